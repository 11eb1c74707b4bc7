"""Candidates that are curves of the engine: a component passes more or less than its model says, smoothly over its own inputs.

A curve is a surface between nodes, as a calibration has them (`engines.unknowns`): small and smooth before any data. Whether it
follows one input or two, and how large it may be, is chosen by what it gains less the cost of as many coefficients as the data
determine. Constants of the engine share its level: its standard error contains their tolerance.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lpvobs.discovery.channels import following, gradient_and_normal
from lpvobs.discovery.evidence import Candidate, fit_candidate, slope_of
from lpvobs.discovery.fit import linearised
from lpvobs.discovery.linear import Linear
from lpvobs.discovery.residual import Term
from lpvobs.discovery.shapes import FactorSurface
from lpvobs.discovery.thresholds import COST, CURVE_SIZES, LARGEST, RIDGE
from lpvobs.engines.curves import on_surface, values_at
from lpvobs.engines.effects import Effect
from lpvobs.engines.residual_model import ComponentCurve
from lpvobs.records import Array


def component_candidates(linear: Linear) -> list[Candidate]:
    """Return the best curve of every component as a candidate, if it gains more than its coefficients cost."""
    found = []
    for curve in linear.problem.model.curves:
        surface = surface_of(linear, curve)
        if surface is not None:
            effect = driven_by(curve, surface)
            like = Term(effect, effect.null, curve=surface)
            candidate = fit_candidate(linear, effect, size=surface.amplitude, like=like)
            if abs(candidate.term.size) < LARGEST * curve.deviation:
                found.append(replace(candidate, gain=candidate.gain - surface.cost))
    return found


def surface_again(linear: Linear, index: int, surface: FactorSurface) -> tuple[FactorSurface, Term] | None:
    """Return one of the curves of a model found again at the map, the constants and the weights there, and its term."""
    problem, term = linear.problem, linear.terms[index]
    others = tuple(t for i, t in enumerate(linear.terms) if i != index)
    held = replace(problem, held=(*problem.held, term))
    around = linearised(held, others, linear.theta, linear.beta, linear.noise, None, linear)
    curve = next(curve for curve in problem.model.curves if curve.id == term.effect.id)
    found = surface_of(around, curve, term.size * surface.values)
    if found is None:
        return None
    return found, replace(term, effect=driven_by(curve, found), size=found.amplitude, curve=found)


def surface_of(linear: Linear, curve: ComponentCurve, known: Array | None = None) -> FactorSurface | None:
    """Return the best curve of a component, None where it gains too little or its inputs are not recorded.

    `known` is the curve that the model has already, shape (first, second).
    """
    problem = linear.problem
    if any(channel not in problem.signals.value for channel in curve.carrier.needs):
        return None
    inputs = curve.inputs(problem.model.constants, {name: problem.along(name) for name in problem.signals.value})
    (first, second), (x, y) = curve.axes.items(), inputs
    shape = first[1].values.size, second[1].values.size
    nodes, share = on_surface(first[1].values, second[1].values, x, y)
    hats = np.zeros((shape[0] * shape[1], problem.K))
    np.add.at(hats, (nodes, np.arange(problem.K)[:, None]), share)
    seen: NDArray[np.bool_] = np.asarray(hats[:, problem.used].any(1))
    columns = linear.whiten(slope_of(linear, curve.carrier, curve.carrier.null) * hats[seen, None, None])
    gradient, normal = gradient_and_normal(linear, columns)
    sizes = [size * curve.deviation for size in CURVE_SIZES]
    if known is not None:
        gradient = gradient - normal @ known.reshape(-1)[seen]
        sizes = [max(sizes[-1], float(np.abs(known).max()))]
    fits = [
        _smooth(gradient, normal, size, correlation, seen) for correlation in curve.correlations() for size in sizes
    ]
    net, cost, values, errors = max(fits, key=lambda each: each[0])
    along = (share * values[nodes]).sum(1)
    at = int(np.argmax(np.abs(along) * problem.used))
    if net <= 0.0 or along[at] == 0.0:
        return None
    return FactorSurface(
        inputs=(first[0], second[0]),
        units=(first[1].unit, second[1].unit),
        first=first[1].values,
        second=second[1].values,
        values=(values / along[at]).reshape(shape),
        errors=errors.reshape(shape),
        largest=(float(x[at]), float(y[at])),
        amplitude=float(along[at]),
        cost=cost,
    )


def driven_by(curve: ComponentCurve, surface: FactorSurface) -> Effect:
    """Return the effect of a curve, which follows its inputs wherever they are known; its parameter is the amplitude."""

    def shape(constants: Any, x: Mapping[str, Array]) -> Array:
        return values_at(on_surface(surface.first, surface.second, *curve.inputs(constants, x)), surface.values)

    return following(curve.id, curve.carrier, shape, curve.deviation, LARGEST * curve.deviation)


def _smooth(
    gradient: Array, normal: Array, deviation: float, correlation: Array, seen: NDArray[np.bool_]
) -> tuple[float, float, Array, Array]:
    """Return what a curve gains less its cost, that cost, and its values at all nodes with their standard errors."""
    root = np.linalg.cholesky(correlation[np.ix_(seen, seen)] + RIDGE * np.eye(int(np.count_nonzero(seen))))
    strength, modes = np.linalg.eigh(root.T @ normal @ root)
    strength, along = np.maximum(strength, 0.0), modes.T @ root.T @ gradient
    precision = strength + deviation**-2.0
    gain = float((along**2 / precision - 0.5 * strength * (along / precision) ** 2).sum())
    cost = COST * float((strength / precision).sum())
    everywhere = correlation[:, seen] @ np.linalg.inv(root).T @ modes
    return gain - cost, cost, -everywhere @ (along / precision), np.sqrt((everywhere**2 / precision).sum(1))
