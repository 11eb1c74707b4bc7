"""One simulated drive for the whole room, a small problem made from it, and effects put into logs without the room's formulas."""

from dataclasses import replace

import numpy as np
import pytest
from repository import DIESEL

from lpvobs.discovery.fit import fit
from lpvobs.discovery.map_prior import free_map
from lpvobs.discovery.residual import lay_out
from lpvobs.engines.diesel.effects import diesel_model
from lpvobs.engines.diesel.lpv import Diesel
from lpvobs.io.configuration.config import load_config
from lpvobs.records import Defects, Log
from lpvobs.simulation.simulate import simulate

SECONDS = 300.0


@pytest.fixture(scope="session")
def config():
    return load_config(DIESEL)[0]


@pytest.fixture(scope="session")
def record(config):
    """Return a function from an engine to its log over the first minutes of a cycle, seed fixed."""

    def drive(engine=None, cycle="etc_part1", effects=(), surface=None):
        engine = engine or config.engine
        made = dict(simulate(engine, config.simulation, cycle, seed=5, effects=effects, surface=surface).channels)
        keep = made["time"] < SECONDS
        channels = {name: made[name][keep] for name in Diesel.channels}
        N = int(keep.sum())
        return Log("drive", "", made["time"][keep], channels, {}, ((0, N),), np.arange(N), Defects(N))

    return drive


@pytest.fixture(scope="session")
def clean(record):
    return record()


@pytest.fixture(scope="session")
def plant(config):
    return diesel_model(config.engine, config.estimate.tolerance)


@pytest.fixture(scope="session")
def laid_out(plant, config):
    """Return a function from logs to the problem with a free map."""
    prior = free_map(config.grid(), len(config.estimate.tolerance), 0.1)
    return lambda *logs: lay_out(plant, config.grid(), prior, logs)


@pytest.fixture(scope="session")
def linear(laid_out, clean):
    return fit(laid_out(clean))


@pytest.fixture(scope="session")
def misread():
    """Return a function that puts another reading of the sensor into a log, and auxiliary channels."""

    def change(log, reading, auxiliary=None):
        return replace(log, channels={**log.channels, "W_maf": reading}, auxiliary=auxiliary or {})

    return change
