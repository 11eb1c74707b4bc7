"""Effects in the observer: what it is given of a log so that map and state come out as they would without them.

An effect does one of three things, and that is all the observer needs to know of it:

- it corrects channels: readings are put right before anything is computed from them, scheduling parameters included, so the region
  of the certificate is checked on what is right;
- it adds to a balance: what the engine's model lacks is a known function of measured signals, a further known input of the state
  equation and a further flow in the balances; A, C, gain and certificate stay;
- it adds a state: behind a slow sensor the flow W drives a state W_m, tau dW_m/dt = W - W_m. The observer corrects it by the
  reading with gain l, and what it has to be corrected by tells of the flow: z = (1 + l tau)(y - W_m) follows W less the flow of the
  balance through a lag of 1/(1/tau + l). The map's inputs go through the same lag. Gain and proof of the larger observer come from
  `lpvobs.synthesis.sensor_state`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np
from numba import njit

from lpvobs.discovery.residual import WIDE
from lpvobs.discovery.standing import Standing, effect_along
from lpvobs.engines.base import AirPath, Balances
from lpvobs.engines.effects import Plant, Scene
from lpvobs.maps.grid import Grid
from lpvobs.observer.estimate import calmed
from lpvobs.observer.recursion import observe
from lpvobs.observer.smoothing import smooth
from lpvobs.records import Array, Log

LAGS = ("maf.lag",)
"""Effects that add a state."""
BLUR = 0.378
"""Standard deviation of the window of `smooth` over its half width: what the sensor's state may blur as well."""
FLOW = "flow:"
"""Begins the names of the channels that hold the flows of the balances."""


@dataclass(frozen=True)
class Refined:
    """The model as the observer has it.

    Attributes
    ----------
    plant : Plant
        With the constants of the refined engine.
    air_path : AirPath
        Of the same engine.
    outputs : tuple of str
        Measured states that correct the state.
    L : ndarray, shape (n, r)
        The last column zero.
    smoothing : float
        [s], as in the configuration.
    effects : tuple of Standing
    """

    plant: Plant
    air_path: AirPath
    outputs: tuple[str, ...]
    L: Array
    smoothing: float
    effects: tuple[Standing, ...]

    @property
    def lags(self) -> tuple[Standing, ...]:
        """The effects that add a state."""
        return tuple(effect for effect in self.effects if effect.id in LAGS)

    def correction(self) -> float:
        """Return l [1/s]: as large as makes the state no slower than the window that the other signals go through."""
        slowest = max(effect.value for effect in self.lags)
        return float(max(0.0, 1.0 / (BLUR * self.smoothing) - 1.0 / slowest))


def observed_path(refined: Refined) -> AirPath:
    """Return the air path whose balances read the flows that `observed` found."""
    return cast(AirPath, _ObservedPath(refined.air_path))


class _ObservedPath:
    """An air path that is asked for its flows along a log and finds them there; all else is the engine's."""

    def __init__(self, base: AirPath):
        self._base = base

    def __getattr__(self, name: str) -> Any:
        return getattr(self._base, name)

    def balances(self, log: Log, rates: Mapping[str, Array], uncertain: Sequence[str]) -> Balances:
        """Return the flows with the effects in them, and the slopes of the engine."""
        plain = self._base.balances(log, rates, uncertain)
        return replace(plain, flow=np.stack([log[FLOW + name] for name in plain.names]))


def observed(refined: Refined, log: Log) -> Log:
    """Return a log with its channels put right, and with the flow of every balance as a further channel."""
    right = corrected(refined, log)
    air_path = refined.air_path
    calm, rates = calmed(air_path, right, refined.smoothing)
    trajectory = air_path.trajectory(calm, refined.outputs)
    inputs, _ = added(refined, calm, rates)
    trajectory = replace(trajectory, E=trajectory.E + inputs)
    fuel, speed = (axis.channel for axis in air_path.axes)
    first = np.stack([[calm[state][start] for state in air_path.state_names] for start, _ in log.segments])
    nowhere = Grid(np.array([0.0, 1.0]), np.array([0.0, 1.0]))  # the map is not moved, so any grid will do
    point = right[fuel], right[speed]
    run = observe(trajectory, log.time, log.segments, point, nowhere, refined.L, 0.0, first, np.zeros(nowhere.size))
    seen = replace(calm, channels={**calm.channels, **dict(zip(air_path.state_names, run.x.T, strict=True))})
    balances = air_path.balances(seen, rates, ())
    _, further = added(refined, seen, rates)
    return _behind_sensor(refined, right, dict(zip(balances.names, balances.flow + further, strict=True)))


def corrected(refined: Refined, log: Log) -> Log:
    """Return a log with its readings put right, one effect after the other, those that add a state left out."""
    effects = [effect for effect in refined.effects if effect.id not in LAGS]
    if not effects:
        return log
    plant = refined.plant
    columns = np.stack([log[name] for name in plant.channels])
    rate = smooth(log.time, columns, log.segments, refined.smoothing)[1]
    scene = _put(_scene(plant, log, columns, rate), refined, effects, log)
    return replace(log, channels={**log.channels, **{name: scene[name] for name in plant.channels}})


