"""What an owner knows of a sensor: the configuration's `[sensors.NAME]`, of a channel by its name."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields

from lpvobs.records import Array

SLOWEST = 60.0  # [s] A sensor that takes longer shows nothing of a drive cycle
Pulsation = Callable[[Mapping[str, Array], float], Array]
"""Returns reading over truth of a sensor in a flow that pulsates, shape (N,), from channels and a coefficient."""


@dataclass(frozen=True)
class Sensor:
    """How a sensor in order, and what records it, change what they show; zero leaves it as it is."""

    tau: float = 0.0  # [s] of its first-order response
    delay: float = 0.0  # [s] dead time, of the bus for example
    filter: float = 0.0  # [s] over which the control unit takes a running mean
    raster: float = 0.0  # [s] between two readings; each is held until the next
    quantisation: float = 0.0  # smallest step of a reading, in the channel's unit
    pulsation: float = 0.0  # what an air flow sensor reads too much by where the flow pulsates, as in `maf.backflow`

    def __post_init__(self) -> None:
        for item in fields(self):
            most = 1.0 if item.name == "pulsation" else float("inf") if item.name == "quantisation" else SLOWEST
            if not 0.0 <= getattr(self, item.name) <= most:
                raise ValueError(f"{item.name} must lie between 0 and {most:g}")

    @property
    def late(self) -> float:
        """How late a sample is behind the sensor [s]; on average by half of what it is the mean of, or held for."""
        return self.delay + 0.5 * (self.filter + self.raster)
