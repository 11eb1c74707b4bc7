"""What every room's tests share: the engine and grid of the shipped configuration, and how Hypothesis draws."""

import os
import tomllib
from dataclasses import fields

from repository import CONFIGS

# Before NumPy is loaded: for a few hundred rows threads of the linear algebra cost more than they give, above all on a machine
# that has something else to do.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import pytest
from hypothesis import settings

from lpvobs.engines.diesel.constants import Compressor, DieselEngine, Egr, Filling, Gas, Geometry, Turbine
from lpvobs.engines.diesel.lpv import Diesel
from lpvobs.maps.grid import Grid

# The same examples on every run, and no example fails for being the first to compile a kernel.
EXAMPLES = 8 if os.environ.get("NUMBA_DISABLE_JIT") == "1" else 40  # a hundred times slower without the compiler
settings.register_profile("repeatable", derandomize=True, deadline=None, database=None, max_examples=EXAMPLES)
settings.load_profile("repeatable")


def _record(kind, table):
    values = {item.name: table[item.name] for item in fields(kind)}
    return kind(**{name: tuple(value) if isinstance(value, list) else value for name, value in values.items()})


@pytest.fixture(scope="session")
def engine() -> DieselEngine:
    """Return the engine of configs/diesel.toml, read without the reader that has tests of its own."""
    tables = tomllib.loads((CONFIGS / "diesel.toml").read_text(encoding="utf-8"))["engine"]
    kinds = {
        "gas": Gas,
        "geometry": Geometry,
        "filling": Filling,
        "compressor": Compressor,
        "turbine": Turbine,
        "egr": Egr,
    }
    return DieselEngine(**{name: _record(kind, tables[name]) for name, kind in kinds.items()})


@pytest.fixture(scope="session")
def air_path(engine) -> Diesel:
    return Diesel(engine)


@pytest.fixture(scope="session")
def grid() -> Grid:
    """Return the default grid of the contract, 15 fuel by 17 speed nodes."""
    return Grid(np.arange(0.0, 57.0, 4.0), np.arange(0.0, 4001.0, 250.0))
