"""Effects outside the catalogue: forms and times against their definitions, written here on their own."""

from itertools import pairwise

import numpy as np
import pytest

from lpvobs.errors import UsageError
from lpvobs.simulation.disturbances import ChannelEffect, Telegraph, UnloggedEffect
from lpvobs.simulation.effects import CatalogueEffect
from lpvobs.simulation.parameters import ErrorSurface
from lpvobs.simulation.road import Auxiliary
from lpvobs.simulation.simulate import simulate

PERFECT = ErrorSurface("zero")


@pytest.fixture(scope="module")
def on_road(config, minutes):
    """Return a function that drives for three minutes on one and the same road, with a perfect sensor; each drive once."""
    known = {}

    def drive(*effects, rate=20.0):
        if (effects, rate) not in known:
            known[effects, rate] = simulate(
                config.engine, config.simulation, minutes, rate, seed=4, surface=PERFECT, effects=effects,
                auxiliary=Auxiliary(),
            )  # fmt: skip
        return known[effects, rate]

    return drive


def disturbed(on_road, effect):
    """Return time, flow, reading and the true channel behind a channel's effect."""
    log = on_road(effect)
    course = log.truth[effect.channel] if isinstance(effect, ChannelEffect) else None
    return log.channels["time"], log.truth["W_c"], log.truth["W_maf"], course


# --- driven by a channel ------------------------------------------------------------------------------------------------------


def test_additive_counts_from_the_channels_mean(on_road):
    _, W, shown, c = disturbed(on_road, ChannelEffect("humidity", "additive", 1e-4))
    np.testing.assert_allclose(shown - W, 1e-4 * (c - c.mean()), rtol=1e-9, atol=1e-15)


def test_gain_counts_from_its_reference(on_road):
    _, W, shown, c = disturbed(on_road, ChannelEffect("T_coolant", "gain", 1e-3, reference=363.0))
    np.testing.assert_allclose(shown / W, 1.0 + 1e-3 * (c - 363.0), rtol=1e-12)


def test_rate_follows_the_slope(on_road):
    time, W, shown, c = disturbed(on_road, ChannelEffect("T_coolant", "rate", 1e-3))
    slope = (c[2:] - c[:-2]) / (time[2:] - time[:-2])
    np.testing.assert_allclose((shown - W)[1:-1], 1e-3 * slope, rtol=1e-6, atol=1e-15)


def test_a_switch_is_on_or_off_within_its_time(on_road):
    effect = ChannelEffect("ac_switch", "switch", 5e-4, onset=20.0, end=150.0)
    time, W, shown, c = disturbed(on_road, effect)
    at_work = (c > 0.5) & (time >= 20.0 - 1e-9) & (time < 150.0 - 1e-9)
    assert 0 < at_work.sum() < (c > 0.5).sum()
    np.testing.assert_allclose(shown - W, np.where(at_work, 5e-4, 0.0), rtol=1e-9, atol=1e-15)


@pytest.mark.slow
def test_a_switch_has_its_threshold_in_the_middle_unless_given(on_road):
    _, W, shown, c = disturbed(on_road, ChannelEffect("T_charge", "switch", 5e-4))
    assert np.array_equal(shown - W > 2e-4, c > 0.5 * (c.min() + c.max()))
    _, W, shown, c = disturbed(on_road, ChannelEffect("T_charge", "switch", 5e-4, threshold=float(np.median(c))))
    assert np.mean(shown - W > 2e-4) == pytest.approx(0.5, abs=0.01)


@pytest.mark.slow
def test_a_disturbance_of_no_size_changes_no_byte(on_road):
    plain = on_road()
    nothing = ChannelEffect("humidity", "gain", 0.0), UnloggedEffect("additive", 0.0, ((10.0, 20.0), (30.0, 40.0)))
    log = on_road(*nothing)
    for name, values in plain.channels.items():
        assert np.array_equal(values, log.channels[name]), name


