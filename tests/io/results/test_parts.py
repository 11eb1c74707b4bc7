"""What stands in the folder of parts that no run of this program has put there."""

import hashlib
import os
from dataclasses import asdict

import msgspec
import numpy as np
import pytest

from lpvobs.errors import DataError
from lpvobs.io.results.parts import MOST_BYTES, PartsFolder, StoredPart, part_bytes, part_of_bytes
from lpvobs.observer.balance_agreement import BalanceSums
from lpvobs.observer.log_run import LogRun
from lpvobs.observer.parts import LogInformation
from lpvobs.records import DefectFound, Defects

NAME = "a" * 64


def part(sha256):
    """Return the part of a log with this digest: two cells visited, three columns touched."""
    found = (DefectFound("stuck", "p_im", 3, 1.5, "dropped"),)
    defects = Defects(12, {"p_im": 2}, dropped_rows=2, findings=found)
    run = LogRun("drive", sha256, 10, np.float64(0.9), defects, np.zeros(7), np.ones(7), float("nan"))
    sums = np.full((2, 2, 3, 3), 0.1), np.full((2, 2), 0.01), np.full(2, 240.0)
    gram = np.full((2, 4, 4), 0.1)
    shapes = ((2,), (2,), (2, 1), (2, 1), (2, 1), (1, 3), (2, 1, 1), (2, 1, 3), (1,), (4,))
    balances = BalanceSums(*(np.full(shape, 0.2) for shape in shapes))
    part = LogInformation(run, np.array([0, 4, 9]), *sums, np.array([3, 5]), gram)
    return StoredPart(part, (np.array([255, 15], dtype=np.uint8),), balances)


@pytest.fixture
def folder(tmp_path):
    parts = PartsFolder(tmp_path / "r.h5", "key", StoredPart)
    parts.keep(NAME, part(NAME))
    (parts.path / f"{NAME}.part").write_bytes(b"half a part")
    return parts


def test_a_part_comes_back_as_it_was_and_only_for_its_own_run(tmp_path):
    parts, other = (PartsFolder(tmp_path / "r.h5", key, StoredPart) for key in ("key", "another"))
    parts.keep(NAME, part(NAME))
    assert (parts.found(), other.found()) == (frozenset({NAME}), frozenset())
    first, again = part(NAME), parts.read(NAME)
    np.testing.assert_equal(asdict(again), asdict(first))
    assert isinstance(again.part.run.defects.findings[0], DefectFound)
    assert [each.dtype for each in (again.part.cells, again.part.products, again.kept[0])] == [
        np.int64,
        np.float64,
        np.uint8,
    ]
    again.part.products[0] = 0.0  # the sums are added to in place
    assert part_bytes("key", NAME, first) == (parts.path / f"{NAME}.part").read_bytes()


def test_the_part_of_another_log_under_this_name_is_not_taken(tmp_path):
    parts = PartsFolder(tmp_path / "r.h5", "key", StoredPart)
    parts.keep(NAME, part(NAME))
    (parts.path / f"{NAME}.part").rename(parts.path / f"{'b' * 64}.part")
    assert parts.found() == frozenset()


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
        parts = PartsFolder(result, "key", StoredPart)
        assert parts.found() == frozenset()
        with pytest.raises(DataError, match="cannot be made"):
            parts.keep(NAME, part(NAME))


def test_a_full_disk_keeps_no_half_part(folder, monkeypatch):
    def full(path, data):
        path.touch()
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("pathlib.Path.write_bytes", full)
    with pytest.raises(DataError, match="No space left on device"):
        folder.keep("b" * 64, part("b" * 64))
    assert [path.name for path in folder.path.iterdir()] == [f"{NAME}.part"]


def sealed(body: bytes) -> bytes:
    """Return a file of this content with a digest that is right."""
    return hashlib.sha256(body).digest() + body


def altered(*keys, value):
    """Return the content of a part's file in which one entry is another."""
    content = msgspec.msgpack.decode(part_bytes("key", NAME, part(NAME))[32:])
    inner = content
    for key in keys[:-1]:
        inner = inner[key]
    inner[keys[-1]] = value
    return msgspec.msgpack.encode(content)


PRODUCTS = ("stored", "part", "products")


@pytest.mark.parametrize(
    "body",
    [
        b"", b"\x91" * 200_000, b"\xc1", b"\xdd\xff\xff\xff\xff", msgspec.msgpack.encode({}), altered("key", value=1),
        altered("stored", "part", "run", value=None), altered("stored", "kept", value=[1]),
        *(altered(*PRODUCTS, value=value) for value in (
            1, [], [[1], b"12345678", 0], [[2], b"12345678"], [[-1, -1], b"12345678"], [[2**62], b""], [["1"], b"12345678"],
            [[1.5], b"12345678"], [[1], b"1234567"], [[1], "12345678"],
        )),
    ],
)  # fmt: skip
def test_a_content_that_makes_no_sense_is_no_part(body):
    with pytest.raises(ValueError, match=r"."):
        part_of_bytes(sealed(body), StoredPart)
