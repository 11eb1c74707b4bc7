"""Numbers, effects, cycles and methods as a person would say them: `the MAF reads 9.65 % high (90 %: 9.51 to 9.79) from 122.0 s`.

Words that are a table beside the code are in `phrases.toml`.
"""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from lpvobs.engines.base import MapAxis
from lpvobs.engines.registry import ENGINES
from lpvobs.maps.joint import NORMAL_90, combined
from lpvobs.observer.balance_agreement import DISAGREE
from lpvobs.observer.estimate import MapEstimate
from lpvobs.records import Array

LEAST_CHANCE = 1e-16


@dataclass(frozen=True)
class Phrase:
    """Words for one parameter of an effect, or for its course, as `phrases.toml` explains them."""

    words: str
    times: float = 1.0
    null: float = 0.0


PHRASES = msgspec.toml.decode(
    files("lpvobs.report").joinpath("phrases.toml").read_bytes(), type=dict[str, dict[str, Phrase]]
)


def with_interval(value: float, low: float, high: float) -> tuple[str, str, str]:
    """Return a value and the ends of its interval, with two digits of the interval's half width.

    Examples
    --------
    >>> with_interval(0.080347, 0.079661, 0.081034)
    ('0.08035', '0.07966', '0.08103')
    >>> with_interval(1.998e-05, 1.994e-05, 2.002e-05)
    ('1.9980e-05', '1.9940e-05', '2.0020e-05')
    >>> with_interval(1456.2, 1451.0, 1461.4)
    ('1456.2', '1451.0', '1461.4')
    """
    half = 0.5 * (high - low)
    if not (math.isfinite(half) and half > 0.0):
        return f"{value:.4g}", f"{low:.4g}", f"{high:.4g}"
    last = math.floor(math.log10(half)) - 1
    largest = max(abs(value), abs(low), abs(high))
    if largest < 1e-3 or largest >= 1e6:
        shown = f".{max(math.floor(math.log10(largest)) - last, 0)}e"
    else:
        shown = f"z.{max(-last, 0)}f"
    return format(value, shown), format(low, shown), format(high, shown)


def chance(p: float | None) -> str:
    """Return a p-value; a dash where there is none.

    Examples
    --------
    >>> chance(0.0), chance(0.00012), chance(None)
    ('< 1e-16', '0.0001', '-')
    """
    if p is None:
        return "-"
    return f"< {LEAST_CHANCE:.0e}" if p < LEAST_CHANCE else f"{p:.1g}"


def second(time: float | None) -> str:
    """Return a time with a tenth of a second, a dash where there is none."""
    return "-" if time is None else f"{time:.1f}"


SHOWS_LITTLE = 0.2  # slope of the sensor's error: where only a larger one would be seen, nobody learns from the figure
MOST_TIMES = 4  # intervals that are told


def headline(
    found: MapEstimate, axes: tuple[MapAxis, MapAxis], driven: tuple[Array, float], disagreement: float
) -> str:
    """Return in one sentence what a map says that informs at least one node.

    `driven` is the share of the time that each node stands for, shape (p,), and the mean air flow [kg/s]; `disagreement` is the
    ratio of the balances over all logs.
    """
    grid, values, covariance, along = found.grid, found.theta.ravel(), found.covariance, found.along_flow
    (weights, flow), on = driven, np.flatnonzero(found.supported)
    sure = bool(np.isfinite(covariance[np.ix_(on, on)]).all())
    mean = float(weights[on] @ values[on])
    shown, interval = f"{1e3 * mean:.2g}", ""
    if sure:
        ends = combined(weights[None], values, covariance).ci90[0]
        shown, low, high = with_interval(*(1e3 * float(x) for x in (mean, *ends)))
        interval = f" (90 %: {low} to {high})"
    side = "high" if mean > 0.0 else "low"
    share = f"{abs(100.0 * mean / flow):.2g} % {side}, " if flow > 0.0 else ""
    worst = int(on[np.argmax(np.abs(values[on]))])
    row, column = np.unravel_index(worst, grid.shape)
    place = f"{spelled(grid.speed[row], axes[1])}, {spelled(grid.fuel[column], axes[0])}"
    said = [
        f"the sensor reads {share}{shown} g/s on average{interval}",
        f"largest error {1e3 * values[worst]:+.2g} g/s at {place}",
    ]
    if sure:
        known = 1e3 * NORMAL_90 * float(np.median(np.sqrt(np.diag(covariance)[on])))
        said.append(f"half of the {on.size} nodes are known to +-{known:.2g} g/s (90 %)")
    if math.isfinite(disagreement):
        agree = disagreement <= DISAGREE
        differ = f"the air flow balances differ by {disagreement:.1f} times the allowed difference"
        said.append("the air flow balances agree" if agree else differ)
    if along is not None:
        slope = f"at one operating point the error changes by {100 * along.slope:+.2g} % of a change of the air flow"
        hidden = f"a gain error of less than about {100 * along.least:.2g} % cannot be told from the engine's constants"
        if along.least > SHOWS_LITTLE:
            hidden = "these logs do not show whether the sensor's gain is wrong"
        said.append(f"{slope} (90 %: +-{100 * NORMAL_90 * along.standard_error:.2g} %)" if along.slope else hidden)
    return "; ".join(said)


