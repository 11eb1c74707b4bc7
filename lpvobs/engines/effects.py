"""What discovery needs to know of an engine: its balances as one function, and the effects that may be missing in it."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lpvobs.records import Array


@dataclass(frozen=True)
class Scene:
    """All that the balances are computed from, twice: K instants seen by the even samples, then by the odd ones.

    Attributes
    ----------
    time : ndarray, shape (2K,)
        [s] since the start of the log.
    clock : ndarray, shape (2K,)
        [s], the same where there is one log; further logs follow with a pause.
    value, rate : ndarray, shape (m, 2K)
        Channels in the order of `Plant.channels`, and their time derivatives.
    lacks : ndarray, shape (l, 2K)
        Sizes of what the engine's model lacks, in the order of `Plant.lacks`.
    later : callable
        What the sensor under test reads some time [s] later, shape (2K,).
    slow : callable
        Rate of a channel by name, seen through a wide window, shape (2K,).
    channels : tuple of str
    constants : named tuple
        The engine's, where the model stands.
    """

    time: Array
    clock: Array
    value: Array
    rate: Array
    lacks: Array
    later: Callable[[float], Array]
    slow: Callable[[str], Array]
    channels: tuple[str, ...]
    constants: Any

    def __getitem__(self, channel: str) -> Array:
        """Return the values of one channel, shape (2K,)."""
        return np.asarray(self.value[self.channels.index(channel)])

    def rate_of(self, channel: str) -> Array:
        """Return the rates of one channel, shape (2K,)."""
        return np.asarray(self.rate[self.channels.index(channel)])

    def corrected(self, channel: str, value: Array, rate: Array | None = None) -> "Scene":
        """Return the scene with another signal in place of a channel; without a rate, the rate stays."""
        i = self.channels.index(channel)
        values = self.value.copy()
        values[i] = value
        if rate is None:
            return replace(self, value=values)
        rates = self.rate.copy()
        rates[i] = rate
        return replace(self, value=values, rate=rates)

    def between(self, other: "Scene", begin: float, end: float) -> "Scene":
        """Return this scene, and the other one in the interval [begin, end)."""
        if begin <= self.clock[0] and end > self.clock[-1]:
            return other
        on = (self.clock >= begin) & (self.clock < end)
        return replace(
            self,
            value=np.where(on, other.value, self.value),
            rate=np.where(on, other.rate, self.rate),
            lacks=np.where(on, other.lacks, self.lacks),
        )


@dataclass(frozen=True)
class Effect:
    """One thing that a model may lack, with one parameter.

    Attributes
    ----------
    id, parameter, unit : str
        As in the contract.
    null : float
        The parameter's value when the effect is absent.
    size : float
        A change of the parameter that a careful engineer would notice; sets the step of difference quotients.
    low, high : float
        Range in which the parameter is sought.
    place : str
        Where it acts; `sensor` for what changes the readings of the sensor under test and nothing else.
    apply : callable
        The scene as it would have been recorded without the effect, or with it in the balances.
    drive : str
        The kind of drive that separates it from its likes.
    in_map : bool
        Whether a map made from the same log contains it when it is there from the first to the last sample.
    moves_point : bool
        Whether it changes the operating point at which the map is read.
    """

    id: str
    parameter: str
    unit: str
    null: float
    size: float
    low: float
    high: float
    place: str
    apply: Callable[[Scene, Any], Scene]
    drive: str
    in_map: bool = False
    moves_point: bool = False


@dataclass(frozen=True)
class Plant:
    """An engine as discovery sees it.

    Attributes
    ----------
    balances : tuple of str
        B balances.
    mapped : ndarray, shape (B,)
        One where the sensor, and with it the map, is part of the balance, zero elsewhere.
    channels : tuple of str
        m channels, the sensor among them.
    hurried : tuple of str
        Those whose fast changes blur the balances.
    sensor, fuel, speed : str
        Channel of the sensor under test, and the map's axes.
    lacks : tuple of float
        l sizes of an engine in order.
    constants : named tuple
        The engine's constants.
    imbalances : callable
        What is left of each balance, shape (B, 2K) [kg/s], from constants, values, rates and lacks.
    catalogue : tuple of Effect
    carriers : tuple of str
        Effects of the catalogue that a logged channel may drive; their `apply` takes a size per sample, too.
    inputs : callable or None
        What a change of the balances [kg/s] adds to the state equation of the observer, shape (n, K), from constants, values and
        the change; None where the state equation stays.
    """

    balances: tuple[str, ...]
    mapped: Array
    channels: tuple[str, ...]
    hurried: tuple[str, ...]
    sensor: str
    fuel: str
    speed: str
    lacks: tuple[float, ...]
    constants: Any
    imbalances: Callable[[Any, Array, Array, Array], Array]
    catalogue: tuple[Effect, ...]
    carriers: tuple[str, ...]
    inputs: Callable[[Any, Array, Array], Array] | None = None
