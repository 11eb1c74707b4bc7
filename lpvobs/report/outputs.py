"""What is printed of results with `--json`, as frozen records; what one verb prints alone stands beside the verb in `lpvobs.api`.

The JSON Schemas in `schemas` are made of these records. A field that may be UNSET is left out where it is.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Annotated, Any

import numpy as np
from msgspec import UNSET, Meta, UnsetType

from lpvobs.io.results.gains import StoredGain
from lpvobs.io.results.results import LogSummary, StoredResult
from lpvobs.kinds import Count, Finite, Fraction, KgPerS, Refused, Seconds, Sha
from lpvobs.maps.metrics import Metrics
from lpvobs.maps.quadratic import Filled
from lpvobs.report.fit import ResidualFit
from lpvobs.report.names import paper_error

StoredOutcome = Annotated[Mapping[str, Any], Meta(extra_json_schema={"$ref": "#/$defs/StoredOutcome"})]


@dataclass(frozen=True, kw_only=True)
class LogOutput:
    """A log of a result with its metrics; a metric that a log cannot have is null."""

    log: str
    sha256: Sha
    found: Annotated[
        Mapping[str, Count], Meta(description="Number of stuck, saturated and spiked samples, by kind and channel.")
    ]
    samples: Count
    samples_read: Count
    dropped_rows: Count
    gaps: Count
    repeated: Count
    duration: Seconds
    share_certified: Fraction
    balance_ratio: Annotated[
        float,
        Meta(
            description="Difference of the balances, divided by what noise and tolerances allow; about 1 or less is right."
        ),
    ]
    mean_relative_error: Fraction
    share_left_out: Fraction
    rms_ratio: Fraction
    rmse: KgPerS | None
    bias: KgPerS | None
    visited_cells: Count | None
    compared_samples: Count | None
    floor_mean_relative_error: Fraction
    floor_rms_ratio: Fraction


@dataclass(frozen=True, kw_only=True)
class Coefficients:
    """Of Eq. (37): kg/s over the map's axes."""

    a2: float
    a1: float
    b2: float
    b1: float
    c2: float
    c1: float


@dataclass(frozen=True, kw_only=True)
class QuadraticOutput:
    """A filled map and its Eq. (37)."""

    method: str
    coefficients: Coefficients
    coefficients_standard_error: Coefficients
    lack_of_fit: KgPerS
    nodes: Count


@dataclass(frozen=True, kw_only=True)
class StateBoundOutput:
    """Proven largest errors of the states: a row each, per size of what disturbs the rate of each state, or an output."""

    of_rates: Sequence[Sequence[Finite]]
    of_outputs: Sequence[Sequence[Finite]]


@dataclass(frozen=True, kw_only=True)
class GainOutput:
    """A gain and what is proven of it."""

    origin: str
    outputs: Sequence[str]
    L: Sequence[Sequence[Finite]]
    proven: bool
    vertices: Count
    state_bound: StateBoundOutput | None


@dataclass(frozen=True, kw_only=True)
class ReportedLog(LogOutput):
    """A log of one of the results."""

    result: str
    method: str
    paper_mean_relative_error: Fraction
    fit: Annotated[
        Fraction, Meta(description="Fit of the balance that predicts the reading best; null if the log was not given.")
    ]
    lags_outside: Annotated[
        Fraction, Meta(description="Share of lags at which the residual's autocorrelation is outside the 99 % band.")
    ]
    input_lags_outside: Annotated[
        Fraction,
        Meta(
            description="Share of lags at which the residual's correlation with an input is outside the 99 % band; "
            "largest of all inputs."
        ),
    ]


@dataclass(frozen=True, kw_only=True)
class MapCounts:
    """Nodes of a map by where their value comes from."""

    cells: Count
    estimated: Count
    extrapolated: Count


@dataclass(frozen=True, kw_only=True)
class ReportedGain(GainOutput):
    """The gain of a result."""

    smallest_pivot: float


@dataclass(frozen=True, kw_only=True)
class ReportedResult:
    """One of the results."""

    result: str
    file: str
    method: str
    map: MapCounts
    nodes_estimated: Count
    standard_error: Annotated[KgPerS | None, Meta(description="Median standard error of the estimated nodes.")]
    balance_agreement: Annotated[
        float, Meta(description="Difference of the balances over all logs, divided by what noise and tolerances allow.")
    ]
    verdict: Annotated[
        str | None, Meta(description="Verdict of trace, or of refine if trace has not run; null if neither has run.")
    ]
    residual: Annotated[KgPerS | None, Meta(description="Rms of the held-out residual from that run.")]
    extrapolation: QuadraticOutput | None
    gain: ReportedGain
    trace: StoredOutcome | UnsetType = UNSET
    refinement: StoredOutcome | UnsetType = UNSET


