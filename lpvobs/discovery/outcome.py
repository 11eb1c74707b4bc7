"""The outcome of `trace` and `refine`, as plain records and as the contract's JSON."""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Annotated, Any

from msgspec import UNSET, Meta, UnsetType, to_builtins

from lpvobs.discovery.held_out import MEASURE, Comparison
from lpvobs.discovery.whiteness import Frequency, Leftover, When, Where
from lpvobs.kinds import Finite, Fraction, Output
from lpvobs.records import Item

Verdict = Annotated[str, Meta(extra_json_schema={"enum": ["effect", "none", "unexplained"]})]
SINCE = "time [s] since the start of the log; null: the effect acts"
Onset = Annotated[float | None, Meta(description=f"{SINCE} from the first sample")]
End = Annotated[float | None, Meta(description=f"{SINCE} to the last sample")]


@dataclass(frozen=True)
class Parameter:
    """An estimated parameter with its 90 % interval."""

    value: float
    unit: str
    ci90: tuple[float, float]


@dataclass(frozen=True)
class Followed:
    """A curve over a logged channel: the effect that changes with it, and its change at each knot."""

    channel: str
    of: str
    changes: str
    knots: tuple[Finite, ...]
    values: tuple[Finite, ...]


@dataclass(frozen=True)
class OverInputs:
    """The curve of a component: its factor at the knots of two inputs, one row for each knot of the first input."""

    inputs: tuple[str, str]
    units: tuple[str, str]
    largest_at: tuple[Finite, Finite]  # inputs where, on the logs, the factor is farthest from one
    knots: tuple[tuple[Finite, ...], tuple[Finite, ...]]
    factor: tuple[tuple[Finite, ...], ...]
    standard_error: tuple[tuple[Finite, ...], ...]


@dataclass(frozen=True)
class Following:
    """Parameters of a course that is more than an onset and an end; zero or empty if the course does not use them."""

    time_constant: Finite  # [s]
    input: str  # a channel
    low: Finite  # of the input, below which a hysteresis ends; of its state, at which there is nothing of an effect
    high: Finite  # of the input, above which a hysteresis begins; of its state, at which all of an effect is there
    intervals: tuple[tuple[Finite, Finite], ...]  # [s] since the start of the log


COURSES = ("always", "step", "interval", "intermittent", "ramp", "saturating", "hysteresis", "lagged")
"""How an effect is there over time, as the contract has them."""


@dataclass(frozen=True)
class Finding:
    """One effect."""

    id: str
    parameters: Mapping[str, Parameter]
    onset: Onset  # [s] since the start of its log; None where it acts from the first sample
    end: End  # [s]; None where it acts to the last
    # share of the residual's power above noise, without the effect, that the effect explains; None for an effect that
    # the model had already
    explained: Fraction
    p_value: float | None  # corrected for all effects and intervals that were tried
    indistinguishable: tuple[str, ...]  # effects that explain these logs as well
    course: Annotated[str, Meta(extra_json_schema={"enum": list(COURSES)})] | UnsetType = UNSET
    follows: Following | UnsetType = UNSET
    drive: str | UnsetType = UNSET  # what kind of drive would tell them apart
    curve: Followed | UnsetType = UNSET  # for a channel
    surface: OverInputs | UnsetType = UNSET  # for a component's curve
    formula: str | UnsetType = UNSET  # in words, for a form


class Leading(Output):
    """A candidate for a residual that stays unexplained: fitted alone, with the share of the residual that it would explain."""

    id: str
    parameters: Mapping[str, Parameter]
    explained: Fraction
    course: Annotated[str, Meta(extra_json_schema={"enum": list(COURSES)})]
    formula: str | UnsetType = UNSET  # in words, for a form
    proven: Annotated[bool, Meta(extra_json_schema={"const": False})] = False


@dataclass(frozen=True)
class DrivesNeeded:
    """The candidate that the fewest healthy drives would prove, and their number, if days differ as the known ones do."""

    id: str
    number: Annotated[int, Meta(ge=3)]


@dataclass(frozen=True)
class BalanceError:
    """Error of one balance on one log: where the effects act, or on the whole log if none acts."""

    balance: str
    unit: Annotated[str, Meta(extra_json_schema={"enum": ["1", "kg/s"]})]
    before: float  # rms of the residual without the effects (B)
    after: float  # with them accounted for (A)
    healthy: float | None  # the same on held-out parts of the healthy logs (N); None where there are none
    usual_before: float  # B from medians, which ignore a few outliers
    usual_after: float  # A from medians
    affected: bool  # whether the effects move it by more than its usual error
    recovered: float | None  # (B - A) / (B - N); None where it is not affected or nothing says what is healthy

    def note(self) -> str:
        """Return a sentence on its error before and after."""
        times, unit = (100.0, "%") if self.unit == "1" else (1e3, "g/s")
        said = (
            f"balance {self.balance}: the rms error is {times * self.before:.2g} {unit} without the effects and "
            f"{times * self.after:.2g} {unit} with them in the model"
        )
        if self.healthy is None or self.recovered is None:
            return f"{said}."
        return (
            f"{said}. A healthy engine has {times * self.healthy:.2g} {unit}; the effects explain {100 * self.recovered:.0f} % of "
            f"the error above that."
        )


@dataclass(frozen=True)
class DayLevel:
    """A constant difference of this log's day from the healthy logs that counts as normal; `usual` is its standard deviation."""

    name: str
    value: float
    unit: str
    usual: float


