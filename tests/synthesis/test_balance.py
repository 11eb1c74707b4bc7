import numpy as np
import pytest

from lpvobs.synthesis.balance import balance


def balanced(A, C):
    units = balance(A, C)
    T, S = units.states, units.outputs
    return A * T / T[:, None] / units.rate, C * T / S[:, None], units


def test_other_units_give_the_same_balanced_matrices():
    rng = np.random.default_rng(5)
    for _ in range(20):
        A = rng.standard_normal((4, 3, 3)) * (rng.random((3, 3)) < 0.7)
        C = rng.standard_normal((4, 2, 3)) * (rng.random((2, 3)) < 0.5)
        D, E = 10.0 ** rng.uniform(-6, 6, 3), 10.0 ** rng.uniform(-6, 6, 2)
        before = balanced(A, C)
        after = balanced(A * D[:, None] / D, C * E[:, None] / D)
        for one, other in zip(before[:2], after[:2], strict=True):
            np.testing.assert_allclose(other, one, rtol=1e-11, atol=1e-13)  # logarithms of 1e12 cost four digits


def test_the_diesel_comes_within_two_decades(diesel):
    A, C, _ = balanced(*diesel("ETC", p_em=True).matrices())
    largest = np.concatenate([np.abs(A).max(axis=0).ravel(), np.abs(C).max(axis=0).ravel()])
    coupled = largest[largest > 0]
    assert coupled.max() / coupled.min() < 100.0  # in Pa and rad/s it is more than seven decades
    raw = np.abs(np.concatenate([m.max(axis=0).ravel() for m in diesel("ETC", p_em=True).matrices()]))
    assert raw.max() / raw[raw > 0].min() > 1e7


def test_the_rate_is_a_rate_of_the_plant():
    oscillator = np.array([[[0.0, 4000.0], [-0.001, 0.0]]])
    assert balance(oscillator, np.array([[[1.0, 0.0]]])).rate == pytest.approx(2.0, rel=1e-12)  # rounding
    integrators = np.array([[[0.0, 5.0, 0.0], [0.0, 0.0, 7.0], [0.0, 0.0, 0.0]]])
    assert balance(integrators, np.array([[[1.0, 0.0, 0.0]]])).rate == 1.0


def test_parts_that_do_not_meet_are_told_apart():
    A = np.array([[[-1.0, 0.0, 2.0], [0.0, -3.0, 0.0], [0.0, 0.0, -1.0]]])
    C = np.array([[[0.0, 0.0, 1.0], [0.0, 4.0, 0.0]]])
    expected = [[1, 0, 1, 1, 0], [0, 1, 0, 0, 1], [1, 0, 1, 1, 0]]
    assert balance(A, C).linked.tolist() == np.array(expected, dtype=bool).tolist()