@pytest.mark.slow
def test_a_lag_makes_a_disturbance_slow_too(on_road):
    """Both together end up where the disturbance alone does when nothing else moves; on the way they are slower."""
    switch = ChannelEffect("ac_switch", "switch", 5e-4)
    slow = CatalogueEffect("maf.lag", 2.0)
    added = on_road(switch, slow).truth["W_maf"] - on_road(slow).truth["W_maf"]
    course, step = on_road().truth["ac_switch"] > 0.5, 0.05
    y, wanted = 5e-4 * course[0], []
    for on in course:
        wanted.append(y)
        y += (1.0 - np.exp(-step / 2.0)) * (5e-4 * on - y)
    # the switch falls somewhere within a sample of 50 ms: 2.5 % of its height, twice that allowed
    np.testing.assert_allclose(added, wanted, atol=2.5e-5)


# --- driven by nothing that is logged ---------------------------------------------------------------------------------------


EPISODES = ((20.0, 40.0), (90.0, 130.0))


@pytest.mark.parametrize("form", ["additive", "gain"])
@pytest.mark.slow
def test_abrupt_episodes(on_road, form):
    time, W, shown, _ = disturbed(on_road, UnloggedEffect(form, 5e-3, EPISODES))
    inside = ((time >= 20.0) & (time < 40.0)) | ((time >= 90.0) & (time < 130.0))
    wanted = W + 5e-3 * inside if form == "additive" else W * (1.0 + 5e-3 * inside)
    np.testing.assert_allclose(shown, wanted, rtol=1e-13)


def test_smooth_episodes_rise_and_fall_over_a_quarter_each(on_road):
    time, W, shown, _ = disturbed(on_road, UnloggedEffect("additive", 5e-3, EPISODES, "smooth"))
    share = (shown - W) / 5e-3
    at = dict(zip(np.round(time, 3).tolist(), share.tolist(), strict=True))
    for moment, wanted in ((20.0, 0.0), (22.5, 0.5), (25.0, 1.0), (30.0, 1.0), (35.0, 1.0), (37.5, 0.5), (95.0, 0.5)):
        assert at[moment] == pytest.approx(wanted, abs=1e-9)
    outside = (time <= 20.0) | ((time >= 40.0) & (time <= 90.0)) | (time >= 130.0)
    np.testing.assert_allclose(share[outside], 0.0, atol=1e-12)
    # a quarter of a sine's period over 5 s: pi/2 per flank at its steepest, 50 ms apart
    assert np.abs(np.diff(share)).max() <= 0.5 * np.pi * 0.05 / 5.0 + 1e-9


def test_no_channel_of_the_log_tells_of_it(on_road):
    plain, log = on_road(), on_road(UnloggedEffect("gain", 0.05, EPISODES))
    for name, values in plain.channels.items():
        assert np.array_equal(values, log.channels[name]) == (name != "W_maf"), name


def test_a_telegraph_has_its_mean_times_and_follows_its_seed():
    episodes = Telegraph(3, 20.0, 50.0).episodes(100e3)
    lengths = np.array([stop - start for start, stop in episodes])
    gaps = np.array([after[0] - before[1] for before, after in pairwise(episodes)])
    # some 1400 episodes: standard error of an exponential's mean 2.7 %, three times that allowed
    assert lengths.mean() == pytest.approx(20.0, rel=0.08)
    assert gaps.mean() == pytest.approx(50.0, rel=0.08)
    assert episodes == Telegraph(3, 20.0, 50.0).episodes(100e3)
    assert episodes[:3] != Telegraph(4, 20.0, 50.0).episodes(1000.0)[:3]


def test_a_telegraph_disturbs_during_its_episodes(on_road):
    drawn = Telegraph(5, 25.0, 40.0)
    time, W, shown, _ = disturbed(on_road, UnloggedEffect("additive", 1e-3, drawn))
    inside = np.any([(time >= a) & (time < b) for a, b in drawn.episodes(180.0)], axis=0)
    np.testing.assert_allclose(shown, W + 1e-3 * inside, rtol=1e-13)


