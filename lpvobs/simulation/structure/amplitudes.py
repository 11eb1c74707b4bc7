"""How much of each form the plant has: the record of `[simulation.structure]`, and what of it the compiled relations read."""

from dataclasses import dataclass, fields

from lpvobs.engines.flat import flat, flat_type, names_of

MOST = 2.0
"""Twice what real diesels show; with more, the control of the plant no longer reaches its set-points."""


@dataclass(frozen=True)
class Structure:
    """Amplitude of each form: 0 leaves it out, 1 is the size that is typical of real diesels."""

    wave: float = 0.0
    residual_gas: float = 0.0
    charge_heating: float = 0.0
    egr: float = 0.0
    compressor: float = 0.0
    turbine: float = 0.0
    pipes: float = 0.0
    thermocouple: float = 0.0
    maf_element: float = 0.0
    rasters: float = 0.0

    def __post_init__(self) -> None:
        for item in fields(self):
            if not 0.0 <= getattr(self, item.name) <= MOST:
                raise ValueError(f"{item.name} must lie between 0 and {MOST:g}; 1 is what real diesels show")

    @property
    def inside(self) -> "Amplitudes":
        """The forms inside the engine."""
        return flat(Amplitudes, self)

    @property
    def slow_sensors(self) -> bool:
        """Whether a sensor or the recorder needs to know what has been between two samples."""
        return self.thermocouple > 0.0 or self.maf_element > 0.0 or self.rasters > 0.0


class Amplitudes(flat_type(names_of(Structure, without=("maf_element", "rasters")))):  # type: ignore[misc]
    """The forms inside the engine; zero is the engine of the model."""
