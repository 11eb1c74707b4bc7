"""HDF5 files that are damaged, changed by others, or point elsewhere."""

import shutil
import time
from contextlib import suppress

import h5netcdf
import h5py
import netCDF4
import numpy as np
import pytest

from lpvobs.errors import DataError
from lpvobs.io.results.gains import read_gain
from lpvobs.io.results.hdf import changing, creating
from lpvobs.io.results.results import read_result
from lpvobs.io.safety import seal
from lpvobs.io.safety.sandbox import PATIENCE
from lpvobs.io.safety.seal import LENGTH, SECONDS

READERS = {"gain": read_gain, "result": read_result}


@pytest.fixture
def copy(samples, tmp_path):
    def make(kind):
        return shutil.copy(getattr(samples, kind), tmp_path / f"{kind}.h5")

    return make


def refusal(kind, path):
    with pytest.raises(DataError) as failure:
        READERS[kind](path)
    text = str(failure.value)
    assert str(path) in text
    assert len(text.splitlines()) == 1
    return text


@pytest.mark.parametrize("kind", READERS)
def test_a_flipped_bit_anywhere_is_noticed_before_hdf5_sees_it(copy, kind):
    path = copy(kind)
    whole = path.read_bytes()
    rng = np.random.default_rng(1)
    began = time.process_time()
    for place in rng.integers(0, len(whole) - LENGTH, 300):
        spoiled = bytearray(whole)
        spoiled[place] ^= 1 << int(rng.integers(8))
        path.write_bytes(spoiled)
        text = refusal(kind, path)
        assert "checksum" in text or "HDF5" in text  # the first bytes say that it is HDF5 at all
    assert time.process_time() - began < 10.0  # a hang of the library would be one of ten seconds and more


@pytest.mark.parametrize("kind", READERS)
@pytest.mark.slow
def test_damage_to_a_file_without_a_seal_is_refused_or_harmless_and_never_hangs(copy, kind):
    """Each costs a process of its own, so few; `make fuzz` tries many."""
    path = copy(kind)
    whole = path.read_bytes()[:-LENGTH]
    for place in np.random.default_rng(2).integers(0, 4096, 6):
        spoiled = bytearray(whole)
        spoiled[place : place + 4] = b"\xff\xff\xff\xff"
        path.write_bytes(spoiled)
        began = time.monotonic()
        with suppress(DataError):
            READERS[kind](path)
        assert time.monotonic() - began < 2.0 * PATIENCE * SECONDS


@pytest.mark.parametrize("kind", READERS)
@pytest.mark.parametrize("left", [0, 7, 100, 0.5, -1, -LENGTH - 1])
def test_a_truncated_file_is_refused(copy, kind, left):
    path = copy(kind)
    whole = path.read_bytes()
    kept = int(left * len(whole)) if isinstance(left, float) else left
    path.write_bytes(whole[:kept])
    if left == -1:  # only the seal is cut short: all of the content is there
        READERS[kind](path)
    else:
        refusal(kind, path)


@pytest.mark.parametrize("kind", READERS)
def test_the_file_of_another_program_is_read_after_a_trial(copy, kind):
    """A person may annotate a result with any HDF5 tool: the tool cuts the seal off, and the content counts as it is."""
    path = copy(kind)
    size = path.stat().st_size
    with h5py.File(path, "r+") as file:
        file["gain/L"][0, 0] = 1234.5
    assert path.stat().st_size == size - LENGTH
    stored = READERS[kind](path)
    gain = stored.gain if kind == "gain" else stored.gain.gain
    assert gain.L[0, 0] == 1234.5


def test_a_sealed_file_opens_everywhere(copy):
    path = copy("result")
    with h5py.File(path) as file:
        expected = file["map/delta_W_c"][()]
    with netCDF4.Dataset(path) as file:
        np.testing.assert_array_equal(np.ma.filled(file["map"]["delta_W_c"][:], np.nan), expected)
    with h5netcdf.File(path) as file:
        np.testing.assert_array_equal(file["map/delta_W_c"][()], expected)


def test_same_content_same_bytes_created_or_changed(tmp_path):
    for name in ("a", "b"):
        with creating(tmp_path / name) as file:
            file["x"] = np.arange(5.0)
        with changing(tmp_path / name, tmp_path / name) as file:
            file["y"] = 1.0
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


def external(file):
    file["map/other"] = h5py.ExternalLink("/etc/hostname", "/")


def soft(file):
    file["map/other"] = h5py.SoftLink("/gain")


def outside(file):
    file["map"].create_dataset("other", shape=(8,), dtype="u1", external=[("/etc/hostname", 0, 8)])


def virtual(file):
    layout = h5py.VirtualLayout(shape=(4,), dtype="f8")
    layout[:] = h5py.VirtualSource("elsewhere.h5", "x", shape=(4,))
    file["map"].create_virtual_dataset("other", layout)


def bomb(file):
    file["map"].create_dataset("other", shape=(10**6, 10**6), dtype="f8", chunks=(1000, 1000), compression="gzip")


@pytest.mark.parametrize("spoil", [external, soft, outside, virtual, bomb])
@pytest.mark.slow
def test_what_points_elsewhere_or_claims_too_much_is_refused_sealed_or_not(copy, tmp_path, spoil):
    sealed, bare = tmp_path / "sealed.h5", copy("result")
    with changing(bare, sealed) as file:
        spoil(file)
    with h5py.File(bare, "r+") as file:
        spoil(file)
    for path in (sealed, bare):
        assert "other" in refusal("result", path) or spoil is bomb


def test_a_file_may_unpack_to_a_few_times_its_own_size_however_large_it_is(copy, monkeypatch):
    """A fleet grows with its vehicles: what `track` writes is read again, what was packed to do harm is not."""
    monkeypatch.setattr(seal, "MOST_BYTES", 1)
    path = copy("result")
    READERS["result"](path)
    monkeypatch.setattr(seal, "MOST_TIMES", 0.5)
    assert "unpacks to more than" in refusal("result", path)


def test_a_group_that_holds_itself_is_no_endless_loop(copy):
    path = copy("result")
    with h5py.File(path, "r+") as file:
        file["logs/drive/again"] = file["logs"]
    began = time.monotonic()
    READERS["result"](path)
    assert time.monotonic() - began < 2.0 * PATIENCE * SECONDS
