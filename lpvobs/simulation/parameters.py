"""What the simulator needs beyond the engine's constants: one frozen record per `[simulation.*]` table of the configuration.

SI units unless a name or a comment says otherwise; speeds in rpm, fuel in mg per cylinder and cycle, openings in %.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from itertools import pairwise
from math import inf, isfinite
from typing import Annotated

from lpvobs.engines.constants import flat_type, names_of

Row = tuple[float, ...]
EQUATION_40 = (2.10e-5, -8.62e-4, 1.46e-9, -6.40e-6, -1.84e-8, 0.0032316)
"""a_2, a_1, b_2, b_1, c_2, c_1 as printed in the paper's Eq. (40): kg/s, with u_delta in mg/cycle and n_e in rpm."""
SURFACE_KINDS = ("quadratic", "king", "zero", "table")

# A number of a record, what holds of it, and what is said where it does not.
Positive = Annotated[float, (lambda x: 0 < x < inf, "must be positive")]
OverOne = Annotated[float, (lambda x: x > 1, "must exceed one")]
NotNegative = Annotated[float, (lambda x: 0 <= x < inf, "must not be negative")]
Share = Annotated[float, (lambda x: 0 <= x <= 1, "must lie between 0 and 1")]
# Twice what real diesels show; with more, the control of the plant no longer reaches its set-points.
Amplitude = Annotated[float, (lambda x: 0 <= x <= 2, "must lie between 0 and 2; 1 is the size typical of real diesels")]


def _rises(axis: Sequence[float]) -> bool:
    return len(axis) >= 2 and all(low < high for low, high in pairwise(axis)) and all(map(isfinite, axis))


RISING = "needs at least two finite numbers in rising order"
Axis = Annotated[Row, (_rises, RISING)]
ShortStep = Annotated[
    Positive, (lambda x: x <= 2e-3, "must not exceed 0.002 s: the exhaust manifold has a time constant of 2 to 3 ms")
]
SixTerms = Annotated[Row, (lambda x: len(x) == 6, "must be the six numbers a_2, a_1, b_2, b_1, c_2, c_1 of Eq. (37)")]
Gears = Annotated[
    Row, (lambda x: x and all(ratio > 0 for ratio in x), "must list at least one ratio, and positive ratios only")
]


@dataclass(frozen=True)
class Checked:
    """A record that refuses, with ValueError, numbers of which the annotation of their field does not hold."""

    def __post_init__(self) -> None:
        for item in fields(self):
            for holds, says in getattr(item.type, "__metadata__", ()):
                _require(holds(getattr(self, item.name)), f"{item.name} {says}")


@dataclass(frozen=True)
class Ambient(Checked):
    """The surroundings during a drive."""

    p_amb: Positive  # Pa
    T_amb: Positive  # K


@dataclass(frozen=True)
class Combustion(Checked):
    """Fuel, heat release, exhaust pipe and friction."""

    X_Oc: Positive  # mass fraction of oxygen in fresh air
    q_HV: Positive  # J/kg
    air_fuel_stoichiometric: Positive
    gamma_cyl: OverOne
    compression_ratio: OverOne
    eta_ig: Positive  # indicated efficiency factor
    eta_sc: Positive  # compensation of the ideal cycle's temperature
    x_cv: float  # share of the heat released at constant volume
    h_tot: float  # W/(m^2 K)
    d_pipe: float  # m
    l_pipe: float  # m
    n_pipe: int
    friction_bar: tuple[float, float, float]  # f_0 (n_e/1000)^2 + f_1 n_e/1000 + f_2
    lambda_min: Positive  # the smoke limit: air in the cylinder over stoichiometric air


@dataclass(frozen=True)
class Cooling(Checked):
    """Intercooler, EGR cooler and how fast the intake manifold's temperature follows."""

    effectiveness_intercooler: Share
    effectiveness_egr: Share
    T_cool: Positive  # K
    tau_T_im: Positive  # s


@dataclass(frozen=True)
class Actuators(Checked):
    """Lags of the EGR valve, which overshoots, and of the VGT vanes."""

    tau_egr1: Positive  # s
    tau_egr2: Positive  # s
    K_egr: float
    tau_vgt: Positive  # s


@dataclass(frozen=True)
class Control(Checked):
    """Gains of the simulator's own EGR and VGT control."""

    period: Positive  # s, between two actions
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
        super().__post_init__()
        in_order = 0 <= self.vgt_min < self.vgt_max <= 100
        _require(in_order, "vgt_min and vgt_max must satisfy 0 <= vgt_min < vgt_max <= 100")


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
class Sensors(Checked):
    """Standard deviation of white noise per channel and, in `quantisation`, the step to which readings are rounded."""

    p_im: NotNegative  # Pa
    p_em: NotNegative  # Pa
    omega_t: NotNegative  # rad/s
    T_im: NotNegative  # K
    T_em: NotNegative  # K
    W_maf_relative: NotNegative
    W_maf_absolute: NotNegative  # kg/s
    n_e: NotNegative  # rpm
    u_delta: NotNegative  # mg/cycle
    quantisation: "Quantisation"


@dataclass(frozen=True)
class Quantisation(Checked):
    """Smallest step of each reading; zero leaves it as it is."""

    p_im: NotNegative = 0.0  # Pa
    p_em: NotNegative = 0.0  # Pa
    omega_t: NotNegative = 0.0  # rad/s
    T_im: NotNegative = 0.0  # K
    T_em: NotNegative = 0.0  # K
    W_maf: NotNegative = 0.0  # kg/s
    n_e: NotNegative = 0.0  # rpm
    u_delta: NotNegative = 0.0  # mg/cycle


