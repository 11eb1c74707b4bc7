"""The error of each balance before and after, on blocks that the sizes were not taken from."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lpvobs.discovery.held_out import Comparison, compared
from lpvobs.discovery.throttled_case import Case, Term
from lpvobs.discovery.throttled_errors import Weighed, daily_sizes
from lpvobs.discovery.throttled_outcome import BalanceError, Level, levels_of
from lpvobs.discovery.throttled_selection import Selection
from lpvobs.discovery.whiteness import Whiteness, whiteness
from lpvobs.engines.throttled.balances import BALANCES, PARTS
from lpvobs.engines.throttled.blocks import haste_of
from lpvobs.records import Array

COARSE = 5
"""Blocks that are held out together."""
FOLDS = 5
STEP = 0.02
"""Of the largest size looked at: what a derivative by the size is taken over."""
AFFECTED = 1.25
"""Times the healthy error from which a balance counts as moved, if the effects lower it."""
PLACED = 0.2
"""Of the largest change: a balance that an effect moves by less is not its place."""


@dataclass(frozen=True)
class Judged:
    """The residual of one log before and after, the day's levels taken out, shape (blocks, 4)."""

    before: Array
    after: Array


def judged(case: Case, found: Selection) -> Judged:
    """Return the residuals; the sizes behind `after` come from other blocks, by one step of the linear model."""
    w = found.w
    _, day = w.day(found.after)
    terms = [item.term for item in found.accepted]
    after = found.after - day
    if terms:
        after = after + _left_out(w, terms, found.after)
    return Judged(found.before - day, after)


def _left_out(w: Weighed, terms: Sequence[Term], r: Array) -> Array:
    """Return how the residual of each fold moves when the sizes are taken from the others, shape (blocks, 4)."""
    case = w.case
    slopes = []
    for i, term in enumerate(terms):
        step = STEP * (term.effect.sizes[-1] - term.effect.null)
        moved = [replace(each, size=each.size + step) if k == i else each for k, each in enumerate(terms)]
        slopes.append((case.imbalances(moved) - r) / step)
    J = np.stack([w.flat(slope) for slope in slopes], axis=1)
    PJ = w.weights.P @ J
    scores = PJ * w.flat(r)[:, None]
    information = (1.0 - 1.0 / FOLDS) * (J.T @ PJ)
    fold = np.arange(case.blocks.count) // COARSE % FOLDS
    out = np.zeros_like(r)
    for each in range(FOLDS):
        step_of = np.linalg.solve(information, scores[fold[w.errors.order // len(BALANCES)] == each].sum(0))
        out[fold == each] = sum(s[fold == each] * x for s, x in zip(slopes, step_of, strict=True))
    return out


def in_flow(case: Case, residuals: Judged) -> tuple[NDArray[np.int64], Array, Array]:
    """Return for every block its stretch, and the squared residual before and after [kg^2/s^2], mean of the flow balances."""
    flow = np.maximum(case.blocks.mean(case.log["W_maf"]), 0.0)[:, None] if "W_maf" in case.log.channels else 0.0
    counted = case.counted[:, :3]
    many = np.maximum(counted.sum(1), 1)
    lost, left = (
        (np.where(counted, flow * r[:, :3], 0.0) ** 2).sum(1) / many for r in (residuals.before, residuals.after)
    )
    return np.arange(case.blocks.count) // COARSE, lost, left


def comparison_of(case: Case, residuals: Judged) -> Comparison:
    """Return the error of a log before and after, in kg/s."""
    coarse, lost, left = in_flow(case, residuals)
    return compared(coarse, 1.0, lost, left, lost.size)


def balance_errors(case: Case, residuals: Judged, terms: Sequence[Term]) -> tuple[BalanceError, ...]:
    """Return every balance where the effects act, of the whole log where there is none."""
    on = np.zeros(case.blocks.count, dtype=bool)
    for term in terms:
        on |= case.acts(term.begin, term.end)
    found = []
    for b, name in enumerate(BALANCES):
        use = case.counted[:, b] & (on if terms else True)
        if use.any():
            before, after = residuals.before[use, b], residuals.after[use, b]
            B, A, N = _rms(before), _rms(after), float(case.healthy.rms[b])
            moved = bool(terms) and B > AFFECTED * N and _rms(before - after) > 0.5 * N
            found.append(BalanceError(name, B, A, N, _usual(before), _usual(after), moved))
    return tuple(found)


def _rms(r: Array) -> float:
    return float(np.sqrt(np.mean(r**2)))


def _usual(r: Array) -> float:
    return float(1.4826 * np.median(np.abs(r)))


def levels(case: Case, found: Selection) -> tuple[Level, ...]:
    """Return what differs from the healthy day all along the log, in units."""
    allowed, sizes = case.day_to_day, dict(daily_sizes(case))
    sizes |= dict(zip(BALANCES, (allowed.balance, allowed.balance, allowed.fuel, allowed.ambient), strict=True))
    value, _ = found.w.day(found.after)
    names = found.w.errors.modes
    seen = tuple(name for name, mode in zip(names, found.w.errors.day, strict=True) if mode.any())
    return levels_of(seen, {n: float(x) * sizes[n] for n, x in zip(names, value, strict=True)}, sizes)


def structure_of(case: Case, r: Array) -> Whiteness:
    """Return the structure of a residual in units of its healthy scale."""
    scale = case.healthy.scale[np.searchsorted(case.healthy.hurry, haste_of(case.blocks, case.log))]
    use = [bool(case.counted[:, b].any()) and name != "ambient" for b, name in enumerate(BALANCES)]
    rows = np.where(case.counted, r / scale, 0.0).T[use]
    names = ("n_e", "m_f", "alpha_th", "p_ic", "p_im", "T_ic", "T_amb")
    signals = {name: case.blocks.mean(case.log[name]) for name in names if name in case.log.channels}
    signals |= {n: case.blocks.mean(v) for n, v in case.log.auxiliary.items() if np.isfinite(v).all() and np.ptp(v) > 0}
    return whiteness(rows, np.arange(0, case.blocks.count, COARSE), signals)


def missing_channels(case: Case, needed: Sequence[str]) -> tuple[str, ...]:
    """Return the channels that the log does not have."""
    return tuple(name for name in needed if name not in case.log.channels)


def lost_balances(case: Case) -> tuple[str, ...]:
    """Return the balances that the log cannot show."""
    return tuple(name for b, name in enumerate(BALANCES) if not case.counted[:, b].any())


def same_place(case: Case) -> tuple[tuple[str, ...], ...]:
    """Return groups of effects that move the same balances of a log."""
    base = case.imbalances(())
    groups: dict[tuple[bool, ...], list[str]] = {}
    for effect in case.candidates:
        size = effect.sizes[int(0.75 * len(effect.sizes))]
        moved = np.where(case.counted, case.imbalances([Term(effect, size)]) - base, 0.0)
        power = np.sqrt((moved**2).mean(0))
        if power.max() > 0.0:
            groups.setdefault(tuple((power > PLACED * power.max()).tolist()), []).append(effect.id)
    return tuple(tuple(names) for names in groups.values() if len(names) > 1)


def needed_channels() -> tuple[str, ...]:
    """Return every channel that a balance needs."""
    return tuple(dict.fromkeys(channel for part in PARTS.values() for channel in part))
