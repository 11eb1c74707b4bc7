"""The shipped cycle tables: what they are said to be, and the surrogate as its generator writes it."""

import runpy
from pathlib import Path

import numpy as np
import pytest

from lpvobs.errors import UsageError
from lpvobs.simulation.cycles import EngineCycle, SpeedCycle, load_cycle, shipped_folder


def test_the_surrogate_is_what_its_generator_writes():
    shipped = (shipped_folder() / "cycles" / "etc_surrogate.csv").read_bytes()
    generator = runpy.run_path(str(shipped_folder() / "make_etc_surrogate.py"))
    assert generator["table"]().encode() == shipped


@pytest.mark.parametrize(
    ("name", "seconds", "kilometres"), [("ftp75", 1874, 17.77), ("nedc", 1180, 11.01), ("ftp75_cold", 505, 5.78)]
)
def test_speed_cycles_have_the_regulation_length(name, seconds, kilometres):
    cycle = load_cycle(name)
    assert isinstance(cycle, SpeedCycle)
    assert cycle.time[-1] - cycle.time[0] == pytest.approx(seconds, abs=1)
    assert np.trapezoid(cycle.speed, cycle.time) / 1000.0 == pytest.approx(kilometres, rel=0.005)


@pytest.mark.parametrize(("name", "seconds"), [("etc", 1800), ("etc_part1", 600), ("whtc", 1800)])
def test_engine_cycles(name, seconds):
    cycle = load_cycle(name)
    assert isinstance(cycle, EngineCycle)
    assert cycle.time[-1] == pytest.approx(seconds, abs=1)


def test_a_cycle_that_is_not_there():
    for name in ("le_mans", str(Path("nowhere") / "none.csv")):
        with pytest.raises(UsageError) as refusal:
            load_cycle(name)
        assert name in str(refusal.value)
