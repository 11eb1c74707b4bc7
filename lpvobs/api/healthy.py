"""What the drives that made a map show of the engine beside it: learned when the map is estimated, used when another is traced."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path

from lpvobs.api.known_engine import known_engine
from lpvobs.api.search_start import known_from
from lpvobs.discovery.healthy_sizes import learned
from lpvobs.discovery.thresholds import HEALTHY_LEAST, HEALTHY_SECONDS, MOST_ROWS
from lpvobs.errors import DataError
from lpvobs.io.logs.parquet import metadata_of
from lpvobs.io.logs.reading import read_log
from lpvobs.io.results.mapping import write
from lpvobs.io.results.results import read_result, update
from lpvobs.records import Log

GROUP = "healthy"


def learn_healthy(out: Path, names: Mapping[Path, str], outliers: Sequence[str]) -> None:
    """Write `/healthy` into a new result: what its own logs leave, without those that stand out.

    A result stays as it is where nothing can be learned: by an engine that knows its healthy errors already, from logs of less
    than `HEALTHY_LEAST`, or beside a map whose method does not tell of the engine.
    """
    stored = read_result(out)
    engine = known_engine(stored)
    if engine.healthy is not None:
        return
    with suppress(DataError):
        model = engine.residual_model()
        known = known_from(stored, model, engine.config.estimate.prior_map, engine.calibrated)
        logs: list[Log] = []
        digest = {log.name: log.sha256 for log in stored.logs}
        for path in sorted(names, key=lambda path: digest.get(names[path], "")):  # the same bytes in any order
            if names[path] in outliers or metadata_of(path).num_rows > MOST_ROWS:
                continue
            if sum(log.time[-1] - log.time[0] for log in logs) > HEALTHY_SECONDS:
                break
            with suppress(DataError):
                logs.append(read_log(path, engine.air_path.channels, engine.config.reading))
        if model.blocks or sum(log.time[-1] - log.time[0] for log in logs) < HEALTHY_LEAST:
            return
        there = model.restarted(known.constants, known.covariance)
        found = learned(there, engine.config.grid(), known.prior, logs)
        update(stored, lambda file: write(file, GROUP, found) and None)
