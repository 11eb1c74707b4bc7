"""`trace` and `refine` for a throttled engine: files in, the closed loop of `discovery.throttled_closing`, files out."""

import json
import shutil
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import h5py

from lpvobs.api.pooled import Traced, contents, usable
from lpvobs.discovery.throttled_closing import Closed, Nominal, close
from lpvobs.engines.throttled.lpv import Throttled
from lpvobs.errors import DataError
from lpvobs.io.configuration.config import Config, config_of
from lpvobs.io.logs.parquet import channel_units
from lpvobs.io.logs.reading import read_log
from lpvobs.io.results.hdf import changing, reading
from lpvobs.io.results.learned import read_learned
from lpvobs.io.results.portraits import write_ranking
from lpvobs.io.results.refinements import (
    StoredRefinement,
    read_refinement,
    write_comparison,
    write_refinement,
    write_structure,
)
from lpvobs.io.results.results import KIND, REMEDY, StoredResult, refuse_replaced, update
from lpvobs.io.safety.atomic import replacing
from lpvobs.records import Log

Progress = Callable[[float], None]


def trace_throttled(stored: StoredResult, logs: Sequence[Path], frozen: bool | None, progress: Progress) -> Traced:
    """Judge logs one by one, and write `/trace` into the result."""
    closed, stands, refused = _closed(stored, logs, (), frozen, progress)

    def change(file: h5py.File) -> None:
        if "trace" in file:
            del file["trace"]
        group = file.create_group("trace")
        group.attrs["json"] = _content(closed, stands, refined=False)
        write_comparison(group, closed.comparisons)
        write_structure(group, {"before": closed.before, "after": closed.after}, closed.balances)
        write_ranking(group, closed.trace.ranking)

    update(stored, change)
    return Traced(closed.trace, stands, refused)


def refine_throttled(
    stored: StoredResult,
    logs: Sequence[Path],
    hold_out: Sequence[Path],
    frozen: bool | None,
    out: Path,
    progress: Progress,
) -> Traced:
    """Add the effects that logs prove to the model; map and curves stay, they are those of the healthy engine."""
    closed, stands, refused = _closed(stored, logs, hold_out, frozen, progress)
    traced = Traced(closed.trace, stands, refused)
    if not closed.trace.findings:
        with replacing(out) as temporary:
            shutil.copyfile(stored.path, temporary)
            refuse_replaced(stored)
        return traced
    found = StoredRefinement(closed.standing, {}, {}, {}, stands, _content(closed, stands, refined=True))
    with changing(stored.path, out) as file:
        for name in ("trace", "refinement"):
            if name in file:
                del file[name]
        structure = {"before": closed.before, "after": closed.after}
        write_refinement(file, found, closed.comparisons, structure, closed.balances)
        write_ranking(file["refinement"], closed.trace.ranking)
        refuse_replaced(stored)
    return traced


def _content(closed: Closed, stands: bool, refined: bool) -> str:
    """Return the contract's object as JSON text."""
    names = [part.log for part in closed.trace.logs if part.own is not None]
    return json.dumps({"logs_used": names, "map_frozen": stands} | closed.trace.as_json(refined=refined))


def _closed(
    stored: StoredResult, paths: Sequence[Path], hold_out: Sequence[Path], frozen: bool | None, progress: Progress
) -> tuple[Closed, bool, tuple[str, ...]]:
    config = config_of(stored.provenance.config, stored.path)
    if config.air_path != Throttled.name:
        raise DataError(f"{stored.path}: its configuration is not that of a throttled engine; {REMEDY} again")
    with reading(stored.path, KIND, REMEDY) as file:
        learned, healthy = read_learned(file)
        refined = read_refinement(file)
    taught = {log.sha256: log.name for log in stored.logs}
    had = () if refined is None else refined.effects
    nominal = Nominal(config.engine, learned, healthy, config.trace, taught, had)
    read = partial(read_what_is_there, config=config)
    (used, refused), (unseen, refused_unseen) = (usable(each, read) for each in (paths, hold_out))
    closed = close(nominal, contents(used), contents(unseen), frozen, progress)
    stands = bool(frozen) or not any(log.sha256 in taught for _, log in used)
    return closed, stands, refused + refused_unseen


def read_what_is_there(path: Path, config: Config) -> Log:
    """Return a log that may lack channels; the balances without them are left out later.

    Raises
    ------
    DataError
        As `lpvobs.io.logs.reading.read_log`, and where the sensor under test is missing.
    """
    there = channel_units(path)
    known = Throttled(config.engine).channels
    kept = {name: channel for name, channel in known.items() if name in there or name == Throttled.sensor}
    return read_log(path, kept, config.policies, auxiliary=True)
