"""From a cycle to a recorded log with its truth."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from lpvobs.airpath.diesel_engine import DieselEngine
from lpvobs.errors import UsageError
from lpvobs.records import Array
from lpvobs.simulation.bench import drive_engine_cycle
from lpvobs.simulation.condition import stages_of
from lpvobs.simulation.control import targets_of
from lpvobs.simulation.cycles import SpeedCycle, load_cycle
from lpvobs.simulation.effects import Effect
from lpvobs.simulation.integrate import RECORDED, TRAIL, Course, Samples, at_samples, drive, sample_times
from lpvobs.simulation.parameters import SimulationParameters, Surface
from lpvobs.simulation.plant import plant_of, resting_state
from lpvobs.simulation.readings import WITH_MEMORY, maf_reading, reading, with_memory
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
        Noise-free signals, flows among them; `W_maf` is the noise-free reading with the effects in it.
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
    effects: Sequence[Effect] = (),
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
    effects : sequence of Effect
        What has happened to engine and sensors. The control of the engine keeps its own true signals.

    Raises
    ------
    UsageError
        For an unknown cycle, an impossible rate or seed, or an effect that cannot show on this drive.
    """
    if not 0 < rate <= 1.0 / parameters.step:
        raise UsageError(
            f"--rate {rate:g}: expected more than 0 and at most {1.0 / parameters.step:g} Hz, a sample per step"
        )
    if seed < 0:
        raise UsageError(f"--seed {seed}: expected a whole number that is not negative")
    course = course_of(engine, parameters, cycle)
    acting = [effect for effect in effects if effect.acts]
    _check_that_they_show(acting, course, parameters.control.period)
    truth, shown = _drive(engine, parameters, course, rate, surface or parameters.surface, acting, progress)
    readings = measure({name: shown[name] for name in UNITS if name in shown}, parameters.sensors, seed)
    time = np.arange(truth["W_c"].size) / rate
    references = {"ref_W_c": truth["W_c"], "ref_delta_W_c": truth["delta_W_c"]}
    return SimulatedLog({"time": time, **readings, **references}, UNITS, truth)


def course_of(engine: DieselEngine, parameters: SimulationParameters, cycle: str) -> Course:
    """Return what the cycle asks of the engine, at every action of its control."""
    period, work, table = parameters.control.period, work_of(engine, parameters), load_cycle(cycle)
    if isinstance(table, SpeedCycle):
        n_e, u_delta = drive_speed_cycle(parameters.vehicle, work, table, period)
    else:
        n_e, u_delta = drive_engine_cycle(parameters.full_load, work, table, period)
    still = np.ones_like(n_e)
    return Course(n_e, u_delta, parameters.ambient.p_amb * still, parameters.ambient.T_amb * still)


def _check_that_they_show(effects: Sequence[Effect], course: Course, period: float) -> None:
    """Refuse effects that would leave no trace: a later search for them would blame the searcher."""
    duration = (course.n_e.size - 1) * period
    for effect in effects:
        if (effect.onset or 0.0) >= duration:
            raise UsageError(
                f"{effect.id}: onset = {effect.onset:g} s, expected before the drive ends at {duration:g} s"
            )


def _drive(
    engine: DieselEngine,
    parameters: SimulationParameters,
    course: Course,
    rate: float,
    surface: Surface,
    effects: Sequence[Effect],
    progress: Callable[[float], None] | None,
) -> tuple[dict[str, Array], dict[str, Array]]:
    """Return the truth at the samples and what noise-free sensors show of it, by channel, each of shape (N,)."""
    period, plant = parameters.control.period, plant_of(engine, parameters)
    samples = sample_times(rate, (course.n_e.size - 1) * period, parameters.step)
    stages = stages_of(plant, effects, period, course.n_e.size - 1)
    start = resting_state(plant, course.p_amb[0], course.T_amb[0])
    with_trail = any(effect.id in WITH_MEMORY for effect in effects)
    targets = targets_of(parameters, engine.geometry.n_cyl)
    recorded, trail = drive(stages, targets, course, samples, parameters.step, start, progress, with_trail)
    time = samples.step * parameters.step + samples.after
    truth = dict(zip(RECORDED, recorded.T, strict=True)) | _ambient(course, time, period)
    truth["delta_W_c"] = surface_error(surface, truth["u_delta"], truth["n_e"], truth["W_c"])
    truth["W_maf"] = maf_reading(truth, time, surface, engine.gas.R_a, effects)
    shown = {name: reading(name, values, time, effects) for name, values in truth.items() if name != "W_maf"}
    shown["W_maf"] = truth["W_maf"]
    if with_trail:
        late = _behind(
            dict(zip(TRAIL, trail.T, strict=True)), course, samples, parameters, surface, engine.gas.R_a, effects
        )
        shown |= late
        truth["W_maf"] = late["W_maf"]
    return truth, shown


def _ambient(course: Course, time: Array, period: float) -> dict[str, Array]:
    """Return the true surroundings at given times, shape (N,)."""
    actions = np.arange(course.n_e.size) * period
    return {"p_amb": np.interp(time, actions, course.p_amb), "T_amb": np.interp(time, actions, course.T_amb)}


def _behind(
    trail: Mapping[str, Array],
    course: Course,
    samples: Samples,
    parameters: SimulationParameters,
    surface: Surface,
    R_a: float,
    effects: Sequence[Effect],
) -> dict[str, Array]:
    """Return what the sensors with a memory show at the samples, from the trail at every step of the integrator."""
    step = parameters.step
    steps = trail["W_c"].size
    time = np.linspace(0.0, (steps - 1) * step, steps)
    point = {**trail, **_ambient(course, time, parameters.control.period)}
    shown = {"W_maf": maf_reading(point, time, surface, R_a, effects), "T_im": trail["T_im"]}
    own = {"W_maf": "maf.", "T_im": "T_im."}
    late = {
        name: with_memory(values, step, [effect for effect in effects if effect.id.startswith(own[name])])
        for name, values in shown.items()
    }
    return {name: at_samples(values, samples, step) for name, values in late.items()}
