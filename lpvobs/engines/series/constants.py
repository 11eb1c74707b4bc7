"""What is known of an engine that logs what series vehicles do; the attributes bear the names of the `[engine.*]` tables."""

from dataclasses import dataclass, fields
from typing import Annotated, Any

from lpvobs.engines.components.intake import Cylinders, Egr, Filling
from lpvobs.engines.constants import Within, flat, flat_type, names_of


@dataclass(frozen=True)
class Gases:
    """Gas constants."""

    R_a: Annotated[float, Within(280, 300, "J/(kg K)", "gas constant of air")]
    gamma_a: Annotated[float, Within(1.3, 1.42, "1", "ratio of heat capacities of air")]
    R_e: Annotated[float, Within(270, 310, "J/(kg K)", "gas constant of exhaust")]


@dataclass(frozen=True)
class Exhaust:
    """Estimates for exhaust sensors that are not fitted: p_em = p_im + dp_0 + dp_n n_e; without T_em, T_im + T_rise W_f / W_ei."""

    dp_0: Annotated[float, Within(-2e4, 1e5, "Pa", "pressure difference across the EGR")]
    dp_n: Annotated[float, Within(0, 100, "Pa/rpm", "slope of the pressure difference across the EGR over n_e")]
    T_rise: Annotated[float, Within(2e3, 3e4, "K", "heating of the gas, per fuel over gas")]


@dataclass(frozen=True)
class Fuel:
    """Stoichiometric mass ratio of air to fuel, and ratio of burnt fuel to the logged quantity."""

    air_fuel: Annotated[float, Within(8, 18, "1", "stoichiometric air over fuel")]
    k_fuel: Annotated[float, Within(0.3, 3, "1", "fuel over the logged quantity")]


@dataclass(frozen=True)
class SeriesEngine:
    """All that is known of the engine; `file` names what `calibrate` has found, beside the configuration."""

    gas: Gases
    geometry: Cylinders
    filling: Filling
    egr: Egr
    exhaust: Exhaust
    fuel: Fuel
    file: str = ""


class SeriesConstants(flat_type(names_of(Gases, Cylinders, Filling, Egr, Exhaust, Fuel))):  # type: ignore[misc]
    """The same constants, flat, for the relations that engines share."""


def constants_of(engine: SeriesEngine) -> Any:
    """Return the engine's constants as one flat tuple of floats."""
    return flat(SeriesConstants, *(getattr(engine, item.name) for item in fields(engine) if item.name != "file"))
