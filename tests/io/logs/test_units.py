"""Units as measurement systems write them."""

from contextlib import suppress

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lpvobs.io.logs.units import convert

ONE = np.array([1.0, -2.5, 40.0])

SAME_KIND = {
    ("kPa", "Pa"): 1e3, ("hPa", "Pa"): 1e2, ("mbar", "Pa"): 1e2, ("bar", "Pa"): 1e5, ("MPa", "Pa"): 1e6,
    ("g/s", "kg/s"): 1e-3, ("kg/h", "kg/s"): 1 / 3600, ("kg/min", "kg/s"): 1 / 60, ("mg/s", "kg/s"): 1e-6,
    ("1/min", "rpm"): 1.0, ("min^-1", "rpm"): 1.0, ("U/min", "rpm"): 1.0, ("rad/s", "rpm"): 30 / np.pi,
    ("min-1", "rpm"): 1.0, ("RPM", "rpm"): 1.0, ("U/MIN", "rpm"): 1.0, ("rev/min", "rad/s"): np.pi / 30, ("upm", "rpm"): 1.0,
    ("mg/str", "mg/cycle"): 1.0, ("mg/stk", "mg/cycle"): 1.0, ("mg/ASP", "mg/cycle"): 1.0, ("mg/(stroke)", "mg/cycle"): 1.0,
    ("KG/H", "kg/s"): 1 / 3600, ("kg/hr", "kg/s"): 1 / 3600, ("hpa", "Pa"): 1e2, ("KPa", "Pa"): 1e3, ("mBar", "Pa"): 1e2,
    ("mPa", "Pa"): 1e-3, ("-", "%"): 100.0, ("Sec", "s"): 1.0, ("g/sec", "kg/s"): 1e-3,
    ("rpm", "rad/s"): np.pi / 30, ("1/min", "rad/s"): np.pi / 30, ("krpm", "rad/s"): 1e3 * np.pi / 30,
    ("mg/stroke", "mg/cycle"): 1.0, ("mg/Hub", "mg/cycle"): 1.0, ("mg/hub", "mg/cycle"): 1.0, ("g/cycle", "mg/cycle"): 1e3,
    ("1", "%"): 100.0, ("percent", "%"): 1.0, ("%", "1"): 0.01, ("ms", "s"): 1e-3, ("min", "s"): 60.0, ("us", "s"): 1e-6,
}  # fmt: skip


@pytest.mark.parametrize("pair", SAME_KIND, ids=" to ".join)
def test_factors(pair):
    np.testing.assert_allclose(
        convert(ONE, *pair), SAME_KIND[pair] * ONE, rtol=1e-14
    )  # a factor is rounded at most twice


@pytest.mark.parametrize(
    ("unit", "zero"),
    [
        ("degC", 273.15), ("°C", 273.15), ("Â°C", 273.15), ("Deg C", 273.15), ("grad C", 273.15), ("\ufffdC", 273.15),
        ("degF", 459.67 * 5 / 9),
    ],
)  # fmt: skip
def test_temperatures_have_an_offset(unit, zero):
    factor = 5 / 9 if unit == "degF" else 1.0
    np.testing.assert_allclose(convert(ONE, unit, "K"), zero + factor * ONE, rtol=1e-14)


def test_the_wanted_unit_comes_back_untouched():
    for unit in ("Pa", "mg/cycle", "rpm", "%", "a unit that nobody knows"):
        assert convert(ONE, unit, unit) is ONE


@pytest.mark.parametrize(
    ("unit", "wanted"),
    [
        ("K", "Pa"), ("s", "kg/s"), ("V", "%"), ("furlong?", "K"), ("mg", "mg/cycle"), ("mg/s", "mg/cycle"), ("l/min", "kg/s"),
        ("Hz", "rpm"), ("1/s", "rpm"), ("1/s", "rad/s"), ("Hz", "rad/s"), ("mg/rad", "mg/cycle"), ("mg/rev", "mg/cycle"),
        ("C", "K"), ("rad", "%"), ("cycle/s", "rpm"), ("2 * Pa", "Pa"), ("1e3 Pa", "Pa"), ("", "Pa"), ("Pa", ""),
    ],
)  # fmt: skip
def test_what_cannot_be_converted_says_both_units(unit, wanted):
    with pytest.raises(ValueError, match="cannot be converted") as failure:
        convert(ONE, unit, wanted)
    assert f"'{unit}'" in str(failure.value)
    assert f"'{wanted}'" in str(failure.value)


@pytest.mark.parametrize("unit", ["Hz", "1/s"])
def test_what_may_count_anything_says_so(unit):
    with pytest.raises(ValueError, match=f"'{unit}' cannot be converted to 'rpm': .* may count cycles or strokes"):
        convert(ONE, unit, "rpm")


def test_not_a_number_stays_so():
    np.testing.assert_array_equal(np.isnan(convert(np.array([np.nan, 1.0]), "kPa", "Pa")), [True, False])


@pytest.mark.parametrize(
    "unit", ["(", "kg/(s", "Pa)", "kg//s", "s**", "1/0", "Pa**1e9", "'", "0x", "\\", "[Pa]", "Pa[0]", "%%"]
)
def test_a_unit_with_a_slip_of_the_pen_is_no_fault_of_the_program(unit):
    with pytest.raises(ValueError, match="cannot be converted"):
        convert(ONE, unit, "Pa")


# No digits: a tower of powers would keep any calculator busy.
@given(st.text("kgPasmbr/*^-+.()[]{}%° ", max_size=12))
@settings(max_examples=200)
def test_whatever_stands_in_the_metadata_converts_or_is_a_value_error(unit):
    with suppress(ValueError):
        assert convert(ONE, unit, "Pa").shape == ONE.shape
