"""The diesel's relations, Eq. (1) and (2) with their functions, one after the other as a textbook lists them.

`k` is the nested record of engine constants; everything broadcasts, so one call serves a point, a log, or many logs at once.
The compressor passes nothing in stall, the EGR flow reverses with the pressures, and below ambient pressure the compressor
passes more than its ellipse: three additions to Wahlstrom and Eriksson (2011).
"""

import numpy as np


def compressor(k, p_im, omega_t, p_amb, T_amb):
    """Return W_c [kg/s] and P_c [W]."""
    gas, wheel = k.gas, k.compressor
    tip_speed = wheel.R_c * omega_t
    Pi_c = p_im / p_amb
    heating = Pi_c ** (1 - 1 / gas.gamma_a) - 1
    head = 2 * gas.c_pa * T_amb * heating / tip_speed**2
    if wheel.form == "tip_speed":
        centre, head_max = (0.0, 0.0), wheel.psi_0 + wheel.psi_1 * tip_speed / 400
        flow_max = wheel.phi_0 + wheel.phi_1 * tip_speed / 400
    else:  # half axes of c_psi1 (Psi - c_psi2)^2 + c_phi1 (Phi - c_phi2)^2 = 1; no compressor has a Phi_c above one
        centre = (wheel.c_psi2, wheel.c_phi2)
        head_max = np.polyval([wheel.c_w_psi1, wheel.c_w_psi2, wheel.c_w_psi3], omega_t) ** -0.5
        flow_max = np.maximum(np.polyval([wheel.c_w_phi1, wheel.c_w_phi2, wheel.c_w_phi3], omega_t), 1.0) ** -0.5
    above = head - centre[0]
    ellipse = np.sqrt(np.maximum(1 - (above / head_max) ** 2, 0.0))
    below = np.sqrt(1 + wheel.k_neg * np.maximum(-above, 0.0) / 0.1)
    Phi_c = np.maximum(centre[1] + flow_max * np.where(above >= 0, ellipse, below), 0.0)
    W_c = p_amb * np.pi * wheel.R_c**3 * Phi_c / (gas.R_a * T_amb) * omega_t
    a, b = W_c - wheel.W_c_opt, np.maximum(Pi_c - 1, 0.0) ** wheel.c_pi - wheel.pi_c_opt
    Q_11, Q_12, Q_22 = wheel.Q
    eta_c = np.clip(wheel.eta_c_max - (Q_11 * a**2 + 2 * Q_12 * a * b + Q_22 * b**2), wheel.eta_c_min, 1.0)
    return W_c, W_c * gas.c_pa * T_amb * np.maximum(heating, 0.0) / eta_c


def egr(k, p_im, p_em, u_egr, T_im, T_em):
    """Return W_egr [kg/s], positive from exhaust to intake."""
    gas, valve = k.gas, k.egr
    u = np.clip(u_egr, 0.0, -valve.c_egr2 / (2 * valve.c_egr1))
    A = valve.A_egr_max * (valve.c_egr1 * u**2 + valve.c_egr2 * u)

    def Psi(Pi):
        return 1 - ((1 - np.clip(Pi, valve.pi_egr_opt, 1.0)) / (1 - valve.pi_egr_opt) - 1) ** 2

    forward = A * p_em * Psi(p_im / p_em) / np.sqrt(T_em * gas.R_e)
    reverse = -valve.k_reverse * A * p_im * Psi(p_em / p_im) / np.sqrt(T_im * gas.R_a)
    return np.where(p_em >= p_im, forward, reverse)


def cylinder(k, p_im, n_e, u_delta, T_im):
    """Return W_ei and W_f [kg/s]."""
    eta_vol = k.filling.c_vol1 * np.sqrt(p_im) + k.filling.c_vol2 * np.sqrt(n_e) + k.filling.c_vol3
    W_ei = eta_vol * p_im * n_e * k.geometry.V_d / (120 * k.gas.R_a * T_im)
    return W_ei, 1e-6 / 120 * u_delta * n_e * k.geometry.n_cyl


def turbine(k, p_em, omega_t, u_vgt, T_em, p_amb):
    """Return W_t [kg/s] and P_t eta_m [W]; three passes for the back pressure that the flow makes for itself."""
    gas, wheel = k.gas, k.turbine
    root = np.sqrt(np.maximum(1 - ((u_vgt - wheel.c_vgt2) / wheel.c_vgt1) ** 2, 0.0))
    area = wheel.A_vgt_max * np.maximum(wheel.f_vgt_min, wheel.c_f2 + wheel.c_f1 * root)
    W_t = 0.0
    for _ in range(3):
        Pi_t = np.minimum((p_amb + wheel.k_exhaust * W_t**2) / p_em, 0.9999)
        W_t = area * p_em * np.sqrt(1 - Pi_t**wheel.K_t) / np.sqrt(T_em * gas.R_e)
    drop = 1 - Pi_t ** (1 - 1 / gas.gamma_e)
    BSR = wheel.R_t * omega_t / np.sqrt(2 * gas.c_pe * T_em * drop)
    c_m = wheel.c_m if wheel.form == "constant" else wheel.c_m1 * np.maximum(omega_t - wheel.c_m2, 0.0) ** wheel.c_m3
    eta_tm = np.clip(wheel.eta_tm_max - c_m * (BSR - wheel.bsr_opt) ** 2, wheel.eta_tm_min, 1.0)
    return W_t, eta_tm * W_t * gas.c_pe * T_em * drop


def flows(k, c):
    """Return all of Eq. (2) by name along channels `c`."""
    W_c, P_c = compressor(k, c["p_im"], c["omega_t"], c["p_amb"], c["T_amb"])
    W_ei, W_f = cylinder(k, c["p_im"], c["n_e"], c["u_delta"], c["T_im"])
    W_t, P_t = turbine(k, c["p_em"], c["omega_t"], c["u_vgt"], c["T_em"], c["p_amb"])
    W_egr = egr(k, c["p_im"], c["p_em"], c["u_egr"], c["T_im"], c["T_em"])
    return {"W_c": W_c, "P_c": P_c, "W_ei": W_ei, "W_f": W_f, "W_t": W_t, "P_t": P_t, "W_egr": W_egr}


def derivatives(k, c):
    """Return the right-hand sides of Eq. (1): dp_im/dt, dp_em/dt [Pa/s], domega_t/dt [rad/s^2]."""
    w = flows(k, c)
    dp_im = k.gas.R_a * c["T_im"] / k.geometry.V_im * (w["W_c"] + w["W_egr"] - w["W_ei"])
    dp_em = k.gas.R_e * c["T_em"] / k.geometry.V_em * (w["W_f"] + w["W_ei"] - w["W_t"] - w["W_egr"])
    return np.array([dp_im, dp_em, (w["P_t"] - w["P_c"]) / (k.turbine.J_t * c["omega_t"])])
