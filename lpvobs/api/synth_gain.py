"""`synth-gain`: from the configuration and logs to a proven gain."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
from msgspec import Meta

from lpvobs.api import files, known_engine
from lpvobs.api.files import File, Files
from lpvobs.api.verify import problem_of
from lpvobs.engines.base import AirPath
from lpvobs.engines.registry import ENGINES
from lpvobs.errors import NotProven, UsageError
from lpvobs.io.configuration.config import Config, load_config
from lpvobs.io.logs import finding, reading
from lpvobs.io.results import gains, provenance
from lpvobs.kinds import Finite
from lpvobs.observer import log_run, parts, smoothing
from lpvobs.records import Array
from lpvobs.report.outputs import GainOutput
from lpvobs.synthesis.problem import GainProblem
from lpvobs.synthesis.region import GainSettings, Region


class SynthGainOutput(GainOutput):
    """A gain with its certificate."""

    gain: str
    eps_1: Finite
    eps_2: Finite
    region: Annotated[
        Mapping[str, tuple[Finite, Finite]],
        Meta(description="Range of every scheduling parameter for which the gain is proven."),
    ]
    nonnegative_sums: Sequence[tuple[str, str]]
    logs: Annotated[
        Mapping[str, tuple[Sequence[Finite], Sequence[Finite]]],
        Meta(description="Smallest and largest value of every scheduling parameter in each log."),
    ]


def synth_gain(config: File, logs: Files = (), *, out: File, published: str | None = None) -> gains.StoredGain:
    """Find the observer gain from the linear matrix inequalities of Theorem 1, prove it, and write it.

    Raises NotProven if no gain can be proven; UsageError, DataError if the configuration or a log cannot be used.

    Parameters
    ----------
    logs : path or several
        Logs, patterns or folders whose range of the scheduling parameters the gain is to cover; none: `[gain.bounds]` of the
        configuration.
    published : str, optional
        The gain that is printed for the engine, proven on this column of Table 1: for the paper's, `ETC`, `FTP75` or `NEDC`.

    Returns
    -------
    StoredGain
        `gain.L` of shape (n, r), outputs with the sensor last, in the units of the states per unit of the outputs and second;
        `gain.certificate`, and `gain.region` that it holds on.

    Notes
    -----
    Eq. (27), (28) and (33). Departure from the paper: p_em is a fourth output by default, see `docs/method.md`.
    """
    paths = finding.find_logs(files.as_paths(logs))
    if published is not None and paths:
        raise UsageError(
            "--published takes no logs, because the paper's Table 1 gives the parameter ranges; drop --published or the logs"
        )
    with files.writing(out, [config, *paths]) as target:
        configuration, text = load_config(files.as_path(config))
        if published is None:
            stored, digests = make_gain(configuration, paths)
        else:
            stored, digests = make_published_gain(configuration, published), {}
        gains.write_gain(target, stored, provenance.Provenance(digests, text))
    return stored


def make_gain(
    config: Config, paths: Sequence[Path], lenient: bool = False, air_path: AirPath | None = None
) -> tuple[gains.StoredGain, dict[str, str]]:
    """Return a proven gain for the configured region, and the SHA-256 of each log that widened it.

    `air_path` is the engine with what it has learned, by default from these logs; `lenient` leaves out logs that cannot be used,
    which whoever uses the gain will meet again. Raises NotProven if no gain can be proven; DataError if a log cannot be used.
    """
    from lpvobs.synthesis.solve import synthesise

    air_path, settings = air_path or known_engine.engine_before(config, paths).air_path, config.gain
    bounds, digests = log_bounds(config, air_path, paths, lenient)
    region = wanted_region(air_path, settings, bounds)
    problem = problem_of(air_path, settings.outputs, region)
    try:
        gain = synthesise(problem, cascade=settings.cascade, decay=settings.decay)
    except NotProven as refusal:
        raise NotProven(f"{refusal}; {_what_is_feasible(problem, settings)}") from None
    made = ("synthesised", *_made_for(air_path), settings.outputs, gain, bounds, settings.temperatures)
    return gains.StoredGain(*made), digests


def _what_is_feasible(problem: GainProblem, settings: GainSettings) -> str:
    """Say how much of a region without a gain has one."""
    from lpvobs.synthesis.solve import largest_feasible

    region = problem.region
    centre = [0.5 * (low + high) for low, high in zip(region.lower, region.upper, strict=True)]
    try:
        scale, gain = largest_feasible(problem, centre, cascade=settings.cascade, decay=settings.decay)
    except (NotProven, UsageError):
        return "even the centre of this region alone has no gain"
    return f"this region has a gain if it is shrunk around its centre to {scale:.2f} of its size: {gain.region}"


def make_published_gain(config: Config, column: str | None = None) -> gains.StoredGain:
    """Return the gain printed for the engine, proven on a column of its bounds (the first by default) at fixed temperatures."""
    from lpvobs.synthesis.solve import certify_fixed_gain

    air_path, printed = config.engine_path(), config.kind.published
    if printed is None:
        able = ", ".join(f"configs/{kind.example}" for kind in ENGINES.values() if kind.published)
        raise UsageError(
            f"air_path = '{config.air_path}': the paper prints no gain for this kind of engine; make one with `lpvobs synth-gain`, "
            f"or use an engine with a printed gain: {able}"
        )
    column = next(iter(printed.bounds)) if column is None else column
    files.expect_one_of("--published", column, printed.bounds)
    rho = dict(zip(air_path.parameter_names, printed.bounds[column], strict=False))
    temperatures = {name: (T, T) for name, T in config.published.temperatures.items()}
    region = _region(air_path, rho | dict(air_path.rate_bounds(temperatures)), ())
    gain = certify_fixed_gain(problem_of(air_path, printed.outputs, region), printed.L, printed.epsilon)
    origin = f"{printed.source}, proven on Table 1, {column}"
    return gains.StoredGain(origin, *_made_for(air_path), printed.outputs, gain, {}, temperatures)


def log_bounds(
    config: Config, air_path: AirPath, paths: Sequence[Path], lenient: bool = False
) -> tuple[dict[str, Array], dict[str, str]]:
    """Return the range of the scheduling parameters along each log, shape (2, m), and the logs' SHA-256."""

    def seen_along(path: Path) -> tuple[reading.LogFile, Array]:
        log = reading.LogFile(path, air_path.channels, config.reading)
        seen = log_run.RangeSeen(len(air_path.parameter_names), None)
        # as the estimate sees it: noise widens no range
        for stretch in smoothing.stretches(log.pieces(), air_path.smoothed, config.estimate.smoothing):
            seen.see(air_path.trajectory(parts.calm_log(stretch), config.gain.outputs).parameters)
        return log, np.stack([seen.lower, seen.upper])

    found = files.usable(paths, seen_along, one=False)[0] if lenient else {path: seen_along(path) for path in paths}
    digests = {path.name: log.sha256 for path, (log, _) in found.items()}
    return {log.name: bounds for log, bounds in found.values()}, digests


