"""What a report is made of: results, and the logs that belong to them."""

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec

from lpvobs.engines.base import AirPath
from lpvobs.engines.registry import ENGINES
from lpvobs.errors import DataError
from lpvobs.io.logs.policies import LogPolicies
from lpvobs.io.logs.reading import References, read_log, read_references
from lpvobs.io.logs.remote import log_digest
from lpvobs.io.results.hdf import is_hdf5
from lpvobs.io.results.results import REMEDY, StoredResult, read_result
from lpvobs.records import Log
from lpvobs.report.discovered import Discovered, read_discovered

LoadedLog = tuple[Log, References | None]
"""A log that at least one of the results was made from; no references where it was recorded without truth."""


@dataclass(frozen=True)
class Loaded:
    """Results in the order given, each with what was found on it, and the logs in the order given."""

    results: tuple[StoredResult, ...]
    discovered: tuple[tuple[Discovered, ...], ...]
    logs: tuple[LoadedLog, ...]
    paths: Mapping[str, Path]  # of the logs, by the digest of each


def load(paths: Sequence[Path]) -> Loaded:
    """Return the results and logs in files, told apart by content; the first is a result.

    Raises DataError if a file cannot be used, or a log belongs to none of the results.
    """
    first, *further = paths
    for path in further:
        if not path.is_file():
            raise DataError(f"{path}: no such file; name results, or logs that they were made from")
    inner = [path for path in further if is_hdf5(path)]
    results = tuple(read_result(path) for path in (first, *inner))
    for result in results:
        air_path_of(result)
    logs = {digest: path for path in further if path not in inner for digest in [log_digest(path)]}
    return Loaded(
        results=results,
        discovered=tuple(read_discovered(result.path) for result in results),
        logs=tuple(_load_log(path, digest, results) for digest, path in logs.items()),
        paths=logs,
    )


def air_path_of(result: StoredResult) -> type[AirPath]:
    """Return the class of the result's engine, for what holds for all engines of its kind: channels, axes, the sensor.

    Raises DataError if the result is for an engine that this version does not know.
    """
    if result.air_path not in ENGINES:
        raise DataError(
            f"{result.path}: result for air path '{result.air_path}', expected one of {', '.join(ENGINES)}; "
            f"read it with the version of lpvobs that wrote it"
        )
    return ENGINES[result.air_path].air_path


def _load_log(path: Path, digest: str, results: Sequence[StoredResult]) -> LoadedLog:
    owner = next((result for result in results if any(log.sha256 == digest for log in result.logs)), None)
    if owner is None:
        raise DataError(
            f"{path}: no result here was made from this log (SHA-256 {digest[:12]}...); "
            f"expected one of the very files that `lpvobs estimate` read; leave it out, or estimate from it first"
        )
    log = read_log(path, air_path_of(owner).channels, _policies(owner))
    return log, read_references(path, log.rows)


def _policies(result: StoredResult) -> LogPolicies:
    """Return the policies that the log was read with when the result was made."""
    try:
        return msgspec.convert(tomllib.loads(result.provenance.config).get("policies", {}), LogPolicies)
    except (ValueError, AttributeError, RecursionError, msgspec.MsgspecError) as error:
        raise DataError(f"{result.path}: damaged configuration in it ({error}); {REMEDY}") from None
