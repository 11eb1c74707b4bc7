"""What the settings of a gain take, to the edge, and what they refuse."""

from dataclasses import replace

import numpy as np
import pytest

from lpvobs.synthesis.region import GainSettings

GOOD = GainSettings(outputs=("p_im",), bounds={"rho": (-1.0, 2.0)}, temperatures={"T_im": (250.0, 400.0)})


def test_defaults_ask_for_what_the_default_method_needs():
    assert (GOOD.margin, GOOD.decay, GOOD.nonnegative_sums) == (0.05, 0.0, ())
    assert GOOD.cascade


@pytest.mark.parametrize(
    ("name", "good", "bad"),
    [
        ("margin", (0.0, 0.5, 1.0), (-5e-324, np.nextafter(1.0, 2.0), float("nan"))),
        ("decay", (0.0, 1.0, np.nextafter(1e6, 0.0)), (-5e-324, 1e6, float("nan"))),
    ],
)
def test_edges_of_numbers(name, good, bad):
    for value in good:
        assert getattr(replace(GOOD, **{name: value}), name) == value
    for value in bad:
        with pytest.raises(ValueError, match=name):
            replace(GOOD, **{name: value})


@pytest.mark.parametrize("name", ["bounds", "temperatures"])
@pytest.mark.parametrize("ends", [(2.0, 1.0), (-np.inf, 1.0), (1.0, np.inf), (np.nan, 1.0), (1.0, np.nan)])
def test_ranges_are_finite_and_in_order(name, ends):
    assert replace(GOOD, **{name: {"x": (1.0, 1.0)}})  # a point is a range
    with pytest.raises(ValueError, match="bounds of x"):
        replace(GOOD, **{name: {"x": ends}})


def test_temperatures_are_above_zero_and_parameters_need_not_be():
    assert replace(GOOD, bounds={"rho": (-5.0, 0.0)}, temperatures={"T_em": (5e-324, 1.0)})
    for low in (0.0, -1.0):
        with pytest.raises(ValueError, match="above 0 K"):
            replace(GOOD, temperatures={"T_em": (low, 300.0)})
