"""What the verdicts of the second bank are worth, by the rules of `rules.md`."""

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.interpolate
import scipy.stats

MOST_ALIKE = 3
SMALL = 0.01
"""True change of a flow or reading below which an effect is a small one."""
SHOWS = 1.1
"""B over N from which the recovered share is judged: below it a difference of two errors is divided by one of noise."""
GROWING = frozenset({"ramp", "saturating", "lagged"})
"""Courses that a drive may not tell apart: each takes the others' place."""
FOLLOWERS = {"maf.temperature": "T_amb"}
"""Listed effects on the reading that are a function of a channel, and the channel."""
RIGHT = ("found", "found as a drift", "found as a listed effect")
LIMITS = (0.01, 0.02, 0.05, 0.1, 0.2, 0.3, 0.5, 0.7, 0.9)


@dataclass(frozen=True)
class Row:
    """How often something held, and how often it should: at least `wanted` and at most `most`."""

    what: str
    held: Sequence[bool]
    wanted: float
    most: float = 1.0

    def cells(self) -> list[str]:
        """Return the cells of the table, with the 90 % interval of Wilson."""
        goal = f">= {self.wanted:.0%}" if self.most == 1.0 else f"{self.wanted:.0%} to {self.most:.0%}"
        if self.wanted == 0.0:
            goal = f"<= {self.most:.0%}" if self.most < 1.0 else "-"
        seen, of = sum(map(bool, self.held)), len(self.held)
        if not of:
            return [self.what, "0", "0", "-", "-", goal]
        interval = scipy.stats.binomtest(seen, of).proportion_ci(0.90, "wilson")
        return [self.what, str(seen), str(of), f"{seen / of:.1%}", f"{interval.low:.1%} to {interval.high:.1%}", goal]


