"""The right-hand side of the plant: flows, temperatures and powers of a state, and how the state moves."""

from lpvobs.compiled import njit
from lpvobs.records import Array
from lpvobs.simulation import plant as relation
from lpvobs.simulation.instruments import cooler_effectiveness
from lpvobs.simulation.plant import OMEGA_T, P_EM, P_IM, T_IM, U_EGR1, U_EGR2, U_VGT, X_OEM, X_OIM, Inputs, Plant
from lpvobs.simulation.structure import Stage, compressor_stage, filling_factor, other_egr, other_turbine


@njit(cache=True)
def flows(plant: Plant, x: Array, given: Inputs) -> relation.Flows:
    """Return flows, temperatures and powers for state x, shape (9,)."""
    # The forms of another structure are called where they are at work: a call takes along all constants of the plant.
    c, b, s = plant.engine, plant.body, plant.structure
    p_im, p_em, omega_t, T_im = x[P_IM], x[P_EM], max(x[OMEGA_T], relation.SLOWEST_TURBINE), x[T_IM]
    W_ei = relation.cylinder_flow(plant, p_im, given.n_e, T_im)
    if s.wave + s.residual_gas + s.charge_heating > 0.0:
        W_ei *= filling_factor(s, given.n_e, p_im, p_em, T_im, given.T_wall, W_ei / c.V_d, b.compression_ratio)
    u_delta = max(0.0, min(given.u_demand, relation.smoke_limit(plant, W_ei, x[X_OIM], given.n_e)))
    W_f = 1e-6 / 120.0 * u_delta * given.n_e * c.n_cyl  # Eq. (2)
    needed = W_f * b.air_fuel_stoichiometric * b.X_Oc
    lambda_O = W_ei * x[X_OIM] / needed if needed > 0.0 else 1e9  # no fuel counts as lean
    W_eo = W_ei + W_f
    T_e = relation.cylinder_out_temperature(plant, W_ei, W_f, lambda_O, p_im, p_em, T_im)
    T_em = relation.pipe_temperature(plant, T_e, W_eo, given.T_amb)
    u_egr = relation.valve_position(plant, x[U_EGR1], x[U_EGR2])
    if s.compressor + s.pipes > 0.0:
        air = compressor_stage(plant, p_im, omega_t, given.p_amb, given.T_amb, T_em)
    else:
        W_c = relation.compressor_flow(plant, p_im, omega_t, given.p_amb, given.T_amb)
        air = Stage(W_c, given.p_amb, p_im, given.T_amb, 1.0, 0.0)
    heating = relation.compressor_heating(plant, air.W_c, air.p_out, air.p_in, air.T_in, air.loss)
    warming = heating + air.warming + (air.T_in - given.T_amb)
    effectiveness = b.effectiveness_intercooler
    if s.thermocouple > 0.0:
        effectiveness = cooler_effectiveness(s.thermocouple, b.effectiveness_intercooler, given.v_air, air.W_c / c.V_d)
    if s.turbine > 0.0:
        W_t, P_t = other_turbine(plant, p_em, x[U_VGT], omega_t, T_em, W_eo, given)
    else:
        W_t, Pi_t = relation.turbine_flow(plant, p_em, x[U_VGT], T_em, given.p_amb)
        P_t = relation.turbine_power(plant, W_t, Pi_t, omega_t, T_em)
    P_t *= relation.risen(plant.condition.turbine_curve, x[U_VGT])
    if s.egr > 0.0:
        W_egr = other_egr(plant, p_im, p_em, u_egr, T_im, T_em, given.n_e, u_delta)
    else:
        W_egr = relation.egr_flow(plant, p_im, p_em, u_egr, T_im, T_em)
    return relation.Flows(
        air.W_c,
        W_egr,
        W_ei,
        W_f,
        W_t,
        relation.intake_leak(plant, p_im, T_im, given.p_amb, given.T_amb),
        u_delta,
        u_egr,
        T_em,
        max(0.0, W_ei * x[X_OIM] - needed) / W_eo,
        (1.0 - effectiveness) * warming,
        air.W_c * c.c_pa * heating,  # Eq. (2)
        P_t,
    )


@njit(cache=True)
def mixed_temperature(plant: Plant, f: relation.Flows, T_im: float, T_amb: float) -> float:
    """Return the temperature [K] of cooled charge air, cooled EGR and air from a leak together, weighted with W c_p (+)."""
    c, b = plant.engine, plant.body
    charge = T_amb + f.charge_warming
    recirculated = f.T_em - b.effectiveness_egr * (f.T_em - b.T_cool)
    air, exhaust, drawn_in = f.W_c * c.c_pa, max(f.W_egr, 0.0) * c.c_pe, max(-f.W_leak, 0.0) * c.c_pa
    if air + exhaust + drawn_in <= 0.0:
        return T_im
    return (air * charge + exhaust * recirculated + drawn_in * T_amb) / (air + exhaust + drawn_in)


@njit(cache=True)
def derivative(plant: Plant, x: Array, given: Inputs, out: Array) -> None:
    """Write dx/dt for state x, both of shape (9,), into `out`.

    Departure from the paper's Eq. (1): dp_im/dt has the term (p_im / T_im) dT_im/dt, because T_im is a state here.
    """
    c, b = plant.engine, plant.body
    f = flows(plant, x, given)
    p_im, T_im = x[P_IM], x[T_IM]
    fill = c.R_a * T_im / c.V_im
    empty = c.R_e * f.T_em / c.V_em
    dT_im = (mixed_temperature(plant, f, T_im, given.T_amb) - T_im) / b.tau_T_im
    oxygen_in = (x[X_OEM] - x[X_OIM]) * max(f.W_egr, 0.0) + (b.X_Oc - x[X_OIM]) * (f.W_c + max(-f.W_leak, 0.0))
    oxygen_out = (f.X_Oe - x[X_OEM]) * (f.W_ei + f.W_f) + (x[X_OIM] - x[X_OEM]) * max(-f.W_egr, 0.0)
    out[P_IM] = fill * (f.W_c + f.W_egr - f.W_ei - f.W_leak) + p_im / T_im * dT_im  # Eq. (1)
    out[P_EM] = empty * (f.W_ei + f.W_f - f.W_t - f.W_egr)  # Eq. (1)
    out[X_OIM] = fill / p_im * oxygen_in
    out[X_OEM] = empty / x[P_EM] * oxygen_out
    out[OMEGA_T] = (f.P_t - f.P_c) / (c.J_t * max(x[OMEGA_T], relation.SLOWEST_TURBINE))  # Eq. (1)
    out[U_EGR1] = (given.u_egr - x[U_EGR1]) / b.tau_egr1
    out[U_EGR2] = (given.u_egr - x[U_EGR2]) / b.tau_egr2
    out[U_VGT] = (given.u_vgt - x[U_VGT]) / b.tau_vgt
    out[T_IM] = dT_im
