"""The errors of the balances, from sums of products that noise has been taken out of."""

import numpy as np
import pytest

from lpvobs.engines.unknowns import unknowns_of
from lpvobs.observer.information import _without_brief, solve
from lpvobs.observer.prior import Prior
from lpvobs.observer.windows import GROUP, Columns, Moments

LAYOUT = Columns(nodes=3, unknowns=0, balances=2)
P = LAYOUT.nodes


def moments(taken: float) -> Moments:
    """Return sums over ten groups of windows; the second balance has lost so much of its own product over these."""
    n, rng = 10 * GROUP, np.random.default_rng(4)
    rows = np.zeros((2, n, LAYOUT.size))
    Psi = rng.dirichlet(np.ones(2), n)
    for b in range(2):
        rows[b, :, :2] = Psi  # the third node is not visited
        rows[b, :, LAYOUT.z] = Psi @ [2e-3, 3e-3] + 1e-4 * rng.standard_normal(n)
    rows[0, :, LAYOUT.z] += 5e-4 * np.repeat(rng.standard_normal(10), GROUP)  # the first has errors that last
    products = np.einsum("ani,bnj->abij", rows, rows)
    grouped = rows.reshape(2, -1, GROUP, LAYOUT.size).sum(2) / np.sqrt(GROUP)
    slow = np.einsum("ani,bnj->abij", grouped, grouped)
    slow[1, 1, LAYOUT.z, LAYOUT.z] -= taken
    return Moments(products, slow, np.full(2, float(n)), np.zeros((1, 4, 4)))


@pytest.mark.parametrize("taken", [0.0, 3e-7])
def test_errors_have_a_positive_variance_however_much_noise_was_taken_out(taken):
    found = solve(LAYOUT, moments(taken), Prior(0.1, unknowns_of({}, ()), np.eye(P)))
    assert np.linalg.eigvalsh(found.errors.S)[0] > 0.0
    assert np.diag(found.covariance[:P, :P]).min() > 0.0
    assert found.covariance[2, 2] == pytest.approx(0.01)  # nothing is known of it but the prior
    np.testing.assert_allclose(found.theta[:2], [2e-3, 3e-3], atol=5e-4)  # the lasting error


def test_a_balance_that_spoke_for_an_instant_beside_others_is_left_out():
    """One window is absorbed by what is not known of the engine, and an error of nothing would outweigh all others."""
    ones = np.ones((3, 3, 4, 4))
    left = _without_brief(Moments(ones, ones, np.array([600.0, 1.0, 40.0]), np.zeros((1, 4, 4))))
    assert left.windows.tolist() == [600.0, 0.0, 40.0]
    assert not left.products[1].any()
    assert not left.slow[:, 1].any()
    assert left.products[0, 2].all()
    short = Moments(ones, ones, np.array([3.0, 2.0, 1.0]), np.zeros((1, 4, 4)))
    assert _without_brief(short) is short


NODES, VISITS = 40, 30
LASTING = 1e-3  # [kg/s] of every balance, another one at every node


def visited(balances: int, scatter: float, worse: float = 1.0) -> tuple[Columns, Moments, np.ndarray]:
    """Return sums over visits to nodes one at a time, each for a group of windows, and what every balance lacks at each node."""
    layout, rng = Columns(NODES, 0, balances), np.random.default_rng(8)
    lasting = LASTING * rng.standard_normal((balances, NODES))
    lasting[2:] *= worse
    node = np.repeat(rng.permuted(np.repeat(np.arange(NODES), VISITS)), GROUP)
    rows = np.zeros((balances, node.size, layout.size))
    rows[:, np.arange(node.size), node] = 1.0
    own = scatter * np.array([1.0, 10.0, 10.0])[:balances, None]  # the first scatters least
    rows[:, :, layout.z] = lasting[:, node] + own * rng.standard_normal((balances, node.size))
    products = np.einsum("ani,bnj->abij", rows, rows)
    grouped = rows.reshape(balances, -1, GROUP, layout.size).sum(2) / np.sqrt(GROUP)
    slow = np.einsum("ani,bnj->abij", grouped, grouped)
    return layout, Moments(products, slow, np.full(balances, float(node.size)), np.zeros((1, 4, 4))), lasting


