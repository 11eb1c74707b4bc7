"""The refined map: estimated by the observer from the logs, with the effects in the model."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from lpvobs.api.estimate import metrics_of
from lpvobs.api.fleet import refuse_empty
from lpvobs.discovery.observed import Refined, observed, observed_path
from lpvobs.discovery.standing import Standing
from lpvobs.engines.diesel.effects import diesel_plant
from lpvobs.errors import DataError
from lpvobs.io.configuration.config import Config
from lpvobs.io.results.gains import StoredGain
from lpvobs.io.results.log_summaries import LogSummary, summary_of
from lpvobs.observer.estimate import MapEstimate, estimate_default
from lpvobs.observer.parts import StateGain
from lpvobs.records import Log
from lpvobs.synthesis.problem import GainProblem
from lpvobs.synthesis.sensor_state import SensorState, with_sensor_state

Record = TypeVar("Record")


@dataclass(frozen=True)
class RefinedEstimate:
    """A map that the observer found with the effects accounted for.

    Attributes
    ----------
    estimate : MapEstimate
    summaries : tuple of LogSummary
    sensor_state : SensorState or None
        Gain and proof of the larger observer where an effect adds a state.
    """

    estimate: MapEstimate
    summaries: tuple[LogSummary, ...]
    sensor_state: SensorState | None


def estimate_refined(
    config: Config,
    gain: StoredGain,
    effects: tuple[Standing, ...],
    constants: Mapping[str, float],
    logs: Sequence[tuple[Path, Log]],
) -> RefinedEstimate:
    """Return the map from logs, by the default method.

    Parameters
    ----------
    config : Config
    gain : StoredGain
        Of the result that is refined.
    effects : tuple of Standing
    constants : mapping of str to float
        Relative deviation of constants of the engine from the configured ones.
    logs : sequence of (Path, Log)
        With their auxiliary channels.

    Raises
    ------
    NotProven
        If an effect adds a state and the larger observer cannot be proven.
    """
    refined = refined_model(config, gain, effects, constants)
    air_path, grid = refined.air_path, config.grid()
    settings = config.estimate.limited_to(air_path.balance_constants)
    seen = [observed(refined, log) for _, log in logs]
    state_gain = StateGain(gain.outputs, gain.gain.L, gain.gain.region)
    estimate = estimate_default(observed_path(refined), grid, state_gain, seen, settings)
    refuse_empty(estimate)
    summaries = tuple(
        summary_of(run, metrics_of(air_path, estimate, file, log))
        for (file, log), run in zip(logs, estimate.runs, strict=True)
    )
    return RefinedEstimate(estimate, summaries, sensor_state(refined, gain))


def expect_cascade(path: Path, gain: StoredGain) -> None:
    """Raise DataError for a result whose gain lets the sensor correct the state: its map cannot be estimated beside effects."""
    if gain.gain.L[:, -1].any():
        raise DataError(
            f"{path}: made with the gain '{gain.origin}', in which the sensor corrects the state, expected a cascade to estimate "
            f"map and effects together; estimate with the default method first, or say --freeze-map"
        )


def refined_model(
    config: Config, gain: StoredGain, effects: tuple[Standing, ...], constants: Mapping[str, float]
) -> Refined:
    """Return the model as the observer has it: the engine with its constants where the joint fit has them, and the effects.

    `estimate` takes the constants as configured, and carries their tolerance into the standard errors. Beside effects they
    move: a size and a constant are estimated together, and mean little apart. On simulated drives with every constant off by up
    to 1 % the map of a refined model missed by 0.7 to 2.1 %, and by 1.3 to 6.8 % with the constants as configured; where they are
    exact, moving them costs up to 1 % at 100 Hz and 2 % at 20 Hz.
    """
    engine = scaled(config.engine, constants)
    air_path = replace(config, engine=engine).engine_path()
    return Refined(diesel_plant(engine), air_path, gain.outputs, gain.gain.L, config.estimate.smoothing, effects)


def sensor_state(refined: Refined, gain: StoredGain) -> SensorState | None:
    """Return gain and proof of the observer with the sensor's state, None where no effect adds one."""
    if not refined.lags:
        return None
    system = partial(refined.air_path.system, outputs=gain.outputs)
    problem = GainProblem(system, gain.gain.region, len(gain.outputs))
    ends = [edge for effect in refined.lags for edge in (*effect.ci90, effect.value)]
    shortest = min(edge for edge in ends if edge > 0.0)
    return with_sensor_state(problem, gain.gain, (shortest, max(ends)), refined.correction())


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
