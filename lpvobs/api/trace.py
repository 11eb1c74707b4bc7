"""`trace`: what the model of a result lacks, by the closed loop that `refine` shares: from result and logs to effects."""

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from msgspec import UNSET

from lpvobs.api.files import File, Files, Progress, refuse_copies, shown, some_logs, updating, usable
from lpvobs.api.known_engine import KnownEngine, known_engine
from lpvobs.api.search_start import HEALTHY, Start, beside_healthy, known_from, nothing_known, search_start
from lpvobs.discovery.forms import PREFIX
from lpvobs.discovery.healthy_drive import HealthyDrive
from lpvobs.discovery.known_effects import KnownEffect, Span
from lpvobs.discovery.outcome import Outcome, Trace
from lpvobs.discovery.portrait import portrait
from lpvobs.discovery.refine import Refinement, refine
from lpvobs.discovery.thresholds import SLOWEST
from lpvobs.discovery.whiteness import structure
from lpvobs.errors import DataError, UsageError
from lpvobs.io.results import gains, hdf, mapping, refinements, results
from lpvobs.kinds import Refused
from lpvobs.records import Log


class TraceOutput(Outcome):
    """What the model lacks."""

    map_frozen: bool
    refused: Refused


@dataclass(frozen=True)
class Traced:
    """What came of `trace` or `refine`."""

    found: Trace
    map_frozen: bool  # whether the map stood; otherwise it was estimated together with the effects
    refused: tuple[str, ...]  # why logs were left out, one line each

    def as_json(self, refined: bool) -> dict[str, Any]:
        """Return the fields of `TraceOutput` as plain data; what follows from the error after only where refined."""
        return self.found.as_json(refined) | {"map_frozen": self.map_frozen, "refused": self.refused}


def trace(
    result: File,
    logs: Files,
    *,
    freeze_map: bool | None = None,
    engine: File | None = None,
    progress: Progress | None = None,
) -> Traced:
    """Find what the model of a result lacks on logs, and write `/trace` into the result.

    Raises UsageError if some logs made the map, others did not, and nothing says what holds; if a log is there twice; DataError
    if the result cannot be used, or no log can.

    Parameters
    ----------
    logs : path or several
        Parquet logs, patterns, or folders of logs; pooled.
    freeze_map : bool, optional
        Whether the map stands; by default on logs that did not make it, while on those that did it is estimated jointly.
    engine : path, optional
        Made by `calibrate`; by default the engine that the result was made with.

    Returns
    -------
    Traced
        `found`: its `verdict` is `none`, `effect` or `unexplained`, its `findings` have sizes and intervals in the units they name,
        onset and end [s]; `map_frozen`; `refused`: why logs were left out.
    """
    paths = some_logs(logs)
    with updating(result) as path:
        closed = close(path, paths, (), freeze_map, shown(progress), calibrated=engine)
        results.update(closed.stored, closed.write_trace)
    return closed.traced


POOLED, POOLED_UNSEEN = "(all logs)", "(all logs held out)"


@dataclass(frozen=True)
class Closed:
    """The closed loop on logs: the stored model, what came of it, and what the verb tells."""

    stored: results.StoredResult
    engine: KnownEngine
    start: Start
    used: Mapping[Path, Log]  # what was learned from
    refinement: Refinement
    traced: Traced

    @property
    def constants(self) -> dict[str, float]:
        """Relative deviation of each constant of the refined model from the configured one."""
        return self.start.total(self.refinement.beta)

    def content(self, refined: bool) -> str:
        """Return the fields of `StoredOutcome` as JSON text."""
        further = {"logs_used": [log.name for log in self.used.values()], "map_frozen": self.traced.map_frozen}
        return json.dumps(self.traced.found.as_json(refined) | further)

    def write_trace(self, file: h5py.File) -> None:
        """Write `/trace` in place of the one that is there."""
        file.pop("trace", None)
        group = file.create_group("trace")
        group.attrs["json"] = self.content(refined=False)
        self._write_evidence(group)

    def write(self, file: h5py.File, effects: Sequence[KnownEffect]) -> None:
        """Write `/refinement` with the effects as the map is estimated beside them."""
        stored = refinements.StoredRefinement(
            effects=tuple(self._with_earlier(effect) for effect in effects),
            constants=self.constants,
            deviations=self.refinement.beta_deviation,
            map_stood=self.traced.map_frozen,
            json=self.content(refined=True),
        )
        self._write_evidence(refinements.write_refinement(file, stored))

    def _write_evidence(self, group: h5py.Group) -> None:
        """Write the error before and after by log and pooled, the structure of the residual, and the data of pictures."""
        found, trace = self.refinement, self.traced.found
        errors = {POOLED: (trace.error.comparison, False)}
        if trace.error_on_held_out_logs:
            errors[POOLED_UNSEEN] = (trace.error_on_held_out_logs.comparison, True)
        errors |= {part.log: (part.error.comparison, part.residual is UNSET) for part in trace.logs}
        refinements.write_comparison(group, errors)
        whiteness = {"before": structure(found.before), "after": structure(found.after)}
        refinements.write_structure(group, whiteness, found.before.problem.model.balances)
        refinements.write_portrait(group, portrait(found, [*self.used.values()]))
        if trace.ranking:
            hdf.write_group(group, "ranking", mapping.rows(trace.ranking, "candidate"))
        if trace.left is not None:
            mapping.write(group, "leftover", trace.left)

    def _with_earlier(self, effect: KnownEffect) -> KnownEffect:
        """Return an effect that says it is absent from earlier logs: those of a map that stood, and of earlier refinements."""
        earlier = {log.sha256: log.name for log in self.stored.logs} if self.traced.map_frozen else {}
        earlier |= {span.sha256: span.log for other in self.refinement.known_effects for span in other.spans}
        told = {span.sha256 for span in effect.spans}
        without = [Span(name, digest, np.inf, np.inf) for digest, name in earlier.items() if digest not in told]
        return replace(effect, spans=effect.spans + tuple(without))


