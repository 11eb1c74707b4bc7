"""Effects inside the engine: flows against the observer's model of a sound one, balances, what pressures and turbine make of it."""

from math import sqrt

import numpy as np
import pytest

from lpvobs.engines.diesel.lpv import INPUTS, Diesel, along
from lpvobs.simulation.effects import CATALOGUE, CatalogueEffect
from lpvobs.simulation.plant import Condition, egr_flow, intake_leak, plant_of, turbine_flow

RATE = 1000  # Hz, a sample at every step of the integrator


@pytest.fixture(scope="module")
def sound(config):
    """Return a function from truth to the flows of a sound engine in the same state, by the observer's own transcription."""

    def flows(truth):
        rho, E = along(Diesel(config.engine).constants, tuple(truth[name] for name in INPUTS))
        return {
            "W_c": rho[:, 0] * truth["omega_t"],
            "W_egr": rho[:, 1] * truth["p_em"],
            "W_ei": rho[:, 2] * truth["p_im"],
            "rho": rho,
            "E": E,
        }

    return flows


@pytest.fixture(scope="module")
def plant(config):
    return plant_of(config.engine, config.simulation)


# --- the catalogue's factors ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("identifier", "flow", "factor"),
    [("egr.area", "W_egr", 0.7), ("eta_vol.factor", "W_ei", 0.94), ("compressor.flow", "W_c", 0.95)],
)
def test_a_factor_multiplies_its_own_flow_at_every_state(inject, sound, identifier, flow, factor):
    truth = inject(CatalogueEffect(identifier, factor)).truth
    for name, wanted in sound(truth).items():
        if name in truth:
            size = factor if name == flow else 1.0
            # a dozen roundings of numbers up to a tenth of a kilogram per second
            np.testing.assert_allclose(truth[name], size * wanted, rtol=1e-11, atol=1e-13, err_msg=name)


def test_a_turbine_of_less_efficiency_gives_that_much_less_power(inject, sound):
    """The turbocharger's acceleration by central differences, against rho_5 and the turbine's share of E."""
    truth = inject(CatalogueEffect("turbine.efficiency", 0.8)).truth
    model, h, inside = sound(truth), 0.01, slice(1, -1)
    found = (truth["omega_t"][2:] - truth["omega_t"][:-2]) / (2.0 * h)
    braking, driving = (model["rho"][:, 4] * truth["omega_t"])[inside], model["E"][inside, 2]
    factor = np.sum((found + braking) * driving) / np.sum(driving**2)
    # curvature of the course between samples 10 ms apart
    assert factor == pytest.approx(0.8, abs=0.005)


def test_less_efficient_turbines_give_less_boost(inject, truth):
    worse = inject(CatalogueEffect("turbine.efficiency", 0.8)).truth
    boost = truth["p_im"] > 1.5e5
    assert worse["omega_t"][boost].mean() < 0.98 * truth["omega_t"][boost].mean()
    assert worse["p_im"][boost].mean() < 0.98 * truth["p_im"][boost].mean()


@pytest.mark.parametrize("factor", [0.2, 1.0001, 2.0, 4.0, 10.0, 20.0])
@pytest.mark.parametrize("p_em", [9.9e4, 1.1e5, 1.5e5, 3e5])
@pytest.mark.parametrize("u_vgt", [30.0, 60.0, 100.0])
def test_a_restriction_backs_up_what_flows_through_it(plant, factor, p_em, u_vgt):
    """Outlet pressure and flow have to belong to each other: p_es = p_amb + f k W_t^2, W_t through the vanes at p_es / p_em."""
    c, T_em, p_amb = plant.engine, 800.0, 9.8e4
    W_t, Pi_t = turbine_flow(plant._replace(condition=Condition(exhaust_restriction=factor)), p_em, u_vgt, T_em, p_amb)
    width = max(c.f_vgt_min, c.c_f2 + c.c_f1 * sqrt(max(0.0, 1.0 - ((u_vgt - c.c_vgt2) / c.c_vgt1) ** 2)))
    vanes = c.A_vgt_max * width * p_em / sqrt(T_em * c.R_e) * sqrt(1.0 - Pi_t**c.K_t)
    assert vanes == pytest.approx(W_t, rel=1e-9)
    assert Pi_t * p_em == pytest.approx(p_amb + factor * c.k_exhaust * W_t**2, rel=1e-9)


