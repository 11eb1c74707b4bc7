"""The evidence for one candidate effect: its best size, its gain, its best interval, and whether one size fits every block."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np
import scipy
from numpy.typing import NDArray

from lpvobs.discovery.linear import Linear
from lpvobs.discovery.normal import pins
from lpvobs.discovery.residual import Problem, Term
from lpvobs.discovery.sizes import best_trial, blur, change_of, is_clear, slope_of
from lpvobs.discovery.thresholds import COST, DATED, LEAST_LENGTH, START, STRETCH, STRONG
from lpvobs.discovery.variation import own_sizes_of, told_of
from lpvobs.engines.effects import Effect
from lpvobs.records import Array


@dataclass(frozen=True, eq=False)
class Candidate:
    """An effect fitted beside map and constants."""

    term: Term
    gain: float  # by how much it lowers half the sum of squares, in units of the noise
    information: float  # what the data say about its size when map and constants are unknown, 1/unit^2
    # mean square of the block sums of its score over that of noise: near one when one size fits every block, and one
    # where the data cannot tell the effect from those that are there
    unevenness: float
    loss: Array  # (blocks,) half the sum of squares that is left, by block
    # unevenness without its largest block: a single event, such as a cold start, is no structure in time
    elsewhere: float
    from_start: bool  # whether it acts from the first tenth of the logs on, and ends
    told: float  # share of the gain that is left beside what a healthy engine always seems to have of the effect
    own_sizes: float  # by how much more a size of its own for every block gains than noise hardly ever does
    # for its coefficients, by a curve of which healthy drives show the shape: it pays from what is told of it
    paid: float = 0.0
    usual: bool = False  # whether an onset is as usual as none

    @property
    def id(self) -> str:
        """The effect's identifier."""
        return self.term.effect.id

    @property
    def price(self) -> float:
        """What an unusual constant inside the effect must gain."""
        return COST if self.term.effect.unusual else 0.0

    @property
    def standard_error(self) -> float:
        """Standard error of its size, wider where no single size fits every block."""
        return float(np.sqrt(max(self.unevenness, 1.0) / self.information))

    @property
    def ends(self) -> int:
        """The number of its ends that lie inside the log."""
        if self.term.course is not None:
            return self.term.course.ends
        return int(np.isfinite(self.term.begin)) + int(np.isfinite(self.term.end))

    @property
    def changes(self) -> int:
        """The number of its ends that lie inside the log, or of the parameters of its course."""
        return self.ends if self.term.course is None else self.term.course.changes

    @property
    def in_time(self) -> bool:
        """Whether it follows no input."""
        return self.term.course is None or self.term.course.in_time


def loss_of(linear: Linear) -> Array:
    """Return half the sum of squares by block at the optimum of the linear model, shape (blocks,)."""
    left = linear.moved(linear.residual, linear.newton_step)
    return 0.5 * linear.by_block(left, left)


def first_order(linear: Linear, effect: Effect, *intervals: tuple[float, float]) -> list[tuple[float, float]]:
    """Return gradient and information of an effect's size in each interval, with the residual taken as linear in it."""
    slope, found = slope_of(linear, effect, effect.null), []
    for interval in intervals:
        on = Term(effect, effect.null, *interval).acts(linear.problem.clock)
        (gradient,), ((information,),) = linear.beside(linear.whiten(slope * on)[None])
        found.append((float(gradient), float(information)))
    return found


def first_order_gain(linear: Linear, effect: Effect, begin: float = -np.inf, end: float = np.inf) -> float:
    """Return the gain of an effect in an interval."""
    ((gradient, information),) = first_order(linear, effect, (begin, end))
    return 0.5 * gradient**2 / information if information > 0.0 else 0.0


def ends_of(linear: Linear, first: int, last: int) -> tuple[float, float]:
    """Return begin and end [s] on the clock of a range of blocks; infinite at the ends of the logs."""
    begins = linear.problem.begins
    return (begins[first] if first > 0 else -np.inf), (begins[last] if last < begins.size else np.inf)


