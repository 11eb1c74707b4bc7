"""`/refinement`: the effects of a refined model, the constants that go with them, and the error before and after.

Everything is plain datasets with units on named axes; the contract's JSON stands beside them as an attribute.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import h5py
import numpy as np

from lpvobs.discovery.channels import Curve
from lpvobs.discovery.held_out import Comparison
from lpvobs.discovery.standing import Span, Standing
from lpvobs.discovery.whiteness import Whiteness
from lpvobs.io.results.gains import StoredGain
from lpvobs.io.results.hdf import Field, flags, text, write_group
from lpvobs.synthesis.sensor_state import SensorState

YES = flags([0, 1], ["no", "yes"])
BOUNDS = np.array([0.05, 0.95])


@dataclass(frozen=True)
class StoredRefinement:
    """What a refined result knows beyond its map.

    Attributes
    ----------
    effects : tuple of Standing
    constants : mapping of str to float
        Relative deviation of each uncertain constant from the configured one.
    deviations : mapping of str to float
        Standard deviation of each.
    of_map : mapping of str to float
        Relative deviation of the constants that the map was estimated with.
    map_stood : bool
        Whether the map was frozen when the effects were found.
    json : str
        The contract's object.
    """

    effects: tuple[Standing, ...]
    constants: Mapping[str, float]
    deviations: Mapping[str, float]
    of_map: Mapping[str, float]
    map_stood: bool
    json: str


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
    file : h5py.File
    stored : StoredRefinement
    comparisons : mapping of str to (Comparison, bool)
        By log, and of all of them, and whether nothing was fitted to it.
    whiteness : mapping of str to Whiteness
        `before` and `after`.
    balances : sequence of str
    """
    group = file.create_group("refinement")
    group.attrs["json"] = stored.json
    group.attrs["map_frozen"] = np.int8(stored.map_stood)
    effects = group.create_group("effects")
    effects.attrs["count"] = len(stored.effects)
    for number, effect in enumerate(stored.effects, 1):
        _write_effect(effects, f"effect_{number}", effect)
    _write_constants(group, stored)
    write_comparison(group, comparisons)
    write_structure(group, whiteness, balances)


def read_refinement(file: h5py.File) -> StoredRefinement | None:
    """Return what `/refinement` of an open result holds, None where it has not been refined."""
    if "refinement" not in file:
        return None
    group = file["refinement"]
    constants = group["constants"]
    names = list(constants["constant"].asstr()[()]) if "constant" in constants else []
    values, spread, of_map = (
        constants[name][()].tolist() if names else []
        for name in ("relative_deviation", "standard_deviation", "relative_deviation_of_map")
    )
    effects = group["effects"]
    return StoredRefinement(
        effects=tuple(_read_effect(effects[f"effect_{i + 1}"]) for i in range(int(effects.attrs["count"]))),
        constants=dict(zip(names, values, strict=True)),
        deviations=dict(zip(names, spread, strict=True)),
        of_map=dict(zip(names, of_map, strict=True)),
        map_stood=bool(group.attrs["map_frozen"]),
        json=str(group.attrs["json"]),
    )


def write_sensor_state(parent: h5py.Group, found: SensorState, gain: StoredGain) -> None:
    """Write gain and proof of the observer with the sensor's state."""
    states, outputs = (*gain.states, "sensor"), (*gain.outputs, "sensor")
    write_group(
        parent,
        "observer",
        {
            "state": Field(text(states), "1", "state"),
            "other_state": Field(text(states), "1", "state"),
            "output": Field(text(outputs), "1", "output"),
            "end": Field(np.array([0, 1], dtype=np.int8), "1", "which end", (), flags([0, 1], ["lower", "upper"])),
            "L": Field(found.L, "SI", "gain of the observer with the sensor's state", ("state", "output")),
            "P": Field(found.P, "SI", "Lyapunov matrix that falls while the map stands", ("state", "other_state")),
            "tau": Field(np.array(found.tau), "s", "time constants that are covered", ("end",)),
            "vertices": Field(found.vertices, "1", "vertices at which it was proven"),
            "smallest_pivot": Field(found.smallest_pivot, "1", "smallest relative pivot"),
        },
    )


def write_comparison(parent: h5py.Group, comparisons: Mapping[str, tuple[Comparison, bool]]) -> None:
    """Write the residual before and after, by log and pooled."""
    each = [comparison for comparison, _ in comparisons.values()]
    unit, axes = "kg/s", ("log",)
    write_group(
        parent,
        "comparison",
        {
            "log": Field(text(list(comparisons)), "1", "log, or all of them pooled"),
            "quantile": Field(BOUNDS, "1", "quantile of the bootstrap over blocks"),
            "before": Field(np.array([c.before for c in each]), unit, "rmse of the held-out residual, before", axes),
            "after": Field(np.array([c.after for c in each]), unit, "rmse of the held-out residual, after", axes),
            "ratio": Field(np.array([c.ratio for c in each]), "1", "after over before", axes),
            "ratio_ci90": Field(
                np.array([c.ratio_ci90 for c in each]), "1", "90 % interval of the ratio", ("log", "quantile")
            ),
            "took_no_part": Field(
                np.array([unseen for _, unseen in comparisons.values()], dtype=np.int8),
                "1",
                "whether nothing was fitted to any part of the log",
                axes,
                YES,
            ),
        },
    )


def write_structure(parent: h5py.Group, whiteness: Mapping[str, Whiteness], balances: Sequence[str]) -> None:
    """Write `whiteness`, the tests of the residual of each model (`before`, `after`), by balance."""
    group = parent.create_group("whiteness")
    for name, found in whiteness.items():
        _write_whiteness(group, name, found, balances)


