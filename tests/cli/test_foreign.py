"""From foreign recordings to logs, and from results to calibration files, on the command line."""

import h5py
import numpy as np
import pyarrow.parquet as pq
import pytest

PROFILE = """
schema = 1
[time]
source = "t"
unit = "s"
[channels.p_im]
source = "map"
unit = "Pa"
"""


@pytest.fixture
def recording(tmp_path):
    path, profile = tmp_path / "drive.csv", tmp_path / "mine.toml"
    rows = [f"{0.1 * k:.1f},{100 + k}" for k in range(30)]
    rows[7] = "0.7,broken"
    path.write_text("t,map [kPa]\n" + "\n".join(rows) + "\n", encoding="utf-8")
    profile.write_text(PROFILE, encoding="utf-8")
    return path, profile


def test_inspect_shows_what_ingest_did(lpvobs, recording, tmp_path):
    path, profile = recording
    out = tmp_path / "drive.parquet"
    done = lpvobs("ingest", path, "--profile", profile, "--out", out, "--json")
    assert done.code == 0, done.err
    assert done.json["schema"] == "lpvobs/ingest/1"
    assert done.json["channels"]["p_im"]["repairs"] == {"unreadable": 1, "example": "broken", "empty": 1}
    shown = lpvobs("inspect", out)
    assert shown.code == 0, shown.err
    for word in ("mine", "drive.csv", "kPa", "as recorded", "unreadable 1", "missing in this log: n_e"):
        assert word in shown.out, word
    content = lpvobs("inspect", out, "--json").json["logs"][0]
    assert content["ingest"]["profile"]["text"] == PROFILE
    assert content["ingest"]["channels"]["p_im"]["rate"] == pytest.approx(10.0)


@pytest.mark.slow
def test_same_recording_same_bytes(lpvobs, recording, tmp_path):
    path, profile = recording
    for name in ("a.parquet", "b.parquet"):
        assert lpvobs("ingest", path, "--profile", profile, "--out", tmp_path / name).code == 0
    assert (tmp_path / "a.parquet").read_bytes() == (tmp_path / "b.parquet").read_bytes()


@pytest.mark.slow
def test_a_draft_is_written_and_read_back(lpvobs, recording, tmp_path):
    path, _ = recording
    draft, out = tmp_path / "draft.toml", tmp_path / "drive.parquet"
    done = lpvobs("profile", path, "--out", draft)
    assert done.code == 0, done.err
    assert lpvobs("profile", path).out == draft.read_text(encoding="utf-8")
    assert "set unit" in lpvobs("ingest", path, "--profile", draft, "--out", out).err
    draft.write_text(draft.read_text(encoding="utf-8").replace('# unit = "s"', 'unit = "s"'), encoding="utf-8")
    assert lpvobs("ingest", path, "--profile", draft, "--out", out).code == 0
    assert pq.read_schema(out).names == ["time", "p_im"]


@pytest.mark.parametrize(
    ("change", "code", "words"),
    [
        (("--profile", "liu-isce"), 2, "lpvobs has the profiles kit-obd, liu-ice"),
        (("--profile", "liu-ice"), 3, "is missing"),
        (("SOURCE", "nowhere.csv"), 3, "no such recording"),
        (("--out", "SOURCE"), 2, "is also an input"),
        (("--out", "nowhere/log.parquet"), 3, "cannot be written"),
    ],
)
def test_refusals_of_ingest(lpvobs, recording, tmp_path, change, code, words):
    path, profile = recording
    arguments = {"SOURCE": path, "--profile": profile, "--out": tmp_path / "log.parquet"}
    arguments[change[0]] = path if change[1] == "SOURCE" else change[1]
    done = lpvobs("ingest", arguments["SOURCE"], "--profile", arguments["--profile"], "--out", arguments["--out"])
    assert done.code == code, done.err
    assert words in done.err
    assert len(done.err.strip().splitlines()) == 1
    assert not (tmp_path / "log.parquet").exists()


@pytest.mark.parametrize("verb", ["ingest", "profile", "export"])
def test_help_has_an_example(lpvobs, verb):
    done = lpvobs(verb, "--help")
    assert done.code == 0
    assert f"Example: lpvobs {verb}" in " ".join(done.out.split())


RECORDED = {
    "n_e": ("rpm", 1.0, 0.0),
    "u_delta": ("mg/str", 1.0, 0.0),
    "u_egr": ("%", 1.0, 0.0),
    "u_vgt": ("%", 1.0, 0.0),
}
RECORDED |= dict.fromkeys(("p_im", "p_em", "p_amb"), ("hPa", 0.01, 0.0))
RECORDED |= dict.fromkeys(("T_im", "T_em", "T_amb"), ("Â°C", 1.0, -273.15))
RECORDED |= {"omega_t": ("1/min", 30 / np.pi, 0.0), "W_maf": ("kg/h", 3600.0, 0.0)}