def fit_candidate(
    linear: Linear,
    effect: Effect,
    begin: float = -np.inf,
    end: float = np.inf,
    size: float | None = None,
    like: Term | None = None,
) -> Candidate:
    """Return the effect at its best size in an interval, by Gauss-Newton steps with map and constants projected out.

    `like` is a term whose course it has.
    """
    term = Term(effect, effect.null, begin, end) if like is None else replace(like, effect=effect)
    on = term.acts(linear.problem.clock).astype(float)
    best = best_trial(linear, effect, effect.null if size is None else float(size), on)
    if best.size != effect.null and not is_clear(linear, best.slope, best.information):
        best = best.from_none(effect.null)
    slope, own = best.slope, best.answers[1]
    left = linear.moved(linear.residual + best.change, best.answers[0] + linear.newton_step)
    information = max(best.information, 1e-9 * float(np.vdot(slope, slope)), 1e-300)
    scores = linear.by_block(left, slope) - linear.products_by_block(left) @ own
    known = is_clear(linear, slope, information)
    clock = linear.problem.clock
    from_start = bool(np.isfinite(term.end)) and term.begin < clock[0] + START * (clock[-1] - clock[0])
    term, direction = replace(term, size=best.size), linear.moved(slope, own)
    weighed = _weighed(linear, term, left, direction, scores if known else None, information)
    return Candidate(gain=best.gain if known else 0.0, from_start=from_start, usual=_is_usual(linear), **weighed)


def _weighed(
    linear: Linear,
    term: Term,
    left: Array,
    direction: Array,
    scores: Array | None,
    information: float,
    told: float | None = None,
) -> dict[str, Any]:
    """Return what a whitened residual that is left beside an effect says of it; no scores by stretch where they are noise.

    `direction` is the effect's derivative with all unknowns projected out.
    """
    unevenness, elsewhere, own_sizes = 1.0, 1.0, 0.0
    if scores is not None:
        squares = linear.problem.by_coarse(scores) ** 2 / information
        own_sizes = own_sizes_of(linear, term, scores, direction)
        unevenness, elsewhere = float(squares.sum()), float(squares.sum() - squares.max())
    told = told_of(linear, term, information, unevenness) if told is None else told
    cost = 0.0 if term.curve is None else term.curve.cost
    return {
        "paid": cost if len(linear.problem.known_as(term)) > 1 else 0.0,
        "term": term,
        "information": float(told * information),
        "unevenness": unevenness,
        "elsewhere": elsewhere,
        "told": told,
        "own_sizes": own_sizes,
        "loss": 0.5 * linear.by_block(left, left),
    }


def elsewhere_of(linear: Linear) -> float:
    """Return the largest mean square of the block sums of any general effect that has no name yet, over that of noise."""
    named = {term.effect.id for term in linear.terms}
    return max(fit_candidate(linear, effect).elsewhere for effect in linear.problem.carriers if effect.id not in named)


def in_place(linear: Linear, index: int, like: Candidate) -> Candidate:
    """Return an effect of the model as a candidate, with information and unevenness taken from the joint model.

    So is its gain, where to first order its derivative was noise.
    """
    at = linear.p + linear.beta.size + index
    row = linear.row(index)
    information = 1.0 / row[at] - pins(linear)[at]
    left = linear.moved(linear.residual, linear.newton_step)
    scores = linear.products_by_block(left) @ (row / row[at])
    term = linear.terms[index]
    gain = like.gain if like.gain != 0.0 else 0.5 * information * (term.size - term.effect.null) ** 2
    # what is told of a curve's shape was found beside a model without it: here nothing of its direction is left
    known_as = linear.problem.known_as(term)
    told = like.told if len(known_as) > 1 and known_as == linear.problem.known_as(like.term) else None
    direction = linear.moved(np.zeros_like(left), row / row[at])
    return replace(like, gain=gain, **_weighed(linear, term, left, direction, scores, information, told))


