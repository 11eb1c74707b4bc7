"""What healthy drives tell of a component's curve: of its shape alone, for its factor differs from day to day."""

from dataclasses import replace

import numpy as np
import pytest

from lpvobs.discovery.curves import driven_by, shape_shown, surface_of
from lpvobs.discovery.evidence import fit_candidate, in_place
from lpvobs.discovery.fit import fit, refit
from lpvobs.discovery.healthy_learning import beyond_noise
from lpvobs.discovery.map_prior import MapPrior
from lpvobs.discovery.patterns import Seeming
from lpvobs.discovery.ranking import chance
from lpvobs.discovery.residual import Term, lay_out
from lpvobs.discovery.sizes import slope_of
from lpvobs.discovery.variation import told_of


@pytest.fixture(scope="module")
def linear(plant, config, clean):
    """A drive beside a map that stands, as healthy drives are judged."""
    p = config.grid().size
    prior = MapPrior(np.zeros(p), np.eye(p) / 0.0005**2, np.zeros((p, len(config.estimate.tolerance))), False)
    return fit(lay_out(plant, config.grid(), prior, [clean]))


def with_change(linear, change):
    """Return the model with a further change of the residual, whitened."""
    step = linear.project(linear.products(change))
    return replace(linear, residual=linear.residual + change, newton_step=linear.newton_step + step)


@pytest.fixture(scope="module")
def curve(linear):
    return linear.problem.model.curve("eta_vol.curve")


def bump(linear):
    speed = linear.problem.along("n_e")
    return np.exp(-0.5 * ((speed - np.median(speed)) / 300.0) ** 2)


def test_a_curve_that_is_the_same_everywhere_shows_no_shape(linear, curve):
    slope = slope_of(linear, curve.carrier, curve.carrier.null)
    before = shape_shown(linear, curve, -np.inf)
    level, shape = (
        shape_shown(with_change(linear, linear.whiten(0.05 * slope * along)), curve, -np.inf)
        for along in (1.0, bump(linear))
    )
    assert level[0] == pytest.approx(before[0], rel=1e-3)
    assert shape[0] > 3.0 * before[0]
    assert level[1] == pytest.approx(before[1])  # information does not depend on what is left


def test_noise_alone_shows_as_much_shape_as_its_information(linear, curve):
    rng, found = np.random.default_rng(1), []
    still = replace(linear, residual=0.0 * linear.residual, newton_step=0.0 * linear.newton_step)
    for _ in range(60):
        noise = np.stack([rng.standard_normal(linear.mapped.shape) * (linear.mapped != 0.0)] * 2) * [[[1.0]], [[0.0]]]
        gradient, information = shape_shown(with_change(still, noise), curve, -np.inf)
        found.append(gradient**2 / information)
    assert np.mean(found) == pytest.approx(1.0, abs=0.5)  # a few shapes, 60 draws; information is that of both views


def test_a_drive_without_the_component_shows_no_shape(linear, curve):
    hardly = replace(linear.problem, clock=linear.problem.clock - linear.problem.clock[-1] - 1.0)
    assert shape_shown(replace(linear, problem=hardly), curve, 0.0) == (0.0, 0.0)
    assert beyond_noise(np.zeros((3, 2)), np.array([[0.0, 0.0]] * 3))[1].tolist() == [0.0, 0.0]
    some, all_tell = (
        beyond_noise(np.full((n, 1), 2.0), np.ones((n, 1)) * on)[1] for n, on in ((4, [[1], [1], [0], [0]]), (2, 1))
    )
    assert some == pytest.approx(all_tell)


@pytest.fixture(scope="module")
def surface(linear, curve):
    slope = slope_of(linear, curve.carrier, curve.carrier.null)
    found = surface_of(with_change(linear, linear.whiten(0.05 * slope * bump(linear))), curve)
    assert found.single
    return found


def told(linear, curve, surface, seeming, level=0.0, height=0.05):
    """Return the share that is told of a curve, where the filling is off by a bump over speed and by a level."""
    slope = slope_of(linear, curve.carrier, curve.carrier.null)
    changed = with_change(linear, linear.whiten(slope * (height * bump(linear) + level)))
    judged = replace(changed, problem=replace(changed.problem, seeming=seeming))
    return told_of(judged, Term(driven_by(curve, surface), 0.0, curve=surface), 1e4, 1.0)