def close(
    path: Path,
    learn: Sequence[Path],
    judge: Sequence[Path],
    freeze_map: bool | None,
    progress: Progress,
    anew: bool = False,
    calibrated: File | None = None,
) -> Closed:
    """Return what logs hold that the model of a result lacks.

    The error alone is judged on the logs of `judge`; a log that cannot be used is left out and named. `anew` is whether a map
    would be made that replaces the stored one; `calibrated` is the `engine` of `trace`, which raises the same.
    """
    refuse_copies([*learn, *judge])
    stored = results.read_result(path)
    engine = known_engine(stored, calibrated)
    refined = results.read_beside(path, "refinement", refinements.StoredRefinement)
    (used, refused), (unseen, refused_unseen) = (usable(paths, engine.read) for paths in (learn, judge))
    logs, hold_out = [*used.values()], [*unseen.values()]
    names = Counter(log.name for log in (*logs, *hold_out))
    if again := next((name for name, count in names.items() if count > 1), None):
        raise UsageError(f"log {again}: two logs have this name, but results tell logs apart by name; rename one file")
    frozen = _stands(stored, logs, anew) if freeze_map is None else freeze_map
    if anew and not frozen:
        expect_cascade(path, stored.gain)
    model = engine.residual_model(() if frozen else [log.sha256 for log in stored.logs])
    grid, prior_map = engine.config.grid(), engine.config.estimate.prior_map
    if frozen:
        if not {*engine.inputs.values()} <= {*stored.provenance.inputs_sha256.values()}:
            raise UsageError(
                f"{path}: this map was not estimated with {calibrated}; a stored map can only be kept with its own engine; "
                f"drop --engine, estimate the map with this engine, or give --free-map"
            )
        before = known_from(stored, model, prior_map, engine.calibrated)
    else:
        before = nothing_known(model, grid, prior_map, engine.calibrated)
    healthy = results.read_beside(path, HEALTHY, HealthyDrive) if frozen else None
    # what healthy drives leave was learned at the constants that they show
    start = search_start(model, before, refined, logs) if healthy is None else beside_healthy(before, healthy)
    known = () if refined is None else refined.effects
    found = refine(start.model, grid, start.prior, logs, progress, known, hold_out, healthy)
    if found.trace.verdict == "unexplained" or any(effect.id.startswith(PREFIX) for effect in found.trace.findings):
        _refuse_slow(logs)
    return Closed(stored, engine, start, used, found, Traced(found.trace, frozen, refused + refused_unseen))


def expect_cascade(path: Path, gain: gains.StoredGain) -> None:
    """Raise DataError for a result whose gain lets the sensor correct the state: its map cannot be estimated beside effects."""
    if gain.gain.L[:, -1].any():
        raise DataError(
            f"{path}: this map was made with the gain '{gain.origin}', whose last column is not zero; such a gain cannot estimate "
            f"map and effects together; estimate the map with the default method first, or give --freeze-map"
        )


def _refuse_slow(logs: Sequence[Log]) -> None:
    """Raise where a residual without a name, or with a formula, may be what slow sampling leaves of fast transients."""
    for log in logs:
        step = float(np.median(np.diff(log.time)))
        if step > SLOWEST:
            raise DataError(
                f"log {log.name}: with one sample every {step:.3g} s, unknown causes cannot be told from fast transients; "
                f"record at least 20 samples a second"
            )


def _stands(stored: results.StoredResult, logs: Sequence[Log], anew: bool) -> bool:
    """Return whether the map stands on these logs; `anew` where a map would be made that replaces the stored one."""
    made = [any(log.sha256 == own.sha256 for own in stored.logs) for log in logs]
    if all(made):
        if anew and len(logs) < len(stored.logs):
            names = ", ".join(log.name for log in stored.logs)
            raise UsageError(
                f"{stored.path}: this map was estimated from the logs {names}, but some of them are not named; name all of them, "
                "or give --free-map to estimate a map from the named logs alone"
            )
        return False
    if any(made):
        names = ", ".join(log.name for log, own in zip(logs, made, strict=True) if own)
        raise UsageError(
            f"{stored.path}: this map was estimated from {names}, but not from the other named logs; give --freeze-map to "
            "keep the map, or --free-map to estimate it again"
        )
    return True
