"""White is white, coloured is coloured, and a lagged cause is named."""

import numpy as np
import pytest

from lpvobs.discovery.whiteness import correlation, periodogram_distance, portmanteau, whiteness

FIRST = np.arange(0, 6000, 20)


def test_white_noise_of_uneven_size_passes():
    rng = np.random.default_rng(1)
    failed = 0
    for _ in range(200):
        x = rng.standard_normal(300) * np.repeat([0.3, 3.0], 150)
        failed += portmanteau(x)[2] < 0.05
    assert failed <= 20  # 10 expected, standard deviation 3: three of them


def test_a_drifting_residual_is_not_white_and_its_cause_is_named():
    rng = np.random.default_rng(3)
    cause = np.repeat(np.cumsum(rng.standard_normal(300)), 20)
    cause = (cause - cause.mean()) / cause.std()
    other = rng.standard_normal(6000)
    residual = rng.standard_normal((2, 6000))
    residual[1] += 0.5 * np.roll(cause, 60)  # three blocks later
    found = whiteness(residual, FIRST, {"cause": cause, "other": other})
    assert not found.white
    assert list(found.correlated_with) == ["cause"]
    assert found.p_values[0] > 1e-3 > found.p_values[1]
    assert found.periodogram_distance[1] > found.periodogram_band > found.periodogram_distance[0]


def test_noise_alone_is_white_and_follows_nothing():
    rng = np.random.default_rng(8)
    found = whiteness(rng.standard_normal((4, 6000)), FIRST, {"a": rng.standard_normal(6000)})
    assert found.white
    assert found.correlated_with == {}


def test_lag_has_a_sign():
    rng = np.random.default_rng(5)
    y = rng.standard_normal(400)
    x = np.roll(y, 4)  # x follows y by four
    rows, columns = np.stack([x, y]), np.stack([y, rng.standard_normal(400), x])
    pairs = {lag: correlation(rows, columns, lag) for lag in (4, -4)}
    found, noise = pairs[4][0, 0]
    assert found > max(0.9, 3.0 * noise)
    found, noise = pairs[-4][0, 0]
    assert abs(found) < 3.0 * noise
    found, noise = pairs[-4][2, 1]  # y comes before x
    assert found > max(0.9, 3.0 * noise)
    found, noise = pairs[4][1, 1]  # of other rows, against the textbook
    assert found == pytest.approx(np.corrcoef(columns[1][:-4], rows[1][4:])[0, 1])
    assert noise == pytest.approx(1.0 / np.sqrt(396.0), rel=0.1)
    assert correlation(rows, columns, 399).tolist() == np.zeros((3, 2, 2)).tolist()  # nothing is left to correlate


def test_a_single_line_is_far_from_the_straight_one():
    assert periodogram_distance(np.sin(np.arange(400.0))) > 0.5
    assert periodogram_distance(np.zeros(10)) == 0.0
