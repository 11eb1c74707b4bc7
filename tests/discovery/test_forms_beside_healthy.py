"""What healthy drives tell of a sensor's error that follows a channel: of its shape alone, for its mean differs from day to day."""

from dataclasses import replace

import numpy as np
import pytest

from lpvobs.discovery.curves import along_channel
from lpvobs.discovery.fit import fit
from lpvobs.discovery.form_search import _along_pools, _effect, _library, _lot, _refined, shapes_shown
from lpvobs.discovery.forms import Factor, Form, along_problem, shape_of
from lpvobs.discovery.inside import _inside_form
from lpvobs.discovery.map_prior import MapPrior
from lpvobs.discovery.patterns import Seeming
from lpvobs.discovery.residual import Term, lay_out
from lpvobs.discovery.sizes import slope_of
from lpvobs.discovery.thresholds import FORM_CLEAR
from lpvobs.discovery.variation import told_of

SHARE = Factor("W_maf")
WARM = Factor("T_im", reference=310.0)


@pytest.fixture(scope="module")
def linear(plant, config, clean):
    """A drive beside a map that stands, as healthy drives are judged."""
    p = config.grid().size
    prior = MapPrior(np.zeros(p), np.eye(p) / 0.0005**2, np.zeros((p, len(config.estimate.tolerance))), False)
    return fit(lay_out(plant, config.grid(), prior, [clean]))


@pytest.fixture(scope="module")
def gain(plant):
    return plant.effect("maf.gain")


def with_change(linear, change):
    """Return the model with a further change of the residual, whitened."""
    step = linear.project(linear.products(change))
    return replace(linear, residual=linear.residual + change, newton_step=linear.newton_step + step)


def off(linear, gain, along):
    return with_change(linear, linear.whiten(slope_of(linear, gain, gain.null) * along))


@pytest.fixture(scope="module")
def still(linear):
    return replace(linear, residual=0.0 * linear.residual, newton_step=0.0 * linear.newton_step)


def test_an_error_that_follows_a_channel_shows_as_that_shape(linear, still, gain):
    _, name = shape_of(gain, Factor("n_e"))
    speed = linear.problem.along("n_e")
    level, follows = (shapes_shown(off(still, gain, along), -np.inf) for along in (0.05, 1e-4 * (speed - speed.mean())))
    shown = {each: abs(z) for each, ((z, _),) in follows.items() if each.startswith(gain.id)}
    assert shown[name] > 10.0
    assert shown[name] > 0.8 * max(shown.values())  # a short lag of the speed is nearly the speed
    assert abs(level[name][0][0]) < 0.05 * shown[name]  # means over pools


def test_noise_alone_shows_each_shape_as_often_as_its_information(linear, still):
    rng, squares = np.random.default_rng(1), []
    for _ in range(40):
        noise = np.stack([rng.standard_normal(linear.mapped.shape) * (linear.mapped != 0.0)] * 2) * [[[1.0]], [[0.0]]]
        squares.append([z**2 for ((z, _),) in shapes_shown(with_change(still, noise), -np.inf).values()])
    assert np.mean(squares) == pytest.approx(1.0, abs=0.4)  # 40 draws of shapes that are alike


def told(linear, term, **seeming):
    judged = replace(linear, problem=replace(linear.problem, seeming=Seeming(**seeming)))
    return told_of(judged, term, 1e4, 1.0)


@pytest.fixture(scope="module")
def warm(linear):
    return _effect(form := Form("W_maf", (SHARE, WARM)), linear.problem, along_problem(form, linear.problem))


def test_a_form_is_known_as_the_gain_and_its_shape_beside_it(linear, gain, warm):
    assert warm.known_as == (gain.id, f"{gain.id} ~ T_im")
    lagged = Form("W_maf", (SHARE, Factor("T_im", "lag", 49.5, 310.0)))
    assert _effect(lagged, linear.problem, np.ones(linear.problem.K)).known_as[1] == f"{gain.id} ~ lag(T_im, 40 s)"
    once = dict.fromkeys(warm.known_as, 1.0 / linear.problem.data)  # they vary at most as much as noise does
    changed = off(linear, gain, 1e-2 * (linear.problem.along("T_im") - 310.0))
    assert told(changed, Term(warm, 0.01), whole={gain.id: 1e3}, effects=once) == pytest.approx(0.5)
    assert told(changed, Term(warm, 0.01), whole={gain.id: 1e3}, effects={**once, gain.id: 1e9}) < 0.5


