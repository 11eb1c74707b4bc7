"""Formulas for what has no name: their words and units, what is found, and what stays `none` or `unexplained`."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lpvobs.discovery import form_search
from lpvobs.discovery.evidence import fit_candidate
from lpvobs.discovery.fit import fit
from lpvobs.discovery.forms import Factor, Form, along_log, along_problem, in_words, parsed, rounded, without_variants
from lpvobs.discovery.known_effects import term_on
from lpvobs.discovery.map_prior import free_map
from lpvobs.discovery.ranking import rank_in
from lpvobs.discovery.refine import refine
from lpvobs.discovery.residual import Term
from lpvobs.errors import DataError

UNITS = {"W_maf": "kg/s", "T_em": "K", "n_e": "rpm", "p_im": "Pa", "p_amb": "Pa", "T_oil": "K"}
WARM = Form("W_maf", (Factor("W_maf"), Factor("T_oil", "lag", 38.0, 355.0)))

DAMP = Form("W_maf", (Factor("W_maf"), Factor("n_e"), Factor("T_em", reference=273.0)), 3e4)


@pytest.fixture
def model(plant):
    return replace(plant, units=UNITS)


def effect(form, model, size=0.0021):
    return Term(form.effect(model, np.ones(3), size), size)


@given(
    st.sampled_from(["T_em", "p_im/p_amb", "T_oil", "time"]),
    st.sampled_from([("value", 0.0), ("rate", 0.0), ("lag", 38.5), ("lag", 5.0)]),
    st.sampled_from([0.0, 355.2, -12.0, 1.2e-5, -3.456e7]),
)
def test_an_identifier_is_all_that_builds_a_form_again(signal, of, reference):
    for form in (
        Form("W_maf", (Factor("W_maf"), Factor(signal, *of, reference))),
        Form("W_maf", (Factor("W_maf"), Factor("n_e"), Factor(signal, *of, reference)), -1.25e5),
        Form("p_im", (Factor("T_oil", reference=-4.5), Factor(signal, *of, reference)), 0.03),
        Form("eta_vol.factor"),
        Form("p_amb"),
    ):
        assert parsed(form.id(UNITS)) == form


@pytest.mark.parametrize("reference", [101325.4, 273.15, 1.234567891234567e-9, -0.1 - 0.2])
def test_a_reference_is_read_back_to_the_last_digit(reference):
    """Four digits of a barometer are 50 Pa, a tenth of what it changes on a drive."""
    form = Form("W_maf", (Factor("W_maf"), Factor("p_amb", reference=reference)), 2.0 * reference)
    for units in (UNITS, {**UNITS, "p_amb": "[hPa]"}):
        assert parsed(form.id(units)) == form


@pytest.mark.parametrize(
    ("spread", "expected"), [(1e4, 101300.0), (1e3, 101330.0), (100.0, 101325.0), (10.0, 101325.4), (0.0, 101325.4321)]
)
def test_a_reference_is_as_round_as_the_drive_allows(spread, expected):
    assert float(rounded(101325.4321, 0.01 * spread)) == expected


def test_a_person_reads_it_with_its_units(model):
    assert in_words(effect(WARM, model)) == "W_maf too high by 0.0021 1/K * W_maf * (lag(T_oil, 38 s) - 355 K)"
    assert in_words(effect(Form("T_em"), model, -3.0)) == "T_em too low by 3 K"
    product = Form("W_maf", (Factor("n_e"), Factor("T_em", "rate")))
    assert effect(product, model).effect.unit == "kg/s/rpm/(K/s)"
    ratio = Form("p_im", (Factor("p_amb"), Factor("p_im/p_amb", reference=1.5)))
    assert effect(ratio, model).effect.unit == "1"
    assert effect(Form("eta_vol.factor", (Factor("T_oil"),)), model).effect.unit == "1/K"
    assert effect(DAMP, model).effect.unit == "1/rpm/K"
    words = "W_maf too high by 0.0021 1/rpm/K * W_maf * [n_e * (T_em - 273 K) - 3e+04 rpm K]"
    assert in_words(effect(DAMP, model)) == words


def test_more_costs_more():
    plain = Form("W_maf", (Factor("T_em"),))
    assert [
        form.unknowns for form in (Form("W_maf"), plain, Form("W_maf", (Factor("W_maf"), *plain.factors)), WARM, DAMP)
    ] == [1, 2, 2, 4, 5]


def test_a_lag_is_that_of_first_order():
    time = np.arange(0.0, 200.0, 0.05)
    after = Factor("T_em", "lag", 40.0).along(lambda _: np.where(time < 20.0, 300.0, 400.0), time)
    exact = np.where(time < 20.0, 300.0, 400.0 - 100.0 * np.exp(-(time - 20.0) / 40.0))
    assert np.abs(after - exact).max() < 1.5  # half a second of averaging at 100 / 40 K/s


def test_a_log_and_a_problem_of_it_see_the_same(laid_out, clean):
    problem = laid_out(clean)
    for factor in (
        Factor("T_em", "lag", 20.0),
        Factor("p_im/p_amb"),
        Factor("time", reference=10.0),
        Factor("n_e", "rate"),
    ):
        form = Form("W_maf", (factor,))
        seen, along = along_problem(form, problem), along_log(form, clean, clean.time[0] + problem.time)
        assert np.std(seen - along) < 0.05 * np.std(along)


def test_a_formula_that_holds_at_no_place_ends_no_search(laid_out, clean, monkeypatch):
    """Means may show a factor that varies too little at the places themselves; `trace` then ended with an IndexError."""
    linear = fit(laid_out(clean))
    found = rank_in(linear, linear.problem.catalogue)
    monkeypatch.setattr(form_search, "_refined", lambda _, __, form: form_search._Tried(-np.inf, form, None))
    monkeypatch.setattr(form_search._Products, "alone", lambda _, lot, form: form_search._Tried(-np.inf, form, lot))
    assert form_search.best_forms(linear, found) == []
    assert [c.id for c in form_search.beside_forms(linear, found, [])] == [c.id for c in found]


def test_a_reading_that_stands_still_is_off_by_nothing_that_moves(laid_out, clean, monkeypatch):
    """An error that moves would show in it. Ambient pressure was too low by 0.9988 * (p_ic - 1.009e5 Pa)."""
    linear, tried = fit(laid_out(clean)), set()
    monkeypatch.setattr(form_search._Products, "best", lambda _, lot, start, *most: tried.add(start.target) or [])
    monkeypatch.setattr(form_search._Products, "alone", lambda _, lot, form: form_search._Tried(-np.inf, form, lot))
    assert form_search.best_forms(linear, [fit_candidate(linear, linear.problem.model.effect("maf.gain"))]) == []
    assert tried >= {"W_maf", "p_im", "egr.area"}
    assert not tried & {"p_amb", "T_amb"}
    assert {"p_amb", "T_amb"} <= set(linear.problem.measured)


@pytest.mark.parametrize(("least", "divides"), [(1e-3, True), (1e-320, False)])
def test_what_comes_down_to_nothing_divides_no_other_channel(laid_out, clean, least, divides):
    """The vanes of a closing turbine came down to 6e-323 %, and the products of the search overflowed."""
    problem = laid_out(clean)
    vanes = np.geomspace(50.0, least, problem.K)
    problem = replace(
        problem,
        auxiliary={"vanes": vanes, "valve": 50.0 + np.sin(problem.time)},
        model=replace(problem.model, units={**UNITS, "vanes": "%", "valve": "%"}),
    )
    library = form_search._library(problem)
    assert ("valve/vanes" in library.names) == divides
    assert np.isfinite(library.shapes**2).all()


def test_a_log_without_the_channel_is_refused(clean):
    with pytest.raises(DataError, match="drive: channel 'T_oil' is missing"):
        along_log(WARM, clean, clean.time)


@pytest.mark.proof
def test_a_housing_that_warms_up_is_found_as_a_formula_and_taken_out(plant, config, clean, misread):
    seconds, tau = 0.01, 40.0
    warm = np.empty(clean.time.size)
    state = clean["T_em"][0]
    for k, T in enumerate(clean["T_em"]):  # forward Euler: the step is a four-thousandth of the time constant
        warm[k] = state
        state += seconds / tau * (T - state)
    log = misread(clean, clean["W_maf"] * (1.0 + 6e-4 * (warm - 700.0)))
    prior = free_map(config.grid(), len(config.estimate.tolerance), 0.1)
    found = refine(replace(plant, units=UNITS), config.grid(), prior, [log])
    (finding,) = found.trace.findings
    form = parsed(finding.id)
    assert form.relative
    assert [(f.signal, f.of) for f in form.factors[1:]] == [("T_em", "lag")]
    assert form.factors[1].tau == pytest.approx(tau, rel=0.15)
    at_reference = 1.0 + 6e-4 * (form.factors[1].reference - 700.0)  # what is constant belongs to the map
    assert finding.parameters["coefficient"].value == pytest.approx(6e-4 / at_reference, rel=0.03)
    assert finding.formula.startswith("W_maf too high by 0.000")
    assert found.trace.error.ratio < 0.9
    again = term_on(found.known_effects[0], found.before.problem, [log])
    assert np.allclose(
        again.effect.apply(found.before.problem.signals, 1e-3)["W_maf"],
        found.terms[0].effect.apply(found.before.problem.signals, 1e-3)["W_maf"],
        rtol=5e-3,  # a lag begins at the first sample, in a problem at the first window
    )


def test_a_product_with_what_hardly_moves_is_no_rival_of_the_plainer_form():
    """Six forms were tried of a reading that follows the shaft's speed, five of them p_im times something else."""

    def tried(score, *signals):
        return form_search._Tried(score, Form("W_maf", tuple(Factor(name) for name in signals)), None)

    plain, worse, other, better = (
        tried(50.0, "p_im"), tried(49.0, "p_im", "T_amb"), tried(40.0, "omega_t", "omega_t"), tried(60.0, "p_im", "n_e"),
    )  # fmt: skip
    assert form_search._plainest([worse, other, plain]) == [plain, other]
    assert form_search._plainest([plain, better]) == [better, plain]
    share, constant = tried(49.0, "W_maf", "p_im"), tried(70.0)
    assert form_search._plainest([plain, share, constant]) == [
        constant,
        plain,
        share,
    ]  # of the reading, or for all of it


def test_of_formulas_that_explain_as_much_one_is_listed_for_each_signal():
    """Three variants of the shaft's speed made a set of five of what two signals may be."""
    ids = [
        "form:W_maf ~ W_maf * (p_im - 1.133e+05 Pa)",
        "form:W_maf ~ W_maf * T_em * (omega_t - 7133 rad/s)",
        "maf.drift",
        "form:W_maf ~ W_maf * omega_t * (omega_t - 6527 rad/s)",
        "form:W_maf ~ W_maf * (omega_t - 6368 rad/s)",
        "form:W_maf ~ p_im * (p_im - 1.153e+05 Pa)",
        "form:W_maf ~ W_maf * (W_maf - 0.02615 kg/s)",
        "form:p_em ~ 1",
        "form:p_em ~ p_em * (n_e - 2000 rpm)",
        "form:T_em ~ T_em * (n_e - 2000 rpm)",  # another sensor
    ]
    assert without_variants(ids) == [ids[0], ids[2], ids[3], *ids[6:]]
