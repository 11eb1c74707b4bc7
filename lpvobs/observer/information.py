"""The map equation of the default method: map and engine together, as one linear problem with a prior.

With the rows of `windows`, in which z_b is what the sensor reads beyond the flow of balance b,

    z_b = Psi theta + J_b beta + l_b + Psi d_b + e_b,

theta being the map, beta the engine's unknowns (constants within their tolerance, corrections of its components), l_b levels of the
day, d_b what balance b has wrong at the nodes at every visit. The covariance S of the e_b, the size of the d_b and the amplitudes
of the corrections are found from the rows (restricted likelihood). Several logs add up.

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

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from itertools import combinations

import numpy as np
import scipy
from numpy.typing import NDArray

from lpvobs.engines.curves import Nodes
from lpvobs.engines.unknowns import Component, Unknowns
from lpvobs.maps.grid import Grid
from lpvobs.observer.windows import GROUP, Columns, Moments
from lpvobs.records import Array

ROUNDS = 4  # rounds between the covariance of the errors and the solution; the last changes it by less than a hundredth
FIRST_ERROR = 5e-5  # [kg/s sqrt(s)] of every balance, from which the rounds start
LEAST_ERROR = 1e-6
"""[kg/s sqrt(s)] A thirtieth of a hot film's: where signals are exact, what a window leaves would pass for knowledge otherwise."""
AMPLITUDES = (0.03, 0.06, 0.12, 0.3, 0.7, 1.5, 3.0)
"""Of the corrections, over those of `Component.deviation`: what is tried. The least decides on an engine that needs none. With
0.05, 0.03, 0.02 the map was off by 1.75, 1.59, 1.51 % on ETC (ten engines with constants within 1 %), and by 0.78, 0.79, 0.81 %
on FTP75 (twelve), where 96, 95, 93 % of the 90 % intervals held."""
SWEEPS = 2  # over all numbers that are sought one after the other
LEAST_FREE = 0.5  # share of the rows that counts as left over, even if the unknowns have used up more
LEAST_SEEN = 1.0  # [s] Of stay, below which a direction of the map tells nothing of whether errors repeat
ALIKE = 1.0 / 3.0
"""Of an axis of the map, the length over which errors that repeat are correlated. On twelve engines with all differences from the
model, a fifth, a third and a half gave maps that are off by 0.415, 0.415 and 0.416 % of the air flow; 94 % of the 90 % intervals of
the nodes held, and 81, 94, 96 % of those of means over a quarter of the map."""
REPEATED = np.concatenate([[0.0], np.geomspace(1e-6, 1e-2, 81)])
"""[kg/s], standard deviations of errors that repeat: what is tried, 12 % apart."""
LEAST_WINDOWS = 40.0  # of a quarter of a second, under which what is not known of the engine absorbs a balance's errors
NO_LEVEL = 1e-9  # [kg/s], standard deviation of a balance's level of the day: the days of an estimate have none
AMPLITUDE_SPREAD = 3.0  # standard deviation of the logarithm of an amplitude before any data: a factor of twenty


@dataclass(frozen=True)
class Errors:
    """Errors of the balances: those that average out over visits, and those that repeat wherever the engine runs alike."""

    S: Array  # (B, B) [kg^2/s], covariance over a second of those that average out
    repeated: Array  # (B,) [kg/s], standard deviation of those that repeat


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
    amplitudes: tuple[float, ...]  # of the groups of corrections
    stiff: Array  # (s,), the mean with corrections as small as they may be

    @property
    def theta(self) -> Array:
        """The map, shape (p,) [kg/s]."""
        return self.mean[: self.layout.nodes]


@dataclass(frozen=True)
class Prior:
    """What is known before the logs."""

    node: float  # [kg/s], standard deviation of a node, far beyond any sensor
    unknowns: Unknowns
    alike: Array  # (p, p) correlation of the errors of a balance that repeat at the nodes
    amplitudes: tuple[float, ...] = ()  # of the groups of corrections; none where they are found from the data

    def mean(self, layout: Columns) -> Array:
        """Return the mean of all columns that are solved for."""
        found = np.zeros(layout.solved)
        found[layout.engine] = self.unknowns.mean
        return found

    def root(self, layout: Columns, amplitudes: Sequence[float]) -> Array:
        """Return a square root of their covariance, lower triangular."""
        found = np.zeros((layout.solved, layout.solved))
        np.fill_diagonal(found, self.node)
        own, covariance = layout.engine, self.unknowns.scaled(amplitudes)
        ridge = 1e-9 * np.diag(covariance) + 1e-18
        found[own, own] = np.linalg.cholesky(covariance + np.diag(ridge)) if self.unknowns.size else covariance
        levels = np.arange(own.stop, layout.solved)
        found[levels, levels] = NO_LEVEL
        return found


