"""A fleet in words and tables."""

import numpy as np

from lpvobs.io.logs.finding import date_of
from lpvobs.io.results.fleets import StoredFleet
from lpvobs.maps.joint import NORMAL_90
from lpvobs.report.tables import Table, grams
from lpvobs.tracking.fleet import Aspects


def fleet_summary(fleet: StoredFleet) -> str:
    """Return what there is, in a few lines."""
    found = fleet.found
    periods = sorted({each.period for each in found.maps})
    unusual = sum(each.stands_out for each in found.vehicles)
    return (
        f"{len(found.vehicles)} vehicles, {len(fleet.kept.logs)} logs, {periods[0]} to {periods[-1]}\n"
        f"vehicles that stand out: {unusual}; changes found: {len(found.changes)}"
        + "".join(
            f"\nwith {each.logs} logs of a vehicle, a drift of {100 * each.drift:.2g} % a month "
            f"or a step of {100 * each.step:.2g} % should be found in nine of ten cases"
            for each in found.power
            if each.logs in (12, 24)
        )
    )


def vehicle_rows(fleet: StoredFleet, verbose: bool) -> Table:
    """Return a row per vehicle, worst first; without `verbose` only of those that stand out."""
    header = ["vehicle", "logs", "verdict", "level g/s a month", "90 %", "gain % a month", "90 %", "unlike its type"]
    return header, [
        [each.vehicle, str(each.logs), each.verdict, *_cells(each.trend, each.trend_error), f"{each.unlike:+z.1f} sd"]
        for each in fleet.found.worst_first()
        if verbose or each.stands_out
    ]


def change_rows(fleet: StoredFleet) -> Table:
    """Return a row per change: date with interval, level and gain."""
    header = ["vehicle", "change", "date", "earliest", "latest", "level g/s", "90 %", "gain %", "90 %"]
    return header, [
        [
            each.vehicle,
            each.kind,
            *map(_day, (each.date, each.earliest, each.latest)),
            *_cells(each.size, each.size_error),
        ]
        for each in fleet.found.changes
    ]


def effect_rows(fleet: StoredFleet) -> Table:
    """Return a row per effect that `refine` found: its size, the last log without it, the first and the last with it."""
    header = ["vehicle", "found by refine", "parameter", "value", "5 %", "95 %", "unit"]
    header += ["last log without", "first log with", "last log with"]
    return header, [
        [
            *(each.vehicle, each.id, each.parameter),
            *(f"{size:.4g}" for size in (each.value, each.low, each.high)),
            each.unit,
            *map(_day, (each.absent, each.first, each.last)),
        ]
        for each in fleet.effects
    ]


def _cells(size: Aspects, error: Aspects) -> list[str]:
    level, gain = grams(NORMAL_90 * error[0]), f"{100 * NORMAL_90 * error[1]:.3f}"
    return [grams(size[0]), f"+-{level}", f"{100 * size[1]:+z.3f}", f"+-{gain}"]


def _day(day: float) -> str:
    return "" if np.isnan(day) else date_of(day).isoformat()
