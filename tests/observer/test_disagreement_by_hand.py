"""The agreement of logs on a small map, against dense formulas."""

import numpy as np
import pytest

from lpvobs.maps.grid import Grid
from lpvobs.observer import disagreement
from lpvobs.observer.disagreement import agreements
from lpvobs.observer.information import solve
from lpvobs.observer.parts import LogInformation, LogRun, added_up
from lpvobs.observer.settings import EstimateSettings
from lpvobs.records import Defects

GRID = Grid(np.array([0.0, 4.0, 10.0]), np.array([500.0, 1000.0, 2000.0]))
SETTINGS = EstimateSettings(smoothing=0.05, least_information=0.1, prior_map=0.1, tolerance={"R_c": 0.01})
CORNERS = np.array([[0, 1, 3, 4], [1, 2, 4, 5], [3, 4, 6, 7], [4, 5, 7, 8]])
TRUTH = 0.01 * np.sin(np.arange(9.0))
NAMES = "abcde"


def part(name, seed, moved=0.0, scatter=0.0, cells=(0, 1, 2, 3)):
    """Return the part of a log with 60 samples in each cell, a map of its own by `scatter`, and a sensor moved by so much."""
    rng = np.random.default_rng(seed)
    own = TRUTH + scatter * rng.standard_normal(9) + moved
    H, h, coupling = np.zeros((len(cells), 4, 4)), np.zeros((len(cells), 4)), np.zeros((len(cells), 7, 4))
    for place, cell in enumerate(cells):
        eta = rng.random((60, 2))
        psi = np.stack(
            [(1 - eta[:, 0]) * (1 - eta[:, 1]), eta[:, 0] * (1 - eta[:, 1]), (1 - eta[:, 0]) * eta[:, 1], eta.prod(1)],
            1,
        )
        w = 1.0 / 2e-4**2
        z = psi @ own[CORNERS[cell]] + 2e-4 * rng.standard_normal(60)
        H[place], h[place] = w * psi.T @ psi, w * psi.T @ z
        coupling[place, 0] = w * psi.T @ (0.03 * np.ones(60))  # one per cent of the constant moves the flow by 0.3 g/s
    run = LogRun(name, name, 60, 6.0, Defects(60), np.empty(0), np.empty(0), 1.0)
    return LogInformation(run, np.array(cells), H / w, H, h, coupling)


def found(parts):
    common = solve(added_up(GRID, 1, parts)[0], SETTINGS.prior_map)
    scatter, verdicts = agreements(GRID, common, parts, SETTINGS)
    return common, scatter, verdicts


def dense(log, common):
    """Return own map less common map, and its covariance without the scatter between logs, node by node."""
    H, h, g = np.eye(9) / SETTINGS.prior_map**2, np.zeros(9), np.zeros(9)
    for cell, H_c, h_c, g_c in zip(log.cells, log.H, log.h, log.coupling[:, 0], strict=True):
        nodes = CORNERS[cell]
        H[np.ix_(nodes, nodes)] += H_c
        h[nodes] += h_c
        g[nodes] += g_c
    own = np.linalg.inv(H)
    answer = own @ g - common.response[:, 0]
    return own @ h - common.theta, own - common.noise + 0.01**2 / 3 * np.outer(answer, answer)


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
    moved.h[0] += moved.H[0] @ there
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
    for values in (parts[0].H, parts[0].h, parts[0].coupling):
        values[3] *= 1e-5  # node 8, in no other cell, is known to some 0.03 kg/s: no better than 1 % of the prior
    assert [verdict.nodes for verdict in found(parts)[2]] == [8, 9, 9, 9, 9]


def test_spread_by_hand():
    values, least = np.array([0.0, 1.0, 2.0, 10.0, np.nan]), np.ones(5)
    # Median 1.5; distances 1.5, 0.5, 0.5, 8.5 with the median 1.
    expected = np.array([-1.5, -0.5, 0.5, 8.5, np.nan]) / 1.4826
    np.testing.assert_allclose(disagreement._beyond(values, least), expected, rtol=1e-15)
    np.testing.assert_allclose(disagreement._beyond(values, 10.0 * least), 0.14826 * expected, rtol=1e-15)
    assert np.isnan(disagreement._beyond(np.full(2, np.nan), least[:2])).all()
