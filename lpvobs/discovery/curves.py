"""Candidates that follow a curve: over a channel of the log, or, as a component of the engine, over its own inputs.

A gain or an offset of the sensor, or a flow of the engine, may follow any channel. A component may pass more or less than its
model says. Its curve is a surface between nodes, as a calibration has them (`engines.unknowns`): small and smooth before any data.
Whether it follows one input or two, and how large it may be, is chosen by what it gains less the cost of as many coefficients
as the data determine. Constants of the engine share its level: its standard error contains their tolerance.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lpvobs.discovery.courses import Curve, FactorSurface, Shape
from lpvobs.discovery.evidence import Candidate, best_onset, fit_candidate
from lpvobs.discovery.fit import linearised
from lpvobs.discovery.forms import CHANNEL, TIME, Factor, shape_of
from lpvobs.discovery.linear import Linear
from lpvobs.discovery.places import averaged
from lpvobs.discovery.residual import Problem, Term
from lpvobs.discovery.sizes import is_clear, slope_of
from lpvobs.discovery.thresholds import COST, CURVE_SIZES, KNOTS, LARGEST, MOST_LEVELS, RIDGE, TENT_WIDTHS
from lpvobs.engines.curves import on_surface, values_at
from lpvobs.engines.effects import Effect, Signals
from lpvobs.engines.residual_model import ComponentCurve
from lpvobs.records import Array


def rate_of(values: Array, spacing: float) -> Array:
    """Return the change per instant, averaged over a second; instants are a spacing [s] apart."""
    return np.asarray(np.gradient(averaged(values, spacing)))


def basis(values: Array) -> tuple[Array, Array]:
    """Return knots, shape (k,), and hat functions, shape (k, K), along a channel."""
    levels = np.unique(values)
    knots = levels if levels.size <= MOST_LEVELS else np.unique(np.quantile(values, KNOTS))
    return knots, np.stack([np.interp(values, knots, np.eye(knots.size)[i]) for i in range(knots.size)])


def shapes(linear: Linear) -> Iterator[tuple[str, str, Array]]:
    """Yield every auxiliary channel and, where it is no switch, its rate."""
    for name, values in linear.problem.auxiliary.items():
        yield name, "value", values
        if np.unique(values).size > MOST_LEVELS:
            yield name, "rate", rate_of(values, linear.problem.spacing)


def channel_candidates(linear: Linear, most: int = 2) -> list[Candidate]:
    """Return the best curves of as many channels as candidates, if they gain more than their coefficients cost."""
    best: dict[str, tuple[float, Effect, Curve]] = {}
    for name, of, values in shapes(linear):
        found = _best_curve(linear, name, of, values, linear.problem.carriers)
        if found[0] > best.get(name, (0.0,))[0]:
            best[name] = found
    ranked = sorted(best.values(), key=lambda item: -item[0])[:most]
    return [_fitted(linear, effect, curve) for _, effect, curve in ranked]


def over_time(linear: Linear) -> Candidate:
    """Return the best curve of the sensor over the time of each log: an error that changes slowly, whatever its cause."""
    problem = linear.problem
    at_sensor = [effect for effect in problem.carriers if effect.place == "sensor"]
    # a frozen map does not hold the average of the error
    _, effect, curve = _best_curve(linear, TIME, "value", problem.time, at_sensor, level=not problem.prior.free)
    return _fitted(linear, effect, curve)


def _best_curve(
    linear: Linear, name: str, of: str, values: Array, carriers: Sequence[Effect], level: bool = False
) -> tuple[float, Effect, Curve]:
    """Return what the best curve of any carrier gains less what its coefficients cost, its effect, and the curve.

    Its mean is zero, but for a curve with a `level` of its own.
    """
    problem, found = linear.problem, []
    knots, hats = basis(values)
    off = not problem.prior.free and knots.size <= MOST_LEVELS  # a frozen map does not hold the average of a switch
    middle = np.zeros((knots.size, 1)) if level or off else hats.mean(1, keepdims=True)
    first = 0 if level else 1
    for effect in carriers:
        slope = slope_of(linear, effect, effect.null)
        columns = linear.whiten(np.stack([slope * hat for hat in (hats - middle)[first:]]))
        gradient, normal = linear.beside(columns)
        normal += 1e-9 * max(float(np.trace(normal)), 1e-300) * np.eye(len(columns))
        coefficients = -np.linalg.solve(normal, gradient)
        gain = float(-0.5 * gradient @ coefficients)
        found.append((gain - COST * coefficients.size, effect, coefficients))
    score, effect, coefficients = max(found, key=lambda item: item[0])
    sizes = np.concatenate([np.zeros(first), coefficients])
    curve = Curve(name, of, effect.id, knots, sizes - float(sizes @ middle[:, 0]))
    along = problem.over_columns(np.interp(values, curve.knots, curve.values))
    return score, along_channel(curve, effect, along), curve


def _fitted(
    linear: Linear, effect: Effect, curve: Shape, size: float | None = None, begin: float = -np.inf
) -> Candidate:
    """Return a curve as a candidate, its gain less what its coefficients cost."""
    candidate = fit_candidate(linear, effect, size=size, like=Term(effect, effect.null, begin, curve=curve))
    return replace(candidate, gain=candidate.gain - curve.cost)


def along_channel(curve: Curve, carrier: Effect, shape: Array) -> Effect:
    """Return the effect whose size follows a curve over a channel, column by column; its parameter is the multiple of the curve."""
    drive = f"drives on which channel {curve.channel} changes independently of the other channels"
    follows = following(f"{CHANNEL}{curve.channel}", carrier, lambda *_: shape, 0.2, 5.0)
    return replace(follows, drive=drive, known_as=shape_of(carrier, Factor(curve.channel, curve.of)))


def following(
    name: str, carrier: Effect, shape: Callable[[Any, Mapping[str, Array]], Array], size: float, most: float
) -> Effect:
    """Return the effect whose size follows a shape, a function of constants and channels; its parameter is the multiple."""
    # `size` is a noticeable multiple, `most` the largest.

    def apply(signals: Signals, amplitude: float) -> Signals:
        return carrier.apply(signals, carrier.null + amplitude * shape(signals.constants, signals.value))

    return Effect(name, "amplitude", "1", 0.0, size, -most, most, carrier.place, apply, carrier.drive)


def component_candidates(linear: Linear, plain: Sequence[Candidate]) -> list[Candidate]:
    """Return the best curve of every component as a candidate, if it gains more than its coefficients cost.

    It acts all the time, or begins where the component's factor does among the plain effects, or else where the best of these
    does, or else where its own shape says.
    """
    found = []
    for curve in linear.problem.model.curves:
        alike = next((c for c in plain if c.id == curve.carrier.id), plain[0]).term
        whole = _of_component(linear, curve, -np.inf)
        begins = onset(alike) or ([] if whole is None else best_onset(linear, whole))
        found += [whole, *(_of_component(linear, curve, begin) for begin in begins)]
    return [each for each in found if each is not None]


def curve_in_place_of(linear: Linear, plain: Term) -> Candidate | None:
    """Return the best curve of a component whose factor a plain effect is, at the same time; None where it explains too little."""
    curve = next((c for c in linear.problem.model.curves if c.carrier.id == plain.effect.id), None)
    if curve is None or not (plain.whole or onset(plain)):
        return None
    return _of_component(linear, curve, plain.begin)


def _of_component(linear: Linear, curve: ComponentCurve, begin: float) -> Candidate | None:
    surface = surface_of(linear, curve, begin)
    if surface is None:
        return None
    found = _fitted(linear, driven_by(curve, surface), surface, surface.amplitude, begin)
    return found if found.term.effect.low < found.term.size < found.term.effect.high else None


def onset(term: Term) -> list[float]:
    """Return when a term begins; none if it is there from the first sample, ends, or has a course."""
    return [term.begin] if term.course is None and np.isfinite(term.begin) and not np.isfinite(term.end) else []


def surface_again(linear: Linear, index: int, surface: FactorSurface) -> tuple[FactorSurface, Term] | None:
    """Return one of the curves of a model found again at the map, the constants and the weights there, and its term."""
    problem, term = linear.problem, linear.terms[index]
    others = tuple(t for i, t in enumerate(linear.terms) if i != index)
    held = replace(problem, held=(*problem.held, term))
    around = linearised(held, others, linear.theta, linear.beta, linear.noise, None, linear)
    curve = next(curve for curve in problem.model.curves if curve.id == term.effect.id)
    found = surface_of(around, curve, term.begin, term.size * surface.values)
    if found is None:
        return None
    return found, replace(term, effect=driven_by(curve, found), size=found.amplitude, curve=found)


def surface_of(
    linear: Linear, curve: ComponentCurve, begin: float = -np.inf, known: Array | None = None
) -> FactorSurface | None:
    """Return the best curve of a component, None where it gains too little or its inputs are not recorded.

    It acts from `begin` on. `known` is the curve that the model has already, shape (first, second).
    """
    problem = linear.problem
    if not is_recorded(problem, curve):
        return None
    (first, second), (x, y) = curve.axes.items(), _inputs(problem, curve)
    shape = first[1].values.size, second[1].values.size
    nodes, share, seen, gradient, normal = _by_node(linear, curve, begin)
    sizes = [size * curve.deviation for size in CURVE_SIZES]
    if known is not None:
        gradient = gradient - normal @ known.reshape(-1)[seen]
        sizes = [max(sizes[-1], float(np.abs(known).max()))]
    line, plane = ([_smooth(gradient, normal, size, alike, seen) for size in sizes] for alike in curve.correlations())
    line += [_tent(gradient, normal, curve.deviation, tent, seen) for tent in _tents(curve)]
    net, cost, values, errors = best = max([*line, *plane], key=lambda each: each[0])
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
        single=any(each is best for each in line),
    )


def is_recorded(problem: Problem, curve: ComponentCurve) -> bool:
    """Return whether the logs have all that a component's curve needs."""
    return all(channel in problem.signals.value for channel in curve.carrier.needs)