@dataclass(frozen=True)
class Missing:
    """What cannot be computed because a log lacks channels."""

    channels: tuple[str, ...]  # that the log does not have
    balances: tuple[str, ...]  # that cannot be drawn up without them
    # effects that move the same of the remaining balances, so that their place no longer tells them apart
    same_place: tuple[tuple[str, ...], ...]

    def notes(self) -> list[str]:
        """Return sentences on it."""
        lost = f"Channels that the log lacks: {', '.join(self.channels)}. Balances that need them: {', '.join(self.balances)}."
        alike = "These effects change the same remaining balances and are therefore hard to tell apart"
        return [lost, *(f"{alike}: {', '.join(group)}." for group in self.same_place)]


@dataclass(frozen=True)
class Ranked:
    """One line of the ranking: an effect alone against the residual of the model as it was."""

    id: Annotated[str, Item("1", "candidate effect, added alone to the earlier model", name="candidate")]
    value: Annotated[float, Item("1", "size of the effect, in the unit of size_unit", name="size", gaps=True)]
    unit: Annotated[str, Item("1", "unit of the size", name="size_unit")]
    gain: Annotated[float, Item("1", "how much the effect lowers half the sum of squares", name="evidence", gaps=True)]
    unevenness: Annotated[float, Item("1", "variance of the effect's score over blocks, over that of noise", gaps=True)]


class ErrorOutput(Output):
    """The error on held-out data: before, and after if the model was refined."""

    measure: Annotated[str, Meta(extra_json_schema={"const": MEASURE})]
    unit: Annotated[str, Meta(extra_json_schema={"const": "kg/s"})]
    before: float
    after: float | UnsetType = UNSET
    ratio: float | UnsetType = UNSET
    ratio_ci90: tuple[float, float] | UnsetType = UNSET
    held_out: str

    @property
    def comparison(self) -> Comparison:
        """Its numbers, where it has all of them."""
        return Comparison(**{field.name: getattr(self, field.name) for field in fields(Comparison)})


def error_output(comparison: Comparison, how: str) -> ErrorOutput:
    """Return the contract's `error`."""
    return ErrorOutput(measure=MEASURE, unit="kg/s", **vars(comparison), held_out=how)


@dataclass(frozen=True)
class ResidualOutput:
    """The residual that is left: whether it is white noise, what it correlates with, and when, where and how fast it varies."""

    white: bool
    correlated_with: tuple[str, ...]
    when: tuple[When, ...] | UnsetType = UNSET
    where: Where | UnsetType = UNSET
    frequency: Frequency | UnsetType = UNSET
    balance: str | UnsetType = UNSET


class OutcomeOnLog(Output):
    """What was found on one log; a log that was held out has no `residual`."""

    log: str
    verdict: Verdict
    effects: tuple[Finding, ...]
    error: ErrorOutput
    residual: ResidualOutput | UnsetType = UNSET
    balances: tuple[BalanceError, ...]
    day_to_day: tuple[DayLevel, ...]
    missing: Missing | UnsetType = UNSET  # what its channels cannot show

    def notes(self) -> list[str]:
        """Return what a person should know beside verdict and effects, a sentence each."""
        agreeing = ", ".join(item.balance for item in self.balances if not item.affected)
        disturbed = ", ".join(item.balance for item in self.balances if item.affected)
        said = [item.note() for item in self.balances if item.affected]
        if disturbed and agreeing:
            said.insert(
                0, f"Balances that the effects change: {disturbed}; balances that they leave alone: {agreeing}."
            )
        unusual = [level for level in self.day_to_day if abs(level.value) > level.usual]
        if unusual:
            levels = ", ".join(f"{level.name} {level.value:+.3g} {level.unit}".rstrip(" 1") for level in unusual)
            said.append(f"Differences from the healthy logs that are normal between days and no fault: {levels}.")
        return said + ([] if self.missing is UNSET else self.missing.notes())


class Outcome(Output):
    """What was found on all logs; `known_effects` are the effects that the model already had."""

    verdict: Verdict
    p_value: Annotated[
        float,
        Meta(
            description="probability that chance gives evidence this strong, corrected for the number of effects, onsets and ends"
        ),
    ]
    effects: tuple[Finding, ...]
    error: ErrorOutput
    residual: ResidualOutput
    candidates: tuple[Leading, ...] | UnsetType = UNSET
    healthy_drives: Annotated[
        tuple[str, ...], Meta(description="logs from which the residual of the healthy engine was learned")
    ]
    # where the verdict is `none`, and more healthy drives might prove something
    healthy_drives_needed: DrivesNeeded | UnsetType = UNSET
    known_effects: tuple[Finding, ...] | UnsetType = UNSET
    error_on_held_out_logs: ErrorOutput | UnsetType = UNSET
    logs: tuple[OutcomeOnLog, ...]


class StoredOutcome(Outcome):
    """What was found on all logs, as a result stores it."""

    logs_used: tuple[str, ...]
    map_frozen: bool


class Trace(Outcome):
    """What was found, with the error before and after, and what a result keeps for figures beside it."""

    ranking: tuple[Ranked, ...]  # best first
    left: Leftover | None  # what is known of what is left; None where that is white noise

    @property
    def findings(self) -> tuple[Finding, ...]:
        """The effects that are named."""
        return self.effects

    def as_json(self, refined: bool) -> dict[str, Any]:
        """Return the object of the contract as plain data, without its schema; the error after and its ratio only where refined."""
        whole = Outcome(**{field.name: getattr(self, field.name) for field in fields(Outcome)})
        content: dict[str, Any] = to_builtins(whole, enc_hook=lambda number: number.item())
        errors = [content["error"], *(part["error"] for part in content["logs"])]
        errors += [content["error_on_held_out_logs"]] if self.error_on_held_out_logs else []
        for error in () if refined else errors:
            for name in ("after", "ratio", "ratio_ci90"):
                del error[name]
        return content
