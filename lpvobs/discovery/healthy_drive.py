"""What the balances leave on healthy drives, so that another drive is asked for what has changed.

No engine is its model. What a balance leaves is a smooth function of the signals and an error beyond it that lasts for seconds and
minutes. Both are learned from the drives that made the map, the error on minutes that were held out. What does not change cancels:
the function is taken off the residual of another drive, and the error is the noise that an effect must beat.

The function is a kernel regression: Gaussian bells over the channels around instants of the healthy drives, and a line over their
rates, since sensors that are slow when the engine is healthy stay slow. Where a drive goes elsewhere the bells end, and what the
function would have said counts as noise.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from lpvobs.discovery import thresholds
from lpvobs.discovery.imbalances import imbalances_at, map_along, operating_nodes, scenes_with
from lpvobs.discovery.residual import Problem
from lpvobs.engines.effects import SENSOR
from lpvobs.engines.healthy import CHUNK, FOLDS, parts_of, slow
from lpvobs.engines.residual_model import Level, ResidualModel
from lpvobs.records import Array, Item


@dataclass(frozen=True, eq=False)
class HealthyDrive:
    """What B balances leave over c channels and r rates, with m bells."""

    logs: tuple[str, ...]  # the healthy drives that it was learned from
    balances: Annotated[tuple[str, ...], Item("1", "balance", name="balance")]
    channels: Annotated[tuple[str, ...], Item("1", "channel whose values the bells stand over", name="channel")]
    rates: tuple[str, ...]  # channels whose rates have a line
    middle: Annotated[Array, Item("SI", "mean of channels and rates", ("input",))]
    spread: Annotated[Array, Item("SI", "their standard deviation", ("input",))]
    centres: Annotated[Array, Item("1", "middle of a bell, in standard deviations from the mean", ("bell", "channel"))]
    width: Annotated[float, Item("1", "of a bell, in standard deviations")]
    weights: Annotated[Array, Item("kg/s", "what a balance leaves, by bells and lines", ("balance", "feature"))]
    amplitude: Annotated[Array, Item("kg/s", "rms of that along the healthy drives", ("balance",))]
    scale: Annotated[Array, Item("kg/s", "usual size of the error beyond, held out", ("balance",))]
    lasting: Annotated[Array, Item("1", "variance of a sum of errors over that of independent ones", ("balance",))]
    day: Annotated[Array, Item("kg/s", "standard deviation of what lasts for minutes, or a day", ("balance",))]

    @cached_property
    def _root(self) -> Array:
        """Inverse of the lower Cholesky factor of the bells' own kernel, shape (m, m)."""
        kernel = _bells(self.centres, self.centres, self.width)
        return np.asarray(np.linalg.inv(np.linalg.cholesky(kernel + thresholds.RIDGE * np.eye(len(kernel)))))

    def inputs(self, problem: Problem) -> Array:
        """Return values and rates in spreads from the middle, shape (2, K, c + r); the views change places.

        The noise of a signal is in the residual of its own view, and independent of the other's.
        """
        s, K = problem.signals, problem.K
        along = np.stack([*(s[name] for name in self.channels), *(s.rate[name] for name in self.rates)], axis=1)
        scaled = np.clip((along - self.middle) / self.spread, -thresholds.FAR, thresholds.FAR)
        return np.asarray(scaled.reshape(2, K, -1)[::-1])

    def features(self, inputs: Array) -> Array:
        """Return independent features of unit variance before any data, shape (n, m + r), of inputs of shape (n, c + r)."""
        c = len(self.channels)
        bells = _bells(inputs[:, :c], self.centres, self.width) @ self._root.T
        return np.hstack([bells, inputs[:, c:]])

    def expected(self, problem: Problem) -> tuple[Array, Array]:
        """Return what a healthy engine leaves [kg/s], and how its errors beyond last, both of shape (B, K)."""
        features = np.mean([self.features(view) for view in self.inputs(problem)], axis=0)
        known = np.clip((features[:, : len(self.centres)] ** 2).sum(1), 0.0, 1.0)
        unsure = np.outer((self.amplitude / self.scale) ** 2, 1.0 - known)
        return self.weights @ features.T, self.lasting[:, None] * (1.0 + unsure)

    def taken_off(self, problem: Problem) -> Problem:
        """Return the problem that asks for what has changed, for any width of the windows."""
        expected, wider = self.expected(problem)
        return replace(
            problem,
            offset=problem.offset - expected,
            lasting=problem.lasting * wider,
            wider=lambda: self.taken_off(problem.wider()),
        )

    def unchanged(self, model: ResidualModel) -> ResidualModel:
        """Return the engine as it was on the healthy drives: nothing of it is unknown but the levels of the day."""
        constants = model.with_unknowns(np.zeros(len(model.names)))
        levels = [Level(name, "kg/s", float(x)) for name, x in zip(self.balances, self.day, strict=True)]
        return replace(
            model,
            names=(),
            adding=0,
            covariance=np.zeros((0, 0)),
            with_unknowns=lambda _: constants,
            by_unknowns=None,
            levels=(*model.levels, *levels),
        )