@dataclass(frozen=True)
class Seen:
    """A drive's truth, its verdict, and the verdict on the same drive without its effects where that was traced."""

    truth: Mapping[str, Any]
    verdict: Mapping[str, Any]
    twin: Mapping[str, Any] | None = None

    @property
    def kind(self) -> str:
        """Kind of the drive."""
        return str(self.truth["kind"])

    @property
    def named(self) -> list[Mapping[str, Any]]:
        """The effects of the verdict."""
        return list(self.verdict["effects"])

    def finds(self, id_: str) -> bool:
        """Return whether an effect is named, or in a set of three at most."""
        return any(_may_be(effect, id_) for effect in self.named)

    @property
    def finds_first(self) -> bool:
        """Whether the first of its effects is named."""
        return self.finds(self.truth["effects"][0]["id"])

    @property
    def finds_all(self) -> bool:
        """Whether every one of its effects is named."""
        return all(self.finds(each["id"]) for each in self.truth["effects"])

    @property
    def all_large(self) -> bool:
        """Whether each of its effects, by itself, changes a flow or reading by more than that of a small one."""
        return all(each["change"] >= SMALL for each in self.truth["effects"])

    @property
    def only_right(self) -> bool:
        """Whether every true effect is found and nothing beside them."""
        return self.finds_all and len(self.named) == len(self.truth["effects"])

    @property
    def formula(self) -> str:
        """What became of an unlisted form: found, found as a listed effect, unexplained, wrong or none."""
        if self.verdict["verdict"] != "effect":
            return str(self.verdict["verdict"])
        channels = self.truth["channels"]
        formulas = [_follows(effect, channels) for effect in self.named]
        right = all(each or _listed_follows(e, channels) for each, e in zip(formulas, self.named, strict=True))
        if not right or (self.recovered is not None and self.recovered < 0.5):
            return "wrong"
        return "found" if all(formulas) else "found as a listed effect"

    @property
    def course(self) -> str:
        """What became of an unlisted course: found, found as a drift, name alone, unexplained, wrong or none."""
        if self.verdict["verdict"] != "effect":
            return str(self.verdict["verdict"])
        (effect,), said = self.truth["effects"], [each["id"] for each in self.named]
        if said == [effect["id"].replace(".gain", ".drift")] != [effect["id"]] and effect["course"] in GROWING:
            return "found as a drift"
        if not self.only_right:
            return "wrong"
        said, true = self.named[0].get("course", "always"), effect["course"]
        same = said == true or (said in GROWING and true in GROWING)
        return "found" if same else "name alone"

    @property
    def recovered(self) -> float | None:
        """(B - A) / (B - N) on stretches that no decision saw; None where N is not known, or B no clear multiple of it."""
        if self.twin is None or "after" not in self.verdict.get("error", {}) or "error" not in self.twin:
            return None
        B, A, N = self.verdict["error"]["before"], self.verdict["error"]["after"], self.twin["error"]["before"]
        return float((B - A) / (B - N)) if B >= SHOWS * N else None

    @property
    def curve_error(self) -> float | None:
        """Rms error of a component's curve over its true amplitude, at instants of the drive; None where it was not named."""
        true, wanted = self.truth["curve"], self.truth["effects"][0]["id"]
        surfaces = [effect["surface"] for effect in self.named if effect["id"] == wanted and "surface" in effect]
        if not surfaces:
            return None
        knots = [np.array(axis) for axis in surfaces[0]["knots"]]
        at = [np.clip(x, axis[0], axis[-1]) for x, axis in zip(true["inputs"], knots, strict=True)]
        found = scipy.interpolate.RegularGridInterpolator(knots, np.array(surfaces[0]["factor"]))(np.stack(at, 1))
        return float(np.sqrt(np.mean((found - true["factor"]) ** 2)) / abs(true["amplitude"]))

    def sizes(self) -> Iterable[tuple[bool, str, float]]:
        """Yield whether the interval of each true effect that is named holds its size, and the relative error."""
        for true in self.truth["effects"]:
            for effect in self.named:
                if effect["id"] == true["id"] and true["parameter"] in effect["parameters"]:
                    found = effect["parameters"][true["parameter"]]
                    low, high = found["ci90"]
                    neutral = 1.0 if true["parameter"] == "factor" else 0.0
                    error = (found["value"] - true["value"]) / (true["value"] - neutral)
                    yield low <= true["value"] <= high, str(true["id"]), float(error)

    def line(self) -> str:
        """Return one line for a list of misses."""
        t = self.truth
        listed = [f"{e['id']} {e['value']:.4g} {e['course']} from {e['onset']}" for e in t["effects"]]
        true = "; ".join([*listed, *t["unlisted"]]) or "nothing"
        p = self.verdict.get("p_value")
        said = "; ".join(_said(effect) for effect in self.named)
        return (
            f"{t['number']} {t['kind']} (engine {t['engine']} {t['variation']}{' today alone' * t['only_today']}, {t['piece'][0]} "
            f"{t['piece'][1]:.0f}, change {100 * t['change']:.1f} %): {true} -> {self.verdict['verdict']}"
            f"{' p ' + format(p, '.1e') if p is not None else ''} {said} {self.verdict.get('said', '')}".rstrip()
        )


def _may_be(effect: Mapping[str, Any], id_: str) -> bool:
    alike = [effect["id"], *effect["indistinguishable"]]
    return bool(effect["id"] == id_ or (id_ in alike and len(alike) <= MOST_ALIKE))


def _follows(effect: Mapping[str, Any], channels: Sequence[str]) -> bool:
    """Return whether a form or a channel's curve has one of the channels, or a set of three at most holds one that does."""
    alike = [effect["id"], *effect["indistinguishable"]]
    texts = [each.partition(":")[2] for each in (alike if len(alike) <= MOST_ALIKE else alike[:1])]
    named = any(set(re.findall(r"[A-Za-z_]\w*", text)) & set(channels) for text in texts)
    return named and effect["id"].startswith(("form:", "channel:"))


def _listed_follows(effect: Mapping[str, Any], channels: Sequence[str]) -> bool:
    """Return whether a listed effect on the reading is a function of one of the channels, or a gain that follows one."""
    on_course = effect.get("follows", {}).get("input") if effect["id"] == "maf.gain" else None
    return FOLLOWERS.get(effect["id"], on_course) in channels


def _said(effect: Mapping[str, Any]) -> str:
    name, size = next(iter(effect["parameters"].items()), ("", {"value": float("nan")}))
    like = f" like {', '.join(effect['indistinguishable'])}" if effect["indistinguishable"] else ""
    onset = "" if effect.get("onset") is None else f" from {effect['onset']:.0f} s"
    return f"{effect['id']} {name} {size['value']:.4g}{onset} {effect.get('course', '')}{like}".rstrip()


