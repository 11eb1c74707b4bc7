"""One relation of the diesel per function, compiled, on scalars: SI units, openings in %, speed in rpm, fuel in mg/cycle.

Relations after Wahlstrom and Eriksson (2011), the paper's reference 16, with one change a small car engine needs, marked (+): a
compressor that passes more flow when the pressure ratio falls below one. Cylinders and EGR: `components.intake`.

A form that a component's relation may have is a name in `constants`, its formula here, and a line in the function that chooses.
The choice is the same for a whole log, so the compiler takes it out of the loops over samples.
"""

from math import pi, sqrt

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
    """Return Phi_c of c_psi1 (Psi_c - c_psi2)^2 + c_phi1 (Phi_c - c_phi2)^2 = 1, both coefficients parabolas of omega_t."""
    # Wahlstrom and Eriksson (2011). Departure from them: below Psi_c = c_psi2 the flow grows (+), where their ellipse turns
    # back.
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
    beyond: float = max(omega_t - c.c_m2, 0.0) ** c.c_m3
    return c.c_m1 * beyond  # Wahlstrom and Eriksson (2011)


TURBINE_PASSES = 3
"""Passes of the fixed point between the turbine's flow and its back pressure p_es = p_amb + k_exhaust W_t^2."""


@njit(cache=True)
def head(c: DieselConstants, p_im: float, p_amb: float) -> float:
    """Return (p_im / p_amb)^(1 - 1 / gamma_a) - 1 [-], the power that flow and work of the compressor have in common."""
    rise: float = (p_im / p_amb) ** (1.0 - 1.0 / c.gamma_a) - 1.0
    return rise


@njit(cache=True)
def compressor_efficiency(c: DieselConstants, W_c: float, p_im: float, p_amb: float) -> float:
    """Return eta_c [-] of Eq. (2): a quadratic around the best flow and pressure ratio, never below its floor."""
    from_flow = W_c - c.W_c_opt
    from_ratio = max(p_im / p_amb - 1.0, 0.0) ** c.c_pi - c.pi_c_opt
    loss = c.Q_11 * from_flow**2 + 2.0 * c.Q_12 * from_flow * from_ratio + c.Q_22 * from_ratio**2
    return min(max(c.eta_c_max - loss, c.eta_c_min), 1.0)


@njit(cache=True)
def rho_1_of(c: DieselConstants, head_: float, omega_t: float, p_amb: float, T_amb: float) -> float:
    """Return rho_1: Phi_c of Eq. (2) is an ellipse of the head coefficient Psi_c in the engine's form, zero in stall."""
    U = c.R_c * omega_t
    Phi_c = flow_coefficient(c, 2.0 * c.c_pa * T_amb * head_ / (U * U), omega_t)
    return p_amb * pi * c.R_c**3 * Phi_c / (c.R_a * T_amb)  # Eq. (3)


@njit(cache=True)
def vgt_area_ratio(c: DieselConstants, u_vgt: float) -> float:
    """Return f_vgt [-]: part of an ellipse over the vane opening [%], never below the leakage area."""
    inside = 1.0 - ((u_vgt - c.c_vgt2) / c.c_vgt1) ** 2
    return max(c.f_vgt_min, c.c_f2 + c.c_f1 * sqrt(max(inside, 0.0)))


@njit(cache=True)
def turbine_scale(c: DieselConstants, u_vgt: float, T_em: float) -> float:
    """Return rho_4 [kg/(s Pa)] of a turbine that expands into nothing."""
    return c.A_vgt_max * vgt_area_ratio(c, u_vgt) / sqrt(T_em * c.R_e)


@njit(cache=True)
def turbine_pass(
    c: DieselConstants, scale: float, p_es: float, p_em: float, p_amb: float
) -> tuple[float, float, float]:
    """Return rho_4 and Pi_t for a back pressure p_es, and the back pressure that this flow makes: one pass of the fixed point."""
    Pi_t = min(p_es / p_em, 0.9999)
    flow = scale * sqrt(1.0 - Pi_t**c.K_t)  # Eq. (3)
    return flow, Pi_t, p_amb + c.k_exhaust * (flow * p_em) ** 2


@njit(cache=True)
def turbine_power(c: DieselConstants, W_t: float, Pi_t: float, omega_t: float, T_em: float) -> float:
    """Return P_t eta_m [W] of Eq. (2)."""
    drop = 1.0 - Pi_t ** (1.0 - 1.0 / c.gamma_e)
    bsr = c.R_t * omega_t / sqrt(2.0 * c.c_pe * T_em * drop)
    eta_tm = min(max(c.eta_tm_max - turbine_loss(c, omega_t) * (bsr - c.bsr_opt) ** 2, c.eta_tm_min), 1.0)
    return eta_tm * W_t * c.c_pe * T_em * drop  # Eq. (2)


@njit(cache=True)
def rho_5(
    c: DieselConstants, rho_1_: float, head_: float, p_im: float, omega_t: float, p_amb: float, T_amb: float
) -> float:
    """Return rho_5 [1/s] of Eq. (3), so that P_c / (J_t omega_t) = rho_5 omega_t; zero where the compressor expands (+)."""
    # Written with rho_1 = p_amb pi R_c^3 Phi_c / (R_a T_amb), which the printed quotient contains.
    eta_c = compressor_efficiency(c, rho_1_ * omega_t, p_im, p_amb)
    return c.c_pa * T_amb * rho_1_ * max(head_, 0.0) / (c.J_t * omega_t * eta_c)  # Eq. (3)
