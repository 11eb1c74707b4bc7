"""The normal equations of map and engine under given weights, and what they leave."""

from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np
import scipy
from numpy.typing import NDArray

from lpvobs.observer.prior import AMPLITUDE_SPREAD, AMPLITUDES, Prior, Scales, swept
from lpvobs.observer.windows import GROUP, Columns, Moments
from lpvobs.records import Array

LEAST_ERROR = 1e-6
"""[kg/s sqrt(s)] A thirtieth of a hot film's: where signals are exact, what a window leaves would pass for knowledge otherwise."""
LEAST_FREE = 0.5  # share of the rows that counts as left over, even if the unknowns have used up more
LEAST_SEEN = 1.0  # [s] Of stay, below which a direction of the map tells nothing of whether errors repeat
REPEATED = np.concatenate([[0.0], np.geomspace(1e-6, 1e-2, 81)])
"""[kg/s], standard deviations of errors that repeat: what is tried, 12 % apart."""


@dataclass(frozen=True)
class Errors:
    """Errors of the balances: those that average out over visits, and those that repeat wherever the engine runs alike."""

    S: Array  # (B, B) [kg^2/s], covariance over a second of those that average out
    repeated: Array  # (B,) [kg/s], standard deviation of those that repeat


@dataclass(frozen=True)
class Free:
    """Normal equations, and what they leave of all other unknowns with the map eliminated."""

    A: Array  # (C, C), weighted products of all columns
    N: Array  # (p, p), covariance of the map where all else is known
    answers: Array  # (p, k - p) of the map to all else
    alone: Array  # (p,) values of the map where all else is as before
    told: Array  # (k - p, k - p), information of all else
    right: Array  # (k - p,), right side of all else


@dataclass(frozen=True)
class Equations:
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

    @cached_property
    def flow(self) -> float:
        """The mean flow [kg/s]."""
        return mean_flow(self.layout, self.moments)

    @cached_property
    def reading(self) -> float:
        """The mean reading of the sensor [kg/s]."""
        return _mean(self.layout, self.moments, (self.layout.terms.stop, self.layout.z))

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

    def settled(self, errors: Errors, scales: Scales, rounds: int) -> tuple[Errors, Array]:
        """Return the errors after so many rounds with the solution, and the part of S that is new every time."""
        for _ in range(rounds):
            free, engine, spent = self.solved(errors, scales)
            errors, fast = self.errors(self.mean(free, engine), spent)
        return errors, fast

    def solved(self, errors: Errors, scales: Scales) -> tuple[Free, Array, float]:
        """Return the equations, the covariance of the other unknowns, and how many unknowns the data determine."""
        p, free = self.layout.nodes, self.without_map(errors)
        root = self.prior.root(scales, self.flow)
        told, axes = np.linalg.eigh(root.T @ free.told @ root)
        told = np.maximum(told, 0.0)  # rounding
        half = root @ axes / np.sqrt(1.0 + told)
        of_map = p - float(np.trace(free.N)) / self.prior.node**2
        return free, half @ half.T, of_map + float(np.sum(told / (1.0 + told)))

    def mean(self, free: Free, engine: Array) -> Array:
        """Return the mean of all columns, given the covariance of the engine's."""
        p, moved, mean = self.layout.nodes, engine @ free.right, self.prior.mean(self.layout)
        mean[p:] += moved
        mean[:p] += free.alone - free.answers @ moved
        return mean

    def covariance(self, free: Free, engine: Array) -> Array:
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

    def without_map(self, errors: Errors) -> Free:
        """Return the normal equations under some errors, with the map eliminated."""
        p, k, z = self.layout.nodes, self.layout.solved, self.layout.z
        A, start = self.normal(errors), self.prior.mean(self.layout)
        right = A[:k, z] - A[:k, :k] @ start
        N = np.linalg.inv(A[:p, :p] + np.eye(p) / self.prior.node**2)
        N = 0.5 * (N + N.T)
        answers, alone = N @ A[:p, p:k], N @ right[:p]
        rest = A[p:k, p:k] - A[p:k, :p] @ answers
        return Free(A, N, answers, alone, 0.5 * (rest + rest.T), right[p:] - A[p:k, :p] @ alone)

    def likeliest(self, errors: Errors) -> tuple[float, ...]:
        """Return the amplitudes of the largest restricted likelihood, each held near one by its own prior."""
        # The likelihood is flat: half or twice an amplitude changes little.
        free = self.without_map(errors)

        def cost(amplitudes: tuple[float, ...]) -> float:
            root = self.prior.root(Scales(amplitudes), self.flow)
            try:
                factor = np.linalg.cholesky(np.eye(free.right.size) + root.T @ free.told @ root)
            except np.linalg.LinAlgError:  # a log of a few samples leaves nothing but rounding
                return np.inf
            seen = scipy.linalg.solve_triangular(factor, root.T @ free.right, lower=True, check_finite=False)
            far = float(np.sum((np.log(amplitudes) / AMPLITUDE_SPREAD) ** 2))
            return float(np.log(np.diag(factor)).sum()) - 0.5 * float(seen @ seen) + 0.5 * far

        groups = len(self.prior.unknowns.groups())
        return swept((AMPLITUDES[0],) * groups, (AMPLITUDES,) * groups, cost)

    def moved(self, errors: Errors, scales: Scales, by: int | None = None) -> float:
        """Return how far the other unknowns move, as the sum of squares over their standard deviations.

        They are moved by the rows as they are, or by rows that hold one unit of the unknown `by` and nothing else.
        """
        free, engine, _ = self.solved(errors, scales)
        right = free.right if by is None else free.told[:, by]
        root = self.prior.root(scales, self.flow)
        moved = scipy.linalg.solve_triangular(root, engine @ right, lower=True, check_finite=False)
        return float(moved @ moved)


def _positive(S: Array, instead: Array) -> Array:
    """Return a covariance as it is; where it is none, the diagonal of another instead of variances that are not positive."""
    if np.linalg.eigvalsh(S)[0] > 0.0:
        return S
    variances = np.where(np.diag(S) > 0.0, np.diag(S), np.diag(instead))
    return np.diag(np.maximum(variances, LEAST_ERROR**2))


def mean_flow(layout: Columns, moments: Moments) -> float:
    """Return the mean flow over the windows in which a balance speaks [kg/s]; one where none does."""
    return _mean(layout, moments, (layout.terms.stop,))


def _mean(layout: Columns, moments: Moments, columns: tuple[int, ...]) -> float:
    """Return the mean of the sum of some columns; one where no balance speaks, or it is not positive."""
    constant = layout.terms.stop - 1
    of_rows = np.einsum("aai->i", moments.products[:, :, constant])
    stay, total = of_rows[constant], of_rows[list(columns)].sum()
    return float(total / stay) if stay > 0.0 and total > 0.0 else 1.0
