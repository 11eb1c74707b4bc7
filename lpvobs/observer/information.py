"""The map equation of the default method: map and engine together, as one linear problem with a prior.

With the rows of `windows`, in which z_b is what the sensor reads beyond the flow of balance b,

    z_b = Psi theta + J_b beta + kappa_1 r + kappa_2 r^2 + Psi d_b + e_b,

theta being the map, beta the engine's unknowns (constants within their tolerance, corrections of its components), kappa what of the
sensor's error follows its reading r at one operating point, d_b what balance b has wrong at the nodes at every visit. The
covariance S of the e_b, the size of the d_b and the amplitudes of the corrections are found from the rows (restricted likelihood).
Several logs add up.

How this departs from Eq. (26) and (36), whose map equation is dtheta/dt = Gamma Psi^T (y_m2 - C_2 x - Psi theta):

- Gamma is no constant diagonal matrix. Least squares solves the same equation with S^-1 in front of Psi^T and Gamma(t) = H(t)^-1,
  dH/dt = Psi^T S^-1 Psi. So a node is the average over all its visits; with Gamma = 200 I it is the last visit, noise included.
- The flow is not C_2 x alone: every balance of the engine speaks, of which C_2 x is one.
- The engine is not taken for exact. Its constants cannot be told apart by a drive (displacement and volumetric efficiency share a
  scale), but the map can be told from them, for it stays where boost and gas move. What the drive does not tell stays in the
  covariance.
- The map does not act back on the state: the gain is a cascade, its last column is zero. The state error decays as the certificate
  says, whatever the map is, and enters here as an error of z.
"""

from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from lpvobs.observer.equations import Equations, Errors
from lpvobs.observer.prior import AMPLITUDES, Prior, Scales
from lpvobs.observer.windows import Columns, Moments
from lpvobs.records import Array, Item

ROUNDS = 4  # rounds between the covariance of the errors and the solution; the last changes it by less than a hundredth
FIRST_ERROR = 5e-5  # [kg/s sqrt(s)] of every balance, from which the rounds start
LEAST_WINDOWS = 40.0  # of a quarter of a second, under which what is not known of the engine absorbs a balance's errors
LEAST_SPARED = 25.0
"""A sensor that reads 2 % too much looks like an engine that breathes 2 % more than configured. Its error follows the flow where
the unknowns of the engine then move so much less, in squares over their variance. On 143 drives without such an error (FTP75, ETC;
constants within 1 or 3 %, or twice as far as stated), they spared 19.4 at most. On 12 drives of both with a gain of 0.95 and
constants within 1 %, it was 28 to 83, with a gain of 1.02 up to 21. How well the rows fit does not decide: what the balances lack
in transients fits a slope of up to 7 %."""

SLOPE_LACKS = 0.01
"""Standard deviation of the slope of the sensor's error for what the balances lack in transients. On six engines with constants
within 1 %, FTP75, slopes of -0.05 were off by 0.014, where noise and tolerances alone said 0.007."""


@dataclass(frozen=True)
class AlongFlow:
    """How the sensor's error changes with the air flow at one fuel and speed, beyond the map."""

    slope: Annotated[
        float, Item("1", "change of the sensor's error per air flow at one operating point; zero: none is seen")
    ]
    standard_error: Annotated[float, Item("1", "standard error of the slope")]
    least: Annotated[
        float, Item("1", "slope from about which on one is seen; a smaller one is taken for wrong constants")
    ]


@dataclass(frozen=True)
class Solution:
    """Map and engine together."""

    layout: Columns
    mean: Array  # (s,) of all columns that are solved for
    covariance: Array  # (s, s)
    noise: Array  # (p, p) [kg^2/s^2], covariance of the map from noise alone, the engine being as the mean says
    # (p, q) [kg/s], how the map would answer to each unknown of the engine if that were all that there is
    response: Array
    design: Array  # (p, 6) node values that the method finds for each term of the quadratic
    errors: Errors
    fast: Array  # (B, B) [kg^2/s], the part of S that is new in every window
    quick: Array  # (p, p) [kg^2/s^2], `noise` as if that part were all
    scales: Scales
    stiff: Array  # (s,), the mean with corrections as small as they may be
    along_flow: AlongFlow | None = None  # None where the engine is not estimated

    @property
    def theta(self) -> Array:
        """The map, shape (p,) [kg/s]."""
        return self.mean[: self.layout.nodes]


