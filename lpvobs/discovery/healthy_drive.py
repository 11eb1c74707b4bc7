"""What the balances leave on healthy drives, so that another drive is asked for what has changed.

No engine is its model. What a balance leaves is a smooth function of the signals, the same on all drives, and errors that last all
day, for minutes, or a few instants; their variances are those of largest likelihood. The function is taken off the residual of
another drive. What is not known of it, and the slow errors, are unknowns of that drive's search with the covariance that healthy
drives leave; the fast error widens the noise. Where an effect corrects a channel, the function goes along by its derivative.

The function is a Gaussian process: bells over the channels around instants of the healthy drives, and a line over their rates,
since sensors that are slow when the engine is healthy stay slow. Where a drive goes elsewhere the bells end, and what the
function would have said counts as noise.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, Any, NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from lpvobs.discovery import thresholds
from lpvobs.discovery.imbalances import imbalances_at, map_along, operating_nodes, rests_on, scenes_with
from lpvobs.discovery.patterns import Patterns, Seeming
from lpvobs.discovery.residual import MapPrior, Problem
from lpvobs.engines.effects import SENSOR
from lpvobs.engines.residual_model import ResidualModel
from lpvobs.records import Array, Item


@dataclass(frozen=True, eq=False)
class HealthyDrive:
    """What B balances leave over c channels and r rates, with m bells."""

    logs: tuple[str, ...]  # the healthy drives that it was learned from
    balances: Annotated[tuple[str, ...], Item("1", "balance", name="balance")]
    channels: Annotated[
        tuple[str, ...], Item("1", "channel over which the bell-shaped functions are placed", name="channel")
    ]
    rates: tuple[str, ...]  # channels whose rates have a line
    middle: Annotated[Array, Item("SI", "mean of each channel and of each rate", ("input",))]
    spread: Annotated[Array, Item("SI", "standard deviation of each channel and of each rate", ("input",))]
    centres: Annotated[
        Array, Item("1", "middle of a bell, in standard deviations from the channel's mean", ("bell", "channel"))
    ]
    width: Annotated[float, Item("1", "width of a bell, in standard deviations of the channel")]
    weights: Annotated[
        Array, Item("kg/s", "weight of each bell and each line in the residual of a balance", ("balance", "feature"))
    ]
    amplitude: Annotated[
        Array, Item("kg/s", "rms of the weighted bells and lines along the healthy drives", ("balance",))
    ]
    scale: Annotated[Array, Item("kg/s", "usual size of the residual that bells and lines leave", ("balance",))]
    lasting: Annotated[
        Array,
        Item("s", "time between independent errors whose sum would vary as that of the fast errors", ("balance",)),
    ]
    unsure: Annotated[
        Array, Item("kg/s", "square root of the weights' covariance", ("balance", "feature", "other_feature"))
    ]
    slow: Annotated[
        Array, Item("kg/s", "standard deviation of the error that lasts all day, and for minutes", ("balance", "error"))
    ]
    effects: Annotated[tuple[str, ...], Item("1", "effect of the catalogue", name="effect")]
    whole: Annotated[
        Array, Item("1", "standard deviation beyond noise of its size on healthy drives, in its unit", ("effect",))
    ]
    late: Annotated[Array, Item("1", "the same where it acts from the middle of a drive on", ("effect",))]
    beyond: Annotated[Array, Item("1", "variance of its size over that of noise, by independent residual", ("effect",))]
    common: Annotated[float, Item("1", "the same of all effects together")] = 0.0
    uneven: Annotated[
        float, Item("1", "largest variance over blocks of the score of an effect, over that of noise")
    ] = 1.0

    @property
    def spacing(self) -> float:
        """Distance of instants [s] that tells all: every other one, where all errors that are known last as long."""
        known = self.lasting[self.amplitude > 0.0]
        every = 2.0 if known.min(initial=np.inf) >= 2.0 * thresholds.SPACING else 1.0
        return every * thresholds.SPACING

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

    def along(self, problem: Problem) -> Array:
        """Return the features along a problem, shape (K, m + r): the mean of both views."""
        return np.asarray(np.mean([self.features(view) for view in self.inputs(problem)], axis=0))

    def expected(self, problem: Problem, features: Array) -> tuple[Array, Array]:
        """Return what a healthy engine leaves [kg/s], and the variance of its errors beyond, over that of white noise, (B, K)."""
        known = np.clip((features[:, : len(self.centres)] ** 2).sum(1), 0.0, 1.0)
        unsure = np.outer((self.amplitude / self.scale) ** 2, 1.0 - known)
        lasting = np.maximum(self.lasting / problem.spacing, 1.0)
        return self.weights @ features.T, lasting[:, None] * (1.0 + unsure)

    def taken_off(self, problem: Problem) -> Problem:
        """Return the problem that asks for what has changed, for any width of the windows."""
        problem = where_the_map_stands(problem)
        features = self.along(problem)
        expected, wider = self.expected(problem, features)
        patterns = Patterns(tuple(self._slow(problem, features, b, wider[b]) for b in range(len(self.balances))))
        found = replace(
            problem,
            offset=problem.offset - expected,
            lasting=problem.lasting * wider,
            patterns=patterns,
            seeming=self._seeming(problem),
            follows=self._follows(problem),
            covariance=scipy.linalg.block_diag(problem.covariance, np.eye(len(patterns))),
        )

        def wide() -> Problem:
            return replace(self.taken_off(problem.wider()), patterns=patterns, covariance=found.covariance)

        return replace(found, wider=wide)

    def _follows(self, problem: Problem) -> Mapping[str, tuple[Array, Array]]:
        """Return the derivatives of what a healthy engine leaves by value and rate of each channel but the sensor, (B, K)."""
        inputs, c, m = self.inputs(problem).mean(0), len(self.channels), len(self.centres)
        here, bells = inputs[:, :c], _bells(inputs[:, :c], self.centres, self.width)
        slopes = np.empty((len(self.balances), *inputs.shape))
        for slope, weights, lines in zip(slopes, self.weights[:, :m] @ self._root, self.weights[:, m:], strict=True):
            pulled = bells * weights
            slope[:, :c] = (pulled @ self.centres - pulled.sum(1)[:, None] * here) / self.width**2
            slope[:, c:] = lines
        slopes = np.moveaxis(slopes * (np.abs(inputs) < thresholds.FAR) / self.spread, 2, 0)
        by_rate = dict(zip(self.rates, slopes[c:], strict=True))
        return {name: (by_value, by_rate[name]) for name, by_value in zip(self.channels, slopes[:c], strict=True)}

    def _seeming(self, problem: Problem) -> Seeming:
        """Return what a healthy engine seems to have of every effect, and of what acts in the place of some: their mean."""
        whole, late, each = (
            dict(zip(self.effects, x.tolist(), strict=True)) for x in (self.whole, self.late, self.beyond)
        )
        known = [effect for effect in problem.catalogue if effect.id in each]
        in_place = {effect.place: [each[e.id] for e in known if e.place == effect.place] for effect in known}
        places = {place: float(np.mean(own)) for place, own in in_place.items()}
        return Seeming(whole, late, each, places, self.common, self.uneven, len(self.logs) + thresholds.POOLED)

    def _slow(self, problem: Problem, features: Array, b: int, wider: Array) -> Array:
        """Return what the slow error of a balance may look like, independent and of unit size, as far as data tell, (m, K)."""
        each = zip(self.slow[b], (_logs(problem), _minutes(problem)), strict=True)
        every = np.hstack([features @ self.unsure[b], *(size * columns for size, columns in each)])
        every = every * problem.shown[b][:, None]
        strength, modes = np.linalg.eigh(every.T @ (every / (self.scale[b] ** 2 * wider)[:, None]))
        return np.ascontiguousarray((every @ modes[:, strength > thresholds.TOLD]).T)

    def unchanged(self, model: ResidualModel) -> ResidualModel:
        """Return the engine as it was on the healthy drives: nothing of it is unknown."""
        constants = model.with_unknowns(np.zeros(len(model.names)))
        return replace(
            model,
            names=(),
            adding=0,
            covariance=np.zeros((0, 0)),
            with_unknowns=lambda _: constants,
            by_unknowns=None,
        )


def where_the_map_stands(problem: Problem) -> Problem:
    """Return the problem without the places whose map was not estimated: what is left there has the sensor's own error in it."""
    nodes = operating_nodes(problem, scenes_with(problem, (), np.zeros(problem.spread.size)))
    return replace(problem, shown=problem.shown & rests_on(problem.prior.estimated, nodes))


