"""`/trace` and `/refinement`: effects, the constants that go with them, the error before and after, the data behind figures.

Everything is plain datasets with units on named axes; the contract's JSON stands beside them as an attribute.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated

import h5py
import numpy as np

from lpvobs.discovery import held_out, known_effects, portrait, thresholds
from lpvobs.discovery.whiteness import Whiteness
from lpvobs.io.results import gains, hdf
from lpvobs.io.results.mapping import Labels, numbered, read, rows, write
from lpvobs.records import Item
from lpvobs.synthesis.sensor_state import SensorState

BOUNDS: Labels = {"quantile": (0.05, 0.95)}
CONSTANT = ("constant",)


@dataclass(frozen=True)
class StoredRefinement:
    """What a refined result knows beyond its map; constants are by name."""

    effects: Annotated[tuple[known_effects.KnownEffect, ...], Item(name="effects/effect")]
    constants: Annotated[Mapping[str, float], Item("1", "from the configured value", CONSTANT, "relative_deviation")]
    deviations: Annotated[Mapping[str, float], Item("1", "of the deviation", CONSTANT, "standard_deviation")]
    map_stood: bool  # whether the map was frozen when the effects were found
    json: str  # the contract's object


@dataclass(frozen=True)
class Compared(held_out.Comparison):
    """The error on a log, or on all of them pooled."""

    log: Annotated[str, Item("1", "log, or all of them pooled")]
    took_no_part: Annotated[bool, Item("1", "whether nothing was fitted to any part of the log")]


def write_refinement(file: h5py.File, stored: StoredRefinement) -> h5py.Group:
    """Write `/refinement` into a result that has none, and return the group."""
    group = write(file, "refinement", stored, BOUNDS)
    # beside an effect stands what only its own values say: unit and meaning, and on which logs it acts
    for effect, own in zip(stored.effects, numbered(group, "effects/effect"), strict=True):
        for name in ("value", "ci90"):
            own[name].attrs["units"] = effect.unit
        own["value"].attrs["long_name"] = f"{effect.parameter} of {effect.id}"
        if (curve := effect.curve) is not None:
            along = f"{curve.of} of {curve.channel}, in the log's unit, rates per second"
            own["curve/knot"].attrs["long_name"] = along
            own["curve/deviation"].attrs["long_name"] = f"relative error of {curve.carrier} for an amplitude of 1"
        acts = np.array([span.acts for span in effect.spans], dtype=np.int8)
        hdf.write_fields(own, {"acts": hdf.Field(acts, Item("1", "on the log", ("log",), meanings=hdf.NO_YES))})
    return group


def write_sensor_state(parent: h5py.Group, found: SensorState, gain: gains.StoredGain) -> None:
    """Write gain and proof of the observer with the sensor's state."""
    states, outputs = (*gain.states, "sensor"), (*gain.outputs, "sensor")
    write(parent, "observer", found, {"state": states, "output": outputs})


def write_comparison(parent: h5py.Group, comparisons: Mapping[str, tuple[held_out.Comparison, bool]]) -> None:
    """Write the residual before and after, by log and pooled, and whether nothing was fitted to it."""
    each = [Compared(**vars(found), log=log, took_no_part=unseen) for log, (found, unseen) in comparisons.items()]
    hdf.write_group(parent, "comparison", rows(each, "log", BOUNDS))


def write_structure(parent: h5py.Group, whiteness: Mapping[str, Whiteness], balances: Sequence[str]) -> None:
    """Write `whiteness`, the tests of the residual of each model (`before`, `after`), by balance."""
    group = parent.create_group("whiteness")
    for name, found in whiteness.items():
        write(group, name, found, {"balance": balances, "lag": np.arange(1, found.autocorrelation.shape[1] + 1)})


def read_structure(parent: h5py.Group) -> dict[str, Whiteness]:
    """Return the tests of the residual of each model; none where none were stored."""
    return {name: read(group, Whiteness) for name, group in parent.get("whiteness", {}).items()}


def write_portrait(parent: h5py.Group, seen: portrait.Portrait) -> None:
    """Write `plots`: the data behind the figures, so that a report needs no logs."""
    size = seen.cumulated.shape[2]
    shares, lags = np.arange(1, size + 1) / max(size, 1), np.arange(-thresholds.LAGS, thresholds.LAGS + 1)
    labels = {"balance": seen.balances, "state": ("before", "after"), "share": shares, "lag": lags}
    write(parent, "plots", seen, labels)
