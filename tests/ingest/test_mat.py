"""MAT files of version 5, read by SciPy in a process of its own: what comes through, and that damage is one line."""

import random
import struct

import numpy as np
import pytest
from robust.foreign import mat_seeds, mutate_mat
from scipy.io import savemat

from lpvobs.errors import DataError
from lpvobs.ingest.formats import open_mat
from lpvobs.ingest.profiles import SourceRules

RULES = SourceRules()
KINDS = ("i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8", "f4", "f8")
NUMBERS = {kind: np.arange(-3, 9).clip(0 if kind[0] == "u" else -9).astype(kind) for kind in KINDS}
DOCUMENT = NUMBERS | {
    "column": np.arange(3.0)[:, None], "flag": np.array([True, False]),
    "text": "kg/h °C", "texts": np.array(["ab", "cd"]), "scalar": 3.5, "matrix": np.arange(6.0).reshape(2, 3),
    "empty": np.empty((0, 0)), "complex": np.array([1 + 2j, 3.0]), "cell": np.array([1.0, "x"], dtype=object),
    "nested": {"inner": {"values": np.arange(5.0), "unit": "°C", "t": np.arange(5.0)}, "unit": "V"},
    "several": np.array([(np.arange(3.0), "rpm"), (np.arange(4.0), "V")], dtype=[("values", "O"), ("unit", "O")]),
}  # fmt: skip
UNITS = {"nested.inner.values": "°C", "nested.inner.t": "", "several(1).values": "rpm", "several(2).values": "V"}


@pytest.fixture(params=[False, True], ids=["plain", "compressed"])
def recording(request, tmp_path):
    path = tmp_path / "drive.mat"
    savemat(path, DOCUMENT, do_compression=request.param)
    return open_mat(path, RULES)


@pytest.mark.slow
def test_vectors_come_through_and_nothing_else_does(recording):
    assert set(recording.heads) == {*NUMBERS, "column", "flag", *UNITS}
    assert {name: recording.heads[name].unit for name in UNITS} == UNITS
    columns = recording.read(list(recording.heads))
    expected = NUMBERS | {"column": [0, 1, 2], "flag": [1, 0], "several(2).values": np.arange(4.0)}
    for name, values in expected.items():
        np.testing.assert_array_equal(columns[name].data.to_numpy(), values)
        assert recording.heads[name].size == len(values)
    assert [str(columns[kind].data.type) for kind in ("i1", "u2", "i8", "f4", "f8")] == [
        "int8", "uint16", "int64", "float", "double",
    ]  # fmt: skip


@pytest.mark.parametrize("number", [2, 4, 14, 18, 22])
@pytest.mark.slow
def test_damage_is_one_line(tmp_path, number):
    """Inputs of the fuzzer in which types and sizes of elements lie; most others change numbers, which nobody can see."""
    rng = random.Random(number)
    path = tmp_path / "drive.mat"
    path.write_bytes(mutate_mat(rng.choice(mat_seeds()).content, rng))
    with pytest.raises(DataError, match="not a readable MAT file") as failure:
        open_mat(path, RULES)
    assert len(str(failure.value).splitlines()) == 1


@pytest.mark.parametrize("lost", [1, 7, 8, 100, 600])
@pytest.mark.slow
def test_a_file_that_was_cut_off(tmp_path, lost):
    path = tmp_path / "drive.mat"
    savemat(path, {"t": np.arange(60.0), "n": np.arange(60.0)})
    path.write_bytes(path.read_bytes()[:-lost])
    with pytest.raises(DataError, match="not a readable MAT file"):
        open_mat(path, RULES)


def test_what_ends_the_reader_does_not_end_the_program(tmp_path):
    """SciPy's reader looks up the type of numbers that does not exist, and ends its process."""
    path = tmp_path / "drive.mat"
    savemat(path, {"t": np.arange(60.0)})
    tag = struct.pack("<II", 9, 8 * 60)
    assert path.read_bytes().count(tag) == 1
    path.write_bytes(path.read_bytes().replace(tag, struct.pack("<II", 0, 8 * 60)))
    with pytest.raises(DataError, match="not a readable MAT file"):
        open_mat(path, RULES)


def test_a_packed_variable_whose_checksum_is_wrong(tmp_path):
    path = tmp_path / "drive.mat"
    savemat(path, {"t": np.arange(60.0)}, do_compression=True)
    content = bytearray(path.read_bytes())
    content[-1] ^= 1
    path.write_bytes(content)
    with pytest.raises(DataError, match="incorrect data check"):
        open_mat(path, RULES)