def added(refined: Refined, log: Log, rates: Mapping[str, Array]) -> tuple[Array, Array]:
    """Return what the effects add to the state equation, shape (N, n), and to the flow of every balance, shape (B, N) [kg/s].

    `log` holds smoothed channels, `rates` their time derivatives.
    """
    plant = refined.plant
    mapped = plant.mapped > 0.0
    columns = np.stack([log[name] for name in plant.channels])
    rate = np.stack([rates.get(name, np.zeros(len(log))) for name in plant.channels])
    scene = _scene(plant, log, columns, rate)
    lacks = _put(scene, refined, refined.effects, log).lacks
    if np.array_equal(lacks, scene.lacks):
        return np.zeros((len(log), len(refined.air_path.state_names))), np.zeros((int(mapped.sum()), len(log)))
    change = plant.imbalances(plant.constants, columns, rate, lacks)
    change = change - plant.imbalances(plant.constants, columns, rate, scene.lacks)
    inputs = np.zeros((len(refined.air_path.state_names), len(log)))
    if plant.inputs is not None:
        inputs = plant.inputs(plant.constants, columns, change)
    return inputs.T, -change[mapped]


def _scene(plant: Plant, log: Log, columns: Array, rate: Array) -> Scene:
    """Return a log as discovery sees one, once instead of twice: N samples."""

    def later(shift: float) -> Array:
        return np.asarray(np.interp(log.time + shift, log.time, columns[plant.channels.index(plant.sensor)]))

    def slow(channel: str) -> Array:
        row = columns[[plant.channels.index(channel)]]
        return np.asarray(smooth(log.time, row, log.segments, WIDE)[1][0])

    since = log.time - log.time[0]
    lacks = np.tile(np.array(plant.lacks)[:, None], (1, len(log)))
    return Scene(since, since, columns, rate, lacks, later, slow, plant.channels, plant.constants)


def _put(scene: Scene, refined: Refined, effects: Sequence[Standing], log: Log) -> Scene:
    """Return the scene with effects accounted for where they act, in the order of the catalogue; channels come last."""
    order = {effect.id: i for i, effect in enumerate(refined.plant.catalogue)}
    for standing in sorted(effects, key=lambda effect: order.get(effect.id, len(order))):
        scene = effect_along(standing, refined.plant, log).apply(scene, standing.value)
    return scene


def _behind_sensor(refined: Refined, log: Log, flows: Mapping[str, Array]) -> Log:
    """Return the log with flows such that the reading less a flow is what the sensor's state has to be corrected by."""
    lags = refined.lags
    if not lags:
        return replace(log, channels={**log.channels, **{FLOW + name: flow for name, flow in flows.items()}})
    tau = np.zeros(len(log))
    for effect in lags:
        span = effect.span_on(log)
        tau += effect.value * ((log.time >= span.begin) & (log.time < span.end))
    correction = refined.correction()
    fuel, speed = (axis.channel for axis in refined.air_path.axes)
    reading = log[refined.air_path.sensor]
    channels = dict(log.channels)
    for name, flow in flows.items():
        z = np.empty(len(log))
        for part in log.each_segment():
            z[part] = _innovations(log.time[part], reading[part], flow[part], tau[part], correction)
        channels[FLOW + name] = reading - z
    for name in (fuel, speed):
        out = np.empty(len(log))
        for part in log.each_segment():
            out[part] = _lagged(log.time[part], log[name][part], tau[part], correction)
        channels[name] = out
    return replace(log, channels=channels)


@njit(cache=True)
def _innovations(time: Array, reading: Array, flow: Array, tau: Array, correction: float) -> Array:
    """Return (1 + l tau)(y - W_m) with dW_m/dt = (flow - W_m) / tau + l (y - W_m), exact for inputs straight between samples.

    Where tau is zero the sensor is quick, and this is the reading less the flow.
    """
    out = np.empty(time.size)
    state = reading[0]
    for k in range(time.size):
        if tau[k] <= 0.0:
            out[k], state = reading[k] - flow[k], reading[k]
            continue
        a = 1.0 / tau[k] + correction
        if k > 0:
            h = time[k] - time[k - 1]
            before = flow[k - 1] / tau[k] + correction * reading[k - 1]
            now = flow[k] / tau[k] + correction * reading[k]
            slope = (now - before) / h
            state = now / a - slope / a**2 + (state - before / a + slope / a**2) * np.exp(-a * h)
        out[k] = (1.0 + correction * tau[k]) * (reading[k] - state)
    return out


@njit(cache=True)
def _lagged(time: Array, signal: Array, tau: Array, correction: float) -> Array:
    """Return a signal through the lag that the innovations go through; as it is where tau is zero."""
    out = signal.copy()
    for k in range(1, time.size):
        if tau[k] <= 0.0:
            continue
        a, h = 1.0 / tau[k] + correction, time[k] - time[k - 1]
        slope = (signal[k] - signal[k - 1]) / h
        out[k] = signal[k] - slope / a + (out[k - 1] - signal[k - 1] + slope / a) * np.exp(-a * h)
    return out
