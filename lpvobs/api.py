"""The verbs as functions: what the command line does, from Python, with the same files and the same errors.

Each function is the step behind a verb. Files are claimed while they are written, so that two programs do not write the same one,
and appear whole or not at all. What fails raises a class of `lpvobs.errors`: `UsageError` (the configuration or the arguments),
`DataError` (a log, gain or result), `NotProven` (a certificate or a gate), each with one line that names the remedy.

A number is the same to the last bit as that of the command line if the linear algebra runs on one thread there and here:
`OPENBLAS_NUM_THREADS=1`, set before NumPy is imported. `jobs` above 1 starts processes that import the main module: keep the
calls under `if __name__ == "__main__":` then.

The report's function is called `write_report`, because `lpvobs.report` is the room that draws it.
"""

import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from lpvobs.errors import NotProven, UsageError

if TYPE_CHECKING:
    from lpvobs.io.gains import StoredGain
    from lpvobs.io.surfaces import Surface
    from lpvobs.maps.quadratic import QuadraticFit
    from lpvobs.simulation.simulate import SimulatedLog
    from lpvobs.steps.estimate import Estimated
    from lpvobs.steps.export import Exported
    from lpvobs.steps.inspect import Inspection
    from lpvobs.steps.pooled import Traced
    from lpvobs.synthesis.certificate import Certificate

File: TypeAlias = str | os.PathLike[str]
Progress: TypeAlias = Callable[[float], None]
LONGEST_NAME = 255
"""[bytes], of a file in its folder."""


def simulate(
    config: File,
    cycle: str,
    out: File,
    *,
    effects: File | None = None,
    rate: float = 100.0,
    seed: int = 1,
    progress: Progress | None = None,
) -> "SimulatedLog":
    """Drive the simulated diesel over a cycle and write the log that its sensors record.

    Parameters
    ----------
    config : path
        TOML file with engine and `[simulation]`.
    cycle : str
        `etc` (surrogate), `etc_part1`, `ftp75`, `ftp75_cold`, `nedc`, `whtc`, `wltc`, or the path of a table.
    out : path
        The Parquet log to write.
    effects : path, optional
        TOML file of what is wrong with engine and sensors, see `configs/effects`.
    rate : float
        [Hz]
    seed : int
        Of noise and road.
    progress : callable, optional
        Takes the fraction done, 0 to 1.

    Returns
    -------
    SimulatedLog
        `channels` as written, each of shape (N,) in the unit that `units` names, and the noise-free `truth`.

    Raises
    ------
    UsageError
        For an unknown cycle, an impossible rate, or an effect that cannot show on this drive.
    DataError
        If the log cannot be written.

    Notes
    -----
    The plant is that of Wahlström and Eriksson (the paper's reference 16), Eq. (1) and (2) with six further states.
    """
    from lpvobs.steps.simulate import simulate_log

    read = [_path(config), _path(cycle), *([_path(effects)] if effects else [])]
    with _writing(_path(out), read) as target:
        return simulate_log(
            _path(config), cycle, target, _path(effects) if effects else None, rate, seed, progress or _silent
        )


def draft_profile(source: File) -> str:
    """Return the text of a profile for `ingest`, drafted from names, units and ranges of a recording.

    Parameters
    ----------
    source : path
        CSV, Parquet, MAT or MDF4.

    Returns
    -------
    str
        TOML; what is unsure is a comment in it. Read it before using it.

    Raises
    ------
    DataError
        If the recording cannot be read.
    """
    from lpvobs.io.drafting import draft_profile as draft

    return draft(_path(source))


def ingest(sources: File | Iterable[File], profile: File, out: File) -> dict[str, Any]:
    """Make a log of a foreign recording.

    Parameters
    ----------
    sources : path or several
        CSV, Parquet, MAT or MDF4 files of one drive, on one clock.
    profile : str or path
        `liu-ice`, `kit-obd`, or a TOML file.
    out : path
        The Parquet log to write.

    Returns
    -------
    dict
        What was done to every channel, each repair with its count, as the log keeps it.

    Raises
    ------
    UsageError
        If the profile cannot be used.
    DataError
        If the files cannot.
    """
    from lpvobs.steps.ingest import ingest_log

    paths = _some(sources, "recording")
    with _writing(_path(out), [*paths, _path(profile)]) as target:
        return ingest_log(paths, str(profile), target)


