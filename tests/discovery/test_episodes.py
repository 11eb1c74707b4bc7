"""When an effect acts: the best sequence of episodes against all sequences, and pauses that one interval hides."""

from itertools import product

import numpy as np
import pytest

from lpvobs.discovery.course_choice import _with_interval, comes_and_goes, switched
from lpvobs.discovery.fit import fit
from lpvobs.discovery.linear import Term
from lpvobs.discovery.map_prior import free_map
from lpvobs.discovery.residual import lay_out


def worth_of(sequence, gain, cost):
    return float(gain[list(sequence)].sum()) - cost * np.count_nonzero(np.diff(np.array(sequence, dtype=int)))


@pytest.mark.parametrize("seed", range(5))
def test_no_other_sequence_is_worth_more(seed):
    rng = np.random.default_rng(seed)
    gain, cost = rng.standard_normal(12), 0.8
    best = max(worth_of(sequence, gain, cost) for sequence in product((False, True), repeat=gain.size))
    found = switched(gain, cost)
    assert worth_of(found.tolist(), gain, cost) == pytest.approx(best, abs=1e-12)  # rounding of twelve sums


def test_switches_that_cost_more_than_they_gain_are_not_made():
    gain = np.array([5.0, 5.0, -1.0, 5.0])
    assert switched(gain, 2.0).tolist() == [True] * 4
    assert switched(gain, 0.4).tolist() == [True, True, False, True]


@pytest.fixture(scope="module")
def fitted(plant, config):
    """Return the model of a log with a gain of the sensor in one interval; of it, 140 to 160 s are kept from every fit."""
    gain = next(effect for effect in plant.catalogue if effect.id == "maf.gain")

    def model(log, begin, end):
        problem = lay_out(plant, config.grid(), free_map(config.grid(), len(config.estimate.tolerance), 0.1), [log])
        return fit(problem, [Term(gain, 1.05, begin, end)])

    return model


@pytest.mark.parametrize(("pause", "goes"), [(0.0, False), (15.0, True), (40.0, True)])
@pytest.mark.slow
def test_a_pause_inside_an_interval_is_seen(fitted, clean, misread, pause, goes):
    t = clean.time
    on = (t > 80.0) & (t < 260.0) & ~((t > 170.0) & (t < 170.0 + pause))
    log = misread(clean, clean["W_maf"] * np.where(on, 1.08, 1.0))
    assert comes_and_goes(fitted(log, 80.0, 260.0), 0) is goes


def test_what_undoes_an_effect_in_a_pause_does_not_hide_the_pause(fitted, plant, clean, misread):
    t = clean.time
    on = (t > 80.0) & (t < 260.0) & ~((t > 170.0) & (t < 200.0))
    model = fitted(misread(clean, clean["W_maf"] * np.where(on, 1.08, 1.0)), 80.0, 260.0)
    gain = model.terms[0].effect
    undone = fit(model.problem, [Term(gain, 1.08, 80.0, 260.0), Term(gain, 0.93, 170.0, 200.0)])
    assert comes_and_goes(undone, 0)


@pytest.mark.parametrize(
    ("span", "acts", "expected"),
    [
        ((5.0, 6.0), True, [(0.0, 2.0), (3.0, 4.0), (5.0, 6.0)]),
        ((1.5, 3.5), True, [(0.0, 4.0)]),
        ((0.5, 1.0), False, [(0.0, 0.5), (1.0, 2.0), (3.0, 4.0)]),
        ((1.5, 9.0), False, [(0.0, 1.5)]),
        ((-1.0, 9.0), False, []),
    ],
)
def test_a_further_episode_or_a_pause_changes_the_intervals(span, acts, expected):
    assert _with_interval([(0.0, 2.0), (3.0, 4.0)], np.array(span), acts) == expected
