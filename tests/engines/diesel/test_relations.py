"""The compiled relations against the textbook's, and what must hold at their seams."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from reference import diesel_scalars as scalars
from reference import diesel_textbook as textbook
from reference.drives import RANGES, scattered

from lpvobs.engines.components import intake
from lpvobs.engines.diesel import relations as relation
from lpvobs.engines.diesel.constants import constants_of

# Both sides are a dozen floating-point operations; powers and roots differ by a few units in the last place, and the difference
# 1 - (...)^2 of nearly equal numbers magnifies them where the compressor is close to stall.
SAME = 1e-9


def anywhere(name):
    return st.floats(*RANGES[name])


@pytest.fixture(scope="module")
def c(engine):
    return constants_of(engine)


@given(anywhere("p_im"), anywhere("omega_t"), anywhere("p_amb"), anywhere("T_amb"))
def test_compressor(engine, c, p_im, omega_t, p_amb, T_amb):
    W_c, P_c = textbook.compressor(engine, p_im, omega_t, p_amb, T_amb)
    rho_1 = scalars.rho_1(c, p_im, omega_t, p_amb, T_amb)
    rho_5 = relation.rho_5(c, rho_1, relation.head(c, p_im, p_amb), p_im, omega_t, p_amb, T_amb)
    assert rho_1 * omega_t == pytest.approx(W_c, rel=SAME, abs=1e-9)
    assert rho_5 * c.J_t * omega_t**2 == pytest.approx(P_c, rel=SAME, abs=1e-5)  # abs: 1e-9 kg/s lifts 10 kJ/kg
    assert rho_5 >= 0.0


@given(*map(anywhere, ("p_im", "p_em", "u_egr", "T_im", "T_em")))
def test_egr(engine, c, p_im, p_em, u_egr, T_im, T_em):
    expected = textbook.egr(engine, p_im, p_em, u_egr, T_im, T_em)
    found = intake.rho_2(c, p_im, p_em, u_egr, T_im, T_em) * p_em
    # Psi is a difference from one: near equal pressures an absolute 1e-16 of the area times pressure over root, about 0.1 kg/s.
    assert found == pytest.approx(float(expected), rel=SAME, abs=1e-15)
    assert found * (p_em - p_im) >= 0.0  # never against the pressure


@given(*map(anywhere, ("p_im", "n_e", "u_delta", "T_im")))
def test_cylinder(engine, c, p_im, n_e, u_delta, T_im):
    W_ei, W_f = textbook.cylinder(engine, p_im, n_e, u_delta, T_im)
    assert intake.rho_3(c, p_im, n_e, T_im) * p_im == pytest.approx(W_ei, rel=1e-12)
    assert intake.cylinder_fuel_flow(c, n_e, u_delta) == pytest.approx(W_f, rel=1e-12)


@given(*map(anywhere, ("p_em", "omega_t", "u_vgt", "T_em", "p_amb")))
def test_turbine(engine, c, p_em, omega_t, u_vgt, T_em, p_amb):
    W_t, power = textbook.turbine(engine, p_em, omega_t, u_vgt, T_em, p_amb)
    rho_4, Pi_t = scalars.turbine(c, p_em, u_vgt, T_em, p_amb)
    assert rho_4 * p_em == pytest.approx(W_t, rel=SAME)
    assert relation.turbine_power(c, rho_4 * p_em, Pi_t, omega_t, T_em) == pytest.approx(power, rel=SAME)
    assert rho_4 > 0.0


def test_samples_reach_both_sides_of_every_seam(engine):
    """Random points only prove the branches that they take."""
    log = scattered(1, 4000)
    w = textbook.flows(engine, log.channels)
    stalled = (w["W_c"] == 0.0).mean()
    below = (log["p_im"] < log["p_amb"]).mean()
    backward = (w["W_egr"] < 0.0).mean()
    assert min(stalled, below, backward) > 0.02
    assert max(stalled, below, backward) < 0.9


def near(at, step=1e-9):
    return at * (1.0 - step), at * (1.0 + step)


@given(anywhere("omega_t"), anywhere("p_amb"), anywhere("T_amb"))
def test_compressor_is_continuous_where_the_head_changes_sign(c, omega_t, p_amb, T_amb):
    below, above = (scalars.rho_1(c, p, omega_t, p_amb, T_amb) for p in near(p_amb))
    # The steepest slope there is k_neg / 0.2 times dPsi_c, and 1e-9 in pressure moves Psi_c by 2 c_pa T 0.28e-9 / U^2, under 2e-7.
    assert below == pytest.approx(above, rel=1e-6)


@given(anywhere("omega_t"), anywhere("p_amb"), anywhere("T_amb"))
def test_compressor_closes_continuously_into_stall(c, omega_t, p_amb, T_amb):
    U = c.R_c * omega_t
    head = (c.psi_0 + c.psi_1 * U / 400.0) * U**2 / (2.0 * c.c_pa * T_amb)
    stall = p_amb * (1.0 + head) ** (c.gamma_a / (c.gamma_a - 1.0))
    widest = p_amb * np.pi * c.R_c**3 * (c.phi_0 + c.phi_1 * U / 400.0) / (c.R_a * T_amb)
    assert scalars.rho_1(c, stall * (1.0 + 1e-9), omega_t, p_amb, T_amb) == 0.0
    just_before = scalars.rho_1(c, stall * (1.0 - 1e-9), omega_t, p_amb, T_amb)
    # The ellipse ends upright: a relative 1e-9 from its end, sqrt(2 d ln Psi) of its width remains, at most sqrt(2e-6).
    assert 0.0 < just_before < 2e-3 * widest


@given(anywhere("p_im"), st.floats(0.0, 100.0), anywhere("T_im"), anywhere("T_em"))
def test_egr_is_continuous_where_the_pressures_are_equal(c, p_im, u_egr, T_im, T_em):
    below, above = (intake.rho_2(c, p_im, p_em, u_egr, T_im, T_em) * p_em for p_em in near(p_im))
    # The parabola leaves one with slope 2 / (1 - Pi_opt); times 1e-9, the area and the pressure over a root of 300 J/kg: 1e-8.
    assert -1e-7 < below <= 0.0 <= above < 1e-7
    assert intake.rho_2(c, p_im, p_im, u_egr, T_im, T_em) == pytest.approx(0.0, abs=1e-20)


@given(anywhere("p_em"), anywhere("T_im"), anywhere("T_em"), st.floats(80.1, 300.0), st.floats(-50.0, 0.0))
def test_egr_valve_beyond_its_ends(c, p_em, T_im, T_em, beyond, before):
    vertex = -0.5 * c.c_egr2 / c.c_egr1
    assume(beyond > vertex)
    wide = intake.rho_2(c, 0.9 * p_em, p_em, vertex, T_im, T_em)
    assert intake.rho_2(c, 0.9 * p_em, p_em, beyond, T_im, T_em) == wide
    assert intake.rho_2(c, 0.9 * p_em, p_em, before, T_im, T_em) == 0.0
    # At the vertex of the area's parabola the slope is zero: no seam.
    assert intake.rho_2(c, 0.9 * p_em, p_em, vertex * (1 - 1e-6), T_im, T_em) == pytest.approx(wide, rel=1e-11)


def test_flow_chokes_at_the_best_ratio(c):
    assert intake.egr_flow_function(c, c.pi_egr_opt) == 1.0
    assert intake.egr_flow_function(c, 0.3 * c.pi_egr_opt) == 1.0
    assert intake.egr_flow_function(c, 1.0) == 0.0


@pytest.mark.parametrize("u_vgt", [-500.0, -16.0, 0.0, 50.0, 102.0, 221.0, 500.0])
def test_vane_area_never_closes(c, u_vgt):
    assert c.f_vgt_min <= relation.vgt_area_ratio(c, u_vgt) <= c.c_f1 + c.c_f2


def test_an_engine_at_rest_breathes_nothing(c):
    assert intake.rho_3(c, 1e5, 0.0, 300.0) == 0.0
    assert intake.cylinder_fuel_flow(c, 0.0, 20.0) == 0.0
