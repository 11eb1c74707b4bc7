"""`plots`: the data behind the figures of a trace or a refinement, so that a report needs no logs."""

import h5py
import numpy as np

from lpvobs.discovery.leftover import Leftover, Stretch
from lpvobs.discovery.outcome import Ranked
from lpvobs.discovery.portrait import Partial, Portrait, Track
from lpvobs.discovery.whiteness import LAGS
from lpvobs.io.results.hdf import Field, flags, text, write_group

STATES = ("before", "after")
YES = flags([0, 1], ["no", "yes"])


def write_portrait(parent: h5py.Group, seen: Portrait) -> None:
    """Write `plots` into a group."""
    group = parent.create_group("plots")
    group.attrs["logs"], group.attrs["effects"] = len(seen.tracks), len(seen.partials)
    for number, track in enumerate(seen.tracks, 1):
        _write_track(group, f"log_{number}", track, seen.balances)
    for number, partial in enumerate(seen.partials, 1):
        _write_partial(group, f"effect_{number}", partial)
    _write_structure(group, seen)


def read_portrait(parent: h5py.Group) -> Portrait | None:
    """Return what `plots` holds, None where there is none."""
    if "plots" not in parent:
        return None
    group = parent["plots"]
    structure = group["structure"]
    return Portrait(
        balances=tuple(structure["balance"].asstr()[()]),
        tracks=tuple(_read_track(group[f"log_{i + 1}"]) for i in range(int(group.attrs["logs"]))),
        partials=tuple(_read_partial(group[f"effect_{i + 1}"]) for i in range(int(group.attrs["effects"]))),
        block=float(structure["block"][()]),
        blocks=int(structure["blocks"][()]),
        frequency=structure["frequency"][()],
        spectrum=structure["spectrum"][()],
        cumulated=structure["cumulated_periodogram"][()],
        signals=tuple(structure["signal"].asstr()[()]),
        cross=structure["cross_correlation"][()],
        cross_limit=structure["cross_limit"][()],
        effective=structure["effective_blocks"][()],
    )


def write_ranking(parent: h5py.Group, ranking: tuple[Ranked, ...]) -> None:
    """Write the candidates of the first round, best first."""
    if not ranking:
        return
    axes = ("candidate",)
    write_group(
        parent,
        "ranking",
        {
            "candidate": Field(text([item.id for item in ranking]), "1", "effect alone against the model as it was"),
            "size": Field(np.array([item.value for item in ranking]), "1", "size, unit in size_unit", axes),
            "size_unit": Field(text([item.unit for item in ranking]), "1", "unit of the size", axes),
            "evidence": Field(
                np.array([item.gain for item in ranking]), "1", "by how much it lowers half the sum of squares", axes
            ),
            "unevenness": Field(
                np.array([item.unevenness for item in ranking]),
                "1",
                "variance of its score over the blocks, over that of noise: near one where one size fits all",
                axes,
            ),
        },
    )


def read_ranking(parent: h5py.Group) -> tuple[Ranked, ...]:
    """Return the candidates, best first; none where none were stored."""
    if "ranking" not in parent:
        return ()
    group = parent["ranking"]
    names, units = (group[name].asstr()[()] for name in ("candidate", "size_unit"))
    sizes, gains, uneven = (group[name][()].tolist() for name in ("size", "evidence", "unevenness"))
    return tuple(Ranked(*row) for row in zip(names, sizes, units, gains, uneven, strict=True))


def write_leftover(parent: h5py.Group, left: Leftover) -> None:
    """Write what is known of an unexplained residual."""
    fields = {
        "end": Field(np.array([0, 1], dtype=np.int8), "1", "which end", (), flags([0, 1], ["lower", "upper"])),
        "fuel": Field(
            np.array(left.fuel), "1", "cell with the largest mean square: fuel, in the unit of its axis", ("end",)
        ),
        "speed": Field(np.array(left.speed), "rpm", "cell with the largest mean square: speed", ("end",)),
        "times_noise": Field(left.times_noise, "1", "that mean square over the median cell's"),
        "half_power": Field(left.half_power, "Hz", "half of the power of the block sums lies below"),
    }
    if left.stretches:
        parts = left.stretches
        fields |= {
            "stretch": Field(np.arange(len(parts), dtype=np.int32), "1", "stretch with much power, strongest first"),
            "log": Field(text([part.log for part in parts]), "1", "log", ("stretch",)),
            "from": Field(np.array([part.begin for part in parts]), "s", "since the start of the log", ("stretch",)),
            "to": Field(np.array([part.end for part in parts]), "s", "since the start of the log", ("stretch",)),
            "share": Field(
                np.array([part.share for part in parts]), "1", "of the power above the median", ("stretch",)
            ),
        }
    if left.follows:
        fields |= {
            "signal": Field(text(list(left.follows)), "1", "signal that the residual follows"),
            "correlation": Field(np.array(list(left.follows.values())), "1", "strongest correlation", ("signal",)),
        }
    write_group(parent, "leftover", fields).attrs["balance"] = left.balance


