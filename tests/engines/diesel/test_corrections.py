"""Corrections of components against difference quotients of the balances, and where the compressor is not relied on."""

from dataclasses import replace

import numpy as np
import pytest
from reference.drives import log_of, scattered

from lpvobs.engines.diesel.corrections import COMPONENTS, COMPRESSOR, FILLING
from lpvobs.engines.diesel.lpv import Diesel

NAMES = [component.name for component in COMPONENTS]


@pytest.fixture(scope="module")
def boosted():
    """Return samples whose exhaust pressure is above that of the intake: gas flows the usual way through the valve."""
    log = scattered(3)
    p_em = log["p_im"] * np.random.default_rng(4).uniform(1.05, 1.6, len(log))
    return replace(log, channels={**log.channels, "p_em": p_em})


@pytest.fixture(scope="module")
def rates(boosted):
    rng = np.random.default_rng(5)
    found = {"p_im": 1e3 * rng.standard_normal(500), "T_im": np.zeros(500), "T_em": 50.0 * rng.standard_normal(500)}
    return found | {"omega_t": 1e3 * rng.standard_normal(500)}


@pytest.fixture(scope="module")
def columns(air_path, boosted, rates):
    """Return the derivatives of the flows by the values of each component, by name."""
    found = zip(COMPONENTS, air_path.corrections(boosted, rates), strict=True)
    return {component.name: correction.columns(component.size) for component, correction in found}


def test_there_is_one_for_each_component_in_its_balance(air_path, boosted, rates):
    found = air_path.corrections(boosted, rates)
    assert [item.balance for item in found] == [COMPRESSOR] + [FILLING] * 7 + [COMPRESSOR, None]


def test_a_filling_that_is_larger_everywhere_is_a_larger_displacement(air_path, boosted, rates, columns):
    slope = air_path.balances(boosted, rates, ("V_d",)).slope[FILLING, 0]
    np.testing.assert_allclose(columns["eta_vol"].sum(axis=1), slope, rtol=1e-6)  # the flow is linear in it
    for name, weight in (
        ("eta_vol_exhaust", boosted["p_em"] / boosted["p_im"] - 1.2),
        ("eta_vol_charge", (boosted["T_im"] - 320.0) / 100.0),
        ("eta_vol_heat", (boosted["T_em"] - 600.0) / 100.0),
    ):
        np.testing.assert_allclose(columns[name][:, 0], slope * weight, rtol=1e-6, atol=1e-12)


def test_ports_that_are_still_cold_warm_the_charge_less_than_at_rest(air_path, boosted, rates, columns):
    heat, cold = NAMES.index("eta_vol_heat"), {"T_ports": boosted["T_em"] - 100.0}
    found = air_path.corrections(replace(boosted, channels={**boosted.channels, **cold}), rates)[heat]
    slope = air_path.balances(boosted, rates, ("V_d",)).slope[FILLING, 0]
    np.testing.assert_allclose(columns["eta_vol_heat"][:, 0] - found.columns(1)[:, 0], slope, rtol=1e-6)


def test_waves_come_back_in_the_same_time_at_any_speed(air_path, boosted, rates):
    """What a wave adds belongs to the time of a revolution; the charge's temperature moves its speed of sound."""
    waves = NAMES.index("eta_vol_waves")
    hot = {"T_im": 1.21 * boosted["T_im"], "n_e": 1.1 * boosted["n_e"]}
    found = [
        air_path.corrections(log, rates)[waves].points.weights
        for log in (boosted, replace(boosted, channels={**boosted.channels, **hot}))
    ]
    np.testing.assert_array_equal(found[0][0], found[1][0])
    np.testing.assert_allclose(found[0][1], found[1][1], atol=1e-9)


def test_a_compressor_that_passes_more_everywhere_does_so_by_its_flow_without_pressure_rise(
    air_path, boosted, rates, columns
):
    free = replace(boosted, channels={**boosted.channels, "p_im": boosted["p_amb"]})
    np.testing.assert_allclose(columns["compressor"].sum(axis=1), air_path.balances(free, rates, ()).flow[COMPRESSOR])


def test_an_open_valve_passes_a_share_of_its_nozzle(air_path, boosted, rates, columns):
    W_egr = -air_path.balances(boosted, rates, ("A_egr_max",)).slope[FILLING, 0]
    open_ = boosted["u_egr"] > 1.0
    share = -W_egr[open_] / columns["egr"].sum(axis=1)[open_]
    # Psi of the EGR valve is a parabola over the pressure ratio, one where the flow chokes.
    assert (share > 0.0).all()
    assert (share < 1.0 + 1e-9).all()


