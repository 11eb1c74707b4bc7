"""How far each log is from the map of all, and how far the balances agree: `/agreement` and `/balance_agreement` of a result."""

from collections.abc import Sequence

import h5py

from lpvobs.io.results.hdf import Field, write_group
from lpvobs.io.results.mapping import Item, Layout, fields, read_rows, rows
from lpvobs.observer.balance_agreement import BalanceAgreement
from lpvobs.observer.disagreement import Agreement

AGREEMENT = Layout(
    Agreement,
    {
        "log": Item("1", "log", of="name"),
        "nodes": Item("1", "nodes that this log and others inform"),
        "chi_square": Item("1", "squared difference of own and common map over its variance", gaps=True),
        "deviation": Item("1", "standard deviations by which the log stands out", gaps=True),
        "mean_difference": Item("kg/s", "own less common map, mean of nodes", gaps=True),
        "disagrees": Item("1", "whether it stands out among the logs"),
    },
    row="log",
)

BALANCES = Layout(BalanceAgreement, {}, attributes=("ratio", "p_value", "where"))


def write_agreement(file: h5py.File, scatter: float, logs: tuple[Agreement, ...]) -> None:
    """Write how far each log's own map is from the common one."""
    between = Field(scatter, "kg/s", "standard deviation of a node between logs, beyond noise")
    write_group(file, "agreement", rows(AGREEMENT, logs) | {"scatter": between})


def read_agreement(file: h5py.File) -> tuple[Agreement, ...]:
    """Return it; nothing for a result of a single log."""
    return read_rows(file["agreement"], AGREEMENT) if "agreement" in file else ()


def write_balance_agreement(file: h5py.File, found: BalanceAgreement, doubts: Sequence[str]) -> None:
    """Write how far the balances agree, and what speaks against logs and engine, a line each."""
    write_group(file, "balance_agreement", fields(BALANCES, found) | {"doubts": "\n".join(doubts)})
