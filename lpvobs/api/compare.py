"""`compare`: what differs between two maps, and where that is more than their errors."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
import scipy
from msgspec import Meta
from numpy.typing import NDArray

from lpvobs.api import export, files
from lpvobs.errors import DataError, NotProven, UsageError
from lpvobs.io.configuration.config import config_of
from lpvobs.io.logs.units import convert
from lpvobs.io.results import fleets, surfaces
from lpvobs.kinds import Count, KgPerS, Output
from lpvobs.maps import joint, quadratic
from lpvobs.records import Array
from lpvobs.report.gates import parse_gate
from lpvobs.tracking.fleet import Fleet
from lpvobs.tracking.timeline import vehicle_of

FAMILY = 0.05
"""Probability that any node at all is called significant where nothing has changed (Bonferroni over the nodes compared)."""
METRICS = ("largest_change", "mean_change", "p_value")


class MeanChange(Output):
    """A mean over a region, or over all nodes compared."""

    value: KgPerS
    ci90: tuple[KgPerS, KgPerS]


class NodeChange(Output):
    """The change at one node."""

    speed: float
    fuel: float
    before: KgPerS
    after: KgPerS
    change: KgPerS
    ci90: tuple[KgPerS, KgPerS]


class CompareOutput(Output):
    """The second map less the first."""

    first: str
    second: str
    values: Annotated[str, Meta(extra_json_schema={"enum": export.SOURCES})]
    axes: tuple[str, str]  # of speed and fuel, with units
    nodes: Count  # that have a value in both
    mean: MeanChange
    p_value: Annotated[float, Meta(description="Probability of changes as large as these if nothing has changed.")]
    largest_change: KgPerS  # among the significant nodes, zero where none is
    significant: Sequence[NodeChange]  # the largest first


def compare(
    first: files.File,
    second: files.File | None = None,
    *,
    vehicle: str = "",
    periods: Sequence[str] = (),
    values: str = "map",
    region: Mapping[str, tuple[float, float]] | None = None,
    gates: Sequence[str] = (),
    figure: files.File | None = None,
) -> CompareOutput:
    """Return how the second map differs from the first, with intervals from the covariance of both.

    Raises NotProven if a gate fails; DataError if a file is no result, or the two have nothing in common; UsageError if a gate
    cannot be understood.

    Parameters
    ----------
    first, second : path
        Results for one kind of engine; the first is laid onto the axes of the second. With `vehicle`, a fleet alone.
    vehicle : str
        A vehicle of the fleet.
    periods : two str
        Those of its periods, such as `2025-01`, whose maps are compared.
    values : str
        `map`: nodes that both have estimated; `extrapolation`: every node.
    region : mapping of str to (float, float), optional
        From and to by the name of an axis, for the mean; by default all nodes that are compared count alike.
    gates : sequence of str
        Such as `largest_change<=0.5 g/s`; metrics are `largest_change`, `mean_change` (in size) and `p_value`.
    figure : path, optional
        Where to draw the change at every node, as SVG.

    Returns
    -------
    CompareOutput
        Flows in kg/s. The errors of two results count as independent; constants of one engine that both share make the intervals
        wider than need be. Two periods of a vehicle share its engine and its drives, and their intervals take account of it.
    """
    files.expect_one_of("--values", values, export.SOURCES)
    if vehicle or second is None:
        if values != "map":
            raise UsageError(f"--values {values}: a fleet contains no extrapolated maps; drop --values")
        if second is not None or not vehicle or not len(periods) == len({*periods}) == 2:
            raise UsageError(
                "expected two results to compare, or one fleet with --vehicle NAME and two different periods, each given by "
                "--period"
            )
        change, later = _between(files.as_path(first), vehicle, (periods[0], periods[1]))
        names = [f"{first}: {vehicle} {period}" for period in periods]
    else:
        before, after = (surfaces.read_surface(files.as_path(each), values) for each in (first, second))
        change, later, names = after.difference(before), after.values, [str(first), str(second)]
    on = np.flatnonzero(np.isfinite(change.values.ravel()) & np.isfinite(change.standard_error.ravel()))
    if not on.size:
        raise DataError(
            f"{names[0]}, {names[1]}: no node has a value with a standard error in both maps; run `lpvobs extrapolate` on both "
            "results, then compare with --values extrapolation"
        )
    nodes = joint.Joint(change.values.ravel()[on], change.covariance[np.ix_(on, on)])
    alike = joint.Joint(nodes.values.mean(keepdims=True), nodes.covariance.mean(keepdims=True))
    mean = alike if region is None else change.mean(region)
    rows = _significant(change, later, nodes, on)
    found = CompareOutput(
        first=names[0],
        second=names[1],
        values=values,
        axes=(f"{change.x.name} [{change.x.unit}]", f"{change.y.name} [{change.y.unit}]"),
        nodes=int(on.size),
        mean=MeanChange(value=float(mean.values[0]), ci90=(*mean.ci90[0].tolist(),)),
        p_value=nodes.nothing(),
        largest_change=abs(rows[0].change) if rows else 0.0,
        significant=rows,
    )
    if figure is not None:
        _draw(figure, [first, *([second] if second else [])], change, found)
    expect_gates(found, gates)
    return found


def _between(path: Path, vehicle: str, pair: tuple[str, str]) -> tuple[surfaces.Surface, Array]:
    """Return how the map of a vehicle has changed between a pair of periods, and the values of the later one."""
    fleet = fleets.read_fleet(path)
    kept, settings = fleet.kept, config_of(fleet.provenance.config, path).estimate
    sums = {each.vehicle: each for each in kept.sums}
    there = [each.period for each in fleet.found.maps if each.vehicle == vehicle]
    if missing := [each for each in pair if each not in there]:
        held = f"periods with a map: {', '.join(there)}" if there else f"vehicles in this fleet: {', '.join(sums)}"
        raise DataError(f"{path}: this fleet has no map of vehicle {vehicle} in period {missing[0]}; {held}")
    own = vehicle_of(sums[vehicle], kept.logs, kept.basis, settings.prior_map)
    its = Fleet(fleet.grid, settings.least_information, kept.periods(), fleet.found.sizes)
    (kind,) = (each for each in fleet.found.types if each.kind == sums[vehicle].kind)
    on, values, errors = its.moved(own, pair, kind)
    shape, known = fleet.grid.shape, np.isin(np.arange(fleet.grid.size), on)
    maps, covariance = np.full((2, known.size), np.nan), np.zeros((known.size, known.size))
    maps[:, on], covariance[np.ix_(on, on)] = values, errors
    x, y = surfaces.surface_axes(fleet.axes, fleet.grid)
    error = np.where(known, np.sqrt(np.diag(covariance)), np.nan).reshape(shape)
    origin = np.where(known, quadratic.ESTIMATED, surfaces.NONE).astype(np.int8).reshape(shape)
    before, after = maps.reshape(2, *shape)
    return surfaces.Surface(x, y, after - before, error, covariance, origin, "kg/s", "difference"), after


def _draw(figure: files.File, maps: Sequence[files.File], change: surfaces.Surface, found: CompareOutput) -> None:
    from lpvobs.report.content import view_of
    from lpvobs.report.figures import error_limit, error_map

    nodes = {(node.speed, node.fuel) for node in found.significant}
    changed = np.array([[(n, u) in nodes for u in change.y.nodes] for n in change.x.nodes])
    view = view_of(change, np.zeros(changed.shape, dtype=bool))
    alt, label = f"{found.second} minus {found.first}", "change of the sensor error [g/s]"
    drawn = error_map("change", alt, view, error_limit([view]), label, changed)
    files.write_text(figure, drawn.replace("<svg", '<svg xmlns="http://www.w3.org/2000/svg"', 1), maps)


def expect_gates(found: CompareOutput, gates: Sequence[str]) -> None:
    """Raise NotProven where a gate fails, UsageError where one cannot be understood."""
    known = {"largest_change": found.largest_change, "mean_change": abs(found.mean.value), "p_value": found.p_value}
    parsed = [parse_gate(*_in_units(gate), METRICS) for gate in ([gates] if isinstance(gates, str) else gates)]
    failed = [gate for gate in parsed if not gate.holds(known[gate.metric])]
    if failed:
        gate, unit = failed[0], "" if failed[0].metric == "p_value" else " kg/s"
        raise NotProven(
            f"gate failed: from {found.first} to {found.second}, {gate.metric} = {known[gate.metric]:.6g}{unit}, "
            f"but the gate is {gate}{unit}; check the nodes with significant changes, or widen the gate"
        )


def _in_units(gate: str) -> tuple[str, float]:
    """Return a gate without the unit of its limit, and what the unit is in kg/s."""
    text, _, unit = gate.strip().rpartition(" ")
    if not text or unit[:1].isdigit() or unit[:1] in "<>=.-+":
        if gate.strip().startswith(METRICS[:2]):
            raise UsageError(f"--gate '{gate}': the limit has no unit; expected for example {METRICS[0]}<=0.5 g/s")
        return gate, 1.0
    try:
        return text, float(convert(np.ones(1), unit, "kg/s")[0])
    except ValueError:
        raise UsageError(f"--gate '{gate}': '{unit}' is not a unit of flow; expected for example 0.5 g/s") from None


def _significant(change: surfaces.Surface, after: Array, nodes: joint.Joint, on: NDArray[np.int64]) -> list[NodeChange]:
    """Return the nodes whose change is beyond its error, however many are looked at; the largest first."""
    least = scipy.special.ndtri(1.0 - 0.5 * FAMILY / on.size) * nodes.standard_error
    found = [i for i in np.argsort(-np.abs(nodes.values), kind="stable") if abs(nodes.values[i]) > least[i]]
    speed, fuel = np.unravel_index(on, change.values.shape)
    return [
        NodeChange(
            speed=float(change.x.nodes[speed[i]]),
            fuel=float(change.y.nodes[fuel[i]]),
            before=float(after[speed[i], fuel[i]] - nodes.values[i]),
            after=float(after[speed[i], fuel[i]]),
            change=float(nodes.values[i]),
            ci90=(*nodes.ci90[i].tolist(),),
        )
        for i in found
    ]


def region_of(text: str) -> dict[str, tuple[float, float]]:
    """Return from and to by the name of an axis, of `n_e=1500:2500,u_delta=8:24`; raises UsageError for anything else."""
    found = {}
    for part in text.split(","):
        name, _, ends = part.partition("=")
        low, _, high = ends.partition(":")
        try:
            found[name.strip()] = (float(low), float(high))
        except ValueError:
            raise UsageError(
                f"--region {text}: expected AXIS=FROM:TO for one axis, or for both axes with a comma between"
            ) from None
    return found
