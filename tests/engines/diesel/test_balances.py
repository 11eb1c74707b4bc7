"""The four balances against the air path's own flows, and what each lack moves."""

import numpy as np
import pytest
from reference.drives import scattered

from lpvobs.engines.components.intake import escape
from lpvobs.engines.diesel.effects import (
    BALANCES,
    CHANNELS,
    LACKS,
    TURNING,
    imbalances_of,
)
from lpvobs.engines.diesel.lpv import Diesel
from lpvobs.engines.diesel.turbine import OTHER, left_by_turbine, turbine


def columns(log, seed=0):
    rng = np.random.default_rng(seed)
    rate = dict.fromkeys(CHANNELS, 0.0 * log.time)
    rate |= {
        "p_im": rng.normal(0, 2e4, len(log)),
        "T_im": rng.normal(0, 5, len(log)),
        "omega_t": rng.normal(0, 500, len(log)),
    }
    return np.stack([log[name] for name in CHANNELS]), np.stack([rate[name] for name in CHANNELS]), rate


def with_lacks(N, **lacks):
    return np.tile(np.array(list({**LACKS, **lacks}.values()))[:, None], (1, N))


def test_the_sensor_balances_are_those_of_the_air_path(engine):
    air_path, log = Diesel(engine), scattered(3)
    value, rate, rates = columns(log)
    flows = air_path.balances(log, rates, ()).flow
    left = imbalances_of(air_path.constants, value, rate, with_lacks(len(log)), np.zeros((3, len(log))))
    np.testing.assert_allclose(left[:2], log["W_maf"] - flows, rtol=0, atol=1e-12)  # kg/s, rounding


def test_turbine_side_is_the_equation_of_the_states(engine):
    air_path, log = Diesel(engine), scattered(5)
    c = air_path.constants
    value, rate, _ = columns(log)
    way = air_path.trajectory(log, ("p_im", "omega_t"))
    dx = np.einsum("kij,kj->ki", way.A, np.stack([log["p_im"], log["p_em"], log["omega_t"]], 1)) + way.E
    i, j = CHANNELS.index("p_em"), CHANNELS.index("omega_t")
    rate[i], rate[j] = dx[:, 1], dx[:, 2]  # what the model says the states do
    left = imbalances_of(c, value, rate, with_lacks(len(log)), np.zeros((3, len(log))))
    scale = np.abs(imbalances_of(c, value, 0 * rate, with_lacks(len(log)), np.zeros((3, len(log)))))
    assert np.all(np.abs(left[2:]) <= 1e-9 * (1e-3 + scale[2:]))


@pytest.mark.parametrize(
    ("name", "size", "moved"),
    [
        ("leak_intake", 1e-5, {"filling"}),
        ("egr_leak", 1e-5, {"filling", "exhaust"}),
        ("egr_area", 0.8, {"filling", "exhaust"}),
        ("eta_vol", 0.9, {"filling", "exhaust"}),
        ("compressor", 0.9, {"compressor", "turbo"}),
        ("turbine", 0.9, {"turbo"}),
        ("exhaust", 3.0, {"exhaust", "turbo"}),
    ],
)
def test_each_lack_has_its_place(engine, name, size, moved):
    log = scattered(7)
    value, rate, _ = columns(log)
    c, still = Diesel(engine).constants, np.zeros((3, len(log)))
    change = imbalances_of(c, value, rate, with_lacks(len(log), **{name: size}), still) - imbalances_of(
        c, value, rate, with_lacks(len(log)), still
    )
    assert {b for b, row in zip(BALANCES, change, strict=True) if np.abs(row).max() > 0} == moved
    assert name in LACKS


def test_a_leak_chokes_and_draws_in(engine):
    c = Diesel(engine).constants
    choked = [escape(c, p, 300.0, 98000.0, 298.0) / p for p in (2.2e5, 2.6e5)]
    assert choked[0] == pytest.approx(
        choked[1], rel=1e-12
    )  # beyond the critical ratio only the upstream pressure counts
    assert choked[0] == pytest.approx(0.684 / np.sqrt(287.0 * 300.0), rel=2e-3)  # textbook maximum of air, gamma 1.4
    assert escape(c, 90000.0, 300.0, 98000.0, 298.0) < 0.0
    assert escape(c, 98000.0, 300.0, 98000.0, 298.0) == 0.0