def gains_of_intervals(linear: Linear, direction: Array) -> Array:
    """Return the gain of a direction, not whitened, on every range of stretches first..last; zero if too short.

    Shape (stretches + 1, stretches + 1).
    """
    first, whitened = linear.problem.first, linear.whiten(direction)
    products, score = linear.along_stretches(direction, whitened)
    score = score - products @ linear.newton_step
    white = scipy.linalg.solve_triangular(linear.factor, np.cumsum(products, 0).T, lower=True, check_finite=False).T
    white = np.vstack([np.zeros(white.shape[1]), white])
    S = np.concatenate([[0.0], np.cumsum(score)])
    gram = white @ white.T
    own = np.diag(gram)
    power = linear.noise.ranges(direction, whitened, first)
    information = power - (own[None] + own[:, None] - 2.0 * gram)
    number = np.arange(S.size)
    noisy = np.concatenate([[0.0], np.cumsum(blur(linear, whitened))])
    usable = number[None] - number[:, None] >= LEAST_LENGTH
    least = 1e-6 * max(power[0, -1], 1e-300)
    usable &= information > STRONG * np.sqrt(np.maximum(noisy[None] - noisy[:, None], 0.0)) + least
    gains = np.zeros(information.shape)
    gains[usable] = 0.5 * (S[None] - S[:, None])[usable] ** 2 / information[usable]
    return gains


def best_intervals(gains: Array) -> list[tuple[int, int]]:
    """Return the best range that begins inside, that ends inside, and that does both."""
    n = gains.shape[0] - 1
    edge = LEAST_LENGTH
    first = int(np.argmax(gains[edge:-edge, n])) + edge
    last = int(np.argmax(gains[0, edge:-edge])) + edge
    inner = gains[edge:-edge, edge:-edge]
    both = np.unravel_index(int(np.argmax(inner)), inner.shape) if inner.any() else (0, inner.shape[1] - 1)
    return [(first, n), (0, last), (int(both[0]) + edge, int(both[1]) + edge)]


def best_gain(linear: Linear, effect: Effect) -> float:
    """Return the first-order gain of an effect on its best range of blocks, or over the whole logs."""
    blocks = linear.problem.first.size
    gains = gains_of_intervals(linear, slope_of(linear, effect, effect.null))
    tops = [
        (gain := float(gains[first, last]))
        - penalty(1 + (first > 0 and last < blocks), blocks, gain, usual=_is_usual(linear))
        for first, last in best_intervals(gains)
    ]
    return max(0.0 if linear.problem.absorbs(effect) else float(gains[0, blocks]), *tops)


Gain = TypeVar("Gain", float, Array)  # of one candidate, or of each of many


def penalty(changes: Gain, blocks: int, gain: Gain, from_start: bool = False, usual: bool = False) -> Gain:
    """Return what an interval must gain over the whole log.

    Each end costs the search over its place and a hundredth of the gain. An interval that ends, but begins at or just after the
    start, costs a further tenth: an effect that ends can often be written as its opposite that begins. Where an onset is usual,
    the first end costs a third of it.
    """
    place = float(np.log(blocks))
    given_back = 2.0 * place if usual and changes else 0.0
    return changes * (3.0 * place + 0.01 * gain) - given_back + (0.1 * gain if from_start else 0.0)


def _is_usual(linear: Linear) -> bool:
    """Return whether an onset is as usual as none: healthy drives tell how errors look, and no effect leaves some by its shape."""
    return linear.problem.seeming.drives > 0 and not linear.terms


def score(candidate: Candidate) -> float:
    """Return the gain less what its interval costs, and an unusual constant inside it."""
    own = candidate.changes, candidate.loss.size, candidate.gain
    return candidate.gain - penalty(*own, candidate.from_start, candidate.usual) - candidate.price


def best_first(candidates: Iterable[Candidate]) -> list[Candidate]:
    """Return candidates by their score."""
    return sorted(candidates, key=score, reverse=True)


def with_best_interval(linear: Linear, whole: Candidate) -> Candidate:
    """Return the effect on the range of blocks with the best score, sought again with the size found there.

    `whole` is the effect on all of them, which stands as well where the map does not take it up.
    """
    if linear.problem.first.size < 3 * LEAST_LENGTH:
        return whole
    effect = whole.term.effect
    absorbed = linear.problem.absorbs(effect)
    ranges = best_intervals(gains_of_intervals(linear, _direction(linear, effect, whole.term.size)))
    usual = (0,) if stays(linear.problem, effect) else (0, 2) if absorbed else (0, 1, 2)
    found = {i: _on_blocks(linear, whole, ranges[i]) for i in usual}
    best = max(found, key=lambda i: score(found[i]))
    again = best_intervals(gains_of_intervals(linear, _direction(linear, effect, found[best].term.size)))[best]
    rivals = [found[best], *([] if again == ranges[best] else [_on_blocks(linear, found[best], again)])]
    return max(rivals if absorbed else [whole, *rivals], key=score)


