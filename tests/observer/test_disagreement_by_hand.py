"""The agreement of logs on a small map, against dense formulas."""

import numpy as np
import pytest

from lpvobs.engines.unknowns import unknowns_of
from lpvobs.maps.grid import Grid
from lpvobs.observer import disagreement
from lpvobs.observer.disagreement import agreements, difference
from lpvobs.observer.equations import Equations, Errors
from lpvobs.observer.information import Solution
from lpvobs.observer.log_run import LogRun
from lpvobs.observer.parts import LogInformation, added_up
from lpvobs.observer.prior import Prior, Scales
from lpvobs.observer.windows import Columns
from lpvobs.records import Defects

GRID = Grid(np.array([0.0, 4.0, 10.0]), np.array([500.0, 1000.0, 2000.0]))
LAYOUT = Columns(nodes=9, unknowns=1, balances=1)
UNKNOWNS = unknowns_of({"R_c": 0.01}, ())
PRIOR, ERROR = 0.1, 2e-4
CORNERS = np.array([[0, 1, 3, 4], [1, 2, 4, 5], [3, 4, 6, 7], [4, 5, 7, 8]])
TRUTH = 0.01 * np.sin(np.arange(9.0))
NAMES = "abcde"


def part(name, seed, moved=0.0, scatter=0.0, cells=(0, 1, 2, 3), hardly=()):
    """Return the part of a log with 60 samples in each cell, a map of its own by `scatter`, and a sensor moved by so much.

    Of cells in `hardly` it knows next to nothing.
    """
    rng = np.random.default_rng(seed)
    own = TRUTH + scatter * rng.standard_normal(9) + moved
    products = np.zeros((LAYOUT.size, LAYOUT.size))
    for cell in cells:
        eta = rng.random((60, 2))
        psi = np.stack(
            [(1 - eta[:, 0]) * (1 - eta[:, 1]), eta[:, 0] * (1 - eta[:, 1]), (1 - eta[:, 0]) * eta[:, 1], eta.prod(1)],
            1,
        )
        rows = np.zeros((60, LAYOUT.size))
        rows[:, CORNERS[cell]] = psi
        rows[:, 9] = 0.03  # one per cent of the constant moves the flow by 0.3 g/s
        rows[:, LAYOUT.z] = psi @ own[CORNERS[cell]] + ERROR * rng.standard_normal(60)
        products += (1e-5 if cell in hardly else 1.0) * rows.T @ rows
    columns = np.flatnonzero(products.any(axis=0))
    run = LogRun(name, name, 60, 6.0, Defects(60), np.empty(0), np.empty(0), 1.0)
    gram = np.zeros((len(cells), 4, 4))
    inner = products[np.ix_(columns, columns)][None, None]
    return LogInformation(run, columns, inner, np.zeros((1, 1)), np.array([60.0 * len(cells)]), np.array(cells), gram)


def found(parts):
    """Return the common map at errors that are known, the engine as configured, and every log's agreement with it."""
    total, _ = added_up(GRID, LAYOUT, parts)
    state = Equations(LAYOUT, total, Prior(PRIOR, UNKNOWNS, np.eye(9)))
    S = np.array([[ERROR**2]])
    errors = Errors(S, np.zeros(1))
    mean, covariance = np.zeros(LAYOUT.solved), np.diag([0.0] * 9 + [0.01**2 / 3, 0.0])
    free = state.without_map(errors)
    noise, design = free.N, free.N @ free.A[:9, LAYOUT.terms]
    mean[:9] = noise @ free.A[:9, LAYOUT.z]
    common = Solution(
        LAYOUT, mean, covariance, noise, free.answers[:, :1], design, errors, S, noise, Scales(()), stiff=mean
    )
    scatter, verdicts = agreements([difference(common, part, PRIOR) for part in parts])
    return common, scatter, verdicts


def dense(log, common):
    """Return own map less common map, and its covariance without the scatter between logs, node by node."""
    full = np.zeros((LAYOUT.size, LAYOUT.size))
    full[np.ix_(log.columns, log.columns)] = log.products[0, 0] / ERROR**2
    own = np.linalg.inv(full[:9, :9] + np.eye(9) / PRIOR**2)
    answer = own @ full[:9, 9] - common.response[:, 0]
    away = own @ full[:9, LAYOUT.z] - common.theta
    return away, own - common.noise + 0.01**2 / 3 * np.outer(answer, answer)


def test_sums_of_logs_that_know_other_cells_add_up():
    parts = [part("a", 1, cells=(0, 1)), part("b", 2, cells=(1, 3)), part("c", 3)]
    whole, windows, gram = np.zeros((LAYOUT.size, LAYOUT.size)), np.zeros(1), np.zeros((4, 4, 4))
    for log in parts:
        whole[np.ix_(log.columns, log.columns)] += log.products[0, 0]
        windows += log.windows
        gram[log.cells] += log.gram
    total, _ = added_up(GRID, LAYOUT, parts)
    assert not np.array_equal(parts[0].columns, parts[1].columns)
    np.testing.assert_array_equal(total.products[0, 0], whole)
    np.testing.assert_array_equal(total.windows, windows)
    np.testing.assert_array_equal(total.gram, gram)


