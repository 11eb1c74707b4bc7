"""Writes a log as a measurement system would have: other names, other units, a decimal comma, a row of units.

    python examples/as_recorded.py drive.parquet recording.csv

Something to practise `lpvobs profile` and `lpvobs ingest` on before a recording of your own is at hand.
"""

import math
import sys
from pathlib import Path

import pyarrow.parquet as pq

COLUMNS = {  # name and unit in the file; channel of the log, factor, offset
    "t": ("s", "time", 1.0, 0.0),
    "nmot": ("1/min", "n_e", 1.0, 0.0),
    "inj_qnt": ("mg/hub", "u_delta", 1.0, 0.0),
    "egr_pos": ("%", "u_egr", 1.0, 0.0),
    "vgt_pos": ("", "u_vgt", 1.0, 0.0),  # nobody entered a unit
    "p_22": ("hPa", "p_im", 1e-2, 0.0),
    "p_31": ("hPa", "p_em", 1e-2, 0.0),
    "shaft": ("1/min", "omega_t", 60.0 / math.tau, 0.0),  # a name that tells nothing
    "T_22": ("°C", "T_im", 1.0, -273.15),
    "T_31": ("°C", "T_em", 1.0, -273.15),
    "p_amb": ("hPa", "p_amb", 1e-2, 0.0),
    "T_amb": ("°C", "T_amb", 1.0, -273.15),
    "maf": ("kg/h", "W_maf", 3600.0, 0.0),
}


def as_recorded(log: Path, out: Path) -> None:
    """Write the CSV file."""
    table = pq.read_table(log)
    columns = [factor * table[channel].to_numpy() + offset for _, channel, factor, offset in COLUMNS.values()]
    units = [unit for unit, *_ in COLUMNS.values()]
    rows = (";".join(f"{value:.10g}" for value in row).replace(".", ",") for row in zip(*columns, strict=True))
    out.write_text("\n".join([";".join(COLUMNS), ";".join(units), *rows]) + "\n", encoding="utf-8")


if __name__ == "__main__":
    as_recorded(Path(sys.argv[1]), Path(sys.argv[2]))
