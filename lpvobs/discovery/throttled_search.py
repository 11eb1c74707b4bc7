"""One log against a learned engine: which effects, from when to when, how large, judged by all balances together."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lpvobs.discovery.throttled_case import ALWAYS, FOREVER, Term
from lpvobs.discovery.throttled_errors import Weighed
from lpvobs.discovery.throttled_evidence import (
    Fit,
    best_interval,
    best_size,
    gains_by_end,
    gains_by_onset,
    refined_size,
)
from lpvobs.engines.throttled.balances import BALANCES
from lpvobs.engines.throttled.effects import Effect
from lpvobs.records import Array

PROMISING = 0.25
"""Share of the best coarse gain that earns a candidate a closer look."""
IDLE = 8.0
"""Gain below which no look closer would make an effect of it."""
BUSY = 24.0
"""Gain from which on it is worth to ask whether an effect also ends."""
EVERY = 5
"""Blocks between two ends that are tried first."""
LEAST_LENGTH = 10
"""Blocks that an effect must last, and must leave before its onset, to be told from an outlier."""
ENDS = 2.0
"""Times the logarithm of the number of blocks: what looking for one end of an interval everywhere gains by chance."""


def search(w: Weighed, terms: Sequence[Term], allow_whole: bool, among: Sequence[Effect] | None = None) -> list[Fit]:
    """Return every candidate beside the terms at its best size and interval, best score first; only promising ones refined."""
    r = w.case.imbalances(terms)
    look = _Look(w, tuple(terms), r, w.weights.P @ w.flat(r), allow_whole)
    effects = w.case.candidates if among is None else among
    lasting = {effect: _coarse(look, effect) for effect in effects}
    coarse = list(lasting.values())
    top = max((fit.gain for fit in coarse), default=0.0)
    if top > BUSY:
        worth = [effect for effect, fit in lasting.items() if fit.gain > PROMISING * top]
        coarse += [fit for effect in worth for fit in _between(look, effect) if fit.score > lasting[effect].score]
    top = max((fit.gain for fit in coarse), default=0.0)
    looked = [_refined(look, fit) if fit.gain > max(PROMISING * top, IDLE) else fit for fit in coarse]
    best = {effect.id: max((f for f in looked if f.id == effect.id), key=lambda f: f.score) for effect in effects}
    return sorted(best.values(), key=lambda fit: fit.score, reverse=True)


@dataclass(frozen=True)
class _Look:
    """What a search needs again and again: the residual beside the terms, and P times it."""

    w: Weighed
    terms: tuple[Term, ...]
    r: Array
    pulled: Array
    allow_whole: bool

    def change(self, effect: Effect, size: float) -> Array:
        return self.w.case.imbalances([*self.terms, Term(effect, size)]) - self.r

    def onset_gains(self, changes: Sequence[Array]) -> Array:
        """Return the gain of each change from each onset, less what the search for it costs; the first onset is the whole log."""
        z = np.stack([self.w.flat(change) for change in changes], axis=1)
        gains = gains_by_onset(self.w.weights, self.pulled, z)
        gains[1:LEAST_LENGTH] = -np.inf
        gains[-LEAST_LENGTH:] = -np.inf
        gains[LEAST_LENGTH:-LEAST_LENGTH] -= self.cost
        if not self.allow_whole:
            gains[0] = -np.inf
        return gains

    def gain(self, change: Array) -> float:
        z = self.w.flat(change)
        return -float(self.pulled @ z + 0.5 * z @ (self.w.weights.P @ z))

    @property
    def cost(self) -> float:
        """What the search over the blocks for one end of an interval gains by chance."""
        return ENDS * float(np.log(max(self.w.weights.onsets.size, 2)))

    def begin(self, number: int) -> float:
        return ALWAYS if number == 0 else float(self.w.weights.onsets[number])


def _coarse(look: _Look, effect: Effect) -> Fit:
    sizes = [size for size in effect.sizes if size != effect.null]
    table = look.onset_gains([look.change(effect, size) for size in sizes])
    k = int(np.argmax(table.max(1)))
    size, value = best_size(sizes, table[k])
    cost = 0.0 if k == 0 else look.cost
    return Fit(effect.id, size, look.begin(k), FOREVER, value + cost, cost, np.zeros_like(look.r), np.inf)


def _between(look: _Look, effect: Effect) -> list[Fit]:
    """Return an effect on the best interval that begins and ends inside, if it is worth anything: sizes up and down, linear."""
    w = look.w
    found = []
    for sizes in ([x for x in effect.sizes if x > effect.null], [x for x in effect.sizes[::-1] if x < effect.null]):
        if sizes:
            probe = sizes[len(sizes) // 4]
            direction = w.flat(look.change(effect, probe)) / (probe - effect.null)
            gain, begin, end, far = best_interval(w.weights, look.pulled, direction, EVERY, LEAST_LENGTH // EVERY)
            size = float(np.clip(effect.null + far, effect.sizes[0], effect.sizes[-1]))
            if gain > IDLE:
                ends = float(w.weights.onsets[begin]), float(w.weights.onsets[end])
                found.append(Fit(effect.id, size, *ends, gain, 2.0 * look.cost, np.zeros_like(look.r), np.inf))
    return sorted(found, key=lambda fit: fit.gain)[-1:]


def _refined(look: _Look, fit: Fit) -> Fit:
    case = look.w.case
    effect = next(e for e in case.candidates if e.id == fit.id)
    size, begin, end = fit.size, fit.begin, fit.end
    for _ in range(2):
        size, _ = _sized(look, effect, size, case.acts(begin, end))
        change = look.change(effect, size)
        begin = look.begin(int(np.argmax(look.onset_gains([change * case.acts(ALWAYS, end)[:, None]])[:, 0])))
        end = _end(look, change * case.acts(begin, FOREVER)[:, None], begin)
    on = case.acts(begin, end)
    size, spread = _sized(look, effect, size, on)
    change = look.change(effect, size) * on[:, None]
    cost = (int(np.isfinite(begin)) + int(np.isfinite(end))) * look.cost
    return Fit(fit.id, size, begin, end, look.gain(change), cost, change, spread)


def _sized(look: _Look, effect: Effect, size: float, on: NDArray[np.bool_]) -> tuple[float, float]:
    """Return the best size of an effect that acts in some blocks, and the size's standard deviation."""
    found, _, spread = refined_size(lambda x: look.gain(look.change(effect, x) * on[:, None]), effect.sizes, size)
    return found, spread


