"""The engine on a test bench: stationary operating points over its whole range, with a reference meter of the air flow."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from lpvobs.compiled import njit
from lpvobs.engines.diesel.constants import DieselEngine
from lpvobs.engines.diesel.lpv import Diesel
from lpvobs.errors import DataError, UsageError
from lpvobs.records import Array
from lpvobs.simulation import integrate
from lpvobs.simulation.instruments import FREE, measure, wall_temperature
from lpvobs.simulation.integrate import Commands, Course, Interval, Samples, Trip, derivative, flows
from lpvobs.simulation.parameters import FullLoad, SimulationParameters
from lpvobs.simulation.plant import STATES, U_VGT, Plant, plant_of, resting_state

UNITS = {name: channel.unit for name, channel in Diesel.channels.items() if name != "W_maf"}
UNITS |= dict.fromkeys(("W_reference", "sd_W_reference", "W_egr_reference", "W_f"), "kg/s")
MOST_POINTS = 1000
READ = ("n_e", "u_delta", "p_im", "p_em", "omega_t", "T_im", "T_em")
"""What sensors with noise read; positions and surroundings are set."""
RECORDED, RATE = 30.0, 100.0  # s and Hz, of every sensor at a point
METER, FUEL = 0.0035, 0.0012
"""Relative standard deviations: thermal reference meters of air state 0.3 to 0.4 % at best, fuel mass flow meters 0.12 %."""
EGR_METER = (0.02, 2e-5)  # of the EGR flow from CO2 before and behind the engine: relative, and [kg/s]
APPROACH = 15.0  # s under control, until the vanes have found the point
STILL = 1e-5  # 1/s, relative rate of the states at which a point counts as stationary
PATIENCE = 90.0  # s
MOST_TRIES = 2  # points that are tried for each that is wanted
COLD, WARM = 0.3, 0.15  # shares of the points whose combustion air is cold, and warm
SHUT = 0.4  # share of the points with the EGR valve shut
VANES = 30.0  # %, by which vanes are moved at most from where the control has them


@dataclass(frozen=True)
class BenchTable:
    """Stationary points, each column of shape (N,), with the unit of each; no column knows more than a bench does."""

    channels: dict[str, Array]
    units: dict[str, str]

    @property
    def duration(self) -> float:
        """For how long sensors were recorded [s]."""
        return RECORDED * self.channels["n_e"].size


class SteadyPoint(NamedTuple):
    """What the bench is asked for."""

    n_e: float  # rpm
    u_delta: float  # mg/cycle
    opening: float  # of the EGR valve, 0 to 1
    vanes: float  # %, from where the control has them
    warmer: float  # K, combustion air over the configured temperature


def bench(
    engine: DieselEngine,
    parameters: SimulationParameters,
    points: int,
    seed: int = 1,
    progress: Callable[[float], None] | None = None,
) -> BenchTable:
    """Return a table of stationary points; sensors are averaged over 30 s, slow ones have settled.

    The seed is that of the noise, and of where the points lie; `progress` takes the fraction done. Raises UsageError for an
    impossible number of points or seed; DataError if the engine settles at fewer points than it should; where it surges,
    the next point takes the place of one.
    """
    if not 1 <= points <= MOST_POINTS:
        raise UsageError(f"--bench {points}: expected 1 to {MOST_POINTS} points")
    if seed < 0:
        raise UsageError(f"--seed {seed}: expected a whole number that is not negative")
    plant = plant_of(engine, parameters)
    truth: list[dict[str, float]] = []
    for point in spread(parameters.full_load, MOST_TRIES * points, seed):
        if len(truth) < points and (found := at_rest(engine, parameters, plant, point)) is not None:
            truth.append(found)
            if progress is not None:
                progress(len(truth) / points)
    if len(truth) < points:
        said = (
            f"the simulated engine settles at {len(truth)} of the {MOST_TRIES * points} points tried, expected {points}"
        )
        raise DataError(f"{said}; use smaller amplitudes in [simulation.structure], or other set-points")
    true, readings_each = {name: np.array([row[name] for row in truth]) for name in truth[0]}, round(RECORDED * RATE)
    table = {name: true[name] for name in UNITS if name in true}
    for name in READ:
        readings = measure(name, np.repeat(true[name], readings_each), parameters.sensors, seed)
        table[name] = readings.reshape(points, readings_each).mean(axis=1)
    noise = np.random.Generator(np.random.PCG64([seed, points])).standard_normal((3, points))
    table["W_reference"] = true["W_c"] * (1.0 + METER * noise[0])
    table["sd_W_reference"] = METER * table["W_reference"]
    table["W_egr_reference"] = true["W_egr"] + (EGR_METER[0] * np.abs(true["W_egr"]) + EGR_METER[1]) * noise[1]
    table["W_f"] = true["W_f"] * (1.0 + FUEL * noise[2])
    return BenchTable({name: table[name] for name in UNITS}, UNITS)


def spread(full_load: FullLoad, points: int, seed: int) -> Sequence[SteadyPoint]:
    """Return points that fill the range evenly: speeds, loads, valve openings, vanes and air temperatures."""
    # They follow the additive recurrence of Roberts, which any number of points leaves even: k times the powers of 1/phi,
    # modulo one, with phi^6 = phi + 1 for five dimensions.
    phi = float(np.max(np.real(np.roots([1.0, 0.0, 0.0, 0.0, 0.0, -1.0, -1.0]))))
    start = np.random.Generator(np.random.PCG64(seed)).random(5)
    return [_point(full_load, *row) for row in (start + np.outer(np.arange(points), phi ** -np.arange(1.0, 6.0))) % 1.0]


def _point(full_load: FullLoad, speed: float, load: float, valve: float, vanes: float, air: float) -> SteadyPoint:
    """Return the point of five numbers between 0 and 1; the more load, the less EGR, as on any engine."""
    strong = [n for n, u in zip(full_load.n_e, full_load.u_delta, strict=True) if u > 0.5 * max(full_load.u_delta)]
    n_e = full_load.idle_speed + speed * (max(strong) - full_load.idle_speed)
    share = 0.08 + 0.92 * load
    opening = 0.0 if valve < SHUT else (0.05 + 0.95 * (valve - SHUT) / (1.0 - SHUT)) * (1.0 - 0.6 * share)
    if air < COLD:
        warmer = -30.0 + 20.0 * air / COLD
    elif air > 1.0 - WARM:
        warmer = 5.0 + 10.0 * (air - 1.0 + WARM) / WARM
    else:
        warmer = -3.0 + 6.0 * (air - COLD) / (1.0 - WARM - COLD)
    u_delta = share * float(np.interp(n_e, full_load.n_e, full_load.u_delta))
    return SteadyPoint(n_e, u_delta, opening, VANES * (2.0 * vanes - 1.0), warmer)


def at_rest(
    engine: DieselEngine, parameters: SimulationParameters, plant: Plant, point: SteadyPoint
) -> dict[str, float] | None:
    """Return the true signals and flows at a point: the control finds it, then valve and vanes are fixed until nothing moves."""
    # None where it keeps moving: a compressor that surges, which a bench does not stay in.
    p_amb, T_amb = parameters.ambient.p_amb, parameters.ambient.T_amb + point.warmer
    targets = integrate.targets_of(parameters, engine.geometry.n_cyl)
    still = np.ones(round(APPROACH / targets.period) + 1)
    W_f = 1e-6 / 120.0 * point.u_delta * point.n_e * engine.geometry.n_cyl
    heat = parameters.combustion.q_HV * W_f / engine.geometry.V_d
    wall = wall_temperature(targets.period, parameters.cooling.T_cool * still, heat * still)
    course = Course(point.n_e * still, point.u_delta * still, p_amb * still, T_amb * still, wall, FREE * still)
    x = resting_state(plant, p_amb, T_amb)
    nothing = Samples(np.empty(0, dtype=np.int64), np.empty(0))
    integrate.drive([(0, plant)], Trip(targets, course, nothing, parameters.step), x)
    u_egr = point.opening * targets.egr_max
    u_vgt = min(max(float(x[U_VGT]) + point.vanes, targets.vgt_min + 5.0), targets.vgt_max)
    held = Interval(course, Commands(u_egr, u_vgt, 0.0, 0.0), targets.period, 0)
    if not settle(plant, held, parameters.step, x):
        return None
    given = integrate.inputs_at(held, 0.0)
    return {**given._asdict(), **dict(zip(STATES, x.tolist(), strict=True)), **flows(plant, x, given)._asdict()}


@njit(cache=True)
def settle(plant: Plant, held: Interval, step: float, x: Array) -> bool:
    """Move the state x, shape (9,), on until it moves by less than `STILL`; return whether it came to that."""
    work, rate = np.empty((6, x.size)), np.empty(x.size)
    given = integrate.inputs_at(held, 0.0)
    for _ in range(round(PATIENCE)):
        for _ in range(round(1.0 / step)):
            integrate.runge_kutta(plant, held, 0.0, step, x, work)
        derivative(plant, x, given, rate)
        if np.all(np.abs(rate) <= STILL * np.maximum(np.abs(x), 1e-2)):
            return True
    return False
