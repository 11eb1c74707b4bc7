"""The one check of the paper's own number that anyone can make."""

import numpy as np
import pytest
from reference.hurwitz import is_hurwitz, limit

from lpvobs.engines.diesel.published import PUBLISHED
from lpvobs.errors import NotProven
from lpvobs.synthesis.problem import GainProblem
from lpvobs.synthesis.region import Region
from lpvobs.synthesis.solve import certify_fixed_gain


@pytest.mark.parametrize("column", ["ETC", "FTP75", "NEDC", "hull"])
def test_the_published_gain_is_certified_at_nominal_temperatures(diesel, column):
    gain = certify_fixed_gain(diesel(column), PUBLISHED.L, PUBLISHED.epsilon)
    assert gain.certificate.vertices == 32
    assert (gain.eps_1, gain.eps_2) == PUBLISHED.epsilon
    np.testing.assert_array_equal(gain.L, PUBLISHED.L)


@pytest.mark.parametrize("V_em", [1.7e-3, 2e-3, 3e-3])
def test_it_is_not_for_larger_exhaust_manifolds(diesel, V_em):
    with pytest.raises(NotProven):
        certify_fixed_gain(diesel("ETC", V_em=V_em), PUBLISHED.L, PUBLISHED.epsilon)


@pytest.mark.parametrize("column", ["ETC", "FTP75", "NEDC"])
def test_it_is_certified_nowhere_once_temperatures_move(diesel, column):
    problem = diesel(column, (280.0, 400.0), (400.0, 1100.0))
    assert not is_hurwitz(problem, PUBLISHED.L)
    with pytest.raises(NotProven):
        certify_fixed_gain(problem, PUBLISHED.L, PUBLISHED.epsilon)


def at_ratio(diesel, moved):
    """The ETC column with a_1/a_2 at a given ratio, moving one of them and keeping the other at its nominal value."""
    nominal = diesel("ETC")
    a_1, a_2 = nominal.region.lower[5:]

    def problem(ratio):
        pair = (ratio * a_2, a_2) if moved == "a_1" else (a_1, a_1 / ratio)
        bounds = (nominal.region.lower[:5] + pair, nominal.region.upper[:5] + pair)
        return GainProblem(nominal.system, Region(nominal.region.names, *bounds), 2)

    return problem, a_1 / a_2


@pytest.mark.parametrize("moved", ["a_1", "a_2"])
def test_it_is_hurwitz_only_for_a_narrow_range_of_a_1_over_a_2(diesel, moved):
    problem, nominal = at_ratio(diesel, moved)
    low, high = (limit(problem, PUBLISHED.L, nominal, far * nominal) for far in (0.01, 100.0))
    # 0.065 and 0.139 as known, to their last digit: which of a_1, a_2 moves shifts the lower end by one unit of it.
    assert low == pytest.approx(0.065, abs=1.5e-3)
    assert high == pytest.approx(0.139, abs=5e-4)


def test_table_1_is_as_printed():
    """The paper's page, in its units of 1e-7 (rho_5: one), but for the lower bound 146 of FTP75 that stands above the upper one."""
    printed = {
        "ETC": "19 150  -1.65 1.6  1.09 6.4  0.61 6.01  0 3.15",
        "FTP75": "46 110  -0.56 1.15  1.18 6  0.75 5.4  0 2.78",
        "NEDC": "49 130  -0.003 1.0  1.1 5.4  0.62 4.7  0 2.67",
    }
    assert list(PUBLISHED.bounds) == list(printed)
    for column, row in printed.items():
        expected = np.array(row.split(), dtype=float).reshape(5, 2)
        units = np.array([[1e-7]] * 4 + [[1.0]])
        # a product with 1e-7 rounds once, a literal with its exponent does, too
        np.testing.assert_allclose(PUBLISHED.bounds[column], expected * units, rtol=1e-15)
        assert (expected[:, 0] < expected[:, 1]).all()


def test_the_hull_is_the_etc_column_which_holds_the_others():
    for column in PUBLISHED.bounds.values():
        for (low, high), (hull_low, hull_high) in zip(column, PUBLISHED.bounds["ETC"], strict=True):
            assert hull_low <= low <= high <= hull_high


def test_the_published_gain_is_as_printed():
    """Eq. (38) and what stands before it, digit by digit."""
    assert PUBLISHED.L.tolist() == [
        [float("1635.83"), -float("124.95"), float("6.52e-7")],
        [-float("16063.4"), float("3135.43"), float("1.67e-7")],
        [float("4.2"), float("29.7"), float("4.55e-20")],
    ]
    assert PUBLISHED.epsilon == (0.25, 0.11)
    assert PUBLISHED.outputs == ("p_im", "omega_t")
