"""A fleet that ages: what `track` finds of drifts, steps and new sensors, whom it accuses, how good trends and maps are.

One fleet is simulated whole (`fleet_drives.py`). Others are made of its stored sums: every log keeps its course, and maps, engines
and noise are drawn anew. The noise of a log has the covariance of its sums, as wide as errors that last make it, and every log has
a day of its own as the simulated fleet has.
"""

import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import reduce
from pathlib import Path
from unittest.mock import patch

import numpy as np
from common import CONFIG, configuration, markdown, publish
from fleet_drives import A_MONTH, FIRST, KINDS, MONTH, MONTHS, VEHICLES, Vehicle, fleet, record, surface_of

import lpvobs
from lpvobs.io.logs.finding import EPOCH, date_of
from lpvobs.io.results.fleets import FleetSums, StoredFleet, read_fleet
from lpvobs.io.results.parts import PartsFolder
from lpvobs.maps.joint import NORMAL_90
from lpvobs.observer.estimate import Point
from lpvobs.observer.parts import LogInformation
from lpvobs.observer.windows import Columns
from lpvobs.records import Array
from lpvobs.simulation.readings import surface_error
from lpvobs.tracking.fleet import Driven, Tracked, track
from lpvobs.tracking.sums import TrackedLog, VehicleSums, flow_at_nodes, kept, weighed
from lpvobs.tracking.timeline import CHANGE

SEED = 1
NEAR = 31.0
"""[d] from a step within which it counts as found."""
FEW = 2
"""Logs of a vehicle with few drives."""
DRIVEN = 0.02
"""Of the stay at the node where a vehicle is most, from which a node counts as driven."""


@dataclass(frozen=True)
class Course:
    """What a log keeps when its fleet is drawn anew."""

    part: LogInformation
    vehicle: int
    date: float
    products: Array
    flow: Array  # (p,) at the nodes
    root: Array  # of its noise


@dataclass(frozen=True)
class Count:
    """What came of a fleet, or of many."""

    changes: int = 0
    found: int = 0
    late: tuple[float, ...] = ()  # [d], of steps that were found
    healthy: int = 0
    accused: int = 0
    trends: int = 0
    held: int = 0
    alone: tuple[float, ...] = ()  # [kg/s] of vehicles with few drives, rms of their nodes
    member: tuple[float, ...] = ()

    def __add__(self, other: "Count") -> "Count":
        return Count(*(getattr(self, each.name) + getattr(other, each.name) for each in fields(self)))


def main(folder: Path, fleets: int) -> None:
    """Print and keep the page."""
    if not folder.exists():
        record(folder, SEED)
    timed = _simulated(folder)
    stored = read_fleet(folder / "fleet.h5")
    whole = _judged(stored.kept, stored.found, fleet(SEED), stored)
    courses = _courses(folder, stored)
    drawn = sum((_drawn(stored, courses, SEED + number) for number in range(1, fleets)), Count())
    few = sum((_few(stored, courses, SEED + number) for number in range(1, min(fleets, 6))), Count())
    publish(
        "fleet",
        "A fleet that ages",
        _page(whole, drawn, few, fleets, timed),
        "make fleet-proof",
    )


def _simulated(folder: Path) -> dict[str, float]:
    """Track the simulated fleet, the last month by itself; return what that took."""
    out, gain = folder / "fleet.h5", folder / "gain.h5"
    logs = sorted(folder.glob("V*/*.parquet"))
    last = [path for path in logs if path.stem.startswith("2025-12")]
    if not gain.exists():
        lpvobs.synth_gain(CONFIG, logs[:2], out=gain)
    with patch.object(PartsFolder, "remove"):  # what the logs leave is needed once more
        if not out.exists():
            lpvobs.track(CONFIG, [path for path in logs if path not in last], out=out, gain=gain)
            lpvobs.track(CONFIG, last, out=out, gain=gain)
        begin = time.process_time()
        lpvobs.track(CONFIG, out=out)
    return {"sums": time.process_time() - begin}


