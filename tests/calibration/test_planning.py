"""Which bench points help most, against the information that all of them add up to, and every choice tried."""

from itertools import pairwise

import numpy as np
import pytest

from lpvobs.calibration.bench import REFERENCE, Rows
from lpvobs.calibration.plan import NEGLIGIBLE, best_points
from lpvobs.engines.unknowns import MeasuredPart

POINTS, UNKNOWNS = 7, 5
KINDS = (
    MeasuredPart("compressor", REFERENCE, 0, {}, 0.01, 0.0),
    MeasuredPart("filling", REFERENCE, 1, {}, 0.01, 0.0),
    MeasuredPart("egr", "W_egr_reference", 1, {"u_egr": 0.0}, 0.02, 0.0),
)
LEFT = {"filling": 0.004}


@pytest.fixture(scope="module")
def rows():
    """Return rows of three kinds; the EGR is measured at the first four points only."""
    rng = np.random.default_rng(7)
    of = np.repeat([0, 1, 2], [POINTS, POINTS, 4])
    point = np.concatenate([np.arange(POINTS), np.arange(POINTS), np.arange(4)])
    flow = 0.02 + 0.01 * point
    J = flow[:, None] * rng.normal(size=(of.size, UNKNOWNS))
    return Rows(KINDS, of, point, flow, 0.0 * flow, 0.01 * flow, np.zeros((of.size, 1)), J)


@pytest.fixture(scope="module")
def covariance():
    root = 0.03 * np.random.default_rng(8).normal(size=(UNKNOWNS, UNKNOWNS))
    return root @ root.T


def informed(rows, covariance, chosen):
    """Return the covariance of the unknowns once some points are measured, in information form."""
    share = np.array([LEFT.get(kind.name, 0.0) for kind in rows.kind])[rows.of]
    on = np.isin(rows.point, chosen)
    weight = 1.0 / (rows.error**2 + (share * rows.reference) ** 2)[on]
    return np.linalg.inv(np.linalg.inv(covariance) + rows.J[on].T @ (weight[:, None] * rows.J[on]))


def uncertainty(rows, covariance):
    """Return the root mean square of the flow's relative error, of the better mixture of both balances."""
    squares = []
    for point in range(POINTS):
        on = (rows.point == point) & (rows.of < 2)
        flow = rows.reference[on][0]
        S = rows.J[on] @ covariance @ rows.J[on].T
        S += np.diag((np.array([0.0, LEFT["filling"]]) * flow) ** 2 + (NEGLIGIBLE * flow) ** 2)
        shares = np.linalg.solve(S, np.ones(2))
        shares /= shares.sum()
        squares.append(shares @ S @ shares / flow**2)
    return np.sqrt(np.mean(squares))


def test_each_choice_is_the_best_of_all_that_are_left(rows, covariance):
    chosen, told = best_points(rows, covariance, LEFT, 3)
    assert told[0] == pytest.approx(uncertainty(rows, covariance), rel=1e-6)
    for count in (1, 2, 3):
        tried = {
            point: uncertainty(rows, informed(rows, covariance, [*chosen[: count - 1], point]))
            for point in set(range(POINTS)) - set(chosen[: count - 1])
        }
        assert chosen[count - 1] == min(tried, key=tried.get)
        assert told[count] == pytest.approx(min(tried.values()), rel=1e-6)


def test_no_point_is_named_twice_and_each_helps(rows, covariance):
    chosen, told = best_points(rows, covariance, LEFT, 20)
    assert sorted(chosen) == list(range(POINTS))
    assert all(after < before for before, after in pairwise(told))


def test_a_known_engine_needs_no_point(rows, covariance):
    _, told = best_points(rows, 1e-12 * covariance, {}, 2)
    assert told[0] == pytest.approx(told[-1], rel=1e-3)
