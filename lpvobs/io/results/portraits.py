"""`plots`: the data behind the figures of a trace or a refinement, so that a report needs no logs."""

from dataclasses import dataclass

import h5py
import numpy as np

from lpvobs.discovery.leftover import Leftover, Stretch
from lpvobs.discovery.outcome import Ranked
from lpvobs.discovery.portrait import Partial, Portrait, Track
from lpvobs.discovery.thresholds import LAGS
from lpvobs.io.results.hdf import write_group
from lpvobs.io.results.mapping import ENDS, Item, Layout, fields, numbered, read, read_rows, rows

STATES = ("before", "after")
DRAWN = "f4"
"""Single precision: a figure shows no more."""
NOISE = "standard deviations of the noise"
COLUMN = ("balance", "extreme", "time")
BY_LAG = ("state", "signal", "lag")


@dataclass(frozen=True)
class _Follow:
    """A signal that the residual follows."""

    signal: str
    correlation: float


TRACK = Layout(
    Track,
    {
        "time": Item("s", "middle of the column, since the start of the log"),
        "before": Item("kg/s", "residual before, extremes of each column", COLUMN, gaps=True, stored=DRAWN),
        "after": Item("kg/s", "residual after, extremes of each column", COLUMN, gaps=True, stored=DRAWN),
        "judged": Item("1", "whether the error before and after is taken from it", ("time",)),
    },
    {
        "balance": "balance",
        "extreme": Item("1", "which extreme", meanings={0: "smallest", 1: "largest"}),
    },
    ("log",),
)
PARTIAL = Layout(
    Partial,
    {
        "regressor": Item("1", f"what the effect says, {NOISE}", ("point",), gaps=True, stored=DRAWN),
        "residual": Item("1", f"residual without it, {NOISE}", ("point",), gaps=True, stored=DRAWN),
        "binned": Item("1", f"of all points by their regressor, {NOISE}", ("mean", "bin"), gaps=True),
    },
    {
        "point": "some of the points",
        "mean": "mean regressor, mean residual, standard error of the mean residual",
        "bin": "bin of the regressor",
    },
    ("id",),
)
STRUCTURE = Layout(
    Portrait,
    {
        "balance": Item("1", "balance", of="balances"),
        "frequency": Item("Hz", "frequency"),
        "signal": Item("1", "input or channel", of="signals"),
        "block": Item("s", "length of a block"),
        "blocks": Item("1", "number of blocks"),
        "spectrum": Item("s", "of the residual in units of its noise", ("state", "balance", "frequency"), gaps=True),
        "cumulated_periodogram": Item("1", "of the block sums", ("state", "balance", "share"), "cumulated", gaps=True),
        "cross_correlation": Item("1", "strongest among the balances", BY_LAG, "cross", gaps=True),
        "cross_limit": Item("1", "what white noise stays under, all signals and lags", BY_LAG, gaps=True),
        "effective_blocks": Item(
            "1", "independent values in the block sums", ("state", "balance"), "effective", gaps=True
        ),
    },
    {
        "state": "model",
        "share": "share of the frequencies of the block sums",
        "lag": "lag in blocks, positive where the residual is later",
    },
)
RANKING = Layout(
    Ranked,
    {
        "candidate": Item("1", "effect alone against the model as it was", of="id"),
        "size": Item("1", "size, unit in size_unit", of="value", gaps=True),
        "size_unit": Item("1", "unit of the size", of="unit"),
        "evidence": Item("1", "by how much it lowers half the sum of squares", of="gain", gaps=True),
        "unevenness": Item(
            "1",
            "variance of its score over the blocks, over that of noise: near one where one size fits all",
            gaps=True,
        ),
    },
    row="candidate",
)
LEFTOVER = Layout(
    Leftover,
    {
        "fuel": Item("1", "cell with the largest mean square: fuel, in the unit of its axis", ("end",)),
        "speed": Item("rpm", "cell with the largest mean square: speed", ("end",)),
        "times_noise": Item("1", "that mean square over the median cell's", gaps=True),
        "half_power": Item("Hz", "half of the power of the block sums lies below"),
    },
    {"end": ENDS},
    ("balance",),
)
STRETCHES = Layout(
    Stretch,
    {
        "log": Item("1", "log"),
        "from": Item("s", "since the start of the log", of="begin"),
        "to": Item("s", "since the start of the log", of="end"),
        "share": Item("1", "of the power above the median", gaps=True),
    },
    {"stretch": "stretch with much power, strongest first"},
    row="stretch",
)
FOLLOWS = Layout(
    _Follow,
    {
        "signal": Item("1", "signal that the residual follows"),
        "correlation": Item("1", "strongest correlation"),
    },
    row="signal",
)


def write_portrait(parent: h5py.Group, seen: Portrait) -> None:
    """Write `plots` into a group."""
    group = parent.create_group("plots")
    for number, track in enumerate(seen.tracks, 1):
        write_group(group, f"log_{number}", fields(TRACK, track, {"balance": seen.balances}))
    for number, partial in enumerate(seen.partials, 1):
        write_group(group, f"effect_{number}", fields(PARTIAL, partial))
    size = seen.cumulated.shape[2]
    labels = {
        "state": STATES,
        "share": np.arange(1, size + 1) / max(size, 1),
        "lag": np.arange(-LAGS, LAGS + 1),
    }
    write_group(group, "structure", fields(STRUCTURE, seen, labels))


def read_portrait(parent: h5py.Group) -> Portrait | None:
    """Return what `plots` holds, None where there is none."""
    if "plots" not in parent:
        return None
    group = parent["plots"]
    return read(
        group["structure"],
        STRUCTURE,
        tracks=tuple(read(each, TRACK) for each in numbered(group, "log")),
        partials=tuple(read(each, PARTIAL) for each in numbered(group, "effect")),
    )


def write_ranking(parent: h5py.Group, ranking: tuple[Ranked, ...]) -> None:
    """Write the candidates of the first round, best first."""
    if ranking:
        write_group(parent, "ranking", rows(RANKING, ranking))


def read_ranking(parent: h5py.Group) -> tuple[Ranked, ...]:
    """Return the candidates, best first; none where none were stored."""
    return read_rows(parent["ranking"], RANKING) if "ranking" in parent else ()


def write_leftover(parent: h5py.Group, left: Leftover) -> None:
    """Write what is known of an unexplained residual."""
    follows = [_Follow(*item) for item in left.follows.items()]
    contents = fields(LEFTOVER, left) | rows(STRETCHES, left.stretches) | rows(FOLLOWS, follows)
    write_group(parent, "leftover", contents)


def read_leftover(parent: h5py.Group) -> Leftover | None:
    """Return what is known of an unexplained residual, None where nothing is left."""
    if "leftover" not in parent:
        return None
    group = parent["leftover"]
    follows = {item.signal: item.correlation for item in read_rows(group, FOLLOWS)}
    return read(group, LEFTOVER, stretches=read_rows(group, STRETCHES), follows=follows)
