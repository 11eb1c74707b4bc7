"""`/refinement`: the effects of a refined model, the constants that go with them, and the error before and after.

Everything is plain datasets with units on named axes; the contract's JSON stands beside them as an attribute.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import h5py
import numpy as np

from lpvobs.discovery.channels import Curve
from lpvobs.discovery.held_out import Comparison
from lpvobs.discovery.known_effects import KnownEffect, Span
from lpvobs.discovery.whiteness import Whiteness
from lpvobs.io.results.gains import StoredGain
from lpvobs.io.results.hdf import NO_YES, Field, flags, write_group
from lpvobs.io.results.mapping import ENDS, Contents, Item, Labels, Layout, fields, numbered, read, read_rows, rows
from lpvobs.synthesis.sensor_state import SensorState

BOUNDS: Labels = {"quantile": (0.05, 0.95)}


@dataclass(frozen=True)
class StoredRefinement:
    """What a refined result knows beyond its map.

    Attributes
    ----------
    constants : mapping of str to float
        Relative deviation of each uncertain constant from the configured one.
    deviations : mapping of str to float
        Standard deviation of each.
    map_stood : bool
        Whether the map was frozen when the effects were found.
    json : str
        The contract's object.
    """

    effects: tuple[KnownEffect, ...]
    constants: Mapping[str, float]
    deviations: Mapping[str, float]
    map_stood: bool
    json: str


@dataclass(frozen=True)
class _Constant:
    """A constant of the engine, its deviations relative to the configured value."""

    constant: str
    relative_deviation: float
    standard_deviation: float


REFINEMENT = Layout(StoredRefinement, {}, attributes=("json", "map_stood"))
CONSTANTS = Layout(
    _Constant,
    {
        "constant": Item("1", "uncertain constant of the engine"),
        "relative_deviation": Item("1", "from the configured value"),
        "standard_deviation": Item("1", "of the deviation"),
    },
    row="constant",
)
SPANS = Layout(
    Span,
    {
        "log": Item("1", "log that tells of the effect, or is without it"),
        "sha256": Item("1", "SHA-256 of the log"),
        "onset": Item(
            "s",
            "on the log's own time axis, -inf: acts from its first sample, inf: does not act on it",
            (),
            "begin",
            gaps=True,
        ),
        "end": Item("s", "on the log's own time axis, inf: acts to its last sample", gaps=True),
    },
    row="log",
)
OBSERVER = Layout(
    SensorState,
    {
        "L": Item("SI", "gain of the observer with the sensor's state", ("state", "output")),
        "P": Item("SI", "Lyapunov matrix that falls while the map stands", ("state", "other_state")),
        "tau": Item("s", "time constants that are covered", ("end",)),
        "vertices": Item("1", "vertices at which it was proven"),
        "smallest_pivot": Item("1", "smallest relative pivot"),
    },
    {"state": "state", "other_state": "state", "output": "output", "end": ENDS},
)
COMPARISON = Layout(
    Comparison,
    {
        "before": Item("kg/s", "rmse of the held-out residual, before", gaps=True),
        "after": Item("kg/s", "rmse of the held-out residual, after", gaps=True),
        "ratio": Item("1", "after over before", gaps=True),
        "ratio_ci90": Item("1", "90 % interval of the ratio", ("quantile",), gaps=True),
    },
    {"log": "log, or all of them pooled", "quantile": "quantile of the bootstrap over blocks"},
    row="log",
)
WHITENESS = Layout(
    Whiteness,
    {
        "autocorrelation": Item("1", "of the sums over blocks", ("balance", "lag"), gaps=True),
        "band": Item("1", "95 % half width of it for white noise", ("balance", "lag"), gaps=True),
        "p_value": Item("1", "of the portmanteau test", ("balance",), "p_values", gaps=True),
        "periodogram_distance": Item(
            "1", "largest distance of the cumulated periodogram from a line", ("balance",), gaps=True
        ),
        "periodogram_band": Item("1", "its 95 % limit for white noise", gaps=True),
        "white": Item("1", "whether no balance fails"),
    },
    {"balance": "balance", "lag": "lag in blocks"},
)


def _effect(unit: str = "", name: str = "") -> Layout[KnownEffect]:
    """Return how an effect stands in its group, with the unit and the name of its parameter."""
    return Layout(
        KnownEffect,
        {
            "value": Item(unit, name),
            "ci90": Item(unit, "90 % interval of the value", ("quantile",), gaps=True),
            "lasting": Item("1", "whether it acts on logs that took no part, from first to last sample"),
        },
        {"quantile": "quantile"},
        ("id", "place", "parameter", "unit"),
    )


def _curve(signal: str = "", carrier: str = "") -> Layout[Curve]:
    """Return how the curve of an effect of a channel stands in the effect's group."""
    return Layout(
        Curve,
        {
            "knot": Item("1", f"{signal}, in the log's unit, rates per second", of="knots"),
            "deviation": Item("1", f"deviation of {carrier} at amplitude one", ("knot",), "values"),
        },
        attributes=("channel", "of", "carrier"),
    )


