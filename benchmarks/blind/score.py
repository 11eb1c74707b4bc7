"""What the verdicts are worth: the only part of the bank that knows both the truth and the verdicts."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.stats
from common import markdown
from draw import KINDS, Case, Size

SHOWS = 1.1
"""B over N from which an effect counts as one that moves the residual."""
CLEAR = 1.25
"""B over N from which the recovered share is judged."""
MOST_ALIKE = 3


@dataclass(frozen=True)
class Judged:
    """A case, the verdict on its log, and on the same log without the effect, or on the log itself if it has none.

    Of a pair also the residual of the log with the one and with the other effect alone [kg/s]. Every residual is that before
    refinement as `trace` tells it: weighed by the errors of the model with what was found, where something was.
    """

    case: Case
    verdict: dict[str, Any]
    twin: dict[str, Any]
    alone: tuple[float, ...] = ()

    @property
    def both_show(self) -> bool:
        """Whether each effect of a pair moves the residual by itself."""
        return len(self.alone) > 1 and min(self.alone) >= SHOWS * self.twin["error"]["before"]

    @property
    def before(self) -> float:
        """B over N."""
        return float(self.verdict["error"]["before"] / self.twin["error"]["before"])

    @property
    def recovered(self) -> float:
        """(B - A) / (B - N)."""
        B, A, N = self.verdict["error"]["before"], self.verdict["error"]["after"], self.twin["error"]["before"]
        return float((B - A) / (B - N))

    @property
    def named(self) -> list[str]:
        """The effects that were named, first one first."""
        return [effect["id"] for effect in self.verdict["effects"]]

    def finds(self, place: int, truth: str) -> bool:
        """Return whether the named effect at a place is the truth or says that it may be."""
        if place >= len(self.verdict["effects"]):
            return False
        effect = self.verdict["effects"][place]
        alike = [effect["id"], *effect["indistinguishable"]]
        return bool(effect["id"] == truth or (truth in alike and len(alike) <= MOST_ALIKE))

    @property
    def right(self) -> bool:
        """Whether the verdict is right, by the rule for its kind."""
        truths = [effect["id"] for effect in self.case.effects]
        if self.case.kind == "clean":
            return bool(self.verdict["verdict"] == "none")
        if self.case.kind == "unlogged":
            return bool(self.verdict["verdict"] == "unexplained" and not self.named)
        if self.case.kind == "pair":
            return all(any(self.finds(k, truth) for k in range(len(self.named))) for truth in truths)
        return self.finds(0, truths[0])

    @property
    def said(self) -> str:
        """The verdict in words."""
        found = "; ".join(
            f"{e['id']} {_short(next(iter(e['parameters'].values()))['value'])} from {_short(e['onset'])}"
            + (f" like {', '.join(e['indistinguishable'])}" if e["indistinguishable"] else "")
            for e in self.verdict["effects"]
        )
        return f"{self.verdict['verdict']} {found}".rstrip()

    def line(self) -> str:
        """Return one line for a list of misses."""
        truth = "; ".join(", ".join(f"{k} {_short(v)}" for k, v in effect.items()) for effect in self.case.effects)
        mode = "nominal" if self.case.nominal else "free"
        piece = f"{self.case.piece[0]} {self.case.piece[1]:.0f}"
        return f"{self.case.number} ({piece}, {mode}, B/N {self.before:.2f}): {truth or 'clean'} -> {self.said}"


def _hidden(judged: Judged) -> str:
    """Return a remark on a pair one of whose effects does not move the residual by itself."""
    if judged.case.kind != "pair" or judged.both_show:
        return ""
    return " (alone: " + ", ".join(f"B/N {b / judged.twin['error']['before']:.2f}" for b in judged.alone) + ")"


def _short(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def page(judged: Sequence[Judged], sizes: Mapping[str, Size]) -> str:
    """Return the tables of one engine's bank."""
    shown = [j for j in judged if j.case.kind == "clean" or j.before >= SHOWS]
    parts = [
        f"{len(judged)} logs: {sum(j.case.kind == 'clean' for j in judged)} clean, "
        f"{sum(j.case.kind != 'clean' for j in shown)} with effects that move the held-out residual to at least {SHOWS} of the "
        f"clean one, {len(judged) - len(shown)} with smaller ones, listed apart. Intervals are Wilson's, 95 %.",
        markdown(["what", "seen", "of", "rate", "95 % interval", "wanted"], [rate.row() for rate in rates(judged)]),
        f"Worst A/B {max(j.verdict['error']['ratio'] for j in judged):.3f}; median CPU time of a refinement "
        f"{np.median([j.verdict['seconds'] for j in judged]):.1f} s.",
        "### Single effects\n\n" + effects_table([j for j in shown if j.case.kind == "single"], sizes),
        "### Confusion\n\n"
        + confusion([j for j in shown if j.case.kind in ("single", "channel", "unlogged", "clean")]),
        "### Smaller than that\n\n" + small([j for j in judged if j not in shown]),
        "### Misses\n\n" + "\n".join(f"- {j.line()}{_hidden(j)}" for j in shown if not j.right),
    ]
    return "\n\n".join(parts)