def _end(look: _Look, change: Array, begin: float) -> float:
    """Return where the effect had better end, infinite if nowhere."""
    weights = look.w.weights
    gains = gains_by_end(weights, look.pulled, look.w.flat(change))
    first = 0 if np.isinf(begin) else int(np.searchsorted(weights.onsets, begin))
    gains[: first + LEAST_LENGTH] = -np.inf
    gains[-LEAST_LENGTH:] = -np.inf
    k = int(np.argmax(gains))
    return float(weights.onsets[k]) if gains[k] > 1.05 * look.gain(change) + look.cost else FOREVER


def refit(w: Weighed, terms: Sequence[Term], effect: Effect, size: float, begin: float, end: float) -> Fit:
    """Return an effect at its best size beside others, its interval as it is."""
    r = w.case.imbalances(terms)
    look = _Look(w, tuple(terms), r, w.weights.P @ w.flat(r), True)
    on = w.case.acts(begin, end)
    found, spread = _sized(look, effect, size, on)
    change = look.change(effect, found) * on[:, None]
    cost = (int(np.isfinite(begin)) + int(np.isfinite(end))) * look.cost
    return Fit(effect.id, found, begin, end, look.gain(change), cost, change, spread)


def best_shift(w: Weighed, r: Array) -> float:
    """Return the score of the best constant shift of one balance from an onset on: what a name would have to beat."""
    pulled = w.weights.P @ w.flat(r)
    best = 0.0
    for b in range(len(BALANCES)):
        column = np.zeros_like(r)
        column[:, b] = 1.0
        z = w.flat(column)[:, None]
        linear = gains_by_onset(w.weights, pulled, z)
        doubled = gains_by_onset(w.weights, pulled, 2.0 * z)
        power = 2.0 * linear - doubled  # gain(x) = x s - x^2 power / 2
        slope = linear + 0.5 * power
        use = power > 1e-9 * max(float(power.max()), 1e-300)
        use[:LEAST_LENGTH] = False
        use[-LEAST_LENGTH:] = False
        gains = 0.5 * slope[use] ** 2 / power[use]
        best = max(best, float(gains.max()) if gains.size else 0.0)
    return best - ENDS * float(np.log(max(w.weights.onsets.size, 2)))
