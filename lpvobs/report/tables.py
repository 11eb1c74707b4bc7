"""Results as plain rows of text and as plain content for JSON; no drawing, no HTML."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from lpvobs.engines.registry import ENGINES
from lpvobs.io.calibration.files import Change
from lpvobs.io.results.gains import StoredGain
from lpvobs.io.results.results import LogSummary, StoredResult
from lpvobs.io.results.surfaces import ORIGINS, Surface
from lpvobs.maps.quadratic import COEFFICIENTS
from lpvobs.observer.disagreement import Agreement
from lpvobs.report.fit import ResidualFit
from lpvobs.report.outputs import RegionMean
from lpvobs.report.spoken import cycle_title, paper_error

Table = tuple[list[str], list[list[str]]]
NONE = "-"
MUCH = 0.1  # share of its rows that are dropped, from which a log is unusual
_range = "{:.4g} .. {:.4g}".format
METRIC_COLUMNS = ("floor", "rms ratio", "rmse g/s", "bias g/s", "cells", "stability certified")


def percent(value: float | None, digits: int = 2) -> str:
    """Return a fraction as per cent; a dash where there is none."""
    return NONE if value is None or not np.isfinite(value) else f"{100 * value:z.{digits}f} %"


def grams(value: float | None) -> str:
    """Return kg/s as g/s; a dash where there is none."""
    return NONE if value is None or not np.isfinite(value) else f"{1e3 * value:z.3f}"


def region_line(mean: RegionMean) -> str:
    """Return a mean over a region as a sentence."""
    low, high = map(grams, mean.ci90)
    return f"{mean.result}: mean error over {mean.region}: {grams(mean.value)} g/s (90 %: {low} to {high})"


def log_rows(logs: Sequence[LogSummary]) -> Table:
    """Return one row per log: samples, metrics and the share that the certificate covers."""
    return ["log", "samples", "dropped", "gaps", "mean rel. error", *METRIC_COLUMNS], [
        [cycle_title(log.name), str(log.samples), str(log.dropped_rows), str(log.gaps), *_metric_cells(log)]
        for log in logs
    ]


def _metric_cells(log: LogSummary) -> list[str]:
    """Return the mean relative error of a log and what METRIC_COLUMNS name."""
    certified, known = percent(log.share_certified, 1), log.metrics
    if known is None:
        return [NONE] * 6 + [certified]
    shares = map(percent, (known.mean_relative_error, known.floor_mean_relative_error, known.rms_ratio))
    return [*shares, grams(known.rmse), grams(known.bias), str(known.visited_cells), certified]


def told(table: Table) -> Table:
    """Return a table without the columns in which no row says anything."""
    header, rows = table
    kept = [c for c in range(len(header)) if not rows or any(row[c] != NONE for row in rows)]
    return [header[c] for c in kept], [[row[c] for c in kept] for row in rows]


def unusual(logs: Sequence[LogSummary], agreement: Sequence[Agreement]) -> list[LogSummary]:
    """Return the logs that disagree with the map of all, or of which much was dropped."""
    apart = {item.name for item in agreement if item.disagrees}
    return [log for log in logs if log.name in apart or log.dropped_rows > MUCH * log.samples_read]


def many_lines(logs: Sequence[LogSummary], agreement: Sequence[Agreement], refused: int, reused: int) -> str:
    """Return in a few lines what came of many logs."""
    hours, apart = sum(log.duration for log in logs) / 3600.0, sum(item.disagrees for item in agreement)
    longest = max(logs, key=lambda log: log.duration)
    return (
        f"{len(logs) + refused} logs, {len(logs)} used, {refused} left out; {reused} finished in an earlier run\n"
        f"{sum(log.samples for log in logs)} samples, {hours:.1f} h; the longest is {longest.name}, {longest.duration:.0f} s\n"
        f"{len(agreement) - apart} logs agree with the map of all logs, {apart} do not"
    )


def agreement_rows(logs: Sequence[Agreement]) -> Table:
    """Return one row per log: how far its own map is from that of all logs."""
    header = ["log", "nodes compared", "chi-square per node", "stands out by", "mean difference g/s", "disagrees"]
    rows = []
    for log in logs:
        cells = [NONE] * 3
        if log.nodes:
            difference = f"{1e3 * log.mean_difference:+.3f}"
            cells = [f"{log.chi_square / log.nodes:.2f}", f"{log.deviation:+.1f} sd", difference]
        rows.append([cycle_title(log.name), str(log.nodes), *cells, "yes" if log.disagrees else "no"])
    return header, rows


def fit_rows(fits: Sequence[ResidualFit]) -> Table:
    """Return how well each balance follows its log, and what its residual still goes with."""
    header = ["result", "log", "balance", "fit", "residual g/s rms"]
    header += ["lags outside 99 % band", "input lags outside 99 % band"]
    rows = []
    for item in fits:
        inputs = [f"{name} {percent(share, 0)}" for name, share in list(item.outside.items())[:3] if share > 0.02]
        cells = percent(item.fit, 1), grams(item.rms), percent(item.lags_outside, 0), ", ".join(inputs) or "none"
        rows.append([item.result, cycle_title(item.log), item.balance, *cells])
    return header, rows


def beside_paper(results: Sequence[tuple[str, StoredResult]]) -> bool:
    """Return whether a log is of a cycle that the paper prints an error for, and knows its own."""
    return any(
        log.metrics is not None and paper_error(item.air_path, log.name) is not None
        for _, item in results
        for log in item.logs
    )


def coefficient_tables(results: Sequence[tuple[str, StoredResult]], paper: bool = False) -> list[Table]:
    """Return the six coefficients of Eq. (37) with standard errors, beside printed ones if asked for: a table for each engine."""
    filled = [(name, item.air_path, item.extrapolation) for name, item in results if item.extrapolation is not None]
    tables = []
    for air_path in dict.fromkeys(kind for _, kind, _ in filled):
        kind = ENGINES[air_path]
        rows = []
        for name, own, fitted in filled:
            if own == air_path:
                rows.append([name, *(f"{value:.4g}" for value in fitted.coefficients)])
                rows.append(["  standard error", *(f"{value:.2g}" for value in fitted.standard_error)])
        printed = kind.published.surfaces if paper and kind.published is not None else {}
        rows += [[f"paper, {name}", *(f"{value:.4g}" for value in values)] for name, values in printed.items()]
        axes = ", ".join(f"{axis.channel} [{axis.unit}]" for axis in kind.air_path.axes)
        tables.append(([f"kg/s over {axes}", *COEFFICIENTS], rows))
    return tables


def bounds_table(gain: StoredGain, logs: Sequence[LogSummary] = (), paper: bool = True) -> Table:
    """Return Table 1: the paper's bounds of rho if asked for, those of the logs, and the region that the certificate covers."""
    # `logs` are those of a result; the logs that the gain's region was drawn from come first.
    kind, region, names = ENGINES.get(gain.air_path), gain.gain.region, gain.gain.region.names
    printed = kind.published.bounds if paper and kind and kind.published else {}
    rows = [
        [f"paper, {column}", *(_range(low, high) for low, high in bounds), *[NONE] * (len(names) - len(bounds))]
        for column, bounds in printed.items()
    ]
    ranges = dict(gain.log_bounds)
    ranges |= {log.name: np.stack([log.lower, log.upper]) for log in logs if log.lower.size == len(names)}
    rows += [[cycle_title(log), *map(_range, lower, upper)] for log, (lower, upper) in ranges.items()]
    rows.append(["proven", *map(_range, region.lower, region.upper)])
    return ["", *names], rows


