"""A throttled engine: what is learned from a healthy log, its LPV form, and its balances, on a drive with known truth."""

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from reference import throttled_drive as truth
from repository import LIU_ICE

from lpvobs.engines.blocks import blocks_of
from lpvobs.engines.curves import Points, on_line, on_surface, values_at
from lpvobs.engines.throttled import relations as relation
from lpvobs.engines.throttled.learning import learn
from lpvobs.engines.throttled.lpv import CONSTANTS, Throttled
from lpvobs.errors import DataError, UsageError
from lpvobs.io.configuration.config import load_config


@pytest.fixture(scope="module")
def engine():
    return load_config(LIU_ICE)[0].engine


@pytest.fixture(scope="module")
def channels():
    return truth.drive()


@pytest.fixture(scope="module")
def log(channels):
    return truth.log_of(channels)


@pytest.fixture(scope="module")
def air_path(engine, log):
    return Throttled(engine).learned_from([log])


def test_interpolation_is_exact_at_nodes_and_held_outside():
    nodes = np.array([0.0, 1.0, 3.0])
    values = np.array([5.0, 7.0, 1.0])
    found = values_at(on_line(nodes, np.array([-4.0, 0.0, 1.0, 2.0, 3.0, 9.0])), values)
    np.testing.assert_allclose(found, [5.0, 5.0, 7.0, 4.0, 1.0, 1.0])
    rows = np.array([0.0, 2.0])
    surface = np.array([[0.0, 1.0, 3.0], [10.0, 11.0, 13.0]])  # y + 5 x
    found = values_at(on_surface(rows, nodes, np.array([0.5, 1.7]), np.array([0.5, 2.0])), surface)
    np.testing.assert_allclose(found, [3.0, 10.5])