def prior(balances: int) -> Prior:
    """Return a prior of nodes that have nothing to do with each other."""
    return Prior(0.1, unknowns_of({}, ()), np.eye(NODES))


def test_balances_that_contradict_each_other_at_every_visit_share_the_map_however_little_one_scatters():
    """The middle of both is off by LASTING / sqrt(2); the balance that scatters least is off by LASTING."""
    layout, sums, lasting = visited(2, 1e-4)
    found = solve(layout, sums, prior(2))
    middle = lasting.mean(axis=0)
    # what windows scatter leaves at a node, 10 x 1e-4 over the root of its windows, and a tenth of the way to either balance
    assert np.abs(found.theta - middle).max() < 0.1 * np.abs(lasting[0] - lasting[1]).max() + 4e-3 / np.sqrt(
        VISITS * GROUP
    )
    held = np.abs(found.theta) <= 1.645 * np.sqrt(np.diag(found.covariance)[:NODES])
    assert 0.75 <= held.mean() <= 1.0  # 90 % of 40, less three standard deviations


def test_a_balance_that_two_others_contradict_is_charged_with_more_than_they_are():
    layout, sums, _ = visited(3, 1e-4, worse=5.0)
    variances = solve(layout, sums, prior(3)).errors.repeated ** 2
    assert variances[2] > 4.0 * variances[:2].max()  # 13 of 1 by the variances: (1 + 25) / 2 to (1 + 1) / 2


def test_balances_that_agree_but_for_scatter_have_the_weights_of_their_scatter():
    layout, sums, lasting = visited(2, 1e-4)
    errors = solve(layout, _without(sums, lasting, layout), prior(2)).errors
    ratio = errors.S[1, 1] / errors.S[0, 0]
    assert 50.0 < ratio < 200.0  # 100 by the variances, of which each is known to a tenth


def _without(sums: Moments, lasting: np.ndarray, layout: Columns) -> Moments:
    """Return the sums of the same rows without what the balances lack: z less Psi lasting."""
    found = []
    for total in (sums.products, sums.slow):
        onto = np.tile(np.eye(layout.size), (layout.balances, 1, 1))
        onto[:, :NODES, layout.z] = -lasting
        found.append(np.einsum("aki,abkl,blj->abij", onto, total, onto))
    return Moments(found[0], found[1], sums.windows, sums.gram)


def test_errors_that_repeat_are_unknowns_of_their_own():
    """The same as a dense solution with a column for what each balance repeats at each node."""
    layout, sums, _ = visited(2, 1e-3)
    near = np.exp(-np.abs(np.subtract.outer(np.arange(NODES), np.arange(NODES))) / 3.0)
    found = solve(layout, sums, Prior(0.1, unknowns_of({}, ()), near))
    size, p, weights = layout.size, NODES, np.linalg.inv(found.errors.S)
    onto = np.zeros((2, size, size + 2 * p))  # the rows of both balances, d_0 and d_1 behind them
    onto[:, :, :size] = np.eye(size)
    for b in range(2):
        onto[b, :p, size + b * p : size + (b + 1) * p] = np.eye(p)
    normal = np.einsum("ab,aki,abkl,blj->ij", weights, onto, sums.products, onto)
    apart = np.linalg.inv(near + 1e-9 * np.eye(p))
    for b in range(2):
        own = slice(size + b * p, size + (b + 1) * p)
        normal[own, own] += apart / found.errors.repeated[b] ** 2
    normal[:p, :p] += np.eye(p) / 0.1**2
    solved = np.r_[:p, size : size + 2 * p]
    covariance = np.linalg.inv(normal[np.ix_(solved, solved)])
    dense = covariance @ normal[solved, layout.z]
    # the levels of the day, next to nothing here, are not among these columns
    np.testing.assert_allclose(found.theta, dense[:p], atol=1e-8)
    np.testing.assert_allclose(found.covariance[:p, :p], covariance[:p, :p], atol=1e-6 * covariance.max())


def test_the_size_of_errors_that_repeat_is_found():
    layout, sums, lasting = visited(2, 1e-4)
    repeated = solve(layout, sums, prior(2)).errors.repeated
    # Of 40 nodes the standard deviation is known to a ninth; three times that.
    assert repeated == pytest.approx(np.std(lasting[0] - lasting[1]) / np.sqrt(2.0), rel=0.33)