def wanted_region(air_path: AirPath, settings: GainSettings, bounds: Mapping[str, Array]) -> Region:
    """Return the region to prove: configured bounds, those of the logs in their place, temperatures as configured."""
    ranges = dict(settings.bounds)
    if bounds:
        lower = np.min([low for low, _ in bounds.values()], axis=0)
        upper = np.max([high for _, high in bounds.values()], axis=0)
        slack = settings.margin * (upper - lower)
        for name, low, high, add in zip(air_path.parameter_names, lower, upper, slack, strict=True):
            ranges[name] = (min(low, max(low - add, 0.0)) if low >= 0 else low - add, high + add)
    return _region(air_path, ranges | dict(air_path.rate_bounds(settings.temperatures)), settings.nonnegative_sums)


def _region(air_path: AirPath, ranges: Mapping[str, tuple[float, float]], sums: tuple[tuple[str, str], ...]) -> Region:
    names = air_path.parameter_names
    missing = [name for name in names if name not in ranges]
    if missing:
        raise UsageError(f"[gain.bounds]: no bounds for {', '.join(missing)}; add them, or give logs to take them from")
    lower, upper = zip(*(ranges[name] for name in names), strict=True)
    return Region(names, tuple(map(float, lower)), tuple(map(float, upper)), sums)


def _made_for(air_path: AirPath) -> tuple[str, dict[str, float], tuple[str, ...]]:
    """Return kind, constants and states of the engine of a gain, as it keeps them."""
    return air_path.name, dict(air_path.engine_constants()), air_path.state_names