def unmoved(prior: MapPrior) -> MapPrior:
    """Return a map that stands beside an engine of which nothing is unknown."""
    return replace(prior, sensitivity=prior.sensitivity[:, :0])


def learned_from(problem: Problem, logs: Sequence[str]) -> tuple[HealthyDrive, ...]:
    """Return what healthy drives show, laid out with the map and the engine that they made, and the same without each of several.

    The width of the bells is the best of some, the variances are the likeliest of all drives.
    """
    problem = where_the_map_stands(problem)
    B, K = problem.shown.shape
    scenes = scenes_with(problem, (), np.zeros(problem.spread.size))
    left = imbalances_at(problem, scenes, np.zeros(problem.spread.size)).reshape(B, 2, K)
    left = left - (problem.by_reading * map_along(problem.prior.mean, operating_nodes(problem, scenes)))[:, None]
    found, shares = [], (_START,) * B
    for width in thresholds.BELL_WIDTHS:
        bare = _bare(problem, logs, width)
        features = np.stack([bare.features(view) for view in bare.inputs(problem)])
        weights = (np.zeros(features.shape[2]),) * B
        for _ in range(thresholds.PASSES):
            scale = _scales(left.mean(1) - np.array(weights) @ features.mean(0).T, problem)
            rows = zip(problem.shown, left, scale, shares, strict=True)
            shares, weights, unlikely = zip(*(_likeliest(problem, features, *row) for row in rows), strict=True)
        found.append((sum(unlikely), bare, features, scale, shares))
    _, bare, features, scale, shares = min(found, key=lambda item: item[0])

    told = [_told(problem, features, *row) for row in zip(problem.shown, left, scale, shares, strict=True)]

    def of(numbers: Sequence[int]) -> HealthyDrive:
        shown = problem.shown & np.isin(problem.of_log, numbers)
        own = _LearnedBalance(*map(np.array, zip(*(_learned(each, numbers) for each in told), strict=True)))
        rest = _scales(left.mean(1) - own.weights @ features.mean(0).T, problem)
        return replace(
            bare, logs=tuple(logs[i] for i in numbers), weights=own.weights, amplitude=own.amplitude, unsure=own.unsure,
            scale=np.array([np.median(row[on]) if on.any() else 1.0 for row, on in zip(rest, shown, strict=True)]),
            slow=own.slow, lasting=problem.spacing * own.lasting,
        )  # fmt: skip

    everyone = range(len(logs))
    return of(everyone), *(of([i for i in everyone if i != own]) for own in everyone if len(logs) > 1)


