"""The size of one effect that explains most beside map and constants, sought by Gauss-Newton steps."""

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np

from lpvobs.discovery.imbalances import change_of_residual
from lpvobs.discovery.linear import Linear, dot
from lpvobs.discovery.normal import gram_of
from lpvobs.discovery.thresholds import EFFECT_STEP, SIZE_PASSES, STILL, STRAIGHT, STRONG
from lpvobs.engines.effects import Effect
from lpvobs.records import Array

KEPT = 64  # changes of the residual that are kept at most: an effect is tried on several intervals from one size


@lru_cache(KEPT)
def change_of(linear: Linear, effect: Effect, size: float) -> Array:
    """Return how a further effect that acts all the time changes the residual, shape (2, B, K), not whitened."""
    found, noticeable = np.zeros(linear.raw.shape), effect.null + effect.size
    if effect.straight and size != noticeable:
        found = (size - effect.null) / effect.size * change_of(linear, effect, noticeable)
    elif size != effect.null:
        scenes = tuple((on, effect.apply(s, size)) for on, s in linear.scenes)
        found = change_of_residual(linear.problem, effect, linear.scenes, scenes, linear.theta, linear.from_signals)
    found.setflags(write=False)  # it is kept
    return found


def forget() -> None:
    """Let go of what is kept of the last model: of an hour of driving it holds hundreds of megabytes."""
    change_of.cache_clear()
    gram_of.cache_clear()


def slope_of(linear: Linear, effect: Effect, size: float, here: Array | None = None) -> Array:
    """Return the derivative of that change by the size; `here` is the change at this size, if it is known.

    At none it is the mean over a noticeable size on either side: the derivative at this very size may be noise, as where the
    compressor stalls, and the sides may differ.
    """
    if size == effect.null:
        below, above = max(effect.null - effect.size, effect.low), min(effect.null + effect.size, effect.high)
        return (change_of(linear, effect, above) - change_of(linear, effect, below)) / (above - below)
    h = EFFECT_STEP * effect.size
    return (change_of(linear, effect, size + h) - (change_of(linear, effect, size) if here is None else here)) / h


@dataclass(frozen=True, eq=False)
class Trial:
    """An effect at one size, with map and constants projected out."""

    linear: Linear
    size: float
    change: Array  # (2, B, K) of the residual, whitened
    slope: Array  # (2, B, K) its derivative by the size
    products: Array  # (2, n) of both with the column of every unknown
    answers: Array  # (2, n) the steps of the unknowns that answer these

    @cached_property
    def gain(self) -> float:
        """By how much it lowers half the sum of squares."""
        products, answer = self.products[0], self.answers[0]
        alone = 0.5 * dot(self.change, self.change) + dot(self.change, self.linear.residual)
        return float(0.5 * products @ answer + products @ self.linear.newton_step - alone)

    @cached_property
    def information(self) -> float:
        """What the data say about the size, 1/unit^2."""
        return dot(self.slope, self.slope) - float(self.products[1] @ self.answers[1])

    @property
    def step(self) -> float:
        """The Gauss-Newton step of the size."""
        answer = self.answers[0] + self.linear.newton_step
        gradient = dot(self.slope, self.linear.residual + self.change) - float(self.products[1] @ answer)
        return -gradient / self.information

    def along(self, size: float) -> "Trial":
        """Return it at another size, to which the change goes along a straight line."""
        step = size - self.size
        ahead = np.array([[1.0, step], [0.0, 1.0]])
        change = self.change + step * self.slope
        return replace(self, size=size, change=change, products=ahead @ self.products, answers=ahead @ self.answers)

    def from_none(self, null: float) -> "Trial":
        """Return it with the whole change for the slope, which is clear where the derivative at this very size is noise."""
        whole = 1.0 / (self.size - null)
        products, answers = (np.stack([both[0], whole * both[0]]) for both in (self.products, self.answers))
        return replace(self, slope=whole * self.change, products=products, answers=answers)


def _trial(linear: Linear, size: float, both: Array) -> Trial:
    """Return an effect at a size from its change and slope, shape (2, 2, B, K), not whitened."""
    white = linear.whiten(both)
    products = linear.products(white)
    return Trial(linear, size, white[0], white[1], products, linear.project(products.T).T)


def best_trial(linear: Linear, effect: Effect, size: float, on: Array) -> Trial:
    """Return an effect at the size, sought from a given one, at which it gains most; `on`, shape (K,), is where it acts."""
    best, ahead = None, np.empty(0)
    for _ in range(SIZE_PASSES):
        plain = change_of(linear, effect, size)
        if best is not None and np.abs(plain - ahead).max() <= STRAIGHT * np.abs(plain).max():
            return max(best, best.along(size), key=lambda trial: trial.gain)
        lean = slope_of(linear, effect, size, plain)
        here = _trial(linear, size, np.stack([plain, lean]) * on)
        if best is not None and here.gain <= best.gain:
            size = 0.5 * (size + best.size)
            continue
        best = here
        # Where the derivative is noise, as near the stall of the compressor, the effect may be told at twice the size.
        step = here.step if is_clear(linear, here.slope, here.information) else size - effect.null
        new = float(np.clip(size + step, effect.low, effect.high))
        if here.information > 0.0 and (new - size) ** 2 * here.information < STILL:
            break
        size, ahead = new, plain + (new - size) * lean
    assert best is not None
    return best


def is_clear(linear: Linear, slope: Array, information: float) -> bool:
    """Return whether the information about a size is more than the noise of its derivative."""
    return bool(information > STRONG * np.sqrt(blur(linear, slope).sum()))


def blur(linear: Linear, direction: Array) -> Array:
    """Return the variance by block that noise gives to the power of a direction across views, shape (blocks,)."""
    mean, difference = direction**2
    return np.asarray(np.add.reduceat(((mean + difference) * difference).sum(0), linear.problem.first))
