"""`compare`: what differs between two maps, and where that is more than their errors."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
import scipy
from msgspec import Meta
from numpy.typing import NDArray

from lpvobs.api.export import SOURCES
from lpvobs.api.files import File, as_path, writing
from lpvobs.engines.base import MapAxis
from lpvobs.errors import DataError, NotProven, UsageError
from lpvobs.io.logs.units import convert
from lpvobs.io.results.surfaces import Surface, read_surface
from lpvobs.io.safety.atomic import replacing
from lpvobs.kinds import Count, KgPerS
from lpvobs.maps.grid import Grid
from lpvobs.maps.joint import Joint
from lpvobs.records import Array
from lpvobs.report.gates import parse_gate

FAMILY = 0.05
"""Probability that any node at all is called significant where nothing has changed (Bonferroni over the nodes compared)."""
METRICS = ("largest_change", "mean_change", "p_value")


@dataclass(frozen=True, kw_only=True)
class MeanChange:
    """A mean over a region, or over all nodes compared."""

    value: KgPerS
    ci90: tuple[KgPerS, KgPerS]


@dataclass(frozen=True, kw_only=True)
class NodeChange:
    """The change at one node."""

    speed: float
    fuel: float
    before: KgPerS
    after: KgPerS
    change: KgPerS
    ci90: tuple[KgPerS, KgPerS]


@dataclass(frozen=True, kw_only=True)
class CompareOutput:
    """The second map less the first."""

    first: str
    second: str
    values: Annotated[str, Meta(extra_json_schema={"enum": SOURCES})]
    axes: tuple[str, str]  # of speed and fuel, with units
    nodes: Count  # that have a value in both
    mean: MeanChange
    p_value: Annotated[float, Meta(description="Of so large a change at the nodes if nothing has changed.")]
    largest_change: KgPerS  # among the significant nodes, zero where none is
    significant: Sequence[NodeChange]  # the largest first


def compare(
    first: File,
    second: File,
    *,
    values: str = "map",
    region: Mapping[str, tuple[float, float]] | None = None,
    gates: Sequence[str] = (),
    figure: File | None = None,
) -> CompareOutput:
    """Return how the second map differs from the first, with intervals from the covariance of both.

    Raises NotProven if a gate fails; DataError if a file is no result, or the two have nothing in common; UsageError if a gate
    cannot be understood.

    Parameters
    ----------
    first, second : path
        Results for one kind of engine; the first is laid onto the axes of the second.
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
        Flows in kg/s. The errors of the two count as independent; constants of one engine that both share make the intervals
        wider than need be.
    """
    if values not in SOURCES:
        raise UsageError(f"--values {values}: expected {' or '.join(SOURCES)}")
    before, after = (read_surface(as_path(each), values) for each in (first, second))
    change = after.difference(before)
    on = np.flatnonzero(np.isfinite(change.values.ravel()) & np.isfinite(change.standard_error.ravel()))
    if not on.size:
        raise DataError(f"{first}, {second}: no node has a value with an error in both; extrapolate both")
    nodes = Joint(change.values.ravel()[on], change.covariance[np.ix_(on, on)])
    alike = Joint(nodes.values.mean(keepdims=True), nodes.covariance.mean(keepdims=True))
    mean = alike if region is None else change.mean(region)
    rows = _significant(change, after, nodes, on)
    found = CompareOutput(
        first=str(first),
        second=str(second),
        values=values,
        axes=(f"{change.x.name} [{change.x.unit}]", f"{change.y.name} [{change.y.unit}]"),
        nodes=int(on.size),
        mean=MeanChange(value=float(mean.values[0]), ci90=_pair(mean.ci90[0])),
        p_value=nodes.nothing(),
        largest_change=abs(rows[0].change) if rows else 0.0,
        significant=rows,
    )
    if figure is not None:
        _draw(figure, (first, second), change, found)
    expect_gates(found, gates)
    return found


def _draw(figure: File, maps: tuple[File, File], change: Surface, found: CompareOutput) -> None:
    from lpvobs.report.content import SurfaceView
    from lpvobs.report.surface_figures import change_map

    nodes = {(node.speed, node.fuel) for node in found.significant}
    changed = np.array([[(n, u) in nodes for u in change.y.nodes] for n in change.x.nodes])
    fuel, speed = (MapAxis(axis.name, axis.unit, axis.long_name) for axis in (change.y, change.x))
    grid = Grid(change.y.nodes, change.x.nodes)
    view = SurfaceView(grid, (fuel, speed), change.values, np.zeros(grid.shape, dtype=bool))
    drawn = change_map("change", f"{found.second} less {found.first}", view, changed)
    with writing(figure, maps) as path, replacing(path) as temporary:
        temporary.write_text(drawn.replace("<svg", '<svg xmlns="http://www.w3.org/2000/svg"', 1), encoding="utf-8")


def expect_gates(found: CompareOutput, gates: Sequence[str]) -> None:
    """Raise NotProven where a gate fails, UsageError where one cannot be understood."""
    known = {"largest_change": found.largest_change, "mean_change": abs(found.mean.value), "p_value": found.p_value}
    parsed = [parse_gate(*_in_units(gate), METRICS) for gate in ([gates] if isinstance(gates, str) else gates)]
    failed = [gate for gate in parsed if not gate.holds(known[gate.metric])]
    if failed:
        gate = failed[0]
        raise NotProven(
            f"gate failed: {found.second} less {found.first} has {gate.metric} = {known[gate.metric]:.6g}, the gate is {gate}; "
            f"look at the significant nodes, or widen the gate"
        )


def _in_units(gate: str) -> tuple[str, float]:
    """Return a gate without the unit of its limit, and what the unit is in kg/s."""
    text, _, unit = gate.strip().rpartition(" ")
    if not text or unit[:1].isdigit() or unit[:1] in "<>=.-+":
        return gate, 1.0
    try:
        return text, float(convert(np.ones(1), unit, "kg/s")[0])
    except ValueError:
        raise UsageError(f"--gate '{gate}': no unit of a flow: '{unit}'; expected for example 0.5 g/s") from None


def _significant(change: Surface, after: Surface, nodes: Joint, on: NDArray[np.int64]) -> list[NodeChange]:
    """Return the nodes whose change is beyond its error, however many are looked at; the largest first."""
    least = scipy.special.ndtri(1.0 - 0.5 * FAMILY / on.size) * nodes.standard_error
    found = [i for i in np.argsort(-np.abs(nodes.values), kind="stable") if abs(nodes.values[i]) > least[i]]
    speed, fuel = np.unravel_index(on, change.values.shape)
    return [
        NodeChange(
            speed=float(change.x.nodes[speed[i]]),
            fuel=float(change.y.nodes[fuel[i]]),
            before=float(after.values[speed[i], fuel[i]] - nodes.values[i]),
            after=float(after.values[speed[i], fuel[i]]),
            change=float(nodes.values[i]),
            ci90=_pair(nodes.ci90[i]),
        )
        for i in found
    ]


def _pair(interval: Array) -> tuple[float, float]:
    return float(interval[0]), float(interval[1])


def region_of(text: str) -> dict[str, tuple[float, float]]:
    """Return from and to by the name of an axis, of `n_e=1500:2500,u_delta=8:24`; raises UsageError for anything else."""
    found = {}
    for part in text.split(","):
        name, _, ends = part.partition("=")
        low, _, high = ends.partition(":")
        try:
            found[name.strip()] = (float(low), float(high))
        except ValueError:
            raise UsageError(f"--region {text}: expected AXIS=FROM:TO, then a comma before a second axis") from None
    return found