def learned_from(problem: Problem, logs: Sequence[str]) -> HealthyDrive:
    """Return what healthy drives show, laid out with the map and the engine that they made."""
    B, K = problem.shown.shape
    scenes = scenes_with(problem, (), np.zeros(problem.spread.size))
    left = imbalances_at(problem, scenes, np.zeros(problem.spread.size)).reshape(B, 2, K)
    left = left - (problem.by_reading * map_along(problem.prior.mean, operating_nodes(problem, scenes)))[:, None]
    scale = _scales(left.mean(1), problem.transience)
    several = len(logs) > 1
    part = problem.of_log % FOLDS if several else parts_of(problem.time)
    found = []
    for width in thresholds.BELL_WIDTHS:
        bare = _bare(problem, logs, width)
        features = np.stack([bare.features(view) for view in bare.inputs(problem)])
        rows = [_regression(features, left[b], scale[b], part) for b in range(B)]
        weights, held_out = (np.array(each) for each in zip(*rows, strict=True))
        error = float(np.mean(np.minimum(np.abs(held_out / scale), thresholds.FAR) ** 2))
        amplitude = np.sqrt(np.mean((weights @ features[0].T) ** 2, axis=1))
        found.append((error, replace(bare, weights=weights, amplitude=amplitude), held_out))
    _, best, held_out = min(found, key=lambda item: item[0])
    scale = _scales(held_out, problem.transience)
    usual = np.median(scale, axis=1)
    chunk = problem.time // CHUNK + 1e4 * problem.of_log
    return replace(
        best,
        scale=usual,
        lasting=np.array([_lasting(problem, z) for z in held_out / scale]),
        day=usual * [max(slow(z, chunk), thresholds.LEAST_LEVEL) for z in held_out / usual[:, None]],
    )


def _bare(problem: Problem, logs: Sequence[str], width: float) -> HealthyDrive:
    """Return where the bells stand, along what the drives have visited, before anything is learned."""
    s, none = problem.signals, np.zeros(0)
    moving = tuple(name for name in s.value if np.std(s[name]) > thresholds.STANDS * np.abs(np.mean(s[name])))
    channels = tuple(name for name in moving if name != SENSOR)
    along = np.stack([*(s[name] for name in channels), *(s.rate[name] for name in moving)], axis=1)
    bare = HealthyDrive(
        logs=tuple(logs), balances=problem.model.balances, channels=channels, rates=moving, middle=along.mean(0),
        spread=along.std(0), centres=np.zeros((0, len(channels))), width=width * float(np.sqrt(len(channels))),
        weights=none, amplitude=none, scale=none, lasting=none, day=none,
    )  # fmt: skip
    return replace(bare, centres=_spread_out(bare.inputs(problem)[0][:, : len(channels)], thresholds.BELLS))


def _bells(x: Array, centres: Array, width: float) -> Array:
    distance = (x**2).sum(1)[:, None] + (centres**2).sum(1) - 2.0 * x @ centres.T
    return np.asarray(np.exp(-0.5 * np.maximum(distance, 0.0) / width**2))


def _spread_out(x: Array, most: int) -> Array:
    """Return points of x, shape (n, c), each as far as possible from those before."""
    chosen = [int(np.argmin((x**2).sum(1)))]
    nearest = ((x - x[chosen[0]]) ** 2).sum(1)
    while len(chosen) < min(most, len(x)):
        chosen.append(int(np.argmax(nearest)))
        nearest = np.minimum(nearest, ((x - x[chosen[-1]]) ** 2).sum(1))
    return x[chosen]


def _scales(left: Array, transience: Array) -> Array:
    """Return the usual size of every balance's residual in its class of transience, shape (B, K) [kg/s]."""
    scale = np.empty(left.shape)
    for each in np.unique(transience):
        on = transience == each
        away = np.abs(left[:, on] - np.median(left, axis=1)[:, None])
        scale[:, on] = np.maximum(1.4826 * np.median(away, axis=1), 1e-9)[:, None]
    return scale


def _regression(features: Array, left: Array, scale: Array, part: NDArray[np.int64]) -> tuple[Array, Array]:
    """Return the weights of one balance, and what is left of it where it is held out, shape (K,) [kg/s].

    The price of a large function is the one that predicts held-out parts best; without any function they are predicted by none.
    """
    rows = {
        p: (features[:, part == p] / scale[part == p, None], left[:, part == p] / scale[part == p])
        for p in np.unique(part)
    }
    gram = {p: np.einsum("vkm,vkn->mn", x, x) for p, (x, _) in rows.items()}
    right = {p: np.einsum("vkm,vk->m", x, y) for p, (x, y) in rows.items()}
    whole, total = sum(gram.values()), sum(right.values())
    best = (np.inf, np.zeros(features.shape[2]), left.mean(0))
    for price in thresholds.BELL_PRICES:
        ridge, held_out = price * np.eye(features.shape[2]), np.empty(part.size)
        for p in rows:
            own = np.linalg.solve(whole - gram[p] + ridge, total - right[p])
            held_out[part == p] = (left[:, part == p] - features[:, part == p] @ own).mean(0)
        error = float(np.mean(np.minimum(np.abs(held_out / scale), thresholds.FAR) ** 2))
        if error < best[0]:
            best = error, np.asarray(np.linalg.solve(whole + ridge, total)), held_out
    return best[1:]


def _lasting(problem: Problem, z: Array) -> float:
    """Return the variance of sums of errors in units of their scale over that of as many independent ones, at the worst length."""
    z, found = np.clip(z, -thresholds.FAR, thresholds.FAR), [1.0]
    for length in thresholds.LASTS:
        stretch = (problem.clock // length).astype(np.int64)
        first = np.flatnonzero(np.diff(stretch, prepend=-1))
        number = np.diff(np.append(first, z.size))
        found.append(float(np.mean(np.add.reduceat(z, first) ** 2 / number) / max(np.mean(z**2), np.finfo(float).tiny)))
    return max(found)
