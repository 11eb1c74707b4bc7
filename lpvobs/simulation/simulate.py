"""From a cycle to a recorded log with its truth."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from lpvobs.airpath.diesel_engine import DieselEngine
from lpvobs.errors import UsageError
from lpvobs.records import Array
from lpvobs.simulation.bench import drive_engine_cycle
from lpvobs.simulation.control import targets_of
from lpvobs.simulation.cycles import SpeedCycle, load_cycle
from lpvobs.simulation.integrate import RECORDED, Course, drive, sample_times
from lpvobs.simulation.parameters import SimulationParameters, Surface
from lpvobs.simulation.plant import plant_of, resting_state
from lpvobs.simulation.sensors import measure
from lpvobs.simulation.surface import surface_error
from lpvobs.simulation.torque import work_of
from lpvobs.simulation.vehicle import drive_speed_cycle

UNITS = {
    "time": "s",
    "n_e": "rpm",
    "u_delta": "mg/cycle",
    "u_egr": "%",
    "u_vgt": "%",
    "p_im": "Pa",
    "p_em": "Pa",
    "omega_t": "rad/s",
    "T_im": "K",
    "T_em": "K",
    "p_amb": "Pa",
    "T_amb": "K",
    "W_maf": "kg/s",
    "ref_W_c": "kg/s",
    "ref_delta_W_c": "kg/s",
}


@dataclass(frozen=True)
class SimulatedLog:
    """A log as it would be recorded, and the truth behind it.

    Attributes
    ----------
    channels : mapping of str to ndarray, shape (N,)
        Readings with noise, and the reference channels.
    units : mapping of str to str
    truth : mapping of str to ndarray, shape (N,)
        Noise-free signals, flows among them.
    """

    channels: Mapping[str, Array]
    units: Mapping[str, str]
    truth: Mapping[str, Array]


def simulate(
    engine: DieselEngine,
    parameters: SimulationParameters,
    cycle: str,
    rate: float = 100.0,
    seed: int = 1,
    surface: Surface | None = None,
    progress: Callable[[float], None] | None = None,
) -> SimulatedLog:
    """Drive the plant over a cycle and record it.

    Parameters
    ----------
    engine : DieselEngine
        The engine as it is.
    parameters : SimulationParameters
    cycle : str
        A name of `lpvobs.simulation.cycles`, or the path of a table.
    rate : float
        [Hz]; at most one sample per step of the integrator.
    seed : int
        Of the sensor noise; same seed, same log.
    surface : Surface, optional
        The sensor's error instead of the configured one.
    progress : callable, optional
        Takes the fraction done.

    Raises
    ------
    UsageError
        For an unknown cycle or an impossible rate or seed.
    """
    if not 0 < rate <= 1.0 / parameters.step:
        raise UsageError(
            f"--rate {rate:g}: expected more than 0 and at most {1.0 / parameters.step:g} Hz, a sample per step"
        )
    if seed < 0:
        raise UsageError(f"--seed {seed}: expected a whole number that is not negative")
    course = course_of(engine, parameters, cycle)
    plant = plant_of(engine, parameters)
    samples = sample_times(rate, (course.n_e.size - 1) * parameters.control.period, parameters.step)
    start = resting_state(plant, course.p_amb, course.T_amb)
    targets = targets_of(parameters, engine.geometry.n_cyl)
    recorded = drive(plant, targets, course, samples, parameters.step, start, progress)
    truth = dict(zip(RECORDED, recorded.T, strict=True))
    truth["p_amb"] = np.full(recorded.shape[0], course.p_amb)
    truth["T_amb"] = np.full(recorded.shape[0], course.T_amb)
    error = surface_error(surface or parameters.surface, truth["u_delta"], truth["n_e"], truth["W_c"])
    truth["W_maf"] = truth["W_c"] + error
    sensed = [name for name in UNITS if name in truth]
    readings = measure({name: truth[name] for name in sensed}, parameters.sensors, seed)
    time = np.arange(recorded.shape[0]) / rate
    return SimulatedLog({"time": time, **readings, "ref_W_c": truth["W_c"], "ref_delta_W_c": error}, UNITS, truth)


def course_of(engine: DieselEngine, parameters: SimulationParameters, cycle: str) -> Course:
    """Return what the cycle asks of the engine, at every action of its control."""
    period, work, table = parameters.control.period, work_of(engine, parameters), load_cycle(cycle)
    if isinstance(table, SpeedCycle):
        n_e, u_delta = drive_speed_cycle(parameters.vehicle, work, table, period)
    else:
        n_e, u_delta = drive_engine_cycle(parameters.full_load, work, table, period)
    return Course(n_e, u_delta, parameters.ambient.p_amb, parameters.ambient.T_amb)
