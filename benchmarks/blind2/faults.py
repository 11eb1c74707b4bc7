"""What is wrong in a drive of the second bank, as physics has it and not as the catalogue does.

Every class here is handed to `simulate` as an effect. It has `settled(truth, duration)` and `on(W, time, point)`, as what disturbs
the reading has, or is a course of an effect inside the engine. Sizes are relative changes of the reading, so they can be
compared. They were written before any term of the identifier's search for formulas was known.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lpvobs.simulation.effects import span_at_work
from lpvobs.simulation.instruments import lagged

Array = NDArray[np.float64]
Point = Mapping[str, Array]
Law = Callable[[float, Array, Array, Point], Array]


@dataclass(frozen=True)
class Misreading:
    """The air flow sensor reads a multiple of the flow that a law gives.

    `law` takes size, reading [kg/s], time [s] and the true point, and returns the new reading [kg/s].
    """

    id: str
    law: Law
    size: float
    onset: float | None = None
    end: float | None = None

    def settled(self, truth: Point, duration: float) -> "Misreading":
        """Return itself: nothing is decided by the drive."""
        return self

    def on(self, W: Array, time: Array, point: Point) -> Array:
        """Return the reading with the effect."""
        return np.where(span_at_work(self.onset, self.end, time), self.law(self.size, W, time, point), W)


@dataclass(frozen=True)
class DirtyFilm:
    """King's law E^2 = A + B W^n whose B has fallen; A has moved so that it reads right at one flow [kg/s]."""

    crossing: float
    exponent: float

    def __call__(self, size: float, W: Array, time: Array, point: Point) -> Array:
        """Return the reading, shape (N,), of flows [kg/s]."""
        n = self.exponent
        forward = ((1.0 - size) * np.maximum(W, 0.0) ** n + size * self.crossing**n) ** (1.0 / n)
        return np.where(W > 0.0, forward, W)


def pulsating(size: float, W: Array, time: Array, point: Point) -> Array:
    """A film that cannot tell direction reads the mean of |1 + a sin|; pulses ring near 1250 rpm and grow with load."""
    a = 1.0 + 1.4 * size * np.exp(-(((point["n_e"] - 1250.0) / 450.0) ** 2)) * (point["u_delta"] / 25.0)
    a = np.where(point["u_delta"] > 4.0, np.clip(a, 1.0, 3.0), 1.0)
    turned = np.arcsin(1.0 / a)
    return W * (2.0 / np.pi) * (turned + np.sqrt(np.maximum(a**2 - 1.0, 0.0)))


def bypassed(size: float, W: Array, time: Array, point: Point) -> Array:
    """A split bellows between sensor and compressor: its slit opens with the depression, so the share grows with flow."""
    return W / (1.0 + size * (np.maximum(W, 1e-4) / 0.04) ** 0.35)


def drawn_film(rng: np.random.Generator) -> Law:
    """Return a dirty film that reads right somewhere between 8 and 30 g/s."""
    return DirtyFilm(float(np.exp(rng.uniform(np.log(0.008), np.log(0.03)))), float(rng.uniform(0.4, 0.5)))


OTHER_LAWS: Mapping[str, tuple[Callable[[np.random.Generator], Law], float, float]] = {
    "maf.contamination": (drawn_film, 0.03, 0.12),
    "maf.backflow": (lambda _: pulsating, 0.5, 1.5),
    "leak.inlet": (lambda _: bypassed, 0.03, 0.10),
}
"""How the law is drawn, least and most size."""


@dataclass(frozen=True)
class Hose:
    """Course of a leak whose slit opens with load: from 0.6 of its area at no fuel to the whole at 40 mg, half a second late."""

    name: str = "always"
    drive: tuple[Array, Array] | None = None

    def along(self, time: Array, inputs: Point) -> "Hose":
        """Return the course on a drive."""
        load = lagged(inputs["u_delta"], float(time[1] - time[0]), 0.5)
        return replace(self, drive=(time, np.clip(0.6 + 0.4 * load / 40.0, 0.6, 1.0)))

    def share(self, time: Array, onset: float | None, end: float | None) -> Array:
        """Return the share of the area that is open."""
        if self.drive is None:
            raise ValueError("the course of a hose is that of a drive")
        return np.where(span_at_work(onset, end, time), np.interp(time, *self.drive), 0.0)


def housing(time: Array, point: Point) -> Array:
    """Temperature of the sensor's housing: between air and coolant, 80 s late."""
    toward = point["T_amb"] + 0.3 * (point["T_coolant"] - point["T_amb"])
    return lagged(toward, float(time[1] - time[0]), 80.0)


def _rate(values: Array, time: Array, tau: float) -> Array:
    return np.gradient(lagged(values, float(time[1] - time[0]), tau), time)


UNLISTED: Mapping[str, tuple[Callable[[Array, Point], Array], frozenset[str]]] = {
    "housing that warms up": (housing, frozenset({"T_coolant", "T_amb", "T_charge"})),
    "supply voltage over engine speed": (lambda time, point: point["n_e"], frozenset({"n_e"})),
    "heat from the manifold": (lambda time, point: point["T_im"], frozenset({"T_im", "T_charge"})),
    "pressure strokes": (lambda time, point: _rate(point["p_im"], time, 0.2), frozenset({"p_im"})),
    "soot blown back": (
        lambda time, point: point["u_egr"] * point["p_em"] / point["p_im"],
        frozenset({"u_egr", "p_em"}),
    ),
    "damp and warm air": (
        lambda time, point: point["humidity"] * (point["T_amb"] - 273.0),
        frozenset({"humidity", "T_amb"}),
    ),
    "exhaust against the intake": (lambda time, point: point["p_em"] - point["p_im"], frozenset({"p_em", "p_im"})),
    "shaken by the wheel": (lambda time, point: point["omega_t"] ** 2, frozenset({"omega_t"})),
}
"""Pattern over time and point, and the channels of which a formula has to have one at least."""


@dataclass(frozen=True)
class Unlisted:
    """A cause in no catalogue: the reading is off by a share that follows a pattern; `size` is the share's rms over the drive."""

    id: str  # a name of `UNLISTED`
    size: float
    scale: tuple[float, float] = (0.0, 1.0)
    onset: float | None = None
    end: float | None = None

    def settled(self, truth: Point, duration: float) -> "Unlisted":
        """Return it with the pattern's mean and spread over the drive."""
        time = np.linspace(0.0, duration, truth["n_e"].size)
        pattern = UNLISTED[self.id][0](time, truth)
        return replace(self, scale=(float(pattern.mean()), float(pattern.std())))

    def on(self, W: Array, time: Array, point: Point) -> Array:
        """Return the reading with the effect."""
        middle, spread = self.scale
        share = self.size * (UNLISTED[self.id][0](time, point) - middle) / spread
        return W * (1.0 + np.clip(share, -0.5, 0.5))
