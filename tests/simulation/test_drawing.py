"""Engines with drawn constants."""

import numpy as np
import pytest

from lpvobs.engines.diesel.constants import own_constants
from lpvobs.errors import UsageError
from lpvobs.simulation.simulate import GIVEN, drawn


def test_all_constants_are_drawn_within_the_tolerance(config):
    before = own_constants(config.engine)
    other, deviation = drawn(config.engine, 0.02, 3)
    after = own_constants(other)
    assert set(deviation) == set(before) - GIVEN
    for name, value in before.items():
        assert after[name] == pytest.approx(value * (1.0 + deviation.get(name, 0.0)), rel=1e-14)
    sizes = np.array(list(deviation.values())) / 0.02
    assert np.abs(sizes).max() <= 1.0
    # 35 uniform numbers: mean 0 and standard deviation 0.58, each known to about 0.1
    assert abs(sizes.mean()) < 0.35
    assert 0.4 < sizes.std() < 0.75


def test_few_are_drawn_as_in_a_draw_of_all(config):
    _, every = drawn(config.engine, 0.01, 3)
    other, few = drawn(config.engine, {"V_d": 0.01, "R_c": 0.03}, 3)
    assert few == {"V_d": every["V_d"], "R_c": pytest.approx(3.0 * every["R_c"])}
    assert other.egr == config.engine.egr
    assert drawn(config.engine, 0.01, 4)[1]["V_d"] != every["V_d"]


@pytest.mark.parametrize("name", ["V_x", "n_cyl", "Q_11"])
def test_what_cannot_be_drawn_is_refused(config, name):
    with pytest.raises(UsageError, match=f"'{name}' cannot be varied at random"):
        drawn(config.engine, {name: 0.01}, 1)
