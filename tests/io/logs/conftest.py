"""A good log as a Parquet file, and ways to spoil it."""

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from lpvobs.engines.diesel.lpv import Diesel
from lpvobs.io.logs.policies import LogPolicies
from lpvobs.io.logs.reading import read_log

N = 200
UNITS = {"time": "s"} | {name: channel.unit for name, channel in Diesel.channels.items()}


def plausible(seed=0):
    """Return every channel of the contract with values that a working engine shows, a hundred samples a second."""
    rng = np.random.default_rng(seed)
    middle = {name: np.mean(channel.typical) for name, channel in Diesel.channels.items()}
    middle |= {"p_im": 1.4e5, "p_em": 1.7e5, "omega_t": 9000.0, "n_e": 2000.0, "u_delta": 20.0, "W_maf": 0.04}
    middle |= {"T_im": 310.0, "T_em": 800.0, "p_amb": 9.8e4, "T_amb": 298.0, "u_egr": 20.0, "u_vgt": 60.0}
    return {"time": 0.01 * np.arange(N)} | {name: v * (1 + 0.01 * rng.standard_normal(N)) for name, v in middle.items()}


def store(path, columns, units):
    """Write columns, given as pairs so that a name may come twice; a unit of None leaves the metadata out."""
    arrays = [column if isinstance(column, pa.Array) else pa.array(column) for _, column in columns]
    fields = []
    for (name, _), array in zip(columns, arrays, strict=True):
        unit = units.get(name)
        fields.append(pa.field(name, array.type, metadata=None if unit is None else {"unit": unit}))
    pq.write_table(pa.table(arrays, schema=pa.schema(fields)), path)
    return path


@pytest.fixture
def columns():
    return plausible()


@pytest.fixture
def write(tmp_path):
    """Return a function that writes channels, with the contract's units unless told otherwise, and returns the path."""

    def make(channels, units=None, name="drive.parquet", twice=()):
        pairs = [*channels.items(), *((again, channels[again]) for again in twice)]
        return store(tmp_path / name, pairs, UNITS | (units or {}))

    return make


@pytest.fixture
def read():
    """Return a function that reads a diesel's log with the policies given."""

    def run(path, auxiliary=False, **policies):
        return read_log(path, Diesel.channels, LogPolicies(**policies), auxiliary)

    return run
