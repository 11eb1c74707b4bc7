"""What `trace` and `refine` say, as plain records and as the contract's JSON."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from lpvobs.discovery.heldout import HOW, MEASURE, Comparison


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
    id : str
    parameters : mapping of str to Parameter
    onset, end : float or None
        [s] since the start of its log; None where the effect acts from the first or to the last sample.
    explained : float
        Share of the residual's power above noise that goes with it, of what is left without it.
    p_value : float
        After all effects and intervals that were tried.
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
    explained: float
    p_value: float
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
class Ranked:
    """One line of the ranking: an effect alone against the residual of the model as it was."""

    id: str
    value: float
    unit: str
    gain: float
    unevenness: float


@dataclass(frozen=True)
class Trace:
    """What the logs hold that the model lacks.

    Attributes
    ----------
    verdict : str
        `effect`, `none` or `unexplained`.
    findings : tuple of Finding
    ranking : tuple of Ranked
        Best first.
    comparison : Comparison
    white : bool
        Of the residual that is left.
    correlated_with : mapping of str to float
        Signals that it follows, with the correlation.
    """

    verdict: str
    findings: tuple[Finding, ...]
    ranking: tuple[Ranked, ...]
    comparison: Comparison
    white: bool
    correlated_with: Mapping[str, float]

    def as_json(self, refined: bool) -> dict[str, Any]:
        """Return the object of the contract, without its schema; `after` and what follows from it only where refined."""
        error: dict[str, Any] = {"measure": MEASURE, "unit": "kg/s", "before": self.comparison.before}
        if refined:
            error |= {
                "after": self.comparison.after,
                "ratio": self.comparison.ratio,
                "ratio_ci90": list(self.comparison.ratio_ci90),
            }
        return {
            "verdict": self.verdict,
            "effects": [finding.as_json() for finding in self.findings],
            "error": error | {"held_out": HOW},
            "residual": {"white": self.white, "correlated_with": list(self.correlated_with)},
        }
