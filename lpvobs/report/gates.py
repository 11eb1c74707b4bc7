"""Gates: conditions on metrics that every log of a report has to meet; their verdicts as JUnit XML, too, which CI systems show."""

import difflib
import math
import operator
import re
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from lpvobs.errors import DataError, NotProven, UsageError
from lpvobs.io.safety.atomic import replacing
from lpvobs.report.outputs import ReportedLog, ReportedResult

TRUTH, GIVEN = "a log with reference channels", "the log as an argument"
SOUGHT = "a run of trace or refine on the result"


@dataclass(frozen=True)
class Metric:
    """What a gate may ask of a log, or of a result."""

    unit: str
    meaning: str
    needs: str = ""  # what there must be, or the metric is missing
    words: tuple[str, ...] = ()  # its values, where it is no number


METRICS: Mapping[str, Metric] = {
    "samples": Metric("1", "number of samples that the estimate used"),
    "samples_read": Metric("1", "number of samples in the file"),
    "dropped_rows": Metric("1", "number of samples that were dropped because of defects"),
    "gaps": Metric("1", "number of pauses in the recording that split the log"),
    "repeated": Metric("1", "number of samples whose time repeats or runs backward"),
    "duration": Metric("s", "duration that the samples cover"),
    "share_certified": Metric("1", "share of the samples where the observer is proven stable"),
    "balance_ratio": Metric("1", "difference of the balances on this log, divided by what noise and tolerances allow"),
    "mean_relative_error": Metric("1", "mean of |estimate - reference| / |reference|", TRUTH),
    "share_left_out": Metric(
        "1", "share of the samples that mean_relative_error leaves out because of a small reference", TRUTH
    ),
    "rms_ratio": Metric("1", "rms of estimate - reference, divided by the rms of the reference", TRUTH),
    "rmse": Metric("kg/s", "rms of estimate - reference", TRUTH),
    "bias": Metric("kg/s", "mean of estimate - reference", TRUTH),
    "visited_cells": Metric("1", "number of map cells with samples that were compared with the reference", TRUTH),
    "compared_samples": Metric("1", "number of samples that were compared with the reference", TRUTH),
    "floor_mean_relative_error": Metric(
        "1", "mean_relative_error of the bilinear map that fits the reference best", TRUTH
    ),
    "floor_rms_ratio": Metric("1", "rms_ratio of the bilinear map that fits the reference best", TRUTH),
    "fit": Metric(
        "1", "1 - |reading - prediction| / |reading - mean reading|, for the balance that predicts best", GIVEN
    ),
    "lags_outside": Metric(
        "1", "share of 25 lags at which the autocorrelation of the residual of `fit` is outside the 99 % band", GIVEN
    ),
    "input_lags_outside": Metric(
        "1", "share of 51 lags at which the residual of `fit` and one input correlate beyond the 99 % band", GIVEN
    ),
    "paper_mean_relative_error": Metric(
        "1", "mean_relative_error that the paper prints for this cycle", "a cycle of the paper"
    ),
}
"""What every log of a result may have."""
OF_RESULT: Mapping[str, Metric] = {
    "nodes_estimated": Metric("1", "number of map nodes that were estimated"),
    "standard_error": Metric(
        "kg/s", "median standard error of the estimated nodes", "a method that computes standard errors"
    ),
    "balance_agreement": Metric(
        "1",
        "difference of the balances over all logs, divided by what is allowed; about 1 or less is right",
        "two balances",
    ),
    "verdict": Metric(
        "-", "verdict of trace, or of refine if trace has not run", SOUGHT, ("none", "effect", "unexplained")
    ),
    "residual": Metric(
        "kg/s", "rms of the held-out residual; after refine, with the found effects in the model", SOUGHT
    ),
}
"""What a result has as a whole."""
RELATIONS: Mapping[str, Callable[[Any, Any], bool]] = {
    "<=": operator.le,
    ">=": operator.ge,
    "==": operator.eq,
    "!=": operator.ne,
    "<": operator.lt,
    ">": operator.gt,
}
SHAPE = re.compile(r"\s*(?P<metric>\w+)\s*(?P<relation><=|>=|==|!=|<|>)\s*(?P<limit>\S+)\s*")
_NOT_XML = re.compile("[^\t\n\r\u0020-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
"""What XML 1.0 cannot hold, not even escaped; names of files may."""


@dataclass(frozen=True)
class Gate:
    """A condition on one metric, such as `mean_relative_error<=0.02` or `verdict==none`; fractions are fractions."""

    metric: str
    relation: str
    limit: float | str

    def __str__(self) -> str:
        return f"{self.metric}{self.relation}{_said(self.limit)}"

    def holds(self, value: float | str) -> bool:
        """Tell whether a value passes."""
        return RELATIONS[self.relation](value, self.limit)


def parse_gate(expression: str, unit: float = 1.0, metrics: Collection[str] = (*METRICS, *OF_RESULT)) -> Gate:
    """Return the gate that an expression states, its limit times a unit.

    Raises UsageError if it is no condition, or nothing is measured under that name.
    """
    found = SHAPE.fullmatch(expression)
    if found is None:
        raise UsageError(f"--gate '{expression}': {NO_GATE}")
    metric, relation, limit = found["metric"], found["relation"], found["limit"]
    if metric not in metrics:
        near = difflib.get_close_matches(metric, metrics, n=1, cutoff=0.4)
        hint = f"did you mean '{near[0]}'?" if near else "`lpvobs report --list-metrics` lists all metrics"
        raise UsageError(f"--gate '{expression}': no metric '{metric}'; {hint}")
    if metric in OF_RESULT and (words := OF_RESULT[metric].words):
        if relation not in ("==", "!=") or limit not in words:
            raise UsageError(
                f"--gate '{expression}': the value of {metric} is a word, not a number; expected == or != and one of "
                f"{', '.join(words)}"
            )
        return Gate(metric, relation, limit)
    try:
        number = float(limit)
    except ValueError:
        number = math.nan
    if math.isnan(number):
        raise UsageError(f"--gate '{expression}': {NO_GATE}")
    return Gate(metric, relation, unit * number)


NO_GATE = "is not a condition; expected metric<=number (or <, >=, >, ==, !=), such as mean_relative_error<=0.02 for 2 %"


@dataclass(frozen=True)
class Verdict:
    """One gate on one log, or on a result."""

    gate: Gate
    result: str
    log: str  # empty for what the result has as a whole
    value: float | str | None  # None where there is no such metric

    @property
    def holds(self) -> bool:
        """Whether there is a value, and it passes."""
        return self.value is not None and self.gate.holds(self.value)

    def __str__(self) -> str:
        place = f"{self.result}: log {self.log}" if self.log else self.result
        if self.value is None:
            needs = {**METRICS, **OF_RESULT}[self.gate.metric].needs
            said = f"{place} has no value of {self.gate.metric} for the gate {self.gate}"
            return f"{said}; this metric needs {needs}" if needs else said
        return f"{place} has {self.gate.metric} = {_said(self.value)}, the gate is {self.gate}"


def judge(
    gates: Sequence[Gate], logs: Sequence[ReportedLog], results: Sequence[ReportedResult] = ()
) -> tuple[Verdict, ...]:
    """Return the verdict of every gate on every log; of a metric that a result has as a whole, on every result."""
    return tuple(
        Verdict(gate, item.result, getattr(item, "log", ""), _finite(getattr(item, gate.metric)))
        for gate in gates
        for item in (results if gate.metric in OF_RESULT else logs)
    )


def enforce(verdicts: Sequence[Verdict]) -> None:
    """Return when all gates hold.

    Raises NotProven if a gate fails, even where another could not be judged; DataError if a metric is missing.
    """
    failed = [str(item) for item in verdicts if item.value is not None and not item.holds]
    missing = [str(item) for item in verdicts if item.value is None]
    if failed:
        raise NotProven(f"gate failed: {_first_of(failed)}; estimate from more or better data, or relax the gate")
    if missing:
        raise DataError(f"gate cannot be judged: {_first_of(missing)}; provide what is missing, or remove the gate")


def _finite(value: float | str | None) -> float | str | None:
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _said(value: float | str) -> str:
    return value if isinstance(value, str) else f"{value:.6g}"


def _first_of(messages: Sequence[str]) -> str:
    return messages[0] if len(messages) == 1 else f"{messages[0]} (and {len(messages) - 1} more)"


def write_junit(path: Path, verdicts: Sequence[Verdict], refused: Sequence[str] = ()) -> None:
    """Write one suite per result and one test case per log and gate; the file appears whole or not at all."""
    # A log that fails a gate is a `failure`, one that cannot have the metric, or could not be used, an `error`. Same
    # verdicts, same bytes: there are no time stamps.
    with replacing(path) as temporary:
        temporary.write_bytes(junit_xml(verdicts, refused))


def junit_xml(verdicts: Sequence[Verdict], refused: Sequence[str] = ()) -> bytes:
    """Return the document, UTF-8."""
    root = ElementTree.Element("testsuites", {"name": "lpvobs", **_counts(verdicts, len(refused))})
    for result in dict.fromkeys(item.result for item in verdicts):
        own = [item for item in verdicts if item.result == result]
        suite = ElementTree.SubElement(root, "testsuite", {"name": _text(result), **_counts(own)})
        for item in own:
            _add_case(suite, item)
    if refused:
        suite = ElementTree.SubElement(root, "testsuite", {"name": "logs left out", **_counts((), len(refused))})
        for line in refused:
            case = ElementTree.SubElement(suite, "testcase", {"classname": "logs", "name": _text(line), "time": "0"})
            ElementTree.SubElement(case, "error", {"type": "log cannot be used", "message": _text(line)})
    ElementTree.indent(root)
    written: bytes = ElementTree.tostring(root, encoding="utf-8", xml_declaration=True)
    return written + b"\n"


def _counts(verdicts: Sequence[Verdict], refused: int = 0) -> dict[str, str]:
    missing = sum(item.value is None for item in verdicts)
    failed = sum(not item.holds for item in verdicts) - missing
    return {"tests": str(len(verdicts) + refused), "failures": str(failed), "errors": str(missing + refused)}


def _add_case(suite: ElementTree.Element, verdict: Verdict) -> None:
    place = f"{verdict.log}: {verdict.gate}" if verdict.log else str(verdict.gate)
    name = {"classname": _text(verdict.result), "name": _text(place), "time": "0"}
    case = ElementTree.SubElement(suite, "testcase", name)
    if verdict.value is None:
        ElementTree.SubElement(case, "error", {"type": "no such metric", "message": _text(str(verdict))})
    elif verdict.holds:
        ElementTree.SubElement(case, "system-out").text = _text(str(verdict))
    else:
        ElementTree.SubElement(case, "failure", {"type": "gate", "message": _text(str(verdict))})


def _text(text: str) -> str:
    return _NOT_XML.sub("\ufffd", text)