def inspect(log: File, config: File | None = None) -> "Inspection":
    """Return what is in a log and what the policies did about its defects.

    Parameters
    ----------
    log : path
    config : path, optional
        Engine and policies; by default the engine that the log suits.

    Returns
    -------
    Inspection
        `as_content()` is plain data: channels with units, ranges in the log's units, defects.

    Raises
    ------
    DataError
        If no estimate could use the log.
    """
    from lpvobs.io.config import load_config
    from lpvobs.io.logs import LogPolicies
    from lpvobs.steps.inspect import inspect_log

    if config is None:
        return inspect_log(_path(log), None, LogPolicies())
    configuration, _ = load_config(_path(config))
    return inspect_log(_path(log), configuration.engine_path().channels, configuration.policies)


def synth_gain(
    config: File, logs: File | Iterable[File] = (), *, out: File, published: str | None = None
) -> "StoredGain":
    """Find the observer gain from the linear matrix inequalities of Theorem 1, prove it, and write it.

    Parameters
    ----------
    config : path
    logs : path or several
        Logs, patterns or folders whose range of the scheduling parameters the gain is to cover; none: `[gain.bounds]` of the
        configuration.
    out : path
        The gain file to write.
    published : str, optional
        `ETC`, `FTP75` or `NEDC`: the paper's own L of Eq. (38), proven on that column of Table 1.

    Returns
    -------
    StoredGain
        `gain.L` of shape (3, r), r outputs with the sensor last, in the units of the states per unit of the outputs and second;
        `gain.certificate`, and `gain.region` that it holds on.

    Raises
    ------
    NotProven
        If no gain can be proven.
    UsageError, DataError
        If the configuration or a log cannot be used.

    Notes
    -----
    Eq. (27), (28) and (33). Departure from the paper: p_em is a fourth output by default, see `docs/method.md`.
    """
    from lpvobs.io.config import load_config
    from lpvobs.io.gains import write_gain
    from lpvobs.io.provenance import Provenance
    from lpvobs.steps.gain import make_gain, make_published_gain

    paths = _paths(logs)
    if published is not None and paths:
        raise UsageError("published: takes no logs, its region is a column of Table 1; drop one of them")
    with _writing(_path(out), [_path(config), *paths]) as target:
        configuration, text = load_config(_path(config))
        if published is None:
            stored, digests = make_gain(configuration, paths)
        else:
            stored, digests = make_published_gain(configuration, published), {}
        write_gain(target, stored, Provenance(digests, text))
    return stored


def verify(gain: File) -> "Certificate":
    """Prove a stored gain again in rational arithmetic, without the solver, and return the certificate.

    Raises
    ------
    NotProven
        If the stored numbers do not prove Theorem 1 on the stored region.
    DataError
        If the file cannot be used.
    """
    from lpvobs.io.gains import read_gain
    from lpvobs.steps.gain import check_again

    certificate = check_again(read_gain(_path(gain)))
    if not certificate.proven:
        raise NotProven(f"{gain}: not proven: {certificate.reason}; make the gain again with synth_gain")
    return certificate


def estimate(
    config: File,
    logs: File | Iterable[File],
    out: File,
    *,
    gain: File | None = None,
    method: str = "observer",
    jobs: int | None = None,
    scheduler: str | None = None,
    progress: Progress | None = None,
) -> "Estimated":
    """Estimate the error map of the sensor from logs and write the result.

    Parameters
    ----------
    config : path
    logs : path or several
        Parquet logs, patterns, or folders of logs.
    out : path
        The result to write.
    gain : path, optional
        Made by `synth_gain`; without it one is made and proven first.
    method : str
        `observer`; `published`: Gamma = 200 I, as in the paper; `ekf`; `batch`.
    jobs : int, optional
        Logs done at the same time, one per process.
    scheduler : str, optional
        Address of a Dask scheduler, on whose workers the logs are done.
    progress : callable, optional
        Takes the fraction done, 0 to 1.

    Returns
    -------
    Estimated
        `estimate.theta` and `estimate.standard_error` of shape (p,) [kg/s], the map's nodes in the order of Eq. (23);
        `summaries` of the logs, with metrics where a log has references; `refused`: why other logs were left out.

    Raises
    ------
    UsageError
        For an unknown method, or logs that are there twice.
    DataError
        If the gain or none of the logs can be used, or they inform no node.
    NotProven
        If the certificate of the gain does not hold.

    Notes
    -----
    Eq. (26) with gains that fall with information; see `docs/method.md` for the departures from the paper.
    """
    from lpvobs.io.config import load_config
    from lpvobs.io.finding import find_logs
    from lpvobs.steps.estimate import estimate_logs, gain_for, workplace_for

    paths = find_logs(_some(logs, "log"))
    given = None if gain is None else _path(gain)
    with _writing(_path(out), [_path(config), *paths, *([given] if given else [])]) as target:
        configuration, text = load_config(_path(config))
        workplace = workplace_for(method, len(paths), jobs, scheduler)
        stored = gain_for(configuration, paths, given, method)
        return estimate_logs(configuration, text, stored, paths, target, method, progress or _silent, workplace)


