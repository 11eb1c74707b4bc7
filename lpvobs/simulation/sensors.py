"""What the sensors make of the truth: white noise, then rounding to the smallest step."""

import zlib
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from lpvobs.records import Array
from lpvobs.simulation.parameters import Sensors


def measure(truth: Mapping[str, Array], sensors: Sensors, seed: int) -> dict[str, Array]:
    """Return the readings of noise-free channels, each of shape (N,).

    Every channel draws from a stream of its own, so that one channel more changes no other.
    """
    return {name: _reading(name, values, sensors, seed) for name, values in truth.items()}


class Quality(NamedTuple):
    """Standard deviation of a sensor's white noise, shape () or (N,), and the step to which it rounds, in the channel's unit."""

    spread: float | Array
    step: float


def _reading(name: str, values: Array, sensors: Sensors, seed: int) -> Array:
    spread: float | Array = getattr(sensors, name, 0.0)
    if name == "W_maf":
        spread = np.hypot(sensors.W_maf_absolute, sensors.W_maf_relative * np.abs(values))
    return read_with(name, values, Quality(spread, getattr(sensors.quantisation, name, 0.0)), seed)


def read_with(name: str, values: Array, quality: Quality, seed: int) -> Array:
    """Return the readings of a sensor, shape (N,)."""
    stream = np.random.Generator(np.random.PCG64([seed, zlib.crc32(name.encode())]))
    noisy = values + quality.spread * stream.standard_normal(values.size)
    return np.asarray(np.round(noisy / quality.step) * quality.step if quality.step > 0 else noisy)