def best_onset(linear: Linear, whole: Candidate) -> list[float]:
    """Return when an effect that acts all along would better begin, from its shape; none if it gains nothing by that."""
    blocks = linear.problem.first.size
    if blocks < 3 * LEAST_LENGTH:
        return []
    gains = gains_of_intervals(linear, _direction(linear, whole.term.effect, whole.term.size))
    (first, last), *_ = best_intervals(gains)
    return [ends_of(linear, first, last)[0]] if gains[first, last] > gains[0, blocks] else []


def stays(problem: Problem, effect: Effect) -> bool:
    """Return whether an effect has no end here: it settles for good, and the logs are one drive."""
    return effect.stays and bool(problem.of_log[-1] == 0)


def dated_again(bare: Linear, term: Term) -> Term:
    """Return a term whose ends are moved, by a stretch at most, to where it gains most with all unknowns fitted.

    `bare` is the model without it, fitted to all data. Until then an onset in a stretch that was kept back is only a guess.
    """
    problem, n = bare.problem, bare.problem.first.size
    reach = STRETCH + 2.0 * float(np.median(np.diff(problem.begins)))

    def near(edge: float, whole: int) -> NDArray[np.int64]:
        return np.flatnonzero(np.abs(problem.begins - edge) <= reach) if np.isfinite(edge) else np.array([whole])

    firsts, lasts = near(term.begin, 0), near(term.end, n)
    if not (firsts.size and lasts.size):
        return term
    gains = gains_of_intervals(bare, _direction(bare, term.effect, term.size))[np.ix_(firsts, lasts)]
    i, j = np.unravel_index(int(np.argmax(gains)), gains.shape)
    begin, end = ends_of(bare, int(firsts[i]), int(lasts[j]))
    return replace(term, begin=begin, end=end) if gains[i, j] > 0.0 else term


def possible_edges(bare: Linear, term: Term) -> list[tuple[float, float]]:
    """Return the spans [s] in which each edge of a term may lie: with the edge anywhere in it, the gain falls by `DATED` at most.

    `bare` is the model without the term. Where its gain is less than that, or no number, the edges stand.
    """
    begins, n = bare.problem.begins, bare.problem.first.size
    gains = gains_of_intervals(bare, _direction(bare, term.effect, term.size))
    first = int(np.argmin(np.abs(begins - term.begin))) if np.isfinite(term.begin) else 0
    last = int(np.argmin(np.abs(begins - term.end))) if np.isfinite(term.end) else n
    tried = (term.begin, first, gains[:n, last]), (term.end, last, gains[first, :n])
    known = gains[first, last] > DATED
    return [_run(begins, at, row) if known else (edge, edge) for edge, at, row in tried if np.isfinite(edge)]


def _run(begins: Array, at: int, gains: Array) -> tuple[float, float]:
    """Return first and last begin of the run of stretches around one that gain as much."""
    less = np.flatnonzero(gains < gains[at] - DATED)
    split = int(np.searchsorted(less, at))
    first, last = less[split - 1] + 1 if split else 0, less[split] - 1 if split < less.size else begins.size - 1
    return float(begins[first]), float(begins[last])


def _direction(linear: Linear, effect: Effect, size: float) -> Array:
    """Return the change of the residual per size: the secant from none to a large size, the slope at a small one."""
    far = abs(size - effect.null) > 0.2 * effect.size
    return change_of(linear, effect, size) / (size - effect.null) if far else slope_of(linear, effect, size)


def _on_blocks(linear: Linear, like: Candidate, blocks: tuple[int, int]) -> Candidate:
    return fit_candidate(linear, like.term.effect, *ends_of(linear, *blocks), like.term.size)
