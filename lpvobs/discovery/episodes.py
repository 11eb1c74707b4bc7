"""When an effect acts: its onset and end to the instant, and whether it comes and goes."""

from collections.abc import Container
from dataclasses import replace

import numpy as np

from lpvobs.compiled import njit
from lpvobs.discovery.linear import Linear, dot, residual_with
from lpvobs.discovery.ranking import least_gain
from lpvobs.discovery.residual import Term
from lpvobs.discovery.thresholds import SWITCH
from lpvobs.records import Array


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
    cancelling = [
        i for i, t in enumerate(linear.terms) if i != index and np.isfinite(t.end) and cancels(linear, i, index)
    ]
    gain = advantage(linear, index, cancelling)
    acting = switched(gain, SWITCH * float(np.log(gain.size)))
    total = np.concatenate([[0.0], np.cumsum(gain)])
    one = float((total - np.minimum.accumulate(total)).max())
    return float(gain[acting].sum()) > one + least_gain(linear.problem)


def cancels(linear: Linear, one: int, other: int) -> bool:
    """Return whether one term, while it acts, changes the residual nearer to opposite to the other than to perpendicular."""
    whole = residual_with(linear, linear.terms)
    a, b = (
        linear.whiten(whole - residual_with(linear, [t for i, t in enumerate(linear.terms) if i != j]))
        for j in (one, other)
    )
    b = b * np.any(a != 0.0, axis=(0, 1))
    return bool(dot(a, b) < -np.sqrt(0.5 * max(dot(a, a) * dot(b, b), 0.0)))


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