def restricted(c, factors):
    """Return flow and pressure ratio of a turbine at one point behind exhausts that are restricted by factors."""
    x = np.zeros((len(CHANNELS), factors.size))
    for name, value in {"u_vgt": 60.0, "p_em": 2.4e5, "T_em": 800.0, "p_amb": 1.0e5}.items():
        x[CHANNELS.index(name)] = value
    return turbine(c, factors * c.k_exhaust, x[TURNING], np.ones(x.shape[1]))


@pytest.mark.parametrize("factor", [2.0, 5.0, 9.0])
def test_a_restricted_exhaust_is_in_balance_with_its_own_flow(engine, factor):
    c = Diesel(engine).constants
    (W_t,), (Pi_t,) = restricted(c, np.array([factor]))
    assert Pi_t * 2.4e5 == pytest.approx(
        1.0e5 + factor * c.k_exhaust * W_t**2, rel=1e-6
    )  # Newton's fifth step is far below


def test_a_little_more_restriction_is_a_little_less_flow(engine):
    flows, _ = restricted(Diesel(engine).constants, np.linspace(0.5, 3.0, 251))
    falls = -np.diff(flows)
    assert (falls > 0.0).all()
    assert falls.max() < 5.0 * falls.min()  # no jump where the solution takes over


def changed(log, c, value, **fault):
    """Return how a fault changes the balances of an engine, shape (4, K)."""
    N, still = len(log), np.zeros((3, len(log)))
    faulty, sound = (imbalances_of(c, value, 0 * value, with_lacks(N, **each), still) for each in (fault, {}))
    return faulty - sound


@pytest.mark.parametrize(
    ("constant", "fault"),
    [("eta_tm_max", {"turbine": 0.9}), ("A_vgt_max", {"turbine": 0.9}), ("A_vgt_max", {"exhaust": 2.5})],
)
def test_a_fault_of_the_turbine_is_one_of_the_turbine_that_healthy_drives_show(engine, constant, fault):
    """A turbine that gave a third less power than its model seemed to lose a third less by a fault, too."""
    log = scattered(9)
    value, _, _ = columns(log)
    model = Diesel(engine).constants
    real = model._replace(**{constant: 0.8 * getattr(model, constant)})
    N, still = len(log), np.zeros((3, len(log)))
    left = np.subtract(*(imbalances_of(c, value, 0 * value, with_lacks(N), still) for c in (model, real)))
    true, as_modelled = changed(log, real, value, **fault), changed(log, model, value, **fault)
    known = as_modelled[2:] - left_by_turbine(model, value[TURNING], with_lacks(N, **fault)[5:], left[2:])
    for b in (0, 1):
        off, before = np.abs(known[b] - true[2 + b]).max(), np.abs(as_modelled[2 + b] - true[2 + b]).max()
        assert off <= 0.15 * before or before < 1e-9


def test_an_engine_that_is_its_model_leaves_nothing_with_a_fault(engine):
    log = scattered(11)
    value, _, _ = columns(log)
    c, nothing = Diesel(engine).constants, np.zeros((2, len(log)))
    for fault in ({"turbine": 0.9}, {"exhaust": 2.5}, {"exhaust": 0.8, "turbine": 1.1}):
        found = left_by_turbine(c, value[TURNING], with_lacks(len(log), **fault)[5:], nothing)
        np.testing.assert_allclose(found, 0.0, rtol=0, atol=1e-12)


def test_what_is_left_where_the_turbine_hardly_works_is_not_all_its_own(engine):
    """On idle the balance of powers may leave several times what the turbine gives."""
    log = scattered(13)
    value, _, _ = columns(log)
    c, N = Diesel(engine).constants, len(log)
    power = -changed(log, c, value, turbine=0.9)[3] / 0.1
    for sign, most in ((1.0, 1.0 - OTHER[0]), (-1.0, OTHER[1] - 1.0)):
        left = np.stack([np.zeros(N), 5.0 * sign * power])
        found = left_by_turbine(c, value[TURNING], with_lacks(N, turbine=0.9)[5:], left)[1]
        np.testing.assert_allclose(found, -0.1 * sign * most * power, rtol=1e-9, atol=1e-12)  # kg/s, rounding
