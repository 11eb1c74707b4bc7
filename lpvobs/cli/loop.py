"""What the model lacks: `lpvobs trace`, `lpvobs refine`."""

import textwrap
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import lpvobs
from lpvobs.cli.common import leave, print_json, progress, say, table, visible
from lpvobs.cli.options import ENGINE, JSON, LOGS, MAP, argument, needed, option

if TYPE_CHECKING:
    from lpvobs.discovery.outcome import Finding, Trace

WIDTH = 80
MOST_SHOWN = 6


def trace(
    result: Path = argument(
        "RESULT.h5", "A result of estimate or refine. The findings are written into this file as /trace."
    ),
    logs: list[Path] = LOGS,
    freeze_map: bool | None = MAP,
    engine: Path | None = ENGINE,
    as_json: bool = JSON,
) -> None:
    """Find effects that the engine model lacks, from its residual.

    If the map was estimated from these logs, map and effects are estimated together. On other logs the stored map is assumed to be
    right. A log that cannot be used is left out with a message, and the exit code is 3.

    Example: lpvobs trace nedc.h5 nedc.parquet

    Example, to find what has changed since the map was made: lpvobs trace nominal.h5 monday.parquet tuesday.parquet
    """
    with progress("tracing") as report:
        traced = lpvobs.trace(result, logs, freeze_map=freeze_map, engine=engine, progress=report)
    if as_json:
        print_json("trace", traced.as_json(refined=False))
    else:
        show(traced.found, traced.map_frozen, refined=False)
        say(
            f"held-out residual {1e3 * traced.found.error.before:.3f} g/s rms; the result of the search is in "
            f"{result} under /trace"
        )
    leave(traced.refused)


def show(found: "Trace", frozen: bool, refined: bool) -> None:
    """Print verdict, effects, errors and ranking, none wider than a terminal of 80 columns."""
    from lpvobs.report.discovered import error_rows
    from lpvobs.report.spoken import in_words

    print(f"verdict: {found.verdict} (map {'frozen' if frozen else 'estimated jointly'})")
    content = found.as_json(refined)
    if found.findings:
        print(textwrap.fill(visible(in_words(content["effects"])), WIDTH, initial_indent="  ", subsequent_indent="  "))
    else:
        _nothing_named(found, content)
    for title, effects in (("found", found.findings), ("in the model already", found.known_effects or ())):
        if effects:
            print(f"\n{table(*_effects(title, effects))}")
        for effect in effects:
            if effect.indistinguishable:
                likes = f"To tell {effect.id} from {', '.join(effect.indistinguishable)}, record {effect.drive}."
                print(textwrap.fill(visible(likes), WIDTH, initial_indent="  ", subsequent_indent="    "))
    if refined or len(found.logs) > 1:
        header, rows = error_rows(content, refined)
        print("\n" + table(header, [[textwrap.shorten(row[0], 28, placeholder="..."), *row[1:]] for row in rows]))
    for part in found.logs:
        for note in part.notes():
            print(textwrap.fill(visible(f"{part.log}: {note}"), WIDTH, subsequent_indent="  "))
    ranked = [item for item in found.ranking if item.gain > 0.0][:MOST_SHOWN]
    if ranked:
        rows = [[item.id, f"{item.value:.4g}", item.unit, f"{item.gain:.1f}"] for item in ranked]
        print("\n" + table(["candidate alone", "size", "unit", "evidence"], rows))


def _nothing_named(found: "Trace", content: Mapping[str, Any]) -> None:
    from lpvobs.report.discovered import candidate_rows, more_drives, where
    from lpvobs.report.spoken import chance

    print(f"  p-value of 'no effect': {chance(found.p_value)}")
    left = where(found.left) if found.verdict == "unexplained" else ""
    for said in filter(None, (left, more_drives(content))):
        print(textwrap.fill(visible(said), WIDTH, initial_indent="  ", subsequent_indent="  "))
    if content.get("candidates"):
        print("\n" + table(*candidate_rows(content)))


def _effects(title: str, effects: "tuple[Finding, ...]") -> tuple[list[str], list[list[str]]]:
    from lpvobs.report.spoken import chance, second, with_interval

    edges = [edge for edge in ("onset", "end") if any(getattr(effect, edge) is not None for effect in effects)]
    rows = []
    for effect in effects:
        for name, parameter in effect.parameters.items():
            sizes = with_interval(parameter.value, *parameter.ci90)
            times = [second(getattr(effect, edge)) for edge in edges]
            rows.append([effect.id, name, *sizes, parameter.unit, *times, chance(effect.p_value)])
    return [title, "", "value", "5 %", "95 %", "unit", *(f"{edge} s" for edge in edges), "p"], rows


def refine(
    result: Path = argument("RESULT.h5", "A result of estimate or refine."),
    logs: list[Path] = LOGS,
    out: Path = needed("REFINED.h5", "The refined result to write."),
    hold_out: list[Path] | None = option(
        "LOG", "A log used only to judge the error, and for no fit or decision. Repeatable."
    ),
    freeze_map: bool | None = MAP,
    engine: Path | None = ENGINE,
    as_json: bool = JSON,
) -> None:
    """Add the effects that the logs prove to the engine model, estimate again, and show the error before and after.

    The error is that on held-out data. If no effect is found, the earlier result is copied byte for byte. A refined result can be
    refined again. A log that cannot be used is left out with a message, and the exit code is 3.

    Example: lpvobs refine nedc.h5 nedc.parquet --out refined.h5

    Example, judged on another drive: lpvobs refine nedc.h5 nedc.parquet --hold-out wltc.parquet --out refined.h5
    """
    with progress("refining") as report:
        held = hold_out or ()
        traced = lpvobs.refine(result, logs, out, hold_out=held, freeze_map=freeze_map, engine=engine, progress=report)
    if as_json:
        print_json("refine", traced.as_json(refined=True))
    else:
        show(traced.found, traced.map_frozen, refined=True)
        error = traced.found.error.comparison
        low, high = error.ratio_ci90
        say(
            f"held-out residual {1e3 * error.before:.3f} -> {1e3 * error.after:.3f} g/s rms, "
            f"ratio {error.ratio:.3f} ({low:.3f} to {high:.3f})"
        )
        copied = "a copy of the earlier result, because no effect was proven"
        say(f"{out}: {'written with the effects' if traced.found.findings else copied}")
    leave(traced.refused)
