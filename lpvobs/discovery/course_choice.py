"""When an effect acts and how much of it is there: its onset and end to the instant, whether it comes and goes, its course.

A course is the simplest that the data support, by what it gains less the cost of its parameters.
"""

from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy
from numpy.typing import NDArray

from lpvobs.compiled import njit
from lpvobs.discovery import thresholds
from lpvobs.discovery.courses import GRADED, TracedCourse, can_be_graded, hystereses, in_time, lags, near, on_course
from lpvobs.discovery.curves import channel_candidates
from lpvobs.discovery.evidence import Candidate, best_first, fit_candidate, penalty, score, with_best_interval
from lpvobs.discovery.fit import with_term, without
from lpvobs.discovery.forms import PREFIX
from lpvobs.discovery.linear import Linear, cancels, residual_with
from lpvobs.discovery.ranking import least_gain
from lpvobs.discovery.residual import Problem, Term
from lpvobs.discovery.sizes import slope_of
from lpvobs.engines.effects import Effect
from lpvobs.records import Array


@dataclass(frozen=True, eq=False)
class Bank:
    """Courses to try."""

    courses: tuple[TracedCourse, ...]
    shares: Array  # (m, stretches) means over stretches, which are fine enough for a first look

    def __add__(self, other: "Bank") -> "Bank":
        """Return the courses of both."""
        return Bank((*self.courses, *other.courses), np.concatenate([self.shares, other.shares]))

    @cached_property
    def changes(self) -> Array:
        """The parameters that the data pay for, shape (m,)."""
        return np.array([course.changes for course in self.courses], dtype=float)

    @cached_property
    def kinds(self) -> Mapping[str, NDArray[np.int64]]:
        """The places of the courses of each kind, by its name."""
        names = np.array([course.name for course in self.courses])
        return {name: np.flatnonzero(names == name) for name in dict.fromkeys(names.tolist())}


def best_course(linear: Linear, bare: Linear, own: Candidate, rivals: Sequence[Effect]) -> Candidate:
    """Return the newest effect of a model, or it or a rival on the course that explains the residual better."""
    # `bare` is the model without it. Where a logged channel explains as much as a course without a cause, it is the
    # channel.
    relays = _relays(bare.problem)
    every = relays + _in_time(bare.problem) + _lagging(bare.problem)
    found: list[Candidate] = []
    uneven = own.own_sizes > thresholds.COST + penalty(2, 1, own.gain)  # what two further instants cost
    if uneven and may_have_episodes(own.term.effect, bare.problem):
        intervals = _comes_and_goes(linear, len(linear.terms) - 1)
        found = [fit_course(bare, own.term.effect, course) for course in intervals]
    for effect in with_courses([own.term.effect, *rivals]):
        found += [fit_course(bare, effect, course) for course in _promising(bare, effect, every, relays)]
    same = [c for c in found if _is_same(c, own)]
    # Episodes are many instants, which a share of the gain pays for: they leave what another effect does at times.
    best = max([own, *(c for c in same if c.in_time and c.changes > c.ends)], key=_net)
    for each in (same, found):
        leading = finer(bare, max(each, key=score, default=best))
        best = leading if is_worth(leading, own) and is_worth(leading, best) else best
    if best is not own and best.term.only is not None:
        driven = max(channel_candidates(bare), key=score, default=None)
        if driven is not None and score(driven) > score(best):
            return driven
    return best


def may_have_episodes(effect: Effect, problem: Problem) -> bool:
    """Return whether an effect may come and go.

    A reading of the flow that does may be any disturbance. Without a cause in the log it has no name, except where healthy drives
    tell how the engine's own errors look.
    """
    return bool(with_courses([effect])) and (effect.place != "sensor" or len(problem.patterns) > 0)


def is_worth(course: Candidate, own: Candidate) -> bool:
    """Return whether an effect on a course explains enough more than one that has another course, or none.

    Of the same effect, both leave what it is not quite shaped like, which the time does not tell. What follows an input, or is
    another effect, must gain a share of all.
    """
    if not (_is_same(course, own) and course.in_time):
        return score(course) > thresholds.ADVANTAGE * max(score(own), 0.0)
    return _net(course) > _net(own)


def _net(candidate: Candidate) -> float:
    """Return the gain less what instants, kind and time constant of a course over time cost."""
    other = thresholds.COST * (candidate.changes - candidate.ends)
    return candidate.gain - float(penalty(candidate.ends, candidate.loss.size, 0.0)) - other