def _inputs(problem: Problem, curve: ComponentCurve) -> tuple[Array, Array]:
    return curve.inputs(problem.model.constants, {name: problem.along(name) for name in problem.signals.value})


def _by_node(
    linear: Linear, curve: ComponentCurve, begin: float
) -> tuple[NDArray[np.int64], Array, NDArray[np.bool_], Array, Array]:
    """Return nodes and shares along the places, which nodes the drive has seen, and gradient and normal matrix of those."""
    problem, (first, second) = linear.problem, [axis.values for axis in curve.axes.values()]
    x, y = _inputs(problem, curve)
    nodes, share = on_surface(first, second, x, y)
    share = share * (problem.clock >= begin)[:, None]
    hats = np.zeros((first.size * second.size, problem.K))
    np.add.at(hats, (nodes, np.arange(problem.K)[:, None]), share)
    seen: NDArray[np.bool_] = np.asarray(hats[:, problem.used].any(1))
    columns = linear.whiten(slope_of(linear, curve.carrier, curve.carrier.null) * hats[seen, None, None])
    return nodes, share, seen, *linear.beside(columns)


def shape_shown(linear: Linear, curve: ComponentCurve, begin: float) -> tuple[float, float]:
    """Return gradient and information of the shape of a component's curve over its first input, its factor free beside it.

    They are the norm of the gradient by all shapes, each in units of its noise, and the number of these shapes. The square of the
    one over the other is one on average where there is noise alone. Shapes of which the drive tells less than is known beforehand
    count in part, and none counts where noise tells as much of the factor as the drive does.
    """
    slope = linear.whiten(slope_of(linear, curve.carrier, curve.carrier.null) * (linear.problem.clock >= begin))
    factor = float(linear.beside(slope[None])[1][0, 0])
    if not is_clear(linear, slope, factor):
        return 0.0, 0.0
    *_, seen, gradient, normal = _by_node(linear, curve, begin)
    along = normal.sum(1)  # the factor has the same size at all nodes
    root = np.linalg.cholesky(curve.correlations()[0][np.ix_(seen, seen)] + RIDGE * np.eye(int(np.count_nonzero(seen))))
    strength, modes = np.linalg.eigh(root.T @ (normal - np.outer(along, along) / factor) @ root)
    shape = modes.T @ root.T @ (gradient - along * (float(gradient.sum()) / factor))
    shape, strength = shape[strength > 0.0], strength[strength > 0.0]
    precision = strength + curve.deviation**-2.0
    return float(np.linalg.norm(shape / np.sqrt(precision))), float((strength / precision).sum())