def spelled(value: float, axis: MapAxis) -> str:
    """Return a value of an axis with its unit; one without a unit has its name."""
    return f"{axis.channel} {value:g}" if axis.unit == "1" else f"{value:g} {axis.unit}"


def in_words(effects: Sequence[Mapping[str, Any]]) -> str:
    """Return what is wrong, of effects as in the contract's JSON, without a full stop."""
    return "; ".join(f"{_what(effect)}{_when(effect)}{_instead(effect)}" for effect in effects)


def _what(effect: Mapping[str, Any]) -> str:
    name = str(effect["id"])
    if name.startswith("channel:") and effect.get("curve"):
        return f"{effect['curve']['changes']} changes with the logged channel {name.removeprefix('channel:')}"
    if "formula" in effect:
        return f"{effect['formula']} ({_plain('coefficient', effect['parameters']['coefficient'])})"
    of, _, kind = name.partition(".")
    parameters, kinds = effect["parameters"], PHRASES["kind"]
    unit = next(iter(parameters.values()))["unit"]
    phrase = PHRASES["identifier"].get(name) or kinds.get(kind) or kinds.get(f"{kind} {unit}")
    if phrase is None or len(parameters) != 1:
        return f"effect {name} acts with {', '.join(_plain(key, value) for key, value in parameters.items())}"
    (parameter,) = parameters.values()
    sign = 1.0 if parameter["value"] >= phrase.null else -1.0
    sizes = [sign * phrase.times * (x - phrase.null) for x in (parameter["value"], *parameter["ci90"])]
    value, low, high = with_interval(sizes[0], min(sizes[1:]), max(sizes[1:]))
    words = re.sub(r"\[(.*?)\|(.*?)\]", r"\1" if sign > 0.0 else r"\2", phrase.words)
    said = words.format(value, name="the MAF" if of == "maf" else of)
    if curve := effect.get("surface"):
        where = zip(curve["inputs"], curve["largest_at"], curve["units"], strict=True)
        said += " around " + ", ".join(f"{name} = {x:.3g} {unit}".removesuffix(" 1") for name, x, unit in where)
    return f"{said} (90 %: {low} to {high})"


def _plain(name: str, parameter: Mapping[str, Any]) -> str:
    value, low, high = with_interval(parameter["value"], *parameter["ci90"])
    unit = "" if parameter["unit"] == "1" else f" {parameter['unit']}"
    return f"{name} = {value}{unit} (90 %: {low} to {high})"


def _when(effect: Mapping[str, Any]) -> str:
    begin = "" if effect["onset"] is None else f" from {effect['onset']:.1f} s"
    if (by := effect.get("follows")) is None:
        return begin + ("" if effect["end"] is None else f" to {effect['end']:.1f} s")
    if effect["course"] == "intermittent":
        times = ", ".join(f"{max(a, 0.0):.0f} to {b:.0f} s" for a, b in by["intervals"][:MOST_TIMES])
        return f" in {len(by['intervals'])} intervals: {times}{', ...' if len(by['intervals']) > MOST_TIMES else ''}"
    return PHRASES["course"][effect["course"]].words.format(begin=begin or " from the start", **by)


def _instead(effect: Mapping[str, Any]) -> str:
    others = effect["indistinguishable"]
    return f" ({', '.join(others)} explain{'s' if len(others) == 1 else ''} this as well)" if others else ""


def cycle_title(log: str) -> str:
    """Return the name of a log for people; a cycle that stands in for the ETC is called so.

    Examples
    --------
    >>> cycle_title("etc_part1")
    'ETC surrogate, part 1'
    >>> cycle_title("etc_b")
    'ETC surrogate (etc_b)'
    >>> cycle_title("road_17")
    'road_17'
    """
    known = _cycle_of(log) or ("etc" if log.startswith("etc") else log)
    title = PHRASES["cycle"].get(known, Phrase(log)).words
    return title if known == log else f"{title} ({log})"


def method_title(method: str) -> str:
    """Return what a method is for a reader who does not know its identifier."""
    return PHRASES["method"].get(method, Phrase(f"method {method}")).words


def paper_error(air_path: str, log: str) -> float | None:
    """Return the mean relative error that is printed for the engine and the cycle that a log is named after, or None."""
    printed = ENGINES[air_path].published
    return None if printed is None else printed.errors.get(_cycle_of(log) or "")


def distinct(paths: list[Path]) -> list[str]:
    """Return a name for each file: its stem, or its whole path where two stems are alike."""
    stems = [path.stem for path in paths]
    return [stem if stems.count(stem) == 1 else str(path) for stem, path in zip(stems, paths, strict=True)]


def _cycle_of(log: str) -> str | None:
    """Return the longest cycle name that the log's name is, or begins with before `_` or `-`."""
    fits = [name for name in PHRASES["cycle"] if log == name or log.startswith((f"{name}_", f"{name}-"))]
    return max(fits, key=len, default=None)
