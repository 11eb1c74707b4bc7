"""The LPV form, Eq. (3)-(5) and (25), and the balances."""

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from reference import diesel_textbook as textbook
from reference.drives import RANGES, log_of, scattered

from lpvobs.engines.diesel.lpv import OWNED_CONSTANTS, Diesel

ROUNDING = 1e-9  # relative to the largest term of a sum; see test_diesel_relations
SETS_OF_OUTPUTS = [("p_im", "omega_t"), ("p_im", "p_em", "omega_t"), ("omega_t", "p_em")]


@pytest.fixture(scope="module")
def log():
    return scattered(7, 600)


def test_rho_times_state_is_a_flow(air_path, log, engine):
    rho = air_path.trajectory(log, ("p_im",)).parameters.T
    w = textbook.flows(engine, log.channels)
    for product, flow in (
        (rho[0] * log["omega_t"], w["W_c"]),
        (rho[1] * log["p_em"], w["W_egr"]),
        (rho[2] * log["p_im"], w["W_ei"]),
        (rho[3] * log["p_em"], w["W_t"]),
        (rho[4] * engine.turbine.J_t * log["omega_t"] ** 2, w["P_c"]),
    ):
        np.testing.assert_allclose(product, flow, rtol=0, atol=ROUNDING * np.abs(flow).max())


def test_rates_of_eq_5(air_path, log, engine):
    parameters = air_path.trajectory(log, ("p_im",)).parameters
    np.testing.assert_allclose(parameters[:, 5], engine.gas.R_a * log["T_im"] / engine.geometry.V_im, rtol=1e-14)
    np.testing.assert_allclose(parameters[:, 6], engine.gas.R_e * log["T_em"] / engine.geometry.V_em, rtol=1e-14)


def test_A_x_plus_E_is_eq_1(air_path, log, engine):
    found = air_path.trajectory(log, ("p_im", "omega_t"))
    x = np.stack([log[name] for name in air_path.state_names], axis=1)
    lpv = np.einsum("kij,kj->ki", found.A, x) + found.E
    direct = textbook.derivatives(engine, log.channels).T
    terms = np.einsum("kij,kj->ki", np.abs(found.A), x) + np.abs(found.E)
    assert np.abs((lpv - direct) / terms).max() < ROUNDING


@pytest.mark.parametrize("outputs", SETS_OF_OUTPUTS)
def test_system_of_fractions_is_the_trajectory(air_path, log, outputs):
    found = air_path.trajectory(log, outputs)
    for k in range(0, len(log), 37):
        exact = [Fraction(float(value)) for value in found.parameters[k]]
        A, C = air_path.system(exact, outputs)
        assert all(isinstance(entry, Fraction) for row in (*A, *C) for entry in row)
        # The exact entry rounded once against floats rounded after each product.
        np.testing.assert_allclose(np.array(A, dtype=float), found.A[k], rtol=1e-15 * 4)
        np.testing.assert_array_equal(np.array(C, dtype=float), found.C[k])


@pytest.mark.parametrize("outputs", SETS_OF_OUTPUTS)
def test_outputs_are_what_is_measured_sensor_last(air_path, log, outputs):
    found = air_path.trajectory(log, outputs)
    np.testing.assert_array_equal(found.y, np.stack([log[name] for name in (*outputs, "W_maf")], axis=1))
    x = np.stack([log[name] for name in air_path.state_names], axis=1)
    predicted = np.einsum("krj,kj->kr", found.C, x)
    np.testing.assert_array_equal(predicted[:, :-1], found.y[:, :-1])
    np.testing.assert_allclose(predicted[:, -1], found.parameters[:, 0] * log["omega_t"], rtol=1e-15)


def test_constant_temperatures_replace_those_of_the_log_in_a_1_and_a_2_alone(air_path, log, engine):
    """The paper's a_1 and a_2 are constants; rho keeps the temperatures that were measured."""
    T_im, T_em = 310.0, 750.0
    free = air_path.trajectory(log, ("p_im", "omega_t"))
    found = air_path.trajectory(log, ("p_im", "omega_t"), {"T_im": T_im, "T_em": T_em})
    a_1, a_2 = engine.gas.R_a * T_im / engine.geometry.V_im, engine.gas.R_e * T_em / engine.geometry.V_em
    np.testing.assert_array_equal(found.parameters[:, :5], free.parameters[:, :5])
    np.testing.assert_allclose(found.parameters[:, 5:], np.tile([a_1, a_2], (len(log), 1)), rtol=1e-14)
    w = textbook.flows(engine, log.channels)
    x = np.stack([log[name] for name in air_path.state_names], axis=1)
    rate = np.einsum("kij,kj->ki", found.A, x) + found.E
    p_im, p_em = a_1 * (w["W_c"] + w["W_egr"] - w["W_ei"]), a_2 * (w["W_f"] + w["W_ei"] - w["W_t"] - w["W_egr"])
    np.testing.assert_allclose(rate[:, 0], p_im, rtol=0, atol=ROUNDING * a_1)  # flows of a tenth of a kg/s
    np.testing.assert_allclose(rate[:, 1], p_em, rtol=0, atol=ROUNDING * a_2)
    np.testing.assert_array_equal(found.C, free.C)


