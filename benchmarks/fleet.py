"""A fleet that ages: what `track` finds of drifts, steps and new sensors, whom it accuses, how good trends and maps are.

One fleet is simulated whole (`fleet_drives.py`). Others are made of its stored sums: every log keeps its course, and maps, engines
and noise are drawn anew. The noise of a log has the covariance of its sums, as wide as errors that last make it, and every log has
a day of its own as the simulated fleet has.
"""

import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from functools import cache, partial, reduce
from pathlib import Path
from tempfile import TemporaryDirectory
from types import SimpleNamespace
from typing import TypeVar
from unittest.mock import patch

import msgspec
import numpy as np
from common import CONFIG, configuration, markdown, publish
from fleet_drives import A_MONTH, FIRST, KINDS, MONTH, MONTHS, SHORT, VEHICLES, Vehicle, cut, fleet, record, surface_of

import lpvobs
from lpvobs.io.logs.finding import EPOCH, date_of
from lpvobs.io.results.fleets import FleetSums, StoredFleet, read_fleet
from lpvobs.io.results.parts import PartsFolder
from lpvobs.io.safety.atomic import replacing
from lpvobs.maps.joint import NORMAL_90, Joint
from lpvobs.records import Array
from lpvobs.simulation.readings import surface_error
from lpvobs.tracking.changes import Detectable
from lpvobs.tracking.fleet import Fleet, Tracked, track
from lpvobs.tracking.sums import KeptLog, TrackedLog, VehicleSums, flow_at_nodes, kept
from lpvobs.tracking.timeline import CHANGE, Driven, vehicle_of

SEED = 1
ALL = VEHICLES * MONTHS * A_MONTH
STEPS = {
    "quarter": f"stored sums of {ALL // 4} logs",
    "sums": f"stored sums of {ALL} logs",
    "month": f"a month of {VEHICLES * A_MONTH} logs more, in one process",
    "short": f"{SHORT} logs of a minute of {-(-SHORT // (MONTHS * A_MONTH))} vehicles, all read, in two processes",
}
MEASURED = """
import pathlib, re
from lpvobs.cli.start import run
try:
    run()
except SystemExit as end:
    if end.code:
        raise
print(re.search(r"VmHWM:\\s+(\\d+)", pathlib.Path("/proc/self/status").read_text())[1])
"""
"""What a process does that says at its end how much memory it has used at most [kB]."""
Kind = TypeVar("Kind")
NEAR = 31.0
"""[d] from a step within which it counts as found."""
FEW = 2
"""Logs of a vehicle with few drives."""
SHARES, POWER_FLEETS, DRIFTING = (0.5, 1.0), 20, 1
"""Of the drift that `track` says of a fleet that it finds, fleets drawn to try it, and vehicles of each that drift so."""
DRIVEN = 0.02
"""Of the stay at the node where a vehicle is most, from which a node counts as driven."""


@dataclass(frozen=True)
class Course:
    """What a log keeps when its fleet is drawn anew."""

    kept: KeptLog
    vehicle: int
    flow: Array  # (p,) at the nodes
    root: Array  # of its noise


@dataclass(frozen=True)
class Between:
    """How well is known what has changed from the first month to the last."""

    nodes: int = 0  # of vehicles that have changed
    inside: int = 0
    healthy: int = 0
    accused: int = 0  # by p below a tenth

    def __add__(self, other: "Between") -> "Between":
        return Between(*(getattr(self, each.name) + getattr(other, each.name) for each in fields(self)))


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
    """Print and keep the page; what has been done is kept in the folder, and a run that was stopped goes on from there."""
    record(folder, SEED)
    timed = _done(folder / "timed.json", dict[str, tuple[float, float, float]], lambda: _simulated(folder))
    stored = read_fleet(folder / "fleet.h5")
    whole = _judged(stored.kept, stored.found, fleet(SEED), stored)
    courses = cache(partial(_courses, folder, stored))

    def drawn(name: str, kind: type[Kind], made: Callable[[int], Kind], numbers: int) -> list[Kind]:
        return [_done(folder / f"{name}_{n}.json", kind, partial(made, SEED + n)) for n in range(1, 1 + numbers)]

    anew = sum(drawn("drawn", Count, lambda seed: _drawn(stored, courses(), seed), fleets - 1), Count())
    few = sum(drawn("few", Count, lambda seed: _few(stored, courses(), seed), min(fleets - 1, 5)), Count())
    between = sum(
        drawn("between", Between, lambda seed: _between(stored, courses(), seed), min(fleets - 1, 5)), Between()
    )
    tried = drawn("power", list[Count], lambda seed: _with_drift(stored, courses(), seed), POWER_FLEETS)
    powers = [(share, sum(counts, Count())) for share, counts in zip(SHARES, zip(*tried, strict=True), strict=True)]
    publish(
        "fleet",
        "A fleet that ages",
        _page(whole, anew, few, between, fleets, timed, stored.found.power, powers),
        "make fleet-proof",
    )


