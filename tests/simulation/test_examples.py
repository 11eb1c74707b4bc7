"""Every shipped example of an effect is read, drives, and shows in the log."""

import numpy as np
import pytest
from repository import CONFIGS

from lpvobs.io.configuration.config import load_effects
from lpvobs.simulation.disturbances import UnloggedEffect
from lpvobs.simulation.effects import CATALOGUE
from lpvobs.simulation.simulate import simulate

EXAMPLES = sorted((CONFIGS / "effects").glob("*.toml"))


def test_every_kind_has_its_example():
    shown = {found.id for path in EXAMPLES for found in load_effects(path).injected}
    assert set(CATALOGUE) | {"unlogged", "channel:T_coolant"} <= shown
    for name in CATALOGUE:
        assert name.replace(".", "_") in {path.stem for path in EXAMPLES}


def drive_of(config, cycle, auxiliary, surface=None, effects=()):
    return simulate(
        config.engine, config.simulation, cycle, 10.0, surface=surface, effects=effects, auxiliary=auxiliary
    ).channels


@pytest.fixture(scope="module")
def undisturbed():
    """Return a function that drives each drive without effects once."""
    known = {}

    def drive(config, cycle, auxiliary):
        if (cycle, auxiliary) not in known:
            known[cycle, auxiliary] = drive_of(config, cycle, auxiliary)
        return known[cycle, auxiliary]

    return drive


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
@pytest.mark.slow
def test_an_example_drives_and_shows(config, cycle, minutes, undisturbed, path):
    wanted = load_effects(path)
    assert path.read_text(encoding="utf-8").startswith("# ")
    coming_and_going = wanted.auxiliary or any(isinstance(found, UnloggedEffect) for found in wanted.injected)

    drive = minutes if coming_and_going else cycle
    log = drive_of(config, drive, wanted.auxiliary, wanted.surface, wanted.injected)
    plain = undisturbed(config, drive, wanted.auxiliary)
    assert all(np.isfinite(values).all() for values in log.values())
    changed = {name for name in plain if not np.array_equal(log[name], plain[name])}
    assert bool(changed) == bool(wanted.injected)
    if path.stem == "road":
        assert {"T_coolant", "T_charge", "humidity", "ac_switch", "p_baro"} < set(log)
