"""How far the balances agree: nothing is said of a right engine, and what is mixed up is named."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.stats import chi2

from lpvobs.engines.diesel import SUSPECTS
from lpvobs.engines.registry import ENGINES
from lpvobs.engines.unknowns import unknowns_of
from lpvobs.errors import DataError
from lpvobs.maps.grid import Grid
from lpvobs.observer import balance_agreement
from lpvobs.observer.balance_agreement import DISAGREE, BalanceSums, Judged, Watched, agreement
from lpvobs.records import Piece

GRID = Grid(np.array([0.0, 10.0, 20.0, 30.0]), np.array([1000.0, 2000.0, 3000.0]))
AXES = ("fuel", "speed")


def sums(difference, visits=None, slope=0.0, flow=0.05, n=20.0, power=((1.0,),)):
    """Return sums of six cells and a pair of balances: `difference` is the mean [kg/s], n blocks a cell."""
    one = np.full((6, 1), n)
    visits = np.zeros((6, 1, 3)) if visits is None else visits
    mean = np.full((6, 1), difference) if np.isscalar(difference) else difference
    slopes = np.full((6, 1, 1), n * slope)
    return BalanceSums(
        one[:, 0],
        0.05 * one[:, 0],
        one,
        flow * one,
        n * mean,
        np.array(power),
        slopes,
        visits,
        np.zeros(0),
        np.zeros(4),
    )


def test_a_difference_as_large_as_the_model_leaves_out_has_ratio_one():
    found = agreement(GRID, sums(0.001), np.zeros((1, 1)), AXES)
    assert found.ratio == pytest.approx(1.0)
    assert found.p_value == pytest.approx(chi2.sf(6.0, 6), rel=1e-6)  # six cells with independent errors


def test_a_tolerance_of_a_constant_is_one_degree_of_freedom():
    """Slope 0.05 kg/s and a relative variance of 0.2^2: the model's 0.001 vanishes beside 0.01 in all cells at once."""
    found = agreement(GRID, sums(0.02, slope=0.05), np.array([[0.04]]), AXES)
    assert found.ratio == pytest.approx(2.0, rel=0.01)
    assert found.p_value == pytest.approx(chi2.sf(4.0, 1), rel=0.1)


def test_scatter_between_visits_is_allowed_for_and_the_worst_cell_is_named():
    """Four visits of five blocks each whose means differ by +-0.02 about 0.01: standard deviation of the mean 0.02 / 2."""
    s = 5.0 * np.array([0.03, -0.01, 0.03, -0.01])
    visits = np.tile([[np.sum(s * s), np.sum(5.0 * s), 100.0]], (6, 1, 1))
    difference = np.full((6, 1), 0.01)
    difference[4] = 0.05
    calm = agreement(GRID, sums(difference), np.zeros((1, 1)), AXES)
    wild = agreement(GRID, sums(difference, visits), np.zeros((1, 1)), AXES)
    assert calm.where == wild.where == {"fuel": (10.0, 20.0), "speed": (2000.0, 3000.0)}
    assert wild.ratio < 0.3 * calm.ratio


@pytest.mark.parametrize(
    ("power", "found"),
    [
        ([[9.0, 30.0, 2.0, 1.0]], 2),
        ([[9.0, 30.0, 2.0, 1.0], [0.0, 0.0, 0.0, 8.0]], 1),  # of several pairs the worse one counts
        ([[9.0, 30.0, 2.5, 8.0]], None),
        ([[9.0, np.inf, np.inf]], None),
        ([[9.0]], None),
    ],
)
def test_the_mistake_without_which_balances_agree_is_found(power, found):
    assert sums(0.02, power=power).mended_by() == found


def test_one_balance_cannot_disagree():
    single = replace(sums(0.0), difference=np.zeros((6, 0)), power=np.zeros((0, 4)))
    assert np.isnan(agreement(GRID, single, np.zeros((1, 1)), AXES).ratio)
    assert agreement(GRID, single, np.zeros((1, 1)), AXES).where == {}
    assert single.mended_by() is None


def test_sums_of_two_logs_are_those_of_both():
    one = sums(0.02)
    assert agreement(GRID, one + one, np.zeros((1, 1)), AXES).ratio == pytest.approx(
        agreement(GRID, one, np.zeros((1, 1)), AXES).ratio
    )
    np.testing.assert_array_equal((one + one).blocks, 2.0 * one.blocks)


@pytest.mark.slow
def test_a_recording_is_passed_on_as_it_is(air_path, drive):
    log = drive[0]
    watched = Watched(log, Judged(air_path, unknowns_of({"R_c": 0.01}, ())), GRID, SUSPECTS)
    with pytest.raises(DataError, match="no sample"):
        _ = watched.sums
    (piece,) = watched.pieces()
    np.testing.assert_array_equal(piece.time, log.time)
    assert (watched.name, watched.sha256, watched.defects) == (log.name, log.sha256, log.defects)
    assert watched.sums.blocks.sum() == len(np.unique(np.floor(log.time / 0.2)))
    assert watched.sums.slope.shape == (6, 1, 1)


