"""From the plant's course to the truth at the samples, and to what noise-free sensors show of it: effects on their readings.

The control of the simulated engine keeps its own true signals; only what is logged changes.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import floor, sqrt

import numpy as np
import scipy

from lpvobs.engines.channels import Sensor
from lpvobs.records import Array
from lpvobs.simulation.disturbances import ChannelEffect, UnloggedEffect
from lpvobs.simulation.effects import CatalogueEffect, blended
from lpvobs.simulation.instruments import lagged, rectified
from lpvobs.simulation.integrate import RECORDED, TRAIL, Samples, at_samples
from lpvobs.simulation.parameters import ErrorSurface, Structure
from lpvobs.simulation.road import CHARGE_LAG
from lpvobs.simulation.scene import DriveCourse

CROSSING = 0.02  # kg/s, where a contaminated hot film still reads right
WARM = 298.0  # K, where the hot film was calibrated
FILTER_RESISTANCE = 2.08e5  # Pa/(kg/s)^2, air filter
WITH_MEMORY = ("maf.lag", "maf.delay", "T_im.lag")  # effects that need to know what has been between two samples


Formula = Callable[[float, Array, Array, Mapping[str, Array]], Array]
"""Returns changed values, shape (N,), from an effect's value, the values, their times [s] of the log, and the true channels."""


def _contaminated(x: float, W: Array, time: Array, point: Mapping[str, Array]) -> Array:
    """King's law with both constants shifted; below no flow, which a hot film cannot tell, the curve goes on straight."""
    forward = ((1.0 - x) * np.sqrt(np.maximum(W, 0.0)) + x * sqrt(CROSSING)) ** 2
    return np.asarray(forward + (1.0 - x) ** 2 * np.minimum(W, 0.0))


def _backflow(x: float, W: Array, time: Array, point: Mapping[str, Array]) -> Array:
    slow = np.maximum(0.0, (2000.0 - point["n_e"]) / 1000.0)
    return np.asarray(W * (1.0 + x * slow * point["u_delta"] / 40.0))


MAF: Mapping[str, Formula] = {
    "maf.contamination": _contaminated,
    "maf.backflow": _backflow,
    "maf.temperature": lambda k, W, time, point: W * (1.0 + k * (point["T_amb"] - WARM)),
    "maf.drift": lambda rate, W, time, point: W * (1.0 + rate * time),
    "maf.gain": lambda factor, W, time, point: W * factor,
    "maf.offset": lambda offset, W, time, point: W + offset,
}
"""What the air flow sensor reads after every effect that has no memory, in the order of the sensor's physics."""


def after(
    effects: Iterable[CatalogueEffect],
    formulas: Mapping[str, Formula],
    values: Array,
    time: Array,
    point: Mapping[str, Array],
) -> Array:
    """Return values, shape (N,), after those of the effects, one behind the other, that have a formula here."""
    for effect in effects:
        if effect.id in formulas:
            values = blended(values, formulas[effect.id](effect.value, values, time, point), effect.share(time))
    return values


def with_memory(W: Array, step: float, effects: Sequence[CatalogueEffect]) -> Array:
    """Return a reading, shape (M,) every `step` seconds from zero, behind its lags and then behind its delays."""
    # A sensor that becomes slow starts from what it showed; one that is mended is right at once.
    time = np.linspace(0.0, (W.size - 1) * step, W.size)
    for effect in effects:
        if effect.id.endswith(".lag"):
            inside = np.flatnonzero(effect.at(time))
            W = W.copy()
            for run in np.split(inside, np.flatnonzero(np.diff(inside) > 1) + 1):
                W[run] = lagged(W[run], step, effect.value)
    for effect in effects:
        if effect.id.endswith(".delay"):
            W = np.where(effect.at(time), delayed(W, step, effect.value), W)
    return W


def delayed(W: Array, step: float, delay: float) -> Array:
    """Return W(t - delay), shape (M,), straight between samples; before the first one its value is held."""
    whole = floor(delay / step + 1e-9)
    share = max(delay / step - whole, 0.0)
    late = np.concatenate([np.full(whole + 1, W[0]), W])
    return np.asarray((1.0 - share) * late[1 : W.size + 1] + share * late[: W.size])


def surface_error(surface: ErrorSurface, u_delta: Array, n_e: Array, W_c: Array) -> Array:
    """Return reading minus truth without noise, shape (N,) [kg/s], at true fuel [mg/cycle], speed [rpm] and flow [kg/s]."""
    u, n, error = u_delta, n_e, np.zeros_like(W_c)
    if surface.kind == "quadratic":
        a2, a1, b2, b1, c2, c1 = surface.coefficients
        error = (a2 * u + a1) * u + (b2 * n + b1) * n + c2 * u * n + c1  # Eq. (37)
        for bump in surface.bumps:
            distance = ((u - bump.u_delta) / bump.width_u_delta) ** 2 + ((n - bump.n_e) / bump.width_n_e) ** 2
            error = error + bump.amplitude * np.exp(-0.5 * distance)
    elif surface.kind == "king":
        aged = surface.offset + surface.slope * np.maximum(W_c, 0.0) ** surface.exponent
        error = aged ** (1.0 / surface.exponent) - W_c
    elif surface.kind == "table":
        axes = (np.array(surface.n_e, dtype=float), np.array(surface.u_delta, dtype=float))
        held = [np.clip(values, axis[0], axis[-1]) for values, axis in zip((n, u), axes, strict=True)]
        table = scipy.interpolate.RegularGridInterpolator(axes, np.array(surface.values, dtype=float))
        error = table(np.column_stack(held))
    return np.asarray(error)


