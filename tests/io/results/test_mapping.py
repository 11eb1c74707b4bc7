"""One declaration writes a record and refuses, on reading, what is not as declared."""

from dataclasses import dataclass

import h5py
import numpy as np
import pytest
from numpy.typing import NDArray

from lpvobs.errors import DataError
from lpvobs.io.results.hdf import changing, creating, reading, write_group
from lpvobs.io.results.mapping import ENDS, Item, Layout, fields, read, read_rows, rows
from lpvobs.records import Array


@dataclass(frozen=True)
class Everything:
    """A field of every kind."""

    title: str
    tables: dict[str, int]
    held: bool
    names: tuple[str, ...]
    count: int
    size: float
    onset: float | None
    yes: bool
    range: tuple[float, float]
    surface: Array
    where: NDArray[np.bool_]
    origin: NDArray[np.int8]


EVERYTHING = Layout(
    Everything,
    {
        "name": Item("1", "name of a row", of="names"),
        "count": Item("1", "how many"),
        "size": Item("kg/s", "a size"),
        "onset": Item("s", "when it begins", gaps=True),
        "yes": Item("1", "whether it is so"),
        "range": Item("s", "a range", ("end",)),
        "surface": Item("kg/s", "values", ("name", "column"), gaps=True),
        "where": Item("1", "where it is so", ("name",)),
        "origin": Item("1", "where it comes from", ("name",), meanings={1: "measured", 2: "guessed"}),
    },
    {"end": ENDS, "column": "column"},
    ("title", "tables", "held"),
)
RECORD = Everything(
    title="some",
    tables={"a": 1},
    held=True,
    names=("one", "two"),
    count=3,
    size=0.5,
    onset=None,
    yes=True,
    range=(1.0, 2.0),
    surface=np.array([[1.0, np.nan, 3.0], [4.0, 5.0, 6.0]]),
    where=np.array([True, False]),
    origin=np.array([1, 2], dtype=np.int8),
)


@dataclass(frozen=True)
class Row:
    """One of several."""

    name: str
    share: float
    pair: tuple[float, float]


ROWS = Layout(Row, {"log": Item("1", "log", of="name"), "share": Item("1", "share"), "pair": Item("s", "pair", ("end",))},
              {"end": ENDS}, row="log")  # fmt: skip
SEVERAL = (Row("a", 0.25, (1.0, 2.0)), Row("b", 0.75, (3.0, 4.0)))


@pytest.fixture
def path(tmp_path):
    target = tmp_path / "some.h5"
    with creating(target) as file:
        file.attrs["schema"] = "lpvobs/some/1"
        write_group(file, "record", fields(EVERYTHING, RECORD))
        write_group(file, "rows", rows(ROWS, SEVERAL))
    return target


def read_both(path):
    with reading(path, "some", "make it again") as file:
        return read(file["record"], EVERYTHING), read_rows(file["rows"], ROWS)


def test_a_record_of_every_kind_comes_back(path):
    again, several = read_both(path)
    for name, value in vars(RECORD).items():
        found = getattr(again, name)
        np.testing.assert_array_equal(found, value)
        assert type(found) is type(value)
        assert getattr(found, "dtype", None) == getattr(value, "dtype", None)
    assert several == SEVERAL


def test_no_rows_write_nothing_and_come_back_as_none(tmp_path):
    with h5py.File(tmp_path / "none.h5", "w") as file:
        group = write_group(file, "rows", rows(ROWS, ()))
        assert list(group) == []
        assert read_rows(group, ROWS) == ()


def test_every_dataset_has_unit_meaning_and_scales(path):
    with h5py.File(path) as file:
        for name, item in file["record"].items():
            assert {"units", "long_name"} <= set(item.attrs), name
            assert item.dtype != bool
        assert [file["record/surface"].dims[i][0].name for i in (0, 1)] == ["/record/name", "/record/column"]
        assert file["record/yes"].attrs["flag_meanings"] == "no yes"
        assert file["record/origin"].attrs["flag_values"].tolist() == [1, 2]
        assert file["record"].attrs["held"] == 1


def replaced(path, name, values):
    with changing(path, path) as file:
        del file[name]
        if values is not None:
            file[name] = values


@pytest.mark.parametrize(
    ("name", "values", "reason"),
    [
        ("record/size", None, "size"),
        ("record/size", np.nan, "not finite"),
        ("record/size", "many", "expected numbers"),
        ("record/size", [1.0], "shape"),
        ("record/count", 2.5, "fractions"),
        ("record/yes", np.int8(2), "other values than 0, 1"),
        ("record/origin", np.array([0, 1], np.int8), "other values than 1, 2"),
        ("record/where", np.zeros(3, np.int8), "shape"),
        ("record/surface", np.zeros((3, 2)), "shape"),
        ("record/name", np.zeros(2), "string"),
        ("record/end", np.arange(3, dtype=np.int8), "shape"),
        ("rows/share", np.zeros(3), "shape"),
        ("rows/share", np.array([0.5, np.inf]), "not finite"),
    ],
)  # fmt: skip
def test_what_is_not_as_declared_is_refused_with_the_remedy(path, name, values, reason):
    replaced(path, name, values)
    with pytest.raises(DataError, match=rf"damaged some file.*{reason}.*make it again"):
        read_both(path)


def test_a_pair_of_three_is_refused(path):
    replaced(path, "record/end", np.arange(3, dtype=np.int8))
    replaced(path, "record/range", np.zeros(3))
    with pytest.raises(DataError, match="3 values, expected 2"):
        read_both(path)


@pytest.mark.parametrize(("name", "value"), [("tables", "[1]"), ("tables", '{"a": "x"}'), ("held", 2), ("title", 1.5)])
def test_an_attribute_of_another_kind_is_refused(path, name, value):
    with changing(path, path) as file:
        file["record"].attrs[name] = value
    with pytest.raises(DataError, match=f"attribute '{name}'.*make it again"):
        read_both(path)
