"""The errors that a healthy engine would show on one log, and how a residual is weighed by them."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lpvobs.discovery.throttled_case import DAILY, Case
from lpvobs.discovery.throttled_evidence import Weighing, weighing
from lpvobs.discovery.throttled_noise import TAIL
from lpvobs.engines.throttled.balances import BALANCES, curve_columns
from lpvobs.engines.throttled.blocks import haste_of
from lpvobs.engines.throttled.effects import CATALOGUE, gain
from lpvobs.records import Array

SHORT = 4.0
"""[s], over which errors are forgotten, but for"""
AT_ONCE = 0.25
"""the share that is forgotten from block to block, and for"""
SLOW = 100.0
"""[s], over which their slow part is forgotten."""
MOST_DAILY = 3.0
"""Standard deviations up to which a level of the day is taken out of the signals; what is larger is no matter of the day."""
MOST_STRETCHED = 3.0
"""Factor on the scale of an outlier: a second fault must not pass for one."""
MOST_STRANGE = 5.0
UNEQUAL = 0.01
"""Scatter of the pressure ratio within a block; where it is near one the throttle's flow hangs on it."""


@dataclass(frozen=True)
class LogErrors:
    """Errors on one log.

    Attributes
    ----------
    order : ndarray of int, shape (n,)
        Which entries of (blocks, 4), flattened row by row, count.
    covariance : ndarray, shape (n, n)
        Of those, but for the day's own levels.
    day : ndarray, shape (modes, n)
        How the balances move with each of the levels that differ from day to day, for one standard deviation.
    modes : tuple of str
        The balances, then some of `DAILY`.
    """

    order: NDArray[np.int64]
    covariance: Array
    day: Array
    modes: tuple[str, ...]


@dataclass(frozen=True)
class Weighed:
    """A case with the errors to expect, and the inverse of their covariance, the day's levels within."""

    case: Case
    errors: LogErrors
    weights: Weighing

    def flat(self, values: Array) -> Array:
        """Return the entries that count, in the order of time."""
        return np.asarray(values.ravel()[self.errors.order])

    def loss(self, r: Array) -> float:
        """Return half the weighted sum of squares."""
        v = self.flat(r)
        return 0.5 * float(v @ self.weights.P @ v)

    def day(self, r: Array) -> tuple[Array, Array]:
        """Return the day's levels in their standard deviations, shape (modes,), and what they explain, shape (blocks, 4)."""
        level = self.errors.day @ (self.weights.P @ self.flat(r))
        out = np.zeros(r.size)
        out[self.errors.order] = level @ self.errors.day
        return level, out.reshape(r.shape)


