"""Windows and the solution against a slow and obvious twin, and what noise on both sides does."""

from functools import partial
from itertools import pairwise

import numpy as np
import pytest
from reference.membership import psi

from lpvobs.engines.curves import Nodes, Points
from lpvobs.engines.unknowns import Component, Correction, Unknowns, unknowns_of
from lpvobs.maps.grid import Grid
from lpvobs.observer import windows
from lpvobs.observer.equations import LEAST_ERROR, mean_flow
from lpvobs.observer.information import considered, solve
from lpvobs.observer.prior import STAYS, Prior, prior_of
from lpvobs.observer.windows import GROUP, LEAST_STAY, LENGTH, Columns, Slopes, Windows

GRID = Grid(np.array([0.0, 4.0, 10.0]), np.array([500.0, 1000.0, 2000.0]))
LAYOUT = Columns(nodes=9, unknowns=2, balances=2)
P = LAYOUT.nodes
SLOPES = np.array([[[1.0, 0.0], [0.5, 0.2]], [[0.3, -1.0], [0.0, 1.0]]])
"""Of each balance by each unknown, for each of two signals."""
THETA = 0.01 * np.sin(np.arange(9.0))
UNKNOWNS = unknowns_of({"a": 0.5, "b": 0.5}, ())
ALIKE = prior_of(GRID, 0.1, UNKNOWNS).alike
PRIOR = Prior(0.1, UNKNOWNS, ALIKE)


def slopes(stay, means, noise=0.0, even=False):
    """Return slopes that are linear in two signals, weights that follow one of them, and a correction that follows the other.

    Signals have noise of a standard deviation, 100 samples a second; a flow of one and one is computed from them.
    """
    J = np.einsum("ns,bqs->nbq", means, SLOPES)
    trust = np.stack([np.ones(len(means)) if even else 1.0 / (1.0 + means[:, 0] ** 2), np.ones(len(means))], axis=1)
    moved = noise * np.sqrt(0.01 / stay)[:, None, None] * SLOPES.transpose(2, 0, 1)[:, None]
    signs = np.stack([np.ones(len(means)), np.where(np.floor(1e3 * means[:, 0]) % 2 == 0, 1.0, -1.0)])[:, :, None, None]
    dJ = (signs * moved).sum(axis=0)
    return Slopes(
        np.arange(2),
        J,
        0.1 * means[:, 0],
        noise * 1e-3 * np.sqrt(0.01 / stay),
        trust,
        1e-3 * np.stack([means[:, 1], 0.0 * means[:, 1]], axis=1),
        (dJ, -dJ.sum(axis=-1)),
    )