def _courses(folder: Path, stored: StoredFleet) -> list[Course]:
    """Return the products of every log, whole."""
    config, basis, p = configuration(), stored.kept.basis, stored.grid.size
    point = Point(config.engine_path(), config.estimate.of_engine(config.engine_path().usual_tolerance))
    layout = Columns(p, point.unknowns.size, len(point.configured.balance_names))
    parts, found = PartsFolder(folder / "fleet.h5", stored.kept.key), []
    for log in stored.kept.logs:
        part = parts.read(log.sha256).part
        products = weighed(part, layout, basis)
        variances, axes = np.linalg.eigh(products[:-2, :-2])
        root = (axes * np.sqrt(np.maximum(variances, 0.0) * basis.lasting))[:, variances > 1e-9 * variances[-1]]
        flow = flow_at_nodes(products[:p, :p], products[:p, -2], basis.flow)
        part = replace(part, products=np.empty(0), slow=np.empty(0))
        found.append(Course(part, int(log.vehicle[1:]), log.date, products, flow, root.astype(np.float32)))
    return found


def _error(vehicle: Vehicle, stored: StoredFleet, flow: Array, date: float) -> Array:
    """Return the true error of a sensor at the nodes, shape (p,) [kg/s]."""
    fuel, speed = (axis.ravel() for axis in np.meshgrid(stored.grid.fuel, stored.grid.speed))
    when_new = surface_error(surface_of(configuration().simulation.surface, vehicle), fuel, speed, flow)
    gain = vehicle.gain((date - (FIRST - EPOCH).days) / MONTH)
    return gain * (flow + when_new) - flow


def _redrawn(stored: StoredFleet, courses: Sequence[Course], seed: int) -> list[tuple[TrackedLog, VehicleSums]]:
    """Return the sums of a fleet whose maps, engines and noise are drawn anew."""
    rng = np.random.default_rng([seed, 81])
    basis, vehicles = stored.kept.basis, fleet(seed)
    engines = rng.standard_normal((len(vehicles), basis.engine.shape[1]))
    days = np.sqrt(stored.found.sizes.daily) * CHANGE
    cells = (stored.grid.speed.size - 1) * (stored.grid.fuel.size - 1)
    found = []
    for course in courses:
        own = vehicles[course.vehicle]
        error = _error(own, stored, course.flow, course.date)
        error = error + basis.modes(course.flow) @ (days * rng.standard_normal(days.size))
        truth = np.concatenate([error, engines[course.vehicle]])
        noise = course.root @ rng.standard_normal(course.root.shape[1])
        products = course.products.copy()
        products[:-2, -1] = products[-1, :-2] = products[:-2, :-2] @ truth + noise
        found.append(kept(course.part, products, basis, (course.part.run.name, own.name, "diesel", course.date), cells))
    return found


def _tracked(stored: StoredFleet, made: Sequence[tuple[TrackedLog, VehicleSums]]) -> tuple[FleetSums, Tracked]:
    logs: dict[str, list[TrackedLog]] = {}
    sums: dict[str, VehicleSums] = {}
    for log, own in made:
        logs.setdefault(log.vehicle, []).append(log)
        sums[log.vehicle] = sums[log.vehicle].plus(own) if log.vehicle in sums else own
    every = [log for own in logs.values() for log in own]
    periods = {log.sha256: date_of(log.date).strftime("%Y-%m") for log in every}
    settings, in_order = configuration().estimate, [sums[name] for name in sorted(sums)]
    least, basis = settings.least_information, stored.kept.basis
    found = track(stored.grid, basis, in_order, logs, periods, settings.prior_map, least)
    return replace(stored.kept, sums=tuple(in_order), logs=tuple(every)), found


def _drawn(stored: StoredFleet, courses: Sequence[Course], seed: int) -> Count:
    return _judged(*_tracked(stored, _redrawn(stored, courses, seed)), fleet(seed), stored)