def prior_of(grid: Grid, node: float, unknowns: Unknowns) -> Prior:
    """Return the prior of logs; `node` [kg/s] is the standard deviation of a node."""
    axes = {name: Nodes(values, "1", "") for name, values in (("speed", grid.speed), ("fuel", grid.fuel))}
    lengths = tuple(ALIKE * float(np.ptp(axis.values)) for axis in axes.values())
    repeated = Component("repeated", "kg/s", "", 1.0, axes=axes, lengths=lengths)
    return Prior(node, unknowns, repeated.correlation())


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
    amplitudes: tuple[float, ...] = (AMPLITUDES[0],) * len(groups)
    state = _Solved(layout, _without_brief(moments), prior)
    errors = Errors(FIRST_ERROR**2 * np.eye(layout.balances), np.zeros(layout.balances))
    errors, fast = state.settled(errors, amplitudes, ROUNDS)
    if groups:
        stiff = state.mean(*state.solved(state.settled(errors, amplitudes, 1)[0], amplitudes)[:2])
        amplitudes = prior.amplitudes or state.likeliest(errors)
        errors, fast = state.settled(errors, amplitudes, 1)
    free, engine, _ = state.solved(errors, amplitudes)
    mean, covariance, p, q = state.mean(free, engine), state.covariance(free, engine), layout.nodes, layout.unknowns
    response, design = free.answers[:, :q], free.N @ free.A[:p, layout.terms]
    quick, step = state.without_map(Errors(fast, np.zeros(layout.balances))).N, stiff if groups else mean
    return Solution(layout, mean, covariance, free.N, response, design, errors, fast, quick, amplitudes, step)


@dataclass(frozen=True)
class _Free:
    """Normal equations, and what they leave of the engine's unknowns and levels with the map eliminated."""

    A: Array  # (C, C), weighted products of all columns
    N: Array  # (p, p), covariance of the map where all else is known
    answers: Array  # (p, k - p) of the map to all else
    alone: Array  # (p,) values of the map where all else is as before
    told: Array  # (k - p, k - p), information of all else
    right: Array  # (k - p,), right side of all else


