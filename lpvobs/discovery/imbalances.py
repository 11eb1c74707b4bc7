"""From signals to residuals: what each balance leaves with given effects, unknowns and levels of the day."""

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from lpvobs.discovery.residual import Problem, Term
from lpvobs.discovery.thresholds import NOTHING, STEP
from lpvobs.engines.effects import SENSOR, Effect, Signals
from lpvobs.records import Array

Nodes = tuple[NDArray[np.int64], Array]
Scene = tuple[NDArray[np.bool_], Signals]
"""Signals with effects accounted for, and the places that they hold at, shape (K,); a single `True` for all."""


def scenes_with(problem: Problem, terms: Sequence[Term], beta: Array) -> tuple[Scene, ...]:
    """Return the signals with all effects accounted for, in the order of the catalogue, channels last.

    Instants do not depend on each other, so one set of signals holds the effects that act at each. A block takes
    differences between its edges and would take an effect that begins at an edge for a jump. Blocks therefore have one set of
    signals for every combination of effects that acts somewhere.
    """
    order = {effect.id: i for i, effect in enumerate(problem.model.catalogue)}
    terms = sorted((*problem.held, *terms), key=lambda term: order.get(term.effect.id, len(order)))
    signals = today(problem, beta)
    if problem.blocks is None:
        for term in terms:
            on = np.tile(term.acts(problem.clock), 2)
            signals = signals.where(on, term.effect.apply(signals, term.size))
        return ((np.array(True), signals),)
    acting = np.array([term.acts(problem.clock) for term in terms]).reshape(len(terms), problem.K)
    found = []
    patterns, number = np.unique(acting, axis=1, return_inverse=True)
    for i, pattern in enumerate(patterns.T):
        acts = [term for term, on in zip(terms, pattern, strict=True) if on]
        of_days = {level.name for _, level in problem.levels} & {term.effect.id for term in acts}
        here = today(problem, beta, of_days) if of_days else signals
        for term in acts:
            here = _corrected(problem, beta, here, term.effect, term.size)
        found.append((number.reshape(-1) == i, here))
    return tuple(found)


def today(problem: Problem, beta: Array, but: Collection[str] = ()) -> Signals:
    """Return the signals at the engine's unknowns, corrected for what sensors and clocks are off by on the day of each log.

    They are not corrected for the effects `but`.
    """
    signals = replace(problem.signals, constants=problem.model.with_unknowns(beta[: len(problem.model.names)]))
    for name in dict.fromkeys(level.name for _, level in problem.levels):
        effect = problem.model.effect(name)
        if effect is not None and effect in problem.catalogue and name not in but:
            signals = _corrected(problem, beta, signals, effect, effect.null)
    return signals


def _corrected(problem: Problem, beta: Array, signals: Signals, effect: Effect, size: float) -> Signals:
    """Return signals corrected for an effect, and for what every log has of it on its day, at once.

    A channel that is shifted twice in time is interpolated twice, and its blur would tell the day from the effect.
    """
    days = {log: own for log, level, own in problem.on_days(beta) if level.name == effect.id}
    if not days:
        return effect.apply(signals, size)
    for log, own in days.items():
        if size + own != effect.null:
            signals = signals.where(problem.columns[log], effect.apply(signals, size + own))
    return signals


def imbalances_at(problem: Problem, scenes: Sequence[Scene], beta: Array) -> Array:
    """Return what is left of every balance without the map, shape (B, 2K) or (B, K) [model's unit]."""
    return from_signals(problem, scenes) + standing(problem, beta)


def from_signals(problem: Problem, scenes: Sequence[Scene]) -> Array:
    """Return what signals and constants make of every balance, shape (B, 2K) or (B, K) [model's unit]."""
    constants, out = scenes[0][1].constants, np.zeros(())
    for on, signals in scenes:
        out = np.where(on, problem.model.imbalances(constants, signals, problem.blocks), out)
    return np.asarray(out if problem.blocks is not None else out - moved(problem, scenes[0][1]))


def standing(problem: Problem, beta: Array) -> Array:
    """Return what is added to that whatever the signals: offsets, levels of the day, errors of a healthy engine, same shape."""
    by_day = problem.patterns.along(beta[beta.size - len(problem.patterns) :])  # with the errors of a healthy engine
    for log, level, size in problem.on_days(beta):
        if level.name in problem.model.balances:
            by_day[problem.model.balances.index(level.name), problem.of_log == log] += size
    out = problem.offset - by_day
    if problem.blocks is not None:
        return out
    by_engine = 0.0 if problem.learned is None else np.tensordot(beta[: len(problem.learned)], problem.learned, 1)
    return np.asarray(np.tile(out, 2) - by_engine)


def moved(problem: Problem, s: Signals) -> Array:
    """Return how what a healthy engine leaves changes with signals that are not what was recorded, shape (B, 2K)."""
    out, recorded = np.zeros((len(problem.shown), 2 * problem.K)), problem.signals
    for name, (by_value, by_rate) in problem.follows.items():
        if s.value[name] is not recorded.value[name]:
            out += np.tile(by_value, 2) * (s[name] - recorded[name])
        if s.rate[name] is not recorded.rate[name]:
            out += np.tile(by_rate, 2) * (s.rate[name] - recorded.rate[name])
    if problem.left is not None and problem.model.left_with is not None and s.lacks is not recorded.lacks:
        out += problem.model.left_with(s.constants, s, np.tile(problem.left, 2))
    return out


