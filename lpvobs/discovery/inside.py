"""What an effect has inside beside its size: the lag and the reference of a form, the constant of an effect of the catalogue."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from lpvobs.discovery import thresholds
from lpvobs.discovery.fit import change_with, objective, with_term
from lpvobs.discovery.forms import PREFIX, Factor, Form, along_problem, parsed
from lpvobs.discovery.linear import Linear
from lpvobs.discovery.sizes import change_of, is_clear
from lpvobs.discovery.thresholds import PASSES
from lpvobs.records import Array

Number = tuple[float, str, float]  # a value, its unit and its standard error
_STEP = 0.01  # of a difference quotient, as a share of the constant


def with_inside(linear: Linear, index: int, standard_error: float) -> tuple[float, dict[str, Number]]:
    """Return the standard error of an effect's size with what is inside it unknown, too, and these numbers by name."""
    inside = (
        _inside_form(linear, index)
        if linear.terms[index].effect.id.startswith(PREFIX)
        else _inside_effect(linear, index)
    )
    if not inside:
        return standard_error, {}
    columns = np.stack([column for _, _, column in inside.values()])
    _, known = linear.beside(columns)
    spread = np.linalg.inv(known + 1e-9 * np.diag(np.abs(np.diag(known))))
    row = linear.row(index)
    alone = float(row[linear.p + linear.beta.size + index])
    together = linear.products(columns) @ row
    scale = standard_error / np.sqrt(alone)
    more = max(float(together @ spread @ together), 0.0)
    errors = scale * np.sqrt(np.maximum(np.diag(spread), 0.0))
    numbers = {
        name: (value, unit, float(e)) for (name, (value, unit, _)), e in zip(inside.items(), errors, strict=True)
    }
    return float(scale * np.sqrt(alone + more)), numbers


def settled(linear: Linear, index: int) -> Linear:
    """Return the model with the constant inside an effect of the catalogue fitted, within twice what is tried."""
    for _ in range(PASSES):
        term = linear.terms[index]
        inside, known = term.effect.inside, _inside_effect(linear, index)
        if inside is None or not known:
            break
        (gradient,), ((information,),) = linear.beside(known[inside.name][2][None])
        low, high = 0.5 * min(inside.tried), 2.0 * max(inside.tried)
        value = float(np.clip(inside.value - gradient / information, low, high))
        there = with_term(linear, index, replace(term, effect=term.effect.having(value)))
        if objective(there) >= objective(linear):
            break
        linear = there
    return linear


def _inside_form(linear: Linear, index: int) -> dict[str, tuple[float, str, Array]]:
    """Return value, unit and derivative of the whitened residual of what a form has in its last factor, and of its reference."""
    problem, term = linear.problem, linear.terms[index]
    form, units = parsed(term.effect.id), problem.model.units
    last = form.factors[-1] if form.factors else Factor("")

    def with_last(factor: Factor) -> Form:
        return replace(form, factors=(*form.factors[:-1], factor))

    further: dict[str, tuple[float, str, Callable[[float], Form]]] = {
        "reference": (last.reference, last.unit(units), lambda x: with_last(replace(last, reference=x))),
        "tau": (last.tau, "s", lambda x: with_last(replace(last, tau=x))),
        "product_reference": (form.reference, form.unit_of_product(units), lambda x: replace(form, reference=x)),
    }
    shape, found = along_problem(form, problem), {}
    for name, (value, unit, moved) in further.items():
        if value:
            change = along_problem(moved((1.0 + _STEP) * value), problem) - shape
            other = form.effect(problem.model, problem.over_columns(change / (_STEP * value)), term.effect.size)
            slope = change_of(linear, other, thresholds.EFFECT_STEP * term.size) / thresholds.EFFECT_STEP
            found[name] = (value, unit, linear.whiten(slope * term.acts(problem.clock)))
    return found


def _inside_effect(linear: Linear, index: int) -> dict[str, tuple[float, str, Array]]:
    """Return the same of the constant inside an effect of the catalogue, nothing where the logs do not tell of it."""
    term = linear.terms[index]
    inside = term.effect.inside
    if inside is None:
        return {}
    h = _STEP * inside.value
    change = change_with(linear, index, replace(term, effect=term.effect.having(inside.value + h)))
    column = linear.whiten(change / h)
    _, ((information,),) = linear.beside(column[None])
    return {inside.name: (inside.value, inside.unit, column)} if is_clear(linear, column, information) else {}
