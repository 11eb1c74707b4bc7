"""Bench tables: CSV and Parquet, units, and what is refused with one line."""

import csv

import numpy as np
import pytest

from lpvobs.calibration.bench import DEVIATION, REFERENCE
from lpvobs.errors import DataError
from lpvobs.io.logs.bench import read_bench, write_table


@pytest.fixture(scope="module")
def lines(other_engine):
    with other_engine.bench.open(newline="", encoding="utf-8") as stream:
        return list(csv.reader(stream))


@pytest.fixture
def changed(lines, tmp_path):
    """Return a function that writes the table after a change of its header, units and columns of numbers."""

    def write(change):
        names, units, *rows = [list(line) for line in lines]
        columns = {
            name: np.array(column, dtype=float) for name, column in zip(names, zip(*rows, strict=True), strict=True)
        }
        unit_of = dict(zip(names, units, strict=True))
        columns = change(columns, unit_of) or columns
        path = tmp_path / "table.csv"
        write_table(path, columns, unit_of)
        return path

    return write


def test_other_units_read_the_same(changed, other_engine, air_path):
    def kilopascal(columns, units):
        columns["p_im"] = columns["p_im"] / 1e3
        columns["W_reference"] = columns["W_reference"] * 3600.0
        units |= {"p_im": "kPa", "W_reference": "kg/h"}

    plain, other = read_bench([other_engine.bench], air_path), read_bench([changed(kilopascal)], air_path)
    for name in plain:
        np.testing.assert_allclose(plain[name], other[name], rtol=1e-12)


def test_parquet_holds_the_same(lines, other_engine, air_path, tmp_path):
    names, units, *rows = lines
    columns = {name: np.array(column, dtype=float) for name, column in zip(names, zip(*rows, strict=True), strict=True)}
    write_table(tmp_path / "bench.parquet", columns, dict(zip(names, units, strict=True)))
    one, other = read_bench([other_engine.bench], air_path), read_bench([tmp_path / "bench.parquet"], air_path)
    for name in one:
        np.testing.assert_array_equal(one[name], other[name])


def test_tables_are_joined_and_need_not_have_the_same_references(changed, other_engine, air_path):
    def without(columns, units):
        return {name: column for name, column in columns.items() if name not in ("W_egr_reference", DEVIATION, "W_f")}

    both = read_bench([other_engine.bench, changed(without)], air_path)
    assert both[REFERENCE].size == 80
    assert np.isnan(both["W_egr_reference"][40:]).all()
    np.testing.assert_allclose(both[DEVIATION][40:], 0.0035 * both[REFERENCE][40:])


def lacking(columns, units):
    del columns["p_em"]


def unit_of_a_temperature(columns, units):
    units["p_im"] = "K"


def no_units(columns, units):
    units["n_e"] = "1500"


def kilopascal_called_pascal(columns, units):
    columns["p_im"] /= 1e3


def flow_in_kilograms_an_hour(columns, units):
    columns["W_reference"] *= 3.6


def too_little_air_for_the_fuel(columns, units):
    columns["W_f"] *= 10.0


def a_meter_that_is_off_fuel_and_lambda(columns, units):
    columns["lambda"] = columns["W_reference"] / (1.09 * 14.57 * columns["W_f"])
    units["lambda"] = "1"


def a_hole(columns, units):
    columns["T_em"][6] = np.nan


def negative_error(columns, units):
    columns[DEVIATION][3] = -1e-4


def few(columns, units):
    return {name: column[:19] for name, column in columns.items()}


def one_speed(columns, units):
    columns["n_e"] = 1500.0 + 0.01 * columns["n_e"]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lacking, "channel 'p_em' is missing; expected once, in Pa"),
        (unit_of_a_temperature, "channel 'p_im': unit 'K' cannot be converted to 'Pa'"),
        (no_units, "unit '1500' cannot be converted to 'rpm'"),
        (kilopascal_called_pascal, "p_im has values from .* check the unit"),
        (flow_in_kilograms_an_hour, "W_reference is 3.* times the flow .* check the column's unit"),
        (too_little_air_for_the_fuel, "richer mixtures do not burn"),
        (
            a_meter_that_is_off_fuel_and_lambda,
            r"W_reference differs by \+9.0 % from the air flow that W_f and lambda give",
        ),
        (a_hole, "T_em has no number at point 7"),
        (negative_error, "sd_W_reference is -0.0001 kg/s at a point, expected more than 0"),
        (few, "19 points in all, expected 20 to 1000"),
        (one_speed, "n_e covers only .* rpm"),
    ],
)
def test_what_would_spoil_a_fit_is_refused(changed, air_path, change, said):
    path = changed(change)
    with pytest.raises(DataError, match=said) as refusal:
        read_bench([path], air_path)
    assert str(path) in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_a_meter_that_agrees_with_fuel_and_lambda_is_taken(changed, air_path):
    def near(columns, units):
        a_meter_that_is_off_fuel_and_lambda(columns, units)
        columns["lambda"] *= 1.06

    assert read_bench([changed(near)], air_path)[REFERENCE].size == 40