def test_a_hair_of_restriction_is_no_restriction(plant):
    """Three fixed-point passes for the clean exhaust, a solution for the restricted: apart by what the passes leave."""
    hair = plant._replace(condition=Condition(exhaust_restriction=1.0 + 1e-9))
    for p_em in (1.1e5, 1.5e5, 3e5):
        args = (p_em, 60.0, 800.0, 9.8e4)
        assert turbine_flow(hair, *args)[0] == pytest.approx(turbine_flow(plant, *args)[0], rel=2e-3)


def test_a_loaded_filter_raises_the_exhaust_pressure_and_costs_air(inject, truth):
    loaded = inject(CatalogueEffect("exhaust.restriction", 6.0)).truth
    much = truth["W_c"] > 0.07
    assert loaded["p_em"][much].mean() > 1.03 * truth["p_em"][much].mean()
    assert loaded["W_c"][much].mean() < 0.99 * truth["W_c"][much].mean()


# --- holes ------------------------------------------------------------------------------------------------------------------


def saint_venant(area, p_up, p_down, T_up, R, gamma):
    """Return the flow through a hole: two branches, as textbooks write it."""
    ratio = p_down / p_up
    if ratio <= (2.0 / (gamma + 1.0)) ** (gamma / (gamma - 1.0)):
        choked = (2.0 / (gamma + 1.0)) ** ((gamma + 1.0) / (2.0 * (gamma - 1.0)))
        return area * p_up * sqrt(gamma / (R * T_up)) * choked
    speed = sqrt(2.0 * gamma / (gamma - 1.0) * R * T_up * (1.0 - ratio ** ((gamma - 1.0) / gamma)))
    return area * p_up / (R * T_up) * ratio ** (1.0 / gamma) * speed


@pytest.mark.parametrize("p_im", [0.4e5, 0.8e5, 0.98e5, 1.2e5, 1.8e5, 2.6e5])
def test_a_hole_in_the_manifold_obeys_saint_venant_both_ways(plant, p_im):
    holed = plant._replace(condition=Condition(leak_intake=2e-5))
    found, c = intake_leak(holed, p_im, 330.0, 9.8e4, 298.0), plant.engine
    if p_im > 9.8e4:
        wanted = saint_venant(2e-5, p_im, 9.8e4, 330.0, c.R_a, c.gamma_a)
    else:
        wanted = -saint_venant(2e-5, 9.8e4, p_im, 298.0, c.R_a, c.gamma_a)
    assert found == pytest.approx(wanted, rel=1e-9, abs=1e-12)


def test_a_leak_closes_the_mass_balance_of_the_manifold(inject, config):
    """What has come in and not gone out is there: from second to second, m = p V / (R T) against the integral of the flows."""
    truth = inject(CatalogueEffect("leak.intake", 4e-5, onset=3.3), rate=RATE).truth
    mass = truth["p_im"] * config.engine.geometry.V_im / (config.engine.gas.R_a * truth["T_im"])
    net = truth["W_c"] + truth["W_egr"] - truth["W_ei"] - truth["W_leak"]
    gained = np.concatenate([[0.0], np.cumsum(0.5 * (net[1:] + net[:-1]) / RATE)])
    # fourth-order steps against trapezoids of 1 ms, half a step of the leak at its onset (20 g/s times 0.5 ms)
    np.testing.assert_allclose(mass - mass[0], gained, atol=1e-5)
    assert truth["W_leak"].sum() / RATE > 5e-3