@dataclass(frozen=True)
class Instruments:
    """The sensors of a drive and what is wrong with them."""

    surface: ErrorSurface  # of the air flow sensor's error
    R_a: float  # [J/(kg K)]
    step: float  # [s] of the integrator
    effects: tuple[CatalogueEffect, ...]
    disturbances: tuple[ChannelEffect | UnloggedEffect, ...]
    structure: Structure

    def maf(self, point: Mapping[str, Array], time: Array) -> Array:
        """Return what the air flow sensor shows [kg/s], shape (N,), before its lag, delay and noise.

        `point` has the true `n_e` [rpm], `u_delta` [mg/cycle], `W_c` [kg/s], `p_amb` [Pa], `T_amb` [K] and the channels behind
        disturbances. These are settled and act on what the effects leave.
        """
        W = after(self.effects, {"leak.inlet": self._drawn_in_behind}, point["W_c"], time, point)
        misread = W * rectified(self.structure.maf_element, point["n_e"], point["u_delta"])
        W = W + surface_error(self.surface, point["u_delta"], point["n_e"], W) + misread  # Eq. (7)
        own = [effect for identifier in MAF for effect in self.effects if effect.id == identifier]
        W = after(own, MAF, W, time, point)
        for disturbance in self.disturbances:
            W = disturbance.on(W, time, point)
        return W

    def _drawn_in_behind(self, area: float, W_c: Array, time: Array, point: Mapping[str, Array]) -> Array:
        """Return the flow that passes the sensor, less than W_c where the inlet draws air in behind it."""
        # The filter's depression dp = 2.08e5 W^2, with W the flow through filter and sensor, drives air of ambient density
        # through the leak, A sqrt(2 rho dp). Both are proportional to W, so the leak takes a fixed share of it. The
        # compressor's own inlet stays at ambient pressure.
        density = point["p_amb"] / (self.R_a * point["T_amb"])
        return W_c / (1.0 + area * np.sqrt(2.0 * density * FILTER_RESISTANCE))


def sense(
    instruments: Instruments, scene: DriveCourse, samples: Samples, recorded: Array, trail: Array
) -> tuple[dict[str, Array], dict[str, Array]]:
    """Return the truth at the samples and what noise-free sensors show of it, by channel, each of shape (N,)."""
    # `recorded` and `trail` are what `integrate.drive` returns.
    time = samples.step * instruments.step + samples.after
    truth = dict(zip(RECORDED, recorded.T, strict=True)) | scene.at(time)
    truth["delta_W_c"] = surface_error(instruments.surface, truth["u_delta"], truth["n_e"], truth["W_c"])
    truth["delta_W_c"] += truth["W_c"] * rectified(instruments.structure.maf_element, truth["n_e"], truth["u_delta"])
    if scene.channels:
        charge = truth["T_amb"] + truth["warming"]
        truth["T_charge"] = lagged(charge, float(time[1] - time[0]) if time.size > 1 else 1.0, CHARGE_LAG)
    settled = tuple(item.settled(truth, scene.duration) for item in instruments.disturbances)
    instruments = replace(instruments, disturbances=settled)
    shown = {}
    for name, values in truth.items():
        formulas = {f"{name}.gain": MAF["maf.gain"], f"{name}.offset": MAF["maf.offset"]}
        shown[name] = after(instruments.effects, formulas, values, time, truth)
    shown["W_maf"] = instruments.maf(truth, time)
    if trail.shape[0] > 0:
        drivers = {found.channel for found in settled if isinstance(found, ChannelEffect)}
        fine = np.linspace(0.0, (trail.shape[0] - 1) * instruments.step, trail.shape[0])
        point = dict(zip(TRAIL, trail.T, strict=True)) | scene.at(fine, ("p_amb", "T_amb"))
        point |= {name: np.interp(fine, time, truth[name]) for name in drivers}
        for channel, prefix in (("W_maf", "maf."), ("T_im", "T_im.")):
            slow = [found for found in instruments.effects if found.id in WITH_MEMORY and found.id.startswith(prefix)]
            if slow:
                values = instruments.maf(point, fine) if channel == "W_maf" else point[channel]
                remembered = at_samples(with_memory(values, instruments.step, slow), samples, instruments.step)
                # before the memory's onset and after its end it shows what it would without one, to the last bit
                at_work = np.any([found.at(time) for found in slow], axis=0)
                shown[channel] = np.where(at_work, remembered, shown[channel])
    return truth, shown


def behind(sensors: Mapping[str, Sensor], shown: Mapping[str, Array], step: float) -> dict[str, Array]:
    """Return what stated sensors show of signals, shape (M,) every `step` seconds: behind lag, running mean and dead time."""
    late = {}
    for name, sensor in sensors.items():
        if name in shown:
            slow = lagged(shown[name], step, sensor.tau) if sensor.tau else shown[name]
            width = round(sensor.filter / step)
            if width > 1:
                mean = np.concatenate(([0.5], np.ones(width - 1), [0.5])) / width
                slow = np.convolve(mean, slow - slow[0])[: slow.size] + slow[0]
            late[name] = delayed(slow, step, sensor.delay) if sensor.delay else slow
    return late
