"""The constants of a diesel with EGR and VGT, as an engineer states them.

Structure after Wahlstrom and Eriksson, Proc. IMechE D 225 (2011), the paper's reference 16. SI units unless said otherwise.
The attributes bear the names of the configuration's `[engine.*]` tables.
"""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Annotated

from lpvobs.engines.components.intake import Cylinders, Egr, Filling
from lpvobs.engines.constants import Within, flat, flat_type

COMPRESSOR_FORMS: Mapping[str, tuple[str, ...]] = {
    "tip_speed": ("psi_0", "psi_1", "phi_0", "phi_1"),
    "rotor_speed": ("c_psi2", "c_phi2", "c_w_psi1", "c_w_psi2", "c_w_psi3", "c_w_phi1", "c_w_phi2", "c_w_phi3"),
}
"""The forms of the compressor's ellipse by name, and the constants that each has for itself; see `forms`."""
TURBINE_FORMS: Mapping[str, tuple[str, ...]] = {"constant": ("c_m",), "rotor_speed": ("c_m1", "c_m2", "c_m3")}
"""The forms of the turbine's loss of efficiency by name, and the constants that each has for itself; see `forms`."""


@dataclass(frozen=True)
class Gas:
    """Gas properties and the surroundings that the constants refer to."""

    R_a: Annotated[float, Within(280, 300, "J/(kg K)", "gas constant of air")]
    R_e: Annotated[float, Within(270, 310, "J/(kg K)", "gas constant of exhaust")]
    c_pa: Annotated[float, Within(950, 1150, "J/(kg K)", "heat capacity of air")]
    c_pe: Annotated[float, Within(1000, 1500, "J/(kg K)", "heat capacity of exhaust")]
    gamma_a: Annotated[float, Within(1.3, 1.42, "1", "ratio of heat capacities of air")]
    gamma_e: Annotated[float, Within(1.2, 1.42, "1", "ratio of heat capacities of exhaust")]


@dataclass(frozen=True)
class Geometry(Cylinders):
    """Volumes and cylinders."""

    V_em: Annotated[float, Within(1e-4, 0.5, "m^3", "volume of a manifold")]


@dataclass(frozen=True, kw_only=True)
class Compressor:
    """Ellipse of flow over head coefficient in one of `COMPRESSOR_FORMS`; efficiency as a quadratic around an optimum."""

    R_c: Annotated[float, Within(5e-3, 0.3, "m", "radius of a compressor")]
    form: str = "tip_speed"
    psi_0: Annotated[float | None, Within(0.3, 3, "1", "head coefficient")] = None
    psi_1: Annotated[float | None, Within(-2, 2, "1", "slope of the head coefficient")] = None
    phi_0: Annotated[float | None, Within(0.01, 1, "1", "flow coefficient")] = None
    phi_1: Annotated[float | None, Within(-0.5, 0.5, "1", "slope of the flow coefficient")] = None
    c_psi2: Annotated[float | None, Within(-3, 3, "1", "centre of the head coefficient")] = None
    c_phi2: Annotated[float | None, Within(-1, 1, "1", "centre of the flow coefficient")] = None
    c_w_psi1: Annotated[float | None, Within(-1e-5, 1e-5, "s^2", "curvature of the head's coefficient")] = None
    c_w_psi2: Annotated[float | None, Within(-0.1, 0.1, "s", "slope of the head's coefficient")] = None
    c_w_psi3: Annotated[float | None, Within(0.05, 20, "1", "level of the head's coefficient")] = None
    c_w_phi1: Annotated[float | None, Within(-1e-4, 1e-4, "s^2", "curvature of the flow's coefficient")] = None
    c_w_phi2: Annotated[float | None, Within(-1, 1, "s", "slope of the flow's coefficient")] = None
    c_w_phi3: Annotated[float | None, Within(1, 1e4, "1", "level of the flow's coefficient")] = None
    k_neg: Annotated[float, Within(0, 10, "1", "slope of the flow below a pressure ratio of one")]
    eta_c_max: Annotated[float, Within(0.2, 0.9, "1", "efficiency of a compressor")]
    W_c_opt: Annotated[float, Within(1e-3, 5, "kg/s", "flow of a compressor at its best efficiency")]
    pi_c_opt: Annotated[float, Within(0, 3, "1", "pressure ratio term of a compressor at its best efficiency")]
    c_pi: Annotated[float, Within(0.05, 1.5, "1", "exponent of the pressure ratio")]
    Q: Annotated[tuple[float, float, float], Within(-1e5, 1e5, "1", "slope of an efficiency")]  # Q_11, Q_12, Q_22
    eta_c_min: Annotated[float, Within(0.01, 0.8, "1", "lower limit of a compressor's efficiency")]

    def __post_init__(self) -> None:
        _check_form(self, self.form, COMPRESSOR_FORMS)