def test_E_needs_no_map_and_no_sensor(air_path, log):
    other = replace(log, channels={**log.channels, "W_maf": log["W_maf"] + 1.0})
    a, b = air_path.trajectory(log, ("p_im",)), air_path.trajectory(other, ("p_im",))
    for name in ("parameters", "A", "E", "C"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
    assert not np.array_equal(a.y, b.y)


def rates_of(log, seed):
    rng = np.random.default_rng(seed)
    return {"p_im": rng.normal(0, 5e4, len(log)), "T_im": rng.normal(0, 5.0, len(log))}


def test_balances_are_two_ways_to_the_same_flow(air_path, log, engine):
    """Where Eq. (1) holds, extended by the term in dT_im/dt, both balances give W_c."""
    T_rate = rates_of(log, 1)["T_im"]
    p_rate = textbook.derivatives(engine, log.channels)[0] + log["p_im"] / log["T_im"] * T_rate
    found = air_path.balances(log, {"p_im": p_rate, "T_im": T_rate}, ())
    W_c = textbook.flows(engine, log.channels)["W_c"]
    assert found.names == ("compressor", "filling")
    assert found.slope.shape == (2, 0, len(log))
    np.testing.assert_allclose(found.flow, [W_c, W_c], rtol=0, atol=ROUNDING * W_c.max())


def shifted(engine, name, factor):
    """Return the engine with one constant scaled, found by its name in whichever part holds it."""
    for part in ("gas", "geometry", "filling", "compressor", "turbine", "egr"):
        if hasattr(getattr(engine, part), name):
            record = getattr(engine, part)
            return replace(engine, **{part: replace(record, **{name: getattr(record, name) * factor})})
    raise LookupError(name)


# Constants as an engineer would list them: some act on both balances, some on one, some on none.
UNCERTAIN = (
    "R_a", "R_e", "c_pa", "gamma_a", "V_d", "V_im", "c_vol1", "c_vol2", "c_vol3", "R_c", "psi_0", "psi_1", "phi_0", "phi_1",
    "k_neg", "A_egr_max", "c_egr1", "c_egr2", "pi_egr_opt", "k_reverse", "J_t", "A_vgt_max", "V_em", "eta_c_max",
)  # fmt: skip


def test_slopes_are_central_differences(air_path, engine):
    log = scattered(11, 300)
    rates, step = rates_of(log, 2), 1e-4
    found = air_path.balances(log, rates, UNCERTAIN)
    for i, name in enumerate(UNCERTAIN):
        up, down = (Diesel(shifted(engine, name, 1 + s)).balances(log, rates, ()).flow for s in (step, -step))
        central = (up - down) / (2 * step)
        # Forward difference of step 1e-5 against a central one of 1e-4: errors f'' 1e-5 and f''' 1e-9. Next to stall and at the
        # vertex of the EGR area the second derivative has no bound, so a few samples in a hundred may miss.
        missed = np.abs(found.slope[:, i] - central) > 2e-3 * np.abs(central) + 1e-6
        assert missed.mean() < 0.02, name


def test_constants_that_no_balance_owns_owe_nothing(air_path, log):
    """Every constant outside OWNED_CONSTANTS is skipped; this shows that none is skipped wrongly."""
    everything = tuple(air_path.engine_constants())
    rates = rates_of(log, 3)
    flow = air_path.balances(log, rates, ()).flow
    for name in everything:
        moved = air_path.constants._replace(**{name: getattr(air_path.constants, name) * 1.01})
        for b, owned in enumerate(OWNED_CONSTANTS):
            other = _flow(moved, log, rates)[b]
            assert (name in owned) == bool(np.any(other != flow[b])), (name, b)


def _flow(constants, log, rates):
    from lpvobs.engines.diesel.corrections import compressor_flow
    from lpvobs.engines.diesel.lpv import filling_flow

    return compressor_flow(constants, log.channels), filling_flow(constants, log.channels, rates)


def test_rate_bounds(air_path):
    bounds = air_path.rate_bounds({"T_im": (280.0, 400.0), "T_em": (300.0, 1200.0)})
    assert bounds["a_1"] == pytest.approx((287 * 280 / 5e-3, 287 * 400 / 5e-3))
    assert bounds["a_2"] == pytest.approx((286 * 300 / 1.5e-3, 286 * 1200 / 1.5e-3))


def test_channels_of_the_contract(air_path):
    assert set(air_path.channels) == set(RANGES)
    assert {name: channel.unit for name, channel in air_path.channels.items()} == {
        "n_e": "rpm", "u_delta": "mg/cycle", "u_egr": "%", "u_vgt": "%", "p_im": "Pa", "p_em": "Pa", "omega_t": "rad/s",
        "T_im": "K", "T_em": "K", "p_amb": "Pa", "T_amb": "K", "W_maf": "kg/s",
    }  # fmt: skip


def test_whatever_passes_the_reader_gives_finite_matrices(air_path):
    """Every combination of the least and the greatest value that a reader lets through, and random mixtures."""
    rng = np.random.default_rng(5)
    ends = {name: (channel.low, channel.high) for name, channel in air_path.channels.items()}
    N = 4096
    corners = {name: np.where(rng.random(N) < 0.5, *pair) for name, pair in ends.items()}
    inside = {name: rng.uniform(*pair, N) for name, pair in ends.items()}
    for columns in (corners, inside):
        log = log_of(np.arange(N) * 0.01, columns)
        found = air_path.trajectory(log, ("p_im", "omega_t"))
        for name in ("parameters", "A", "E", "C"):
            assert np.isfinite(getattr(found, name)).all(), name
        zero = np.zeros(N)
        assert np.isfinite(air_path.balances(log, {"p_im": zero, "T_im": zero}, UNCERTAIN).flow).all()
