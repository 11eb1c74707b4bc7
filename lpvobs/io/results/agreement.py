"""How far each log is from the map of all: `/agreement` of a result."""

import h5py
import numpy as np

from lpvobs.io.results.hdf import Field, flags, text, write_group
from lpvobs.observer.disagreement import Agreement
from lpvobs.records import Array


def write_agreement(file: h5py.File, scatter: float, logs: tuple[Agreement, ...]) -> None:
    """Write how far each log's own map is from the common one."""

    def column(name: str) -> Array:
        return np.array([getattr(item, name) for item in logs])

    per_log = ("log",)
    disagrees = column("disagrees").astype(np.int8)
    write_group(
        file,
        "agreement",
        {
            "log": Field(text([item.name for item in logs]), "1", "log"),
            "nodes": Field(column("nodes"), "1", "nodes that this log and others inform", per_log),
            "chi_square": Field(
                column("chi_square"), "1", "squared difference of own and common map over its variance", per_log
            ),
            "deviation": Field(column("deviation"), "1", "standard deviations by which the log stands out", per_log),
            "mean_difference": Field(column("mean_difference"), "kg/s", "own less common map, mean of nodes", per_log),
            "disagrees": Field(
                disagrees, "1", "whether it stands out among the logs", per_log, flags([0, 1], ["no", "yes"])
            ),
            "scatter": Field(scatter, "kg/s", "standard deviation of a node between logs, beyond noise"),
        },
    )


def read_agreement(file: h5py.File) -> tuple[Agreement, ...]:
    """Return it; nothing for a result of a single log."""
    if "agreement" not in file:
        return ()
    group = file["agreement"]
    names = group["log"].asstr()[()]
    columns = [
        group[name][()].tolist() for name in ("nodes", "chi_square", "mean_difference", "deviation", "disagrees")
    ]
    return tuple(
        Agreement(name, nodes, chi_square, mean, deviation, bool(disagrees))
        for name, nodes, chi_square, mean, deviation, disagrees in zip(names, *columns, strict=True)
    )