@dataclass(frozen=True)
class Rate:
    """How often something held, and how often it should: at least `wanted`, and at most `most`."""

    what: str
    seen: int
    of: int
    wanted: float
    most: float = 1.0

    def row(self) -> list[str]:
        """Return a row of the table."""
        goal = f">= {self.wanted:.0%}" if self.most == 1.0 else f"{self.wanted:.0%} to {self.most:.0%}"
        if not self.of:
            return [self.what, "0", "0", "-", "-", goal]
        interval = scipy.stats.binomtest(self.seen, self.of).proportion_ci(0.95, "wilson")
        between = f"{interval.low:.1%} to {interval.high:.1%}"
        return [self.what, str(self.seen), str(self.of), f"{self.seen / self.of:.1%}", between, goal]


def rates(judged: Sequence[Judged]) -> list[Rate]:
    """Return what the bank is for."""
    shown = [j for j in judged if j.case.kind == "clean" or j.before >= SHOWS]
    clear = [j for j in shown if j.case.kind not in ("clean", "unlogged") and j.named and j.before >= CLEAR]
    right = {kind: [j.right for j in shown if j.case.kind == kind] for kind in KINDS}
    visible = [j.right for j in shown if j.case.kind == "pair" and j.both_show]
    held = [inside for inside, _, _ in _intervals(shown)]
    recovered = [j.recovered >= 0.7 for j in clear]
    silent = [j.twin["verdict"] == "none" for j in judged if j.case.effects]
    unharmed = [j.verdict["error"]["ratio"] <= 1.02 for j in judged]
    return [
        _rate("single effect: first named right, or in a set of three at most", right["single"], 0.90),
        _rate("pair: both found", right["pair"], 0.80),
        _rate(f"both of a pair found, where each alone moves the residual to {SHOWS}", visible, 0.80),
        _rate("driven by a logged channel: named", right["channel"], 0.90),
        _rate("driven by nothing logged: `unexplained`, no name", right["unlogged"], 0.95),
        _rate("clean: `none`", right["clean"], 0.98),
        _rate("the same log without its effects: `none`", silent, 0.98),
        _rate("truth inside its 90 % interval", held, 0.85, 0.95),
        _rate(f"(B - A)/(B - N) at least 0.7 where B >= {CLEAR} N", recovered, 0.90),
        _rate("A/B at most 1.02, all logs", unharmed, 0.98),
    ]


def _rate(what: str, held: Sequence[bool], wanted: float, most: float = 1.0) -> Rate:
    return Rate(what, sum(held), len(held), wanted, most)


def _intervals(judged: Iterable[Judged]) -> Iterable[tuple[bool, str, float]]:
    """Yield whether the interval of each named effect that is there holds its truth, and the relative error."""
    for item in judged:
        if item.case.kind not in ("single", "pair"):
            continue
        for truth in item.case.effects:
            for effect in item.verdict["effects"]:
                if effect["id"] == truth["id"]:
                    name, found = next(iter(effect["parameters"].items()))
                    low, high = found["ci90"]
                    none = 1.0 if name == "factor" else 0.0
                    error = (found["value"] - truth[name]) / (truth[name] - none)
                    yield low <= truth[name] <= high, truth["id"], float(error)


