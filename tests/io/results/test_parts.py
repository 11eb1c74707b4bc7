"""What stands in the folder of parts that no run of this program has put there."""

import hashlib
import json
import os

import pytest

from lpvobs.errors import DataError
from lpvobs.io.results.parts import MOST_BYTES, PartsFolder, part_of_bytes

NAME = "a" * 64


@pytest.fixture
def folder(tmp_path):
    parts = PartsFolder(tmp_path / "r.h5", "key")
    parts.keep(NAME, b"half a part")
    return parts


def test_files_of_somebody_else_are_neither_read_nor_removed(folder):
    (folder.path / "film.part").write_bytes(b"not of this program")
    (folder.path / f"{'b' * 64}.part").mkdir()
    os.mkfifo(folder.path / f"{'c' * 64}.part")  # to read it would take for ever
    outside = folder.path.parent / "outside"
    outside.write_bytes(b"kept")
    (folder.path / f"{'d' * 64}.part").symlink_to(outside)
    foreign = sorted(path.name for path in folder.path.iterdir() if path.name != f"{NAME}.part")
    assert folder.found() == frozenset()
    folder.remove()
    assert sorted(path.name for path in folder.path.iterdir()) == foreign
    assert outside.read_bytes() == b"kept"


def test_what_a_run_has_left_is_removed_with_its_folder(folder):
    for left in (f".{NAME}.part.part", f".{NAME}.part.lock"):
        (folder.path / left).touch()
    folder.remove()
    assert not folder.path.exists()


def test_a_part_larger_than_any_log_needs_is_not_loaded(folder):
    with (folder.path / f"{NAME}.part").open("r+b") as file:
        file.truncate(MOST_BYTES + 1)  # takes no room on the disk, but would in memory
    assert folder.found() == frozenset()


def test_a_folder_whose_name_is_too_long_or_taken_is_refused(tmp_path):
    for result in (tmp_path / ("r" * 252), tmp_path / "taken"):
        (tmp_path / "taken.parts").touch()
        parts = PartsFolder(result, "key")
        assert parts.found() == frozenset()
        with pytest.raises(DataError, match="cannot be made"):
            parts.keep(NAME, b"")


def test_a_full_disk_keeps_no_half_part(folder, monkeypatch):
    def full(path, data):
        path.touch()
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("pathlib.Path.write_bytes", full)
    with pytest.raises(DataError, match="No space left on device"):
        folder.keep("b" * 64, b"")
    assert [path.name for path in folder.path.iterdir()] == [f"{NAME}.part"]


def sealed(heading: bytes) -> bytes:
    """Return a part with this heading and a digest that is right."""
    body = len(heading).to_bytes(8, "little") + heading + bytes(8)
    return hashlib.sha256(body).digest() + body


@pytest.mark.parametrize(
    "heading",
    [
        b"[" * 200_000, b"\xff", b"[]", b"null", b"{}", b"NaN",
        *(json.dumps({"arrays": arrays}).encode() for arrays in (
            "f8", [["O", [1]]], [["f8", [-1]]], [["f8", [10**30]]], [["(2,", [1]]], [["{", [1]]], [[{"a": 1}, [1]]],
            [["f8", "xx"]], [["f8", [1.5]]], [["V0", [5]]], [["f8", [0]]] * 9,
        )),
    ],
)  # fmt: skip
def test_a_heading_that_makes_no_sense_is_no_part(heading):
    with pytest.raises(ValueError, match=r"."):
        part_of_bytes(sealed(heading))
