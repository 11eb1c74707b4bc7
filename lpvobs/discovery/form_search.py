"""The sparse search for forms: products of the library against the residual, many at once, then the best of them one by one.

A product of two signals has one of the few that gain most alone. The price counts all products all the same.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy
from numpy.typing import NDArray

from lpvobs.discovery import thresholds
from lpvobs.discovery.evidence import Candidate, best_first, fit_candidate, score, with_best_interval
from lpvobs.discovery.fit import fit, linearised, objective, refit
from lpvobs.discovery.form_gains import Lot
from lpvobs.discovery.forms import (
    NAME,
    TIME,
    Factor,
    Form,
    along_problem,
    carrier_of,
    recorded_at,
    rms,
    rounded,
    shape_of,
)
from lpvobs.discovery.linear import Linear
from lpvobs.discovery.places import moves
from lpvobs.discovery.residual import Problem
from lpvobs.discovery.sizes import slope_of
from lpvobs.engines.effects import SENSOR, Effect
from lpvobs.records import Array

COARSE_STEPS = (0.7, 0.84, 1.19, 1.41)
FINE_STEPS = (0.92, 0.96, 1.04, 1.08)  # factors on the lag of a form that are tried around the best one
LEAST = float(np.sqrt(np.finfo(float).tiny))  # [1] of a channel over its mean, so that it divides others


@dataclass(frozen=True)
class _Tried:
    """A form, and what it gains to first order less its price."""

    score: float
    form: Form
    lot: Lot


@dataclass(frozen=True)
class _Products:
    """What a form is made of, with its means over pools of places: channels are calm, and the products cost less."""

    problem: Problem
    first: NDArray[np.int64]  # (P,) first places of the pools
    names: tuple[str, ...]  # of channels, ratios and the time
    factors: tuple[Factor, ...]  # M factors to try
    count: float  # forms that compete

    @cached_property
    def shapes(self) -> Array:
        """The factors along the pools, shape (M, P)."""
        return np.stack([_along_pools(Form("", (factor,)), self.problem, self.first) for factor in self.factors])

    def price(self, unknowns: Array | int, gain: Array | float) -> Array:
        """Return what a form must gain before it counts: the search, and what the data must tell beside the coefficient."""
        each = thresholds.COST + thresholds.FORM_SHARE * np.asarray(gain)
        return np.asarray(np.log(self.count) + (unknowns - 1) * each)

    def best(self, lot: Lot, start: Form, most: int = thresholds.FORM_RIVALS) -> list[_Tried]:
        """Return the best forms that have one factor more, with or without a reference, each of another signal.

        A product may have a reference of its own. Where its last factor's is farther away than `FORM_REACH`, the form comes behind
        others by the logarithm of the distance.
        """
        several = len(start.factors) > start.relative
        bases = [start, Form(start.target, start.factors[: start.relative])][: 1 + several]
        along = np.stack([_along_pools(replace(base, target=""), self.problem, self.first) for base in bases])
        middle, spread = self.shapes.mean(1), self.shapes.std(1)
        unknowns = np.array([replace(start, factors=(*start.factors, factor)).unknowns for factor in self.factors])
        alone, each = lot.gains(along, self.shapes)
        gains = [alone, *(gain for gain, _ in each)]
        references = [np.zeros((1, middle.size)), *(own for _, own in each)]
        scores = np.stack([gain - self.price(unknowns + i, gain) for i, gain in enumerate(gains)], axis=1)
        reach = np.maximum(thresholds.FORM_REACH * spread, np.finfo(float).tiny)
        with np.errstate(over="ignore"):
            away = [np.abs(own[0] - middle) / reach for own in references]
        scores[away[1] > 1.0, 1] = -np.inf
        scores[:, 2:] -= np.log(np.maximum(np.transpose(away[2:]), 1.0)).reshape(middle.size, -1)
        scores[[factor.of == "rate" for factor in self.factors], 1:] = -np.inf
        scores[spread < thresholds.FORM_FLAT * np.abs(middle), 0] = -np.inf
        if Factor(start.target) in self.factors and not start.factors:  # a share of the reading, which `alone` judges
            scores[self.factors.index(Factor(start.target)), 0] = -np.inf
        found: dict[str, _Tried] = {}
        for at in np.argsort(scores, axis=None)[::-1]:
            i, many = divmod(int(at), len(gains))
            if self.factors[i].signal not in found:
                form = self._with(start, i, *references[many][:, i])
                found[self.factors[i].signal] = _Tried(float(scores[i, many]), form, lot)
            if len(found) == most:
                break
        return list(found.values())

    def _with(self, start: Form, i: int, reference: float, of_product: float = 0.0) -> Form:
        """Return a form with one factor more, its references as round as the drive allows: to a hundredth of what is taken off."""
        own = float(rounded(reference, 0.01 * float(self.shapes[i].std())))
        form = replace(start, factors=(*start.factors, replace(self.factors[i], reference=own)))
        if not of_product:
            return form
        spread = float(_along_pools(form, self.problem, self.first).std())
        return replace(form, reference=float(rounded(of_product, 0.01 * spread)))

    def alone(self, lot: Lot, form: Form) -> _Tried:
        """Return a reading that is off by a constant, or by a share of itself, where the catalogue has no effect on it."""
        at = {"sensor": SENSOR, "fuel": self.problem.model.fuel}
        listed = {e.id for e in self.problem.catalogue}
        listed |= {at.get(e.place, e.place) for e in self.problem.catalogue if e.parameter in ("factor", "offset")}
        if form.target in listed:
            return _Tried(-np.inf, form, lot)
        y = _along_pools(replace(form, target=""), self.problem, self.first)
        gain = float(lot.gains(y[None], np.ones((1, y.size)))[0][0])
        return _Tried(gain - float(self.price(form.unknowns, gain)), form, lot)


def beside_forms(
    linear: Linear, found: Sequence[Candidate], forms: Sequence[Candidate], leader: Candidate | None = None
) -> list[Candidate]:
    """Return all candidates, best first, forms among them; those come first where there is a `leader`."""
    # Where a form leads, forms are sought again with the weights that hold beside it: before, what it explains counts as
    # noise.
    if leader is None and forms and score(forms[0]) > score(found[0]):
        leader = forms[0]
    if leader is None:
        return best_first([*found, *forms])
    beside = fit(linear.problem, [*linear.terms, leader.term], start=linear)
    return [*best_forms(refit(beside, beside.terms[:-1]), found), *found]


def best_forms(linear: Linear, found: Sequence[Candidate]) -> list[Candidate]:
    """Return the most promising forms, best first, with what they gain beside all unknowns, less the price of the search.

    Only those that come close to the best of what has been found are fitted, and one at least.
    """
    problem, plain = linear.problem, linear
    if linear.dense is not None:  # the search takes places as independent, the fit does not
        pointwise = linear.noise.pointwise()
        plain = linearised(problem, linear.terms, linear.theta, linear.beta, pointwise, linear.pinned, linear)
    library = _library(problem)
    starts = [
        _Tried(0.0, form, lot)
        for target in _targets(problem)
        for lot in [_lot(plain, target, library.first)]
        for form in (target, replace(target, factors=(Factor(target.target),)))  # by itself, and a share of a reading
        if not form.factors or target.target in problem.signals.value
    ]
    alone = _leading([library.alone(start.lot, start.form) for start in starts], thresholds.SHORTLIST)
    # an error that moves shows in the reading, unless the truth moves against it
    still = {name for name in problem.measured if not moves(recorded_at(problem, name))}
    moving = [start for start in starts if start.form.target not in still]
    firsts = [(start, library.best(start.lot, start.form, thresholds.FORM_FIRST)) for start in moving]
    pool = [tried for _, ahead in firsts for tried in ahead[: thresholds.FORM_RIVALS]]
    targets = list(dict.fromkeys(tried.form.target for tried in _leading(pool, len(pool))))[: thresholds.SHORTLIST]
    for start, ahead in firsts:
        for name in [each.form.factors[-1].signal for each in ahead if start.form.target in targets]:
            longer = replace(start.form, factors=(*start.form.factors, Factor(name)))
            pool += library.best(start.lot, longer)[:1] if name != start.form.target else []
    leading = _leading(_plainest([*pool, *alone]), thresholds.FORM_TRIED)
    if not leading:
        return []
    least = thresholds.CLOSE * max(leading[0].score, score(found[0]))
    near = [each for each in leading if each.score > thresholds.CLOSE * least] or leading[:1]
    tried = _leading([_refined(plain, library, each.form) if each.form.factors else each for each in near], len(near))
    before = objective(linear)
    return best_first(_fitted(linear, library, t.form, before) for t in tried if t.score > least or t is tried[0])


def shapes_shown(linear: Linear, *begins: float) -> dict[str, list[tuple[float, float]]]:
    """Return gradient and information, in units of noise, of the sensor's error where it follows a factor from each begin on.

    The carrier, an error of the sensor that follows nothing, is free beside it. Names are those of `shape_of`.
    """
    problem, library = linear.problem, _library(linear.problem)
    found: dict[str, list[tuple[float, float]]] = {}
    for relative in (True, False):
        if (carrier := carrier_of(problem.model, relative)) is None:
            continue
        factors = (Factor(SENSOR),) if relative else ()
        y = _along_pools(Form("", factors), problem, library.first)
        seen = [_lot(linear, Form(SENSOR), library.first, begin).beside(y, library.shapes) for begin in begins]
        each = zip(library.factors, np.transpose(seen), strict=True)
        found |= {
            shape_of(carrier, factor)[1]: [(float(z), 1.0) for z in own]
            for factor, own in each
            if np.isfinite(own).all()
        }
    return found


def _leading(tried: Sequence[_Tried], most: int) -> list[_Tried]:
    return sorted((each for each in tried if each.score > -np.inf), key=lambda each: -each.score)[:most]


def _plainest(tried: Sequence[_Tried]) -> list[_Tried]:
    """Return forms without those that have all factors of a better one, and more: a product with what hardly moves is no rival."""
    found: list[tuple[set[tuple[str, str]], _Tried]] = []
    for each in _leading(tried, len(tried)):
        own = {(factor.of, factor.signal) for factor in each.form.factors[each.form.relative :]}
        if not any(better and better < own and each.form.target == other.form.target for better, other in found):
            found.append((own, each))
    return [each for _, each in found]


def _refined(linear: Linear, library: _Products, form: Form) -> _Tried:
    """Return a form with its lag sought more finely, and the reference that goes with it, at every place."""
    each = replace(library, first=np.arange(linear.problem.K))
    lot, start = _lot(linear, Form(form.target), each.first), Form(form.target, form.factors[:-1])
    best = replace(each, factors=(replace(form.factors[-1], reference=0.0),)).best(lot, start)[0]
    for steps in (COARSE_STEPS, FINE_STEPS) if form.factors[-1].of == "lag" else ():
        last = best.form.factors[-1]
        finer = tuple(replace(last, tau=float(f"{last.tau * step:.3g}"), reference=0.0) for step in steps)
        best = (_leading([best, *replace(each, factors=finer).best(lot, start)], 1) or [best])[0]
    return best


def _fitted(linear: Linear, library: _Products, form: Form, start: float) -> Candidate:
    """Return a form as a candidate on its best interval; `start` is the objective without it."""
    problem = linear.problem
    whole = fit_candidate(linear, _effect(form, problem, along_problem(form, problem)))
    best = with_best_interval(linear, whole)
    gain = start - objective(refit(linear, [*linear.terms, best.term]))
    return replace(best, gain=gain - float(library.price(form.unknowns, max(gain, 0.0))))


def _effect(form: Form, problem: Problem, shape: Array) -> Effect:
    catalogued = problem.model.effect(form.target)
    size = catalogued.size if catalogued else thresholds.FORM_NOTICED
    if catalogued is None and not form.relative:
        size *= rms(recorded_at(problem, form.target))
    return form.effect(problem.model, problem.over_columns(shape), size / max(rms(shape), 1e-300))


def _library(problem: Problem) -> _Products:
    """Return every channel that moves, every ratio of two of one unit, and the time, with rates and lags."""
    channels = (*problem.measured, *problem.auxiliary)
    values = {name: recorded_at(problem, name) for name in channels if NAME.fullmatch(name)}
    moving = [name for name, x in values.items() if moves(x)]
    units = problem.model.units
    # a valve that closes without steps comes down to 1e-300 %, and the square of a ratio to it is no number
    positive = [name for name in moving if values[name].min() > LEAST * values[name].mean() and units.get(name)]
    ratios = [f"{a}/{b}" for i, a in enumerate(positive) for b in positive[:i] if units[a] == units[b]]
    names = (*moving, *ratios, TIME)
    dynamic = [Factor(name, "rate") for name in names[:-1]]
    dynamic += [Factor(name, "lag", tau) for name in names[:-1] for tau in thresholds.FORM_LAGS]
    factors = (*(Factor(name) for name in names), *dynamic)
    count = 3.0 * len(problem.measured) * len(names) * len(factors)  # alone, or with one reference or two
    pool = max(1, int(thresholds.FORM_CALM / problem.spacing))
    first = np.flatnonzero((np.diff(problem.of_log, prepend=-1) != 0) | (np.arange(problem.K) % pool == 0))
    return _Products(problem, first, names, factors, count)


def _targets(problem: Problem) -> list[Form]:
    """Return what may be off: every channel, and what a catalogued effect changes in the engine.

    Where healthy drives tell what the engine's model lacks, which is a function of the channels, too, it is the sensor alone.
    """
    if len(problem.patterns):
        return [Form(SENSOR)]
    channels = [name for name in problem.measured if np.isfinite(problem.signals[name]).all()]  # a log may lack one
    readings = {"sensor", "fuel", *channels}
    return [Form(name) for name in (*channels, *(e.id for e in problem.catalogue if e.place not in readings))]


def _along_pools(form: Form, problem: Problem, first: NDArray[np.int64]) -> Array:
    """Return the mean of a form's product over every pool, shape (P,)."""
    return np.asarray(np.add.reduceat(along_problem(form, problem), first) / np.diff(first, append=problem.K))


def _lot(linear: Linear, target: Form, first: NDArray[np.int64], begin: float = -np.inf) -> Lot:
    problem = linear.problem
    effect = _effect(target, problem, np.ones(problem.K))
    white = linear.whiten(slope_of(linear, effect, effect.null) * (problem.clock >= begin))
    signed = white * np.array([1.0, -1.0])[:, None, None]
    nodes, weights = linear.nodes
    on_map = -(linear.mapped * white[0]).sum(0)[:, None] * weights
    pool = np.repeat(np.cumsum(np.isin(np.arange(problem.K), first)) - 1, nodes.shape[1])
    sparse = scipy.sparse.csr_array((on_map.ravel(), (pool, nodes.ravel())), shape=(first.size, linear.p))
    residual, power, columns = (
        np.add.reduceat(x, first, axis=-1)
        for x in ((signed * linear.residual).sum((0, 1)), (signed * white).sum((0, 1)), linear.along(white))
    )
    return Lot(linear, residual, power, columns.T, sparse)