@dataclass(frozen=True)
class _Solved:
    """The normal equations of sums under some weights and amplitudes."""

    layout: Columns
    moments: Moments
    prior: Prior

    @cached_property
    def visited(self) -> NDArray[np.int64]:
        """The n nodes at which any balance speaks."""
        own = np.einsum("aaii->i", self.moments.products[:, :, : self.layout.nodes, : self.layout.nodes])
        return np.flatnonzero(own > 0.0)

    @cached_property
    def alike(self) -> Array:
        """A square root of the correlation of errors that repeat at these nodes, shape (n, n)."""
        n = self.visited.size
        return np.asarray(np.linalg.cholesky(self.prior.alike[np.ix_(self.visited, self.visited)] + 1e-9 * np.eye(n)))

    def normal(self, errors: Errors) -> Array:
        """Return the weighted products of all columns, shape (C, C), with the errors that repeat eliminated."""
        weights, products = np.linalg.inv(errors.S), self.moments.products
        total = np.tensordot(weights, products)
        if not errors.repeated.any():
            return np.asarray(total)
        # d_b stands beside theta in the rows of balance b alone, so the products of its columns are there already. In units of
        # its standard deviation, its prior is the unit matrix.
        on, n = self.visited, self.visited.size
        roots = errors.repeated[:, None, None] * self.alike
        blocks = weights[:, :, None, None] * products[:, :, on]
        across = np.matmul(roots.transpose(0, 2, 1), blocks.sum(axis=1)).reshape(-1, total.shape[1])
        inner = np.matmul(roots.transpose(0, 2, 1)[:, None], np.matmul(blocks[..., on], roots))
        whole = inner.transpose(0, 2, 1, 3).reshape(len(weights) * n, -1) + np.eye(len(weights) * n)
        half = scipy.linalg.solve_triangular(np.linalg.cholesky(whole), across, lower=True, check_finite=False)
        return np.asarray(total - half.T @ half)

    def settled(self, errors: Errors, amplitudes: Sequence[float], rounds: int) -> tuple[Errors, Array]:
        """Return the errors after so many rounds with the solution, and the part of S that is new every time."""
        for _ in range(rounds):
            free, engine, spent = self.solved(errors, amplitudes)
            errors, fast = self.errors(self.mean(free, engine), spent)
        return errors, fast

    def solved(self, errors: Errors, amplitudes: Sequence[float]) -> tuple[_Free, Array, float]:
        """Return the equations, the covariance of the engine's unknowns and levels, and how many unknowns the data determine."""
        p, free = self.layout.nodes, self.without_map(errors)
        root = self.prior.root(self.layout, amplitudes)[p:, p:]
        told, axes = np.linalg.eigh(root.T @ free.told @ root)
        told = np.maximum(told, 0.0)  # rounding
        half = root @ axes / np.sqrt(1.0 + told)
        of_map = p - float(np.trace(free.N)) / self.prior.node**2
        return free, half @ half.T, of_map + float(np.sum(told / (1.0 + told)))

    def mean(self, free: _Free, engine: Array) -> Array:
        """Return the mean of all columns, given the covariance of the engine's."""
        p, moved, mean = self.layout.nodes, engine @ free.right, self.prior.mean(self.layout)
        mean[p:] += moved
        mean[:p] += free.alone - free.answers @ moved
        return mean

    def covariance(self, free: _Free, engine: Array) -> Array:
        """Return the covariance of all columns, given that of the engine's."""
        across = -free.answers @ engine
        return np.block([[free.N - across @ free.answers.T, across], [across.T, engine]])

    def errors(self, mean: Array, spent: float) -> tuple[Errors, Array]:
        """Return the errors from what the solution leaves, less the freedom used up, and the part of S that is new every time."""
        # S is from sums over groups of windows, for errors of a model last; from windows where a short log leaves too few
        # groups.
        left = np.zeros(self.layout.size)
        left[: self.layout.solved], left[self.layout.z] = -mean, 1.0

        def covariance(products: Array, rows: Array) -> Array:
            own = spent * rows / max(float(rows.sum()), 1.0)
            free = np.maximum(np.maximum(rows - own, LEAST_FREE * rows), 1.0)
            found = np.einsum("i,abij,j->ab", left, products, left) / np.sqrt(np.outer(free, free))
            return np.asarray(found + LEAST_ERROR**2 * np.eye(self.layout.balances))

        moments = self.moments
        fast, slow = covariance(moments.products, moments.windows), covariance(moments.slow, moments.windows / GROUP)
        # The noise of smoothed signals is taken out of the products, and a short log may have less left than was taken out.
        fast, slow = _positive(fast, np.abs(fast)), _positive(slow, fast)
        S = slow if np.trace(np.linalg.solve(fast, slow)) > self.layout.balances else fast
        # The map takes up what balances have in common, and leaves them with opposite errors: those are none of their own.
        S = np.where(np.eye(self.layout.balances, dtype=bool), S, np.maximum(S, 0.0))
        return Errors(S, self.repeated(S, left)), fast

    def repeated(self, S: Array, left: Array) -> Array:
        """Return the standard deviation of the errors that each balance repeats at the nodes, shape (B,) [kg/s]."""
        # No balance shows its own, for the map takes it up. But two balances contradict each other at the nodes by more than S
        # says: where both speak, Psi^T (r_a - r_b) has the covariance (S_aa + S_bb - 2 S_ab) G + G (D_a + D_b) G, with
        # G = Psi^T Psi and D the covariance of what a balance repeats. The size of D_a + D_b is the likeliest one. Neither
        # balance is the likelier one to be wrong, so each is charged with half of the least contradiction that it has with
        # another: of two balances, all of it; of more, at least half of what one lacks that none supports.
        on, B, products = self.visited, self.layout.balances, self.moments.products
        least = np.full((B, B), np.inf)
        for a, b in combinations(range(B), 2):
            together = products[a, b][np.ix_(on, on)]
            stay, axes = np.linalg.eigh(0.5 * (together + together.T))
            seen = stay > LEAST_SEEN
            if not seen.any():  # they speak at different times: one with the EGR valve shut, one with it open
                continue
            root, white = axes[:, seen] * np.sqrt(stay[seen]), axes[:, seen] / np.sqrt(stay[seen])
            scatter = S[a, a] + S[b, b] - 2.0 * S[a, b]
            away = white.T @ ((products[b, a] - products[a, b])[on] @ left) / np.sqrt(scatter)
            power, turned = np.linalg.eigh((half := root.T @ self.alike) @ half.T / scatter)
            more = 1.0 + REPEATED[:, None] ** 2 * np.maximum(power, 0.0)
            cost = (np.log(more) + (turned.T @ away) ** 2 / more).sum(axis=1)
            least[a, b] = least[b, a] = REPEATED[np.argmin(cost)] ** 2
        least = least.min(axis=1, initial=np.inf)
        return np.sqrt(0.5 * np.where(np.isfinite(least), least, 0.0))

    def without_map(self, errors: Errors) -> _Free:
        """Return the normal equations under some errors, with the map eliminated."""
        p, k, z = self.layout.nodes, self.layout.solved, self.layout.z
        A, start = self.normal(errors), self.prior.mean(self.layout)
        right = A[:k, z] - A[:k, :k] @ start
        N = np.linalg.inv(A[:p, :p] + np.eye(p) / self.prior.node**2)
        N = 0.5 * (N + N.T)
        answers, alone = N @ A[:p, p:k], N @ right[:p]
        rest = A[p:k, p:k] - A[p:k, :p] @ answers
        return _Free(A, N, answers, alone, 0.5 * (rest + rest.T), right[p:] - A[p:k, :p] @ alone)

    def likeliest(self, errors: Errors) -> tuple[float, ...]:
        """Return the amplitudes of the largest restricted likelihood, each held near one by its own prior."""
        # The likelihood is flat: half or twice an amplitude changes little.
        p, free = self.layout.nodes, self.without_map(errors)

        def cost(amplitudes: tuple[float, ...]) -> float:
            root = self.prior.root(self.layout, amplitudes)[p:, p:]
            try:
                factor = np.linalg.cholesky(np.eye(free.right.size) + root.T @ free.told @ root)
            except np.linalg.LinAlgError:  # a log of a few samples leaves nothing but rounding
                return np.inf
            seen = scipy.linalg.solve_triangular(factor, root.T @ free.right, lower=True, check_finite=False)
            far = float(np.sum((np.log(amplitudes) / AMPLITUDE_SPREAD) ** 2))
            return float(np.log(np.diag(factor)).sum()) - 0.5 * float(seen @ seen) + 0.5 * far

        groups = len(self.prior.unknowns.groups())
        return swept((AMPLITUDES[0],) * groups, (AMPLITUDES,) * groups, cost)