def _is_same(one: Candidate, other: Candidate) -> bool:
    """Return whether two candidates are one effect; a drift is a gain that grows."""
    return one.id.replace(".drift", ".gain") == other.id.replace(".drift", ".gain")


def on_courses(bare: Linear) -> list[Candidate]:
    """Return every effect on the course over time and the relay of an input that explain most, best first."""
    # The state of an input that moves slowly is no evidence by itself: what differs from day to day looks like it.
    relays = _relays(bare.problem)
    every = relays + _in_time(bare.problem)
    return best_first(
        finer(bare, fit_course(bare, effect, course))
        for effect in with_courses(bare.problem.catalogue)
        for course in _promising(bare, effect, every, relays)
    )


def with_courses(effects: Iterable[Effect]) -> list[Effect]:
    """Return the effects that may be on a course.

    A drift is one by itself, the factors of a formula are as free as one, and what settles for good does not come and go.
    """
    return [e for e in effects if not (e.id.startswith(PREFIX) or e.id.endswith(".drift") or e.stays)]


def timed_again(linear: Linear, index: int) -> Candidate | None:
    """Return an effect that comes and goes with the intervals that all data show beside the whole model, if there are several."""
    bare = without(linear, index)
    found = (fit_course(bare, linear.terms[index].effect, course) for course in _comes_and_goes(linear, index))
    return max(found, key=score, default=None)


def fit_course(bare: Linear, effect: Effect, course: TracedCourse) -> Candidate:
    """Return an effect on a course at its best size."""
    term = on_places(effect, course, bare.problem)
    return fit_candidate(bare, term.effect, like=term)


def on_places(effect: Effect, course: TracedCourse, problem: Problem) -> Term:
    """Return an effect on a course as a term without a size: confined to places, or there in part in every column."""
    share = problem.share(course)
    if course.name not in GRADED:
        return Term(effect, effect.null, only=share > 0.5, course=course)
    return Term(on_course(effect, problem.over_columns(share)), effect.null, course=course)


def gains(linear: Linear, direction: Array, shares: Array) -> Array:
    """Return the gain of a direction, not whitened, with each of m shares of it by stretch, (m, stretches), shape (m,)."""
    whitened = linear.whiten(direction)
    products, along = linear.along_stretches(direction, whitened)
    along = along - products @ linear.newton_step
    few = len(shares) < len(products)  # the fewer right-hand sides, the sooner it is solved
    right = shares @ products if few else products
    white = scipy.linalg.solve_triangular(linear.factor, right.T, lower=True, check_finite=False).T
    taken = ((white if few else shares @ white) ** 2).sum(1)
    information = linear.noise.powers(direction, whitened, linear.problem.first, shares) - taken
    usable = information > 1e-6 * np.abs(information).max()
    return np.where(usable, 0.5 * (shares @ along) ** 2 / np.where(usable, information, 1.0), 0.0)


def _comes_and_goes(linear: Linear, index: int) -> Iterator[TracedCourse]:
    """Yield the intervals in which an effect of a model explains the residual, if there are several.

    Further episodes and pauses are found one after the other beside all unknowns, which else have taken what is left. Then all
    edges are moved together.
    """
    problem, term = linear.problem, linear.terms[index]
    if problem.of_log[-1] > 0:
        return
    ends = problem.clock[0], float(np.nextafter(problem.clock[-1], np.inf))
    intervals = list(term.course.intervals if term.course else [tuple(np.clip((term.begin, term.end), *ends))])
    for _ in range(thresholds.MOST_SWITCHES):
        further = with_best_interval(linear, fit_candidate(linear, term.effect))
        if score(further) <= 0.0 or not further.changes:
            break
        size, null = linear.terms[index].size, term.effect.null
        span = np.clip((further.term.begin, further.term.end), *ends)
        before, acts = intervals, (further.term.size > null) == (size > null)
        intervals = _with_interval(before, span, acts)
        if intervals == before:
            break
        if not 1 <= len(intervals) <= thresholds.MOST_SWITCHES:
            return
        episodes = on_places(term.effect, TracedCourse("intermittent", intervals=tuple(intervals)), problem)
        linear = with_term(linear, index, replace(episodes, size=size))
    if len(intervals) > 1:
        yield TracedCourse("intermittent", intervals=tuple(intervals))
    between = np.concatenate([ends[:1], 0.5 * (problem.clock[1:] + problem.clock[:-1]), ends[1:]])
    moved = _runs(between, _switched_on(advantage(linear, index)))
    if 1 < len(moved) <= thresholds.MOST_SWITCHES:
        yield TracedCourse("intermittent", intervals=tuple(moved))


