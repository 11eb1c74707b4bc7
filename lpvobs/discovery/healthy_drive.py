"""What the balances leave on healthy drives, so that another drive is asked for what has changed.

No engine is its model. The constants are those that all balances of the healthy drives show. What a balance leaves then is a
smooth function of the signals, the same on all drives, and errors beside it; their variances are those of largest likelihood.
Some last for a few instants, some for minutes, and some all day: a level, and a smooth function that is another one every day.
The function is taken off the residual of another drive. What is not known of it, and the slow errors, are unknowns of that
drive's search with the covariance that healthy drives leave. So are those combinations of the engine's constants that the drive
can show; where the healthy drives have been, too, the function goes along with the constants, and their effect cancels. So does
an error of the map: what healthy drives tell at a node is the sum of both. The fast error widens the noise. Where an effect
corrects a channel, the function goes along by its derivative.

The function is a Gaussian process: bells over the channels around instants of the healthy drives, and a line over their rates,
and over what the balance changes by where a temperature is late: sensors that are slow when the engine is healthy stay slow. How
far a bell reaches along each channel is what makes the drives likeliest, for every balance: the ambient pressure of six days says
little of a seventh. Where a drive goes elsewhere the bells end. What the function would have said there is unknown, and the same
as long as the drive stays: bells around these places are further unknowns of its search. What they lack counts as noise.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Annotated, Any

import numpy as np
import scipy

from lpvobs.discovery import thresholds
from lpvobs.discovery.bells import Bells
from lpvobs.discovery.imbalances import imbalances_at, operating_nodes, rests_on, scenes_with
from lpvobs.discovery.lateness import late_by, slopes_of_lateness
from lpvobs.discovery.patterns import Patterns, Seeming
from lpvobs.discovery.residual import Problem
from lpvobs.engines.effects import Effect
from lpvobs.engines.residual_model import ResidualModel
from lpvobs.records import Array, Item


@dataclass(frozen=True, eq=False)
class HealthyDrive:
    """What B balances leave over c channels and r rates."""

    logs: tuple[str, ...]  # the healthy drives that it was learned from
    balances: Annotated[tuple[str, ...], Item("1", "balance", name="balance")]
    channels: tuple[str, ...]  # those that the bells stand over
    rates: tuple[str, ...]  # channels whose rates have a line
    temperatures: Annotated[tuple[str, ...], Item("1", "temperature, whose sensor may be slow", name="temperature")]
    middle: Annotated[Array, Item("SI", "mean of each channel and of each rate", ("input",))]
    spread: Annotated[Array, Item("SI", "standard deviation of each channel and of each rate", ("input",))]
    late: Annotated[
        Array,
        Item("kg/s^2", "usual change of a balance by a second by which one is late", ("balance", "temperature")),
    ]
    bells: Annotated[tuple[Bells, ...], Item("1", "function of a balance")]
    amplitude: Annotated[Array, Item("kg/s", "standard deviation of the function before any data", ("balance",))]
    scale: Annotated[Array, Item("kg/s", "usual size of the residual that bells and lines leave", ("balance",))]
    lasting: Annotated[
        Array,
        Item("s", "time between independent errors whose sum would vary as that of the fast errors", ("balance",)),
    ]
    missed: Annotated[
        Array, Item("1", "share of the function's variance that its bells lack on these drives", ("balance",))
    ]
    slow: Annotated[
        Array, Item("kg/s", "standard deviation of the errors that last all day, and for minutes", ("balance", "error"))
    ]
    of_map: Annotated[
        Array,
        Item(
            "s^2/kg^2", "information on the sum of the map's error and what the balances leave", ("node", "other_node")
        ),
    ]
    deviation: Annotated[
        Array,
        Item("1", "deviation of each of the engine's unknowns from the value beside the map, relative", ("unknown",)),
    ]
    covariance: Annotated[Array, Item("1", "covariance of these deviations", ("unknown", "other_unknown"))]
    effects: Annotated[
        tuple[str, ...], Item("1", "effect, curve of a component, or what a form follows", name="effect")
    ]
    whole: Annotated[
        Array,
        Item("1", "standard deviation beyond noise of its size on healthy drives, in its unit", ("effect",), gaps=True),
    ]
    half: Annotated[Array, Item("1", "the same where it acts from the middle of a drive on", ("effect",), gaps=True)]
    beyond: Annotated[Array, Item("1", "variance of its size over that of noise, by independent residual", ("effect",))]
    searched: Annotated[
        Array,
        Item(
            "1",
            "gain of its best onset on a healthy drive, over that in noise: one end, two",
            ("effect", "ends"),
            gaps=True,
        ),
    ]
    common: Annotated[float, Item("1", "the same of all effects together")] = 0.0
    seconds: Annotated[float, Item("s", "length of a healthy drive, on average")] = thresholds.HEALTHY_SECONDS
    uneven: Annotated[
        float, Item("1", "largest variance over blocks of the score of an effect, over that of noise")
    ] = 1.0

    def __post_init__(self) -> None:
        if len(self.bells) != len(self.balances):
            raise ValueError(f"it has {len(self.bells)} functions for {len(self.balances)} balances")

    @property
    def spacing(self) -> float:
        """Distance of instants [s]: up to twice the usual one, where all known errors last so long that no balance loses much."""
        lasting = float(self.lasting[self.amplitude > 0.0].min(initial=np.inf))
        return float(np.clip(lasting / thresholds.TAKEN, thresholds.SPACING, 2.0 * thresholds.SPACING))

    def engine(self, model: ResidualModel) -> ResidualModel:
        """Return the engine as the healthy drives show it, from the one beside the map."""
        return model.moved(self.deviation, self.covariance)

    def inputs(self, problem: Problem) -> Array:
        """Return values and rates in spreads from the middle, and what each balance changes by where t temperatures are late.

        The shape is (B, 2, K, c + r + t). The views change places: the noise of a signal is in the residual of its own view, and
        independent of the other's.
        """
        s, K = problem.signals, problem.K
        values = (problem.over_all(name, usual) for name, usual in zip(self.channels, self.middle, strict=False))
        along = np.stack([*values, *(s.rate[name] for name in self.rates)], axis=1)
        scaled = np.broadcast_to((along - self.middle) / self.spread, (len(self.balances), *along.shape))
        late = late_by(problem, self.temperatures) / self.late[:, :, None]
        every = np.clip(np.concatenate([scaled, late.swapaxes(1, 2)], axis=2), -thresholds.FAR, thresholds.FAR)
        return np.asarray(every.reshape(len(every), 2, K, -1)[:, ::-1])

    def along(self, problem: Problem) -> Iterator[Array]:
        """Yield bells and lines of each balance along a problem, shape (K, m + r): the mean of both views.

        One after the other, since an hour has up to 70 MB of each.
        """
        for bells, (one, other) in zip(self.bells, self.inputs(problem), strict=True):
            along = bells.along(one)
            along += bells.along(other)
            along *= 0.5
            yield along

    def expected(self, problem: Problem) -> Array:
        """Return what a healthy engine leaves [kg/s], the same where nothing changes, and the variance of its errors, (3, B, K).

        The variance of the errors beyond is in that of white noise.
        """
        views, each = self.inputs(problem), enumerate(self.along(problem))
        return np.array([self._expected(problem, views[b], along, b)[0] for b, along in each]).swapaxes(0, 1)

    def _expected(
        self, problem: Problem, views: Array, along: Array, b: int
    ) -> tuple[tuple[Array, Array, Array], Array]:
        """Return what `expected` has of one balance, and features of the function where no healthy drive has been, (K, n)."""
        bells = self.bells[b]
        new = bells.elsewhere(views, along, self.missed[b])
        # what the bells lack on healthy drives is in the errors there
        beyond = np.maximum(bells.missed(views, along) - (new**2).sum(1) - self.missed[b], 0.0)
        unsure = (self.amplitude[b] / self.scale[b]) ** 2 * beyond
        wider = max(self.lasting[b] / problem.spacing, 1.0) * (1.0 + unsure)
        return (along @ bells.weights, bells.steady(along), wider), new

    def taken_off(self, problem: Problem, modes: Array | None = None) -> Problem:
        """Return the problem that asks for what has changed, for any width of the windows.

        `modes` are the `Problem.modes` of another problem whose unknowns it shares.
        """
        problem = self._where_known(problem)
        answers, learned = by_constants(problem), self._by_constants(problem)
        views, each, slow = self.inputs(problem), [], []
        for b, along in enumerate(self.along(problem)):
            found, new = self._expected(problem, views[b], along, b)
            each.append(found)
            slow.append(self._slow(problem, along, new, b, found[-1]))
        expected = np.array(each).swapaxes(0, 1)
        modes = self._shown_modes(problem, answers - learned, expected[-1]) if modes is None else modes
        model = _in_modes(problem.model, modes, answers - learned)
        learned = np.tensordot(modes[: len(learned)].T, learned, 1)
        return self._beside_healthy(problem, modes, learned, model, Patterns(tuple(slow)), expected)

    def _where_known(self, problem: Problem) -> Problem:
        """Return the problem where the map stands, without balances of which the healthy drives showed too little."""
        problem = where_the_map_stands(problem)
        return replace(problem, shown=problem.shown & (self.amplitude > 0.0)[:, None])

    def _by_constants(self, problem: Problem) -> Array:
        """Return the derivatives of what was learned by the engine's n constants, shape (n, B, 2K).

        With other constants the healthy drives would have left something else, and what both drives show of a constant cancels.
        """
        every = zip(self.bells, self.inputs(problem), strict=True)
        each = [[bells.along(view) @ bells.by_constant for view in views[::-1]] for bells, views in every]
        return np.array([np.concatenate(views) for views in each]).transpose(2, 0, 1)

    def _beside_healthy(
        self, problem: Problem, modes: Array, learned: Array, model: ResidualModel, patterns: Patterns, healthy: Array
    ) -> Problem:
        """Return the problem less what a healthy engine leaves, as `expected` has it, with these unknowns of engine and errors."""
        (expected, steady, wider), q = healthy, len(problem.model.names)

        def again() -> Problem:
            wide = self._where_known(problem.wider())
            return self._beside_healthy(wide, modes, learned, model, patterns, self.expected(wide))

        return replace(
            problem,
            model=model,
            modes=modes,
            prior=replace(problem.prior, sensitivity=problem.prior.sensitivity @ modes),
            of_map=self.of_map,
            offset=problem.offset - expected,
            left=steady,
            learned=learned,
            bounded=True,
            lasting=problem.lasting * wider,
            patterns=patterns,
            seeming=self._seeming(problem),
            follows=self._follows(problem),
            covariance=scipy.linalg.block_diag(model.covariance, problem.covariance[q:, q:], np.eye(len(patterns))),
            wider=again,
        )

    def _shown_modes(self, problem: Problem, answers: Array, wider: Array) -> Array:
        """Return the combinations of the engine's unknowns, of unit variance, that move this drive's residual, shape (q, m).

        They do so by more than `TOLD` of its noise; the map moves with them. Corrections of a calibrated engine stay as they are:
        they are functions of the channels, as the bells are. `answers` are those to the n constants.
        """
        root, n = root_of_constants(problem.model), len(answers)
        both = with_map(problem, answers)
        moved = 0.5 * (both[..., : problem.K] + both[..., problem.K :])
        rows = (moved * problem.shown / (self.scale[:, None] * np.sqrt(wider))).reshape(n, problem.shown.size)
        strength, modes = np.linalg.eigh(root[:n].T @ rows @ rows.T @ root[:n])
        return np.asarray(root @ modes[:, strength > thresholds.TOLD])

    def _follows(self, problem: Problem) -> Mapping[str, tuple[Array, Array]]:
        """Return the derivatives of what a healthy engine leaves by value and rate of each channel but the sensor, (B, K)."""
        c, r, names = len(self.channels), len(self.rates), self.temperatures
        every = zip(self.bells, self.inputs(problem), strict=True)
        each = np.array([0.5 * sum(bells.slopes(view) for view in views) for bells, views in every])
        slopes = each.transpose(2, 0, 1)  # (c + r + t, B, K)
        slopes[: c + r] /= self.spread[:, None, None]
        slopes[c + r :] /= self.late.T[:, :, None]
        by_value = dict(zip(self.channels, slopes[:c], strict=True))
        by_rate = dict(zip(self.rates, slopes[c : c + r], strict=True))
        for name, slope, (of_value, of_rate) in zip(
            names, slopes[c + r :], slopes_of_lateness(problem, names), strict=True
        ):
            by_value[name], by_rate[name] = by_value[name] + slope * of_value, by_rate[name] + slope * of_rate
        return {name: (slope, by_rate[name]) for name, slope in by_value.items() if name in by_rate}

    def _seeming(self, problem: Problem) -> Seeming:
        """Return what a healthy engine seems to have of every effect, and of what acts in the place of some: their mean."""
        whole, half, each = (
            {name: float(x) for name, x in zip(self.effects, row, strict=True) if not np.isnan(x)}
            for row in (self.whole, self.half, self.beyond)
        )
        by_onset = zip(self.effects, self.searched, strict=True)
        sized = {name: found for name, found in by_onset if np.isfinite(found).all()}  # of a shape nothing is known
        of_all = {"": np.mean(list(sized.values()), 0)} if sized else {}
        places = {place: float(mean) for place, mean in _by_place(problem.catalogue, each).items()}
        drives = len(self.logs)
        # a further one is learned from where enough of an hour is missing
        most = 1 + int((thresholds.HEALTHY_SECONDS - thresholds.HEALTHY_LEAST) / self.seconds)
        searched = sized | _by_place(problem.catalogue, sized) | of_all
        of_drives = drives + thresholds.POOLED, drives, most, searched
        return Seeming(whole, half, each, places, self.common, self.uneven, *of_drives)

    def _slow(self, problem: Problem, along: Array, new: Array, b: int, wider: Array) -> Array:
        """Return what the slow error of a balance may look like, independent and of unit size, as far as data tell, (m, K)."""
        days = scipy.linalg.khatri_rao(logs_of(problem).T, self.bells[b].of_day(along).T).T
        each = [size * columns for size, columns in zip(self.slow[b], (days, minutes_of(problem)), strict=True)]
        every = np.hstack([along @ self.bells[b].unsure, self.amplitude[b] * new, *each])
        every = every * problem.shown[b][:, None]
        strength, modes = np.linalg.eigh(every.T @ (every / (self.scale[b] ** 2 * wider)[:, None]))
        return np.ascontiguousarray((every @ modes[:, strength > thresholds.TOLD]).T)


def root_of_constants(model: ResidualModel) -> Array:
    """Return a root of the covariance of the engine's n constants where corrections are as they are, shape (q, n)."""
    C, n = model.covariance, len(model.names) - model.adding
    variance, axes = np.linalg.eigh(C[:n, :n] - C[:n, n:] @ np.linalg.solve(C[n:, n:], C[n:, :n]))
    return np.pad(axes * np.sqrt(np.maximum(variance, 0.0)), ((0, model.adding), (0, 0)))