def rows(seen: Sequence[Seen]) -> list[Row]:
    """Return the rows of the table that the bank is for."""
    of = {
        kind: [s for s in seen if s.kind == kind]
        for kind in ("clean", "varied", "single", "pair", "curve", "course", "form")
    }
    alike = [s for s in of["varied"] if not s.truth["only_today"]]
    today = [s for s in of["varied"] if s.truth["only_today"]]
    twins = [s.twin for s in seen if s.twin is not None]
    silent = [*(s.verdict for s in of["clean"]), *twins]
    nothing = [*silent, *(s.verdict for s in of["varied"])]
    large = [s for s in of["single"] if s.truth["change"] >= SMALL]
    small = [s for s in of["single"] if s.truth["change"] < SMALL]
    forms, courses = [s.formula for s in of["form"]], [s.course for s in of["course"]]
    found = [*forms, *courses]
    sized = [inside for s in (*of["single"], *of["pair"]) for inside, _, _ in s.sizes()]
    p_values = [v["p_value"] for v in [*silent, *(s.verdict for s in alike)] if v.get("p_value") is not None]
    errors = [s.verdict["error"]["ratio"] for s in seen if "ratio" in s.verdict.get("error", {})]
    recovered = [s.recovered for s in seen if s.recovered is not None]
    pace = paces(seen)
    return [
        Row("clean: `none`", [v["verdict"] == "none" for v in silent], 0.98),
        Row("- of them drives drawn clean", [s.verdict["verdict"] == "none" for s in of["clean"]], 0.98),
        Row("- of them faulty drives once more without their effects", [v["verdict"] == "none" for v in twins], 0.98),
        Row(
            "healthy variations, in the healthy drives too: `none`",
            [s.verdict["verdict"] == "none" for s in alike],
            0.97,
        ),
        *(
            Row(f"- {name}", [s.verdict["verdict"] == "none" for s in alike if s.truth["variation"] == name], 0.93)
            for name in sorted({str(s.truth["variation"]) for s in alike})
        ),
        Row(
            "healthy variations, today alone: `none` or `unexplained`",
            [s.verdict["verdict"] in ("none", "unexplained") for s in today],
            0.97,
        ),
        Row(
            "single effect, true change above 1 %: named right, nothing beside it", [s.only_right for s in large], 0.85
        ),
        Row("- named right, whatever stands beside it", [s.finds_first for s in large], 0.85),
        Row("- small ones, below 1 %: the same", [s.only_right for s in small], 0.0),
        Row(
            "- small ones: a wrong name",
            [bool(s.named) and not s.finds_first for s in small],
            0.0,
            0.03,
        ),
        Row(
            "wrong name where nothing in the catalogue is true",
            [*(bool(v["effects"]) for v in nothing), *(form == "wrong" for form in forms)],
            0.0,
            0.03,
        ),
        Row("size inside its 90 % interval", sized, 0.85, 0.95),
        Row("pairs: both found", [s.finds_all for s in of["pair"]], 0.80),
        Row("- of them each above 1 % by itself", [s.finds_all for s in of["pair"] if s.all_large], 0.0),
        *(
            Row(f"component curves, true change {where} 1 %: named", [s.finds_first for s in curves], wanted)
            for where, curves, wanted in (
                ("above", [s for s in of["curve"] if s.truth["change"] >= SMALL], 0.90),
                ("below", [s for s in of["curve"] if s.truth["change"] < SMALL], 0.0),
            )
        ),
        Row("unlisted forms and courses: found", [each in RIGHT for each in found], 0.60),
        Row("- formulas: found", [each in RIGHT for each in forms], 0.60),
        Row("- of them a listed effect that follows the channel", [each == RIGHT[2] for each in forms], 0.0),
        Row("- courses: found", [each in RIGHT for each in courses], 0.60),
        Row("- of them a gain that grows, named as a drift", [each == "found as a drift" for each in courses], 0.0),
        Row("- courses: name right, course not", [each == "name alone" for each in courses], 0.0),
        Row("- `unexplained`", [each == "unexplained" for each in found], 0.0),
        Row("- `none`", [each == "none" for each in found], 0.0),
        Row("- wrong name", [each == "wrong" for each in found], 0.0, 0.03),
        Row("error after over before at most 1.05, unseen stretches", [ratio <= 1.05 for ratio in errors], 1.0),
        Row(f"(B - A)/(B - N) at least 0.7, where B >= {SHOWS} N", [share >= 0.7 for share in recovered], 0.90),
        Row("`p_value` below 0.01 on clean drives", [p < 0.01 for p in p_values], 0.0, 0.02),
        Row("`p_value` below 0.1 on clean drives", [p < 0.1 for p in p_values], 0.0, 0.13),
        Row("at most 15 s of CPU for 15 minutes of driving", [seconds <= 15.0 for seconds in pace], 1.0),
        Row("judged at all", [s.verdict["verdict"] != "refused" for s in seen], 1.0),
    ]


