"""Two writers of one file, what a killed one leaves, disks and folders that do not take a file."""

import fcntl
import os
import resource
import signal
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest
from repository import ROOT, short_cycle
from verbs import AFRESH

from lpvobs.errors import DataError
from lpvobs.io.safety.atomic import claimed, replacing


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def other_process(target, *, then="", **options):
    script = f"""
        import sys, os, signal
        from pathlib import Path
        from lpvobs.errors import DataError
        from lpvobs.io.safety.atomic import replacing
        try:
            with replacing(Path({str(target)!r})) as temporary:
                temporary.write_text("other")
                {then}
        except DataError as error:
            print(error)
            sys.exit(error.exit_code)
    """
    call = [sys.executable, "-c", textwrap.dedent(script)]
    return subprocess.run(call, cwd=ROOT, capture_output=True, text=True, check=False, timeout=300, **options)


def test_a_second_writer_is_refused_and_the_first_goes_on(tmp_path):
    target = tmp_path / "result.h5"
    with replacing(target) as temporary:
        temporary.write_text("first")
        done = other_process(target)
        assert done.returncode == 3
        assert "another process" in done.stdout
        assert str(target) in done.stdout
    assert target.read_text() == "first"
    assert other_process(target).returncode == 0
    assert target.read_text() == "other"
    assert names(tmp_path) == ["result.h5"]


def test_a_claim_keeps_others_out_before_anything_is_written(tmp_path):
    target, link = tmp_path / "result.h5", tmp_path / "link.h5"
    target.write_text("old")
    link.symlink_to(target)
    with claimed(link):
        with claimed(target):  # the same file: nothing new
            assert other_process(target).returncode == 3
        assert other_process(target).returncode == 3
    assert other_process(target).returncode == 0
    assert names(tmp_path) == ["link.h5", "result.h5"]


def test_what_a_killed_writer_leaves_keeps_nobody_out_and_is_swept_away(tmp_path):
    target, neighbour = tmp_path / "result.h5", tmp_path / ".result.h5.mine"
    target.write_text("old")
    neighbour.write_text("of somebody else")
    assert other_process(target, then="os.kill(os.getpid(), signal.SIGKILL)").returncode == -signal.SIGKILL
    assert target.read_text() == "old"
    left = set(names(tmp_path)) - {"result.h5", ".result.h5.mine"}
    assert len(left) == 2
    assert all(name.startswith(".result.h5.") for name in left)
    assert other_process(target).returncode == 0
    assert names(tmp_path) == [".result.h5.mine", "result.h5"]


def test_writers_of_different_files_do_not_meet(tmp_path):
    with replacing(tmp_path / "a") as temporary:
        temporary.write_text("a")
        assert other_process(tmp_path / "b").returncode == 0
    assert names(tmp_path) == ["a", "b"]


def test_a_writer_does_not_sweep_away_what_another_is_writing_under_a_longer_name(tmp_path):
    with replacing(tmp_path / "map.h5") as temporary:
        temporary.write_text("of map.h5")
        for name in ("map", "map.h", "ma"):
            with claimed(tmp_path / name):
                assert (tmp_path / f".{name}.lock").exists()
    assert (tmp_path / "map.h5").read_text() == "of map.h5"


def test_a_lock_that_vanishes_between_opening_and_locking_is_made_again(tmp_path, monkeypatch):
    target = tmp_path / "result.h5"
    lock, real, calls = tmp_path / ".result.h5.lock", fcntl.flock, []

    def flock(handle, how):
        if not calls:
            lock.unlink()  # the owner of before has just ended
        calls.append(how)
        real(handle, how)

    monkeypatch.setattr(fcntl, "flock", flock)
    with claimed(target):
        assert len(calls) == 2
        assert lock.exists()
    assert names(tmp_path) == []


@pytest.mark.parametrize("error", [38, 37, 95])  # ENOSYS, ENOLCK, ENOTSUP
def test_a_file_system_without_locks_is_written_to_all_the_same(tmp_path, monkeypatch, error):
    def flock(handle, how):
        raise OSError(error, os.strerror(error))

    monkeypatch.setattr(fcntl, "flock", flock)
    with replacing(tmp_path / "result.h5") as temporary:
        temporary.write_text("new")
    assert names(tmp_path) == ["result.h5"]


def test_a_folder_that_takes_no_file_is_named(tmp_path):
    for target in ("/proc/result.h5", "/dev/null/result.h5", tmp_path / "nowhere" / "result.h5"):
        with pytest.raises(DataError, match="cannot be written"), claimed(Path(target)):
            pass


@pytest.mark.parametrize("target", ["/", ".", "/dev/null"])
def test_what_is_no_file_is_not_replaced(target):
    with pytest.raises(DataError, match="not a regular file"), claimed(Path(target)):
        pass


def limited():
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))


@pytest.mark.parametrize("verb", ["gain", "log", "page"])
@pytest.mark.slow
def test_a_disk_that_is_full_half_way_costs_nothing(samples, tmp_path, verb):
    """A limit on the size of files stands in for the disk: the kernel refuses to write more in the same way."""
    target = tmp_path / "target"
    target.write_text("old")
    verbs = {
        "gain": ("synth-gain", "--config", samples.config, "--published", "ETC", "--out", target),
        "log": (
            "simulate",
            "--config",
            samples.config,
            "--cycle",
            short_cycle(tmp_path.parent),
            "--rate",
            10,
            "--out",
            target,
        ),
        "page": ("report", samples.result, "--html", target),
    }
    done = subprocess.run(
        [*AFRESH, *map(str, verbs[verb])],
        capture_output=True, text=True, check=False, timeout=600, preexec_fn=limited,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    assert done.returncode == 3, done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    assert "File too large" in done.stderr  # from the target, or from where compiled code is kept
    assert target.read_text() == "old"
    assert names(tmp_path) == ["target"]