def extrapolate(result: File) -> tuple["QuadraticFit", float]:
    """Fill the nodes that no log informed from the quadratic of Eq. (37), and write `/extrapolation` into the result.

    Returns
    -------
    fitted : QuadraticFit
        Coefficients in kg/s, mg/cycle and rpm with standard errors, values and intervals of prediction for every node.
    outer_coverage : float
        Share of the outer estimated nodes inside their 90 % interval when they take no part in the fit.

    Raises
    ------
    DataError
        If the file is no result, or its nodes do not determine the quadratic.
    """
    from lpvobs.steps.extrapolate import extrapolate_result

    with _changing(_path(result)) as path:
        return extrapolate_result(path)


def trace(
    result: File, logs: File | Iterable[File], *, freeze_map: bool | None = None, progress: Progress | None = None
) -> "Traced":
    """Find what the model of a result lacks on logs, and write `/trace` into the result.

    Parameters
    ----------
    result : path
    logs : path or several
        Parquet logs, patterns, or folders of logs; pooled.
    freeze_map : bool, optional
        Whether the map stands; by default on logs that did not make it, while on those that did it is estimated jointly.
    progress : callable, optional
        Takes the fraction done, 0 to 1.

    Returns
    -------
    Traced
        `found`: its `verdict` is `none`, `effect` or `unexplained`, its `findings` have sizes and intervals in the units they name,
        onset and end [s]; `map_frozen`; `refused`: why logs were left out.

    Raises
    ------
    UsageError
        If some logs made the map, others did not, and nothing says what holds; if a log is there twice.
    DataError
        If the result cannot be used, or no log can.
    """
    from lpvobs.io.finding import find_logs
    from lpvobs.steps.trace import Sources, trace_result

    paths = find_logs(_some(logs, "log"))
    with _changing(_path(result)) as path:
        return trace_result(Sources(path, paths, (), freeze_map), progress or _silent)


def refine(
    result: File,
    logs: File | Iterable[File],
    out: File,
    *,
    hold_out: File | Iterable[File] = (),
    freeze_map: bool | None = None,
    progress: Progress | None = None,
) -> "Traced":
    """Add the effects that the logs prove to the model, estimate again, and write the refined result.

    Parameters
    ----------
    result, logs, freeze_map, progress
        As for `trace`.
    out : path
        The refined result to write; without a finding, the model of before.
    hold_out : path or several
        Logs that nothing is fitted to and no decision sees: the error is judged on them, too.

    Returns
    -------
    Traced
        As of `trace`, and with the error after.

    Raises
    ------
    UsageError, DataError
        As for `trace`.
    NotProven
        If an effect adds a state and the larger observer is not proven.
    """
    from lpvobs.io.finding import find_logs
    from lpvobs.steps.trace import Sources, refine_result

    paths, unseen = find_logs(_some(logs, "log")), find_logs(_paths(hold_out))
    with _writing(_path(out), [_path(result), *paths, *unseen]) as target:
        return refine_result(Sources(_path(result), paths, unseen, freeze_map), target, progress or _silent)


def export(
    result: File,
    out: File,
    file_format: str,
    *,
    values: str = "",
    only_estimated: bool = False,
    old: File | None = None,
    name: str = "delta_W_c",
    kind: str = "",
    digits: int = 7,
) -> "Exported":
    """Write the map for calibration tools: what to subtract from a reading.

    Parameters
    ----------
    result : path
    out : path
        The file to write.
    file_format : str
        `dcm`, `csv` or `netcdf`.
    values : str
        `map` or `extrapolation`; by default the latter if there is one.
    only_estimated : bool
        No extrapolated node: the old value there, or nothing.
    old : path, optional
        A DCM with the map as it was: its axes, units and kind stay.
    name : str
        Label of the map.
    kind : str
        `KENNFELD` or `GRUPPENKENNFELD`; by default the old map's, else the former.
    digits : int
        Significant digits in DCM and CSV.

    Returns
    -------
    Exported
        `surface` with values of shape (p2, p1) in the unit it names, `changes` against the old map.

    Raises
    ------
    UsageError
        If the request contradicts itself.
    DataError
        If the result or the old file cannot be used, or a DCM would have empty nodes.
    """
    from lpvobs.steps.export import Request, export_result

    before = None if old is None else _path(old)
    request = Request(file_format, values, only_estimated, before, name, kind.upper(), digits)
    with _writing(_path(out), [_path(result), *([before] if before else [])]) as target:
        return export_result(_path(result), target, request)


