"""Candidates driven by a channel of the log: a gain or an offset of the sensor, or a flow of the engine, follows the channel."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import scipy

from lpvobs.discovery.evidence import Candidate, fit_candidate, slope_of
from lpvobs.discovery.linear import Linear, dot
from lpvobs.discovery.residual import Term
from lpvobs.discovery.shapes import Curve
from lpvobs.discovery.thresholds import COST, KNOTS, MOST_LEVELS, RATE_WINDOW
from lpvobs.engines.effects import Effect, Signals
from lpvobs.records import Array


def rate_of(values: Array) -> Array:
    """Return the change per instant, averaged over a second."""
    kernel = np.full(RATE_WINDOW, 1.0 / RATE_WINDOW)
    calm = np.convolve(np.pad(values, RATE_WINDOW // 2, mode="edge"), kernel, mode="valid")
    return np.asarray(np.gradient(calm))


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
            yield name, "rate", rate_of(values)


def channel_candidates(linear: Linear) -> list[Candidate]:
    """Return the best curve of every channel as a candidate, if it gains more than its coefficients cost."""
    problem = linear.problem
    carriers = problem.carriers
    slopes = {effect.id: slope_of(linear, effect, effect.null) for effect in carriers}
    best: dict[str, tuple[float, Effect, Curve]] = {}
    for name, of, values in shapes(linear):
        knots, hats = basis(values)
        off = not problem.prior.free and knots.size <= MOST_LEVELS  # a frozen map does not hold the average of a switch
        middle = np.zeros((knots.size, 1)) if off else hats.mean(1, keepdims=True)
        for effect in carriers:
            columns = linear.whiten(np.stack([slopes[effect.id] * hat for hat in (hats - middle)[1:]]))
            gain, coefficients = _joint(linear, columns)
            if gain - COST * coefficients.size > best.get(name, (0.0,))[0]:
                sizes = np.concatenate([[0.0], coefficients])
                curve = Curve(name, of, effect.id, knots, sizes - float(sizes @ middle[:, 0]))
                along = problem.over_columns(np.interp(values, curve.knots, curve.values))
                driven = along_channel(curve, effect, along)
                best[name] = gain - COST * coefficients.size, driven, curve
    ranked = sorted(best.values(), key=lambda item: -item[0])[:2]
    return [_fitted(linear, effect, curve) for _, effect, curve in ranked]


def _fitted(linear: Linear, effect: Effect, curve: Curve) -> Candidate:
    """Return a curve as a candidate, its gain less what its coefficients cost.

    It is told by what is left beside what a healthy engine seems to have of the carrier, whose size follows the curve.
    """
    candidate = fit_candidate(linear, effect, like=Term(effect, effect.null, curve=curve))
    usual = max(float(np.sqrt(np.mean(curve.values**2))), np.finfo(float).tiny)
    carrier = next(effect for effect in linear.problem.carriers if effect.id == curve.carrier)
    seems = linear.problem.seems(Term(carrier, usual), candidate.information / candidate.told / usual**2)
    return replace(candidate, gain=candidate.gain - COST * (curve.knots.size - 1), told=1.0 / (1.0 + seems))


def along_channel(curve: Curve, carrier: Effect, shape: Array) -> Effect:
    """Return the effect whose size follows a curve over a channel, column by column; its parameter is the multiple of the curve."""
    drive = f"drives on which channel {curve.channel} changes independently of the other channels"
    return replace(following(f"channel:{curve.channel}", carrier, lambda *_: shape, 0.2, 5.0), drive=drive)


def following(
    name: str, carrier: Effect, shape: Callable[[Any, Mapping[str, Array]], Array], size: float, most: float
) -> Effect:
    """Return the effect whose size follows a shape, a function of constants and channels; its parameter is the multiple."""
    # `size` is a noticeable multiple, `most` the largest.

    def apply(signals: Signals, amplitude: float) -> Signals:
        return carrier.apply(signals, carrier.null + amplitude * shape(signals.constants, signals.value))

    return Effect(name, "amplitude", "1", 0.0, size, -most, most, carrier.place, apply, carrier.drive)


def _joint(linear: Linear, columns: Array) -> tuple[float, Array]:
    """Return the gain of several directions together, and their coefficients."""
    gradient, normal = gradient_and_normal(linear, columns)
    normal += 1e-9 * max(float(np.trace(normal)), 1e-300) * np.eye(len(columns))
    coefficients = -np.asarray(np.linalg.solve(normal, gradient), dtype=float)
    return float(-0.5 * gradient @ coefficients), coefficients


def gradient_and_normal(linear: Linear, columns: Array) -> tuple[Array, Array]:
    """Return the products of whitened directions with the residual and with each other, (m, m), unknowns projected out."""
    products = np.stack([linear.products(column) for column in columns])
    answers = scipy.linalg.cho_solve((linear.factor, True), products.T, check_finite=False)
    mean, difference = columns.reshape(len(columns), 2, -1).swapaxes(0, 1)
    gradient = np.array([dot(column, linear.residual) for column in columns]) - products @ linear.newton_step
    return gradient, mean @ mean.T - difference @ difference.T - products @ answers