@pytest.fixture(scope="module")
def travelled(lpvobs, config, chain, table, tmp_path_factory):
    """Return the result of the chain's log after it went through an MDF file of a measurement system."""
    asammdf = pytest.importorskip("asammdf", reason="the extra lpvobs[mdf] is not installed")
    folder = tmp_path_factory.mktemp("travelled")
    file = asammdf.MDF(version="4.10")
    stamps = table["time"].to_numpy()
    for name, (unit, factor, zero) in RECORDED.items():
        file.append([asammdf.Signal(factor * table[name].to_numpy() + zero, stamps, unit=unit, name=f"Sig_{name}")])
    file.save(folder / "drive.mf4")
    file.close()
    kept = {name: (table.schema.field(name).metadata or {})[b"unit"].decode() for name in RECORDED}
    channels = [f'[channels.{name}]\nsource = "Sig_{name}"\nunit = "{unit}"\n' for name, unit in kept.items()]
    (folder / "mine.toml").write_text("schema = 1\n[raster]\nrate = 20.0\n" + "".join(channels), encoding="utf-8")
    log, result = folder / "ftp75_cold.parquet", folder / "result.h5"
    for step in (
        ("ingest", folder / "drive.mf4", "--profile", folder / "mine.toml", "--out", log),
        ("estimate", "--config", config, "--gain", chain.gain, log, "--out", result),
        ("extrapolate", result),
        (
            "export",
            result,
            "--format",
            "dcm",
            "--out",
            folder / "maf.dcm",
            "--digits",
            "9",
            "--name",
            "MAF_dW",
            "--widest",
            "1e9",
        ),
    ):
        done = lpvobs(*step)
        assert done.code == 0, f"{step}: {done.err}"
    return folder


@pytest.mark.slow
def test_mdf_to_dcm_loses_nothing_but_the_stated_rounding(chain, travelled):
    with h5py.File(chain.result) as direct, h5py.File(travelled / "result.h5") as found:
        # Units there and back, and sums over 10000 samples in between: a thousand times the rounding of a float is plenty.
        np.testing.assert_allclose(found["map/delta_W_c"][()], direct["map/delta_W_c"][()], rtol=1e-9, atol=1e-13)
        filled = found["extrapolation/delta_W_c"][()]
    library = pytest.importorskip("dcmReader.dcm_reader", reason="dcmReader is not installed")
    reader = library.DcmReader()
    reader.read(str(travelled / "maf.dcm"))
    (stored,) = reader.get_characteristic_maps()
    values = np.array([list(line.values()) for line in stored.values.values()])
    np.testing.assert_allclose(values, filled.T, rtol=0.5e-8)


@pytest.mark.slow
def test_the_ingest_record_stands_on_the_page(lpvobs, travelled, tmp_path):
    page = tmp_path / "page.html"
    done = lpvobs("report", travelled / "result.h5", travelled / "ftp75_cold.parquet", "--html", page)
    assert done.code == 0, done.err
    text = page.read_text(encoding="utf-8")
    assert "How ingest made each channel of the log" in text
    assert "drive.mf4 (sha256" in text


def test_export_lists_what_changes(lpvobs, chain, tmp_path):
    old, new = tmp_path / "old.dcm", tmp_path / "new.dcm"
    assert lpvobs("export", chain.result, "--format", "dcm", "--out", old, "--digits", 3, "--widest", 1e9).code == 0
    done = lpvobs(
        "export",
        chain.result,
        "--format",
        "dcm",
        "--out",
        new,
        "--only-estimated",
        "--old",
        old,
        *("--widest", 1e9),
        "--json",
    )
    assert done.code == 0, done.err
    assert done.json["schema"] == "lpvobs/export/1"
    with h5py.File(chain.result) as file:
        estimated = int(file["map/support"][()].sum())
    assert done.json["nodes"]["estimated"] == estimated
    assert 0 < len(done.json["changes"]) <= estimated
    shown = lpvobs(
        "export", chain.result, "--format", "dcm", "--out", new, "--only-estimated", "--old", old, "--widest", 1e9
    )
    assert f"{len(done.json['changes'])} of 255 nodes differ" in shown.err
    assert len(shown.out.strip().splitlines()) == 1 + len(done.json["changes"])


@pytest.mark.parametrize(("file_format", "name"), [("csv", "maf.csv"), ("netcdf", "maf.nc"), ("dcm", "maf.dcm")])
def test_same_result_same_bytes(lpvobs, chain, tmp_path, file_format, name):
    written = []
    for _ in range(2):
        assert lpvobs("export", chain.result, "--format", file_format, "--out", tmp_path / name).code == 0
        written.append((tmp_path / name).read_bytes())
    assert written[0] == written[1]


def test_refusals_of_export(lpvobs, chain, tmp_path):
    for arguments, code in (
        ((chain.result, "--format", "xls", "--out", tmp_path / "a"), 2),
        ((chain.result, "--format", "dcm", "--out", chain.result), 2),
        ((chain.log, "--format", "dcm", "--out", tmp_path / "a"), 3),
        ((chain.result, "--format", "dcm", "--values", "map", "--out", tmp_path / "a"), 3),
        ((chain.result, "--format", "dcm", "--old", chain.log, "--out", tmp_path / "a"), 3),
    ):
        done = lpvobs("export", *arguments)
        assert done.code == code, done.err
        assert len(done.err.strip().splitlines()) == 1
        assert not (tmp_path / "a").exists()