def drive(seed, beta=(0.0, 0.0), seconds=60.0, noise=0.0, own=0.0):
    """Return time, steps, operating point, z (2, N) and noisy signals (2, N) of a log with a gap."""
    rng = np.random.default_rng(seed)
    time = np.cumsum(rng.uniform(0.008, 0.012, int(100 * seconds)))
    time[time.size // 2 :] += 30.0
    u, n = 5.0 + 4.9 * np.sin(0.7 * time), 1250.0 + 740.0 * np.cos(0.45 * time)
    signals = np.stack([1.0 + 0.8 * np.sin(0.9 * time), 0.5 + np.cos(1.3 * time)])
    flow = np.einsum("sn,bqs,q->bn", signals, SLOPES, beta)
    map_part = np.array([psi(GRID.fuel, GRID.speed, *at) for at in zip(u, n, strict=True)]) @ THETA
    z = map_part + flow + own * rng.standard_normal((2, time.size))
    z[0] -= 1e-3 * signals[1]
    noisy = signals + noise * rng.standard_normal(signals.shape)
    steps = np.diff(time, prepend=time[0])
    steps[time.size // 2] = 0.0
    # A flow that is computed from noisy signals has their noise, just as its slopes have.
    z -= np.einsum("sn,bqs,q->bn", noisy - signals, SLOPES, (1.0, 1.0))
    return time, steps, (u, n), z, noisy


def summed(log, cuts=(), noise=0.0, even=False):
    """Return the sums over windows of a log in pieces."""
    time, steps, point, z, signals = log
    found = Windows(GRID, LAYOUT, partial(slopes, noise=noise, even=even))
    for own in (slice(*cut) for cut in pairwise((0, *cuts, time.size))):
        part = tuple(axis[own] for axis in point)
        found.add(time[own], steps[own], part, z[:, own], np.ascontiguousarray(signals[:, own]))
    return found.moments()


def twin(log, noise):
    """Return products, those of sums over groups, and number of windows: one dense row a window and a balance, in plain loops."""
    time, steps, (u, n), z, signals = log
    window = np.floor((time - time[0]) / LENGTH).astype(int)
    rows, groups, taken = [], {}, 0.0
    for number in np.unique(window):
        own = np.flatnonzero(window == number)
        stay = steps[own].sum()
        if stay < LEAST_STAY:
            continue
        share = steps[own] / stay
        Psi = share @ np.array([psi(GRID.fuel, GRID.speed, u[k], n[k]) for k in own])
        terms = share @ windows.scaled_terms(GRID, u[own], n[own])
        found = slopes(np.array([stay]), (signals[:, own] @ share)[None], noise)
        J, trust, bias = found.J, found.weight, found.correction
        means = z[:, own] @ share
        row = np.array(
            [
                np.concatenate(
                    (
                        Psi,
                        J[0, b],
                        found.reading ** [1, 2],
                        [means[b] + bias[0, b]],
                        terms,
                        found.reading - means[b] - bias[0, b],
                    )
                )
                * np.sqrt(stay * trust[0, b])
                for b in range(2)
            ]
        )
        rows.append(row)
        dJ, dz = found.shaken
        moved = np.zeros_like(row)
        moved[:, 9:11], moved[:, LAYOUT.z] = dJ[0], dz[0]
        moved *= np.sqrt(stay) * trust[0][:, None]
        sensor = np.zeros_like(row)
        sensor[:, 11:14] = found.noise * np.array([1.0, 2.0 * found.reading[0], 1.0])
        sensor *= np.sqrt(stay * trust[0])[:, None]
        both = np.einsum("ai,bj->abij", moved, moved) + np.einsum("ai,bj->abij", sensor, sensor)
        both[:, :, : LAYOUT.z, : LAYOUT.z] = 0.0
        both[:, :, LAYOUT.z, LAYOUT.z] = 0.0
        taken = taken + both
        groups[number // GROUP] = groups.get(number // GROUP, 0.0) + row
    products = sum(np.einsum("ai,bj->abij", row, row) for row in rows)
    slow = sum(np.einsum("ai,bj->abij", row, row) for row in groups.values()) / GROUP
    return products - taken, slow - taken / GROUP, len(rows)


@pytest.mark.slow
def test_sums_are_those_of_dense_rows():
    log = drive(1, (0.02, -0.01), noise=0.05, own=1e-3)
    found = summed(log, noise=0.05)
    products, slow, count = twin(log, 0.05)
    assert count > 200
    assert (found.windows == count).all()
    np.testing.assert_allclose(found.products, products, rtol=0, atol=1e-12 * np.abs(products).max())
    np.testing.assert_allclose(found.slow, slow, rtol=0, atol=1e-12 * np.abs(slow).max())
    # The stay in the cells is that of the drive, but for the samples that stand for none.
    assert found.gram.sum() == pytest.approx(log[1].sum(), rel=0.02)


def test_pieces_have_the_bits_of_the_whole():
    log = drive(2, noise=0.05)
    whole = summed(log)
    for cuts in [(1,), (100, 101, 3000), tuple(range(7, 5990, 13))]:
        parts = summed(log, cuts)
        for name in ("products", "slow", "gram"):
            np.testing.assert_array_equal(getattr(parts, name), getattr(whole, name))


def test_the_solution_is_that_of_dense_least_squares():
    """Given S, the mean is that of stacked rows, whitened, with the prior as further rows."""
    log = drive(3, (0.02, -0.01), own=1e-3)
    moments = summed(log)
    prior = Prior(0.1, UNKNOWNS, ALIKE)
    found = solve(LAYOUT, moments, prior)
    k = LAYOUT.solved
    weight = np.linalg.inv(found.errors.S)
    normal = np.einsum("ab,abij->ij", weight, moments.products)
    assert not found.errors.repeated.any()  # there are none
    deviations = np.concatenate(
        (np.full(9, 0.1), 0.5 / np.sqrt(3.0) * np.ones(2), STAYS * mean_flow(LAYOUT, moments) ** -np.arange(2))
    )
    own = normal[:k, :k] + np.diag(deviations**-2.0)
    # A prior of nearly no slope beside one of 0.1 kg/s: a condition that is known to the map and the engine.
    np.testing.assert_allclose(found.mean[:11], np.linalg.solve(own, normal[:k, LAYOUT.z])[:11], rtol=0, atol=1e-7)
    covariance = np.linalg.inv(own)[:11, :11]
    np.testing.assert_allclose(found.covariance[:11, :11], covariance, rtol=0, atol=1e-5 * covariance.max())
    # Known engine: the map alone.
    noise = np.linalg.inv(own[:9, :9])
    np.testing.assert_allclose(found.noise, noise, rtol=0, atol=1e-9 * noise.max())
    np.testing.assert_allclose(found.response, noise @ normal[:9, 9:11], rtol=0, atol=1e-7)
    # What is left of the sums over groups has the covariance that is stated, but for the freedom that was used up.
    residual = np.concatenate((-found.mean, [1.0]))
    power = np.diag(np.einsum("i,abij,j->ab", residual, moments.slow[:, :, : k + 1, : k + 1], residual))
    least = GROUP * power / moments.windows[0]
    assert (np.diag(found.errors.S) > least).all()
    assert (np.diag(found.errors.S) < 3.0 * least + 2.0 * LEAST_ERROR**2).all()


def test_without_noise_map_and_engine_come_back():
    beta = np.array([0.02, -0.01])
    found = solve(LAYOUT, summed(drive(4, beta)), Prior(0.1, UNKNOWNS, ALIKE))
    # z follows the deviations less the flow of one and one that it is computed from.
    np.testing.assert_allclose(found.mean[9:11], beta, atol=2e-5)
    np.testing.assert_allclose(found.theta, THETA, atol=2e-5)


def test_a_wrong_engine_that_is_ignored_spoils_the_map():
    moments = summed(drive(4, (0.02, -0.01)))
    exact = unknowns_of({"a": 0.0, "b": 0.0}, ())
    found = solve(LAYOUT, moments, Prior(0.1, exact, ALIKE))
    assert np.abs(found.theta - THETA).max() > 5e-3
    kept = considered(solve(LAYOUT, moments, Prior(0.1, UNKNOWNS, ALIKE)), moments, PRIOR)
    assert np.abs(kept.theta - THETA).max() > 5e-3
    # Considered, the tolerance at least is in the interval.
    assert (np.abs(kept.theta - THETA) < 3.0 * np.sqrt(np.diag(kept.covariance[:P, :P]))).all()


@pytest.mark.slow
def test_noise_on_both_sides_is_taken_out():
    """Slopes and z are made of the same noisy signals, as if the engine were off by one: the noise pulls towards that."""
    beta, pulled = np.array([0.05, -0.05]), {}
    logs = [
        drive(10 + seed, beta, noise=1.0, own=1e-3, seconds=200.0) for seed in range(6)
    ]  # signals are of the order of one
    for known in (0.0, 1.0):
        found = np.mean([solve(LAYOUT, summed(log, noise=known, even=True), PRIOR).mean[9:11] for log in logs], axis=0)
        pulled[known] = np.abs(found - beta).max()
    assert pulled[0.0] > 0.02  # measured 0.039: a bias is there to be seen
    # Measured 0.27: products of columns with each other keep their noise, which only damps; without it sums over a short log are
    # no covariance.
    assert pulled[1.0] < 0.35 * pulled[0.0]


@pytest.mark.slow
def test_errors_that_come_back_at_an_operating_point_widen_the_intervals():
    """One balance is off by the same at every visit; without that the factor is near one."""
    log = drive(7, own=1e-3, seconds=600.0)
    time, steps, (u, n), z, signals = log
    wrong = 1e-3 * np.sin(np.arange(9.0) ** 2)
    here = np.array([psi(GRID.fuel, GRID.speed, *at) for at in zip(u, n, strict=True)]) @ wrong
    twisted = (time, steps, (u, n), z + np.stack([here, 0.0 * here]), signals)
    clean, found = (solve(LAYOUT, summed(each), PRIOR) for each in (log, twisted))
    error = np.sqrt(np.diag(found.covariance[:P, :P]))
    assert np.median(error / np.sqrt(np.diag(clean.covariance[:P, :P]))) > 2.0
    assert np.mean(np.abs(found.theta - THETA) < 1.645 * error) > 0.75
    assert np.mean(np.abs(clean.theta - THETA) < 1.645 * np.sqrt(np.diag(clean.covariance[:P, :P]))) > 0.75


@pytest.mark.slow
def test_two_logs_know_an_error_of_both_better():
    logs = [summed(drive(seed, (0.02, -0.01), own=1e-3, seconds=300.0)) for seed in (5, 6)]
    both = windows.Moments(**{name: sums + getattr(logs[1], name) for name, sums in vars(logs[0]).items()})
    prior = Prior(0.1, UNKNOWNS, ALIKE)
    one, two = (np.diag(solve(LAYOUT, moments, prior).covariance)[:11] for moments in (logs[0], both))
    assert np.median(two / one) == pytest.approx(0.5, rel=0.3)  # each finds its own S


def test_no_log_leaves_the_prior():
    found = solve(LAYOUT, windows.no_moments(GRID, LAYOUT), Prior(0.1, UNKNOWNS, ALIKE))
    np.testing.assert_array_equal(found.mean, 0.0)
    np.testing.assert_allclose(np.diag(found.covariance)[:11], [0.01] * 9 + [0.25 / 3.0] * 2, rtol=1e-6)


def test_a_correction_moves_a_flow_by_its_share_at_the_nodes():
    nodes = Nodes(np.array([0.0, 1.0, 3.0]), "1", "input")
    component = Component("f", "1", "", 0.04, "f", {"x": nodes}, (2.0,))
    found = Correction(1, np.array([2.0, 5.0]), Points((nodes.values,), (np.array([0.25, 2.0]),))).columns(
        component.size
    )
    np.testing.assert_allclose(found, [[1.5, 0.5, 0.0], [0.0, 2.5, 2.5]])
    np.testing.assert_allclose(Correction(0, np.array([2.0, 5.0])).columns(1), [[2.0], [5.0]])


def test_unknowns_are_placed_named_and_scaled():
    nodes = Nodes(np.array([0.0, 1.0]), "1", "input")
    components = (Component("f", "1", "", 0.04, "f", {"x": nodes}, (2.0,)), Component("g", "s", "", 2.0))
    found: Unknowns = unknowns_of({"a": 0.03}, components).seen_from({"a": 0.01})
    assert found.names == ("a", "f[0]", "f[1]", "g")
    assert found.places() == {"f": slice(1, 3), "g": slice(3, 4)}
    assert found.groups() == ("f",)
    assert found.mean == pytest.approx([1.0 / 1.01 - 1.0, 0.0, 0.0, 0.0])
    near = (1.0 + np.sqrt(3.0) / 2.0) * np.exp(-np.sqrt(3.0) / 2.0)  # Matern 3/2 at half its length
    expected = np.zeros((4, 4))
    expected[0, 0], expected[3, 3] = 0.03**2 / 3.0, 4.0
    expected[1:3, 1:3] = 0.04**2 * np.array([[1.0, near], [near, 1.0]])
    np.testing.assert_allclose(found.covariance, expected)
    expected[1:3, 1:3] *= 9.0
    np.testing.assert_allclose(found.scaled((3.0,)), expected)