@pytest.mark.parametrize("scatter", [0.0, 5e-4])
def test_differences_and_chi_square_are_the_dense_ones(scatter):
    parts = [part(name, seed, scatter=scatter) for seed, name in enumerate(NAMES)]
    common, between, verdicts = found(parts)
    ratios = []
    for log, verdict in zip(parts, verdicts, strict=True):
        away, covariance = dense(log, common)
        assert (verdict.name, verdict.nodes) == (log.run.name, 9)
        # Differences of maps that agree to four digits, from inverses of condition 1e6.
        assert verdict.mean_difference == pytest.approx(away.mean(), rel=1e-6, abs=1e-12)
        chi_square = away @ np.linalg.solve(covariance + between**2 * np.eye(9), away)
        assert verdict.chi_square == pytest.approx(chi_square, rel=1e-6)
        ratios.append(chi_square / 9)
    if scatter:
        assert np.median(ratios) == pytest.approx(1.0, rel=1e-6)  # what the scatter is chosen by
        assert between == pytest.approx(scatter, rel=0.5)  # five logs of nine nodes know it to about a fifth
    else:
        assert between < 1e-4
        assert np.median(ratios) <= 1.0 + 1e-6
    assert not any(verdict.disagrees for verdict in verdicts)


def test_deviations_are_those_of_the_median_log():
    parts = [part(name, seed, scatter=5e-4) for seed, name in enumerate(NAMES)]
    common, between, verdicts = found(parts)
    differences = [dense(log, common) for log in parts]
    mean = np.array([away.mean() for away, _ in differences])
    errors = np.sqrt([covariance.sum() / 81 + between**2 / 9 for _, covariance in differences])
    height = np.log([verdict.chi_square / 9 for verdict in verdicts])

    def beyond(values, least):
        away = values - np.median(values)
        return away / np.maximum(1.4826 * np.median(np.abs(away)), least)

    expected = np.maximum(beyond(height, 0.75), np.abs(beyond(mean, errors)))
    np.testing.assert_allclose([verdict.deviation for verdict in verdicts], expected, rtol=1e-5)


@pytest.mark.parametrize("moved", [2e-3, -2e-3])
def test_a_sensor_that_has_moved_stands_out_alone(moved):
    parts = [part(name, seed, moved=moved * (name == "d")) for seed, name in enumerate(NAMES)]
    _, _, verdicts = found(parts)
    assert [verdict.name for verdict in verdicts if verdict.disagrees] == ["d"]
    assert verdicts[3].deviation > disagreement.STANDS_OUT
    # Of five logs one moved: the common map goes with it by a fifth.
    assert verdicts[3].mean_difference == pytest.approx(0.8 * moved, rel=0.05)


def test_a_part_of_the_map_that_has_moved_stands_out_by_chi_square():
    # Of nine logs: the common map follows one of them by a ninth, and chi-square of the others by the square of that.
    parts = [part(name, seed, scatter=1e-4) for seed, name in enumerate("abcdefghi")]
    there = np.array([5e-3, -5e-3, 0.0, 0.0])  # nothing on average
    moved = parts[1]
    at, z = np.searchsorted(moved.columns, CORNERS[0]), np.searchsorted(moved.columns, LAYOUT.z)
    eta = np.random.default_rng(1).random((60, 2))  # the samples of its first cell again
    psi = np.stack(
        [(1 - eta[:, 0]) * (1 - eta[:, 1]), eta[:, 0] * (1 - eta[:, 1]), (1 - eta[:, 0]) * eta[:, 1], eta.prod(1)], 1
    )
    moved.products[0, 0, at, z] += psi.T @ psi @ there
    moved.products[0, 0, z, at] = moved.products[0, 0, at, z]
    _, _, verdicts = found(parts)
    assert [verdict.name for verdict in verdicts if verdict.disagrees] == ["b"]


def test_what_only_one_log_knows_is_not_compared():
    both = found([part("a", 1, cells=(0,)), part("b", 2, cells=(0, 3))])[2]
    assert [verdict.nodes for verdict in both] == [4, 7]
    alone = found([part("a", 1)])[2][0]
    assert (alone.nodes, alone.disagrees) == (0, False)
    assert np.isnan([alone.chi_square, alone.mean_difference, alone.deviation]).all()


def test_a_node_that_a_log_hardly_knows_is_not_compared():
    parts = [part(name, seed) for seed, name in enumerate(NAMES)]
    # Node 8, in no other cell, is known to some 0.03 kg/s: no better than 1 % of the prior.
    parts[0] = part(NAMES[0], 0, hardly=(3,))
    assert [verdict.nodes for verdict in found(parts)[2]] == [8, 9, 9, 9, 9]


def test_spread_by_hand():
    values, least = np.array([0.0, 1.0, 2.0, 10.0, np.nan]), np.ones(5)
    # Median 1.5; distances 1.5, 0.5, 0.5, 8.5 with the median 1.
    expected = np.array([-1.5, -0.5, 0.5, 8.5, np.nan]) / 1.4826
    np.testing.assert_allclose(disagreement._beyond(values, least), expected, rtol=1e-15)
    np.testing.assert_allclose(disagreement._beyond(values, 10.0 * least), 0.14826 * expected, rtol=1e-15)
    assert np.isnan(disagreement._beyond(np.full(2, np.nan), least[:2])).all()