def read_leftover(parent: h5py.Group) -> Leftover | None:
    """Return what is known of an unexplained residual, None where nothing is left."""
    if "leftover" not in parent:
        return None
    group = parent["leftover"]
    stretches: tuple[Stretch, ...] = ()
    if "stretch" in group:
        columns = (group[name][()].tolist() for name in ("from", "to", "share"))
        stretches = tuple(Stretch(*row) for row in zip(group["log"].asstr()[()], *columns, strict=True))
    follows = {}
    if "signal" in group:
        follows = dict(zip(group["signal"].asstr()[()], group["correlation"][()].tolist(), strict=True))
    (u_low, u_high), (n_low, n_high) = (group[name][()].tolist() for name in ("fuel", "speed"))
    return Leftover(
        stretches=stretches,
        fuel=(u_low, u_high),
        speed=(n_low, n_high),
        times_noise=float(group["times_noise"][()]),
        half_power=float(group["half_power"][()]),
        balance=str(group.attrs["balance"]),
        follows=follows,
    )


def _write_track(parent: h5py.Group, name: str, track: Track, balances: tuple[str, ...]) -> None:
    axes = ("balance", "extreme", "time")
    group = write_group(
        parent,
        name,
        {
            "balance": Field(text(balances), "1", "balance"),
            "extreme": Field(
                np.array([0, 1], dtype=np.int8), "1", "which extreme", (), flags([0, 1], ["smallest", "largest"])
            ),
            "time": Field(track.time, "s", "middle of the column, since the start of the log"),
            "before": Field(track.before.astype(np.float32), "kg/s", "residual before, extremes of each column", axes),
            "after": Field(track.after.astype(np.float32), "kg/s", "residual after, extremes of each column", axes),
            "judged": Field(
                track.judged.astype(np.int8), "1", "whether the error before and after is taken from it", ("time",), YES
            ),
        },
    )
    group.attrs["log"] = track.log


def _read_track(group: h5py.Group) -> Track:
    before, after = (group[name][()].astype(float) for name in STATES)
    return Track(str(group.attrs["log"]), group["time"][()], before, after, group["judged"][()] == 1)


def _write_partial(parent: h5py.Group, name: str, partial: Partial) -> None:
    unit = "standard deviations of the noise"
    group = write_group(
        parent,
        name,
        {
            "point": Field(np.arange(partial.regressor.size, dtype=np.int32), "1", "some of the points"),
            "regressor": Field(partial.regressor.astype(np.float32), "1", f"what the effect says, {unit}", ("point",)),
            "residual": Field(partial.residual.astype(np.float32), "1", f"residual without it, {unit}", ("point",)),
            "bin": Field(np.arange(partial.binned.shape[1], dtype=np.int32), "1", "bin of the regressor, all points"),
            "mean_regressor": Field(partial.binned[0], "1", f"mean regressor, {unit}", ("bin",)),
            "mean_residual": Field(partial.binned[1], "1", f"mean residual, {unit}", ("bin",)),
            "standard_error": Field(partial.binned[2], "1", "of the mean residual", ("bin",)),
        },
    )
    group.attrs["id"] = partial.id


def _read_partial(group: h5py.Group) -> Partial:
    binned = np.stack([group[name][()] for name in ("mean_regressor", "mean_residual", "standard_error")])
    regressor, residual = (group[name][()].astype(float) for name in ("regressor", "residual"))
    return Partial(str(group.attrs["id"]), regressor, residual, binned)


def _write_structure(parent: h5py.Group, seen: Portrait) -> None:
    P = seen.cumulated.shape[2]
    share = np.arange(1, P + 1) / max(P, 1)
    write_group(
        parent,
        "structure",
        {
            "state": Field(text(STATES), "1", "model"),
            "balance": Field(text(seen.balances), "1", "balance"),
            "frequency": Field(seen.frequency, "Hz", "frequency"),
            "share": Field(share, "1", "share of the frequencies of the block sums"),
            "signal": Field(text(seen.signals), "1", "input or channel"),
            "lag": Field(np.arange(-LAGS, LAGS + 1), "1", "lag in blocks, positive where the residual is later"),
            "block": Field(seen.block, "s", "length of a block"),
            "blocks": Field(seen.blocks, "1", "number of blocks"),
            "spectrum": Field(
                seen.spectrum, "s", "of the residual in units of its noise", ("state", "balance", "frequency")
            ),
            "cumulated_periodogram": Field(seen.cumulated, "1", "of the block sums", ("state", "balance", "share")),
            "cross_correlation": Field(seen.cross, "1", "strongest among the balances", ("state", "signal", "lag")),
            "cross_limit": Field(
                seen.cross_limit, "1", "what white noise stays under, all signals and lags", ("state", "signal", "lag")
            ),
            "effective_blocks": Field(
                seen.effective, "1", "independent values in the block sums", ("state", "balance")
            ),
        },
    )
