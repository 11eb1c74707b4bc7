"""Gates: conditions on metrics that every log of a report has to meet."""

import difflib
import math
import operator
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields

from lpvobs.errors import DataError, NotProven, UsageError
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


def parse_gate(expression: str) -> Gate:
    """Return the gate that an expression states.

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
    if metric not in METRICS:
        near = difflib.get_close_matches(metric, METRICS, n=1, cutoff=0.4)
        hint = f"did you mean '{near[0]}'?" if near else f"known: {', '.join(METRICS)}"
        raise UsageError(f"--gate '{expression}': no metric '{metric}'; {hint}")
    return Gate(metric, found["relation"], limit)


@dataclass(frozen=True)
class Verdict:
    """One gate on one log.

    Attributes
    ----------
    value : float or None
        None where the log cannot have the metric.
    """

    gate: Gate
    result: str
    log: str
    value: float | None

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
