"""Standard errors of sizes: clusters that share an error count once, pinned constants are as unknown as before."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.stats

from lpvobs.discovery.fit import between_windows, fit, spread_of_sums, standard_errors, widened
from lpvobs.discovery.linear import Term
from lpvobs.discovery.normal import pins
from lpvobs.discovery.thresholds import RESPONSE


def test_the_spread_of_sums_is_the_variance_of_what_is_independent():
    rng = np.random.default_rng(3)
    group = np.repeat(np.arange(200), 50)
    alone = rng.standard_normal(group.size)
    # 200 groups: the spread is known to a tenth (chi2), three of which are allowed
    assert spread_of_sums(alone, group) == pytest.approx(group.size, rel=0.3)
    shared = np.repeat(rng.standard_normal(200), 50)
    assert spread_of_sums(shared, group) == pytest.approx(50 * group.size, rel=0.3)


@pytest.fixture(scope="module")
def stepped(laid_out, clean, misread, plant):
    """Return the model of a drive whose sensor reads 5 % too much in its second half."""
    effect = next(e for e in plant.catalogue if e.id == "maf.gain")
    log = misread(clean, clean["W_maf"] * np.where(clean.time < 150.0, 1.0, 1.05))
    return fit(laid_out(log).with_all(), [Term(effect, 1.05, 150.0)])


def test_the_interval_holds_a_known_size(stepped):
    (error,) = standard_errors(stepped)
    assert abs(stepped.terms[0].size - 1.05) < 3.0 * error  # one log: three standard errors
    assert error < 0.01


def test_the_choice_of_window_is_part_of_it(stepped):
    (moved,) = between_windows(stepped)
    assert moved != 0.0
    assert standard_errors(stepped)[0] >= np.sqrt(0.5) * abs(moved)


@pytest.mark.parametrize(
    ("told", "added"),
    [*((how, np.sqrt(0.25**2 - RESPONSE**2)) for how in ("by its logs", "by healthy drives")), ("not", 0.0)],
)
def test_a_response_that_nothing_shows_is_part_of_it_where_the_engine_is_not_its_model(
    stepped, monkeypatch, told, added
):
    (term,), problem = stepped.terms, stepped.problem
    if told == "by its logs":
        problem = replace(problem, model=replace(problem.model, healthy=object()))
    elif told == "by healthy drives":
        monkeypatch.setattr(type(problem.patterns), "__len__", lambda _: 1)
        monkeypatch.setattr("lpvobs.discovery.fit.between_windows", lambda _: np.zeros(1))
        monkeypatch.setattr("lpvobs.discovery.fit._variance", lambda *_: 1e-8)
    known, unknown = (
        float(standard_errors(replace(stepped, problem=problem, terms=(each,)))[0])
        for each in (term, replace(term, effect=replace(term.effect, unlearned=0.25)))
    )
    # the quantile differs a little
    assert np.sqrt(unknown**2 - known**2) == pytest.approx(added * (term.size - 1.0), rel=0.05)


def test_a_pinned_constant_is_not_a_known_one(stepped):
    constants = np.arange(stepped.beta.size + 1) < stepped.beta.size  # all but the effect's size
    pinned = replace(stepped, pinned=constants)
    held = replace(pinned, normal=pinned.normal + np.diag(pins(pinned)))
    # a twentieth: the steps through the wider window stop where the next one would gain less than a unit of noise
    assert standard_errors(held) == pytest.approx(standard_errors(stepped), rel=0.05)


def test_one_difference_says_little_of_a_variance():
    one, none = np.ones(1), np.zeros(1)
    normal = scipy.stats.norm.ppf(0.95)
    # textbook quantiles: t(0.95) is 1.6973 at 30 degrees of freedom, 6.3138 at one, 2.0150 at five
    assert np.sqrt(widened(one, 30.0, none))[0] * normal == pytest.approx(1.6973, abs=1e-4)
    assert np.sqrt(widened(none, 30.0, one))[0] * normal == pytest.approx(6.3138, abs=1e-4)
    # five degrees of freedom: (4 + 1)^2 over 4^2 / 4 + 1^2
    assert np.sqrt(widened(4.0 * one, 4.0, one) / 5.0)[0] * normal == pytest.approx(2.0150, abs=1e-4)
