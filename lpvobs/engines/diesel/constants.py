"""The constants of a diesel with EGR and VGT, as an engineer states them.

Structure after Wahlstrom and Eriksson, Proc. IMechE D 225 (2011), the paper's reference 16. SI units unless said otherwise.
The attributes bear the names of the configuration's `[engine.*]` tables.
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, is_dataclass, replace
from math import isfinite
from typing import Any, NamedTuple, TypeVar

Record = TypeVar("Record")


@dataclass(frozen=True)
class Gas:
    """Gas properties and the surroundings that the constants refer to."""

    R_a: float  # J/(kg K), air
    R_e: float  # J/(kg K), exhaust
    c_pa: float  # J/(kg K)
    c_pe: float  # J/(kg K)
    gamma_a: float
    gamma_e: float

    def __post_init__(self) -> None:
        _check(self, "R_a", "R_e", "c_pa", "c_pe")


@dataclass(frozen=True)
class Geometry:
    """Volumes and cylinders."""

    V_d: float  # m^3, displaced
    n_cyl: int
    V_im: float  # m^3
    V_em: float  # m^3

    def __post_init__(self) -> None:
        _check(self, "V_d", "n_cyl", "V_im", "V_em")


@dataclass(frozen=True)
class Filling:
    """eta_vol = c_vol1 sqrt(p_im) + c_vol2 sqrt(n_e) + c_vol3, p_im in Pa, n_e in rpm."""

    c_vol1: float
    c_vol2: float
    c_vol3: float

    def __post_init__(self) -> None:
        _check(self)


@dataclass(frozen=True)
class Compressor:
    """Ellipse of flow over head coefficient; efficiency as a quadratic around an optimum."""

    R_c: float  # m
    psi_0: float
    psi_1: float
    phi_0: float
    phi_1: float
    k_neg: float
    eta_c_max: float
    W_c_opt: float  # kg/s
    pi_c_opt: float
    c_pi: float
    Q: tuple[float, float, float]  # Q_11, Q_12, Q_22
    eta_c_min: float

    def __post_init__(self) -> None:
        _check(self, "R_c", "psi_0", "phi_0", "eta_c_min")


@dataclass(frozen=True)
class Turbine:
    """Variable nozzle, efficiency over the blade speed ratio, back pressure and inertia."""

    R_t: float  # m
    A_vgt_max: float  # m^2
    K_t: float
    c_f1: float
    c_f2: float
    c_vgt1: float  # %
    c_vgt2: float  # %
    f_vgt_min: float
    eta_tm_max: float
    bsr_opt: float
    c_m: float
    eta_tm_min: float
    k_exhaust: float  # Pa/(kg/s)^2
    J_t: float  # kg m^2

    def __post_init__(self) -> None:
        _check(self, "R_t", "A_vgt_max", "K_t", "c_vgt1", "eta_tm_min", "J_t")


@dataclass(frozen=True)
class Egr:
    """EGR valve: area over opening, and the flow function; reverse flow is reduced by k_reverse."""

    A_egr_max: float  # m^2
    c_egr1: float  # 1/%^2
    c_egr2: float  # 1/%
    pi_egr_opt: float
    k_reverse: float

    def __post_init__(self) -> None:
        _check(self, "A_egr_max", "c_egr2", "pi_egr_opt")


@dataclass(frozen=True)
class DieselEngine:
    """All that the observer knows of the engine."""

    gas: Gas
    geometry: Geometry
    filling: Filling
    compressor: Compressor
    turbine: Turbine
    egr: Egr


class DieselConstants(NamedTuple):
    """The same constants, flat, for the compiled relations (numba reads a named tuple by field name)."""

    R_a: float
    R_e: float
    c_pa: float
    c_pe: float
    gamma_a: float
    gamma_e: float
    V_d: float
    n_cyl: float
    V_im: float
    V_em: float
    c_vol1: float
    c_vol2: float
    c_vol3: float
    R_c: float
    psi_0: float
    psi_1: float
    phi_0: float
    phi_1: float
    k_neg: float
    eta_c_max: float
    W_c_opt: float
    pi_c_opt: float
    c_pi: float
    Q_11: float
    Q_12: float
    Q_22: float
    eta_c_min: float
    R_t: float
    A_vgt_max: float
    K_t: float
    c_f1: float
    c_f2: float
    c_vgt1: float
    c_vgt2: float
    f_vgt_min: float
    eta_tm_max: float
    bsr_opt: float
    c_m: float
    eta_tm_min: float
    k_exhaust: float
    J_t: float
    A_egr_max: float
    c_egr1: float
    c_egr2: float
    pi_egr_opt: float
    k_reverse: float


def constants_of(engine: DieselEngine) -> DieselConstants:
    """Return the engine's constants as one flat tuple of floats."""
    values: dict[str, float] = {}
    for part in (engine.gas, engine.geometry, engine.filling, engine.compressor, engine.turbine, engine.egr):
        values |= asdict(part)
    values["Q_11"], values["Q_12"], values["Q_22"] = values.pop("Q")  # type: ignore[misc]
    return DieselConstants(**{name: float(value) for name, value in values.items()})


def scaled(record: Record, constants: Mapping[str, float]) -> Record:
    """Return an engine with some of its constants multiplied by one plus their relative deviation, wherever they stand.

    Examples
    --------
    >>> from lpvobs.engines.diesel.constants import Egr
    >>> scaled(Egr(1.0, 0.0, 2.0, 0.65, 0.6), {"c_egr2": 0.5}).c_egr2
    3.0
    """
    changed: dict[str, Any] = {}
    for item in fields(record):  # type: ignore[arg-type]
        value = getattr(record, item.name)
        if is_dataclass(value):
            changed[item.name] = scaled(value, constants)
        elif item.name in constants:
            changed[item.name] = value * (1.0 + constants[item.name])
    return replace(record, **changed)  # type: ignore[type-var]


def _check(part: object, *positive: str) -> None:
    """Raise ValueError for a constant that is not finite, or not positive where it has to be."""
    for name, value in vars(part).items():
        if not all(map(isfinite, value if isinstance(value, tuple) else (value,))):
            raise ValueError(f"{name} must be finite")
        if name in positive and not value > 0:
            raise ValueError(f"{name} must be positive")
