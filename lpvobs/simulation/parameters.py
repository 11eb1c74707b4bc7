"""What the simulator needs beyond the engine's constants: one frozen record per `[simulation.*]` table of the configuration.

SI units unless a name or a comment says otherwise; speeds in rpm, fuel in mg per cylinder and cycle, openings in %.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from math import isfinite

from lpvobs.simulation.structure.amplitudes import Structure

Row = tuple[float, ...]
EQUATION_40 = (2.10e-5, -8.62e-4, 1.46e-9, -6.40e-6, -1.84e-8, 0.0032316)
"""a_2, a_1, b_2, b_1, c_2, c_1 as printed in the paper's Eq. (40): kg/s, with u_delta in mg/cycle and n_e in rpm."""
SURFACE_KINDS = ("quadratic", "king", "zero", "table")


@dataclass(frozen=True)
class Ambient:
    """The surroundings during a drive."""

    p_amb: float  # Pa
    T_amb: float  # K

    def __post_init__(self) -> None:
        _positive(self, "p_amb", "T_amb")


@dataclass(frozen=True)
class Combustion:
    """Fuel, heat release, exhaust pipe and friction."""

    X_Oc: float  # mass fraction of oxygen in fresh air
    q_HV: float  # J/kg
    air_fuel_stoichiometric: float
    gamma_cyl: float
    compression_ratio: float
    eta_ig: float  # indicated efficiency factor
    eta_sc: float  # compensation of the ideal cycle's temperature
    x_cv: float  # share of the heat released at constant volume
    h_tot: float  # W/(m^2 K)
    d_pipe: float  # m
    l_pipe: float  # m
    n_pipe: int
    friction_bar: tuple[float, float, float]  # f_0 (n_e/1000)^2 + f_1 n_e/1000 + f_2
    lambda_min: float  # the smoke limit: air in the cylinder over stoichiometric air

    def __post_init__(self) -> None:
        _positive(self, "X_Oc", "q_HV", "air_fuel_stoichiometric", "eta_ig", "eta_sc", "lambda_min")
        _require(self.compression_ratio > 1 and self.gamma_cyl > 1, "compression_ratio and gamma_cyl must exceed one")


@dataclass(frozen=True)
class Cooling:
    """Intercooler, EGR cooler and how fast the intake manifold's temperature follows."""

    effectiveness_intercooler: float
    effectiveness_egr: float
    T_cool: float  # K
    tau_T_im: float  # s

    def __post_init__(self) -> None:
        _positive(self, "T_cool", "tau_T_im")
        shares = (self.effectiveness_intercooler, self.effectiveness_egr)
        _require(all(0 <= share <= 1 for share in shares), "an effectiveness lies between 0 and 1")


@dataclass(frozen=True)
class Actuators:
    """Lags of the EGR valve, which overshoots, and of the VGT vanes."""

    tau_egr1: float  # s
    tau_egr2: float  # s
    K_egr: float
    tau_vgt: float  # s

    def __post_init__(self) -> None:
        _positive(self, "tau_egr1", "tau_egr2", "tau_vgt")


@dataclass(frozen=True)
class Control:
    """Gains of the simulator's own EGR and VGT control."""

    period: float  # s, between two actions
    egr_proportional: float  # % per unit of relative error of the fresh air
    egr_integral: float  # %/s
    egr_max: float  # %
    pressure_proportional: float  # %/Pa, VGT on p_em - p_im
    pressure_integral: float  # %/(Pa s)
    boost_proportional: float  # %/Pa, VGT on p_im
    boost_integral: float  # %/(Pa s)
    vgt_min: float  # %
    vgt_max: float  # %

    def __post_init__(self) -> None:
        _positive(self, "period")
        _require(0 <= self.vgt_min < self.vgt_max <= 100, "0 <= vgt_min < vgt_max <= 100 is needed")


