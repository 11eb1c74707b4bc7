"""Foreign files that were made to break the reader, or to make it read or run what it should not."""

import io
import os
import struct
import zlib
from pathlib import Path

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from lpvobs.api.ingest_log import ingest_log
from lpvobs.errors import DataError
from lpvobs.ingest import formats, recordings
from lpvobs.ingest.drafting import draft_profile
from lpvobs.ingest.foreign import ingest
from lpvobs.ingest.formats import open_csv, open_mat, open_mdf
from lpvobs.ingest.profiles import SourceRules, profile_of
from lpvobs.ingest.reader import expect_arithmetic
from lpvobs.ingest.repairs import stamps
from lpvobs.io.safety import sandbox

PROFILE = """
schema = 1
{time}
[raster]
rate = {rate}
[channels.p_im]
source = "{source}"
unit = "Pa"
source_unit = "kPa"
"""
TIME = '[time]\nsource = "t"\nunit = "s"'
T = np.arange(100) / 10
ROWS = "".join(f"{k / 10},{100 + k}\n" for k in range(100))
RULES = SourceRules()


def made(path, source="p", rate=0.0, time=TIME):
    return ingest([path], profile_of(PROFILE.format(source=source, rate=rate, time=time), path.with_suffix(".toml")))


def refused(path, match, **how):
    for attempt in (lambda: made(path, **how), lambda: draft_profile(path)):
        with pytest.raises(DataError, match=match) as failure:
            attempt()
        assert len(str(failure.value)) < 1000
        assert len(str(failure.value).splitlines()) == 1


def test_a_quotation_that_is_left_open_swallows_no_rows(tmp_path):
    path = tmp_path / "drive.csv"
    path.write_text("t,p\n" + ROWS.replace("0.5,105", '0.5,"105'))
    refused(path, "the quotation mark in line 7 is not closed, so 94 lines")
    path.write_text("t,p\n" + ROWS.replace("0.5,105", '0.5,"105"').replace("0.6,106", '0.6,5"'))
    assert made(path).channels["time"].size == 100


def test_a_line_that_ends_within_a_letter_is_left_out_and_nothing_else_is_said(tmp_path, capfd):
    """Found by the fuzzer: Arrow cannot hand such a line on as UTF-8, and said so in a traceback."""
    path = tmp_path / "cut.csv"
    path.write_bytes(f"t,p\n{ROWS}10,200,".encode() + "°".encode()[:1])
    recording = open_csv(path, RULES)
    assert len(recording.read(["t", "p"])["t"].data) == 100
    assert recording.notes["broken_lines"].startswith("1 lines")
    assert capfd.readouterr().err == ""


def test_a_doubled_column_is_not_chosen_silently(tmp_path):
    path = tmp_path / "drive.csv"
    path.write_text("t,p,p,p#2,p#2#\n1,2,3,4,5\n2,3,4,5,6\n")
    with pytest.raises(DataError, match="'p' fits 2 columns"):
        made(path)
    assert list(open_csv(path, RULES).heads) == ["t", "p#2", "p#3", "p#2#", "p#2##"]
    assert made(path, source="p#3").channels["p_im"].tolist() == [3000.0, 4000.0]


def test_a_stamp_out_of_all_proportion_is_one_short_line(tmp_path):
    path = tmp_path / "drive.csv"
    path.write_text("t,p\n" + ROWS + "1e300,3\n")
    with pytest.raises(DataError, match=r"drive.csv: a log of 1e\+300 s at 20 Hz") as failure:
        made(path, rate=20.0)
    assert len(str(failure.value)) < 300


def test_numbers_at_the_end_of_what_floats_can_hold(tmp_path):
    """Found by the fuzzer: they were warned of on stderr, with the place in the program."""
    path, profile, out = tmp_path / "drive.csv", tmp_path / "mine.toml", tmp_path / "log.parquet"
    path.write_text("t,p\n" + ROWS.replace(",105\n", ",1.7e308\n").replace(",106\n", ",-1.7e308\n"))
    profile.write_text(PROFILE.format(source="p", rate=5.0, time=TIME).replace('"kPa"', '"Pa"') + 'rule = "mean"\n')
    assert draft_profile(path)
    assert ingest_log([path], str(profile), out)["channels"]["p_im"]["without_value"] > 0
    assert not np.isinf(pq.read_table(out)["p_im"].to_numpy()).any()


def test_an_unreadable_entry_is_quoted_in_short(tmp_path):
    path = tmp_path / "drive.csv"
    path.write_text("t,p\n" + ROWS + "99," + "x" * 5000 + "\n")
    assert made(path).record["channels"]["p_im"]["repairs"]["example"] == "x" * 40


