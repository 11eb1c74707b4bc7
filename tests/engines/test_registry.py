"""Every engine's record agrees with itself and with the configuration that is shipped for it."""

import numpy as np
import pytest
from repository import CONFIGS

from lpvobs.engines.channels import recorded as listed
from lpvobs.engines.registry import ENGINES, usual_engine
from lpvobs.io.configuration.config import load_config
from lpvobs.simulation.parameters import PLANTS


@pytest.fixture(params=ENGINES)
def kind(request):
    return ENGINES[request.param]


def test_channels_axes_and_units_agree(kind):
    path = kind.air_path
    for axis in path.axes:
        assert axis.unit == path.channels[axis.channel].unit
    assert {path.sensor, *path.temperature_names, *path.smoothed} <= set(path.channels)
    recorded = {**listed(""), **kind.recorded()}
    assert set(path.channels) <= set(recorded)
    for name in path.channels:
        assert recorded[name].unit == path.channels[name].unit
        low, high = path.channels[name].low, path.channels[name].high
        assert low <= recorded[name].typical[0] < recorded[name].typical[1] <= high


def test_its_example_is_a_configuration_of_it(kind):
    config, _ = load_config(CONFIGS / kind.example)
    assert config.kind is kind
    for name, record in kind.tables.items():
        assert isinstance(getattr(config, name), record)
    assert (config.simulation is not None) == bool(kind.plant)
    assert not kind.plant or isinstance(config.simulation, PLANTS[kind.plant])
    bounds = config.engine_path().rate_bounds(config.gain.temperatures)
    assert tuple(bounds) == kind.air_path.rate_names
    assert all(0.0 < low < high for low, high in bounds.values())


@pytest.mark.parametrize("name", [name for name, kind in ENGINES.items() if kind.published is not None])
def test_what_is_printed_fits_the_engine(name):
    printed, path = ENGINES[name].published, ENGINES[name].air_path
    assert set(printed.outputs) <= set(path.state_names)
    assert printed.L.shape == (len(path.state_names), len(printed.outputs) + 1)
    for bounds in printed.bounds.values():
        assert len(bounds) == len(path.parameter_names) - len(path.rate_names)
    assert all(np.size(surface) == 6 for surface in printed.surfaces.values())


def test_the_usual_engine_is_the_papers():
    assert usual_engine().published is not None