def swept(
    start: Sequence[float], choices: Sequence[Sequence[float]], cost: Callable[[tuple[float, ...]], float]
) -> tuple[float, ...]:
    """Return the numbers of least cost, sought one after the other among the choices of each, `SWEEPS` times over all."""
    best, cost = tuple(start), cache(cost)
    for _ in range(SWEEPS):
        for i, among in enumerate(choices):
            best = min(((*best[:i], choice, *best[i + 1 :]) for choice in among), key=cost)
    return best


def _positive(S: Array, instead: Array) -> Array:
    """Return a covariance as it is; where it is none, the diagonal of another instead of variances that are not positive."""
    if np.linalg.eigvalsh(S)[0] > 0.0:
        return S
    variances = np.where(np.diag(S) > 0.0, np.diag(S), np.diag(instead))
    return np.diag(np.maximum(variances, LEAST_ERROR**2))


def considered(solution: Solution, moments: Moments, prior: Prior) -> Solution:
    """Return the map with the engine as configured, its constants' tolerances considered and not fitted (Schmidt)."""
    layout, unknowns, state = solution.layout, prior.unknowns, _Solved(solution.layout, moments, prior)
    variances = np.diag(unknowns.covariance)[: len(unknowns.constants)]
    answers = solution.response[:, : variances.size]
    mean, covariance = np.zeros(layout.solved), np.zeros((layout.solved, layout.solved))
    p, constants = layout.nodes, slice(layout.nodes, layout.nodes + variances.size)
    mean[:p] = solution.noise @ state.normal(solution.errors)[:p, layout.z]
    covariance[:p, :p] = solution.noise + (answers * variances) @ answers.T
    covariance[:p, constants] = -answers * variances
    covariance[constants, :p], covariance[constants, constants] = covariance[:p, constants].T, np.diag(variances)
    return replace(solution, mean=mean, covariance=covariance, stiff=mean)
