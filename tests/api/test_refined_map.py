"""The refined model as the observer has it: constants where the joint fit has them, gains that it can use."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from repository import DIESEL

from lpvobs.api.trace import expect_cascade
from lpvobs.engines.constants import scaled
from lpvobs.errors import DataError
from lpvobs.io.configuration.config import load_config


def test_constants_are_scaled_wherever_they_stand():
    engine = load_config(DIESEL)[0].engine
    moved = scaled(engine, {"V_d": 0.01, "J_t": -0.02})
    assert moved.geometry.V_d == pytest.approx(1.01 * engine.geometry.V_d)
    assert moved.turbine.J_t == pytest.approx(0.98 * engine.turbine.J_t)
    assert moved.compressor == engine.compressor
    assert scaled(engine, {}) == engine


def test_a_gain_through_which_the_sensor_bends_the_state_is_refused_in_one_line():
    L = np.zeros((3, 3))
    expect_cascade(Path("r.h5"), SimpleNamespace(origin="made", gain=SimpleNamespace(L=L)))
    L = L + np.array([0.0, 0.0, 1.0])
    with pytest.raises(DataError, match=r"^r.h5: this map was made with the gain 'Eq. \(38\)', .*--freeze-map$"):
        expect_cascade(Path("r.h5"), SimpleNamespace(origin="Eq. (38)", gain=SimpleNamespace(L=L)))