def test_the_share_told_of_a_curve_is_what_is_left_beside_its_factor_and_shape(linear, curve, surface):
    id_, carrier, much = curve.id, curve.carrier.id, {curve.carrier.id: 1e9, curve.id: 0.0}
    assert told(linear, curve, surface, Seeming(whole={carrier: 0.0}, effects=much)) == pytest.approx(1.0)
    once = dict.fromkeys([carrier, id_], 1.0 / linear.problem.data)  # they vary at most as much as noise does
    assert told(linear, curve, surface, Seeming(whole={carrier: 1e3}, effects=once)) == pytest.approx(0.5)
    assert 0.5 < told(linear, curve, surface, Seeming(whole={carrier: 0.0}, effects=once)) < 1.0  # the shape alone
    beside = [told(linear, curve, surface, Seeming(whole={carrier: x}, effects=much)) for x in (1e-3, 1e3)]
    assert 0.02 < beside[1] < beside[0] < 1.0


def test_a_factor_that_varies_by_day_is_no_evidence_of_a_curve(linear, curve, surface):
    """The gain of the curve once kept what the factor explains, and only its information lost that: a false name."""
    still = replace(linear, residual=0.0 * linear.residual, newton_step=0.0 * linear.newton_step)
    deviation, id_, carrier = 0.05, curve.id, curve.carrier.id
    seeming = Seeming(whole={carrier: deviation}, effects={carrier: 1e9, id_: 0.0})
    effect, slope = driven_by(curve, surface), slope_of(still, curve.carrier, curve.carrier.null)
    rng, found = np.random.default_rng(1), []
    for _ in range(60):
        noise = np.stack([rng.standard_normal(linear.mapped.shape) * (linear.mapped != 0.0)] * 2) * [[[1.0]], [[0.0]]]
        day = with_change(still, noise + linear.whiten(deviation * rng.standard_normal() * slope))
        judged = replace(day, problem=replace(day.problem, seeming=seeming))
        each = fit_candidate(judged, effect, like=Term(effect, 0.0, curve=surface))
        found.append((2.0 * each.gain, 2.0 * each.told * each.gain))
    gained, left = np.mean(found, axis=0)
    assert gained > 5.0  # the day's factor looks like the curve
    assert left == pytest.approx(1.0, abs=0.5)  # 60 draws of chi-square with one degree of freedom


def test_a_curve_pays_its_price_from_what_is_told_of_it(linear, curve, surface):
    seeming = Seeming(effects={curve.carrier.id: 0.0, curve.id: 1.0 / linear.problem.data}, degrees=12.0, drives=6)
    problem, effect = replace(linear.problem, seeming=seeming), driven_by(curve, surface)
    each = fit_candidate(linear, effect, like=Term(effect, 0.0, curve=surface))
    paid = replace(each, told=0.5, gain=100.0 - surface.cost, unevenness=1.0)
    plain = replace(paid, term=Term(curve.carrier, 1.0), gain=100.0 - 2.0 * surface.cost)
    assert chance(paid, problem) == pytest.approx(chance(plain, problem))  # half of 100 less the cost, either way


def test_a_curve_of_which_healthy_drives_tell_nothing_is_known_by_its_place(linear, curve, surface):
    data = linear.problem.data
    alone = Seeming(effects={curve.carrier.id: 1.0 / data}, places={curve.carrier.place: 3.0 / data})
    assert told(linear, curve, surface, alone) == pytest.approx(0.25)


def test_a_curve_in_the_model_is_told_as_it_was_without_it(linear, curve, surface):
    """Beside itself nothing of its direction is left, and a share of that is noise of rounding."""
    id_, carrier = curve.id, curve.carrier.id
    seeming = Seeming(whole={carrier: 0.01}, effects={carrier: 1e9, id_: 1.0 / linear.problem.data})
    judged = fit(
        replace(linear.problem, seeming=seeming), [Term(driven_by(curve, surface), 0.03, curve=surface)], passes=1
    )
    alone = fit_candidate(refit(judged, ()), judged.terms[0].effect, size=0.03, like=judged.terms[0])
    assert 0.0 < alone.told < 0.6
    assert in_place(judged, 0, alone).told == alone.told


def test_a_curve_over_two_inputs_is_known_by_what_acts_in_its_place(linear, curve, surface):
    """At nodes where a drive hardly was, neither a factor's size nor the shape over one input tells how far it varies."""
    known = Seeming(
        whole={curve.carrier.id: 1e-9},
        effects={curve.carrier.id: 1e9, curve.id: 0.0},
        places={curve.carrier.place: 3.0 / linear.problem.data},
    )
    plane = replace(surface, single=False)
    assert told(linear, curve, surface, known) == pytest.approx(1.0, rel=0.01)
    assert told(linear, curve, plane, known) == pytest.approx(0.25)
