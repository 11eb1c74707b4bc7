"""The outcome of `trace` and `refine`, as plain records and as the contract's JSON."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from lpvobs.discovery.held_out import HOW, HOW_WHOLE, MEASURE, Comparison
from lpvobs.discovery.leftover import Leftover
from lpvobs.discovery.whiteness import Whiteness


@dataclass(frozen=True)
class Parameter:
    """An estimated parameter with its 90 % interval."""

    value: float
    unit: str
    ci90: tuple[float, float]


@dataclass(frozen=True)
class Finding:
    """One effect.

    Attributes
    ----------
    onset, end : float or None
        [s] since the start of its log; None where the effect acts from the first or to the last sample.
    explained : float or None
        Share of the residual's power above noise, without the effect, that the effect explains; None for an effect that the model
        had already.
    p_value : float or None
        Corrected for all effects and intervals that were tried.
    indistinguishable : tuple of str
        Effects that explain these logs as well.
    drive : str
        What kind of drive would tell them apart.
    curve : mapping of str to list, or None
        For a channel: what follows it, knots and values.
    """

    id: str
    parameters: Mapping[str, Parameter]
    onset: float | None
    end: float | None
    explained: float | None
    p_value: float | None
    indistinguishable: tuple[str, ...]
    drive: str
    curve: Mapping[str, Any] | None

    def as_json(self) -> dict[str, Any]:
        """Return the finding as in the contract; `drive` and `curve` are added where they say something."""
        shown: dict[str, Any] = {
            "id": self.id,
            "parameters": {
                name: {"value": p.value, "unit": p.unit, "ci90": list(p.ci90)} for name, p in self.parameters.items()
            },
            "onset": self.onset,
            "end": self.end,
            "explained": self.explained,
            "p_value": self.p_value,
            "indistinguishable": list(self.indistinguishable),
        }
        if self.indistinguishable:
            shown["drive"] = self.drive
        if self.curve is not None:
            shown["curve"] = dict(self.curve)
        return shown


@dataclass(frozen=True)
class BalanceError:
    """One balance of one log, where the effects act; of the whole log where there is none.

    Attributes
    ----------
    before, after : float
        Rms of the residual without the effects (B) and with them accounted for (A).
    healthy : float or None
        The same on held-out parts of the healthy logs (N); None where there are none.
    usual_before, usual_after : float
        The same from medians, which ignore a few outliers.
    affected : bool
        Whether the effects move it by more than its usual error.
    """

    balance: str
    unit: str
    before: float
    after: float
    healthy: float | None
    usual_before: float
    usual_after: float
    affected: bool

    @property
    def recovered(self) -> float | None:
        """(B - A) / (B - N) with the healthy error N, None where the balance is not affected or nothing says what is healthy."""
        if not self.affected or self.healthy is None:
            return None
        return (self.before - self.after) / (self.before - self.healthy)

    def as_json(self) -> dict[str, Any]:
        """Return the balance as plain data, fractions as fractions."""
        return asdict(self) | {"recovered": self.recovered}

    def note(self) -> str:
        """Return a sentence on its error before and after."""
        times, unit = (100.0, "%") if self.unit == "1" else (1e3, "g/s")
        said = f"{self.balance}: the error goes from {times * self.before:.2g} {unit} rms to {times * self.after:.2g} {unit}"
        if self.healthy is None or self.recovered is None:
            return f"{said}."
        return f"{said}; a healthy engine has {times * self.healthy:.2g} {unit}, so {100 * self.recovered:.0f} % is recovered."


@dataclass(frozen=True)
class DayLevel:
    """What differs from the healthy day all along a log and is no fault; `usual` is one standard deviation between days."""

    name: str
    value: float
    unit: str
    usual: float


@dataclass(frozen=True)
class Missing:
    """What the channels of a log cannot show.

    Attributes
    ----------
    channels, balances : tuple of str
        Channels that the log does not have, and balances that cannot be drawn up without them.
    same_place : tuple of tuple of str
        Effects that move the same of the remaining balances, so that their place no longer tells them apart.
    """

    channels: tuple[str, ...]
    balances: tuple[str, ...]
    same_place: tuple[tuple[str, ...], ...]

    def notes(self) -> list[str]:
        """Return sentences on it."""
        lost = f"Without {', '.join(self.channels)} there is no balance {', '.join(self.balances)}."
        return [
            lost,
            *(
                f"The remaining balances cannot tell these apart by their place: {', '.join(group)}."
                for group in self.same_place
            ),
        ]


@dataclass(frozen=True)
class Ranked:
    """One line of the ranking: an effect alone against the residual of the model as it was."""

    id: str
    value: float
    unit: str
    gain: float
    unevenness: float


@dataclass(frozen=True)
class LogPart:
    """The outcome on one log of several.

    Attributes
    ----------
    findings : tuple of Finding
        Those of the pooled logs that act on it, with onset and end on it.
    own : Whiteness or None
        Structure of what is left of its residual; None for a log that took no part.
    missing : Missing or None
        What its channels cannot show.
    """

    log: str
    verdict: str
    findings: tuple[Finding, ...]
    comparison: Comparison
    own: Whiteness | None
    balances: tuple[BalanceError, ...] = ()
    day: tuple[DayLevel, ...] = ()
    missing: Missing | None = None

    def notes(self) -> list[str]:
        """Return what a person should know beside verdict and effects, a sentence each."""
        agreeing = [item.balance for item in self.balances if not item.affected]
        moved = [item for item in self.balances if item.affected]
        said = [item.note() for item in moved]
        if moved and agreeing:
            disturbed = ", ".join(item.balance for item in moved)
            said.insert(0, f"Balances that the effects disturb: {disturbed}; undisturbed: {', '.join(agreeing)}.")
        unusual = [level for level in self.day if abs(level.value) > level.usual]
        if unusual:
            levels = ", ".join(f"{level.name} {level.value:+.3g} {level.unit}".rstrip(" 1") for level in unusual)
            said.append(f"The day differs from the healthy one, which is no fault: {levels}.")
        return said + ([] if self.missing is None else self.missing.notes())

    def as_json(self, refined: bool) -> dict[str, Any]:
        """Return the contract's object for this log, and what is known of its balances and its day."""
        shown: dict[str, Any] = {
            "log": self.log,
            "verdict": self.verdict,
            "effects": [finding.as_json() for finding in self.findings],
            "error": error_content(self.comparison, refined, HOW_WHOLE if self.own is None else HOW),
        }
        if self.own is not None:
            shown["residual"] = {"white": self.own.white, "correlated_with": list(self.own.correlated_with)}
        shown["balances"] = [item.as_json() for item in self.balances]
        shown["day_to_day"] = [asdict(item) for item in self.day]
        if self.missing is not None:
            shown["missing"] = asdict(self.missing)
        return shown


