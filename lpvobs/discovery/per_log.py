"""The part of an outcome that is about one log: its balances with and without the effects, levels of the day, missing channels."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from lpvobs.discovery.imbalances import residual_of, scenes_with
from lpvobs.discovery.linear import Linear
from lpvobs.discovery.outcome import BalanceError, DayLevel, Missing
from lpvobs.discovery.residual import Problem, Term
from lpvobs.discovery.thresholds import AFFECTED, PLACED, PROBE
from lpvobs.discovery.whiteness import structure
from lpvobs.records import Array


def shown_by(after: Linear, i: int) -> dict[str, Any]:
    """Return what log i shows, as `LogPart` has it: structure of what is left, balances, levels of the day, what is missing."""
    on = after.problem.of_log == i
    return {
        "own": structure(after, on),
        "balances": balance_errors(after, i),
        "day": levels_of(after.problem, after.beta, i),
        "missing": missing_of(after.problem),
    }


def balance_errors(after: Linear, i: int) -> tuple[BalanceError, ...]:
    """Return every balance of log i where the effects act, of the whole log where there is none.

    Map, unknowns and levels of the day are those of the model with the effects in both cases, so that only the effects differ.
    """
    problem, model = after.problem, after.problem.model
    before = residual_of(problem, scenes_with(problem, (), after.beta), after.beta, after.theta, after.nodes)[0]
    acting = np.zeros(problem.K, dtype=bool)
    for term in after.terms:
        acting |= term.acts(problem.clock)
    own = problem.of_log == i
    named = bool((acting & own).any())
    found = []
    for b, name in enumerate(model.balances):
        use = problem.shown[b] & (own & acting if named else own)
        if not use.any():
            continue
        lost, left = before[b, use], after.raw[0][b, use]
        healthy = None if model.healthy is None else float(model.healthy.rms[b])
        B, A, usual = _rms(lost), _rms(left), _rms(left) if healthy is None else healthy
        moved = named and AFFECTED * usual < B and _rms(lost - left) > 0.5 * usual
        recovered = (B - A) / (B - healthy) if moved and healthy is not None else None
        found.append(BalanceError(name, model.unit, B, A, healthy, _median(lost), _median(left), moved, recovered))
    return tuple(found)


def levels_of(problem: Problem, beta: Array, i: int) -> tuple[DayLevel, ...]:
    """Return what differs on the day of log i, in units."""
    known = {effect.id for effect in problem.catalogue}
    known |= {name for name, row in zip(problem.model.balances, problem.shown, strict=True) if row.any()}
    return tuple(
        DayLevel(level.name, value, level.unit, level.deviation)
        for log, level, value in problem.on_days(beta)
        if log == i and level.name in known
    )


def missing_of(problem: Problem) -> Missing | None:
    """Return what the channels of the logs cannot show, None where they have all."""
    model = problem.model
    channels = tuple(name for name in model.channels if name not in problem.signals.value)
    balances = tuple(name for name, row in zip(model.balances, problem.shown, strict=True) if not row.any())
    return Missing(channels, balances, _same_place(problem)) if channels else None


def _same_place(problem: Problem) -> tuple[tuple[str, ...], ...]:
    """Return groups of effects that move the same balances of the logs."""
    beta = np.zeros(problem.spread.size)
    theta, nodes = np.zeros(1), (np.zeros((problem.K, 4), dtype=np.int64), np.zeros((problem.K, 4)))

    def residual(terms: Sequence[Term]) -> Array:
        return np.asarray(residual_of(problem, scenes_with(problem, terms, beta), beta, theta, nodes)[0])

    base, groups = residual(()), dict[tuple[bool, ...], list[str]]()
    for effect in problem.catalogue:
        moved = np.where(problem.shown, residual([Term(effect, effect.null + PROBE * effect.size)]) - base, 0.0)
        power = np.sqrt((moved**2).mean(1))
        if power.max() > 0.0:
            groups.setdefault(tuple((power > PLACED * power.max()).tolist()), []).append(effect.id)
    return tuple(tuple(names) for names in groups.values() if len(names) > 1)


def _rms(r: Array) -> float:
    return float(np.sqrt(np.mean(r**2)))


def _median(r: Array) -> float:
    return float(1.4826 * np.median(np.abs(r)))