def _with_interval(intervals: Sequence[tuple[float, float]], other: Array, acts: bool) -> list[tuple[float, float]]:
    """Return intervals with another one, in which the effect acts or pauses."""
    edges = np.unique([*np.ravel(intervals), *other])
    middle = 0.5 * (edges[1:] + edges[:-1])
    on = np.any([(a < middle) & (middle < b) for a, b in intervals], axis=0)
    return _runs(edges, np.where((other[0] < middle) & (middle < other[1]), acts, on))


def _runs(edges: Array, on: NDArray[np.bool_]) -> list[tuple[float, float]]:
    """Return begin and end of every run of places that are on; place k lies between edges k and k + 1."""
    ends = edges[np.flatnonzero(np.diff(on.astype(int), prepend=0, append=0))]
    return [(float(a), float(b)) for a, b in ends.reshape(-1, 2)]


def finer(bare: Linear, found: Candidate) -> Candidate:
    """Return an effect whose course follows an input with the values of that input sought again, others as they are."""
    problem, own = bare.problem, found.term.effect
    for step in thresholds.FINER:
        if found.term.course is None or not found.term.course.input:
            break
        effect = next(e for e in problem.catalogue if e.id == found.id)
        effect = effect if own.inside is None else effect.having(own.inside.value)
        courses = list(near(found.term.course, step))
        shares = np.array([problem.share(course) for course in courses])
        gain = gains(by_place(bare), slope_of(bare, effect, effect.null), shares)
        found = max(found, fit_course(bare, effect, courses[int(gain.argmax())]), key=score)
    return found


def _promising(bare: Linear, effect: Effect, every: Bank, relays: Bank) -> list[TracedCourse]:
    """Return the courses of an effect that gain most to first order less what they cost, one of each kind at most.

    One that cannot be there in part has relays alone.
    """
    bank, best = every if can_be_graded(effect) else relays, []
    gain = gains(bare, slope_of(bare, effect, effect.null), bank.shares) if bank.courses else np.zeros(0)
    net = gain - penalty(bank.changes, bare.problem.first.size, gain)
    for places in bank.kinds.values():
        top = places[np.argmax(net[places])]
        best.append((float(net[top]), bank.courses[top]))
    best = sorted((each for each in best if each[0] > 0.0), key=lambda each: -each[0])
    return [course for _, course in best[: thresholds.MOST_COURSES]]


def by_place(linear: Linear) -> Linear:
    """Return a model whose stretches are single places."""
    place = np.arange(linear.problem.K)
    return replace(linear, problem=replace(linear.problem, block=place, first=place))


def _relays(problem: Problem) -> Bank:
    """Return courses that begin and end at values of an input, with their shares by stretch."""
    return _by_stretch(problem, list(hystereses(_inputs(problem), thresholds.RELAY_LEVELS)))


def _in_time(problem: Problem) -> Bank:
    """Return courses over time, where there is one log, with their shares by stretch."""
    whole, middle = float(problem.clock[-1] - problem.clock[0]), np.append(problem.begins[1:], problem.clock[-1])
    courses: list[TracedCourse] = []
    if problem.of_log[-1] == 0 and problem.first.size >= 3 * thresholds.LEAST_LENGTH:
        courses = list(in_time(problem.begins, thresholds.LEAST_LENGTH, whole * np.array(thresholds.TIME_CONSTANTS)))
    at = 0.5 * (problem.begins + middle)
    shares = [c.share(at, problem.channel, float(problem.clock[-1])) for c in courses]
    return Bank(tuple(courses), np.reshape(shares, (len(courses), at.size)))


def _lagging(problem: Problem) -> Bank:
    """Return courses that lag behind an input, with their shares by stretch."""
    whole = float(problem.clock[-1] - problem.clock[0])
    courses: list[TracedCourse] = []
    for name in _inputs(problem):
        for tau in whole * np.array(thresholds.TIME_CONSTANTS):
            courses += lags(name, problem.state(name, float(tau)), float(tau))
    return _by_stretch(problem, courses)


