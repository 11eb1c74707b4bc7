"""The observer with the sensor's state: proven where it is stable, refused where it is not, and no solver near."""

import numpy as np
import pytest

from lpvobs.errors import NotProven
from lpvobs.synthesis.gain import Gain
from lpvobs.synthesis.sensor_state import prove, with_sensor_state
from lpvobs.synthesis.solve import synthesise

TAU = (0.05, 0.12)  # s


@pytest.fixture(scope="module")
def cascade(diesel):
    problem = diesel("FTP75", p_em=True)
    return problem, synthesise(problem, falling_gain=True, cascade=True, decay=100.0)


def test_four_states_are_proven_and_the_sensor_corrects_its_own_alone(cascade):
    problem, gain = cascade
    found = with_sensor_state(problem, gain, TAU, 40.0)
    assert found.vertices == 2 * len(problem.region.vertices())
    assert found.smallest_pivot > 0.0
    assert np.array_equal(found.L[:3], gain.L)
    assert list(found.L[3]) == [0.0, 0.0, 0.0, 40.0]
    assert prove(problem, found.L, found.P, TAU).smallest_pivot == found.smallest_pivot  # from the numbers alone


def test_the_closed_loop_is_stable_inside_the_region_too(cascade):
    problem, gain = cascade
    found = with_sensor_state(problem, gain, TAU, 0.0)
    rng = np.random.default_rng(2)
    lower, upper = np.array(problem.region.lower), np.array(problem.region.upper)
    for _ in range(50):
        parameters = lower + rng.random(lower.size) * (upper - lower)
        A, C = (np.array(part, dtype=float) for part in problem.system(parameters))
        tau = rng.uniform(*TAU)
        A_4, C_4 = np.zeros((4, 4)), np.zeros((4, 4))
        A_4[:3, :3], A_4[3, :3], A_4[3, 3] = A, C[3] / tau, -1.0 / tau
        C_4[:3, :3], C_4[3, 3] = C[:3], 1.0
        assert np.linalg.eigvals(A_4 - found.L @ C_4).real.max() < 0.0


def test_numbers_that_prove_nothing_are_refused(cascade):
    problem, gain = cascade
    found = with_sensor_state(problem, gain, TAU, 40.0)
    heavy = found.P.copy()
    heavy[3, 3] *= 1e6  # the sensor's error now outweighs what the others take away
    with pytest.raises(NotProven, match="V does not fall at rho_1 = "):
        prove(problem, found.L, heavy, TAU)
    with pytest.raises(NotProven, match="V does not fall"):
        prove(problem, -found.L, found.P, TAU)


def test_a_sensor_that_corrects_the_engine_is_refused(cascade):
    problem, gain = cascade
    L = gain.L.copy()
    L[0, 3] = 1.0
    other = Gain(L, gain.P, gain.Q, gain.eps_1, gain.eps_2, gain.region, gain.certificate)
    with pytest.raises(NotProven, match="expected a cascade"):
        with_sensor_state(problem, other, TAU, 40.0)