class _Told(NamedTuple):
    """What each of L logs tells of the function in one balance, at the given variances, beside its own slow errors."""

    pieces: NDArray[np.int64]  # number of stretches of `PIECE`, (L,)
    precision: Array  # (L, m, m)
    gradient: Array  # (L, m)
    sizes: Array  # of the function and of the slow errors, (3,) [kg/s]
    lasting: float  # variance of the fast error over that of white noise


class _LearnedBalance(NamedTuple):
    """What is learned of one balance, or of each along a further axis."""

    weights: Array
    unsure: Array
    amplitude: Any
    lasting: Any
    slow: Array


_START = np.array([1.0, 0.0, *np.log([thresholds.SLOW_SHARE] * 2)])
_LEAST_PIECES = 10  # pieces below which nothing is learned of a balance


def _pieces(problem: Problem, shown: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return where a new stretch of `PIECE` begins among the places where a balance counts."""
    return np.flatnonzero(np.diff((problem.clock[shown] // thresholds.PIECE).astype(np.int64), prepend=-1))


def _likeliest(
    problem: Problem, features: Array, shown: NDArray[np.bool_], left: Array, scale: Array, start: Array = _START
) -> tuple[Array, Array, float]:
    """Return what means over `PIECE` say of a balance where it counts; `left` and `scale` have shapes (2, K) and (K,).

    That is the logarithms of the variances of largest likelihood, of the fast error, the function, and the slow ones; the weights
    of the function; and the negative logarithm of that likelihood.
    """
    first, m = _pieces(problem, shown), features.shape[2]
    if first.size < _LEAST_PIECES:
        return start, np.zeros(m), 0.0
    weight, usual = scale[shown] ** -2.0, float(np.median(scale[shown]))
    total = np.add.reduceat(weight, first)

    def mean(values: Array) -> Array:
        return np.asarray((np.add.reduceat((values[shown].T * weight).T, first, axis=0).T / total).T)

    y, slow = mean(left.mean(0)), (_logs(problem), _minutes(problem))
    means = usual * np.hstack([mean(columns) for columns in (features.mean(0), *slow)])
    of = np.repeat([0, 1, 2], [m, *(columns.shape[1] for columns in slow)])
    gram, seen, alone = means.T @ (total[:, None] * means), means.T @ (total * y), float(y @ (total * y))

    def posterior(x: Array) -> tuple[Array, Array, Array]:
        # cov(y) = e^x_0 / total + M S^2 M', where S has e^(x_i / 2) for the columns of kind i. By Woodbury, in as many
        # dimensions as there are columns: B = 1 + e^-x_0 S M' total M S, and B^-1 is the covariance of their sizes.
        S = np.exp(0.5 * x[1:])[of]
        factor = scipy.linalg.cholesky(np.eye(of.size) + np.exp(-x[0]) * np.outer(S, S) * gram, lower=True)
        return S, factor, np.exp(-x[0]) * scipy.linalg.cho_solve((factor, True), S * seen)

    def unlikely(x: Array) -> tuple[float, Array]:
        S, factor, sizes = posterior(x)
        known = 1.0 - (scipy.linalg.solve_triangular(factor, np.eye(of.size), lower=True) ** 2).sum(0)
        misfit = np.exp(-x[0]) * float(alone - sizes @ (S * seen))
        away = (x[1:] - np.log(thresholds.SLOW_SHARE)) / thresholds.SLOW_SPREAD
        own = misfit + y.size * x[0] - np.log(total).sum() + 2.0 * np.log(np.diag(factor)).sum() + away @ away
        fast = y.size - known.sum() - misfit + sizes @ sizes
        others = np.bincount(of, known - sizes**2, minlength=3) + 2.0 * away / thresholds.SLOW_SPREAD
        return 0.5 * float(own), 0.5 * np.array([fast, *others])

    bounds = [(0.0, 6.0), *[(-9.0, 4.0)] * 3]
    best = scipy.optimize.minimize(unlikely, start, jac=True, method="L-BFGS-B", bounds=bounds)
    S, _, sizes = posterior(best.x)
    return best.x, usual * (S * sizes)[:m], float(best.fun)


def _told(
    problem: Problem, features: Array, shown: NDArray[np.bool_], left: Array, scale: Array, shares: Array
) -> _Told:
    """Return what the instants at which a balance counts tell of its function; arguments as of `_likeliest`.

    `shares` are the logarithms of the variances that means over `PIECE` show.
    """
    numbers, m = np.unique(problem.of_log), features.shape[2]
    lasting, *variances = np.exp(shares)
    sizes = (np.median(scale[shown]) if shown.any() else 1.0) * np.sqrt(variances)
    pieces = np.bincount(problem.of_log[shown][_pieces(problem, shown)], minlength=numbers.size)
    precision, gradient = np.zeros((numbers.size, m, m)), np.zeros((numbers.size, m))
    for i in numbers[pieces > 0]:
        on = shown & (problem.of_log == i)
        slow = np.hstack([np.full((on.sum(), 1), sizes[1]), sizes[2] * _memory(problem, i)[on[problem.of_log == i]]])
        root = np.sqrt(0.5 / lasting) / np.tile(scale[on], 2)
        rows = root[:, None] * np.concatenate([np.hstack([sizes[0] * view[on], slow]) for view in features])
        gram, seen = rows.T @ rows, rows.T @ (root * left[:, on].ravel())
        of_slow = np.linalg.solve(gram[m:, m:] + np.eye(slow.shape[1]), gram[m:, :m]).T
        precision[i] = gram[:m, :m] - of_slow @ gram[m:, :m]
        gradient[i] = seen[:m] - of_slow @ seen[m:]
    return _Told(pieces, precision, gradient, sizes, float(lasting))


def _learned(told: _Told, logs: Sequence[int]) -> _LearnedBalance:
    """Return what a balance leaves on some logs, as a function that is the same on all of them, and the errors beyond."""
    m = told.gradient.shape[1]
    if told.pieces[logs].sum() < _LEAST_PIECES:
        return _LearnedBalance(np.zeros(m), np.zeros((m, m)), 0.0, 1.0, np.zeros(2))
    size, *slow = told.sizes
    precision = told.precision[logs].sum(0) + np.eye(m)
    weights = size * np.linalg.solve(precision, told.gradient[logs].sum(0))
    unsure = size * np.linalg.cholesky(np.linalg.inv(precision))
    return _LearnedBalance(weights, unsure, float(size), told.lasting, np.array(slow))


def _bare(problem: Problem, logs: Sequence[str], width: float) -> HealthyDrive:
    """Return where the bells stand, along what the drives have visited, before anything is learned."""
    s, none = problem.signals, np.zeros(0)
    moving = tuple(name for name in problem.measured if np.std(s[name]) > thresholds.STANDS * np.abs(np.mean(s[name])))
    channels = tuple(name for name in moving if name != SENSOR)
    along = np.stack([*(s[name] for name in channels), *(s.rate[name] for name in moving)], axis=1)
    bare = HealthyDrive(
        logs=tuple(logs), balances=problem.model.balances, channels=channels, rates=moving, middle=along.mean(0),
        spread=along.std(0), centres=np.zeros((0, len(channels))), width=width * float(np.sqrt(len(channels))),
        weights=none, amplitude=none, scale=none, lasting=none, unsure=none, slow=none,
        effects=(), whole=none, late=none, beyond=none,
    )  # fmt: skip
    visited = bare.inputs(problem)[0][problem.shown.any(axis=0), : len(channels)]
    return replace(bare, centres=_spread_out(visited, thresholds.BELLS))


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


def _scales(left: Array, problem: Problem) -> Array:
    """Return the usual size of every balance's residual in its class of transience, (B, K) [kg/s], where the balance counts."""
    scale = np.ones(left.shape)
    for row, shown, own in zip(left, problem.shown, scale, strict=True):
        for each in np.unique(problem.transience[shown]):
            on = shown & (problem.transience == each)
            alike = on if on.sum() >= thresholds.LEAST_VISIT else shown
            own[on] = max(1.4826 * float(np.median(np.abs(row[alike] - np.median(row[shown])))), 1e-9)
    return scale


def _logs(problem: Problem) -> Array:
    """Return one for the places of each log, shape (K, logs)."""
    return np.asarray(problem.of_log[:, None] == np.unique(problem.of_log), dtype=float)


def _minutes(problem: Problem) -> Array:
    """Return features of what lasts for minutes, of unit variance, shape (K, knots), of one log after the other."""
    return np.asarray(scipy.linalg.block_diag(*(_memory(problem, i) for i in np.unique(problem.of_log))))


def _memory(problem: Problem, log: int) -> Array:
    """Return the features of one log, along its own places: a memory, straight between knots."""
    t = problem.clock[problem.of_log == log]
    knots = np.linspace(t[0], t[-1], max(2, round(2.0 * (t[-1] - t[0]) / thresholds.MEMORY)))
    root = np.linalg.cholesky(np.exp(-np.abs(knots[:, None] - knots) / thresholds.MEMORY))
    return np.stack([np.interp(t, knots, column) for column in root.T], axis=1)