@dataclass(frozen=True)
class Setpoints:
    """Targets over speed (rows) and fuel (columns); see `[simulation.setpoints]`."""

    boost_n_e: Row  # rpm
    boost_u_delta: Row  # mg/cycle
    boost: tuple[Row, ...]  # multiples of p_amb
    air_n_e: Row  # rpm
    air_u_delta: Row  # mg/cycle
    air: tuple[Row, ...]  # mg/stroke
    egr_off_above_u_delta: float
    egr_off_below_u_delta: float
    egr_off_above_n_e: float
    delta_p: tuple[float, float]  # Pa and Pa/rpm

    def __post_init__(self) -> None:
        _check_table(self.boost_n_e, self.boost_u_delta, self.boost, "boost")
        _check_table(self.air_n_e, self.air_u_delta, self.air, "air")


@dataclass(frozen=True)
class Sensors:
    """Standard deviation of white noise per channel and, in `quantisation`, the step to which readings are rounded."""

    p_im: float  # Pa
    p_em: float  # Pa
    omega_t: float  # rad/s
    T_im: float  # K
    T_em: float  # K
    W_maf_relative: float
    W_maf_absolute: float  # kg/s
    n_e: float  # rpm
    u_delta: float  # mg/cycle
    quantisation: "Quantisation"

    def __post_init__(self) -> None:
        _not_negative(self, *(name for name in self.__dataclass_fields__ if name != "quantisation"))


@dataclass(frozen=True)
class Quantisation:
    """Smallest step of each reading; zero leaves it as it is."""

    p_im: float = 0.0  # Pa
    p_em: float = 0.0  # Pa
    omega_t: float = 0.0  # rad/s
    T_im: float = 0.0  # K
    T_em: float = 0.0  # K
    W_maf: float = 0.0  # kg/s
    n_e: float = 0.0  # rpm
    u_delta: float = 0.0  # mg/cycle

    def __post_init__(self) -> None:
        _not_negative(self, *self.__dataclass_fields__)


@dataclass(frozen=True)
class Vehicle:
    """Body, drive line, gear shifts and driver."""

    gears: Row  # engine speed over that of the final drive's input
    final_drive: float
    wheel_radius: float  # m
    efficiency: float  # of the drive line
    mass: float  # kg
    road_constant: float  # N
    road_quadratic: float  # N/(km/h)^2
    rolling_resistance: float
    accessory_torque: float  # Nm
    idle_speed: float  # rpm
    launch_speed: float  # rpm, held by the slipping clutch
    shift_down_below: float  # rpm
    shift_up_light: float  # rpm, at no load
    shift_up_full: float  # rpm, at the limit of the pedal
    shift_up_always: float  # rpm
    shift_reserve: float  # share of the next gear's pedal limit that may be needed there before shifting up
    shift_time: float  # s, without traction
    shift_dwell: float  # s, between two shifts
    speed_gain: float  # 1/s, of the driver
    reaction_time: float  # s, of the driver
    pedal_time: float  # s, lag of the fuel behind the pedal
    pedal_n_e: Row  # rpm
    pedal_u_delta: Row  # mg/cycle, most that the driver asks for before shifting down

    def __post_init__(self) -> None:
        _positive(self, "final_drive", "wheel_radius", "efficiency", "mass", "idle_speed", "pedal_time", "shift_time")
        _require(len(self.gears) >= 1 and all(ratio > 0 for ratio in self.gears), "gears need positive ratios")
        _check_axis(self.pedal_n_e, "pedal_n_e")
        _require(len(self.pedal_n_e) == len(self.pedal_u_delta), "pedal_n_e and pedal_u_delta differ in length")


@dataclass(frozen=True)
class FullLoad:
    """What an engine cycle's 0 and 100 % mean: idle speed and the most fuel over speed."""

    idle_speed: float  # rpm
    n_e: Row  # rpm
    u_delta: Row  # mg/cycle

    def __post_init__(self) -> None:
        _positive(self, "idle_speed")
        _check_axis(self.n_e, "n_e")
        _require(len(self.n_e) == len(self.u_delta), "n_e and u_delta differ in length")


