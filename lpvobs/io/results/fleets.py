"""A fleet in one HDF5 file: the sums of all logs, by which it goes on without them, and what was found from them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np

from lpvobs.errors import DataError
from lpvobs.io.arrow import pa, pq
from lpvobs.io.logs.finding import PERIODS, date_of
from lpvobs.io.results import hdf, results, surfaces
from lpvobs.io.results.mapping import fields, layout_of, read, read_if_there
from lpvobs.io.results.provenance import Provenance, read_refused, write_refused
from lpvobs.io.safety.atomic import replacing
from lpvobs.maps.grid import Grid
from lpvobs.records import Item
from lpvobs.tracking.fleet import Tracked
from lpvobs.tracking.sums import Basis, DatedEffect, TrackedLog, VehicleSums

KIND = "fleet"
REMEDY = "make a fleet with `lpvobs track`"
LABELS = {"aspect": ("level", "gain", "shape")}


@dataclass(frozen=True)
class FleetSums:
    """What all logs of a fleet leave, and what it depends on."""

    key: str  # digest of everything but the logs
    every: str
    deviation: Mapping[str, float]  # of the engine's constants, where it is linearised
    basis: Annotated[Basis, Item("1", "how rows are weighed")]
    sums: Annotated[tuple[VehicleSums, ...], Item("1", "sums of a vehicle", name="vehicle")] = ()  # by name
    logs: Annotated[tuple[TrackedLog, ...], Item("1", "logs", ("log",))] = ()  # by digest

    def periods(self) -> dict[str, str]:
        """Return the period of every log, by its digest."""
        return {log.sha256: date_of(log.date).strftime(PERIODS[self.every]) for log in self.logs}


@dataclass(frozen=True)
class StoredFleet:
    """A fleet as read back."""

    path: Path
    air_path: str
    axes: surfaces.Axes
    grid: Grid
    kept: Annotated[FleetSums, Item(name="sums")]
    found: Annotated[Tracked, Item(name=".")]
    effects: Annotated[tuple[DatedEffect, ...], Item(axes=("effect",), name="effects")]  # by vehicle and date
    provenance: Annotated[Provenance, Item()]
    refused: tuple[str, ...] = ()  # why other logs were left out


def write_fleet(fleet: StoredFleet) -> None:
    """Write a fleet, which appears whole."""
    with hdf.creating(fleet.path, KIND) as file:
        file.attrs["air_path"] = fleet.air_path
        layout = fields(surfaces.grid_layout(fleet.axes), fleet.grid)
        hdf.write_group(file, "map", layout).attrs["axes"] = " ".join(fleet.axes)
        hdf.write_fields(file, fields(replace(layout_of(StoredFleet), attributes=()), fleet, LABELS))
        write_refused(file, fleet.refused)


def read_fleet(path: Path) -> StoredFleet:
    """Return a stored fleet; raises DataError if the file is no complete one."""
    with hdf.reading(path, KIND, REMEDY) as file:
        axes, of = surfaces.axes_of(file), str(file.attrs["air_path"])
        grid = read(file["map"], surfaces.grid_layout(axes))
        return read(file, StoredFleet, path=path, air_path=of, axes=axes, grid=grid, refused=read_refused(file))


def dated(refined: Path, logs: Sequence[TrackedLog]) -> list[DatedEffect]:
    """Return the effects of a refined result in the time of the fleet; raises DataError if none of its logs is in it."""
    from lpvobs.io.results.refinements import StoredRefinement  # loads the search for effects

    with hdf.reading(refined, results.KIND, "make a result with `lpvobs refine`") as file:
        stored = read_if_there(file.get("refinement"), StoredRefinement)
    known, found = {log.sha256: log for log in logs}, []
    for effect in () if stored is None else stored.effects:
        spans = [(known[span.sha256], span.begin < np.inf) for span in effect.spans if span.sha256 in known]
        present = [log for log, acts in spans if acts]
        if not present:
            raise DataError(
                f"{refined}: effect {effect.id} was found on logs that are not in the fleet; give these logs to `lpvobs track`, too"
            )
        for vehicle in sorted({log.vehicle for log in present}):
            days = [log.date for log in present if log.vehicle == vehicle]
            before = [log.date for log, acts in spans if not acts and log.vehicle == vehicle and log.date <= min(days)]
            size = (effect.id, effect.parameter, effect.unit, effect.value, *effect.ci90)
            found.append(DatedEffect(vehicle, *size, max(before, default=np.nan), min(days), max(days)))
    return found


def write_table(path: Path, fleet: StoredFleet) -> None:
    """Write the maps as a Parquet file in long form: a row for each vehicle, period and node; units are in the metadata."""
    maps, nodes = fleet.found.maps, fleet.grid.size
    speed, fuel = (axis.ravel() for axis in np.meshgrid(fleet.grid.speed, fleet.grid.fuel, indexing="ij"))
    types = {each.vehicle: each.type for each in fleet.found.vehicles}
    columns = {
        "type": np.repeat([types[each.vehicle] for each in maps], nodes),
        "vehicle": np.repeat([each.vehicle for each in maps], nodes),
        "period": np.repeat([each.period for each in maps], nodes),
        **{name: np.tile(axis, len(maps)) for name, axis in zip(fleet.axes, (fuel, speed), strict=True)},
        "delta_W_c": np.concatenate([each.theta for each in maps]),
        "standard_error": np.concatenate([each.standard_error for each in maps]),
    }
    units = {name: item.unit for name, item in fleet.axes.items()} | {"delta_W_c": "kg/s", "standard_error": "kg/s"}
    arrays = {name: pa.array(column) for name, column in columns.items()}
    metadata = {name: {"unit": unit} for name, unit in units.items()}
    schema = pa.schema([pa.field(name, each.type, metadata=metadata.get(name)) for name, each in arrays.items()])
    with replacing(path) as temporary:
        pq.write_table(pa.table([*arrays.values()], schema=schema), temporary)
