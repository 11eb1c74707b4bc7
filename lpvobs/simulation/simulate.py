"""From a cycle to a recorded log with its truth; effects inside the engine are its condition from each moment on."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import ceil, floor
from types import MappingProxyType

import numpy as np

from lpvobs.engines.channels import Sensor
from lpvobs.engines.constants import scaled
from lpvobs.engines.diesel.constants import DieselEngine, own_constants
from lpvobs.engines.diesel.lpv import Diesel
from lpvobs.errors import UsageError
from lpvobs.records import Array
from lpvobs.simulation.disturbances import ChannelEffect, Injected
from lpvobs.simulation.effects import CATALOGUE, CatalogueEffect, Timed
from lpvobs.simulation.instruments import record, shown_late, stream_of
from lpvobs.simulation.integrate import Trip, drive, sample_times, targets_of
from lpvobs.simulation.parameters import ErrorSurface, SimulationParameters
from lpvobs.simulation.plant import SOUND, Condition, Plant, Rise, plant_of, resting_state
from lpvobs.simulation.readings import WARM, WITH_MEMORY, Instruments, behind, sense
from lpvobs.simulation.road import AUXILIARY, Auxiliary, measure_road
from lpvobs.simulation.scene import DriveCourse, scene_of

LEVELS = 200  # steps in which an effect grows: half a per cent of it


def stages_of(plant: Plant, effects: Sequence[CatalogueEffect], time: Array) -> tuple[tuple[int, Plant], ...]:
    """Return the plant from each action of the control, at given times [s], on at which its condition changes, the first from 0."""
    # Of the effects those that live in the plant count. An onset between two actions waits for the later one.
    acting = [effect for effect in effects if effect.kind.place == "plant"]
    levels = np.array([np.round(LEVELS * effect.share(time)) for effect in acting]).reshape(len(acting), time.size)
    changes = np.flatnonzero(np.abs(np.diff(levels, axis=1)).sum(axis=0)) + 1
    shares = {now: (levels[:, now] / LEVELS).tolist() for now in [0, *changes.tolist()]}
    return tuple((now, plant._replace(condition=_condition(acting, there))) for now, there in shares.items())


def _condition(effects: Sequence[CatalogueEffect], shares: Sequence[float]) -> Condition:
    """Return the condition with shares of effects: factors of the same kind multiply, areas add, of curves the last stands."""
    values = SOUND._asdict()
    for effect, share in zip(effects, shares, strict=True):
        name, neutral = effect.id.replace(".", "_"), effect.kind.neutral
        value = effect.value if share == 1.0 else neutral + share * (effect.value - neutral)
        if effect.kind.bump:
            values[name] = Rise(value, *(effect.bump or effect.kind.bump)) if value else values[name]
        else:
            values[name] = values[name] + value if effect.kind.parameter == "area" else values[name] * value
    return Condition(**values)


FINE = 500.0  # hz, of the signals behind sensors with a memory: a hot film takes 15 ms
UNITS = {"time": "s"} | {name: channel.unit for name, channel in Diesel.channels.items()}
UNITS |= {"ref_W_c": "kg/s", "ref_delta_W_c": "kg/s"}


@dataclass(frozen=True)
class SimulatedLog:
    """A log as it would be recorded, and the truth behind it."""

    channels: Mapping[str, Array]  # (N,) readings with noise, and the reference channels
    units: Mapping[str, str]
    # (N,) noise-free signals, flows among them; `W_maf` is the noise-free reading with the effects in it
    truth: Mapping[str, Array]


def simulate(
    engine: DieselEngine,
    parameters: SimulationParameters,
    cycle: str,
    rate: float = 100.0,
    seed: int = 1,
    surface: ErrorSurface | None = None,
    progress: Callable[[float], None] | None = None,
    effects: Sequence[Injected] = (),
    auxiliary: Auxiliary | None = None,
    sensors: Mapping[str, Sensor] = MappingProxyType({}),
) -> SimulatedLog:
    """Drive the plant over a cycle, a name of `cycles` or the path of a table, and record it at a rate [Hz].

    The seed is that of the sensor noise and of the road; same seed, same log. A `surface` takes the place of the configured
    error of the sensor. `sensors` is what is known of sensors in order, by channel; effects are what has happened to engine and
    sensors. The control of the engine keeps its own true signals. With `auxiliary` the drive is on the road, where the air is not
    constant, and these channels are logged as well.
    `progress` takes the fraction done.

    Raises UsageError for an unknown cycle, an impossible rate or seed, or an effect that cannot show on this drive.
    """
    if not 0 < rate <= 1.0 / parameters.step:
        fastest = f"{1.0 / parameters.step:g} Hz, the rate of the simulation"
        raise UsageError(f"--rate {rate:g}: expected above 0 and at most {fastest}")
    if seed < 0:
        raise UsageError(f"--seed {seed}: expected a whole number that is not negative")
    scene, form, size = scene_of(engine, parameters, cycle, auxiliary, seed), parameters.structure, engine.geometry
    course = scene.course
    moments = np.arange(0.0, course.n_e.size) * scene.period
    inputs = {"n_e": course.n_e, "u_delta": course.u_demand, **scene.channels}
    effects = [effect.along(moments, inputs) if isinstance(effect, Timed) else effect for effect in effects]
    for effect in effects:
        _check_that_it_shows(effect, scene)
    catalogued = [effect for effect in effects if isinstance(effect, CatalogueEffect)]
    others = tuple(effect for effect in effects if not isinstance(effect, CatalogueEffect))
    pulsing = [CatalogueEffect("maf.backflow", sensor.pulsation) for sensor in sensors.values() if sensor.pulsation]
    acting = tuple(effect for effect in (*catalogued, *pulsing) if effect.acts)
    # samples that are taken for each that is logged: sensors and recorders with a memory need `FINE` of them a second
    slow = form.thermocouple + form.maf_element + form.rasters > 0.0
    remembers = slow or any(sensor.tau or sensor.late for sensor in sensors.values())
    most = floor(1.0 / (parameters.step * rate) + 1e-9) if remembers else 1
    fine = max(1, min(ceil(FINE / rate), most))
    plant, step = plant_of(engine, parameters), 1.0 / (rate * fine)
    samples = sample_times(rate * fine, scene.duration, parameters.step)
    trip = Trip(targets_of(parameters, size.n_cyl), course, samples, parameters.step)
    stages, x = stages_of(plant, acting, moments[:-1]), resting_state(plant, course.p_amb[0], course.T_amb[0])
    with_trail = any(effect.id in WITH_MEMORY for effect in acting)
    recorded, trail = drive(stages, trip, x, progress, with_trail)
    instruments = Instruments(surface or parameters.surface, engine.gas.R_a, parameters.step, acting, others, form)
    truth, shown = sense(instruments, scene, samples, recorded, trail)
    shown |= shown_late(form, truth, shown, size.V_d, size.n_cyl, step)
    truth["W_maf"] = shown["W_maf"]
    shown |= behind(sensors, shown, step)
    logged = {name: shown[name] for name in UNITS if name in shown}
    readings = record(form.rasters, sensors, logged, size.n_cyl, fine, step, parameters.sensors, seed)
    truth, shown = ({name: values[::fine] for name, values in signals.items()} for signals in (truth, shown))
    if auxiliary is not None:
        readings |= measure_road(shown, scene.logged, seed)
    time = np.arange(truth["W_c"].size) / rate
    references = {"ref_W_c": truth["W_c"], "ref_delta_W_c": truth["delta_W_c"]}
    units = UNITS | {name: AUXILIARY[name][0] for name in scene.logged}
    return SimulatedLog({"time": time, **readings, **references}, units, truth)


def _check_that_it_shows(effect: Injected, scene: DriveCourse) -> None:
    """Refuse an effect that would leave no trace: whoever looked for it later would look in vain."""
    if isinstance(effect, ChannelEffect) and effect.channel not in scene.logged:
        raise UsageError(
            f"{effect.id}: the drive does not log channel {effect.channel}; add it to [auxiliary] channels, or take another cycle"
        )
    if isinstance(effect, Timed) and (effect.onset or 0.0) >= scene.duration:
        wanted = f"a time before the end of the drive at {scene.duration:g} s"
        raise UsageError(f"{effect.id}: onset = {effect.onset:g} s, expected {wanted}")
    if not isinstance(effect, CatalogueEffect):
        return
    if effect.id == "maf.drift":
        until, gain = min(effect.end or scene.duration, scene.duration), CATALOGUE["maf.gain"]
        if not gain.low <= (factor := 1.0 + effect.value * until) <= gain.high:
            said = f"{effect.id}: rate = {effect.value:g} 1/s multiplies the reading by {factor:g} at {until:g} s"
            raise UsageError(f"{said}, expected a factor of {gain.low:g} to {gain.high:g}; take a smaller rate")
    if effect.id == "maf.temperature" and effect.acts and np.all(scene.course.T_amb == WARM):
        said = f"{effect.id}: this effect would change nothing, because T_amb stays at {WARM:g} K"
        raise UsageError(f"{said}; add an [auxiliary] table")


GIVEN = frozenset({"R_a", "R_e", "c_pa", "c_pe", "gamma_a", "gamma_e", "n_cyl", "Q_11", "Q_12", "Q_22"})
"""What is not drawn unless it is named: properties of gases and a count; the three of the efficiency cannot be."""


def drawn(
    engine: DieselEngine, tolerance: float | Mapping[str, float], seed: int
) -> tuple[DieselEngine, dict[str, float]]:
    """Return an engine with constants drawn, and the relative deviation of each by name.

    The tolerance is relative: of every constant but properties of gases, or of those named. Deviations are uniform within it.
    Every constant has a stream of its own: a draw of few constants gives each the deviation that a draw of all does. Raises
    UsageError for a name that the engine does not have, or that cannot be drawn.

    A plant for a benchmark: `simulate(drawn(config.engine, config.estimate.tolerance, 7)[0], config.simulation, "etc_part1")`.
    """
    names = own_constants(engine)
    within = tolerance if isinstance(tolerance, Mapping) else {name: tolerance for name in names if name not in GIVEN}
    for name in within:
        if name not in names or name.startswith("Q_") or name == "n_cyl":
            known = ", ".join(sorted(set(names) - GIVEN))
            raise UsageError(f"constant '{name}' cannot be varied at random; expected one or more of {known}")
    deviation = {n: size * stream_of(seed, f"constant {n}").uniform(-1.0, 1.0) for n, size in within.items()}
    return scaled(engine, deviation), deviation