def test_a_leak_costs_boost_and_the_sensor_sees_more_than_the_cylinders_get(inject, truth):
    leaky = inject(CatalogueEffect("leak.intake", 4e-5)).truth
    boost = truth["p_im"] > 1.5e5
    assert leaky["p_im"][boost].mean() < 0.99 * truth["p_im"][boost].mean()
    more, before = ((course["W_c"] + course["W_egr"] - course["W_ei"])[boost].mean() for course in (leaky, truth))
    assert more - before > 0.7 * leaky["W_leak"][boost].mean() > 0.0


def test_an_egr_valve_that_leaks_passes_gas_when_closed(inject, sound, config, truth):
    c, area = Diesel(config.engine).constants, 6e-6
    leaky = inject(CatalogueEffect("egr.leak", area)).truth
    p_im, p_em = leaky["p_im"], leaky["p_em"]
    ratio = np.minimum(p_im, p_em) / np.maximum(p_im, p_em)
    Psi = 1.0 - ((1.0 - np.maximum(ratio, c.pi_egr_opt)) / (1.0 - c.pi_egr_opt) - 1.0) ** 2
    forward = area * p_em * Psi / np.sqrt(leaky["T_em"] * c.R_e)
    backward = -c.k_reverse * area * p_im * Psi / np.sqrt(leaky["T_im"] * c.R_a)
    wanted = sound(leaky)["W_egr"] + np.where(p_em >= p_im, forward, backward)
    np.testing.assert_allclose(leaky["W_egr"], wanted, rtol=1e-9, atol=1e-12)
    closed = truth["u_egr"] == 0.0
    assert closed.any()
    assert np.array_equal(np.sign(leaky["W_egr"][closed]), np.sign(p_em - p_im)[closed])


def test_egr_flows_backward_through_a_leak_as_through_the_valve(plant):
    leaky = plant._replace(condition=Condition(egr_leak=1e-5))
    forward, backward = (egr_flow(leaky, *pressures, 0.0, 400.0, 400.0) for pressures in ((1e5, 1.1e5), (1.1e5, 1e5)))
    c = plant.engine
    assert backward / forward == pytest.approx(-c.k_reverse * sqrt(c.R_e / c.R_a), rel=1e-12)


# --- time, and the ends of the ranges -----------------------------------------------------------------------------------


@pytest.mark.parametrize("identifier", [name for name, kind in CATALOGUE.items() if kind.place == "plant"])
@pytest.mark.parametrize("end", ["low", "high"])
@pytest.mark.slow
def test_the_engine_runs_at_both_ends_of_every_range(inject, identifier, end):
    kind = CATALOGUE[identifier]
    value = getattr(kind, end)
    truth = inject(CatalogueEffect(identifier, value, onset=2.0, end=16.0), rate=20).truth
    for name, values in truth.items():
        assert np.isfinite(values).all(), name
    assert truth["p_im"].min() > 3e4
    assert truth["p_em"].max() < 1.5e6
    assert truth["T_em"].max() < 2000.0


def test_two_holes_are_one_of_both_areas(inject):
    two = inject(CatalogueEffect("leak.intake", 1e-5), CatalogueEffect("leak.intake", 2e-5)).truth
    one = inject(CatalogueEffect("leak.intake", 3e-5)).truth
    np.testing.assert_allclose(two["W_leak"], one["W_leak"], rtol=1e-9, atol=1e-15)


def test_a_leak_that_is_mended_leaves_the_engine_as_before(inject, truth):
    """It starts and ends with a step of the area; the pressures follow, and forget within a second or so."""
    leaky = inject(CatalogueEffect("leak.intake", 2e-5, onset=5.0, end=9.0)).truth
    time = np.arange(truth["p_im"].size) / 100.0
    assert (leaky["W_leak"][(time >= 5.0) & (time < 9.0)] != 0.0).all()
    assert (leaky["W_leak"][(time < 5.0) | (time >= 9.0 + 1e-9)] == 0.0).all()
    jump = np.abs(np.diff(leaky["p_im"])).max() / np.abs(np.diff(truth["p_im"])).max()
    assert jump < 1.5  # the pressure has no step
    late = time > 16.0
    np.testing.assert_allclose(leaky["p_im"][late], truth["p_im"][late], rtol=5e-3)
