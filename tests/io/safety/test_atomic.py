"""At any instant the target is absent, the old file, or the complete new one."""

import os
import re
import stat
import subprocess
import sys
import textwrap

import pytest
from repository import ROOT

from lpvobs.errors import DataError
from lpvobs.io.safety.atomic import replacing


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_the_new_file_takes_the_place_of_the_old(tmp_path):
    target = tmp_path / "result.h5"
    target.write_text("old")
    with replacing(target) as temporary:
        assert temporary.parent == tmp_path  # the same file system, or a rename would not be one step
        temporary.write_text("new")
        assert target.read_text() == "old"
    assert target.read_text() == "new"
    assert names(tmp_path) == ["result.h5"]


def test_the_old_bytes_are_never_written_over(tmp_path):
    """Who still has the old file open, or a second link to it, keeps the old file whole."""
    target, link = tmp_path / "result.h5", tmp_path / "link.h5"
    target.write_text("old")
    link.hardlink_to(target)
    with target.open() as reader:
        with replacing(target) as temporary:
            temporary.write_text("new and longer")
        assert reader.read() == "old"
    assert link.read_text() == "old"


@pytest.mark.parametrize(
    "failure", [ValueError("no"), KeyboardInterrupt(), SystemExit(3), OSError(28, "No space left")]
)
@pytest.mark.parametrize("before", ["old", None])
def test_a_failure_inside_leaves_what_was_there(tmp_path, failure, before):
    target = tmp_path / "result.h5"
    if before:
        target.write_text(before)

    def write_half():
        with replacing(target) as temporary:
            temporary.write_text("half of")
            raise failure

    wanted = DataError if isinstance(failure, OSError) else type(failure)
    with pytest.raises(wanted):
        write_half()
    assert names(tmp_path) == (["result.h5"] if before else [])
    if before:
        assert target.read_text() == before


def test_a_full_disk_is_reported_in_one_line(tmp_path):
    target = tmp_path / "result.h5"

    def write():
        with replacing(target):
            raise OSError(28, "No space left on device")

    with pytest.raises(DataError, match="No space left on device") as failure:
        write()
    assert str(target) in str(failure.value)
    assert "\n" not in str(failure.value)


@pytest.mark.parametrize("target", ["none/result.h5", "file/result.h5"])
def test_a_folder_that_is_none_is_named(tmp_path, target):
    (tmp_path / "file").write_text("")

    def write():
        with replacing(tmp_path / target):
            pytest.fail("there is nothing to write to")

    with pytest.raises(DataError, match=r"result\.h5"):
        write()


def test_a_folder_in_the_place_of_the_target_stays(tmp_path):
    (tmp_path / "result.h5").mkdir()

    def write():
        with replacing(tmp_path / "result.h5") as temporary:
            temporary.write_text("new")

    with pytest.raises(DataError, match=r"result\.h5"):
        write()
    assert names(tmp_path) == ["result.h5"]
    assert (tmp_path / "result.h5").is_dir()


@pytest.mark.parametrize("mask", [0o022, 0o077])
def test_the_file_is_as_readable_as_the_user_wants(tmp_path, mask):
    before = os.umask(mask)
    try:
        with replacing(tmp_path / "result.h5") as temporary:
            temporary.write_text("new")
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "result.h5").stat().st_mode) == 0o666 & ~mask


def test_two_writers_do_not_meet(tmp_path):
    target = tmp_path / "result.h5"
    with replacing(target) as first, replacing(target) as second:
        assert first != second
        first.write_text("first")
        second.write_text("second")
    assert target.read_text() == "first"  # who leaves last wins, and is whole
    assert names(tmp_path) == ["result.h5"]


def test_a_killed_writer_leaves_the_old_file(tmp_path):
    """SIGKILL gives no chance to tidy up: the old file must be whole; what is left over is hidden and named after the target."""
    target = tmp_path / "result.h5"
    target.write_text("old")
    script = f"""
        import os, signal
        from pathlib import Path
        from lpvobs.io.safety.atomic import replacing
        with replacing(Path({str(target)!r})) as temporary:
            temporary.write_text("half of")
            os.kill(os.getpid(), signal.SIGKILL)
    """
    ended = subprocess.run([sys.executable, "-c", textwrap.dedent(script)], cwd=ROOT, check=False)
    assert ended.returncode == -9
    assert target.read_text() == "old"
    assert all(name.startswith(".result.h5.") for name in names(tmp_path) if name != "result.h5")


def test_a_temporary_file_that_is_written_again_leaves_nothing_that_the_next_writer_does_not_sweep(tmp_path):
    """A killed `estimate` left `..o.h5.wutm0ktd.part.vbuehtd6.part` and a lock of it, which nobody took away."""
    target = tmp_path / "o.h5"
    with replacing(target) as whole:
        whole.write_bytes(b"old")
        with replacing(whole) as again:
            assert re.fullmatch(r"\.o\.h5\.[a-z0-9_]{8}\.part", again.name)
            assert names(tmp_path) == sorted([whole.name, again.name, ".o.h5.lock"])
            again.write_bytes(b"new")
    assert names(tmp_path) == ["o.h5"]
    assert target.read_bytes() == b"new"
