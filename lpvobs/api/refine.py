"""`refine`: the model of a result with the effects that the logs prove."""

import shutil
from dataclasses import dataclass
from pathlib import Path

import h5py

from lpvobs.api.closed_loop import Closed, Traced, close
from lpvobs.api.files import File, Files, Progress, as_path, as_paths, shown, some_logs, within, writing
from lpvobs.api.refined_map import estimate_refined, refined_model, sensor_state
from lpvobs.api.trace import TraceOutput
from lpvobs.discovery.known_effects import from_off
from lpvobs.io.logs.finding import find_logs
from lpvobs.io.results.hdf import changing
from lpvobs.io.results.provenance import Provenance
from lpvobs.io.results.refinements import write_sensor_state
from lpvobs.io.results.results import refuse_replaced, write_result
from lpvobs.io.safety.atomic import replacing


@dataclass(frozen=True, kw_only=True)
class RefineOutput(TraceOutput):
    """What was added to the model, error before and after."""


def refine(
    result: File,
    logs: Files,
    out: File,
    *,
    hold_out: Files = (),
    freeze_map: bool | None = None,
    engine: File | None = None,
    progress: Progress | None = None,
) -> Traced:
    """Add the effects that the logs prove to the model, estimate again, and write the refined result.

    Without a finding the model of before is written, byte for byte. Effects that the model had already are estimated again with
    those that are added. A map that stands is kept as it is; otherwise the observer estimates it anew, with the effects in it.

    Raises UsageError, DataError as for `trace`; NotProven if an effect adds a state and the larger observer is not proven.

    Parameters
    ----------
    result, logs, freeze_map, engine, progress
        As for `trace`.
    out : path
        The refined result to write; without a finding, the model of before.
    hold_out : path or several
        Logs that nothing is fitted to and no decision sees: the error is judged on them, too.

    Returns
    -------
    Traced
        As of `trace`, and with the error after.
    """
    paths, unseen = some_logs(logs), find_logs(as_paths(hold_out))
    calibrated = None if engine is None else as_path(engine)
    with writing(out, [result, *paths, *unseen, calibrated]) as target:
        told = shown(progress)
        searched = within(told, 0.0, 0.95)
        closed = close(as_path(result), paths, unseen, freeze_map, searched, anew=True, calibrated=calibrated)
        if not closed.refinement.trace.findings:
            with replacing(target) as temporary:
                shutil.copyfile(closed.stored.path, temporary)
                refuse_replaced(closed.stored)
        elif closed.frozen:
            _write_beside(target, closed)
        else:
            _write_anew(target, closed)
        told(1.0)
    return closed.traced


def _write_beside(out: Path, closed: Closed) -> None:
    """Write the effects beside a map that stands; the observer with a further state is proven here, too."""
    stored, found = closed.stored, closed.refinement
    proven = sensor_state(refined_model(closed.engine, stored.gain, found.known_effects, closed.constants), stored.gain)
    with changing(stored.path, out) as file:
        for group in ("trace", "refinement"):
            if group in file:
                del file[group]
        closed.write(file, found.known_effects)
        if proven is not None:
            write_sensor_state(file["refinement"], proven, stored.gain)
        refuse_replaced(stored)


def _write_anew(out: Path, closed: Closed) -> None:
    """Write the map that the observer finds with the effects in the model, and the effects."""
    stored, air_path = closed.stored, closed.engine.air_path
    effects = tuple(from_off(effect) for effect in closed.refinement.known_effects)
    seen = estimate_refined(closed.engine, stored.gain, effects, closed.constants, closed.used)
    provenance = Provenance({path.name: log.sha256 for path, log in closed.used}, stored.provenance.config)

    def further(file: h5py.File) -> None:
        closed.write(file, effects)
        closed.engine.write(file)
        if seen.sensor_state is not None:
            write_sensor_state(file["refinement"], seen.sensor_state, stored.gain)

    write_result(out, air_path, seen.estimate, seen.summaries, stored.gain, provenance, further)