@pytest.mark.parametrize("axes", [1, 2, 3])
def test_interpolation_without_weights_is_that_with_them(axes):
    rng = np.random.default_rng(axes)
    nodes = tuple(np.sort(rng.uniform(0.0, 1.0, size)) for size in (4, 3, 5)[:axes])
    points = Points(nodes, tuple(rng.uniform(-0.2, 1.2, (axes, 200))))
    values = rng.normal(size=[each.size for each in nodes])
    np.testing.assert_allclose(points.interpolated(values), values_at(points.weights, values), rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("ratio", [0.1, 0.5283, 0.7, 0.95])
def test_flow_function_is_the_orifice_of_the_textbook(engine, ratio):
    x = {"p_ic": np.array([1.2e5]), "p_im": np.array([ratio * 1.2e5]), "T_ic": np.array([310.0])}
    expected = truth.orifice(1.2e5, ratio * 1.2e5, 310.0)
    # The textbook's critical ratio is rounded to four digits, and the maximum is flat there.
    np.testing.assert_allclose(relation.throttle_per_area(engine, x), expected, rtol=1e-6)


def test_blocks_hold_no_gap_and_means_and_rates_are_those_of_the_channel():
    time = np.concatenate([np.arange(0.0, 21.0, 0.05), np.arange(30.0, 61.0, 0.05)])
    line = 3.0 + 2.0 * time
    cut = int(np.searchsorted(time, 25.0))
    log = replace(
        truth.log_of({"time": time, "x": line}),
        segments=((0, cut), (cut, time.size)),
    )
    blocks = blocks_of(log)
    assert blocks.count == 10 + 15
    assert not np.any((blocks.edges[0] < 25.0) & (blocks.edges[1] > 21.0))
    inside = np.ones(blocks.count, bool)
    inside[[0, 9, 10, 24]] = False  # the window at an edge of the log holds one side only
    np.testing.assert_allclose(blocks.rate(line)[inside], 2.0, rtol=1e-9)
    # Samples lie at the beginning of their time step, so a mean is half a step early.
    np.testing.assert_allclose(blocks.mean(line), 3.0 + 2.0 * (blocks.time - 0.025), rtol=1e-9)
    np.testing.assert_allclose(blocks.spread(line), 2.0 * 2.0 / np.sqrt(12.0), rtol=1e-2)


def test_a_healthy_log_shows_volumes_and_curves(air_path, engine, log):
    learned = air_path.learned
    values = {name: curve.values for name, curve in learned.curves.items()}
    # 2 s blocks, filling and throttle smooth to the nodes' distance: the volumes come out within a few per cent.
    np.testing.assert_allclose([learned["V_ic"], learned["V_im"]], [truth.V_IC, truth.V_IM], rtol=0.04)
    x = log.channels
    area = np.array([truth.area(a) for a in x["alpha_th"]])
    seen = values_at(relation.THROTTLE.weights(engine, x), values["throttle"])
    # Straight lines between nodes of a curve that rises by a third from node to node: one per cent in the middle.
    assert np.quantile(np.abs(seen / area - 1.0), 0.95) < 0.02
    eta = np.array([truth.eta_vol(n, p) for n, p in zip(x["n_e"], x["p_im"], strict=True)])
    filled = values_at(relation.FILLING.weights(engine, x), values["filling"]) / eta
    inside = x["p_im"] > 2e4  # the lowest node lies at 15 kPa, and below it the curve is held
    assert np.quantile(np.abs(filled - 1.0)[inside], 0.9) < 0.03
    fuel = values_at(relation.FUEL.weights(engine, x), values["fuel"])
    assert np.median(np.abs(fuel / truth.AIR_PER_FUEL - 1.0)) < 2e-3


def test_uncertainty_is_small_where_the_log_went_and_large_elsewhere(air_path, engine, log):
    learned = air_path.learned
    error = np.sqrt(np.diag(learned.covariance)[learned.places()["throttle"]])
    nodes = np.array(engine.curves.alpha_th)
    driven = (nodes > 4.0) & (nodes < 30.0)
    assert error[driven].max() < 0.1 < error[nodes > 60.0].min()
    assert learned.covariance.shape == (len(learned.names) + 2,) * 2


def test_learning_leaves_out_what_it_is_told_to(engine, channels):
    blocks = blocks_of(truth.log_of(channels))
    wrong = dict(channels)
    spoiled = channels["time"] > 300.0
    wrong["W_maf"] = np.where(spoiled, 1.5, 1.0) * channels["W_maf"]
    half = blocks.time < 299.0
    kept = learn(engine, [truth.log_of(wrong)], [half])
    clean = learn(engine, [truth.log_of(channels)], [half])
    np.testing.assert_array_equal(kept.curves["throttle"].values, clean.curves["throttle"].values)


def test_a_log_without_flow_is_refused(engine, channels):
    still = {**channels, "W_maf": np.zeros_like(channels["W_maf"])}
    with pytest.raises(DataError, match="longer healthy log"):
        learn(engine, [truth.log_of(still, "still")])


def test_an_engine_that_has_learned_nothing_says_so(engine, log):
    with pytest.raises(UsageError, match="healthy log"):
        Throttled(engine).trajectory(log, ("p_ic",))


def test_the_state_equation_holds_along_the_drive(air_path, channels, log):
    outputs = ("p_ic", "p_im")
    found = air_path.trajectory(log, outputs)
    x = np.stack([channels["p_ic"], channels["p_im"], channels["W_c"]], axis=1)
    slope = np.einsum("kij,kj->ki", found.A, x) + found.E
    measured = np.gradient(x, channels["time"], axis=0)
    calm = np.abs(measured[:, 1]) < 2e3  # Pa/s: where a difference over two samples is the derivative
    a_im_W = found.parameters[:, 3] * channels["W_c"]
    # Curves are good to one or two per cent of the flow.
    assert np.median(np.abs(slope[:, 1] - measured[:, 1])[calm] / a_im_W[calm]) < 0.02
    np.testing.assert_array_equal(slope[:, 2], 0.0)
    assert found.C.shape == (len(log), 3, 3)
    np.testing.assert_array_equal(np.einsum("kj,kj->k", found.C[:, -1], x), channels["W_c"])


def test_system_of_fractions_is_the_trajectory(air_path, log):
    outputs = ("p_im", "p_ic")
    found = air_path.trajectory(log, outputs)
    for k in range(0, len(log), 1501):
        exact = [Fraction(float(value)) for value in found.parameters[k]]
        A, C = air_path.system(exact, outputs)
        assert all(isinstance(entry, Fraction) for row in (*A, *C) for entry in row)
        np.testing.assert_allclose(np.array(A, dtype=float), found.A[k], rtol=4e-15)  # one rounding against two
        np.testing.assert_array_equal(np.array(C, dtype=float), found.C[k])


def test_balances_give_the_true_flow_and_their_slopes_are_exact(air_path, channels, log):
    rates = {name: np.gradient(channels[name], channels["time"]) for name in air_path.smoothed}
    found = air_path.balances(log, rates, CONSTANTS)
    assert found.names == ("throttle", "filling", "fuel")
    calm = np.abs(rates["p_im"]) < 2e3
    for flow in found.flow:
        # As the curves: a per cent or two.
        assert np.median(np.abs(flow / channels["W_c"] - 1.0)[calm]) < 0.02
    learned = air_path.learned
    moved = {}
    for name, part in zip(CONSTANTS, relation.PARTS, strict=False):
        curve = learned.curves[part.name]
        moved[name] = replace(learned, curves={**learned.curves, part.name: replace(curve, values=1.01 * curve.values)})
    for name in ("V_ic", "V_im"):
        number = replace(learned.numbers[name], value=1.01 * learned[name])
        moved[name] = replace(learned, numbers={**learned.numbers, name: number})
    for i, name in enumerate(CONSTANTS):
        other = replace(air_path, learned=moved[name]).balances(log, rates, ())
        # Flows are linear in each: rounding only.
        np.testing.assert_allclose((other.flow - found.flow) / 0.01, found.slope[:, i], rtol=1e-6, atol=1e-10)


def test_rate_bounds_follow_the_learned_volumes(air_path, engine):
    R = engine.air.R_a
    bounds = air_path.rate_bounds({"T_ic": (280.0, 320.0)})
    assert bounds["a_ic"] == (R * 280.0 / air_path.learned["V_ic"], R * 320.0 / air_path.learned["V_ic"])
    wide = Throttled(engine).rate_bounds({"T_ic": (280.0, 320.0)})
    assert wide["a_im"][0] < R * 280.0 / engine.geometry.V_im < R * 320.0 / engine.geometry.V_im < wide["a_im"][1]
