"""One declaration writes a record and refuses, on reading, what is not as declared."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated

import h5py
import numpy as np
import pytest
from numpy.typing import NDArray

from lpvobs.errors import DataError
from lpvobs.io.results.hdf import changing, creating, reading, write_group
from lpvobs.io.results.mapping import read, read_rows, rows, write
from lpvobs.records import Array, Item

ORIGINS = {1: "measured", 2: "guessed"}


@dataclass(frozen=True)
class Inner:
    """A record in another one."""

    word: str
    part: Annotated[float, Item("1", "part")]


@dataclass(frozen=True)
class Row:
    """One of several."""

    name: Annotated[str, Item("1", "row", name="row")]
    share: Annotated[float, Item("1", "share of it", name="amount")]
    pair: Annotated[tuple[float, float], Item("s", "pair", ("end",))]


SEVERAL = (Row("a", 0.25, (1.0, 2.0)), Row("b", 0.75, (3.0, 4.0)))


@dataclass(frozen=True)
class Everything:
    """A field of every kind."""

    title: str
    tables: dict[str, int]
    held: bool
    names: Annotated[tuple[str, ...], Item("1", "name of a row", name="name")]
    count: Annotated[int, Item("1", "how many")]
    size: Annotated[float, Item("kg/s", "a size")]
    onset: Annotated[float | None, Item("s", "when it begins", gaps=True)]
    yes: Annotated[bool, Item("1", "whether it is so")]
    range: Annotated[tuple[float, float], Item("s", "a range", ("end",))]
    surface: Annotated[Array, Item("kg/s", "values", ("name", "share"), gaps=True)]
    where: Annotated[NDArray[np.bool_], Item("1", "where it is so", ("name",))]
    origin: Annotated[NDArray[np.int8], Item("1", "where it comes from", ("name",), meanings=ORIGINS)]
    sizes: Annotated[Mapping[str, float], Item("kg/s", "by name", ("signal",))]
    none: Annotated[Mapping[str, Array], Item("kg/s", "by name", ("log", "end"))]
    beside: Annotated[Inner, Item(name=".")]
    below: Annotated[Inner | None, Item()]
    nothing: Annotated[Inner | None, Item()]
    several: Annotated[tuple[Inner, ...], Item(name="folder/one")]
    lines: Annotated[tuple[Row, ...], Item(axes=("row",))]
    left: Inner


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
    sizes={"x": 1.5, "y": -2.0},
    none={},
    beside=Inner("beside", 1.0),
    below=Inner("below", 2.0),
    nothing=None,
    several=(Inner("first", 3.0), Inner("second", 4.0)),
    lines=SEVERAL,
    left=Inner("not stored", 5.0),
)


@pytest.fixture
def path(tmp_path):
    target = tmp_path / "some.h5"
    with creating(target) as file:
        file.attrs["schema"] = "lpvobs/some/1"
        write(file, "record", RECORD)
        write_group(file, "rows", rows(SEVERAL, "row"))
    return target


def read_both(path):
    with reading(path, "some", "make it again") as file:
        return read(file["record"], Everything, left=RECORD.left), read_rows(file["rows"], Row, "row")


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
        group = write_group(file, "rows", rows((), "row"))
        assert list(group) == []
        assert read_rows(group, Row, "row") == ()


def test_every_dataset_has_unit_meaning_and_scales(path):
    with h5py.File(path) as file:
        datasets = {name: item for name, item in file["record"].items() if isinstance(item, h5py.Dataset)}
        assert len(datasets) > 15
        for name, item in datasets.items():
            assert {"units", "long_name"} <= set(item.attrs), name
            assert item.dtype != bool
        assert [file["record/surface"].dims[i][0].name for i in (0, 1)] == ["/record/name", "/record/share"]
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
        ("record/yes", np.int8(2), "values other than 0, 1"),
        ("record/origin", np.array([0, 1], np.int8), "values other than 1, 2"),
        ("record/where", np.zeros(3, np.int8), "shape"),
        ("record/surface", np.zeros((3, 2)), "shape"),
        ("record/name", np.zeros(2), "string"),
        ("record/end", np.arange(3, dtype=np.int8), "shape"),
        ("rows/amount", np.zeros(3), "shape"),
        ("rows/amount", np.array([0.5, np.inf]), "not finite"),
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
