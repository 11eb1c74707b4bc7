"""Effects in the observer: what it is given of a log so that map and state come out as they would without them.

For the observer an effect does one of three things:

- it corrects channels: readings are corrected before anything is computed from them. That includes the scheduling parameters, so
  the region of the certificate is checked on corrected readings;
- it adds to a balance: what the engine's model lacks is a known function of measured signals. It is a further input of the state
  equation and a further flow in the balances; A, C, gain and certificate do not change;
- it adds a state: behind a slow sensor the flow W drives a state W_m, tau dW_m/dt = W - W_m. The observer corrects it by the
  reading with gain l, and the correction measures the flow: z = (1 + l tau)(y - W_m) follows W less the flow of the balance with a
  lag of 1/(1/tau + l). The map's inputs go through the same lag. Gain and proof of the larger observer come from
  `lpvobs.synthesis.sensor_state`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from lpvobs.compiled import njit
from lpvobs.discovery.known_effects import KnownEffect, effect_along
from lpvobs.discovery.places import lacks_of
from lpvobs.discovery.thresholds import WIDE
from lpvobs.engines.base import AirPath
from lpvobs.engines.effects import SENSOR, Signals
from lpvobs.engines.followers import with_followers
from lpvobs.engines.residual_model import ResidualModel
from lpvobs.maps.excitation import steps_of
from lpvobs.maps.grid import Grid
from lpvobs.observer.estimate import calmed
from lpvobs.observer.parts import Observed, operating_point, slope_signals
from lpvobs.observer.recursion import observe
from lpvobs.observer.smoothing import CALM, CALM_LEAST, roughness, smooth
from lpvobs.records import Array, Log

LAGS = ("maf.lag",)  # effects that add a state
BLUR = 0.378  # standard deviation of the window of `smooth` over its half width: the sensor's state may blur as much


@dataclass(frozen=True)
class Refined:
    """The model as the observer has it."""

    model: ResidualModel  # with the constants of the refined engine
    air_path: AirPath  # of the same engine
    outputs: tuple[str, ...]  # measured states that correct the state
    L: Array  # (n, r) the last column zero
    smoothing: float  # [s], as in the configuration
    effects: tuple[KnownEffect, ...]

    @property
    def lags(self) -> tuple[KnownEffect, ...]:
        """The effects that add a state."""
        return tuple(effect for effect in self.effects if effect.id in LAGS)

    def correction(self) -> float:
        """Return l [1/s]: as large as makes the state no slower than the window that the other signals go through."""
        slowest = max(effect.value for effect in self.lags)
        return float(max(0.0, 1.0 / (BLUR * self.smoothing) - 1.0 / slowest))


def observed(refined: Refined, log: Log) -> Observed:
    """Return what a log says of the map beside the effects: the reading less the flow of every balance, and where it is read."""
    air_path = refined.air_path
    right = corrected(refined, with_followers(air_path.followers, log))
    calm, rates = calmed(air_path, right, refined.smoothing)
    trajectory = air_path.trajectory(calm, refined.outputs)
    inputs, _ = added(refined, calm, rates)
    trajectory = replace(trajectory, E=trajectory.E + inputs)
    first = np.stack([air_path.states(calm)[start] for start, _ in log.segments])
    nowhere = Grid(np.array([0.0, 1.0]), np.array([0.0, 1.0]))  # the map is not moved, so any grid will do
    point = operating_point(air_path, right)
    run = observe(trajectory, log.time, log.segments, point, nowhere, refined.L, 0.0, first, np.zeros(nowhere.size))
    seen = replace(calm, channels={**calm.channels, **dict(zip(air_path.state_names, run.x.T, strict=True))})
    calmer = {}  # the channels that steep relations read, through their window
    if air_path.calmed:
        columns = np.stack([right[name] for name in air_path.calmed])
        calm_values = smooth(log.time, columns, log.segments, CALM * refined.smoothing, CALM_LEAST)[0]
        calmer = dict(zip(air_path.calmed, calm_values, strict=True))
    _, further = added(refined, seen, rates)
    z = right[air_path.sensor] - (air_path.balances(seen, rates, (), calmer).flow + further)
    rough = {name: roughness(right[name], log.segments) for name in air_path.noisy}
    steps = steps_of(log.time, log.segments)
    signals = slope_signals(air_path, seen.channels, rates, rough, steps)
    found = Observed(log.time, steps, trajectory.parameters, point, z, signals)
    return _behind_sensor(refined, right, found) if refined.lags else found


def corrected(refined: Refined, log: Log) -> Log:
    """Return a log with its readings put right, one effect after the other, those that add a state left out."""
    effects = [effect for effect in refined.effects if effect.id not in LAGS]
    if not effects:
        return log
    there = [name for name in refined.model.channels if name in log.channels]
    rates = smooth(log.time, np.stack([log[name] for name in there]), log.segments, refined.smoothing)[1]
    signals = _put(_signals(refined.model, log, dict(zip(there, rates, strict=True))), refined, effects, log)
    return replace(log, channels={**log.channels, **signals.value})


def added(refined: Refined, log: Log, rates: Mapping[str, Array]) -> tuple[Array, Array]:
    """Return what the effects add to the state equation, shape (N, n), and to the flow of every balance, shape (b, N) [kg/s]."""
    # `log` holds smoothed channels, `rates` their time derivatives.
    given = _signals(refined.model, log, rates)
    # Channels are corrected already: only what the engine lacks is added here, computed from the channels as they are given.
    lacking = replace(given, lacks=_put(given, refined, refined.effects, log).lacks)
    flows, inputs = refined.model.further(refined.model.constants, lacking)
    return inputs.T, flows


def _signals(model: ResidualModel, log: Log, rates: Mapping[str, Array]) -> Signals:
    """Return a log as discovery sees one, every sample once."""

    def slow(channel: str) -> Array:
        return np.asarray(smooth(log.time, log[channel][None], log.segments, WIDE)[1][0])

    def later(shift: float) -> Array:
        return np.asarray(np.interp(log.time + shift, log.time, log[SENSOR]))

    value = {name: log[name] for name in model.signals if name in log.channels}
    rate = {name: rates.get(name, np.zeros(len(log))) for name in value}
    since = log.time - log.time[0]
    return Signals(since, since, value, rate, lacks_of(model, len(log)), later, slow, model.constants)


def _put(signals: Signals, refined: Refined, effects: Sequence[KnownEffect], log: Log) -> Signals:
    """Return the signals with effects accounted for where they act, in the order of the catalogue; channels come last."""
    order = {effect.id: i for i, effect in enumerate(refined.model.catalogue)}
    for known_effect in sorted(effects, key=lambda effect: order.get(effect.id, len(order))):
        effect, on = effect_along(known_effect, refined.model, [(log, log.time)])
        signals = signals.where(on, effect.apply(signals, known_effect.value))
    return signals


def _behind_sensor(refined: Refined, log: Log, seen: Observed) -> Observed:
    """Return the correction of the sensor's state in place of reading less flow, with the map's inputs delayed by the same lag."""
    tau = np.zeros(len(log))
    for effect in refined.lags:
        tau += effect.value * effect.span_on(log).covers(log.time)
    correction = refined.correction()
    reading = log[refined.air_path.sensor]
    flows = reading - seen.z
    z, fuel, speed = np.empty_like(flows), *(np.empty_like(x) for x in seen.point)
    for part in (slice(*segment) for segment in log.segments):
        for row, flow in zip(z, flows, strict=True):
            row[part] = _innovations(log.time[part], reading[part], flow[part], tau[part], correction)
        for late, signal in zip((fuel, speed), seen.point, strict=True):
            late[part] = _lagged(log.time[part], signal[part], tau[part], correction)
    return replace(seen, z=z, point=(fuel, speed))


@njit(cache=True)
def _innovations(time: Array, reading: Array, flow: Array, tau: Array, correction: float) -> Array:
    """Return (1 + l tau)(y - W_m) with dW_m/dt = (flow - W_m) / tau + l (y - W_m), exact for inputs straight between samples."""
    # Where tau is zero the sensor is quick, and this is the reading less the flow.
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
