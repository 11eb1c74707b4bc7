"""What healthy drives tell of a component's curve: of its shape alone, for its factor differs from day to day."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from lpvobs.discovery.curves import driven_by, shape_shown, surface_of
from lpvobs.discovery.evidence import _told, fit_candidate, in_place
from lpvobs.discovery.fit import fit, refit
from lpvobs.discovery.patterns import Seeming
from lpvobs.discovery.residual import Term
from lpvobs.discovery.sizes import slope_of


@pytest.fixture(scope="module")
def linear(laid_out, clean):
    return fit(laid_out(clean))


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


def told(linear, curve, seeming):
    """Return the share that is told of a bump of the filling over speed, found where it is."""
    slope = slope_of(linear, curve.carrier, curve.carrier.null)
    changed = with_change(linear, linear.whiten(0.05 * slope * bump(linear)))
    surface = surface_of(changed, curve)
    term = Term(driven_by(curve, surface), 0.0, curve=surface)
    judged = replace(changed, problem=replace(changed.problem, seeming=seeming))
    return _told(judged, term, 1e4, 1.0), surface


def test_the_share_told_of_a_curve_is_what_is_left_beside_its_factor(linear, curve):
    id_, carrier = curve.id, curve.carrier.id
    steady, surface = told(linear, curve, Seeming(shapes={id_: 0.0}))
    assert surface.single
    assert steady == pytest.approx(1.0)
    shaped, _ = told(linear, curve, Seeming(shapes={id_: 1.0 / linear.problem.data}))
    assert shaped == pytest.approx(0.5)
    unknown, _ = told(linear, curve, Seeming(whole={carrier: 1e3}, shapes={id_: 0.0}))
    slightly, _ = told(linear, curve, Seeming(whole={carrier: 1e-3}, shapes={id_: 0.0}))
    assert 0.02 < unknown < slightly < 1.0


def test_a_curve_of_which_healthy_drives_tell_nothing_is_told_as_before(linear, curve):
    problem = SimpleNamespace(
        clock=linear.problem.clock, seems=lambda *_: 3.0, share=None, seeming=Seeming(), model=linear.problem.model
    )
    surface = told(linear, curve, Seeming(shapes={curve.id: 0.0}))[1]
    term = Term(driven_by(curve, surface), 0.0, curve=surface)
    assert _told(SimpleNamespace(problem=problem), term, 1e4, 1.0) == pytest.approx(0.25)


def test_a_curve_in_the_model_is_told_as_it_was_without_it(linear, curve):
    """Beside itself nothing of its direction is left, and a share of that is noise of rounding."""
    surface = told(linear, curve, Seeming(shapes={curve.id: 0.0}))[1]
    seeming = Seeming(whole={curve.carrier.id: 0.01}, shapes={curve.id: 1.0 / linear.problem.data})
    judged = fit(
        replace(linear.problem, seeming=seeming), [Term(driven_by(curve, surface), 0.03, curve=surface)], passes=1
    )
    alone = fit_candidate(refit(judged, ()), judged.terms[0].effect, size=0.03, like=judged.terms[0])
    assert 0.0 < alone.told < 0.6
    assert in_place(judged, 0, alone).told == alone.told
