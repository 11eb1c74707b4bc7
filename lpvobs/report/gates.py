"""Gates: conditions on metrics that every log of a report has to meet; their verdicts as JUnit XML, too, which CI systems show."""

import difflib
import math
import operator
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from xml.etree import ElementTree

from lpvobs.errors import DataError, NotProven, UsageError
from lpvobs.io.safety.atomic import replacing
from lpvobs.report.outputs import LogOutput, ReportedLog

METRICS = tuple(field.name for field in fields(LogOutput) if field.name not in ("log", "sha256", "found"))
"""The numbers that the JSON has for every log."""
RELATIONS: Mapping[str, Callable[[float, float], bool]] = {
    "<=": operator.le,
    ">=": operator.ge,
    "<": operator.lt,
    ">": operator.gt,
}
SHAPE = re.compile(r"\s*(?P<metric>\w+)\s*(?P<relation><=|>=|<|>)\s*(?P<limit>\S+)\s*")
_NOT_XML = re.compile("[^\t\n\r\u0020-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
"""What XML 1.0 cannot hold, not even escaped; names of files may."""


@dataclass(frozen=True)
class Gate:
    """A condition on one metric, for example `mean_relative_error<=0.02`; fractions are fractions."""

    metric: str
    relation: str
    limit: float

    def __str__(self) -> str:
        return f"{self.metric}{self.relation}{self.limit:g}"

    def holds(self, value: float) -> bool:
        """Tell whether a value passes."""
        return RELATIONS[self.relation](value, self.limit)


def parse_gate(expression: str, unit: float = 1.0, metrics: Sequence[str] = METRICS) -> Gate:
    """Return the gate that an expression states, its limit times a unit.

    Raises UsageError if it is not `metric<=number` (or with <, >=, >), or nothing is measured under that name.
    """
    found = SHAPE.fullmatch(expression)
    limit = _number(found["limit"]) if found else None
    if found is None or limit is None:
        raise UsageError(
            f"--gate '{expression}': not a condition; expected metric<=number with <=, <, >= or >, "
            f"fractions as fractions, for example mean_relative_error<=0.02"
        )
    metric = found["metric"]
    if metric not in metrics:
        near = difflib.get_close_matches(metric, metrics, n=1, cutoff=0.4)
        hint = f"did you mean '{near[0]}'?" if near else f"known: {', '.join(metrics)}"
        raise UsageError(f"--gate '{expression}': no metric '{metric}'; {hint}")
    return Gate(metric, found["relation"], unit * limit)


@dataclass(frozen=True)
class Verdict:
    """One gate on one log."""

    gate: Gate
    result: str
    log: str
    value: float | None  # None where the log cannot have the metric

    @property
    def holds(self) -> bool:
        """Whether the log has the metric and passes."""
        return self.value is not None and self.gate.holds(self.value)

    def __str__(self) -> str:
        place = f"{self.result}: log {self.log}"
        if self.value is None:
            return f"{place} has no {self.gate.metric}, which the gate {self.gate} needs"
        return f"{place} has {self.gate.metric} = {self.value:.6g}, the gate is {self.gate}"


def judge(gates: Sequence[Gate], logs: Sequence[ReportedLog]) -> tuple[Verdict, ...]:
    """Return every gate's verdict on every log."""
    return tuple(
        Verdict(gate, log.result, log.log, _finite(getattr(log, gate.metric))) for gate in gates for log in logs
    )


def enforce(verdicts: Sequence[Verdict]) -> None:
    """Return when every log passes every gate.

    Raises NotProven if a log fails a gate, even where another log could not be judged; DataError if a log lacks a metric that a
    gate asks for.
    """
    failed = [str(item) for item in verdicts if item.value is not None and not item.holds]
    missing = [str(item) for item in verdicts if item.value is None]
    if failed:
        raise NotProven(f"gate failed: {_first_of(failed)}; estimate from more or better data, or widen the gate")
    if missing:
        raise DataError(
            f"gate cannot be judged: {_first_of(missing)}; estimate from a log with reference channels, or drop the gate"
        )


def _finite(value: float | None) -> float | None:
    return None if value is None or not math.isfinite(value) else value


def _number(text: str) -> float | None:
    try:
        value = float(text)
    except ValueError:
        return None
    return None if math.isnan(value) else value


def _first_of(messages: Sequence[str]) -> str:
    return messages[0] if len(messages) == 1 else f"{messages[0]} (and {len(messages) - 1} more)"


def write_junit(path: Path, verdicts: Sequence[Verdict], refused: Sequence[str] = ()) -> None:
    """Write one suite per result and one test case per log and gate; the file appears whole or not at all.

    A log that fails a gate is a `failure`, one that cannot have the metric, or could not be used, an `error`. Same verdicts, same
    bytes: there are no time stamps.
    """
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
    name = {"classname": _text(verdict.result), "name": _text(f"{verdict.log}: {verdict.gate}"), "time": "0"}
    case = ElementTree.SubElement(suite, "testcase", name)
    if verdict.value is None:
        ElementTree.SubElement(case, "error", {"type": "no such metric", "message": _text(str(verdict))})
    elif verdict.holds:
        ElementTree.SubElement(case, "system-out").text = _text(str(verdict))
    else:
        ElementTree.SubElement(case, "failure", {"type": "gate", "message": _text(str(verdict))})


def _text(text: str) -> str:
    return _NOT_XML.sub("\ufffd", text)