@dataclass(frozen=True)
class Bump:
    """A Gaussian on top of a quadratic surface."""

    amplitude: float  # kg/s
    u_delta: float  # mg/cycle, centre
    n_e: float  # rpm, centre
    width_u_delta: float  # mg/cycle, standard deviation
    width_n_e: float  # rpm, standard deviation

    def __post_init__(self) -> None:
        _positive(self, "width_u_delta", "width_n_e")


@dataclass(frozen=True)
class ErrorSurface:
    """The sensor's error over the operating point.

    Kind `quadratic`: Eq. (37) with `coefficients`, those of Eq. (40) unless given, plus `bumps`. `king`: King's law of a hot film
    whose two constants have aged, a function of the true flow. `zero`: a perfect sensor. `table`: bilinear, held outside its axes.
    """

    kind: str
    coefficients: Row = EQUATION_40  # a_2, a_1, b_2, b_1, c_2, c_1: kg/s over mg/cycle and rpm
    bumps: tuple[Bump, ...] = ()
    offset: float = 0.0  # (A' - A)/B of King's law [(kg/s)^exponent]
    slope: float = 1.0  # B'/B of King's law
    exponent: float = 0.5  # n of King's law
    u_delta: Row = ()  # mg/cycle, axis of the table
    n_e: Row = ()  # rpm, axis of the table
    values: tuple[Row, ...] = ()  # [kg/s], a row per n_e, a column per u_delta

    def __post_init__(self) -> None:
        _require(self.kind in SURFACE_KINDS, f"kind must be one of {', '.join(SURFACE_KINDS)}, not '{self.kind}'")
        _require(len(self.coefficients) == 6, "coefficients are the six of Eq. (37): a_2, a_1, b_2, b_1, c_2, c_1")
        _positive(self, "slope", "exponent")
        _not_negative(self, "offset")
        if self.kind == "table":
            _check_table(self.n_e, self.u_delta, self.values, "values")


@dataclass(frozen=True)
class SimulationParameters:
    """All of `[simulation]`."""

    step: float  # s, of the integrator
    ambient: Ambient
    combustion: Combustion
    cooling: Cooling
    actuators: Actuators
    control: Control
    setpoints: Setpoints
    sensors: Sensors
    full_load: FullLoad
    surface: ErrorSurface
    vehicle: Vehicle | None = None  # without one no speed cycle
    structure: Structure = field(default_factory=Structure)

    def __post_init__(self) -> None:
        _positive(self, "step")
        _require(self.step <= 2e-3, "step must not exceed 0.002 s: the exhaust manifold has a pole of 2 to 3 ms")
        ratio = self.control.period / self.step
        _require(round(ratio) >= 1 and abs(ratio - round(ratio)) < 1e-9, "control.period must be a multiple of step")


def _require(holds: bool, message: str) -> None:
    if not holds:
        raise ValueError(message)


def _positive(record: object, *names: str) -> None:
    for name in names:
        _require(0 < getattr(record, name) < float("inf"), f"{name} must be positive")


def _not_negative(record: object, *names: str) -> None:
    for name in names:
        _require(0 <= getattr(record, name) < float("inf"), f"{name} must not be negative")


def _check_axis(axis: Sequence[float], name: str) -> None:
    rising = all(low < high for low, high in pairwise(axis))
    _require(len(axis) >= 2 and rising and all(map(isfinite, axis)), f"{name} needs at least two rising numbers")


def _check_table(rows: Row, columns: Row, values: tuple[Row, ...], name: str) -> None:
    _check_axis(rows, f"{name}: its n_e axis")
    _check_axis(columns, f"{name}: its u_delta axis")
    shape_fits = len(values) == len(rows) and all(len(row) == len(columns) for row in values)
    _require(shape_fits, f"{name} needs {len(rows)} rows (n_e) of {len(columns)} numbers (u_delta)")
    _require(all(isfinite(value) for row in values for value in row), f"{name} holds a number that is not finite")
