"""Effects that a model has: where they act on logs that told of them and on others, and what they are worth there."""

from dataclasses import replace

import numpy as np
import pytest

from lpvobs.discovery.courses import Curve
from lpvobs.discovery.imbalances import scenes_with
from lpvobs.discovery.known_effects import KnownEffect, Span, from_off, spans_of, term_on
from lpvobs.discovery.map_prior import free_map
from lpvobs.discovery.places import starts
from lpvobs.discovery.refine import refine
from lpvobs.discovery.residual import Term
from lpvobs.errors import DataError

STEP = KnownEffect(
    "maf.gain", "sensor", "factor", "1", 1.08, (1.07, 1.09), (Span("first", "1", 141.0, np.inf),), True, None
)


@pytest.fixture(scope="module")
def first(clean):
    return replace(clean, name="first", sha256="1", auxiliary={"heat": np.sin(0.05 * clean.time)})


@pytest.fixture(scope="module")
def second(clean):
    return replace(clean, name="second", sha256="2", time=clean.time + 1000.0)


def test_an_interval_of_the_clock_is_told_in_the_time_of_each_log(first, second, plant):
    begin = starts([first, second])[1] + 20.0
    effect = plant.catalogue[0]
    lasting = spans_of(Term(effect, 1.1, begin=begin), [first, second])
    assert [span.acts for span in lasting] == [False, True]
    assert lasting[1].begin == pytest.approx(1020.0)  # the second log's own axis begins at 1000 s
    passing = spans_of(Term(effect, 1.1, begin=100.0, end=200.0), [first, second])
    assert [span.acts for span in passing] == [True, False]
    assert (passing[0].begin, passing[0].end) == pytest.approx((100.0, 200.0))


def test_what_lasts_acts_on_later_logs_throughout_and_what_ended_does_not(first, second, laid_out):
    problem = laid_out(first, second)
    half = problem.K // 2

    def active(effect):
        return term_on(effect, problem, [first, second]).acts(problem.clock)

    on = active(STEP)
    assert on[half:].all()
    assert on[:half].mean() == pytest.approx(159.0 / 300.0, abs=0.01)  # from 141 s of 300 s
    ended = replace(STEP, spans=(Span("first", "1", 100.0, 200.0),), lasting=False)
    assert not active(ended)[half:].any()
    healthy = replace(STEP, spans=(*STEP.spans, Span("second", "2", np.inf, np.inf)))
    assert not active(healthy)[half:].any()


def test_a_dirty_film_keeps_the_flow_at_which_it_reads_right(first, laid_out):
    problem, crossing, lost = laid_out(first), 0.011, 0.1
    film = replace(STEP, id="maf.contamination", parameter="coefficient", value=lost, inside=crossing)
    term = term_on(film, problem, [first])
    seen = problem.signals["W_maf"]
    truth = ((np.sqrt(seen) - lost * np.sqrt(crossing)) / (1.0 - lost)) ** 2
    np.testing.assert_allclose(term.effect.apply(problem.signals, lost)["W_maf"], truth, rtol=1e-12)


def test_logs_that_told_of_an_effect_do_not_tell_twice(first, second, laid_out):
    again = term_on(STEP, laid_out(first), [first]).effect
    assert again.null == 1.0  # no effect is what is expected, with a wide prior: estimated anew
    other = term_on(STEP, laid_out(second), [second]).effect
    assert other.null == STEP.value  # what the first log said is known beforehand
    assert other.size < again.size


def test_a_curve_follows_the_channel_of_the_other_log(first, second, laid_out):
    curve = Curve("heat", "value", "maf.gain", np.array([-1.0, 1.0]), np.array([-0.1, 0.1]))
    effect = replace(STEP, id="channel:heat", parameter="amplitude", value=1.0, spans=(), curve=curve)
    problem = laid_out(first)
    term = term_on(effect, problem, [first])
    ((_, signals),) = scenes_with(problem, [term], np.zeros(problem.spread.size))
    undone = problem.signals["W_maf"] / signals["W_maf"]
    expected = 1.0 + 0.1 * np.sin(0.05 * problem.signals.time)
    assert undone == pytest.approx(expected, abs=1e-3)  # the channel is read between samples
    with pytest.raises(DataError, match=r"^second: channel 'heat' is missing, .*record this channel"):
        term_on(effect, laid_out(second), [second])