def weighed(case: Case, stretch: Array) -> Weighed:
    """Return the case with errors whose scale is stretched, shape (blocks, 4), where outliers are."""
    names, modes = day_modes(case)
    order = np.flatnonzero(case.counted.ravel())
    size = case.counted.size
    covariance = _covariance(case, stretch).reshape(size, size)[np.ix_(order, order)]
    errors = LogErrors(order, covariance, modes.reshape(len(names), size)[:, order], names)
    time = case.blocks.time[order // len(BALANCES)]
    return Weighed(case, errors, weighing(covariance + errors.day.T @ errors.day, time, case.blocks.length))


def stretched(w: Weighed, r: Array) -> Array:
    """Return the factors on the scales that Student's distribution gives to what is left, shape (blocks, 4)."""
    _, day = w.day(r)
    z = (r - day) / _scale(w.case)
    return np.asarray(np.clip(np.sqrt((TAIL + z**2) / (TAIL + 1.0)), 1.0, MOST_STRETCHED))


def strangeness_of(w: Weighed, r: Array) -> float:
    """Return how far a residual strays over what it strays on a healthy log, in the worst of the flow balances.

    The mean of squares that count up to `MOST_STRANGE` scales: a level, not a few outliers.
    """
    _, day = w.day(r)
    z = np.minimum(((r - day) / _scale(w.case)) ** 2, MOST_STRANGE**2)[:, :3]
    means = [
        float(z[use, b].mean() / w.case.healthy.together[b, b])
        for b, use in enumerate(w.case.counted[:, :3].T)
        if use.any()
    ]
    return max(means, default=0.0)


def on_its_day(w: Weighed, r: Array) -> Case:
    """Return the case with the day's own zeros, as far as signals have them, taken out where a residual shows them."""
    level, _ = w.day(r)
    size = daily_sizes(w.case)
    found = {
        n: float(np.clip(x, -MOST_DAILY, MOST_DAILY)) for n, x in zip(w.errors.modes, level, strict=True) if n in size
    }
    today = {n: _null(n) + x * size[n] for n, x in found.items()}
    there = replace(w.case, today=today, lift=None)
    names, modes = day_modes(there)
    whole = {n: (today[n] - _null(n)) / size[n] for n in today}
    lift = sum((whole[n] * mode for n, mode in zip(names, modes, strict=True) if n in whole), np.zeros_like(r))
    return replace(there, lift=lift)


def day_modes(case: Case) -> tuple[tuple[str, ...], Array]:
    """Return the names of the levels that differ from day to day, and what one standard deviation of each does.

    The second has shape (modes, blocks, 4).
    """
    B = case.blocks.count
    modes = [np.zeros((B, len(BALANCES))) for _ in BALANCES]
    allowed = case.day_to_day
    for b, level in enumerate((allowed.balance, allowed.balance, allowed.fuel, allowed.ambient)):
        modes[b][:, b] = level
    sizes = daily_sizes(case)
    for effect in CATALOGUE:
        if effect.id in sizes:
            ends = (effect.null - sizes[effect.id], effect.null + sizes[effect.id])
            less, more = (case.balancer(effect.undo(case.engine, case.scene, x)) for x in ends)
            modes.append(0.5 * (less - more))
    return (*BALANCES, *(effect.id for effect in CATALOGUE if effect.id in sizes)), np.stack(modes)


def daily_sizes(case: Case) -> Mapping[str, float]:
    """Return the standard deviation of each daily effect that the log can show; channels may be off by one sample."""
    allowed, step = case.day_to_day, float(np.median(np.diff(case.log.time)))
    sizes = (
        allowed.pressure_gain, allowed.pressure_offset, allowed.pressure_gain, allowed.pressure_offset, allowed.opening, step,
    )  # fmt: skip
    possible = {effect.id for effect in case.candidates}
    return {name: size for name, size in zip(DAILY, sizes, strict=True) if name in possible}


def _null(name: str) -> float:
    return next(effect.null for effect in CATALOGUE if effect.id == name)


def _scale(case: Case) -> Array:
    return np.asarray(case.healthy.scale[np.searchsorted(case.healthy.hurry, haste_of(case.blocks, case.log))])


def _covariance(case: Case, stretch: Array) -> Array:
    """Return the covariance of all entries but for the day's levels, shape (blocks, 4, blocks, 4)."""
    B, t, healthy = case.blocks.count, case.blocks.time, case.healthy
    distance = np.abs(t[:, None] - t[None])
    memory = AT_ONCE * np.eye(B) + (1.0 - AT_ONCE) * np.exp(-distance / SHORT)
    slowly = np.exp(-distance / SLOW)
    scale = _scale(case) * stretch
    shared = np.eye(len(BALANCES))
    shared[:3, :3] = healthy.together
    columns = curve_columns(case.engine, case.learned, case.blocks, case.scene)
    known = case.learned.covariance[: columns.shape[2], : columns.shape[2]]
    C = np.zeros((B, 4, B, 4))
    for i in range(4):
        for j in range(i, 4):
            part = shared[i, j] * np.outer(scale[:, i], scale[:, j]) * memory
            if j < 3:
                part += columns[i] @ known @ columns[j].T
            C[:, i, :, j] = part
            C[:, j, :, i] = part.T
        C[:, i, :, i] += healthy.slow[i] ** 2 * slowly
    if case.counted[:, 0].any():
        here = case.balancer(case.scene)[:, 0]
        moved = case.balancer(gain("p_im")(case.engine, case.scene, 1.0 + UNEQUAL))[:, 0]
        C[np.arange(B), 0, np.arange(B), 0] += (moved - here) ** 2
    return C