def driven_by(curve: ComponentCurve, surface: FactorSurface) -> Effect:
    """Return the effect of a curve, which follows its inputs wherever they are known; its parameter is the amplitude."""

    def shape(constants: Any, x: Mapping[str, Array]) -> Array:
        return values_at(on_surface(surface.first, surface.second, *curve.inputs(constants, x)), surface.values)

    follows = following(curve.id, curve.carrier, shape, curve.deviation, LARGEST * curve.deviation)
    # one over two inputs has a size that no other has: it is known by its place alone
    return replace(follows, known_as=(curve.carrier.id, curve.id) if surface.single else (curve.carrier.place,))


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


def _tents(curve: ComponentCurve) -> Iterator[Array]:
    """Yield the values at all nodes of narrow and wide tents around each node of the first input."""
    first, second = curve.axes.values()
    for width in TENT_WIDTHS:
        for middle in first.values:
            tent = np.maximum(1.0 - np.abs(first.values - middle) / (width * curve.lengths[0]), 0.0)
            yield np.repeat(tent, second.values.size)


def _tent(
    gradient: Array, normal: Array, deviation: float, tent: Array, seen: NDArray[np.bool_]
) -> tuple[float, float, Array, Array]:
    """Return the same of a curve that is a multiple of one tent: its place, one of a few, is what costs."""
    against, strength = float(tent[seen] @ gradient), max(float(tent[seen] @ normal @ tent[seen]), 0.0)
    precision = strength + deviation**-2.0
    size = -against / precision
    gain = -size * against - 0.5 * strength * size**2 if abs(size) < LARGEST * deviation else 0.0
    return gain - COST, COST, size * tent, tent / np.sqrt(precision)