def _by_stretch(problem: Problem, courses: list[TracedCourse]) -> Bank:
    count = np.diff(np.append(problem.first, problem.K))
    shares = [np.add.reduceat(problem.share(course), problem.first) / count for course in courses]
    return Bank(tuple(courses), np.reshape(shares, (len(courses), count.size)))


def _inputs(problem: Problem) -> Mapping[str, Array]:
    """Return what a course may follow: the map's inputs and the logs' own channels, but for switches."""
    own = [name for name in (problem.model.speed, problem.model.fuel) if name in problem.signals.value]
    found = {name: problem.channel(name) for name in (*own, *problem.auxiliary)}
    return {name: x for name, x in found.items() if np.unique(x).size > thresholds.MOST_LEVELS}


def advantage(linear: Linear, index: int, aside: Container[int] = ()) -> Array:
    """Return by how much half the sum of squares falls when a term acts at an instant, shape (K,); zero where it is not used."""
    # Map, constants and sizes stay as they are, and terms in `aside` do not act. Products are taken across the views, so
    # that the noise of a regressor is no evidence against the term.
    term = linear.terms[index]
    others = [t for i, t in enumerate(linear.terms) if i != index and i not in aside]
    off = residual_with(linear, others)
    on = residual_with(linear, [*others, replace(term, begin=-np.inf, end=np.inf, only=None)])
    place = linear.noise.pointwise()
    plain_off, plain_on = place.whiten(off), place.whiten(on)
    gain = 0.5 * ((plain_off[0] ** 2 - plain_off[1] ** 2).sum(0) - (plain_on[0] ** 2 - plain_on[1] ** 2).sum(0))
    if place is linear.noise:
        return np.asarray(gain)
    # Where noise is correlated in time, places are not independent: their sum is scaled to the evidence of the whole change.
    whole, alone = linear.noise.whiten(on - off)[0], (plain_on - plain_off)[0]
    return np.asarray(gain * min(1.0, float(np.vdot(whole, whole) / max(np.vdot(alone, alone), 1e-300))))


def sharpened(linear: Linear, index: int) -> Term:
    """Return a term with its onset and end moved to between the two places where it starts and stops to explain the residual."""
    term = linear.terms[index]
    better = np.cumsum(advantage(linear, index))  # if it acts up to a place, that one included
    clock = linear.problem.clock
    between = np.append(0.5 * (clock[1:] + clock[:-1]), clock[-1])
    reach = 2.0 * float(np.median(np.diff(linear.problem.begins)))

    def near(at: float, sign: float) -> float:
        window = np.flatnonzero(np.abs(clock - at) <= reach)
        return float(between[window[np.argmax(sign * better[window])]]) if window.size else at

    begin = near(term.begin, -1.0) if np.isfinite(term.begin) else term.begin
    end = near(term.end, 1.0) if np.isfinite(term.end) else term.end
    return replace(term, begin=begin, end=end) if end > begin else term


def comes_and_goes(linear: Linear, index: int) -> bool:
    """Return whether a term explains clearly more when it acts in several episodes than in the best one interval."""
    # An effect that ends and cancels this one is put aside: together they are a pause.
    aside = [i for i, t in enumerate(linear.terms) if i != index and np.isfinite(t.end) and cancels(linear, i, index)]
    gain = advantage(linear, index, aside)
    acting = _switched_on(gain)
    total = np.concatenate([[0.0], np.cumsum(gain)])
    one = float((total - np.minimum.accumulate(total)).max())
    return float(gain[acting].sum()) > one + least_gain(linear.problem)


def _switched_on(gain: Array) -> NDArray[np.bool_]:
    """Return where a term acts, from what it gains at every place, shape (K,)."""
    return np.asarray(switched(gain, thresholds.SWITCH * float(np.log(gain.size))))


@njit(cache=True)
def switched(gain, cost):  # type: ignore[no-untyped-def]
    """Return when to act for the largest sum of gains, if every switch has a cost, shape (K,) (Viterbi's recursion)."""
    acting, idle = 0.0, 0.0
    begins, ends = np.zeros(gain.size, np.bool_), np.zeros(gain.size, np.bool_)
    for k in range(gain.size):
        begins[k], ends[k] = idle - cost > acting, acting - cost > idle
        acting, idle = max(acting, idle - cost) + gain[k], max(idle, acting - cost)
    out = np.zeros(gain.size, np.bool_)
    on = acting > idle
    for k in range(gain.size - 1, -1, -1):
        out[k] = on
        on = not begins[k] if on else ends[k]
    return out
