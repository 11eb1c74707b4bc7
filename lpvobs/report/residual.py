"""The section of the page on the residual: verdict, tables and figures of every trace and refinement."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from markupsafe import Markup

from lpvobs.discovery.portrait import Portrait
from lpvobs.report import discovered
from lpvobs.report import residual_figures as figures
from lpvobs.report.content import ResultView
from lpvobs.report.fit import ResidualFit
from lpvobs.report.tables import Table, fit_rows

MOST_LOGS = 6  # logs whose residual is drawn over time; the tables have all
WHITENESS = "Whiteness of sums over blocks: their effective number, portmanteau test, cumulated periodogram"
TITLES = {"refine": "refined", "trace": "traced"}


@dataclass(frozen=True)
class Picture:
    """A figure with its caption."""

    svg: Markup
    caption: str


@dataclass(frozen=True)
class Section:
    """A heading with what stands under it; every table has its caption."""

    title: str
    pictures: tuple[Picture, ...]
    tables: tuple[tuple[Table, str], ...] = ()
    verdict: str = ""


def residual_sections(view: ResultView, number: int) -> list[Section]:
    """Return the sections of one result, none where neither verb has run."""
    return [
        Section(
            title=f"{view.name}, {TITLES[found.verb]}",
            verdict=discovered.sentence(found),
            tables=tuple(_tables(found)),
            pictures=tuple(_pictures(found, view.name, f"d{number}-{found.verb}")),
        )
        for found in view.discovered
    ]


def fit_section(fits: Sequence[ResidualFit]) -> Section | None:
    """Return how well each balance follows each log, and what is left of the best one; None where no log was given."""
    if not fits:
        return None
    best = {(item.result, item.log): item for item in sorted(fits, key=lambda item: -(item.rms or 0.0))}
    return Section(
        title="Does the model follow the log?",
        tables=((fit_rows(fits), "Reading against the flow of each balance plus the map"),),
        pictures=tuple(
            picture(
                figures.resid_panels(f"fit{number}", f"correlations of the residual, {log}, {result}", item),
                f"{log}, {result}: what the balance {item.balance} leaves. First its autocorrelation, then its correlation with "
                f"each input. Lags outside the shaded band show what the model lacks.",
            )
            for number, ((result, log), item) in enumerate(best.items())
        ),
    )


def _tables(found: discovered.Discovered) -> Iterator[tuple[Table, str]]:
    for rows, title in (
        (discovered.effect_rows(found), "Effects, with 90 % intervals"),
        (discovered.candidate_rows(found.content), "What comes nearest, each alone in the model"),
        (discovered.error_rows(found.content, found.refined), "Residual on data held out"),
        (discovered.balance_rows(found), "Balances where the effects act: rms of the relative residual"),
        (
            discovered.day_rows(found),
            "Differences from the healthy day that are no fault, beside what is usual between days",
        ),
        (discovered.lost_rows(found), "What cannot be told without the missing channels"),
        (discovered.ranking_rows(found), "Every candidate, tried alone"),
        (discovered.whiteness_rows(found), WHITENESS),
    ):
        if rows is not None:
            yield rows, title


def _pictures(found: discovered.Discovered, result: str, name: str) -> Iterator[Picture]:
    seen = found.portrait
    if seen is None:
        return
    yield from _over_time(found, seen, name)
    for effect in found.content["effects"]:
        if "surface" in effect:
            yield picture(
                figures.component_curve(f"{name}-{effect['id']}", f"{effect['id']}, {result}", effect["surface"]),
                f"{effect['id']}: deviation of the component from its model, where the logs went, with the 90 % interval.",
            )
    if any(item.gain > 0.0 for item in found.ranking):
        yield picture(
            figures.ranking_bars(f"{name}-rank", f"ranking of candidates, {result}", found.ranking),
            "What each candidate would explain if it were the only one.",
        )
    for index, partial in enumerate(seen.partials):
        yield picture(
            figures.partial_residual(f"{name}-part{index}", f"partial residual of {partial.id}, {result}", partial),
            f"Partial residual of {partial.id}: the residual without this effect, over what the effect predicts, both without what "
            f"map, constants and the other effects explain. On the dashed line the size is right.",
        )
    yield from _structure(found, seen, result, name)


def _over_time(found: discovered.Discovered, seen: Portrait, name: str) -> Iterator[Picture]:
    parts: Mapping[str, Mapping[str, Any]] = {part["log"]: part for part in found.content["logs"]}
    held = "shaded parts were used for no fit and no choice"
    in_turn = "every part was left out in turn"
    for index, track in enumerate(seen.tracks[:MOST_LOGS]):
        effects = parts[track.log]["effects"]
        judged, title = held if track.judged.any() else in_turn, f"residual over time, {track.log}"
        yield picture(
            figures.residual_course(f"{name}-time{index}", title, track, seen.balances, effects),
            f"Residual of every balance on {track.log}, before and after: smallest and largest value of each column of pixels; "
            f"{judged}.",
        )


def _structure(found: discovered.Discovered, seen: Portrait, result: str, name: str) -> Iterator[Picture]:
    yield picture(
        figures.spectra(f"{name}-spectrum", f"spectra of the residual, {result}", seen),
        "Spectral density of the residual in units of its noise, before and after.",
    )
    if set(found.structure) == {"before", "after"}:
        yield picture(
            figures.autocorrelations(f"{name}-acf", f"autocorrelation, {result}", seen, found.structure),
            "Autocorrelation of the sums over blocks, with the band of white noise of the same uneven variance.",
        )
        yield picture(
            figures.periodograms(f"{name}-cum", f"cumulated periodogram, {result}", seen, found.structure),
            "Cumulated periodogram of the sums over blocks; white noise stays in the band.",
        )
    if seen.signals:
        yield picture(
            figures.cross_correlations(f"{name}-cross", f"cross-correlation, {result}", seen),
            "Correlation with every input and channel, the strongest among the balances, at lags of either sign; dots are beyond "
            "what noise gives.",
        )


def picture(svg: str, caption: str) -> Picture:
    """Return a figure with its caption."""
    return Picture(Markup(svg), caption)  # every name in it was escaped when it was drawn