def test_a_channels_curve_is_known_in_the_same_way(gain):
    curve = type("Curve", (), {"channel": "humidity", "of": "rate"})()
    assert along_channel(curve, gain, np.ones(3)).known_as == (gain.id, f"{gain.id} ~ d(humidity)/dt")


def test_a_form_that_healthy_drives_do_not_show_is_known_by_its_place(linear, warm):
    of_two = _effect(Form("W_maf", (SHARE, WARM, Factor("n_e"))), linear.problem, np.ones(linear.problem.K))
    assert of_two.known_as == ()
    for effect in (warm, of_two):
        assert told(linear, Term(effect, 0.01), places={"sensor": 3.0 / linear.problem.data}) == pytest.approx(0.25)


@pytest.mark.parametrize(
    ("slow", "about", "less"),
    [
        ("n_e", 273.0, 0.0),
        ("n_e", 273.0, 1.6e5),
        ("p_em", 290.0, 6e6),
    ],
)
def test_a_product_may_have_a_reference_of_its_own(plant, linear, still, slow, about, less):
    """Damp and warm air, W_maf * [humidity * (T_amb - 269 K) - 1083 % K], was `unexplained`: a sum of two followed either."""
    true = Form("W_maf", (SHARE, Factor(slow), Factor("T_im", reference=about)), less)
    along = along_problem(true, linear.problem)
    library = _library(linear.problem)
    reading = along_problem(Form("", (SHARE,)), linear.problem)  # a form's factors are means over a second
    changed = off(still, plant.effect("maf.offset"), 0.05 * reading * along / along.std())
    lot = _lot(changed, Form("W_maf"), library.first)
    start = Form("W_maf", (SHARE, Factor(slow)))
    bases = np.stack(
        [_along_pools(Form("", each), linear.problem, library.first) for each in (start.factors, (SHARE,))]
    )
    (found,) = library.best(lot, start, 1)
    assert found.form.factors[2].signal == "T_im"
    form = _refined(changed, library, found.form).form  # at every place, where the first search takes means
    assert form.factors[2].reference == pytest.approx(about, abs=1.0)
    assert form.reference == pytest.approx(less, abs=0.03 * np.ptp(along))
    of_one, of_two = (gain[library.factors.index(Factor("T_im"))] for gain, _ in lot.gains(bases, library.shapes)[1])
    assert (of_two > of_one + FORM_CLEAR) == (less > 0.0)


def test_what_healthy_drives_show_of_a_channel_does_not_depend_on_its_zero(linear, still, gain):
    """An ambient temperature in kelvin hardly changes, measured by its own size: no error seemed to follow it."""
    speed = linear.problem.along("n_e")
    seen = []
    for zero in (0.0, 100.0):
        slow = (speed - speed.mean()) / speed.std()
        changed = off(
            replace(still, problem=replace(linear.problem, auxiliary={"slow": zero + slow})), gain, 1e-2 * slow
        )
        seen.append(shapes_shown(changed, -np.inf)[f"{gain.id} ~ slow"][0][0])
    assert seen[0] == pytest.approx(seen[1])


def test_what_a_form_has_inside_is_told_by_the_residual(linear, gain):
    """Value, unit and derivative of each number inside, against the gain of the sensor that a change of it amounts to."""
    model = replace(linear.problem.model, units={"T_im": "K", "p_em": "Pa"})
    problem = replace(linear.problem, model=model)
    form = Form("W_maf", (SHARE, Factor("p_em", reference=1e5), Factor("T_im", "lag", 20.0, 310.0)), 2e5)
    effect = _effect(form, problem, along_problem(form, problem))
    fitted = fit(problem, [Term(effect, 1e-8)])
    found, size = _inside_form(fitted, 0), fitted.terms[0].size
    assert {name: (value, unit) for name, (value, unit, _) in found.items()} == {
        "reference": (310.0, "K"),
        "tau": (20.0, "s"),
        "product_reference": (2e5, "Pa K"),
    }
    slope = slope_of(linear, gain, gain.null)
    pressure = along_problem(Form("", form.factors[1:2]), problem)
    for name, share in (("reference", -size * pressure), ("product_reference", -size * np.ones(problem.K))):
        column, expected = found[name][2], fitted.whiten(slope * share)
        assert np.linalg.norm(column - expected) < 0.1 * np.linalg.norm(expected)  # the reading is one of its noise
