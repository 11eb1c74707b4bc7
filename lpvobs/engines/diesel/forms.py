"""The forms that a component's relation may have, one compiled function each; the configuration chooses by name.

A form is a name in `constants`, a function here, and a line in the function that chooses. The choice is the same for a whole log,
so the compiler takes it out of the loops over samples.
"""

from math import sqrt

from lpvobs.compiled import njit
from lpvobs.engines.diesel.constants import COMPRESSOR_FORMS, TURBINE_FORMS, DieselConstants

TIP_SPEED = list(COMPRESSOR_FORMS).index("tip_speed")
CONSTANT = list(TURBINE_FORMS).index("constant")
LEAST_COEFFICIENT = 1.0
"""Least c_phi1 of `ellipse_over_rotor_speed`: a flow coefficient Phi_c of one, several times that of any compressor."""


@njit(cache=True)
def flow_coefficient(c: DieselConstants, Psi_c: float, omega_t: float) -> float:
    """Return Phi_c [-] at a head coefficient [-] and a speed [rad/s], in the form of the engine's compressor."""
    if c.compressor_form == TIP_SPEED:
        return ellipse_over_tip_speed(c, Psi_c, omega_t)
    return ellipse_over_rotor_speed(c, Psi_c, omega_t)


@njit(cache=True)
def ellipse_over_tip_speed(c: DieselConstants, Psi_c: float, omega_t: float) -> float:
    """Return Phi_c of an ellipse whose axes grow in proportion to the tip speed."""
    U = c.R_c * omega_t
    Phi_max = c.phi_0 + c.phi_1 * U / 400.0
    if Psi_c < 0.0:
        return Phi_max * sqrt(1.0 - c.k_neg * Psi_c / 0.1)  # (+)
    ratio = Psi_c / (c.psi_0 + c.psi_1 * U / 400.0)
    return Phi_max * sqrt(1.0 - ratio * ratio) if ratio < 1.0 else 0.0


@njit(cache=True)
def ellipse_over_rotor_speed(c: DieselConstants, Psi_c: float, omega_t: float) -> float:
    """Return Phi_c of c_psi1 (Psi_c - c_psi2)^2 + c_phi1 (Phi_c - c_phi2)^2 = 1, both coefficients parabolas of omega_t.

    Wahlstrom and Eriksson (2011). Departure from them: below Psi_c = c_psi2 the flow grows (+), where their ellipse turns back.
    """
    c_psi1 = (c.c_w_psi1 * omega_t + c.c_w_psi2) * omega_t + c.c_w_psi3
    c_phi1 = max((c.c_w_phi1 * omega_t + c.c_w_phi2) * omega_t + c.c_w_phi3, LEAST_COEFFICIENT)
    above = Psi_c - c.c_psi2
    left = 1.0 - c_psi1 * above * above if above > 0.0 else 1.0 - c.k_neg * above / 0.1
    return max(c.c_phi2 + sqrt(max(left, 0.0) / c_phi1), 0.0)


@njit(cache=True)
def turbine_loss(c: DieselConstants, omega_t: float) -> float:
    """Return c_m [-], by which the turbine's efficiency falls with the square of the distance from the best blade speed ratio."""
    if c.turbine_form == CONSTANT:
        return c.c_m
    return loss_over_rotor_speed(c, omega_t)


@njit(cache=True)
def loss_over_rotor_speed(c: DieselConstants, omega_t: float) -> float:
    """Return c_m1 max(0, omega_t - c_m2)^c_m3; Wahlstrom and Eriksson (2011)."""
    beyond: float = max(omega_t - c.c_m2, 0.0) ** c.c_m3
    return c.c_m1 * beyond