def read_structure(parent: h5py.Group) -> dict[str, Whiteness]:
    """Return the tests of the residual of each model; none where none were stored."""
    return {name: _read_whiteness(group) for name, group in parent.get("whiteness", {}).items()}


def _read_whiteness(group: h5py.Group) -> Whiteness:
    return Whiteness(
        white=bool(group["white"][()]),
        autocorrelation=group["autocorrelation"][()],
        band=group["band"][()],
        p_values=group["p_value"][()],
        periodogram_distance=group["periodogram_distance"][()],
        periodogram_band=float(group["periodogram_band"][()]),
        correlated_with={},
    )


def _write_whiteness(parent: h5py.Group, name: str, found: Whiteness, balances: Sequence[str]) -> None:
    lags = found.autocorrelation.shape[1]
    write_group(
        parent,
        name,
        {
            "balance": Field(text(balances), "1", "balance"),
            "lag": Field(np.arange(1, lags + 1), "1", "lag in blocks"),
            "autocorrelation": Field(found.autocorrelation, "1", "of the sums over blocks", ("balance", "lag")),
            "band": Field(found.band, "1", "95 % half width of it for white noise", ("balance", "lag")),
            "p_value": Field(found.p_values, "1", "of the portmanteau test", ("balance",)),
            "periodogram_distance": Field(
                found.periodogram_distance,
                "1",
                "largest distance of the cumulated periodogram from a line",
                ("balance",),
            ),
            "periodogram_band": Field(found.periodogram_band, "1", "its 95 % limit for white noise"),
            "white": Field(np.int8(found.white), "1", "whether no balance fails", (), YES),
        },
    )


def _write_constants(parent: h5py.Group, stored: StoredRefinement) -> None:
    if not stored.constants:
        parent.create_group("constants")
        return
    axes = ("constant",)
    write_group(
        parent,
        "constants",
        {
            "constant": Field(text(list(stored.constants)), "1", "uncertain constant of the engine"),
            "relative_deviation": Field(
                np.array(list(stored.constants.values())), "1", "from the configured value", axes
            ),
            "standard_deviation": Field(
                np.array([stored.deviations[name] for name in stored.constants]), "1", "of the deviation", axes
            ),
            "relative_deviation_of_map": Field(
                np.array([stored.of_map.get(name, 0.0) for name in stored.constants]),
                "1",
                "from the configured value, of the constants that the map was estimated with",
                axes,
            ),
        },
    )


def _write_effect(parent: h5py.Group, name: str, effect: Standing) -> None:
    fields = {
        "log": Field(text([span.log for span in effect.spans]), "1", "log that tells of the effect, or is without it"),
        "sha256": Field(text([span.sha256 for span in effect.spans]), "1", "SHA-256 of the log", ("log",)),
        "acts": Field(np.array([span.acts for span in effect.spans], dtype=np.int8), "1", "on the log", ("log",), YES),
        "onset": Field(
            np.array([_or_nan(span.begin) for span in effect.spans]),
            "s",
            "on the log's own time axis, NaN where the effect acts from its first sample",
            ("log",),
        ),
        "end": Field(
            np.array([_or_nan(span.end) for span in effect.spans]),
            "s",
            "on the log's own time axis, NaN where the effect acts to its last sample",
            ("log",),
        ),
        "quantile": Field(BOUNDS, "1", "quantile"),
        "value": Field(effect.value, effect.unit, f"{effect.parameter} of {effect.id}"),
        "ci90": Field(np.array(effect.ci90), effect.unit, "90 % interval of the value", ("quantile",)),
        "lasting": Field(
            np.int8(effect.lasting),
            "1",
            "whether it acts on logs that took no part, from first to last sample",
            (),
            YES,
        ),
    }
    curve = effect.curve
    if curve is not None:
        fields |= {
            "knot": Field(curve.knots, "1", f"{curve.of} of {curve.channel}, in the log's unit, rates per second"),
            "deviation": Field(curve.values, "1", f"deviation of {curve.carrier} at amplitude one", ("knot",)),
        }
    group = write_group(parent, name, fields)
    for key in ("id", "place", "parameter", "unit"):
        group.attrs[key] = getattr(effect, key)
    if curve is not None:
        group.attrs["channel"], group.attrs["of"], group.attrs["carrier"] = curve.channel, curve.of, curve.carrier


def _read_effect(group: h5py.Group) -> Standing:
    columns = (group[name].asstr()[()] for name in ("log", "sha256"))
    numbers = (group[name][()].tolist() for name in ("acts", "onset", "end"))
    low, high = group["ci90"][()].tolist()
    return Standing(
        id=str(group.attrs["id"]),
        place=str(group.attrs["place"]),
        parameter=str(group.attrs["parameter"]),
        unit=str(group.attrs["unit"]),
        value=float(group["value"][()]),
        ci90=(low, high),
        spans=tuple(_span(*row) for row in zip(*columns, *numbers, strict=True)),
        lasting=bool(group["lasting"][()]),
        curve=_read_curve(group) if "knot" in group else None,
    )


def _span(log: str, sha256: str, acts: int, onset: float, end: float) -> Span:
    if not acts:
        return Span(log, sha256, np.inf, np.inf)
    return Span(log, sha256, onset if np.isfinite(onset) else -np.inf, end if np.isfinite(end) else np.inf)


def _read_curve(group: h5py.Group) -> Curve:
    names = (str(group.attrs[name]) for name in ("channel", "of", "carrier"))
    channel, of, carrier = names
    return Curve(channel, of, carrier, group["knot"][()], group["deviation"][()])


def _or_nan(edge: float) -> float:
    return edge if np.isfinite(edge) else np.nan
