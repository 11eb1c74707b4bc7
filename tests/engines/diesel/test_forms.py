"""The forms of a component's relation: the truck engine against the textbook, what is refused, and that no form costs another."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from reference import diesel_scalars as scalars
from reference import diesel_textbook as textbook
from repository import CONFIGS

from lpvobs.engines.diesel import relations as relation
from lpvobs.engines.diesel.constants import COMPRESSOR_FORMS, TURBINE_FORMS, constants_of, own_constants
from lpvobs.engines.diesel.lpv import Diesel
from lpvobs.errors import UsageError
from lpvobs.io.configuration.config import config_of, load_config

HEAVY = CONFIGS / "heavy-duty.toml"
TEXT = HEAVY.read_text(encoding="utf-8")
SAME = 1e-9  # a dozen floating-point operations, magnified near stall as in test_relations
RANGES = {"p_im": (0.8e5, 3.5e5), "p_em": (0.9e5, 5e5), "omega_t": (500.0, 20000.0), "p_amb": (0.85e5, 1.03e5),
          "T_amb": (260.0, 310.0), "T_em": (300.0, 1200.0), "u_vgt": (20.0, 100.0)}  # fmt: skip


def anywhere(*names):
    return [st.floats(*RANGES[name]) for name in names]


@pytest.fixture(scope="module")
def truck():
    return load_config(HEAVY)[0].engine


@given(*anywhere("p_im", "omega_t", "p_amb", "T_amb"))
def test_the_compressor_is_the_textbooks(truck, p_im, omega_t, p_amb, T_amb):
    c = constants_of(truck)
    W_c, P_c = textbook.compressor(truck, p_im, omega_t, p_amb, T_amb)
    rho_1 = scalars.rho_1(c, p_im, omega_t, p_amb, T_amb)
    assert rho_1 * omega_t == pytest.approx(W_c, rel=SAME, abs=1e-8)
    power = relation.rho_5(c, rho_1, relation.head(c, p_im, p_amb), p_im, omega_t, p_amb, T_amb) * c.J_t * omega_t**2
    assert power == pytest.approx(P_c, rel=SAME, abs=1e-3)  # 1e-8 kg/s lifts 100 kJ/kg


@given(*anywhere("p_em", "omega_t", "u_vgt", "T_em", "p_amb"))
def test_the_turbine_is_the_textbooks(truck, p_em, omega_t, u_vgt, T_em, p_amb):
    c = constants_of(truck)
    W_t, power = textbook.turbine(truck, p_em, omega_t, u_vgt, T_em, p_amb)
    rho_4, Pi_t = scalars.turbine(c, p_em, u_vgt, T_em, p_amb)
    assert rho_4 * p_em == pytest.approx(W_t, rel=SAME)
    assert relation.turbine_power(c, W_t, Pi_t, omega_t, T_em) == pytest.approx(power, rel=SAME)


def test_an_ellipse_off_the_origin_satisfies_its_equation(truck):
    """Both centres moved: every point of the upper right quarter lies on the curve as it is printed."""
    moved = replace(truck, compressor=replace(truck.compressor, c_psi2=0.1, c_phi2=0.02))
    c, omega_t = constants_of(moved), 6000.0
    a = np.polyval([c.c_w_psi1, c.c_w_psi2, c.c_w_psi3], omega_t)
    b = np.polyval([c.c_w_phi1, c.c_w_phi2, c.c_w_phi3], omega_t)
    for Psi in np.linspace(0.1, 0.1 + 0.99 * a**-0.5, 7):
        Phi = relation.flow_coefficient(c, Psi, omega_t)
        assert a * (Psi - 0.1) ** 2 + b * (Phi - 0.02) ** 2 == pytest.approx(1.0, rel=1e-12)
    assert relation.flow_coefficient(c, 0.1 + 1.01 * a**-0.5, omega_t) == 0.02  # stall


def test_no_speed_makes_the_flow_infinite(truck):
    """The parabola of c_phi1 goes through zero near 16 600 rad/s."""
    c = constants_of(truck)
    found = [scalars.rho_1(c, 2e5, speed, 1e5, 300.0) for speed in np.linspace(14_000.0, 40_000.0, 500)]
    assert np.isfinite(found).all()
    assert max(found) <= 1e5 * np.pi * c.R_c**3 / (c.R_a * 300.0)  # Phi_c = 1


def test_the_loss_begins_at_its_speed(truck):
    c = constants_of(truck)
    assert relation.turbine_loss(c, 0.99 * c.c_m2) == 0.0
    assert relation.turbine_loss(c, 3.0 * c.c_m2) == pytest.approx(c.c_m1 * (2.0 * c.c_m2) ** c.c_m3)


def test_an_engine_has_the_constants_of_its_own_forms(truck, engine):
    """So that tolerances and gains speak of nothing else."""
    for one, compressor, turbine in ((engine, "tip_speed", "constant"), (truck, "rotor_speed", "rotor_speed")):
        own = own_constants(one)
        for kind, chosen in ((COMPRESSOR_FORMS, compressor), (TURBINE_FORMS, turbine)):
            for form, names in kind.items():
                assert all((name in own) == (form == chosen) for name in names)
        assert set(Diesel(one).usual_tolerance) <= set(own)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('form = "rotor_speed"\nR_c', 'form = "parabola"\nR_c', ("parabola", "'tip_speed'", "'rotor_speed'")),
        ("c_w_psi2 = -1.73197604e-4", "#", ("rotor_speed", "needs 'c_w_psi2'")),
        ("c_psi2 = 0.0", "c_psi2 = 0.0\npsi_0 = 1.2", ("does not use 'psi_0'", "tip_speed", "delete 'psi_0'")),
        ("c_m1 = 1.35634407", "c_m = 1.3", ("rotor_speed", "c_m")),
        ('form = "rotor_speed"\nR_c', "R_c", ("form = 'tip_speed'", "'psi_0'")),
        ("c_w_psi3 = 0.01", "psi_0 = 0.01", ("estimate.tolerance", "psi_0")),
    ],
)
def test_a_wrong_form_is_refused(old, new, words):
    lines = TEXT.replace("               # s\n", "\n")
    assert lines.count(old) == 1
    with pytest.raises(UsageError) as refusal:
        config_of(lines.replace(old, new), HEAVY)
    for word in words:
        assert word in str(refusal.value)