def by_constants(problem: Problem) -> Array:
    """Return the derivatives of the balances by the relative deviation of each of the engine's n constants, shape (n, B, 2K)."""
    model, none = problem.model, np.zeros(problem.spread.size)
    scenes, q = scenes_with(problem, (), none), len(model.names)

    def left(deviation: Array) -> Array:
        constants = model.with_unknowns(deviation)
        return imbalances_at(problem, tuple((on, replace(s, constants=constants)) for on, s in scenes), none)

    here, steps = left(np.zeros(q)), thresholds.STEP * np.eye(q)[: q - model.adding]
    out = np.empty((len(steps), *here.shape))  # not a list of them beside: an hour has 60 MB
    for row, step in zip(out, steps, strict=True):
        row[:] = (left(step) - here) / thresholds.STEP
    return out


def with_map(problem: Problem, answers: Array) -> Array:
    """Return derivatives of the balances by n constants, shape (n, B, 2K), as those of the residual: the map moves, too."""
    nodes = operating_nodes(problem, scenes_with(problem, (), np.zeros(problem.spread.size)))
    by_map = np.einsum("km,kmq->qk", nodes[1], problem.prior.sensitivity[nodes[0], : len(answers)])
    views = answers.reshape(-1, len(problem.shown), 2, problem.K)
    return np.asarray(views - (problem.by_reading * by_map[:, None])[:, :, None]).reshape(answers.shape)