def _judged(kept_of: FleetSums, found: Tracked, vehicles: Sequence[Vehicle], stored: StoredFleet) -> Count:
    """Count what was found of what is true."""
    total = Count()
    standing = {each.vehicle: each for each in found.vehicles}
    sums = {each.vehicle: each for each in kept_of.sums}
    for vehicle in vehicles:
        its, changes = standing[vehicle.name], [each for each in found.changes if each.vehicle == vehicle.name]
        when = (FIRST - EPOCH).days + MONTH * vehicle.change
        away = min((abs(each.date - when) for each in changes), default=np.inf)
        if vehicle.kind == "healthy":
            total += Count(healthy=1, accused=int(its.verdict != "steady"))
        else:
            right = "drifts" in its.verdict if vehicle.kind == "drift" else away <= NEAR
            late = (away,) if vehicle.change and right else ()
            total += Count(changes=1, found=int(right), late=late)
        driven = Driven(stored.grid, kept_of.basis, sums[vehicle.name])
        flow = driven.flow
        last, month = its.last, MONTH if vehicle.kind == "drift" else 0.0
        change = _error(vehicle, stored, flow, last) - _error(vehicle, stored, flow, last - month)
        apart = np.abs(np.array(its.trend) - driven.aspects @ change)[:2]
        total += Count(trends=2, held=int(np.sum(apart <= NORMAL_90 * np.array(its.trend_error)[:2])))
    return total


def _few(stored: StoredFleet, courses: Sequence[Course], seed: int) -> Count:
    """Compare maps of vehicles with few drives, alone and as members of their type."""
    made = _redrawn(stored, courses, seed)
    few = {f"V{number:02}" for number in range(len(KINDS), len(KINDS) + 4)}
    own: dict[str, list[tuple[TrackedLog, VehicleSums]]] = {}
    for log, sums in sorted(made, key=lambda item: item[0].date):
        if log.vehicle not in few or len(own.get(log.vehicle, [])) < FEW:
            own.setdefault(log.vehicle, []).append((log, sums))
    _, together = _tracked(stored, [each for logs in own.values() for each in logs])
    total, vehicles = Count(), {each.name: each for each in fleet(seed)}
    for name in sorted(few):
        _, by_itself = _tracked(stored, own[name])
        sums = reduce(lambda a, b: a.plus(b), [each for _, each in own[name]])
        driven = Driven(stored.grid, stored.kept.basis, sums)
        date = own[name][-1][0].date
        truth = _error(vehicles[name], stored, driven.flow, date)
        used = driven.weight > DRIVEN * driven.weight.max()
        errors = [
            float(np.sqrt(np.mean((maps.theta - truth)[used] ** 2)))
            for each in (by_itself, together)
            for maps in [next(m for m in reversed(each.maps) if m.vehicle == name)]
        ]
        total += Count(alone=(errors[0],), member=(errors[1],))
    return total


def _page(whole: Count, drawn: Count, few: Count, fleets: int, timed: dict[str, float]) -> str:
    both = whole + drawn
    rows = []
    for name, count in (("simulated whole", whole), (f"{fleets - 1} drawn anew", drawn), ("together", both)):
        late = f"{max(count.late, default=np.nan):.0f}"
        found, accused = f"{count.found} of {count.changes}", f"{count.accused} of {count.healthy}"
        rows.append(
            [name, found, late, accused, f"{count.held} of {count.trends} ({100 * count.held / count.trends:.0f} %)"]
        )
    header = [
        "fleets",
        "changes found",
        "steps: furthest from the day [d]",
        "healthy accused",
        "trends in their 90 % intervals",
    ]
    alone, member = (1e3 * np.sqrt(np.mean(np.square(each))) for each in (few.alone, few.member))
    return "\n\n".join(
        (
            __doc__.split("\n\n", 1)[1].strip() if __doc__ else "",
            markdown(header, rows),
            "A trend counts twice: level and gain. The truth is the change of the sensor's error at the nodes that the vehicle "
            "drives, weighted as `track` weights it.",
            f"Maps of {len(few.alone)} vehicles with {FEW} drives, nodes that these have driven: {alone:.3f} g/s rms alone, "
            f"{member:.3f} g/s as members of their type.",
            f"`track` of the stored sums of {VEHICLES * MONTHS * A_MONTH} logs takes {timed['sums']:.1f} s of one processor, "
            "reading and writing the file included.",
        )
    )


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path("build/fleet"), int(sys.argv[2]) if len(sys.argv) > 2 else 20)
