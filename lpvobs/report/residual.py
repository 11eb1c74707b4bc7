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
            title=f"{view.name}, {'refined' if found.refined else 'traced'}",
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
        title="How well does the model predict the reading?",
        tables=(
            (
                fit_rows(fits),
                "Sensor reading compared with its prediction: the air flow from each balance, plus the map",
            ),
        ),
        pictures=tuple(
            picture(
                figures.resid_panels(f"fit{number}", f"correlations of the residual, {log}, {result}", item),
                f"{log}, {result}: residual of the balance {item.balance}. The first panel is its autocorrelation, the "
                "other panels are its correlation with each input. Values outside the shaded band show that the model lacks "
                "something.",
            )
            for number, ((result, log), item) in enumerate(best.items())
        ),
    )


def _tables(found: discovered.Discovered) -> Iterator[tuple[Table, str]]:
    for table, title in (
        (discovered.effect_rows(found), "Effects, with 90 % intervals"),
        (
            discovered.candidate_rows(found.content),
            "Candidates that come nearest to the residual, each tried alone in the model",
        ),
        (discovered.error_rows(found.content, found.refined), "Residual on held-out data"),
        (discovered.balance_rows(found), "Balances on which the effects act: rms of the relative residual"),
        (
            discovered.day_rows(found),
            "Differences from the healthy day that are not faults, and the usual difference between days",
        ),
        (discovered.lost_rows(found), "What the logs cannot show because channels are missing"),
        (
            discovered.ranking_rows(found),
            "Candidates, each tried alone in the model (unevenness near 1: one size fits the whole log)",
        ),
        (
            discovered.whiteness_rows(found),
            "Whiteness tests of the residual in blocks of time: effective blocks, portmanteau test, cumulated periodogram",
        ),
    ):
        if table[1]:
            yield table, title


def _pictures(found: discovered.Discovered, result: str, name: str) -> Iterator[Picture]:
    seen = found.portrait
    if seen is None:
        return
    yield from _over_time(found, seen, name)
    for effect in found.content["effects"]:
        if "surface" in effect:
            yield picture(
                figures.component_curve(f"{name}-{effect['id']}", f"{effect['id']}, {result}", effect["surface"]),
                f"{effect['id']}: deviation of the component from its model in the range that the logs cover, with the "
                "90 % interval.",
            )
    if any(item.gain > 0.0 for item in found.ranking):
        yield picture(
            figures.ranking_bars(f"{name}-rank", f"ranking of candidates, {result}", found.ranking),
            "Evidence for each candidate if it were the only one in the model.",
        )
    for index, partial in enumerate(seen.partials):
        yield picture(
            figures.partial_residual(f"{name}-part{index}", f"partial residual of {partial.id}, {result}", partial),
            f"Partial residual of {partial.id}: the residual without this effect, plotted over the prediction of this "
            "effect. From both, the part that map, constants and other effects explain is removed. Points on the dashed line "
            "agree with the estimated size.",
        )
    yield from _structure(found, seen, result, name)


def _over_time(found: discovered.Discovered, seen: Portrait, name: str) -> Iterator[Picture]:
    parts: Mapping[str, Mapping[str, Any]] = {part["log"]: part for part in found.content["logs"]}
    held = "Shaded parts were held out: they were used neither for the fit nor for the choice of effects"
    in_turn = "Every part of the log was held out in turn"
    for index, track in enumerate(seen.tracks[:MOST_LOGS]):
        effects = parts[track.log]["effects"]
        judged, title = held if track.judged.any() else in_turn, f"residual over time, {track.log}"
        yield picture(
            figures.residual_course(f"{name}-time{index}", title, track, seen.balances, effects),
            f"Residual of every balance on {track.log}, before and after. Each column of pixels shows the smallest and "
            f"the largest value. {judged}.",
        )


def _structure(found: discovered.Discovered, seen: Portrait, result: str, name: str) -> Iterator[Picture]:
    yield picture(
        figures.spectra(f"{name}-spectrum", f"spectra of the residual, {result}", seen),
        "Power spectral density of the residual, divided by the standard deviation of its noise, before and after.",
    )
    if set(found.structure) == {"before", "after"}:
        yield picture(
            figures.autocorrelations(f"{name}-acf", f"autocorrelation, {result}", seen, found.structure),
            "Autocorrelation of the residual, summed over blocks of time. The band is that of white noise with the "
            "same changes of variance.",
        )
        yield picture(
            figures.periodograms(f"{name}-cum", f"cumulated periodogram, {result}", seen, found.structure),
            "Cumulated periodogram of the residual, summed over blocks of time. White noise stays in the band.",
        )
    if seen.signals:
        yield picture(
            figures.cross_correlations(f"{name}-cross", f"cross-correlation, {result}", seen),
            "Correlation of the residual with every input and channel at positive and negative lags, for the balance with the "
            "strongest correlation. Dots mark correlations that noise cannot explain.",
        )


def picture(svg: str, caption: str) -> Picture:
    """Return a figure with its caption."""
    return Picture(Markup(svg), caption)  # every name in it was escaped when it was drawn