@dataclass(frozen=True)
class Vehicle(Checked):
    """Body, drive line, gear shifts and driver."""

    gears: Gears  # engine speed over that of the final drive's input
    final_drive: Positive
    wheel_radius: Positive  # m
    efficiency: Positive  # of the drive line
    mass: Positive  # kg
    road_constant: float  # N
    road_quadratic: float  # N/(km/h)^2
    rolling_resistance: float
    accessory_torque: float  # Nm
    idle_speed: Positive  # rpm
    launch_speed: float  # rpm, held by the slipping clutch
    shift_down_below: float  # rpm
    shift_up_light: float  # rpm, at no load
    shift_up_full: float  # rpm, at the limit of the pedal
    shift_up_always: float  # rpm
    shift_reserve: float  # share of the next gear's pedal limit that may be needed there before shifting up
    shift_time: Positive  # s, without traction
    shift_dwell: float  # s, between two shifts
    speed_gain: float  # 1/s, of the driver
    reaction_time: float  # s, of the driver
    pedal_time: Positive  # s, lag of the fuel behind the pedal
    pedal_n_e: Axis  # rpm
    pedal_u_delta: Row  # mg/cycle, most that the driver asks for before shifting down

    def __post_init__(self) -> None:
        super().__post_init__()
        alike = len(self.pedal_n_e) == len(self.pedal_u_delta)
        _require(alike, "pedal_n_e and pedal_u_delta must have the same length")


@dataclass(frozen=True)
class FullLoad(Checked):
    """What 0 and 100 % of an engine cycle stand for: idle speed, and the full-load fuel over speed."""

    idle_speed: Positive  # rpm
    n_e: Axis  # rpm
    u_delta: Row  # mg/cycle

    def __post_init__(self) -> None:
        super().__post_init__()
        _require(len(self.n_e) == len(self.u_delta), "n_e and u_delta must have the same length")


@dataclass(frozen=True)
class Bump(Checked):
    """A Gaussian on top of a quadratic surface."""

    amplitude: float  # kg/s
    u_delta: float  # mg/cycle, centre
    n_e: float  # rpm, centre
    width_u_delta: Positive  # mg/cycle, standard deviation
    width_n_e: Positive  # rpm, standard deviation


@dataclass(frozen=True)
class ErrorSurface(Checked):
    """The sensor's error over the operating point.

    Kind `quadratic`: Eq. (37) with `coefficients`, those of Eq. (40) unless given, plus `bumps`. `king`: King's law of a hot film
    whose two constants have aged, a function of the true flow. `zero`: a perfect sensor. `table`: bilinear, held outside its axes.
    """

    kind: str
    coefficients: SixTerms = EQUATION_40  # a_2, a_1, b_2, b_1, c_2, c_1: kg/s over mg/cycle and rpm
    bumps: tuple[Bump, ...] = ()
    offset: NotNegative = 0.0  # (A' - A)/B of King's law [(kg/s)^exponent]
    slope: Positive = 1.0  # B'/B of King's law
    exponent: Positive = 0.5  # n of King's law
    u_delta: Row = ()  # mg/cycle, axis of the table
    n_e: Row = ()  # rpm, axis of the table
    values: tuple[Row, ...] = ()  # [kg/s], a row per n_e, a column per u_delta

    def __post_init__(self) -> None:
        super().__post_init__()
        _require(self.kind in SURFACE_KINDS, f"kind must be one of {', '.join(SURFACE_KINDS)}, not '{self.kind}'")
        if self.kind == "table":
            _check_table(self.n_e, self.u_delta, self.values, "values")


@dataclass(frozen=True)
class Structure(Checked):
    """Amplitude of each structural difference from the observer's model: 0 leaves it out, 1 is typical of real diesels."""

    wave: Amplitude = 0.0
    residual_gas: Amplitude = 0.0
    charge_heating: Amplitude = 0.0
    egr: Amplitude = 0.0
    compressor: Amplitude = 0.0
    turbine: Amplitude = 0.0
    pipes: Amplitude = 0.0
    thermocouple: Amplitude = 0.0
    maf_element: Amplitude = 0.0
    rasters: Amplitude = 0.0


class Amplitudes(flat_type(names_of(Structure))):  # type: ignore[misc]
    """The same as compiled functions read them."""


@dataclass(frozen=True)
class SimulationParameters(Checked):
    """All of `[simulation]`."""

    step: ShortStep  # s, of the integrator
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
        super().__post_init__()
        ratio = self.control.period / self.step
        _require(round(ratio) >= 1 and abs(ratio - round(ratio)) < 1e-9, "control.period must be a multiple of step")


PLANTS: Mapping[str, type] = {"nine states": SimulationParameters}
"""The record of `[simulation]` by what simulates an engine, as the engine's own record names it."""


def _require(holds: bool, message: str) -> None:
    if not holds:
        raise ValueError(message)


def _check_table(rows: Row, columns: Row, values: tuple[Row, ...], name: str) -> None:
    _require(_rises(rows), f"the n_e axis of {name} {RISING}")
    _require(_rises(columns), f"the u_delta axis of {name} {RISING}")
    shape_fits = len(values) == len(rows) and all(len(row) == len(columns) for row in values)
    _require(shape_fits, f"{name} needs {len(rows)} rows (n_e) of {len(columns)} numbers (u_delta)")
    _require(all(isfinite(value) for row in values for value in row), f"{name} must contain finite numbers only")
