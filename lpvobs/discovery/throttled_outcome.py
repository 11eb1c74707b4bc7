"""What is said of a throttled engine's log beyond the contract's object: each balance, the day's levels, what is missing."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from lpvobs.discovery.held_out import Comparison
from lpvobs.discovery.outcome import LogPart, Trace

MEASURE = "rmse of the held-out residual"
HOW = "sizes from the other parts when each fifth block of 10 s is judged, the day's levels taken out; flows of all balances pooled"
HOW_UNSEEN = "nothing but the day's levels fitted to the log; flows of all balances pooled"


@dataclass(frozen=True)
class BalanceError:
    """One balance of one log, where the effects act; of the whole log where there is none.

    Attributes
    ----------
    balance : str
    before, after, healthy : float
        Rms of the relative residual: B as it is, A with the effects undone, N of held-out blocks of the healthy logs.
    usual_before, usual_after : float
        The same from medians: without the few blocks that lie far out.
    affected : bool
        Whether the effects move it by more than its usual error.
    """

    balance: str
    before: float
    after: float
    healthy: float
    usual_before: float
    usual_after: float
    affected: bool

    @property
    def recovered(self) -> float | None:
        """(B - A) / (B - N), None where the balance is not affected."""
        return (self.before - self.after) / (self.before - self.healthy) if self.affected else None

    def as_json(self) -> dict[str, Any]:
        """Return the balance as plain data, fractions as fractions."""
        return {
            "balance": self.balance,
            "unit": "1",
            "before": self.before,
            "after": self.after,
            "healthy": self.healthy,
            "usual_before": self.usual_before,
            "usual_after": self.usual_after,
            "affected": self.affected,
            "recovered": self.recovered,
        }


@dataclass(frozen=True)
class Level:
    """What differs from the healthy day all along a log, within what days may differ by: no fault."""

    name: str
    value: float
    unit: str
    usual: float

    def as_json(self) -> dict[str, Any]:
        """Return the level and one standard deviation of it between days."""
        return {"name": self.name, "value": self.value, "unit": self.unit, "usual": self.usual}


@dataclass(frozen=True)
class ThrottledPart(LogPart):
    """What is said of one log of a throttled engine.

    Attributes
    ----------
    balances : tuple of BalanceError
    day : tuple of Level
    missing : tuple of str
        Channels that the log does not have, and
    lost : tuple of str
        balances that cannot be drawn up without them.
    same_place : tuple of tuple of str
        Effects that move the same of the remaining balances, where some are lost: their place no longer tells them apart.
    """

    balances: tuple[BalanceError, ...]
    day: tuple[Level, ...]
    missing: tuple[str, ...]
    lost: tuple[str, ...]
    same_place: tuple[tuple[str, ...], ...]

    def as_json(self, refined: bool) -> dict[str, Any]:
        """Return the contract's object for this log, and what is known of its balances."""
        shown: dict[str, Any] = {
            "log": self.log,
            "verdict": self.verdict,
            "effects": [finding.as_json() for finding in self.findings],
            "error": _error(self.comparison, refined, HOW_UNSEEN if self.own is None else HOW),
        }
        if self.own is not None:
            shown["residual"] = {"white": self.own.white, "correlated_with": list(self.own.correlated_with)}
        shown["balances"] = [item.as_json() for item in self.balances]
        shown["day_to_day"] = [item.as_json() for item in self.day]
        if self.missing:
            shown["missing"] = {
                "channels": list(self.missing),
                "balances": list(self.lost),
                "same_place": [list(group) for group in self.same_place],
            }
        return shown

    def notes(self) -> list[str]:
        """Return what a person should know beside verdict and effects, a sentence each."""
        agreeing = [item.balance for item in self.balances if not item.affected]
        moved = [item for item in self.balances if item.affected]
        said = []
        if moved and agreeing:
            said.append(
                f"{', '.join(item.balance for item in moved)} moved; still in agreement: {', '.join(agreeing)}."
            )
        said += [
            f"{item.balance}: {100 * item.before:.1f} % rms before, {100 * item.after:.1f} % after, healthy "
            f"{100 * item.healthy:.1f} %: {100 * (item.recovered or 0.0):.0f} % recovered."
            for item in moved
        ]
        unusual = [level for level in self.day if abs(level.value) > level.usual]
        if unusual:
            levels = ", ".join(f"{level.name} {level.value:+.3g} {level.unit}".rstrip(" 1") for level in unusual)
            said.append(f"Different from the healthy day, but no fault: {levels}.")
        if self.lost:
            said.append(f"Without {', '.join(self.missing)} there is no balance {', '.join(self.lost)}.")
            said += [
                f"By their place alone these cannot be told apart: {', '.join(group)}." for group in self.same_place
            ]
        return said


@dataclass(frozen=True)
class ThrottledTrace(Trace):
    """What the logs of a throttled engine hold that the model lacks; every log is judged by itself."""

    def as_json(self, refined: bool) -> dict[str, Any]:
        """Return the object of the contract, without its schema."""
        shown: dict[str, Any] = {
            "verdict": self.verdict,
            "effects": [finding.as_json() for finding in self.findings],
            "error": _error(self.comparison, refined, HOW),
            "residual": {"white": self.white, "correlated_with": list(self.correlated_with)},
        }
        if self.standing:
            shown["standing"] = [finding.as_json() for finding in self.standing]
        if self.held_out is not None:
            shown["error_on_held_out_logs"] = _error(self.held_out, refined, HOW_UNSEEN)
        parts = [part.as_json(refined) for part in self.logs]
        if len(parts) == 1:
            shown |= {key: parts[0][key] for key in ("balances", "day_to_day", "missing") if key in parts[0]}
        return shown | {"logs": parts}


def _error(comparison: Comparison, refined: bool, how: str) -> dict[str, Any]:
    shown: dict[str, Any] = {"measure": MEASURE, "unit": "kg/s", "before": comparison.before}
    if refined:
        shown |= {
            "after": comparison.after, "ratio": comparison.ratio, "ratio_ci90": list(comparison.ratio_ci90),
        }  # fmt: skip
    return shown | {"held_out": how}


def levels_of(names: tuple[str, ...], values: Mapping[str, float], usual: Mapping[str, float]) -> tuple[Level, ...]:
    """Return the day's levels in their units: fractions for balances, the effect's own unit otherwise."""
    units = {"p_im.offset": "Pa", "p_ic.offset": "Pa", "alpha_th.offset": "%", "maf.delay": "s"}
    return tuple(Level(name, values[name], units.get(name, "1"), usual[name]) for name in names)
