"""The errors of the balances, from sums of products that noise has been taken out of."""

import numpy as np
import pytest

from lpvobs.engines.unknowns import unknowns_of
from lpvobs.observer.information import Prior, _without_brief, solve
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
    found = solve(LAYOUT, moments(taken), Prior(0.1, unknowns_of({}, ()), (1e-9, 1e-9)))
    assert np.linalg.eigvalsh(found.errors)[0] > 0.0
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