def effects_table(singles: Sequence[Judged], sizes: Mapping[str, Size]) -> str:
    """Return a line per effect of the catalogue: found, size, interval, onset, what is left."""
    rows = []
    for id_ in sizes:
        own = [j for j in singles if j.case.effects[0]["id"] == id_]
        if not own:
            continue
        held = list(_intervals(own))
        onsets = [abs(d) for d in map(_onset_error, own) if d is not None]
        rows.append(
            [
                id_,
                str(len(own)),
                str(sum(j.right for j in own)),
                f"{np.median([abs(e) for _, _, e in held]):.1%}" if held else "-",
                f"{sum(inside for inside, _, _ in held)}/{len(held)}",
                f"{np.median(onsets):.1f}" if onsets else "-",
                f"{np.median([j.before for j in own]):.2f}",
                f"{np.median([j.verdict['error']['after'] / j.twin['error']['before'] for j in own]):.2f}",
            ]
        )
    header = ["effect", "logs", "right", "median error of size", "in interval", "onset off by [s]", "B/N", "A/N"]
    return markdown(header, rows)


def _onset_error(judged: Judged) -> float | None:
    truth = judged.case.effects[0]
    for effect in judged.verdict["effects"]:
        if effect["id"] == truth["id"] and effect["onset"] is not None and "onset" in truth:
            return float(effect["onset"] - truth["onset"])
    return None


def confusion(judged: Sequence[Judged]) -> str:
    """Return what was said first of each truth, as a list: most cells of the matrix are empty."""
    counts: dict[str, Counter[str]] = {}
    for item in judged:
        truth = item.case.effects[0]["id"] if item.case.effects else "clean"
        said = item.named[0] if item.named else str(item.verdict["verdict"])
        counts.setdefault(truth, Counter())[said] += 1
    rows = [
        [truth, ", ".join(f"{said} {n}" for said, n in counter.most_common())]
        for truth, counter in sorted(counts.items())
    ]
    return markdown(["truth", "said"], rows)


def small(judged: Sequence[Judged]) -> str:
    """Return what was said of effects too small to show."""
    counts = Counter("right" if j.right else ("nothing said" if not j.named else "wrong name") for j in judged)
    lines = [f"- {j.line()}" for j in judged if j.named and not j.right]
    return ", ".join(f"{what}: {n}" for what, n in counts.most_common()) + "\n\n" + "\n".join(lines)


def differences(before: Sequence[Judged], after: Sequence[Judged]) -> str:
    """Return how many verdicts on the same logs are equal by name, and a line for each that is not."""
    lines, sizes = [], []
    for old, new in zip(before, after, strict=True):
        if (old.verdict["verdict"], old.named) != (new.verdict["verdict"], new.named):
            judgement = f"{'right' if old.right else 'wrong'}, {'right' if new.right else 'wrong'}"
            lines.append(f"- {judgement}: {old.line()}; then {new.said} (B/N {new.before:.2f})")
        else:
            sizes += [_moved(*both) for both in zip(old.verdict["effects"], new.verdict["effects"], strict=True)]
    beyond = sum(each > 1.0 for each in sizes)
    head = (
        f"{len(before) - len(lines)} of {len(before)} verdicts are equal by name; of their {len(sizes)} sizes, {beyond} moved "
        "by more than half their 90 % interval."
    )
    return "\n\n".join([head, "\n".join(lines)])


def _moved(old: Mapping[str, Any], new: Mapping[str, Any]) -> float:
    """Return how far a size moved, in half widths of its 90 % interval of before."""
    (was, now) = (next(iter(effect["parameters"].values())) for effect in (old, new))
    low, high = was["ci90"]
    return float(abs(now["value"] - was["value"]) / max(0.5 * (high - low), 1e-300))