def write_report(
    result: File, further: File | Iterable[File] = (), *, html: File | None = None, gates: Sequence[str] = ()
) -> dict[str, Any]:
    """Return how far the corrected sensor is from the truth, write the page if asked for, and judge the gates.

    Parameters
    ----------
    result : path
    further : path or several
        Logs that the results were made from (time series), and further results.
    html : path, optional
        The self-contained page to write.
    gates : sequence of str
        Such as `mean_relative_error<=0.02`; fractions are fractions.

    Returns
    -------
    dict
        The object that `lpvobs report --json` prints, without its schema: flows in kg/s.

    Raises
    ------
    NotProven
        If a log fails a gate; the page is written all the same.
    DataError
        If a file cannot be used, or a log lacks the metric of a gate.
    UsageError
        If a gate cannot be understood.
    """
    from lpvobs.report.content import gather
    from lpvobs.report.discovered import contents
    from lpvobs.report.gates import enforce, judge, parse_gate
    from lpvobs.report.load import load
    from lpvobs.report.names import distinct
    from lpvobs.report.page import write_page
    from lpvobs.report.tables import report_content

    conditions = [parse_gate(expression) for expression in gates]
    paths = [_path(result), *_paths(further)]
    loaded = load(paths)
    names = distinct([item.path for item in loaded.results])
    content = report_content(list(zip(names, loaded.results, strict=True)))
    for item, found in zip(content["results"], loaded.discovered, strict=True):
        item.update(contents(found))
    if html is not None:
        with _writing(_path(html), paths) as target:
            write_page(target, gather(loaded))
    enforce(judge(conditions, content["logs"]))
    return content


def read_map(result: File, values: str = "") -> "Surface":
    """Return the map of a result as arrays.

    Parameters
    ----------
    result : path
    values : str
        `map`: what was estimated, NaN elsewhere; `extrapolation`: every node; by default the latter if there is one.

    Returns
    -------
    Surface
        `values` and `standard_error` of shape (p2, p1) [kg/s], reading minus truth; `origin` 0 none, 1 estimated,
        2 extrapolated; `x.nodes` of shape (p2,) [rpm], `y.nodes` of shape (p1,) [mg/cycle].

    Raises
    ------
    DataError
        If the file is no result, or lacks what is asked for.
    """
    from lpvobs.io.surfaces import read_surface

    return read_surface(_path(result), values)


def _paths(files: File | Iterable[File]) -> list[Path]:
    """Return one or several files as a list."""
    return [_path(files)] if isinstance(files, (str, os.PathLike)) else [_path(file) for file in files]


def _some(files: File | Iterable[File], kind: str) -> list[Path]:
    """Return files of which at least one is needed."""
    paths = _paths(files)
    if not paths:
        raise UsageError(f"no {kind}; name at least one")
    return paths


def _path(file: File) -> Path:
    """Return a name as a path; raises UsageError if no file can have it."""
    path = Path(file)
    if "\0" in str(path) or any(len(os.fsencode(part)) > LONGEST_NAME for part in path.parts):
        raise UsageError(
            f"{str(path)!r}: no file can have this name; expected at most {LONGEST_NAME} bytes, none of them 0"
        )
    return path


@contextmanager
def _writing(out: Path, read: Iterable[Path]) -> Iterator[Path]:
    """Yield the file to write, which nobody else writes meanwhile; raise UsageError if it is one of those that are read."""
    from lpvobs.io.atomic import is_same

    for path in read:
        if is_same(out, path):
            raise UsageError(f"{out}: is also an input and would be lost; name another file to write")
    with _claimed(out):
        yield out


@contextmanager
def _changing(result: Path) -> Iterator[Path]:
    """Yield a result that nobody else writes meanwhile; what is no file is refused by whoever reads it."""
    if not result.is_file():
        yield result
        return
    with _claimed(result):
        yield result


@contextmanager
def _claimed(path: Path) -> Iterator[None]:
    from lpvobs.io.atomic import claim, release

    claim(path)
    try:
        yield
    finally:
        release(path)


def _silent(fraction: float) -> None:
    """Show no progress."""