@dataclass(frozen=True, kw_only=True)
class RegionMean:
    """The mean of a result's map over a region."""

    result: str
    region: str
    value: KgPerS
    ci90: tuple[KgPerS, KgPerS]


@dataclass(frozen=True, kw_only=True)
class ReportOutput:
    """Metrics of every log; map and extrapolation are those of the first result."""

    logs: Sequence[ReportedLog]
    map: MapCounts
    extrapolation: QuadraticOutput | None
    results: Sequence[ReportedResult]
    regions: Sequence[RegionMean]
    fits: Annotated[
        Sequence[ResidualFit], Meta(description="Fit and residual of each balance on the logs that were given.")
    ]
    refused: Refused


def log_fields(log: LogSummary) -> dict[str, Any]:
    """Return the fields of `LogOutput` for a log of a result."""
    metrics: dict[str, Any] = dict.fromkeys(field.name for field in fields(Metrics))
    metrics |= {} if log.metrics is None else vars(log.metrics)
    metrics["compared_samples"] = metrics.pop("samples")
    own = vars(log) | {"log": log.name}
    return metrics | {field.name: own[field.name] for field in fields(LogOutput) if field.name in own}


def quadratic_fields(fitted: Filled) -> dict[str, Any]:
    """Return the fields of `QuadraticOutput` for a quadratic."""
    names = [field.name for field in fields(Coefficients)]
    value, error = (
        Coefficients(**dict(zip(names, each.tolist(), strict=True)))
        for each in (fitted.coefficients, fitted.standard_error)
    )
    return {
        "method": fitted.method,
        "coefficients": value,
        "coefficients_standard_error": error,
        "lack_of_fit": fitted.lack_of_fit,
        "nodes": fitted.nodes,
    }


def gain_fields(stored: StoredGain) -> dict[str, Any]:
    """Return the fields of `GainOutput` for a gain."""
    certificate = stored.gain.certificate
    return {
        "origin": stored.origin,
        "outputs": stored.outputs,
        "L": stored.gain.L.tolist(),
        "proven": certificate.proven,
        "vertices": certificate.vertices,
        "state_bound": state_bound_output(stored),
    }


def state_bound_output(stored: StoredGain) -> StateBoundOutput | None:
    """Return the proven bound of a gain; None where there is none."""
    bound = stored.gain.bound
    return None if bound is None else StateBoundOutput(**{name: value.tolist() for name, value in vars(bound).items()})


def report_output(
    results: Sequence[tuple[str, StoredResult]],
    found: Sequence[Mapping[str, Any]] = (),
    fits: Sequence[ResidualFit] = (),
) -> ReportOutput:
    """Return the object of `report --json` for named results; `found` is what `trace` and `refine` said of each."""
    every = [
        _result_output(name, result, each)
        for (name, result), each in zip(results, found or [{}] * len(results), strict=True)
    ]
    logs = [
        ReportedLog(
            result=name,
            method=result.method,
            paper_mean_relative_error=paper_error(result.air_path, log.name),
            **_best_fit([each for each in fits if (each.result, each.log) == (name, log.name)]),
            **log_fields(log),
        )
        for name, result in results
        for log in result.logs
    ]
    refused = [f"{name}: {line}" for name, result in results for line in result.refused]
    return ReportOutput(
        logs=logs,
        map=every[0].map,
        extrapolation=every[0].extrapolation,
        results=every,
        regions=(),
        fits=fits,
        refused=refused,
    )


def _best_fit(fits: Sequence[ResidualFit]) -> dict[str, Any]:
    if not fits:
        return dict.fromkeys(("fit", "lags_outside", "input_lags_outside"))
    best = min(fits, key=lambda item: item.rms or 0.0)
    return {
        "fit": best.fit,
        "lags_outside": best.lags_outside,
        "input_lags_outside": max(best.outside.values(), default=0.0),
    }


def _result_output(name: str, result: StoredResult, found: Mapping[str, Any]) -> ReportedResult:
    fitted, nodes = result.extrapolation, int(result.supported.sum())
    errors = result.standard_error[result.supported]
    sought = found.get("trace") or found.get("refinement") or {"verdict": None, "error": {}}

    return ReportedResult(
        result=name,
        file=str(result.path),
        method=result.method,
        map=MapCounts(
            cells=result.grid.size,
            estimated=nodes,
            extrapolated=0 if fitted is None else int((fitted.support == 2).sum()),
        ),
        nodes_estimated=nodes,
        standard_error=float(np.median(errors)) if errors.size and (errors > 0.0).all() else None,
        balance_agreement=result.balance_agreement,
        verdict=sought["verdict"],
        residual=sought["error"].get("after", sought["error"].get("before")),
        extrapolation=None if fitted is None else QuadraticOutput(**quadratic_fields(fitted)),
        gain=ReportedGain(**gain_fields(result.gain), smallest_pivot=result.gain.gain.certificate.smallest_pivot),
        **found,
    )
