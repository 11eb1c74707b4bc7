"""What is said of the error before and after comes from stretches that nothing else has seen."""

from dataclasses import replace

import numpy as np

from lpvobs.discovery.fit import fit
from lpvobs.discovery.held_out import compare, informed
from lpvobs.discovery.map_prior import MapPrior
from lpvobs.discovery.ranking import best_of
from lpvobs.discovery.thresholds import EVERY, GUARD, KNOWN


def test_used_and_judged_instants_are_apart(linear):
    problem = linear.problem
    clock = problem.clock
    gap = np.abs(clock[problem.judged][:, None] - clock[problem.used][None]).min()
    assert gap >= GUARD
    assert problem.used.mean() > 1.0 - 1.5 / EVERY
    assert problem.judged.mean() > 0.1
    assert problem.with_all().used.all()


def test_nothing_that_is_judged_is_seen(laid_out, clean, misread, linear):
    """A sensor that errs in the judged stretches alone changes neither model nor ranking, only the error that is reported."""
    problem = linear.problem
    instants, judged = problem.time, problem.judged
    nearest = np.abs(clean.time[:, None] - instants[None, judged][:, ::7]).min(1)  # every seventh is close enough
    bad = misread(clean, clean["W_maf"] * np.where(nearest < 0.4, 1.2, 1.0))
    other = fit(laid_out(bad))
    np.testing.assert_array_equal(other.theta, linear.theta)
    np.testing.assert_array_equal(other.beta, linear.beta)
    assert [c.gain for c in best_of(other)] == [c.gain for c in best_of(linear)]
    assert compare(other, other).comparison().before > 2.0 * compare(linear, linear).comparison().before


def test_a_nominal_map_counts_where_it_is_known(linear):
    """Without any data, an instant counts where all nodes that it reads were known before."""
    p = linear.p
    error = np.where(np.arange(p) < p // 2, 0.5 * KNOWN, 0.1)
    prior = MapPrior(np.zeros(p), np.diag(error**-2.0), np.zeros((p, linear.beta.size)), False)
    known = informed(
        replace(linear, problem=replace(linear.problem, prior=prior)), np.zeros(linear.problem.K, dtype=bool)
    )
    nodes, weights = linear.nodes
    expected = np.all((nodes < p // 2) | (weights < 0.02), axis=1)
    np.testing.assert_array_equal(known, expected)
    assert 0 < known.sum() < known.size