@dataclass(frozen=True)
class Trace:
    """What the logs hold that the model lacks.

    Attributes
    ----------
    verdict : str
        `effect`, `none` or `unexplained`.
    ranking : tuple of Ranked
        Best first.
    white : bool
        Of the residual that is left.
    correlated_with : mapping of str to float
        Signals that it follows, with the correlation.
    known_effects : tuple of Finding
        Effects that the model had already, estimated again.
    logs : tuple of LogPart
        One for each log, then one for each log held out.
    held_out : Comparison or None
        Of all logs held out together.
    left : Leftover or None
        What is known of what is left; None where that is white noise.
    """

    verdict: str
    findings: tuple[Finding, ...]
    ranking: tuple[Ranked, ...]
    comparison: Comparison
    white: bool
    correlated_with: Mapping[str, float]
    known_effects: tuple[Finding, ...]
    logs: tuple[LogPart, ...]
    held_out: Comparison | None
    left: Leftover | None

    def as_json(self, refined: bool) -> dict[str, Any]:
        """Return the object of the contract, without its schema; `after` and what follows from it only where refined."""
        shown: dict[str, Any] = {
            "verdict": self.verdict,
            "effects": [finding.as_json() for finding in self.findings],
            "error": error_content(self.comparison, refined, HOW),
            "residual": {"white": self.white, "correlated_with": list(self.correlated_with)},
        }
        if self.left is not None:
            shown["residual"] |= self.left.as_json()
        if self.known_effects:
            shown["known_effects"] = [finding.as_json() for finding in self.known_effects]
        if self.held_out is not None:
            shown["error_on_held_out_logs"] = error_content(self.held_out, refined, HOW_WHOLE)
        return shown | {"logs": [part.as_json(refined) for part in self.logs]}


def error_content(comparison: Comparison, refined: bool, how: str) -> dict[str, Any]:
    """Return the contract's `error`."""
    shown: dict[str, Any] = {"measure": MEASURE, "unit": "kg/s", "before": comparison.before}
    if refined:
        shown |= {
            "after": comparison.after,
            "ratio": comparison.ratio,
            "ratio_ci90": list(comparison.ratio_ci90),
        }
    return shown | {"held_out": how}
