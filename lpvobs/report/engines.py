"""What is said of a calibrated engine: records for `--json`, rows of text."""

from collections.abc import Mapping, Sequence
from typing import Annotated

import numpy as np
from msgspec import Meta

from lpvobs.io.results.engines import StoredEngine
from lpvobs.kinds import Count, Finite, Output
from lpvobs.records import Array
from lpvobs.report.tables import Table, percent


class RowsOutput(Output):
    """How well bench rows of one kind fit."""

    kind: str
    rows: Count
    configured: Annotated[Finite, Meta(description="Rms error of the configured engine, divided by the rms flow.")]
    held_out: Annotated[Finite, Meta(description="Rms error at held-out points, divided by the rms flow.")]
    left: Annotated[Finite, Meta(description="Error that no smooth correction removes, as a share of the flow.")]


class ComponentOutput(Output):
    """The correction of a component; in the unit of the correction."""

    component: str
    unit: str
    largest: Annotated[Finite, Meta(description="Largest absolute value of the correction.")]
    standard_error: Annotated[Finite, Meta(description="Median standard error of its nodes.")]
    before: Annotated[
        Finite | None, Meta(description="Median standard error before the data; null where there was no prior.")
    ]


class ConstantOutput(Output):
    """A constant, as its relative deviation from the configured one."""

    deviation: Finite
    standard_error: Finite
    determined: Annotated[
        bool,
        Meta(description="Whether the data determine it: less than half of the prior's standard deviation is left."),
    ]


class PlannedPoint(Output):
    """A bench point that is worth recording."""

    point: Annotated[Mapping[str, Finite], Meta(description="Values that the bench has to set, by channel.")]
    units: Mapping[str, str]
    before: Annotated[Finite, Meta(description="Rms uncertainty of the air flow over all points without this point.")]
    after: Annotated[
        Finite, Meta(description="Rms uncertainty of the air flow with this point and the points before it.")
    ]


class CalibrateOutput(Output):
    """What is known of an engine."""

    engine: str
    points: Annotated[Count, Meta(description="Number of stationary bench points.")]
    inputs: Sequence[str]
    rows: Sequence[RowsOutput]
    components: Sequence[ComponentOutput]
    amplitudes: Annotated[
        Mapping[str, Finite],
        Meta(description="Amplitude of the corrections, divided by the prior's amplitude, by group."),
    ]
    constants: Mapping[str, ConstantOutput]
    plan: Annotated[Sequence[PlannedPoint], Meta(description="With --plan: further bench points, the best first.")]


def told(stored: StoredEngine, out: str, plan: Sequence[PlannedPoint] = ()) -> CalibrateOutput:
    """Return what is said of a calibrated engine."""
    mean, error, determined = stored.unknowns.mean, stored.error, stored.determined.tolist()
    curves = {} if stored.learned is None else stored.learned.known.curves
    components = [
        _component(component.name, component.unit, mean[own], error[own], float(np.median(stored.prior_error[own])))
        for component, own in zip(stored.unknowns.components, stored.unknowns.places().values(), strict=True)
    ]
    components += [_component(name, of.unit, of.values, of.relative_error * of.values) for name, of in curves.items()]
    return CalibrateOutput(
        engine=out,
        points=len({row.point for row in stored.rows if row.point >= 0}),
        inputs=tuple(stored.provenance.inputs_sha256),
        rows=tuple(_fit(stored, kind, left) for kind, left in stored.left.items()),
        components=tuple(components),
        amplitudes=stored.amplitudes,
        constants={
            name: ConstantOutput(deviation=value, standard_error=float(error[i]), determined=determined[i])
            for i, (name, value) in enumerate(stored.deviation.items())
        },
        plan=plan,
    )


def _component(name: str, unit: str, values: Array, errors: Array, before: float | None = None) -> ComponentOutput:
    largest, usual = float(np.abs(values).max()), float(np.median(errors))
    return ComponentOutput(component=name, unit=unit, largest=largest, standard_error=usual, before=before)


def flows_of(stored: StoredEngine, kind: str) -> Array:
    """Return the reference of every row of a kind, what it is beyond the configured engine, and held out, shape (3, m) [kg/s]."""
    own = [row for row in stored.rows if row.kind == kind]
    return np.array([[getattr(row, name) for row in own] for name in ("reference", "before", "held_out")])


def _fit(stored: StoredEngine, kind: str, left: float) -> RowsOutput:
    flows = flows_of(stored, kind)
    flow, before, held_out = np.sqrt(np.nanmean(flows**2, axis=1)).tolist()
    return RowsOutput(kind=kind, rows=flows.shape[1], configured=before / flow, held_out=held_out / flow, left=left)


def calibration_tables(found: CalibrateOutput) -> list[Table]:
    """Return how well bench rows fit, the corrections of the components, and which points to record next."""
    fit = [[row.kind, str(row.rows), *map(percent, (row.configured, row.held_out, row.left))] for row in found.rows]
    corrections = [
        [of.component, of.unit] + ["-" if x is None else f"{x:.2g}" for x in (of.largest, of.standard_error, of.before)]
        for of in found.components
    ]
    tables = [(["correction", "unit", "largest", "standard error", "before the data"], corrections)]
    if found.plan:
        header = [f"{name} {unit}" for name, unit in found.plan[0].units.items()]
        rows = [[*(f"{x:.5g}" for x in item.point.values()), f"{100 * item.after:.3g} %"] for item in found.plan]
        tables.append(([*header, "then unknown"], rows))
    return [(["flow", "rows", "as configured", "held out", "left over"], fit), *tables] if fit else tables
