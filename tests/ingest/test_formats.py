"""The same drive from CSV, Parquet, MAT of both kinds and MDF gives the same log."""

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from scipy.io import savemat

from lpvobs.errors import DataError
from lpvobs.ingest import recordings
from lpvobs.ingest.foreign import ingest
from lpvobs.ingest.formats import sniff
from lpvobs.ingest.profiles import profile_of

PROFILE = """
schema = 1
[time]
source = "t"
unit = "s"
[raster]
rate = 20.0
[channels.n_e]
source = ["n", "fast.n"]
{unit_n}
unit = "rpm"
rule = "linear"
[channels.T_im]
source = ["T", "slow.T"]
{unit_t}
unit = "K"
rule = "hold"
{time_t}
"""
FAST, SLOW = np.arange(0, 4, 0.01), np.arange(0, 4, 0.5)
SPEED, CELSIUS = 100 + 5 * FAST, 20 + SLOW


def made(path, unit_n="", unit_t="", time_t=""):
    text = PROFILE.format(unit_n=unit_n, unit_t=unit_t, time_t=time_t)
    return ingest([path], profile_of(text, path.with_suffix(".toml")))


def check(found):
    at = np.arange(found.channels["time"].size) / 20
    np.testing.assert_allclose(found.channels["time"], at, atol=1e-12)
    assert at[-1] >= 3.9
    np.testing.assert_allclose(found.channels["n_e"], (100 + 5 * at) * 30 / np.pi, rtol=1e-12)
    held = 273.15 + 20 + np.floor(2 * at + 1e-9) / 2
    np.testing.assert_allclose(found.channels["T_im"], np.where(at <= 4.5, held, np.nan), rtol=1e-12)
    assert found.record["channels"]["n_e"]["rate"] == pytest.approx(100)
    assert found.record["channels"]["T_im"]["rate"] == pytest.approx(2)


def test_csv(tmp_path):
    path = tmp_path / "drive.csv"
    slow = {round(t, 6): c for t, c in zip(SLOW, CELSIUS, strict=True)}
    rows = [f"{t!r},{n!r},{slow.get(round(t, 6), '')}" for t, n in zip(FAST.tolist(), SPEED.tolist(), strict=True)]
    path.write_text("t,n [rad/s],T [degC]\n" + "\n".join(rows) + "\n")
    assert sniff(path) == "csv"
    check(made(path))


def test_parquet(tmp_path):
    path = tmp_path / "drive.parquet"
    slow = np.full(FAST.size, np.nan)
    slow[::50] = CELSIUS
    fields = [
        pa.field("t", pa.float64()),
        pa.field("n", pa.float64(), metadata={"unit": "rad/s"}),
        pa.field("T [degC]", pa.float32()),
    ]
    arrays = [pa.array(FAST), pa.array(SPEED), pa.array(slow.astype(np.float32))]
    pq.write_table(pa.table(arrays, schema=pa.schema(fields)), path)
    assert sniff(path) == "parquet"
    check(made(path))


@pytest.mark.slow
def test_mat_5_with_two_time_bases(tmp_path):
    path = tmp_path / "drive.mat"
    savemat(
        path, {"t": FAST, "n": SPEED[:, None], "t_slow": SLOW, "T": CELSIUS, "note": "a drive"}, do_compression=True
    )
    assert sniff(path) == "mat"
    check(made(path, 'source_unit = "rad/s"', 'source_unit = "degC"', 'time = "t_slow"'))


@pytest.mark.slow
def test_mat_5_with_structures_that_hold_units(tmp_path):
    path = tmp_path / "drive.mat"
    savemat(
        path, {"t": FAST, "fast": {"n": SPEED, "unit": "rad/s"}, "slow": {"T": CELSIUS, "time": SLOW, "unit": "°C"}}
    )
    check(made(path, time_t='time = "slow.time"'))


def test_mat_7_3(tmp_path):
    path = tmp_path / "drive.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, values in (("t", FAST), ("fast/n", SPEED), ("slow/T", CELSIUS), ("slow/time", SLOW)):
            file.create_dataset(name, data=values[None, :]).attrs["MATLAB_class"] = np.bytes_("double")
        for name, unit in (("fast/unit", "rad/s"), ("slow/unit", "degC")):
            file.create_dataset(name, data=np.array([[ord(c)] for c in unit], np.uint16)).attrs["MATLAB_class"] = (
                np.bytes_("char")
            )
        file["elsewhere"] = h5py.ExternalLink("secrets.h5", "/n")
    with path.open("r+b") as stream:
        stream.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")
    assert sniff(path) == "mat"
    check(made(path, time_t='time = "slow.time"'))


def mdf(path, groups, version="4.10"):
    """Write groups of (name, values, unit) with their stamps."""
    asammdf = pytest.importorskip("asammdf", reason="the extra lpvobs[mdf] is not installed")
    file = asammdf.MDF(version=version)
    for stamps, channels in groups:
        file.append([asammdf.Signal(values, stamps, unit=unit, name=name) for name, values, unit in channels])
    file.save(path, overwrite=True)
    file.close()
    return path