def report_rows(results: Sequence[tuple[str, StoredResult]]) -> Table:
    """Return one row per result and log: the metrics, with the paper's mean relative error beside those of its cycles."""
    rows = []
    for name, result in results:
        for log in result.logs:
            error, *others = _metric_cells(log)
            printed = percent(paper_error(result.air_path, log.name))
            rows.append([name, result.method, cycle_title(log.name), str(log.samples), error, printed, *others])
    return ["result", "method", "log", "samples", "mean rel. error", "paper", *METRIC_COLUMNS], rows


def gain_line(gain: StoredGain) -> str:
    """Return in one sentence whose gain it is and what was proven of it."""
    certificate = gain.gain.certificate
    if not certificate.proven:
        return f"{gain.origin}: stability is not proven"
    drawn = f"; its region comes from the logs ({', '.join(gain.log_bounds)})" if gain.log_bounds else ""
    return f"{gain.origin}; outputs {', '.join(gain.outputs)}; Theorem 1 proven at all {certificate.vertices} vertices{drawn}"


def state_bound_table(gain: StoredGain) -> Table:
    """Return how large the error of each state can be for each unit of what disturbs it; no rows where nothing is proven."""
    bound, units = gain.gain.bound, [f"unit of {name}" for name in gain.outputs]
    errors = (
        () if bound is None else zip(gain.states, np.hstack([bound.of_outputs[:, :-1], bound.of_rates]), strict=True)
    )
    rows = [[state, *(f"{value:.3g}" for value in row)] for state, row in errors]
    return ["largest error per", *units, *(f"{name} per s" for name in gain.states)], rows


