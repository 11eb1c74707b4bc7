"""A copy of a log whose air flow sensor is heated by the charge: `python tools/heated_sensor.py LOG OUT`.

No catalogue has this cause. `make run` gives the copy to `refine`, which has to find a formula for it.
"""

import sys

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

PER_KELVIN, REFERENCE = 2e-3, 320.0  # 1/K, K: the reading is too high by so much above this charge temperature


def main(log: str, out: str) -> None:
    """Write the copy."""
    table = pq.read_table(log)
    factor = pc.add(1.0, pc.multiply(PER_KELVIN, pc.subtract(table["T_im"], REFERENCE)))
    place = table.column_names.index("W_maf")
    reading = pa.chunked_array(pc.multiply(table["W_maf"], factor))
    pq.write_table(table.set_column(place, table.schema.field(place), reading), out)


if __name__ == "__main__":
    main(*sys.argv[1:])