def views(values: Array, K: int) -> Array:
    """Return mean and half difference of the two views, shape (2, m, K), of values at 2K columns; K columns are a single view."""
    if values.shape[1] == K:
        return np.stack([values, np.zeros_like(values)])
    return np.stack([0.5 * (values[:, :K] + values[:, K:]), 0.5 * (values[:, :K] - values[:, K:])])


def residual_of(problem: Problem, scenes: Sequence[Scene], beta: Array, theta: Array, nodes: Nodes) -> Array:
    """Return what is left of every balance, shape (2, B, K) [model's unit]."""
    left = views(imbalances_at(problem, scenes, beta), problem.K)
    left[0] -= problem.by_reading * map_along(theta, nodes)
    return left


def change_of_residual(
    problem: Problem,
    effect: Effect,
    before: Sequence[Scene],
    after: Sequence[Scene],
    theta: Array,
    known: Array,
) -> Array:
    """Return how the residual changes with signals that differ in the size of an effect, shape (2, B, K) [model's unit].

    `known` is what the signals of before make of both views.
    """
    # The residual is linear in the reading, and nothing else changes.
    if effect.place == "sensor" and problem.blocks is None:
        return np.asarray(views((after[0][1][SENSOR] - before[0][1][SENSOR])[None], problem.K) * problem.by_reading)
    change = views(from_signals(problem, after), problem.K) - known
    if effect.moves_point:
        then, now = (map_along(theta, operating_nodes(problem, scenes)) for scenes in (before, after))
        change[0] -= problem.by_reading * (now - then)
    return change


def curvature_bias(problem: Problem, scenes: Sequence[Scene], made: Array) -> Array:
    """Return the balances of the mean of both views less the mean of their balances, shape (B, K).

    `made` is what their signals make, as `from_signals` gives it.

    Noise of the signals biases a balance that is curved in them, and the mean of the views has half the noise of either. (Near its
    stall the compressor is so curved that the noise of p_im looked like an offset of ten pascals; this term makes it one.)
    Twice the term would remove the whole bias of a parabola, but it overshoots near the end of a square root. Only residuals have
    the term. In regressors it would mix the views, whose noise must stay independent. The noise of means over a block is too small
    to matter.
    """
    if problem.blocks is not None:
        return np.zeros(problem.shown.shape)
    K, s = problem.K, scenes[0][1]

    def middle(x: Array) -> Array:
        return np.asarray(0.5 * (x[..., :K] + x[..., K:]))

    mean = replace(
        s,
        value={name: middle(x) for name, x in s.value.items()},
        rate={name: middle(x) for name, x in s.rate.items()},
        lacks=middle(s.lacks),
    )
    return np.asarray(problem.model.imbalances(s.constants, mean, None) - middle(made + moved(problem, s)))


def operating_nodes(problem: Problem, scenes: Sequence[Scene]) -> Nodes:
    """Return node numbers and weights of the map along the places."""
    point = []
    for channel in (problem.model.fuel, problem.model.speed):
        values = np.zeros(problem.K)
        for on, s in scenes:
            here = s.value.get(channel)
            if here is not None:
                values = np.where(on, problem.mean(here), values)
        point.append(values)
    return problem.grid.regressors(*point)


def map_along(theta: Array, nodes: Nodes) -> Array:
    """Return the map's value at every place, shape (K,) [kg/s]."""
    return np.asarray(np.einsum("km,km->k", nodes[1], theta[nodes[0]]))


def rests_on(sound: NDArray[np.bool_], nodes: Nodes) -> NDArray[np.bool_]:
    """Return at which places the map is interpolated between sound nodes alone, shape (K,)."""
    return np.asarray(np.all(sound[nodes[0]] | (nodes[1] < NOTHING), axis=1), dtype=bool)


def by_unknowns(problem: Problem, scenes: Sequence[Scene], terms: Sequence[Term], beta: Array, at: Array) -> Array:
    """Return the derivatives of the residual by constants or curves, and by the levels of the day, shape (u, 2, B, K).

    `at` are the balances at `beta`, as `imbalances_at` gives them.
    """
    model, K = problem.model, problem.K
    q, spread = len(model.names), problem.spread
    B = len(model.balances)
    found = np.zeros((q + len(problem.levels), 2, B, K))
    quotients = q
    if model.by_unknowns is not None:
        for on, s in scenes:
            own = model.by_unknowns(s.constants, s, problem.blocks)
            quotients = q - len(own)
            both = views(own.reshape(len(own) * B, own.shape[-1]), K).reshape(2, len(own), B, K).swapaxes(0, 1)
            found[quotients:q] = np.where(on, both, found[quotients:q])
    for i in range(quotients):
        moved = beta.copy()
        moved[i] += STEP
        constants = model.with_unknowns(moved[:q])
        shifted = tuple((on, replace(s, constants=constants)) for on, s in scenes)
        found[i] = views((imbalances_at(problem, shifted, beta) - at) / STEP, K)
    for i, (log, level) in enumerate(problem.levels, q):
        effect = model.effect(level.name)
        if effect is None:
            found[i, 0, model.balances.index(level.name), problem.of_log == log] = -1.0
        elif effect in problem.catalogue:
            ends = []
            for step in (spread[i], -spread[i]):
                moved = beta.copy()
                moved[i] += step
                ends.append(imbalances_at(problem, scenes_with(problem, terms, moved), moved))
            found[i] = views((ends[0] - ends[1]) / (2.0 * spread[i]), K)
    return found
