"""The one check of the paper's own number that anyone can make."""

import numpy as np
import pytest

from lpvobs.errors import NotProven, UsageError
from lpvobs.synthesis.gain import hurwitz_at_vertices
from lpvobs.synthesis.problem import Problem
from lpvobs.synthesis.published import EPSILON, TABLE_1, hull, hurwitz_interval, published_gain
from lpvobs.synthesis.region import Region
from lpvobs.synthesis.solve import certify_fixed_gain


@pytest.mark.parametrize("column", ["ETC", "FTP75", "NEDC", "hull"])
def test_the_published_gain_is_certified_at_nominal_temperatures(diesel, column):
    gain = certify_fixed_gain(diesel(column), published_gain(), EPSILON)
    assert gain.certificate.vertices == 32
    assert gain.certificate.falling_gain  # 1 - 0.25 - 0.11 = 0.64
    assert (gain.eps_1, gain.eps_2) == EPSILON
    np.testing.assert_array_equal(gain.L, published_gain())


@pytest.mark.parametrize("V_em", [1.7e-3, 2e-3, 3e-3])
def test_it_is_not_for_larger_exhaust_manifolds(diesel, V_em):
    with pytest.raises(NotProven):
        certify_fixed_gain(diesel("ETC", V_em=V_em), published_gain(), EPSILON)


@pytest.mark.parametrize("column", ["ETC", "FTP75", "NEDC"])
def test_it_is_certified_nowhere_once_temperatures_move(diesel, column):
    problem = diesel(column, (280.0, 400.0), (400.0, 1100.0))
    assert not hurwitz_at_vertices(problem, published_gain())
    with pytest.raises(NotProven):
        certify_fixed_gain(problem, published_gain(), EPSILON)


def at_ratio(diesel, moved):
    """The ETC column with a_1/a_2 at a given ratio, moving one of them and keeping the other at its nominal value."""
    nominal = diesel("ETC")
    a_1, a_2 = nominal.region.lower[5:]

    def problem(ratio):
        pair = (ratio * a_2, a_2) if moved == "a_1" else (a_1, a_1 / ratio)
        bounds = (nominal.region.lower[:5] + pair, nominal.region.upper[:5] + pair)
        return Problem(nominal.system, Region(nominal.region.names, *bounds), 2)

    return problem, a_1 / a_2


@pytest.mark.parametrize("moved", ["a_1", "a_2"])
def test_it_is_hurwitz_only_for_a_narrow_range_of_a_1_over_a_2(diesel, moved):
    problem, nominal = at_ratio(diesel, moved)
    low, high = hurwitz_interval(problem, published_gain(), nominal)
    # 0.065 and 0.139 as known, to their last digit: which of a_1, a_2 moves shifts the lower end by one unit of it.
    assert low == pytest.approx(0.065, abs=1.5e-3)
    assert high == pytest.approx(0.139, abs=5e-4)
    # The limits are limits: just inside it is Hurwitz, just outside not.
    assert hurwitz_at_vertices(problem(low * 1.001), published_gain())
    assert not hurwitz_at_vertices(problem(low * 0.999), published_gain())
    assert not hurwitz_at_vertices(problem(high * 1.001), published_gain())


def test_far_inside_there_is_no_limit_to_find_and_far_outside_no_start(diesel):
    problem, nominal = at_ratio(diesel, "a_1")
    assert hurwitz_interval(problem, published_gain(), nominal, reach=1.05) == (nominal / 1.05, nominal * 1.05)
    with pytest.raises(UsageError):
        hurwitz_interval(problem, published_gain(), 1.0)


def test_table_1_is_in_order_and_its_hull_covers_it():
    for column in TABLE_1.values():
        for (low, high), (hull_low, hull_high) in zip(column, hull(), strict=True):
            assert hull_low <= low <= high <= hull_high
