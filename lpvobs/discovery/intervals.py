"""The standard error of an effect's size from noise, model error, the constants' tolerance and the choice of window.

Noise and model error show in how the sums of the size's score vary from stretch to stretch of the drive and from cell to cell of
the map. Where they vary more than noise explains, the larger variance holds (a cluster-robust variance). The constants' tolerance
enters through their prior. Pinned constants are included: a constant at the end of its tolerance is not known any better for that.
Noise in curved balances and blur within the window both bias a size. One bias falls with the width of the window, the other grows.
The same model is therefore fitted through windows of another width, and half the squared difference of the two sizes is the
variance between windows, as for two draws of one random effect.

Where healthy drives tell, the engine is not the model, and a cause is not quite the catalogue's. What its shape is off by then
moves the size by the square of that share.

The variance between windows has a single degree of freedom, the others have those of the stretches. The quantile is Student's with
the degrees of freedom of the sum (Satterthwaite). The standard error is scaled so that the normal quantile gives the same interval.
"""

from dataclasses import replace

import numpy as np
import scipy
from numpy.typing import NDArray

from lpvobs.discovery.fit import cholesky, converged, linearised, pins, prior_precision
from lpvobs.discovery.linear import Linear
from lpvobs.discovery.thresholds import SHAPE
from lpvobs.maps.excitation import cell_numbers
from lpvobs.records import Array


def standard_errors(linear: Linear) -> Array:
    """Return the standard error of the size of every effect in a model, shape (terms,)."""
    if not linear.terms:
        return np.empty(0)
    prior = prior_precision(linear.problem, linear.terms)
    free = replace(linear, factor=cholesky(linear.normal - pins(linear)))
    within = np.array([_variance(linear, free.row(i), prior, i) for i in range(len(linear.terms))])
    within += [linear.problem.seems(term, 1.0 / own) * own for term, own in zip(linear.terms, within, strict=True)]
    if len(linear.problem.patterns):
        within += [(SHAPE**2 * (term.size - term.effect.null)) ** 2 for term in linear.terms]
    return np.sqrt(widened(within, max(linear.problem.coarse_blocks - 1.0, 1.0), 0.5 * between_windows(linear) ** 2))


def widened(within: Array, degrees: float, between: Array) -> Array:
    """Return the variance of a normal distribution whose 90 % interval is that of a sum of estimated variances.

    That within has some degrees of freedom, that between has one.
    """
    total = within + between
    effective = total**2 / np.maximum(within**2 / degrees + between**2, np.finfo(float).tiny)
    student, normal = scipy.stats.t.ppf(0.95, effective), scipy.stats.norm.ppf(0.95)
    return np.asarray(total * (student / normal) ** 2)


def between_windows(linear: Linear) -> Array:
    """Return the difference of the sizes that wider windows give, shape (terms,)."""
    if linear.problem.blocks is not None:  # blocks take storage as a difference between edges, and no window blurs it
        return np.zeros(len(linear.terms))
    wider = linear.problem.wider()
    there = linearised(wider, linear.terms, linear.theta, linear.beta, linear.noise.only(wider.used), linear.pinned)
    return np.array([b.size - a.size for a, b in zip(linear.terms, converged(there).terms, strict=True)])


def _variance(linear: Linear, row: Array, prior: Array, index: int) -> float:
    """Return the variance of one size for a given window; `row` is its covariance with all unknowns without model error."""
    problem, plain = linear.problem, float(row[linear.p + linear.beta.size + index])
    left = linear.moved(linear.residual, linear.newton_step)
    along = -linear.moved(np.zeros_like(left), row)
    scores = (along[0] * left[0] - along[1] * left[1]).sum(0)
    known = float(row @ prior @ row)
    cells = cell_numbers(problem.grid, linear.nodes[0])
    return known + max(plain - known, spread_of_sums(scores, problem.coarse), spread_of_sums(scores, cells))


def spread_of_sums(scores: Array, group: NDArray[np.int64]) -> float:
    """Return the variance of a sum whose parts by group are independent, from those parts; the sum itself is zero."""
    sums = np.bincount(group, scores)
    sums = sums[np.bincount(group, scores != 0.0) > 0]
    return float(sums @ sums) * sums.size / max(sums.size - 1, 1)