MDF_PROFILE = PROFILE.replace('source = "t"\nunit = "s"\n', "")


@pytest.mark.parametrize(
    ("version", "name"),
    [
        ("4.10", "drive.mf4"),
        pytest.param("3.30", "drive.mdf", marks=pytest.mark.slow),
        pytest.param("4.20", "drive.mf4", marks=pytest.mark.slow),
    ],
)
def test_mdf_with_a_time_base_per_group(tmp_path, version, name):
    path = mdf(tmp_path / name, [(FAST, [("n", SPEED, "rad/s")]), (SLOW, [("T", CELSIUS, "Â°C")])], version)
    assert sniff(path) == "mdf"
    found = ingest([path], profile_of(MDF_PROFILE.format(unit_n="", unit_t="", time_t=""), tmp_path / "p.toml"))
    check(found)
    assert "unit_spelling" in found.record["channels"]["T_im"]["repairs"]


@pytest.mark.slow
def test_mdf_names_that_several_groups_have(tmp_path):
    path = mdf(
        tmp_path / "drive.mf4", [(FAST, [("n", SPEED, "rad/s")]), (SLOW, [("T", CELSIUS, "°C"), ("n", CELSIUS, "rpm")])]
    )
    text = MDF_PROFILE.format(unit_n="", unit_t="", time_t="")
    with pytest.raises(DataError, match="'n' fits 2 columns: 0:n, 1:n"):
        ingest([path], profile_of(text, tmp_path / "p.toml"))
    check(ingest([path], profile_of(text.replace('"n"', '"0:n"'), tmp_path / "p.toml")))


@pytest.mark.slow
def test_what_the_library_says_of_a_file_is_a_note_and_not_on_stderr(tmp_path, capfd):
    path = mdf(tmp_path / "drive.mf4", [(FAST, [("n", SPEED, "rad/s")]), (SLOW, [("T", CELSIUS, "degC")])])
    content = path.read_bytes()
    assert b"</HDcomment>" in content
    path.write_bytes(content.replace(b"</HDcomment>", b"</HDcommenT>"))
    found = ingest([path], profile_of(MDF_PROFILE.format(unit_n="", unit_t="", time_t=""), tmp_path / "p.toml"))
    check(found)
    assert "could not parse" in found.record["sources"][0]["notes"]["asammdf says"]
    assert capfd.readouterr().err == ""


def test_mdf_without_its_library_says_what_to_install(tmp_path, monkeypatch):
    import sys

    from lpvobs.errors import UsageError

    monkeypatch.setitem(sys.modules, "asammdf", None)
    path = tmp_path / "drive.mf4"
    path.write_bytes(b"MDF     4.10    ")
    with pytest.raises(UsageError, match=r"pip install 'lpvobs\[mdf\]'"):
        made(path)


@pytest.mark.parametrize("kind", ["mat", "mat73", "parquet", "mdf"])
@pytest.mark.slow
def test_damaged_files_are_one_line(tmp_path, kind):
    path = tmp_path / "drive.bin"
    if kind == "mat":
        savemat(path, {"t": FAST, "n": SPEED}, do_compression=True, appendmat=False)
    elif kind == "mat73":
        with h5py.File(path, "w") as file:
            file["t"], file["n"] = FAST, SPEED
    elif kind == "parquet":
        pq.write_table(pa.table({"t": FAST, "n": SPEED}), path)
    else:
        mdf(tmp_path / "drive.mf4", [(FAST, [("n", SPEED, "rad/s")])]).rename(path)
    path.write_bytes(path.read_bytes()[:-900])
    with pytest.raises(DataError) as failure:
        made(path)
    assert "\n" not in str(failure.value)
    assert str(path) in str(failure.value)


@pytest.mark.parametrize("kind", ["csv", "mat", "mat73", "parquet"])
@pytest.mark.slow
def test_the_size_is_looked_at_before_memory_is_taken(tmp_path, monkeypatch, kind):
    path = tmp_path / "drive.bin"
    zeros = np.zeros(2_000_000)
    if kind == "csv":
        path.write_text("t,n [rad/s],T [degC]\n" + "0,0,0\n" * 300_000)
    elif kind == "mat":  # 16 MB in 16 kB
        savemat(path, {"t": zeros, "n": zeros, "T": zeros}, do_compression=True, appendmat=False)
        assert path.stat().st_size < 100_000
    elif kind == "mat73":
        with h5py.File(path, "w") as file:
            for name in ("t", "n", "T"):
                file.create_dataset(name, data=zeros, compression="gzip")
    else:
        pq.write_table(pa.table({"t": zeros, "n": zeros, "T": zeros}), path)
    monkeypatch.setattr(recordings, "MOST_BYTES", 1 << 20)
    with pytest.raises(DataError, match="GiB"):
        made(path)
