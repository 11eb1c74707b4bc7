"""A result that another program replaces while a verb works on it, and files that may not be read."""

import shutil

import h5py
import pytest

from lpvobs.api import extrapolate
from lpvobs.api.files import refuse_copies
from lpvobs.api.jobs import Workers
from lpvobs.errors import DataError
from lpvobs.io.results import hdf
from lpvobs.io.results.results import read_result, update


@pytest.fixture
def result(samples, tmp_path):
    return shutil.copyfile(samples.result, tmp_path / "result.h5")


@pytest.mark.slow
def test_what_was_found_is_not_written_into_the_result_that_came_in_between(samples, result, monkeypatch):
    real, newer = extrapolate.krige, b"of another program"

    def krige(*arguments):
        result.write_bytes(newer)
        return real(*arguments)

    monkeypatch.setattr(extrapolate, "krige", krige)
    with pytest.raises(DataError, match="another process changed this file during the run"):
        extrapolate.extrapolate(result)
    assert result.read_bytes() == newer
    assert [path.name for path in result.parent.iterdir()] == ["result.h5"]


def test_a_result_replaced_at_the_last_moment_stays_as_it_is_then(samples, result):
    newer = result.with_name("newer")
    shutil.copyfile(samples.result, newer)
    inode = newer.stat().st_ino
    with pytest.raises(DataError, match="another process changed this file during the run"):
        update(read_result(result), lambda file: newer.replace(result))
    assert result.stat().st_ino == inode


def test_a_change_is_written_where_nobody_came_in_between(result):
    update(read_result(result), lambda file: file.attrs.__setitem__("note", "kept"))
    with h5py.File(result) as file:
        assert file.attrs["note"] == "kept"


def test_a_result_that_may_not_be_read_is_named(monkeypatch, result):
    def denied(path):
        raise PermissionError(13, "Unable to determine if the file is HDF5")  # what h5py says

    monkeypatch.setattr(hdf.h5py, "is_hdf5", denied)
    with pytest.raises(DataError, match=r"result\.h5: cannot be read \(Permission denied\)"):
        read_result(result)


def test_a_log_that_may_not_be_read_does_not_hinder_the_others(monkeypatch, samples):
    def denied(path):
        raise PermissionError(13, "Permission denied", str(path))

    monkeypatch.setattr("lpvobs.api.files.log_digest", denied)
    refuse_copies([samples.log, samples.log])  # who reads it says what is wrong with it


def test_workers_that_cannot_be_started_are_one_line(monkeypatch):
    def submit(self, *arguments):
        raise BlockingIOError(11, "Resource temporarily unavailable")

    monkeypatch.setattr("concurrent.futures.ProcessPoolExecutor.submit", submit)
    with Workers(2) as workers, pytest.raises(DataError, match=r"cannot be started .* --jobs 1"):
        list(workers.finished(abs, [1, 2, 3]))
