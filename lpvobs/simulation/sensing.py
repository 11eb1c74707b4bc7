"""From the plant's course to the truth at the samples and to what noise-free sensors show of it."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import scipy

from lpvobs.engines.sensors import Sensor
from lpvobs.records import Array
from lpvobs.simulation.courses import lagged
from lpvobs.simulation.disturbances import ChannelEffect, UnloggedEffect
from lpvobs.simulation.effects import CatalogueEffect
from lpvobs.simulation.integrate import RECORDED, TRAIL, Samples, at_samples
from lpvobs.simulation.parameters import ErrorSurface
from lpvobs.simulation.readings import WITH_MEMORY, delayed, maf_reading, reading, surface_error, with_memory
from lpvobs.simulation.road import CHARGE_LAG
from lpvobs.simulation.scene import DriveCourse
from lpvobs.simulation.structure.amplitudes import Structure
from lpvobs.simulation.structure.pulses import rectified


@dataclass(frozen=True)
class Instruments:
    """The sensors of a drive and what is wrong with them."""

    surface: ErrorSurface  # of the air flow sensor's error
    R_a: float  # [J/(kg K)]
    step: float  # [s] of the integrator
    effects: tuple[CatalogueEffect, ...]
    disturbances: tuple[ChannelEffect | UnloggedEffect, ...]
    structure: Structure

    def settled(self, truth: Mapping[str, Array], duration: float) -> "Instruments":
        """Return the same with everything filled in that the drive decides of the disturbances."""
        return replace(self, disturbances=tuple(item.settled(truth, duration) for item in self.disturbances))

    def maf(self, point: Mapping[str, Array], time: Array) -> Array:
        """Return what the air flow sensor shows at a point [kg/s], before its lag, delay and noise, shape (N,)."""
        element = self.structure.maf_element
        return maf_reading(point, time, self.surface, self.R_a, self.effects, self.disturbances, element)


def sense(
    instruments: Instruments, scene: DriveCourse, samples: Samples, recorded: Array, trail: Array
) -> tuple[dict[str, Array], dict[str, Array]]:
    """Return the truth at the samples and what noise-free sensors show of it, by channel, each of shape (N,).

    `recorded` and `trail` are what `integrate.drive` returns.
    """
    time = samples.step * instruments.step + samples.after
    truth = dict(zip(RECORDED, recorded.T, strict=True)) | scene.at(time)
    truth["delta_W_c"] = surface_error(instruments.surface, truth["u_delta"], truth["n_e"], truth["W_c"])
    if (pulsing := instruments.structure.maf_element) > 0.0:
        truth["delta_W_c"] += truth["W_c"] * rectified(pulsing, truth["n_e"], truth["u_delta"])
    if scene.channels:
        charge = truth["T_amb"] + truth["warming"]
        truth["T_charge"] = lagged(charge, float(time[1] - time[0]) if time.size > 1 else 1.0, CHARGE_LAG)
    instruments = instruments.settled(truth, scene.duration)
    truth["W_maf"] = instruments.maf(truth, time)
    shown = {
        name: reading(name, values, time, instruments.effects) for name, values in truth.items() if name != "W_maf"
    }
    shown["W_maf"] = truth["W_maf"]
    if trail.shape[0] > 0:
        shown |= _with_trail(instruments, scene, samples, trail, (time, truth, shown))
    return truth | {"W_maf": shown["W_maf"]}, shown


def _with_trail(
    instruments: Instruments,
    scene: DriveCourse,
    samples: Samples,
    trail: Array,
    sampled: tuple[Array, Mapping[str, Array], Mapping[str, Array]],
) -> dict[str, Array]:
    """Return what sensors with a memory show at the samples, from the trail at every step of the integrator.

    Before the memory's onset and after its end they show what they would without one, to the last bit.
    """
    step, (times, truth, direct) = instruments.step, sampled
    time = np.linspace(0.0, (trail.shape[0] - 1) * step, trail.shape[0])
    drivers = {found.channel for found in instruments.disturbances if isinstance(found, ChannelEffect)}
    point = {
        **dict(zip(TRAIL, trail.T, strict=True)),
        **{name: np.interp(time, times, truth[name]) for name in drivers},
        **scene.at(time, ("p_amb", "T_amb")),
    }
    late = {}
    for channel, prefix in (("W_maf", "maf."), ("T_im", "T_im.")):
        slow = [found for found in instruments.effects if found.id in WITH_MEMORY and found.id.startswith(prefix)]
        if slow:
            values = instruments.maf(point, time) if channel == "W_maf" else point[channel]
            remembered = at_samples(with_memory(values, step, slow), samples, step)
            at_work = np.any([found.at(times) for found in slow], axis=0)
            late[channel] = np.where(at_work, remembered, direct[channel])
    return late


def behind(sensors: Mapping[str, Sensor], shown: Mapping[str, Array], step: float) -> dict[str, Array]:
    """Return what stated sensors show of signals, shape (M,) every `step` seconds: behind lag, running mean and dead time."""
    return {name: _behind(sensor, shown[name], step) for name, sensor in sensors.items() if name in shown}


def _behind(sensor: Sensor, values: Array, step: float) -> Array:
    slow = lagged(values, step, sensor.tau) if sensor.tau else values
    width = round(sensor.filter / step)
    if width > 1:
        mean = np.concatenate(([0.5], np.ones(width - 1), [0.5])) / width
        slow = scipy.signal.lfilter(mean, 1.0, slow - slow[0]) + slow[0]
    return delayed(slow, step, sensor.delay) if sensor.delay else np.asarray(slow)