def test_a_switch_that_is_off_does_nothing():
    switch = Curve("ac", "value", "maf.offset", np.array([0.0, 1.0]), np.array([-0.0004, 0.0006]))
    effect = replace(STEP, id="channel:ac", curve=switch)
    assert list(from_off(effect).curve.values) == pytest.approx([0.0, 0.001])
    smooth = replace(effect, curve=replace(switch, knots=np.arange(4.0), values=np.arange(4.0)))
    assert from_off(smooth) is smooth
    assert from_off(STEP) is STEP


@pytest.fixture(scope="module")
def other_cycle(record):
    return replace(record(cycle="ftp75_cold"), name="other", sha256="3")


def slowed(log, tau=0.1):
    """Return the reading that follows the recorded one with a lag."""
    reading, out = log["W_maf"], log["W_maf"].copy()
    for k in range(1, out.size):
        out[k] = reading[k] + (out[k - 1] - reading[k]) * np.exp(-(log.time[k] - log.time[k - 1]) / tau)
    return out


@pytest.fixture(scope="module")
def learned(first, other_cycle, misread, plant, config):
    """Return a lag learned on one cycle, and judged on another that takes no part."""
    prior = free_map(config.grid(), len(config.estimate.tolerance), 0.1)
    slow, unseen = (misread(log, slowed(log)) for log in (first, other_cycle))
    return refine(plant, config.grid(), prior, [slow], hold_out=[unseen]), slow, unseen


@pytest.mark.slow
def test_an_effect_learned_on_one_cycle_lowers_the_error_on_another(learned):
    found, *_ = learned
    assert found.known_effects[0].id == "maf.lag"
    unseen = found.trace.error_on_held_out_logs
    assert unseen.ratio_ci90[1] < 0.9
    assert unseen.ratio == pytest.approx(unseen.after / unseen.before)
    shown = found.trace.as_json(refined=True)
    assert [part["log"] for part in shown["logs"]] == ["first", "other"]
    assert shown["logs"][1]["effects"][0]["id"] == "maf.lag"
    assert shown["error_on_held_out_logs"]["ratio"] == unseen.ratio


@pytest.mark.slow
def test_a_refined_model_has_nothing_to_add_and_estimates_what_it_has_again(learned, plant, config):
    found, slow, _ = learned
    again = refine(
        plant,
        config.grid(),
        free_map(config.grid(), len(config.estimate.tolerance), 0.1),
        [slow],
        known=found.known_effects,
    )
    assert again.trace.verdict == "none"
    assert again.trace.findings == ()
    (kept,) = again.known_effects
    assert kept.value == pytest.approx(found.known_effects[0].value, rel=1e-3)  # the same data, the same optimum
    assert again.trace.as_json(refined=True)["known_effects"][0]["id"] == "maf.lag"


@pytest.mark.proof
def test_a_further_effect_is_added_to_those_that_stand(learned, other_cycle, misread, plant, config):
    found, *_ = learned
    prior = free_map(config.grid(), len(config.estimate.tolerance), 0.1)
    changed = misread(other_cycle, slowed(other_cycle) * np.where(other_cycle.time < 150.0, 1.0, 1.06))
    again = refine(plant, config.grid(), prior, [replace(changed, sha256="4")], known=found.known_effects)
    assert [effect.id for effect in again.known_effects] == ["maf.lag", "maf.gain"]
    assert again.known_effects[1].spans[0].begin == pytest.approx(150.0, abs=1.0)  # s; well under a block
    lag = again.known_effects[0]
    assert [span.log for span in lag.spans] == ["first", "other"]
    assert lag.standard_deviation < found.known_effects[0].standard_deviation  # two logs know more than one
    assert again.trace.error.ratio < 0.9