def test_a_thermocouple_that_lags_reads_the_temperature_of_before(air_path, boosted, rates, columns):
    step = 1e-4
    later = replace(boosted, channels={**boosted.channels, "T_em": boosted["T_em"] + step * rates["T_em"]})
    flows = [air_path.balances(log, rates, ()).flow[FILLING] for log in (boosted, later)]
    np.testing.assert_allclose(columns["T_em_lag"][:, 0], (flows[1] - flows[0]) / step, rtol=1e-3, atol=1e-8)


@pytest.mark.parametrize(
    ("lag", "names", "way"), [("W_maf_lag", ("p_im", "omega_t"), -1.0), ("omega_t_lag", ("omega_t",), 1.0)]
)
def test_a_sensor_that_lags_reads_the_value_of_before(air_path, boosted, rates, columns, lag, names, way):
    """The flow reads what it was; the speed makes the flow what it was, so the flow past the sensor is later."""
    step = 1e-4
    later = {name: boosted[name] + step * rates[name] for name in names}
    flows = [
        air_path.balances(log, rates, ()).flow[COMPRESSOR]
        for log in (boosted, replace(boosted, channels={**boosted.channels, **later}))
    ]
    moved = way * (flows[1] - flows[0]) / step
    calm = (
        np.minimum(*flows)
        > 0.2
        * air_path.balances(replace(boosted, channels={**boosted.channels, "p_im": boosted["p_amb"]}), rates, ()).flow[
            COMPRESSOR
        ]
    )  # near stall the flow is no straight line even over such a step
    assert calm.sum() > 100
    np.testing.assert_allclose(columns[lag][calm, 0], moved[calm], rtol=0.05, atol=1e-6)


def test_values_at_nodes_are_shares_that_add_up_to_one(air_path, boosted, rates):
    for component, correction in zip(COMPONENTS, air_path.corrections(boosted, rates), strict=True):
        if component.axes:
            nodes, share = correction.points.weights
            np.testing.assert_allclose(share.sum(axis=1), 1.0, rtol=1e-12)
            assert share.min() >= 0.0
            assert nodes.min() >= 0
            assert nodes.max() < component.size == len(component.names()) == len(component.correlation())


def test_a_compressor_near_stall_is_trusted_less(air_path):
    """At one speed, from free flow to beyond the pressure at which the flow turns."""
    N = 200
    p_im = np.linspace(1.0e5, 2.5e5, N)
    steady = {name: np.full(N, value) for name, value in (("omega_t", 9000.0), ("p_amb", 98000.0), ("T_amb", 298.0))}
    log = log_of(0.01 * np.arange(N), {"p_im": p_im, **steady})
    noise = {"p_im": np.full(N, 100.0), "omega_t": np.full(N, 5.0)}
    found = air_path.caution(log, noise, 0.003)
    trust, bias = found.trust[COMPRESSOR], found.bias[COMPRESSOR]
    assert ((trust > 0.0) & (trust <= 1.0)).all()
    np.testing.assert_array_equal(found.trust[FILLING], 1.0)
    np.testing.assert_array_equal(found.bias[FILLING], 0.0)
    assert trust[0] > 0.9
    assert trust.min() < 0.5
    # A curve that bends downwards reads too little under noise: half its second difference.
    flow = Diesel.balances
    rising = {name: log[name] for name in log.channels}
    values = []
    for way in (-1.0, 0.0, 1.0):
        moved = {**rising, "p_im": p_im + way * 100.0}
        rows = dict.fromkeys(("n_e", "u_delta", "u_egr", "u_vgt", "p_em", "T_im", "T_em"), np.full(N, 300.0)) | moved
        zero = np.zeros(N)
        values.append(flow(air_path, log_of(log.time, rows), {"p_im": zero, "T_im": zero}, ()).flow[COMPRESSOR])
    by_pressure = 0.5 * (values[0] + values[2]) - values[1]
    quiet = air_path.caution(log, {**noise, "omega_t": np.zeros(N)}, 0.0).bias[COMPRESSOR]
    np.testing.assert_allclose(quiet, by_pressure, rtol=1e-9, atol=1e-15)
    assert np.abs(bias).max() > 0.0