def _in_modes(model: ResidualModel, modes: Array, answers: Array) -> ResidualModel:
    """Return the engine with modes, (q, m), as its unknowns; derivatives by them are taken once, without effects."""
    at, columns = model.with_unknowns, np.tensordot(modes[: len(answers)].T, answers, 1)
    return replace(
        model,
        names=tuple(f"mode {i}" for i in range(len(columns))),
        adding=0,
        covariance=np.eye(len(columns)),
        with_unknowns=lambda sizes: at(modes @ sizes),
        by_unknowns=lambda *_: columns,
    )


def _by_place(catalogue: Iterable[Effect], each: Mapping[str, Any]) -> dict[str, Any]:
    """Return the mean, over effects that act in a place, of what is known by effect."""
    known = [effect for effect in catalogue if effect.id in each]
    places = dict.fromkeys(effect.place for effect in known)
    return {place: np.mean([each[e.id] for e in known if e.place == place], 0) for place in places}


def where_the_map_stands(problem: Problem) -> Problem:
    """Return the problem without the places whose map was not estimated: what is left there has the sensor's own error in it."""
    nodes = operating_nodes(problem, scenes_with(problem, (), np.zeros(problem.spread.size)))
    return replace(problem, shown=problem.shown & rests_on(problem.prior.estimated, nodes))


def logs_of(problem: Problem) -> Array:
    """Return one for the places of each log, shape (K, logs)."""
    return np.asarray(problem.of_log[:, None] == np.unique(problem.of_log), dtype=float)


def minutes_of(problem: Problem) -> Array:
    """Return features of what lasts for minutes, of unit variance, shape (K, knots), of one log after the other."""
    return np.asarray(scipy.linalg.block_diag(*(memory(problem, i) for i in np.unique(problem.of_log))))


def memory(problem: Problem, log: int) -> Array:
    """Return the features of one log, along its own places: a memory, straight between knots."""
    t = problem.clock[problem.of_log == log]
    knots = np.linspace(t[0], t[-1], max(2, round(2.0 * (t[-1] - t[0]) / thresholds.MEMORY)))
    root = np.linalg.cholesky(np.exp(-np.abs(knots[:, None] - knots) / thresholds.MEMORY))
    return np.stack([np.interp(t, knots, column) for column in root.T], axis=1)