def write_refinement(
    file: h5py.File,
    stored: StoredRefinement,
    comparisons: Mapping[str, tuple[Comparison, bool]],
    whiteness: Mapping[str, Whiteness],
    balances: Sequence[str],
) -> None:
    """Write `/refinement` into a result that has none.

    Parameters
    ----------
    comparisons : mapping of str to (Comparison, bool)
        By log, and of all of them, and whether nothing was fitted to it.
    whiteness : mapping of str to Whiteness
        `before` and `after`.
    """
    group = write_group(file, "refinement", fields(REFINEMENT, stored))
    effects = group.create_group("effects")
    for number, effect in enumerate(stored.effects, 1):
        write_group(effects, f"effect_{number}", _effect_contents(effect))
    constants = [_Constant(name, value, stored.deviations[name]) for name, value in stored.constants.items()]
    write_group(group, "constants", rows(CONSTANTS, constants))
    write_comparison(group, comparisons)
    write_structure(group, whiteness, balances)


def read_refinement(file: h5py.File) -> StoredRefinement | None:
    """Return what `/refinement` of an open result holds, None where it has not been refined."""
    if "refinement" not in file:
        return None
    group = file["refinement"]
    constants = read_rows(group["constants"], CONSTANTS)
    return read(
        group,
        REFINEMENT,
        effects=tuple(_read_effect(effect) for effect in numbered(group["effects"], "effect")),
        constants={item.constant: item.relative_deviation for item in constants},
        deviations={item.constant: item.standard_deviation for item in constants},
    )


def write_sensor_state(parent: h5py.Group, found: SensorState, gain: StoredGain) -> None:
    """Write gain and proof of the observer with the sensor's state."""
    states, outputs = (*gain.states, "sensor"), (*gain.outputs, "sensor")
    labels = {"state": states, "other_state": states, "output": outputs}
    write_group(parent, "observer", fields(OBSERVER, found, labels))


def write_comparison(parent: h5py.Group, comparisons: Mapping[str, tuple[Comparison, bool]]) -> None:
    """Write the residual before and after, by log and pooled."""
    each = [comparison for comparison, _ in comparisons.values()]
    unseen = np.array([unseen for _, unseen in comparisons.values()], dtype=np.int8)
    of_log = "whether nothing was fitted to any part of the log"
    contents = rows(COMPARISON, each, {"log": tuple(comparisons), **BOUNDS})
    contents["took_no_part"] = Field(unseen, "1", of_log, ("log",), flags(NO_YES))
    write_group(parent, "comparison", contents)


def write_structure(parent: h5py.Group, whiteness: Mapping[str, Whiteness], balances: Sequence[str]) -> None:
    """Write `whiteness`, the tests of the residual of each model (`before`, `after`), by balance."""
    group = parent.create_group("whiteness")
    for name, found in whiteness.items():
        lags = np.arange(1, found.autocorrelation.shape[1] + 1)
        write_group(group, name, fields(WHITENESS, found, {"balance": balances, "lag": lags}))


def read_structure(parent: h5py.Group) -> dict[str, Whiteness]:
    """Return the tests of the residual of each model; none where none were stored."""
    return {name: read(group, WHITENESS, correlated_with={}) for name, group in parent.get("whiteness", {}).items()}


def _effect_contents(effect: KnownEffect) -> Contents:
    acts = np.array([span.acts for span in effect.spans], dtype=np.int8)
    contents = fields(_effect(effect.unit, f"{effect.parameter} of {effect.id}"), effect, BOUNDS)
    contents |= rows(SPANS, effect.spans)
    contents["acts"] = Field(acts, "1", "on the log", ("log",), flags(NO_YES))
    if effect.curve is not None:
        contents |= fields(_curve(f"{effect.curve.of} of {effect.curve.channel}", effect.curve.carrier), effect.curve)
    return contents


def _read_effect(group: h5py.Group) -> KnownEffect:
    curve = read(group, _curve()) if "knot" in group else None
    return read(group, _effect(), spans=read_rows(group, SPANS), curve=curve)