# --- refusals -----------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: ChannelEffect("T_oil", "gain", 1e-3), "no such auxiliary channel; expected one of T_coolant"),
        (lambda: ChannelEffect("humidity", "cubic", 1e-3), "form = 'cubic', expected one of additive"),
        (lambda: ChannelEffect("humidity", "gain", float("nan")), "finite"),
        (lambda: ChannelEffect("humidity", "rate", 1e-3, reference=3.0), "does not use the key 'reference'"),
        (lambda: ChannelEffect("humidity", "gain", 1e-3, threshold=3.0), "does not use the key 'threshold'"),
        (lambda: ChannelEffect("humidity", "gain", 1e-3, onset=5.0, end=5.0), "is not after"),
        (lambda: ChannelEffect("ac_switch", "switch", 0.5), "change the reading by 0.5 kg/s"),
        (lambda: UnloggedEffect("rate", 1e-3, EPISODES), "expected one of additive, gain"),
        (lambda: UnloggedEffect("gain", 5.0, EPISODES), "check amplitude"),
        (lambda: UnloggedEffect("gain", 0.1, EPISODES, "soft"), "expected abrupt or smooth"),
        (lambda: UnloggedEffect("gain", 0.1, EPISODES[:1]), "at least two"),
        (lambda: UnloggedEffect("gain", 0.1, EPISODES[::-1]), "overlap or are not in order of time"),
        (lambda: UnloggedEffect("gain", 0.1, ((20.0, 10.0), (30.0, 40.0))), "is not after"),
        (lambda: Telegraph(-1, 10.0, 10.0), "zero or more"),
        (lambda: Telegraph(1, 1e-6, 10.0), "at least 0.1 s"),
        (lambda: Telegraph(1, 10.0, float("inf")), "at least 0.1 s"),
    ],
)
def test_what_cannot_be_meant_is_refused(make, words):
    with pytest.raises(UsageError) as refused:
        make()
    assert words in str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("effect", "auxiliary", "words"),
    [
        (ChannelEffect("humidity", "gain", 1e-3), None, "does not log channel humidity"),
        (ChannelEffect("humidity", "gain", 1e-3), Auxiliary(("T_coolant",)), "does not log channel humidity"),
        (ChannelEffect("v_veh", "gain", 1e-3), Auxiliary(), "does not log channel v_veh"),
        (ChannelEffect("T_coolant", "gain", 1e-3, onset=500.0), Auxiliary(), "before the end"),
        (ChannelEffect("T_coolant", "gain", 1.0, reference=0.0), Auxiliary(), "check amplitude"),
        (UnloggedEffect("gain", 0.1, ((1.0, 2.0), (500.0, 600.0))), None, "at least two"),
        (CatalogueEffect("maf.gain", 1.1, onset=500.0), None, "before the end"),
        (CatalogueEffect("maf.temperature", 1e-3), None, "add an [auxiliary] table"),
    ],
)
def test_what_would_leave_no_trace_on_a_drive_is_refused(config, cycle, effect, auxiliary, words):
    with pytest.raises(UsageError) as refused:
        simulate(config.engine, config.simulation, cycle, 10.0, effects=(effect,), auxiliary=auxiliary)
    assert words in str(refused.value)


def test_a_channel_that_stands_still_is_followed_by_nothing():
    with pytest.raises(UsageError, match="is constant on this drive"):
        ChannelEffect("ac_switch", "switch", 5e-4).settled({"ac_switch": np.zeros(100)}, 10.0)


def test_a_drift_that_ends_in_nonsense_is_refused(config, tmp_path):
    """Reading down to 16 % after seven minutes, on a cycle that stands still and is refused before it is driven."""
    path = tmp_path / "idle.csv"
    path.write_text("time_s,speed_norm_pct,torque_norm_pct,motoring\n0,0,0,0\n420,0,0,0\n")
    with pytest.raises(UsageError, match=r"multiplies the reading by 0\.16 at 420 s"):
        simulate(config.engine, config.simulation, str(path), effects=(CatalogueEffect("maf.drift", -2e-3),))
