"""Gates: conditions on metrics that every log of a report has to meet; their verdicts as JUnit XML, which CI systems show."""

import difflib
import math
import operator
import re
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from lpvobs.errors import DataError, NotProven, UsageError
from lpvobs.io.templates import filled
from lpvobs.report.outputs import ReportedLog, ReportedResult, metrics_of

METRICS = metrics_of(ReportedLog)
"""What every log of a result may have."""
OF_RESULT = metrics_of(ReportedResult)
"""What a result has as a whole."""
RELATIONS: Mapping[str, Callable[[Any, Any], bool]] = {
    "<=": operator.le,
    ">=": operator.ge,
    "==": operator.eq,
    "!=": operator.ne,
    "<": operator.lt,
    ">": operator.gt,
}
SHAPE = re.compile(rf"\s*(?P<metric>\w+)\s*(?P<relation>{'|'.join(RELATIONS)})\s*(?P<limit>\S+)\s*")
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
    missing = [str(item) for item in verdicts if item.value is None]
    if failed := [str(item) for item in verdicts if item.value is not None and not item.holds]:
        raise NotProven(f"gate failed: {_first_of(failed)}; estimate from more or better data, or relax the gate")
    if missing:
        raise DataError(f"gate cannot be judged: {_first_of(missing)}; provide what is missing, or remove the gate")


def junit_xml(verdicts: Sequence[Verdict], refused: Sequence[str] = ()) -> str:
    """Return JUnit XML: one suite per result, and one test case per log and gate."""
    text = filled("lpvobs.report.templates", "junit.xml", {}, markup=True, verdicts=verdicts, refused=refused)
    return _NOT_XML.sub("\ufffd", text) + "\n"


def _finite(value: float | str | None) -> float | str | None:
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _said(value: float | str) -> str:
    return value if isinstance(value, str) else f"{value:.6g}"


def _first_of(messages: Sequence[str]) -> str:
    return messages[0] if len(messages) == 1 else f"{messages[0]} (and {len(messages) - 1} more)"
