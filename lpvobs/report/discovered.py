"""What a result says of its residual: the outcome of `trace` and `refine`, read back for the page."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lpvobs.discovery.outcome import Ranked
from lpvobs.discovery.portrait import Portrait
from lpvobs.discovery.whiteness import Leftover, Whiteness
from lpvobs.io.results.hdf import reading
from lpvobs.io.results.mapping import read_if_there, read_rows
from lpvobs.io.results.refinements import read_structure
from lpvobs.io.results.results import KIND, REMEDY
from lpvobs.report.spoken import in_words, with_interval
from lpvobs.report.tables import Table, grams, percent

GROUPS = {"refine": "refinement", "trace": "trace"}
"""Where the outcome of a verb is in the file."""


@dataclass(frozen=True)
class Discovered:
    """The outcome of one verb on one result."""

    verb: str  # `refine`, by which the effects are part of the model, or `trace`
    content: Mapping[str, Any]  # the contract's JSON, `trace` without what comes after
    portrait: Portrait | None
    ranking: tuple[Ranked, ...]
    left: Leftover | None
    structure: Mapping[str, Whiteness]  # `before` and `after`


def read_discovered(path: Path) -> tuple[Discovered, ...]:
    """Return what was found on a result, as far as `trace` and `refine` have run; raises DataError for a damaged file."""
    with reading(path, KIND, REMEDY) as file:
        return tuple(
            Discovered(
                verb=verb,
                content=json.loads(str(file[name].attrs["json"])),
                portrait=read_if_there(file[name].get("plots"), Portrait),
                ranking=read_rows(file[name].get("ranking"), Ranked, "candidate"),
                left=read_if_there(file[name].get("leftover"), Leftover),
                structure=read_structure(file[name]),
            )
            for verb, name in GROUPS.items()
            if name in file
        )


def sentence(found: Discovered) -> str:
    """Return the verdict in words."""
    content, error = found.content, found.content["error"]
    logs = ", ".join(part["log"] for part in content["logs"] if "residual" in part)
    if content["verdict"] == "none":
        left = grams(error["before"])
        said = f"{logs}: the residual shows nothing that the model lacks. The held-out residual is {left} g/s rms."
        return f"{said} {more_drives(content)}".rstrip()
    if content["verdict"] == "unexplained":
        return (
            f"{logs}: no known effect explains the residual, so no effect is named. The held-out residual is "
            f"{grams(error['before'])} g/s rms. {where(found.left)}"
        )
    said, them = f"{logs}: {in_words(content['effects'])}.", "it" if len(content["effects"]) == 1 else "them"
    if found.verb != "refine":
        return f"{said} Without {them} in the model, the held-out residual is {grams(error['before'])} g/s rms."
    low, high = error["ratio_ci90"]
    return (
        f"{said} With {them} in the model, the held-out residual goes from {grams(error['before'])} to {grams(error['after'])} g/s "
        f"rms, which is {percent(error['ratio'], 1)} of the value before (90 %: {percent(low, 1)} to {percent(high, 1)})."
    )


def more_drives(content: Mapping[str, Any]) -> str:
    """Return how many healthy drives might prove the nearest candidate, empty where that is not known."""
    needed, known = content.get("healthy_drives_needed"), len(content["healthy_drives"])
    if needed is None:
        return ""
    said = f"{known} healthy drives tell how much days differ. If {needed['id']} is no chance"
    return f"{said}, {needed['number']} healthy drives in all would prove it."


def where(left: Leftover | None) -> str:
    """Return in words when, where and how fast a residual is, and what it follows."""
    if left is None:
        return ""
    times = ", ".join(f"from {part.begin:.0f} to {part.end:.0f} s of {part.log}" for part in left.stretches)
    when = f"It is largest {times}." if times else "It is spread evenly over the drive."
    follows = ", ".join(f"{name} ({r:+.2f})" for name, r in left.follows.items()) or "none of the logged signals"
    slow = f" Half of the power of the residual's slow part is below {left.half_power:.3g} Hz." * (left.half_power > 0)
    return (
        f"{when} The largest part is in the balance {left.balance}. The worst cell of the map is fuel {left.fuel[0]:g} to "
        f"{left.fuel[1]:g}, speed {left.speed[0]:g} to {left.speed[1]:g} (units of the map's axes), with {left.times_noise:.1f} "
        f"times the power of the median cell.{slow} The residual correlates with {follows}."
    )


def candidate_rows(content: Mapping[str, Any]) -> Table:
    """Return what comes nearest to a residual without a name."""
    header = ["candidate, not proven", "course", "parameter", "value", "5 %", "95 %", "unit", "share explained"]
    return header, [
        [
            item["id"],
            item["course"],
            name,
            *with_interval(p["value"], *p["ci90"]),
            p["unit"],
            percent(item["explained"], 1),
        ]
        for item in content.get("candidates", [])
        for name, p in item["parameters"].items()
    ]


def error_rows(content: Mapping[str, Any], refined: bool) -> Table:
    """Return the held-out error of all logs and of each; `unseen` logs are judged whole, for nothing was fitted to them."""
    whole = content.get("error_on_held_out_logs")
    parts = [("all logs", content["error"], False)] if len(content["logs"]) > 1 else []
    parts += [("all logs held out", whole, True)] if whole else []
    parts += [(part["log"], part["error"], "residual" not in part) for part in content["logs"]]
    rows = []
    for name, error, unseen in parts:
        row = [name, "unseen log" if unseen else "held-out parts", grams(error["before"])]
        if refined:
            row += [grams(error["after"]), f"{error['ratio']:.3f}", *(f"{edge:.3f}" for edge in error["ratio_ci90"])]
        rows.append(row)
    header = ["held-out residual, g/s rms", "judged on", "before"]
    return header + (["after", "ratio", "5 %", "95 %"] if refined else []), rows
