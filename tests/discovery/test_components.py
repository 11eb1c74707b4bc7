"""Curves of the engine's components: found where an engine breathes otherwise than its model, quiet where it does not."""

from dataclasses import replace

import numpy as np
import pytest

from lpvobs.discovery.courses import FactorSurface
from lpvobs.discovery.curves import curve_in_place_of, driven_by, surface_of
from lpvobs.discovery.evidence import fit_candidate, score
from lpvobs.discovery.fit import fit
from lpvobs.discovery.known_effects import term_on
from lpvobs.discovery.map_prior import free_map
from lpvobs.discovery.refine import refine
from lpvobs.discovery.residual import lay_out
from lpvobs.discovery.thresholds import TIE
from lpvobs.engines.diesel.effects import LACKS
from lpvobs.report.residual_figures import component_curve
from lpvobs.report.spoken import in_words

BUMP = 0.05
CYLINDERS = list(LACKS).index("eta_vol")


def bump(n_e):
    return BUMP * np.exp(-0.5 * ((n_e - 2000.0) / 350.0) ** 2)


def even(n_e):
    return np.full(n_e.shape, BUMP)


def breathing(plant, lacking):
    """Return a model that lacks a factor of its cylinders: on its own plant's logs they take that much more."""

    def imbalances(constants, s, blocks):
        lacks = s.lacks.copy()
        lacks[CYLINDERS] /= 1.0 + lacking(s["n_e"])
        return plant.imbalances(constants, replace(s, lacks=lacks), blocks)

    return replace(plant, imbalances=imbalances)


@pytest.fixture(scope="module")
def wrong(plant):
    return breathing(plant, bump)


@pytest.fixture(scope="module")
def found(wrong, config, clean):
    return refine(wrong, config.grid(), free_map(config.grid(), len(wrong.names), 0.1), [clean])


@pytest.mark.slow
def test_cylinders_that_take_more_around_a_speed_are_a_curve(found):
    (finding,) = found.trace.findings
    assert finding.id == "eta_vol.curve"
    low, high = finding.parameters["amplitude"].ci90
    assert low < BUMP < high
    assert finding.surface.largest_at[0] == pytest.approx(2000.0, abs=200.0)  # rpm; a distance of nodes
    assert found.trace.error.ratio_ci90[1] < 1.0


@pytest.mark.slow
@pytest.mark.parametrize(("lacking", "curve"), [(bump, True), (even, False)])
def test_a_component_is_a_curve_only_where_the_data_ask_for_one(plant, config, clean, lacking, curve):
    grid = config.grid()
    linear = fit(lay_out(breathing(plant, lacking), grid, free_map(grid, len(plant.names), 0.1), [clean]))
    own = fit_candidate(linear, plant.effect("eta_vol.factor"))
    other = curve_in_place_of(linear, own.term)
    assert (other is not None and score(other) > score(own) + TIE) == curve


@pytest.mark.slow
def test_the_curve_is_that_of_the_engine(found, clean):
    (finding,) = found.trace.findings
    own = finding.surface
    factor = np.array(own.factor) - 1.0
    first, second = (np.array(knots) for knots in own.knots)
    row = int(np.abs(second - own.largest_at[1]).argmin())
    along = np.interp(clean["n_e"], first, factor[:, row])
    error = np.sqrt(np.mean((along - bump(clean["n_e"])) ** 2))
    assert error < 0.25 * BUMP  # the requirement


@pytest.mark.proof
def test_a_curve_that_begins_is_dated(plant, config, clean):
    """Half of the drive is as the model says: a curve of the whole drive would have half of the amplitude."""
    onset = 150.0

    def imbalances(constants, s, blocks):
        lacks = s.lacks.copy()
        time = s.time[: s["n_e"].size]  # once for both views, or for their mean
        lacks[CYLINDERS] /= 1.0 + bump(s["n_e"]) * (time >= onset)
        return plant.imbalances(constants, replace(s, lacks=lacks), blocks)

    later = replace(plant, imbalances=imbalances)
    found = refine(later, config.grid(), free_map(config.grid(), len(plant.names), 0.1), [clean])
    (finding,) = found.trace.findings
    assert (finding.id, finding.course) == ("eta_vol.curve", "step")
    assert finding.onset == pytest.approx(onset, abs=2.0)  # s; a stretch of the search is longer
    assert finding.parameters["amplitude"].value == pytest.approx(BUMP, rel=0.25)  # the requirement of its curve


@pytest.mark.slow
def test_words_say_how_much_and_where(found):
    said = in_words(found.trace.as_json(refined=True)["effects"])
    assert said.startswith("eta_vol is 5")
    assert "around n_e = 2" in said


@pytest.mark.slow
def test_the_report_draws_the_curve_with_its_band(found):
    (effect,) = found.trace.as_json(refined=True)["effects"]
    drawn = component_curve("curve", "the curve", effect["surface"])
    assert drawn.startswith("<svg")
    assert "deviation from the model" in drawn


@pytest.mark.slow
def test_the_stored_effect_is_the_found_one(found, wrong, clean):
    """A term made from what is stored corrects the signals as the accepted one does."""
    (known,), problem = found.known_effects, found.after.problem
    term = term_on(known, problem, [clean])
    own = found.terms[0].effect.apply(problem.signals, found.terms[0].size)
    np.testing.assert_allclose(term.effect.apply(problem.signals, known.value).lacks, own.lacks)


def test_a_clean_log_pays_for_no_curve(linear, plant):
    assert all(surface_of(linear, curve) is None for curve in plant.curves)


def test_a_curve_without_its_channels_is_no_candidate(linear, plant):
    signals = linear.problem.signals
    curve = plant.curves[0]
    blind = replace(curve, carrier=replace(curve.carrier, needs=("boost",)))
    assert surface_of(linear, blind) is None
    assert driven_by(curve, _flat(curve)).apply(signals, 0.1).lacks[CYLINDERS] == pytest.approx(1.1)


def _flat(curve):
    first, second = (axis.values for axis in curve.axes.values())
    ones = np.ones((first.size, second.size))
    names, units = tuple(curve.axes), tuple(axis.unit for axis in curve.axes.values())
    return FactorSurface(names, units, first, second, ones, ones, (0.0, 0.0), 0.1, 0.0, True)
