"""Our reader of MAT files against SciPy's, and against damage."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.io import loadmat, savemat

from lpvobs.ingest.mat5 import read_mat5, unpacked_size

KINDS = ("i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8", "f4", "f8")
NUMBERS = {kind: np.arange(-3, 9).clip(0 if kind[0] == "u" else -9).astype(kind) for kind in KINDS}
DOCUMENT = NUMBERS | {
    "text": "kg/h °C", "scalar": 3.5, "matrix": np.arange(6.0).reshape(2, 3), "empty": np.empty((0, 0)),
    "flag": np.array([True, False]),
    "nested": {"inner": {"values": np.arange(5.0), "unit": "rpm"}, "unit": "V"},
    "several": np.array([(np.arange(3.0), "a"), (np.arange(4.0), "b")], dtype=[("values", "O"), ("name", "O")]),
    "complex": np.array([1 + 2j, 3.0]), "cell": np.array([1.0, "x"], dtype=object),
}  # fmt: skip


@pytest.fixture(params=[False, True], ids=["plain", "compressed"])
def path(request, tmp_path):
    path = tmp_path / "drive.mat"
    savemat(path, DOCUMENT, do_compression=request.param)
    return path


def test_numbers_and_texts_are_what_scipy_reads(path):
    mine, theirs = read_mat5(path), loadmat(path, squeeze_me=True)
    assert set(mine) == {name for name in theirs if not name.startswith("__")}
    for name in (*NUMBERS, "scalar", "empty", "flag"):
        np.testing.assert_array_equal(np.squeeze(mine[name]), np.ravel(theirs[name]).squeeze())
    assert mine["text"] == theirs["text"]
    assert mine["matrix"] is mine["complex"] is mine["cell"] is None


def test_structures(path):
    found = read_mat5(path)
    np.testing.assert_array_equal(found["nested"]["inner"]["values"], np.arange(5.0))
    assert (found["nested"]["unit"], found["nested"]["inner"]["unit"]) == ("V", "rpm")
    assert [item["name"] for item in found["several"]] == ["a", "b"]
    np.testing.assert_array_equal(found["several"][1]["values"], np.arange(4.0))


def test_the_size_is_known_before(path):
    total = sum(np.asarray(values).nbytes for values in NUMBERS.values())
    assert total < unpacked_size(path) < 50 * total


@given(st.integers(0, 10_000), st.booleans())
def test_damage_is_a_value_error_or_another_value(tmp_path_factory, seed, compressed):
    rng = np.random.default_rng(seed)
    path = tmp_path_factory.mktemp("damaged") / "drive.mat"
    savemat(path, DOCUMENT, do_compression=compressed)
    content = bytearray(path.read_bytes())
    for place in rng.integers(0, len(content), rng.integers(1, 20)):
        content[place] = rng.integers(0, 256)
    path.write_bytes(bytes(content[: rng.integers(1, len(content) + 1)] if seed % 3 == 0 else content))
    try:
        found = read_mat5(path)
    except ValueError:
        return
    assert isinstance(found, dict)
