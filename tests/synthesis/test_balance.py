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


def test_one_state_by_hand():
    # |A| = 4 is the rate; T / S = 1 / 3, and T S = 1 where nothing else sets the scale
    units = balance(np.array([[[-4.0]]]), np.array([[[3.0]]]))
    assert units.rate == pytest.approx(4.0, rel=1e-12)  # rounding, here and below
    assert units.states == pytest.approx([1.0 / np.sqrt(3.0)], rel=1e-12)
    assert units.outputs == pytest.approx([np.sqrt(3.0)], rel=1e-12)


def test_a_chain_by_hand_counts_the_largest_magnitude_of_all_vertices():
    A = np.array([[[-2.0, 1.0], [0.0, -0.5]], [[0.5, -8.0], [0.0, 1.0]]])
    units = balance(A, np.array([[[0.0, 0.0]], [[-1.0, 0.0]]]))
    assert units.rate == pytest.approx(2.0, rel=1e-12)
    # The coupling of 8 1/s is 4 of that rate, so T_2 / T_1 = 1/4; T_1 = S; and T_1 T_2 S = 1.
    assert units.states == pytest.approx([4.0 ** (1 / 3), 4.0 ** (-2 / 3)], rel=1e-12)
    assert units.outputs == pytest.approx([4.0 ** (1 / 3)], rel=1e-12)


def test_a_ring_by_hand():
    # The rate is sqrt(4 * 16) = 8; in it the couplings are 1/2 and 2, which T_2 / T_1 = 2 makes one.
    units = balance(np.array([[[0.0, 4.0], [16.0, 0.0]]]), np.array([[[0.0, 0.0]]]))
    assert units.rate == pytest.approx(8.0, rel=1e-12)
    assert units.states == pytest.approx([np.sqrt(0.5), np.sqrt(2.0)], rel=1e-12)
    assert units.outputs.tolist() == [1.0]


def test_states_that_nothing_touches_keep_their_units():
    units = balance(np.diag([-1.0, -3.0])[None], np.zeros((1, 2, 2)))
    assert units.rate == pytest.approx(3.0, rel=1e-12)
    assert units.states.tolist() == [1.0, 1.0]
    assert units.outputs.tolist() == [1.0, 1.0]
    assert units.linked.tolist() == [[True, False, False, False], [False, True, False, False]]


def test_ties_go_along_a_chain_in_either_direction():
    A = np.zeros((1, 4, 4))
    A[0, 0, 1], A[0, 2, 1], A[0, 2, 3] = 0.5, 0.25, 7.0  # 1 - 2 - 3 - 4, arrows both ways
    C = np.zeros((1, 3, 4))
    C[0, 1, 3] = 0.1
    assert balance(A, C).linked.tolist() == [[True] * 4 + [False, True, False]] * 4