def paces(seen: Sequence[Seen]) -> list[float]:
    """Return seconds of CPU of a refinement over a quarter of an hour of driving."""
    return [900.0 * s.verdict["seconds"] / s.truth["length"] for s in seen]


def page(seen: Sequence[Seen]) -> str:
    """Return the tables of the page."""
    header = ["what", "seen", "of", "rate", "90 % interval", "wanted"]
    clean = [s.verdict for s in seen if s.kind == "clean" or (s.kind == "varied" and not s.truth["only_today"])]
    clean += [s.twin for s in seen if s.twin is not None]
    p_values = np.array([v["p_value"] for v in clean if v.get("p_value") is not None])
    pace, ratios = paces(seen), [s.verdict["error"]["ratio"] for s in seen if "ratio" in s.verdict.get("error", {})]
    known = [error for s in seen if s.kind == "curve" and (error := s.curve_error) is not None]
    missed = [s for s in seen if not _fine(s)]
    parts = [
        f"{len(seen)} drives: "
        + ", ".join(f"{n} {kind}" for kind, n in Counter(s.kind for s in seen).most_common())
        + ".",
        _table(header, [row.cells() for row in rows(seen)]),
        f"Error after over before on unseen stretches: median {np.median(ratios):.3f}, worst {max(ratios):.3f}. CPU of a "
        f"refinement for 15 minutes of driving: median {np.median(pace):.1f} s, largest {max(pace):.1f} s.",
        "Component curves: rms of the curve's error over its amplitude, where the drive went, of those named: "
        + (", ".join(f"{error:.0%}" for error in known) or "none named")
        + f"; at most 25 % in {sum(error <= 0.25 for error in known)} of {len(known)} (wanted: all).",
        f"### `p_value` on {p_values.size} clean drives\n\n"
        + _table(
            ["p", *map(str, LIMITS)], [["share below", *(f"{np.mean(p_values < limit):.2f}" for limit in LIMITS)]]
        ),
        "### Sizes\n\n" + _sizes(seen),
        "### Misses\n\n" + "\n".join(f"- {s.line()}" for s in missed),
    ]
    suspected = [s for s in seen if s.twin is not None and s.twin["verdict"] != "none"]
    parts.append(
        "### Without their effects, and yet not `none`\n\n"
        + (
            "\n".join(
                f"- {s.truth['number']}: {s.twin['verdict']} {'; '.join(map(_said, s.twin['effects']))}"
                for s in suspected
                if s.twin
            )
            or "None."
        )
    )
    return "\n\n".join(parts)


def _fine(s: Seen) -> bool:
    if s.kind in ("clean", "varied"):
        return s.verdict["verdict"] == "none" or (bool(s.truth["only_today"]) and s.verdict["verdict"] == "unexplained")
    if s.kind in ("form", "course"):
        return (s.formula if s.kind == "form" else s.course) in RIGHT
    return s.only_right


def _sizes(seen: Sequence[Seen]) -> str:
    by: dict[str, list[tuple[bool, float]]] = {}
    for s in seen:
        for inside, id_, error in s.sizes() if s.kind in ("single", "pair", "course") else ():
            by.setdefault(id_, []).append((inside, error))
    lines = [
        [id_, str(len(all_)), str(sum(inside for inside, _ in all_)), f"{np.median([abs(e) for _, e in all_]):.1%}"]
        for id_, all_ in sorted(by.items())
    ]
    return _table(["effect", "sized", "inside", "median error"], lines)


def _table(header: Sequence[str], lines: Sequence[Sequence[str]]) -> str:
    return "\n".join(
        "| " + " | ".join(line) + " |" for line in [header, ["---"] + ["---:"] * (len(header) - 1), *lines]
    )