@pytest.mark.parametrize("encoding", ["punycode", "undefined", "idna", "zip", "no such"])
def test_an_encoding_that_is_none_of_text(tmp_path, encoding):
    path = tmp_path / "drive.csv"
    path.write_bytes(b"t,p\xff\n" + ROWS.encode())
    with pytest.raises(DataError):
        open_csv(path, SourceRules(encoding=encoding)).read(["t"])


def test_numbers_are_neither_a_time_of_day_nor_a_date():
    for unit in ("clock", "datetime"):
        for numbers in (np.arange(3), np.arange(3.0)):
            with pytest.raises(ValueError, match="needs text or time stamps"):
                stamps(pa.array(numbers), unit)


def test_the_memory_of_a_table_is_known_before_it_is_read(tmp_path, monkeypatch):
    """A row of four bytes becomes ten times as many."""
    path = tmp_path / "drive.csv"
    path.write_text("t,p\n" + "1,1\n" * 50_000)
    monkeypatch.setattr(recordings, "MOST_BYTES", 4 << 20)
    refused(path, "reading it would take")


def test_too_many_columns_are_refused(tmp_path):
    path = tmp_path / "drive.csv"
    path.write_text("t,p" + ",x" * 60_000 + "\n")
    with pytest.raises(DataError, match="has 60002 columns"):
        made(path)


def test_a_name_that_is_no_text_is_drafted(tmp_path):
    path = Path(os.fsdecode(os.fsencode(tmp_path) + b"/\xff.csv"))
    path.write_text("t,p\n" + ROWS)
    assert draft_profile(path).encode("utf-8")


def element(kind, data):
    return struct.pack("<II", kind, len(data)) + data + b"\0" * (-len(data) % 8)


def vector(name, values, kind=9):
    parts = (6, struct.pack("<II", 6, 0)), (5, struct.pack("<2i", values.size, 1)), (1, name), (kind, values.tobytes())
    return element(14, b"".join(element(*part) for part in parts))


HEADER = b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM"


def test_a_few_packed_bytes_that_become_many_numbers(tmp_path, monkeypatch):
    """Bytes unpack to a thousand times their number, and to eight times more as floats."""
    path = tmp_path / "drive.mat"
    packed = [zlib.compress(vector(name, np.zeros(1 << 18, np.int8), 1)) for name in (b"t", b"p")]
    path.write_bytes(HEADER + b"".join(struct.pack("<II", 15, len(item)) + item for item in packed))
    monkeypatch.setattr(recordings, "MOST_BYTES", 16 << 20)
    refused(path, "reading it would take")


def test_variables_that_are_there_twice(tmp_path):
    path = tmp_path / "drive.mat"
    path.write_bytes(HEADER + vector(b"t", T) + vector(b"p", T) + vector(b"p", 2 * T))
    refused(path, "variable 'p' appears twice")