def _done(path: Path, kind: type[Kind], make: Callable[[], Kind]) -> Kind:
    """Return what stands in a file, made now if it is not there."""
    if not path.exists():
        made = msgspec.json.encode(make())
        with replacing(path) as temporary:
            temporary.write_bytes(made)
    return msgspec.json.decode(path.read_bytes(), type=kind)


def _simulated(folder: Path) -> dict[str, tuple[float, float, float]]:
    """Track the simulated fleet, the last month by itself; return processor time, time and memory of each step."""
    out, gain, whole, month, quarter = (
        folder / f"{name}.h5" for name in ("fleet", "gain", "whole", "month", "quarter")
    )
    logs = sorted(folder.glob("V*/*.parquet"))
    last = [path for path in logs if path.stem.startswith("2025-12")]
    given = ("--config", CONFIG, "--gain", gain)
    if not gain.exists():
        lpvobs.synth_gain(CONFIG, logs[:2], out=gain)
    with patch.object(PartsFolder, "remove"):  # what the logs leave is needed once more
        if not out.exists():
            lpvobs.track(CONFIG, [path for path in logs if path not in last], out=out, gain=gain, jobs=1)
        if not month.exists():
            shutil.copy(out, month)
            shutil.copytree(f"{out}.parts", f"{quarter}.parts", dirs_exist_ok=True)
        lpvobs.track(CONFIG, last, out=out, gain=gain, jobs=1)
    lpvobs.track(CONFIG, logs[: len(logs) // 4], out=quarter, gain=gain, jobs=1)
    shutil.copy(out, whole)  # which keeps no parts
    with TemporaryDirectory() as short:
        cut(folder, Path(short))
        many = _measured("track", *given, "--jobs", 2, short, "--out", Path(short) / "fleet.h5")

    def more() -> tuple[float, float, float]:
        shutil.copy(month, folder / "more.h5")
        return _measured("track", *given, "--jobs", 1, *last, "--out", folder / "more.h5")

    return {
        "quarter": min(_measured("track", "--config", CONFIG, "--out", quarter) for _ in range(3)),
        "sums": min(_measured("track", "--config", CONFIG, "--out", whole) for _ in range(3)),
        "month": min(more() for _ in range(3)),
        "short": many,
    }


def _measured(*arguments: object) -> tuple[float, float, float]:
    """Return processor time [s], time [s] and the largest memory [MB] of a command line."""
    begin, before = time.monotonic(), os.times()
    call = [sys.executable, "-c", MEASURED, *map(str, arguments)]
    done = subprocess.run(call, capture_output=True, text=True, check=True)
    clock, after = time.monotonic() - begin, os.times()
    processor = after.children_user + after.children_system - before.children_user - before.children_system
    return processor, clock, float(done.stdout.split()[-1]) / 1024


def _courses(folder: Path, stored: StoredFleet) -> list[Course]:
    """Return what every log leaves, and the root of its noise's covariance."""
    basis, p = stored.kept.basis, stored.grid.size
    parts, found = PartsFolder(folder / "fleet.h5", stored.kept.key + basis.digest(), KeptLog), []
    for log in stored.kept.logs:
        left = parts.read(log.sha256)
        products = left.sums.whole(basis.size)
        variances, axes = np.linalg.eigh(products[:-2, :-2])
        root = (axes * np.sqrt(np.maximum(variances, 0.0) * basis.lasting))[:, variances > 1e-9 * variances[-1]]
        flow = flow_at_nodes(products[:p, :p], products[:p, -2], basis.flow)
        found.append(Course(left, int(log.vehicle[1:]), flow, root.astype(np.float32)))
    return found


def _error(vehicle: Vehicle, stored: StoredFleet, flow: Array, date: float) -> Array:
    """Return the true error of a sensor at the nodes, shape (p,) [kg/s]."""
    fuel, speed = (axis.ravel() for axis in np.meshgrid(stored.grid.fuel, stored.grid.speed))
    when_new = surface_error(surface_of(configuration().simulation.surface, vehicle), fuel, speed, flow)
    gain = vehicle.gain((date - (FIRST - EPOCH).days) / MONTH)
    return gain * (flow + when_new) - flow


def _redrawn(
    stored: StoredFleet, courses: Sequence[Course], seed: int, vehicles: Sequence[Vehicle] = ()
) -> list[tuple[TrackedLog, VehicleSums]]:
    """Return the sums of a fleet whose maps, engines and noise are drawn anew."""
    rng = np.random.default_rng([seed, 81])
    basis, vehicles = stored.kept.basis, vehicles or fleet(seed)
    engines = rng.standard_normal((len(vehicles), basis.engine.shape[1]))
    days = np.sqrt(stored.found.sizes.daily) * CHANGE
    cells = np.arange((stored.grid.speed.size - 1) * (stored.grid.fuel.size - 1))
    found = []
    for course in courses:
        own, log = vehicles[course.vehicle], course.kept.log
        error = _error(own, stored, course.flow, log.date)
        error = error + basis.modes(course.flow) @ (days * rng.standard_normal(days.size))
        truth = np.concatenate([error, engines[course.vehicle]])
        noise = course.root @ rng.standard_normal(course.root.shape[1])
        products = course.kept.sums.whole(basis.size)
        products[:-2, -1] = products[-1, :-2] = products[:-2, :-2] @ truth + noise
        part = SimpleNamespace(run=log, cells=cells, gram=course.kept.sums.gram)
        made = kept(part, products, basis, (log.name, own.name, "diesel", log.date), cells.size)
        found.append((made.log, made.sums))
    return found


def _tracked(stored: StoredFleet, made: Sequence[tuple[TrackedLog, VehicleSums]]) -> tuple[FleetSums, Tracked]:
    sums: dict[str, VehicleSums] = {}
    for log, own in made:
        sums[log.vehicle] = sums[log.vehicle].plus(own) if log.vehicle in sums else own
    every = [log for log, _ in made]
    periods = {log.sha256: date_of(log.date).strftime("%Y-%m") for log in every}
    settings, in_order = configuration().estimate, [sums[name] for name in sorted(sums)]
    least, basis = settings.least_information, stored.kept.basis
    found = track(stored.grid, basis, in_order, every, periods, settings.prior_map, least)
    return replace(stored.kept, sums=tuple(in_order), logs=tuple(every)), found


def _drawn(stored: StoredFleet, courses: Sequence[Course], seed: int) -> Count:
    return _judged(*_tracked(stored, _redrawn(stored, courses, seed)), fleet(seed), stored)


def _with_drift(stored: StoredFleet, courses: Sequence[Course], seed: int) -> list[Count]:
    """Count what is found where a vehicle drifts by shares of what `track` says of this fleet that it finds, others not at all."""
    signs = np.random.default_rng([seed, 90]).choice((-1.0, 1.0), VEHICLES)

    def drifting(slope: float) -> tuple[list[Vehicle], Tracked]:
        slopes = [float(sign * slope) if number < DRIFTING else 0.0 for number, sign in enumerate(signs)]
        vehicles = [
            replace(each, kind="healthy", change=0.0, slope=its) for each, its in zip(fleet(seed), slopes, strict=True)
        ]
        return vehicles, _tracked(stored, _redrawn(stored, courses, seed, vehicles))[1]

    (stated,) = (each.drift for each in drifting(0.0)[1].power if each.logs == MONTHS * A_MONTH)
    counts = []
    for vehicles, found in (drifting(share * stated) for share in SHARES):
        out = {each.vehicle for each in found.vehicles if each.verdict != "steady"}
        right, wrong = (sum(each.name in out for each in part) for part in (vehicles[:DRIFTING], vehicles[DRIFTING:]))
        counts.append(Count(DRIFTING, right, (), VEHICLES - DRIFTING, wrong))
    return counts


def _between(stored: StoredFleet, courses: Sequence[Course], seed: int) -> Between:
    """Compare the last month of every vehicle with the first, at the nodes that it drives."""
    kept_of, found = _tracked(stored, _redrawn(stored, courses, seed))
    total, sums, basis = Between(), {each.vehicle: each for each in kept_of.sums}, kept_of.basis
    settings, pair = configuration().estimate, ("2025-01", f"2025-{MONTHS:02}")
    for vehicle in fleet(seed):
        its = sums[vehicle.name]
        own = vehicle_of(its, kept_of.logs, basis, settings.prior_map)
        periods = {log.sha256: date_of(log.date).strftime("%Y-%m") for log in own.logs}
        known = Fleet(stored.grid, settings.least_information, periods, found.sizes)
        on, maps, covariance = known.moved(own, pair, found.types[0])
        change = Joint(maps[1] - maps[0], covariance)
        days = [np.mean([log.date for log in own.logs if periods[log.sha256] == at]) for at in pair]
        before, after = (_error(vehicle, stored, basis.flow, float(day)) for day in days)
        weight = own.driven.weight
        used = weight[on] > DRIVEN * weight.max()
        inside = (np.abs(change.values - (after - before)[on]) <= NORMAL_90 * change.standard_error)[used]
        healthy = vehicle.kind == "healthy"
        nodes = (0, 0) if healthy else (inside.size, int(inside.sum()))
        total += Between(*nodes, int(healthy), int(healthy and change.nothing() < 0.1))
    return total


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
        driven = Driven(kept_of.basis, sums[vehicle.name])
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
        driven = Driven(stored.kept.basis, sums)
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


def _page(
    whole: Count,
    drawn: Count,
    few: Count,
    between: Between,
    fleets: int,
    timed: dict[str, tuple[float, float, float]],
    power: Sequence[Detectable],
    powers: Sequence[tuple[float, Count]],
) -> str:
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
            f"`compare` of the last month with the first, five fleets: of vehicles that have changed, {between.inside} of "
            f"{between.nodes} driven nodes ({100 * between.inside / between.nodes:.0f} %) hold the true change in their 90 % "
            f"intervals, at the flow that the fleet usually has there; {between.accused} of {between.healthy} healthy vehicles "
            "have p < 0.1.",
            "What `track` says of this fleet's power: changes of the gain that it says it finds nine times out of ten.",
            markdown(
                ["logs of a vehicle", "over [d]", "drift [% a month]", "step [%]"],
                [[str(p.logs), f"{p.days:.0f}", f"{100 * p.drift:.3f}", f"{100 * p.step:.2f}"] for p in power],
            ),
            f"{POWER_FLEETS} fleets drawn anew with {MONTHS * A_MONTH} logs a vehicle. Each is tracked without a drift first, for "
            "what `track` says of this fleet: its noise is drawn wider, so that is more than above. Then one vehicle drifts by a "
            "multiple of it. Where several of twenty drift as slowly, they are taken for the random walk that all vehicles have: "
            "the trend of each is shown with its interval, and none is accused.",
            markdown(
                ["of the drift stated", "found", "others accused"],
                [[f"{share:g}", f"{c.found} of {c.changes}", f"{c.accused} of {c.healthy}"] for share, c in powers],
            ),
            "Time and memory of `lpvobs track`, started afresh, reading and writing the file included; the quickest of a few, and "
            f"the {SHORT} logs once. Other work was done on the machine meanwhile. Memory grows with the fleet that is kept, not "
            "with the logs that are read.",
            markdown(
                ["", "processor [s]", "by the clock [s]", "memory at most [MB]"],
                [
                    [STEPS[name], f"{cpu:.1f}", f"{clock:.1f}", f"{memory:.0f}"]
                    for name, (cpu, clock, memory) in timed.items()
                ],
            ),
        )
    )


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path("build/fleet"), int(sys.argv[2]) if len(sys.argv) > 2 else 20)
