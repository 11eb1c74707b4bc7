"""What is printed of results with `--json`, as frozen records; what one verb prints alone stands beside the verb in `lpvobs.api`.

The JSON Schemas in `schemas` are made of these records. A field that may be UNSET is left out where it is.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Annotated, Any, get_type_hints

from msgspec import UNSET, Meta, UnsetType

from lpvobs.io.results.gains import StoredGain
from lpvobs.io.results.results import LogSummary
from lpvobs.kinds import Count, Finite, Fraction, KgPerS, Output, Refused, Seconds, Sha
from lpvobs.maps.metrics import Metrics
from lpvobs.maps.quadratic import Filled
from lpvobs.report.fit import ResidualFit

TRUTH, GIVEN = "a log with reference channels", "the log as an argument"
SOUGHT = "a run of trace or refine on the result"


@dataclass(frozen=True)
class Metric:
    """What a gate may ask of a log, or of a result."""

    meaning: str
    needs: str  # what there must be, or the metric is missing
    unit: str
    words: tuple[str, ...]  # its values, where it is no number


def metric(meaning: str, needs: str = "", unit: str = "1", words: tuple[str, ...] = ()) -> Meta:
    """Return what makes the field of a record a metric; its JSON Schema says the same."""
    said = meaning[0].upper() + meaning[1:] + (f" [{unit}]" if unit in ("s", "kg/s") else "")
    return Meta(
        description=f"{said}; null without {needs}." if needs else f"{said}.",
        extra={"metric": Metric(meaning, needs, unit, words)},
    )


def metrics_of(record: type) -> dict[str, Metric]:
    """Return the metrics among the fields of a record."""
    return {
        name: item.extra["metric"]
        for name, hint in get_type_hints(record, include_extras=True).items()
        for item in getattr(hint, "__metadata__", ())
        if getattr(item, "extra", None)
    }


StoredOutcome = Annotated[Mapping[str, Any], Meta(extra_json_schema={"$ref": "#/$defs/StoredOutcome"})]


class LogOutput(Output):
    """A log of a result with its metrics; a metric that a log cannot have is null."""

    log: str
    sha256: Sha
    found: Annotated[
        Mapping[str, Count], Meta(description="Number of stuck, saturated and spiked samples, by kind and channel.")
    ]
    samples: Annotated[Count, metric("number of samples that the estimate used")]
    samples_read: Annotated[Count, metric("number of samples in the file")]
    dropped_rows: Annotated[Count, metric("number of samples that were dropped because of defects")]
    gaps: Annotated[Count, metric("number of pauses in the recording that split the log")]
    repeated: Annotated[Count, metric("number of samples whose time repeats or runs backward")]
    duration: Annotated[Seconds, metric("duration that the samples cover", unit="s")]
    share_certified: Annotated[Fraction, metric("share of the samples where the observer is proven stable")]
    balance_ratio: Annotated[
        float, metric("difference of the balances on this log, divided by what noise and tolerances allow")
    ]
    mean_relative_error: Annotated[Fraction, metric("mean of |estimate - reference| / |reference|", TRUTH)]
    share_left_out: Annotated[
        Fraction, metric("share of the samples that mean_relative_error leaves out because of a small reference", TRUTH)
    ]
    rms_ratio: Annotated[Fraction, metric("rms of estimate - reference, divided by the rms of the reference", TRUTH)]
    rmse: Annotated[KgPerS | None, metric("rms of estimate - reference", TRUTH, "kg/s")]
    bias: Annotated[KgPerS | None, metric("mean of estimate - reference", TRUTH, "kg/s")]
    visited_cells: Annotated[
        Count | None, metric("number of map cells with samples that were compared with the reference", TRUTH)
    ]
    compared_samples: Annotated[Count | None, metric("number of samples that were compared with the reference", TRUTH)]
    floor_mean_relative_error: Annotated[
        Fraction, metric("mean_relative_error of the bilinear map that fits the reference best", TRUTH)
    ]
    floor_rms_ratio: Annotated[Fraction, metric("rms_ratio of the bilinear map that fits the reference best", TRUTH)]


@dataclass(frozen=True)
class Coefficients:
    """Of Eq. (37): kg/s over the map's axes."""

    a2: float
    a1: float
    b2: float
    b1: float
    c2: float
    c1: float