class Cut:
    """A log in pieces that end at the samples given."""

    def __init__(self, log, ends, begins=()):
        self.name, self.sha256, self.defects, self.log, self.ends, self.begins = (
            log.name, log.sha256, log.defects, log, ends, list(begins),
        )  # fmt: skip

    def pieces(self):
        (whole,) = self.log.pieces()
        begins = whole.begins.copy()
        begins[self.begins] = True
        for start, end in pairwise((0, *self.ends, len(self.log))):
            part = slice(start, end)
            yield Piece(whole.time[part], {n: column[part] for n, column in whole.channels.items()}, begins[part])


def sums_along(recording, air_path, grid=GRID, uncertain=()):
    engine = Judged(air_path, unknowns_of(dict.fromkeys(uncertain, 0.01), ()))
    watched = Watched(recording, engine, grid, SUSPECTS)
    for _ in watched.pieces():
        pass
    return watched.sums


def test_how_a_log_is_cut_changes_no_bit(air_path, drive, monkeypatch):
    monkeypatch.setattr(balance_agreement, "CHUNK", 64)
    whole = vars(sums_along(drive[0], air_path, uncertain=("R_c",)))
    for ends in ((1,), (7, 8, 103), range(20, len(drive[0]), 20), (len(drive[0]) - 1,)):
        np.testing.assert_equal(vars(sums_along(Cut(drive[0], ends), air_path, uncertain=("R_c",))), whole)


def test_a_block_does_not_reach_across_a_gap(air_path, drive):
    cut, whole = sums_along(Cut(drive[0], (), begins=[7]), air_path), sums_along(drive[0], air_path)
    assert cut.blocks.sum() == whole.blocks.sum() + 1


def test_a_reading_that_is_late_or_held_does_not_follow_the_flow(air_path, drive):
    log = drive[0]
    reading, rate = log["W_maf"], round(1.0 / float(np.median(np.diff(log.time))))

    def follows(W_maf):
        return sums_along(replace(log, channels={**log.channels, "W_maf": W_maf}), air_path).follows()

    held = reading[np.arange(reading.size) // (2 * rate) * 2 * rate]
    assert follows(reading) > 0.8  # of fuel that jumps every few seconds, so that the error of the map jumps, too
    assert follows(0.7 * reading) == pytest.approx(follows(reading))  # a gain is no delay
    assert follows(np.roll(reading, rate)) < 0.5
    assert follows(held) < 0.5
    assert abs(follows(np.full(reading.size, 0.03))) < 0.05


@pytest.fixture(scope="module")
def judged(air_path, grid, drive, settings):
    """Return a function: ratio and mistake found, from changes of the log's channels and of the engine's constants."""

    def judge(change=dict, **deviation):
        log = replace(drive[0], channels=change(drive[0].channels))
        engine = air_path.deviating(deviation)
        variance = np.diag(np.array(list(settings.tolerance.values())) ** 2 / 3.0)
        found = sums_along(log, engine, grid, tuple(settings.tolerance))
        return agreement(grid, found, variance, AXES).ratio, found.mended_by()

    return judge


@pytest.mark.parametrize("mix_up", range(4), ids=[item.says for item in SUSPECTS.mix_ups[:4]])
def test_exchanged_channels_are_named(judged, mix_up):
    assert judged(SUSPECTS.mix_ups[mix_up].mended)[1] == mix_up


def test_a_mistake_that_would_break_a_check_is_none(air_path, grid, drive):
    found = sums_along(drive[0], air_path, grid)
    exchanged = [item.says for item, power in zip(SUSPECTS.mix_ups, found.power[0, 1:], strict=True) if np.isinf(power)]
    assert "p_im and p_em exchanged" in exchanged
    assert "T_im and T_amb exchanged" in exchanged
    assert "u_egr and u_vgt exchanged" not in exchanged


@pytest.mark.parametrize("deviation", [{"V_d": 0.2}, {"V_d": -0.2}, {"R_c": 0.2}, {"R_c": -0.2}])
def test_a_constant_that_is_off_by_a_fifth_shows(judged, deviation):
    right, _ = judged()
    wrong, _ = judged(**deviation)
    assert right < 1.0
    assert wrong > DISAGREE


@pytest.mark.parametrize("kind", ENGINES.values(), ids=list(ENGINES))
def test_suspects_speak_of_channels_that_the_engine_has(kind):
    channels = {name: np.full(3, float(place)) for place, name in enumerate(kind.air_path.channels)}
    for check in kind.suspects.checks:
        assert check.broken(channels).shape == (3,)
        assert 0.0 < check.most < 1.0
    for mix_up in kind.suspects.mix_ups:
        mended = mix_up.mended(channels)
        assert set(mended) == set(channels)
        assert any((mended[name] != channels[name]).any() for name in channels)