def hdf(path, *changes):
    """Write a MAT file of version 7.3 with t, p and what the changes make of it."""
    stream = io.BytesIO()
    with h5py.File(stream, "w", userblock_size=512) as file:
        file["t"], file["p"] = T, T
        for change in changes:
            change(file)
    path.write_bytes(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM" + stream.getvalue()[128:])
    return path


def text(group, name, values):
    group[name] = values
    group[name].attrs["MATLAB_class"] = np.bytes_("char")


@pytest.fixture
def secret(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with h5py.File(tmp_path / "secret.h5", "w") as file:
        file["p"] = 7 * T
        text(file, "unit", np.frombuffer(b"secret", np.uint8))


@pytest.mark.slow
def test_links_to_other_files_are_not_followed(tmp_path, secret):
    def linked(file):
        file["g/v"], file["q.p"] = T, T
        file["g/unit"] = h5py.ExternalLink("secret.h5", "/unit")
        file.create_group("q")["p"] = h5py.ExternalLink("secret.h5", "/p")

    path = hdf(tmp_path / "drive.mat", linked)
    assert open_mat(path, RULES).heads["g.v"].unit == ""
    assert made(path, source="q.p").channels["p_im"].tolist() == (1000 * T).tolist()  # not seven times as much


def test_two_paths_of_the_same_dotted_name(tmp_path):
    def doubled(file):
        file["a.b"], file["a/b"] = T, T

    refused(hdf(tmp_path / "drive.mat", doubled), "variable 'a.b' appears twice")


UNITS = (
    [2**60], [-5], [1.5], [b"ab"], "text", h5py.Empty("u2"), np.zeros(100_000, np.uint16),
    np.array([0xD800, 10, 0x202E], np.uint16),
)  # fmt: skip


@pytest.mark.slow
def test_a_unit_that_is_none(tmp_path):
    def odd(file):
        for number, values in enumerate(UNITS):
            file[f"g{number}/v"] = T
            text(file[f"g{number}"], "unit", values)

    path = hdf(tmp_path / "drive.mat", odd)
    heads = open_mat(path, RULES).heads
    assert {heads[f"g{number}.v"].unit for number in range(len(UNITS))} <= {"", "\ufffd\n\u202e"}
    assert draft_profile(path).encode("utf-8")


@pytest.mark.slow
def test_things_that_are_no_vectors_of_numbers(tmp_path):
    def odd(file):
        file["empty"], file["long"] = h5py.Empty("f8"), T.astype(np.longdouble)
        file.create_group("g").create_group("unit").attrs["MATLAB_class"] = np.bytes_("char")
        file["g/v"] = T
        file["p"].attrs["units"], file["p"].attrs["MATLAB_class"] = np.arange(5), [1, 2]
        file.create_dataset(b"\xff\xfe", data=T)

    path = hdf(tmp_path / "drive.mat", odd)
    recording = open_mat(path, RULES)
    assert set(recording.heads) == {"t", "p", "g.v"}
    assert recording.notes == {"names": "1 objects were left out, because their names are not text"}
    assert made(path).channels["time"].size == 100


@pytest.mark.slow
def test_no_file_of_a_stranger_is_opened_by_the_program_itself(tmp_path, monkeypatch):
    """Anybody can compute a checksum, so what lies under a seal is read apart, as without."""
    from lpvobs.io.safety.seal import sealed

    path = hdf(tmp_path / "drive.mat", lambda file: file.create_dataset("z", (2**60,), "i1", chunks=(1 << 20,)))
    path.write_bytes(sealed(path.read_bytes()))
    monkeypatch.setattr(h5py, "File", None)
    assert made(path).channels["time"].size == 100
    with pytest.raises(DataError, match="GiB"):
        made(path, source="z")


@pytest.fixture
def mdf(tmp_path):
    """Return what writes an MDF file of one channel."""
    asammdf = pytest.importorskip("asammdf", reason="the extra lpvobs[mdf] is not installed")

    def write(formula):
        file = asammdf.MDF(version="4.10")
        conversion = {"formula": formula} if formula else None
        file.append([asammdf.Signal(T, T, unit="kPa", name="p", conversion=conversion)])
        file.save(tmp_path / "drive.mf4", overwrite=True)
        file.close()
        return tmp_path / "drive.mf4"

    return write


@pytest.mark.slow
def test_a_formula_in_a_file_is_arithmetic_or_refused(tmp_path, mdf):
    """The library gives formulas to Python's own eval where SymPy is installed, and takes one that fails for no conversion."""
    assert made(mdf("2*X1 + sin(0*X1)"), time="").channels["p_im"].tolist() == (2000 * T).tolist()
    with pytest.raises(DataError, match="expected only arithmetic with X"):
        open_mdf(mdf(f"__import__('os').system('touch {tmp_path}/run')"), RULES).read(["p"])
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    "formula", ["X1^2", "X.__class__", "XY", "open(X)", "sin", "sqrt(X1", "X X", "X*", "()()", "1(X)"]
)
def test_a_formula_that_is_no_arithmetic(formula):
    pytest.importorskip("numexpr", reason="comes with the extra lpvobs[mdf]")
    with pytest.raises(ValueError, match="channel 'p' has the conversion formula"):
        expect_arithmetic(formula, "p")
    expect_arithmetic("(X1*2.5e-3 + .5)/sqrt(X1**2) - 1.", "p")


@pytest.mark.slow
def test_a_reader_that_comes_to_no_end_is_stopped(mdf, monkeypatch):
    monkeypatch.setattr(formats, "SECONDS", 1)  # of computing; powers of powers would take longer than the universe
    with pytest.raises(DataError, match="takes too long"):
        open_mdf(mdf("9**9**9**9**9*X"), RULES).read(["p"])


def test_a_reader_that_wants_too_much_memory_is_stopped(tmp_path, mdf, monkeypatch):
    monkeypatch.setattr(formats, "BYTES", 100 << 20)  # less than its libraries take
    with pytest.raises(DataError, match="not a readable MDF file"):
        open_mdf(mdf(""), RULES)
    with pytest.raises(DataError, match="not a readable MAT file"):
        open_mat(hdf(tmp_path / "drive.mat"), RULES)


def test_modules_in_the_working_folder_are_not_run(tmp_path, monkeypatch):
    """Logs come with whatever else their folder holds."""
    (tmp_path / "h5py.py").write_text("raise SystemExit(7)")
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("PYTHONPATH", raising=False)
    path = hdf(tmp_path / "drive.mat")
    assert sandbox.answer("lpvobs.io.safety.seal", path, 10, 2 << 30) == b"whole\n"