class QuadraticOutput(Output):
    """A filled map and its Eq. (37)."""

    method: str
    coefficients: Coefficients
    coefficients_standard_error: Coefficients
    lack_of_fit: KgPerS
    nodes: Count


class StateBoundOutput(Output):
    """Proven largest errors of the states: a row each, per size of what disturbs the rate of each state, or an output."""

    of_rates: Sequence[Sequence[Finite]]
    of_outputs: Sequence[Sequence[Finite]]


class GainOutput(Output):
    """A gain and what is proven of it."""

    origin: str
    outputs: Sequence[str]
    L: Sequence[Sequence[Finite]]
    proven: bool
    vertices: Count
    state_bound: StateBoundOutput | None


class ReportedLog(LogOutput):
    """A log of one of the results."""

    result: str
    method: str
    paper_mean_relative_error: Annotated[
        Fraction, metric("mean_relative_error that the paper prints for this cycle", "a cycle of the paper")
    ]
    fit: Annotated[
        Fraction,
        metric("1 - |reading - prediction| / |reading - mean reading|, for the balance that predicts best", GIVEN),
    ]
    lags_outside: Annotated[
        Fraction,
        metric(
            "share of 25 lags at which the autocorrelation of the residual of `fit` is outside the 99 % band", GIVEN
        ),
    ]
    input_lags_outside: Annotated[
        Fraction,
        metric("share of 51 lags at which the residual of `fit` and one input correlate beyond the 99 % band", GIVEN),
    ]


class MapCounts(Output):
    """Nodes of a map by where their value comes from."""

    cells: Count
    estimated: Count
    extrapolated: Count


class ReportedGain(GainOutput):
    """The gain of a result."""

    smallest_pivot: float


class ReportedResult(Output):
    """One of the results."""

    result: str
    file: str
    method: str
    map: MapCounts
    nodes_estimated: Annotated[Count, metric("number of map nodes that were estimated")]
    standard_error: Annotated[
        KgPerS | None,
        metric("median standard error of the estimated nodes", "a method that computes standard errors", "kg/s"),
    ]
    balance_agreement: Annotated[
        float,
        metric(
            "difference of the balances over all logs, divided by what is allowed; about 1 or less is right",
            "two balances",
        ),
    ]
    verdict: Annotated[
        str | None,
        metric("verdict of trace, or of refine if trace has not run", SOUGHT, "-", ("none", "effect", "unexplained")),
    ]
    residual: Annotated[
        KgPerS | None,
        metric("rms of the held-out residual; after refine, with the found effects in the model", SOUGHT, "kg/s"),
    ]
    extrapolation: QuadraticOutput | None
    gain: ReportedGain
    trace: StoredOutcome | UnsetType = UNSET
    refinement: StoredOutcome | UnsetType = UNSET


class RegionMean(Output):
    """The mean of a result's map over a region."""

    result: str
    region: str
    value: KgPerS
    ci90: tuple[KgPerS, KgPerS]


class ReportOutput(Output):
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
    metrics = {field.name: getattr(log.metrics, field.name, None) for field in fields(Metrics)}
    metrics["compared_samples"] = metrics.pop("samples")
    own = vars(log) | {"log": log.name}
    return metrics | {field.name: own[field.name] for field in fields(LogOutput) if field.name in own}


def quadratic_fields(fitted: Filled) -> dict[str, Any]:
    """Return the fields of `QuadraticOutput` for a quadratic."""
    return {
        "method": fitted.method,
        "coefficients": Coefficients(*fitted.coefficients.tolist()),
        "coefficients_standard_error": Coefficients(*fitted.standard_error.tolist()),
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
