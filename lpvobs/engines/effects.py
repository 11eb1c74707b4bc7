"""Effects: faults of an engine or its sensors, each as a change of the signals that the balances are computed from.

Nothing that injects an effect into a simulation reads this module: a loop that knew the simulator's formulas would prove nothing.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lpvobs.records import Array

SENSOR = "W_maf"  # the channel of the sensor under test, of every engine
AIR_AT_CALIBRATION = 298.0  # [K] Air temperature at which a sensor whose gain depends on temperature reads right
# [kg/s] Flows at which a contaminated film may read right, too much below and too little above: the usual one, and some further
CROSSINGS = (0.02, 0.012, 0.035)
FILTER = 2.08e5  # [Pa/(kg/s)^2] Depression of the air filter over the squared flow: 3 kPa at 0.12 kg/s
LITTLE = 1e-3  # [kg/s] Flow below which the noise of a reading hides the other effects on it

TRANSIENTS = "fast changes of load at constant speed"
STEADY = "long stays at many operating points, with and without the effect"
BOOST = "the same operating points at low and at high boost"
ALTITUDE = "drives at other ambient pressures or temperatures"


@dataclass(frozen=True)
class Signals:
    """All that the balances are computed from, in C columns."""

    time: Array  # (C,) [s] since the start of the log
    clock: Array  # (C,) [s], the same where there is one log; further logs follow with a pause
    value: Mapping[str, Array]  # (C,) channels
    rate: Mapping[str, Array]  # (C,) their time derivatives
    # (l, C) sizes of the leaks and factors that the engine's model lacks, in the order of `ResidualModel.lacks`
    lacks: Array
    later: Callable[[float], Array]  # returns the reading of the sensor under test some time [s] later, shape (C,)
    slow: Callable[[str], Array]  # returns the rate of a channel by name through a wide window, shape (C,)
    constants: Any  # the engine's constants at the current point of the model
    error: Array | None = None  # (C,) [kg/s] error of the sensor under test, where a map that stands tells it

    def __getitem__(self, channel: str) -> Array:
        """Return the values of one channel, shape (C,)."""
        return self.value[channel]

    def corrected(self, channel: str, value: Array, rate: Array | None = None) -> "Signals":
        """Return the signals with another one in place of a channel; without a rate, the rate stays."""
        rates = self.rate if rate is None else {**self.rate, channel: rate}
        return replace(self, value={**self.value, channel: value}, rate=rates)

    def where(self, on: NDArray[np.bool_], other: "Signals") -> "Signals":
        """Return the other signals in some columns, shape (C,), and these elsewhere."""
        if on.all():
            return other

        def mixed(there: Array, here: Array) -> Array:
            return here if there is here else np.where(on, there, here)

        value = {name: mixed(other.value[name], x) for name, x in self.value.items()}
        rate = {name: mixed(other.rate[name], x) for name, x in self.rate.items()}
        return replace(self, value=value, rate=rate, lacks=mixed(other.lacks, self.lacks))


Change = Callable[[Signals, Any], Signals]


@dataclass(frozen=True)
class Inside:
    """A constant inside an effect that nobody knows beforehand."""

    name: str
    unit: str
    value: float
    tried: tuple[float, ...]  # by a search, the usual value first
    change: Callable[[float], Change]  # returns `Effect.apply` for a value of the constant


@dataclass(frozen=True)
class Effect:
    """One effect that a model may lack, with one parameter."""

    id: str  # as in the contract, like parameter and unit
    parameter: str
    unit: str
    null: float  # the parameter's value when the effect is absent
    size: float  # a noticeable change of the parameter; it sets the step of difference quotients.
    low: float  # range in which the parameter is sought
    high: float
    place: str  # where it acts; `sensor` for what changes the readings of the sensor under test and nothing else
    apply: Change  # returns the signals corrected for the effect, or with the effect in the balances
    drive: str  # the kind of drive that separates it from similar effects
    # whether a map made from the same log contains it when it is there from the first to the last sample
    in_map: bool = False
    moves_point: bool = False  # whether it changes the operating point at which the map is read
    needs: tuple[str, ...] = ()  # channels without which a log cannot show it
    inside: Inside | None = None
    # other laws that it may follow: it is not told from what explains the logs as well as one of them
    laws: tuple[Change, ...] = ()
    # standard error of its size where the engine is not its model, as a share of the change: neither a bench nor healthy drives
    # show how the balances respond to it
    unlearned: float = 0.0
    straight: bool = False  # whether all balances change in proportion to how far the parameter is from `null`
    stays: bool = False  # whether it has no end within a drive
    # by what healthy drives tell how it varies where that is not itself: another effect, and the shape that it has beside that one
    known_as: tuple[str, ...] = ()

    def having(self, value: float) -> "Effect":
        """Return the effect with another value of the constant inside it; raises TypeError if there is none."""
        inside = self.inside
        if inside is None:
            raise TypeError(f"the effect '{self.id}' has no constant inside")
        return replace(self, apply=inside.change(value), inside=replace(inside, value=value))

    @property
    def variants(self) -> tuple["Effect", ...]:
        """The effect with each value of the constant inside it that is tried, but its own."""
        inside = self.inside
        return () if inside is None else tuple(self.having(x) for x in inside.tried if x != inside.value)

    @property
    def late(self) -> bool:
        """Whether it makes the reading of the sensor under test late."""
        return self.place == "sensor" and self.unit == "s"

    @property
    def unusual(self) -> bool:
        """Whether the constant inside it has another value than the usual one."""
        return self.inside is not None and self.inside.value != self.inside.tried[0]


def gain(channel: str) -> Change:
    """Return the correction of a channel that reads a multiple of the truth."""
    return lambda s, factor: s.corrected(channel, s[channel] / factor, s.rate[channel] / factor)


def offset(channel: str) -> Change:
    """Return the correction of a channel that reads too much by a constant."""
    return lambda s, shift: s.corrected(channel, s[channel] - shift)


def lacking(in_order: Mapping[str, float], name: str) -> Change:
    """Return the change that adds an area (zero in order) or multiplies a flow or power (one), given all of `lacks` in order."""
    i, null = list(in_order).index(name), in_order[name]

    def change(s: Signals, x: Any) -> Signals:
        lacks = s.lacks.copy()
        lacks[i] = lacks[i] + x if null == 0.0 else lacks[i] * x
        return replace(s, lacks=lacks)

    return change


def reading(over_truth: Callable[[Signals, Any], Any]) -> Change:
    """Return the correction of the sensor under test where its reading over the truth is known."""
    return lambda s, x: s.corrected(SENSOR, s[SENSOR] / over_truth(s, x))


def past_the_filter(s: Signals, area: float, gas_constant: float) -> Array:
    """Return the flow through a hole behind the filter over that through the sensor; the depression grows with its square."""
    return np.asarray(area * np.sqrt(2.0 * s["p_amb"] / (gas_constant * s["T_amb"]) * FILTER))


def lag(s: Signals, tau: Any) -> Signals:
    """Return the flow before a first-order response: tau dW_m/dt = W - W_m solved for W."""
    return s.corrected(SENSOR, s[SENSOR] + tau * s.rate[SENSOR])


def delay(s: Signals, dead_time: float) -> Signals:
    """Return the flow before a dead time: the later reading, with the other effects on the reading applied to it."""
    now = s.later(0.0)
    other = np.where(np.abs(now) > LITTLE, np.clip(s[SENSOR] / np.where(now == 0.0, 1.0, now), 0.5, 2.0), 1.0)
    return s.corrected(SENSOR, s[SENSOR] + other * (s.later(dead_time) - now))


def contamination(crossing: float) -> Change:
    """Return the correction of a film whose King's law has lost a share x of its slope.

    It reads sqrt W_m = (1 - x) sqrt W + x sqrt crossing.
    """

    def change(s: Signals, x: Any) -> Signals:
        above = np.sqrt(np.maximum(s[SENSOR], 0.0)) - x * np.sqrt(crossing)
        # A hot film does not see the direction of the flow: below zero the curve continues as a straight line.
        backward = np.minimum(s[SENSOR] - x * x * crossing, 0.0)
        return s.corrected(SENSOR, np.where(above > 0.0, above**2, backward) / (1.0 - x) ** 2)

    return change


def on_the_reading() -> Mapping[str, Effect]:
    """Return the effects that every engine may have on the reading of the sensor, by name."""
    place, own = "sensor", (SENSOR,)
    gain_of = reading(lambda s, x: np.broadcast_to(x, s.time.shape))
    drift = reading(lambda s, rate: 1.0 + rate * s.time)
    warmed = reading(lambda s, k: 1.0 + k * (s["T_amb"] - AIR_AT_CALIBRATION))
    crossing = Inside("crossing", "kg/s", CROSSINGS[0], CROSSINGS, contamination)
    film = contamination(CROSSINGS[0])
    found = (
        Effect("maf.delay", "delay", "s", 0.0, 0.03, -0.1, 1.0, place, delay, TRANSIENTS, needs=own),
        Effect("maf.lag", "tau", "s", 0.0, 0.03, -0.02, 1.0, place, lag, TRANSIENTS, needs=own),
        Effect("maf.offset", "offset", "kg/s", 0.0, 1e-3, -0.02, 0.02, place, offset(SENSOR), STEADY, True, needs=own),
        Effect("maf.gain", "factor", "1", 1.0, 0.05, 0.4, 2.0, place, gain_of, STEADY, True, needs=own),
        Effect("maf.drift", "rate", "1/s", 0.0, 1e-4, -1e-3, 1e-3, place, drift, STEADY, needs=own),
        Effect("maf.temperature", "coefficient", "1/K", 0.0, 1e-3, -0.02, 0.02, place, warmed, ALTITUDE, needs=(SENSOR, "T_amb")),
        Effect(
            "maf.contamination", "coefficient", "1", 0.0, 0.05, -0.02, 0.5, place, film, STEADY, needs=own, inside=crossing,
            stays=True,
        ),
    )  # fmt: skip
    return {effect.id: effect for effect in found}


def fuel_gain(name: str, channel: str) -> Effect:
    """Return the gain of the channel that is the map's own fuel axis."""
    return Effect(name, "factor", "1", 1.0, 0.05, 0.6, 1.5, "fuel", gain(channel), STEADY, True, True, needs=(channel,))