def ingest_rows(record: Mapping[str, Any]) -> Table:
    """Return header and rows of what `ingest` did: one row per channel."""
    header = ["channel", "source", "source unit", "unit", "rate [Hz]", "rule", "bridged", "no value", "repairs"]
    rows = []
    for name, item in record["channels"].items():
        source = item["source"] if len(record["sources"]) == 1 else f"{item['file']}: {item['source']}"
        rate = NONE if item["rate"] is None else f"{item['rate']:.4g}"
        counts = rate, item["rule"], str(item["bridged"]), str(item["without_value"])
        repairs = "; ".join(f"{key} {value}" for key, value in item["repairs"].items()) or NONE
        rows.append([name, source, item["unit_read_as"], item["unit"], *counts, repairs])
    return header, rows


def ingest_notes(record: Mapping[str, Any]) -> list[str]:
    """Return what `ingest` did to a recording as a whole, one line each: profile, sources, stamps, raster."""
    lines = [f"ingested with profile '{record['profile']['name']}' (sha256 {record['profile']['sha256'][:12]})"]
    for source in record["sources"]:
        notes = [f"{key}: {text}" for key, text in source["notes"].items()]
        for clock, repairs in source["time_repairs"].items():
            notes.append(f"{clock}: " + ", ".join(f"{key} {count}" for key, count in repairs.items()))
        lines.append(f"  {source['name']} (sha256 {source['sha256'][:12]})" + "".join(f"; {note}" for note in notes))
    time, raster = record["time"], record["raster"]
    zero = f", time starts at 0 instead of {time['start']:.6g} s" if time["from_zero"] else ""
    rate = f"{raster['rate']:g} Hz" if raster["rate"] else "as recorded"
    lines.append(
        f"  raster {rate}, {raster['samples']} samples, no samples where all channels pause longer than {raster['gap']:g} s{zero}"
    )
    if record["missing"]:
        lines.append(f"  optional channels that are missing: {', '.join(record['missing'])}")
    return lines


def change_rows(surface: Surface, changed: Sequence[Change]) -> Table:
    """Return header and rows of what an export changes against an old file."""
    header = [f"{axis.name} [{axis.unit}]" for axis in (surface.x, surface.y)]
    flow = surface.unit == "kg/s"
    header += [f"{name} [{'g/s' if flow else surface.unit}]" for name in ("old", "new", "change")] + ["origin"]
    told = grams if flow else "{:.5g}".format
    return header, [
        [f"{item.x:g}", f"{item.y:g}", told(item.old), told(item.new), told(item.new - item.old), item.origin]
        for item in changed
    ]


def origin_counts(surface: Surface) -> dict[str, int]:
    """Return how many nodes of an exported map come from where."""
    counts = {name: int(np.count_nonzero(surface.origin == code)) for code, name in ORIGINS.items()}
    return {name: count for name, count in counts.items() if count}