def _without_brief(moments: Moments) -> Moments:
    """Return the sums without balances that spoke too briefly beside the others to show what their errors are."""
    heard = moments.windows >= min(LEAST_WINDOWS, 0.1 * float(moments.windows.max(initial=0.0)))
    if heard.all():
        return moments
    both = np.outer(heard, heard)[:, :, None, None]
    kept = {name: np.where(both, getattr(moments, name), 0.0) for name in ("products", "slow")}
    return replace(moments, **kept, windows=np.where(heard, moments.windows, 0.0))


def solve(layout: Columns, moments: Moments, prior: Prior) -> Solution:
    """Return map and engine as the sums of logs determine them."""
    groups = prior.unknowns.groups()
    stiff = Scales((AMPLITUDES[0],) * len(groups))
    state = Equations(layout, _without_brief(moments), prior)
    errors = Errors(FIRST_ERROR**2 * np.eye(layout.balances), np.zeros(layout.balances))
    errors, fast = state.settled(errors, stiff, ROUNDS)
    scales = Scales(state.likeliest(errors)) if groups else stiff
    if _follows(state, errors, scales):
        stiff, scales = (replace(each, follows=True) for each in (stiff, scales))
    at_stiff = state.mean(*state.solved(state.settled(errors, stiff, 1)[0], stiff)[:2])
    if groups or scales.follows:
        errors, fast = state.settled(errors, scales, 1)
    free, engine, _ = state.solved(errors, scales)
    p, q = layout.nodes, layout.unknowns
    # The map holds all of the sensor's error, that which follows the flow at the mean flow of every visit.
    onto = np.eye(layout.solved)
    onto[:p, layout.sensor] = free.answers[:, q:]
    mean, covariance = onto @ state.mean(free, engine), state.covariance(free, engine)
    if scales.follows:
        covariance[layout.sensor.start, layout.sensor.start] += SLOPE_LACKS**2
    covariance = onto @ covariance @ onto.T
    along = _along_flow(state, errors, scales, mean[layout.sensor], covariance[layout.sensor, layout.sensor])
    response, design = free.answers[:, :q], free.N @ free.A[:p, layout.terms]
    quick = state.without_map(Errors(fast, np.zeros(layout.balances))).N
    return Solution(layout, mean, covariance, free.N, response, design, errors, fast, quick, scales, at_stiff, along)


def _follows(state: Equations, errors: Errors, scales: Scales) -> bool:
    """Return whether the unknowns of the engine move much less where the sensor's error may follow the flow."""
    spared = state.moved(errors, scales) - state.moved(errors, replace(scales, follows=True))
    return state.prior.may_follow and spared > LEAST_SPARED


def _along_flow(state: Equations, errors: Errors, scales: Scales, powers: Array, covariance: Array) -> AlongFlow:
    """Return the slope of the sensor's error over the flow at the mean reading, from the weights of the powers of the reading."""
    order = np.arange(1, powers.size + 1)
    at_mean = order * state.reading ** (order - 1.0)
    # What a slope of one makes the unknowns of the engine move where the sensor's error is not allowed to follow the flow.
    as_if = state.moved(errors, replace(scales, follows=False), by=state.layout.unknowns)
    least = float(np.sqrt(LEAST_SPARED / max(as_if, LEAST_SPARED)))
    if not scales.follows:
        return AlongFlow(0.0, 0.0, least)
    # An error of which each kg/s of reading holds the share k is k/(1 - k) of the flow, which is less than the reading by itself.
    share, error = float(at_mean @ powers), float(np.sqrt(at_mean @ covariance @ at_mean))
    return AlongFlow(share / (1.0 - share), error / (1.0 - share) ** 2, least)


def considered(solution: Solution, moments: Moments, prior: Prior) -> Solution:
    """Return the map with the engine as configured, its constants' tolerances considered and not fitted (Schmidt)."""
    layout, unknowns, state = solution.layout, prior.unknowns, Equations(solution.layout, moments, prior)
    variances = np.diag(unknowns.covariance)[: len(unknowns.constants)]
    answers = solution.response[:, : variances.size]
    mean, covariance = np.zeros(layout.solved), np.zeros((layout.solved, layout.solved))
    p, constants = layout.nodes, slice(layout.nodes, layout.nodes + variances.size)
    mean[:p] = solution.noise @ state.normal(solution.errors)[:p, layout.z]
    covariance[:p, :p] = solution.noise + (answers * variances) @ answers.T
    covariance[:p, constants] = -answers * variances
    covariance[constants, :p], covariance[constants, constants] = covariance[:p, constants].T, np.diag(variances)
    return replace(solution, mean=mean, covariance=covariance, stiff=mean, along_flow=None)
