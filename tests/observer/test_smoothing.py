"""Local quadratics: exact on quadratics, no phase, no reach across gaps or beyond the window."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from reference import local_quadratic

from lpvobs.observer import smoothing
from lpvobs.observer.smoothing import smooth, stretches
from lpvobs.records import Piece

WIDTH = 0.05


def uneven(seed, N, low=0.002, high=0.02):
    rng = np.random.default_rng(seed)
    return np.cumsum(rng.uniform(low, high, N)), rng


def whole(time):
    return ((0, time.size),)


@pytest.mark.parametrize(("low", "high"), [(0.002, 0.02), (0.009, 0.011), (0.02, 0.9), (1e-4, 0.3)])
def test_equals_a_weighted_least_squares_fit_at_every_sample(low, high):
    time, rng = uneven(1, 150, low, high)
    signals = np.stack([1e5 + 1e3 * rng.standard_normal(150), np.sin(time)])
    values, rates = smooth(time, signals, whole(time), WIDTH)
    for m, signal in enumerate(signals):
        slow = np.array([local_quadratic.fit(time, signal, k, WIDTH) for k in range(150)])
        size = np.ptp(signal)
        # At the ends three samples may carry the fit, the last with a weight of 4e-6: the cofactors lose that many digits.
        np.testing.assert_allclose(values[m], slow[:, 0], rtol=0, atol=1e-8 * size + 1e-11 * np.abs(signal).max())
        np.testing.assert_allclose(rates[m], slow[:, 1], rtol=1e-6, atol=1e-7 * (size + np.abs(signal).max()) / WIDTH)


@given(st.integers(0, 2**32 - 1), st.sampled_from([0.01, 0.05, 0.3]), st.integers(3, 60))
def test_quadratics_are_reproduced_exactly(seed, width, N):
    time, rng = uneven(seed, N)
    a, b, c = rng.uniform(-1, 1, 3)
    values, rates = smooth(time, (a + b * time + c * time**2)[None, :], whole(time), width)
    # Rounding, divided by the smallest weight that the fit may hang on, 4e-6, and for the slope by the spacing.
    np.testing.assert_allclose(values[0], a + b * time + c * time**2, rtol=0, atol=1e-9)
    np.testing.assert_allclose(rates[0], b + 2 * c * time, rtol=0, atol=1e-6)


def test_no_phase_on_even_sampling():
    time = np.arange(2000) * 0.01
    for frequency in (0.5, 3.0, 10.0):
        wave = np.stack([np.sin(2 * np.pi * frequency * time), np.cos(2 * np.pi * frequency * time)])
        values, _ = smooth(time, wave, whole(time), 0.047)  # no sample on the rim, where rounding would choose
        inner = slice(500, 1500)  # whole periods of every frequency
        in_phase, shifted = (values[0, inner] @ part[inner] / 500 for part in wave)
        assert (
            abs(shifted) < 1e-11
        )  # a symmetric window turns a sine into a multiple of itself; time stamps round at 20 s
        assert 0.0 < in_phase <= 1.0
        np.testing.assert_allclose(values[0, inner], in_phase * wave[0, inner], rtol=0, atol=1e-10)


def test_derivative_of_a_sine():
    time, _ = uneven(3, 1000)
    omega = 2 * np.pi
    values, rates = smooth(time, np.sin(omega * time)[None, :], whole(time), WIDTH)
    inside = slice(50, -50)
    # The cubic term left out of the fit: omega^3 w^2 / 6 at most for the slope; for the value uneven spacing leaves a part of
    # omega^3 w^3 / 6.
    np.testing.assert_allclose(
        rates[0, inside], omega * np.cos(omega * time)[inside], rtol=0, atol=omega**3 * WIDTH**2 / 6
    )
    np.testing.assert_allclose(values[0, inside], np.sin(omega * time)[inside], rtol=0, atol=omega**3 * WIDTH**3 / 6)
    halved = smooth(time, np.sin(omega * time)[None, :], whole(time), WIDTH / 2)[1]
    error = [np.abs(r[0, inside] - omega * np.cos(omega * time)[inside]).max() for r in (rates, halved)]
    assert error[1] < 0.45 * error[0]  # second order in the window


def test_noise_is_reduced():
    time = np.arange(4000) * 0.01
    noise = np.random.default_rng(4).standard_normal(4000)
    values, _ = smooth(time, noise[None, :], whole(time), WIDTH)
    # A local quadratic over nine samples with biweights has a noise gain of about 0.64 in the standard deviation.
    assert 0.4 < np.std(values) < 0.75


def test_no_window_reaches_into_another_segment():
    time, rng = uneven(5, 200)
    signal = rng.standard_normal((2, 200))
    segments = ((0, 80), (80, 140), (140, 200))
    reference = smooth(time, signal, segments, WIDTH)
    disturbed = signal.copy()
    disturbed[:, 80:140] += 1e6
    for a, b in zip(reference, smooth(time, disturbed, segments, WIDTH), strict=True):
        np.testing.assert_array_equal(a[:, :80], b[:, :80])
        np.testing.assert_array_equal(a[:, 140:], b[:, 140:])
    for start, stop in segments:
        alone = smooth(time[start:stop], signal[:, start:stop], ((0, stop - start),), WIDTH)
        for a, b in zip(reference, alone, strict=True):
            np.testing.assert_array_equal(a[:, start:stop], b)


def test_pieces_give_what_the_whole_gives_where_no_window_touches_the_cut():
    time, rng = uneven(6, 400)
    signal = rng.standard_normal((1, 400))
    reference = smooth(time, signal, whole(time), WIDTH)
    for cut in (100, 237):
        reach = 2 * WIDTH
        before = np.searchsorted(time, time[cut] - reach)
        after = np.searchsorted(time, time[cut] + reach)
        left = smooth(time[:cut], signal[:, :cut], ((0, cut),), WIDTH)
        right = smooth(time[cut:], signal[:, cut:], ((0, 400 - cut),), WIDTH)
        for a, b, c in zip(reference, left, right, strict=True):
            np.testing.assert_array_equal(a[:, :before], b[:, :before])
            np.testing.assert_array_equal(a[:, after:], c[:, after - cut :])


def test_look_ahead_is_bounded():
    time, rng = uneven(7, 300)
    signal = rng.standard_normal((1, 300))
    other = signal.copy()
    other[0, 150] += 1.0
    changed = smooth(time, signal, whole(time), WIDTH)[0] != smooth(time, other, whole(time), WIDTH)[0]
    touched = np.flatnonzero(changed[0])
    assert (np.abs(time[touched] - time[150]) <= WIDTH).all() or (np.abs(touched - 150) <= 2).all()
    assert 150 in touched


@pytest.mark.parametrize("N", [1, 2])
def test_segments_too_short_for_a_quadratic_stay_as_they_are(N):
    time = np.arange(N) * 0.01
    signal = np.arange(N)[None, :] + 5.0
    values, rates = smooth(time, signal, whole(time), WIDTH)
    np.testing.assert_array_equal(values, signal)
    np.testing.assert_array_equal(rates, 0.0)


def binary(seed, N):
    """Return time stamps whose differences are exact, so that many samples lie on the very rim of a window of 4/128 s."""
    return np.cumsum(np.random.default_rng(seed).choice([1.0, 2.0], N)) / 128.0


RIM = 4.0 / 128.0


def test_a_sample_on_the_rim_takes_no_part():
    time = binary(8, 300)
    signal = np.random.default_rng(9).standard_normal((1, 300))
    values, rates = smooth(time, signal, whole(time), RIM)
    on_the_rim = 0
    for k in range(20, 280):
        within = np.flatnonzero(np.abs(time - time[k]) < RIM)
        part = slice(min(within[0], k - smoothing.LEAST), max(within[-1], k + smoothing.LEAST) + 1)
        on_the_rim += np.count_nonzero(np.abs(time - time[k]) == RIM)
        value, rate = smooth(time[part], signal[:, part], whole(time[part]), RIM)
        at = k - part.start
        assert (value[0, at], rate[0, at]) == (values[0, k], rates[0, k])
    assert on_the_rim > 100


@pytest.mark.parametrize("width", [RIM, 0.05])
@pytest.mark.parametrize("cuts", [(), (1, 2, 3), (90,), tuple(range(5, 240, 11)), tuple(range(1, 250))])
def test_pieces_of_any_size_give_the_bits_of_the_whole(width, cuts):
    time = binary(10, 250)
    signal = np.random.default_rng(11).standard_normal(250)
    begins = np.zeros(250, dtype=bool)
    begins[[0, 100, 102]] = True
    time[100:] += 60.0
    time[102:] += 60.0
    edges = [0, *cuts, 250]
    parts = [slice(start, stop) for start, stop in pairwise(edges)]
    pieces = [Piece(time[part], {"p": signal[part]}, begins[part]) for part in parts]
    found = list(stretches(pieces, ("p",), width, ("p",), ("p",)))
    segments = ((0, 100), (100, 102), (102, 250))
    values, rates = smooth(time, signal[None, :], segments, width)
    calm, _ = smooth(time, signal[None, :], segments, smoothing.CALM * width, smoothing.CALM_LEAST)
    np.testing.assert_array_equal(np.concatenate([item.time for item in found]), time)
    np.testing.assert_array_equal(np.concatenate([item.values["p"] for item in found]), values[0])
    np.testing.assert_array_equal(np.concatenate([item.rates["p"] for item in found]), rates[0])
    np.testing.assert_array_equal(np.concatenate([item.calm["p"] for item in found]), calm[0])
    rough = smoothing.roughness(signal, segments)
    np.testing.assert_array_equal(np.concatenate([item.rough["p"] for item in found]), rough)
    starts = np.cumsum([0, *(item.time.size for item in found)])[:-1]
    assert [int(at) for at, item in zip(starts, found, strict=True) if item.before is None] == [0, 100, 102]
    for at, item in zip(starts, found, strict=True):
        if item.before is not None:
            assert item.before == time[at - 1]


def test_only_samples_whose_window_is_open_are_held_back():
    time = 1.0 + np.arange(40) / 128.0
    begins = np.arange(40) == 0
    pieces = (Piece(time[k : k + 1], {"p": time[k : k + 1]}, begins[k : k + 1]) for k in range(40))
    passed = [item.time[-1] for item in stretches(pieces, ("p",), RIM)]
    # Read to the sample of number 39 by then; all but the last window's four samples came while reading.
    assert len(passed) == 36 + 1
    assert passed[-1] == time[-1]


def test_roughness_is_the_noise_and_no_transient():
    time = 0.05 * np.arange(4000.0)
    noise = 150.0 * np.random.default_rng(12).standard_normal(time.size)
    transient = 2e5 + 1e4 * np.sin(1.5 * time)  # 15 kPa/s at most, 20 samples a second
    found = smoothing.roughness(transient + noise, ((0, 1500), (1500, 4000)))
    # 4000 second differences say as much as 2060 independent ones: 1.6 % is one standard deviation
    assert np.sqrt(np.mean(found**2)) == pytest.approx(150.0, rel=0.05)
    assert np.all(found[[0, 1499, 1500, 3999]] == 0.0)


@pytest.mark.parametrize("step", [0.01, 0.05])
@pytest.mark.parametrize("least", [smoothing.LEAST, smoothing.CALM_LEAST])
def test_the_kernel_is_what_a_window_does_to_one_sample(step, least):
    time = step * np.arange(101.0)
    one = np.zeros((1, 101))
    one[0, 50] = 1.0
    values, rates = smooth(time, one, whole(time), 0.052, least)
    found = smoothing.kernel(step, 0.052, least)
    side = found.shape[1] // 2
    np.testing.assert_allclose(values[0, 50 - side : 51 + side][::-1], found[0], atol=1e-12)
    np.testing.assert_allclose(rates[0, 50 - side : 51 + side][::-1], found[1], atol=1e-9)