@dataclass(frozen=True, kw_only=True)
class Turbine:
    """Variable nozzle, efficiency over the blade speed ratio in one of `TURBINE_FORMS`, back pressure and inertia."""

    R_t: Annotated[float, Within(5e-3, 0.3, "m", "radius of a turbine")]
    A_vgt_max: Annotated[float, Within(1e-5, 0.05, "m^2", "area of a turbine")]
    K_t: Annotated[float, Within(0.3, 10, "1", "exponent of the turbine's flow")]
    c_f1: Annotated[float, Within(-10, 10, "1", "coefficient of the vanes")]
    c_f2: Annotated[float, Within(-10, 10, "1", "coefficient of the vanes")]
    c_vgt1: Annotated[float, Within(1, 1000, "%", "vane opening")]
    c_vgt2: Annotated[float, Within(-500, 500, "%", "vane opening")]
    f_vgt_min: Annotated[float, Within(0, 1, "1", "lower limit of the share of the turbine's area")]
    eta_tm_max: Annotated[float, Within(0.2, 1, "1", "efficiency of a turbine")]
    bsr_opt: Annotated[float, Within(0.2, 2, "1", "blade speed ratio")]
    form: str = "constant"
    c_m: Annotated[float | None, Within(0, 20, "1", "slope of the turbine's efficiency")] = None
    c_m1: Annotated[float | None, Within(0, 1e3, "1", "slope of the turbine's efficiency")] = None
    c_m2: Annotated[float | None, Within(0, 4e4, "rad/s", "turbine speed")] = None
    c_m3: Annotated[float | None, Within(0, 5, "1", "exponent of the turbine's speed")] = None
    eta_tm_min: Annotated[float, Within(0.01, 0.9, "1", "lower limit of a turbine's efficiency")]
    k_exhaust: Annotated[float, Within(0, 1e9, "Pa/(kg/s)^2", "back pressure")]
    J_t: Annotated[float, Within(1e-8, 0.1, "kg m^2", "inertia of a turbocharger")]

    def __post_init__(self) -> None:
        _check_form(self, self.form, TURBINE_FORMS)


@dataclass(frozen=True)
class DieselEngine:
    """All that the observer knows of the engine; `file` names what `calibrate` has found, beside the configuration."""

    gas: Gas
    geometry: Geometry
    filling: Filling
    compressor: Compressor
    turbine: Turbine
    egr: Egr
    file: str = ""


def _flat_names(part: type) -> list[str]:
    """Return the names that the constants of a part have in the flat tuple."""
    own = {"Q": ("Q_11", "Q_12", "Q_22"), "form": (f"{part.__name__.lower()}_form",)}
    return [name for item in fields(part) for name in own.get(item.name, (item.name,))]


NAMES = [name for part in (Gas, Geometry, Filling, Compressor, Turbine, Egr) for name in _flat_names(part)]


class DieselConstants(flat_type(NAMES)):  # type: ignore[misc]
    """The same constants, flat; a form is its place among the forms, and constants of other forms are zero."""


def constants_of(engine: DieselEngine) -> DieselConstants:
    """Return the engine's constants as one flat tuple of floats."""
    further = dict(zip(("Q_11", "Q_12", "Q_22"), engine.compressor.Q, strict=True))
    further["compressor_form"] = list(COMPRESSOR_FORMS).index(engine.compressor.form)
    further["turbine_form"] = list(TURBINE_FORMS).index(engine.turbine.form)
    parts = (engine.gas, engine.geometry, engine.filling, engine.compressor, engine.turbine, engine.egr)
    return flat(DieselConstants, *parts, **further)


def own_constants(engine: DieselEngine) -> dict[str, float]:
    """Return the engine's constants by name, without those of forms that it does not have."""
    others = {"compressor_form", "turbine_form"}
    for part, forms in ((engine.compressor, COMPRESSOR_FORMS), (engine.turbine, TURBINE_FORMS)):
        others.update(name for form, names in forms.items() if form != part.form for name in names)
    return {name: value for name, value in constants_of(engine)._asdict().items() if name not in others}


def _check_form(part: object, form: str, forms: Mapping[str, tuple[str, ...]]) -> None:
    """Raise ValueError for a form that does not exist, and for constants that it lacks or that belong to another form."""
    if form not in forms:
        raise ValueError(f"form = '{form}' is unknown, expected one of {', '.join(map(repr, forms))}")
    for other, names in forms.items():
        for name in names:
            given = getattr(part, name) is not None
            if other == form and not given:
                raise ValueError(f"form = '{form}' needs '{name}', which is missing")
            if other != form and given and name not in forms[form]:
                raise ValueError(
                    f"form = '{form}' does not use '{name}', which belongs to form = '{other}'; delete '{name}'"
                )
