/* A diesel with EGR and VGT, Eq. (2), (3) and (5); the relations of lpvobs.engines.diesel.relations, in the same order. */
#include <math.h>

#include "lpvobs.h"

#define R(x) ((real_t)(x))
#define TURBINE_PASSES 3U
#define TIP_SPEED R(0.5)          /* compressor_form below: tip_speed; above: rotor_speed */
#define CONSTANT_LOSS R(0.5)      /* turbine_form below: constant; above: rotor_speed */
#define LEAST_COEFFICIENT R(1.0)
#define PI R(3.14159265358979323846)
#if LPVOBS_CORRECTED
#define COUNT(a) ((uint32_t)(sizeof(a) / sizeof((a)[0])))
#define SLOWEST R(60.0)       /* rpm; lpvobs.engines.components.intake */
#define USUAL_CHARGE R(320.0) /* K; lpvobs.engines.components.intake */
#define USUAL_RATIO R(1.2)    /* p_em / p_im; lpvobs.engines.diesel.corrections */
#define USUAL_HEAT R(600.0)   /* K; lpvobs.engines.diesel.corrections */

typedef struct {
    uint32_t low; /* the node below */
    real_t share; /* of the node above */
} place;
#endif

static real_t root(real_t x)
{
    return LPVOBS_SQRT(x);
}

static real_t power(real_t x, real_t exponent)
{
    return LPVOBS_POW(x, exponent);
}

static real_t least(real_t a, real_t b)
{
    return (a < b) ? a : b;
}

static real_t most(real_t a, real_t b)
{
    return (a > b) ? a : b;
}

static real_t flow_coefficient(real_t Psi_c, real_t omega_t)
{
    const lpvobs_constants *c = &lpvobs_engine;
    real_t Phi_c = R(0.0);
    if (c->compressor_form < TIP_SPEED) {
        const real_t U = c->R_c * omega_t;
        const real_t Phi_max = c->phi_0 + (c->phi_1 * U / R(400.0));
        if (Psi_c < R(0.0)) {
            Phi_c = Phi_max * root(R(1.0) - (c->k_neg * Psi_c / R(0.1)));
        } else {
            const real_t ratio = Psi_c / (c->psi_0 + (c->psi_1 * U / R(400.0)));
            if (ratio < R(1.0)) {
                Phi_c = Phi_max * root(R(1.0) - (ratio * ratio));
            }
        }
    } else {
        const real_t c_psi1 = (((c->c_w_psi1 * omega_t) + c->c_w_psi2) * omega_t) + c->c_w_psi3;
        const real_t c_phi1 =
            most((((c->c_w_phi1 * omega_t) + c->c_w_phi2) * omega_t) + c->c_w_phi3, LEAST_COEFFICIENT);
        const real_t above = Psi_c - c->c_psi2;
        real_t left;
        if (above > R(0.0)) {
            left = R(1.0) - (c_psi1 * above * above);
        } else {
            left = R(1.0) - (c->k_neg * above / R(0.1));
        }
        Phi_c = most(c->c_phi2 + root(most(left, R(0.0)) / c_phi1), R(0.0));
    }
    return Phi_c;
}

static real_t compressor_efficiency(real_t W_c, real_t ratio)
{
    const lpvobs_constants *c = &lpvobs_engine;
    const real_t from_flow = W_c - c->W_c_opt;
    const real_t from_ratio = power(most(ratio - R(1.0), R(0.0)), c->c_pi) - c->pi_c_opt;
    const real_t loss = (c->Q_11 * (from_flow * from_flow)) + (R(2.0) * c->Q_12 * from_flow * from_ratio) +
                        (c->Q_22 * (from_ratio * from_ratio));
    return least(most(c->eta_c_max - loss, c->eta_c_min), R(1.0));
}

#if LPVOBS_CORRECTED
/* The corrections that an estimate or a calibration has found: tables between nodes, linear as in lpvobs.engines.curves. */
static place at(const real_t nodes[], uint32_t count, real_t value)
{
    place found;
    found.low = lpvobs_cell(nodes, count, value, &found.share);
    return found;
}

static real_t on_line(const real_t values[], uint32_t first, place k)
{
    return ((R(1.0) - k.share) * values[first + k.low]) + (k.share * values[first + k.low + 1U]);
}

static real_t on_surface(const real_t values[], uint32_t first, place j, uint32_t columns, place k)
{
    const uint32_t row = first + (j.low * columns);
    return ((R(1.0) - j.share) * on_line(values, row, k)) + (j.share * on_line(values, row + columns, k));
}

/* Return what is added to Phi_c, of that without pressure rise. */
static real_t compressor_correction(real_t Psi_c, real_t U)
{
    const lpvobs_constants *c = &lpvobs_engine;
    const uint32_t across = COUNT(c->compressor_Psi_c);
    const place j = at(c->compressor_U_c, COUNT(c->compressor_U_c), U);
    const place k = at(c->compressor_Psi_c, across, Psi_c);
    return on_surface(c->compressor, 0U, j, across, k);
}

/* Return the relative change of the volumetric efficiency. */
static real_t filling_correction(const real_t u[LPVOBS_SIGNALS])
{
    const lpvobs_constants *c = &lpvobs_engine;
    const real_t T_im = u[LPVOBS_IN_T_im];
    const uint32_t across = COUNT(c->eta_vol_p_im);
    const uint32_t densities = COUNT(c->eta_vol_waves_p_im);
    const place j = at(c->eta_vol_n_e, COUNT(c->eta_vol_n_e), u[LPVOBS_IN_n_e]);
    const place k = at(c->eta_vol_p_im, across, u[LPVOBS_IN_p_im]);
    const place wave = at(c->eta_vol_waves_turn, COUNT(c->eta_vol_waves_turn), R(6e4) / most(u[LPVOBS_IN_n_e], SLOWEST) * root(T_im / USUAL_CHARGE));
    const place dense = at(c->eta_vol_waves_p_im, densities, u[LPVOBS_IN_p_im]);
    return on_surface(c->eta_vol, 0U, j, across, k) + on_surface(c->eta_vol_waves, 0U, wave, densities, dense) +
           (c->eta_vol_heat * ((u[LPVOBS_IN_T_ports] - USUAL_HEAT) / R(100.0))) +
           (c->eta_vol_exhaust * ((u[LPVOBS_IN_p_em] / u[LPVOBS_IN_p_im]) - USUAL_RATIO)) +
           (c->eta_vol_charge * ((T_im - USUAL_CHARGE) / R(100.0)));
}

/* Return the flow that is added to that of the EGR valve, of that of the open nozzle. */
static real_t egr_correction(const real_t u[LPVOBS_SIGNALS])
{
    const lpvobs_constants *c = &lpvobs_engine;
    const uint32_t rows = COUNT(c->egr_p_im_over_p_em);
    const uint32_t columns = COUNT(c->egr_u_delta);
    const place i = at(c->egr_u_egr, COUNT(c->egr_u_egr), u[LPVOBS_IN_u_egr]);
    const place j = at(c->egr_p_im_over_p_em, rows, u[LPVOBS_IN_p_im] / u[LPVOBS_IN_p_em]);
    const place k = at(c->egr_u_delta, columns, u[LPVOBS_IN_u_delta]);
    const uint32_t slab = i.low * rows * columns;
    return ((R(1.0) - i.share) * on_surface(c->egr, slab, j, columns, k)) +
           (i.share * on_surface(c->egr, slab + (rows * columns), j, columns, k));
}
#endif

static real_t egr_flow_function(real_t ratio)
{
    const lpvobs_constants *c = &lpvobs_engine;
    const real_t Pi = least(most(ratio, c->pi_egr_opt), R(1.0));
    const real_t away = ((R(1.0) - Pi) / (R(1.0) - c->pi_egr_opt)) - R(1.0);
    return R(1.0) - (away * away);
}

static real_t egr(const real_t u[LPVOBS_SIGNALS])
{
    const lpvobs_constants *c = &lpvobs_engine;
    const real_t p_im = u[LPVOBS_IN_p_im];
    const real_t p_em = u[LPVOBS_IN_p_em];
    const real_t opening = least(most(u[LPVOBS_IN_u_egr], R(0.0)), R(-0.5) * c->c_egr2 / c->c_egr1);
    const real_t area = c->A_egr_max * ((c->c_egr1 * opening) + c->c_egr2) * opening;
    real_t rho_2;
    if (p_em >= p_im) {
        rho_2 = area * egr_flow_function(p_im / p_em) / root(u[LPVOBS_IN_T_em] * c->R_e); /* Eq. (3) */
    } else {
        const real_t reverse =
            c->k_reverse * area * p_im * egr_flow_function(p_em / p_im) / root(u[LPVOBS_IN_T_im] * c->R_a);
        rho_2 = -reverse / p_em;
    }
#if LPVOBS_CORRECTED
    rho_2 += egr_correction(u) * area / root(u[LPVOBS_IN_T_em] * c->R_e);
#endif
    return rho_2;
}

static real_t turbine_loss(real_t omega_t)
{
    const lpvobs_constants *c = &lpvobs_engine;
    real_t loss = c->c_m;
    if (c->turbine_form > CONSTANT_LOSS) {
        loss = c->c_m1 * power(most(omega_t - c->c_m2, R(0.0)), c->c_m3);
    }
    return loss;
}

/* Return rho_4 of Eq. (3) and fill power with P_t eta_m of Eq. (2). */
static real_t turbine(const real_t u[LPVOBS_SIGNALS], real_t *delivered)
{
    const lpvobs_constants *c = &lpvobs_engine;
    const real_t p_em = u[LPVOBS_IN_p_em];
    const real_t T_em = u[LPVOBS_IN_T_em];
    const real_t omega_t = u[LPVOBS_IN_omega_t];
    const real_t vanes = (u[LPVOBS_IN_u_vgt] - c->c_vgt2) / c->c_vgt1;
    const real_t area = most(c->f_vgt_min, c->c_f2 + (c->c_f1 * root(most(R(1.0) - (vanes * vanes), R(0.0)))));
    const real_t scale = c->A_vgt_max * area / root(T_em * c->R_e);
    real_t p_es = u[LPVOBS_IN_p_amb];
    real_t flow = R(0.0);
    real_t Pi_t = R(0.9999);
    real_t drop;
    real_t bsr;
    real_t away;
    real_t eta_tm;
    uint32_t pass;
    for (pass = 0U; pass < TURBINE_PASSES; pass++) {
        Pi_t = least(p_es / p_em, R(0.9999));
        flow = scale * root(R(1.0) - power(Pi_t, c->K_t)); /* Eq. (3) */
        p_es = u[LPVOBS_IN_p_amb] + (c->k_exhaust * ((flow * p_em) * (flow * p_em)));
    }
    drop = R(1.0) - power(Pi_t, R(1.0) - (R(1.0) / c->gamma_e));
    bsr = c->R_t * omega_t / root(R(2.0) * c->c_pe * T_em * drop);
    away = bsr - c->bsr_opt;
    eta_tm = least(most(c->eta_tm_max - (turbine_loss(omega_t) * (away * away)), c->eta_tm_min), R(1.0));
    *delivered = eta_tm * (flow * p_em) * c->c_pe * T_em * drop; /* Eq. (2) */
    return flow;
}

void lpvobs_model(const real_t u[LPVOBS_SIGNALS], lpvobs_system *system)
{
    const lpvobs_constants *c = &lpvobs_engine;
    const real_t p_im = u[LPVOBS_IN_p_im];
    const real_t omega_t = u[LPVOBS_IN_omega_t];
    const real_t T_im = u[LPVOBS_IN_T_im];
    const real_t p_amb = u[LPVOBS_IN_p_amb];
    const real_t T_amb = u[LPVOBS_IN_T_amb];
    const real_t U = c->R_c * omega_t;
    const real_t rise = power(p_im / p_amb, R(1.0) - (R(1.0) / c->gamma_a)) - R(1.0);
    const real_t Psi_c = R(2.0) * c->c_pa * T_amb * rise / (U * U);
#if LPVOBS_CORRECTED
    const real_t Phi_c =
        flow_coefficient(Psi_c, omega_t) + (compressor_correction(Psi_c, U) * flow_coefficient(R(0.0), omega_t));
    const real_t changed = R(1.0) + filling_correction(u);
#else
    const real_t Phi_c = flow_coefficient(Psi_c, omega_t);
    const real_t changed = R(1.0);
#endif
    const real_t rho_1 = p_amb * PI * (c->R_c * (c->R_c * c->R_c)) * Phi_c / (c->R_a * T_amb); /* Eq. (3) */
    const real_t rho_2 = egr(u);
    const real_t n_e = u[LPVOBS_IN_n_e];
    const real_t eta_vol = ((c->c_vol1 * root(p_im)) + (c->c_vol2 * root(most(n_e, R(0.0)))) + c->c_vol3) * changed;
    const real_t rho_3 = eta_vol * n_e * c->V_d / (R(120.0) * c->R_a * T_im); /* Eq. (3) */
    const real_t eta_c = compressor_efficiency(rho_1 * omega_t, p_im / p_amb);
    const real_t rho_5 = c->c_pa * T_amb * rho_1 * most(rise, R(0.0)) / (c->J_t * omega_t * eta_c); /* Eq. (3) */
    const real_t a_1 = c->R_a * T_im / c->V_im;               /* Eq. (5) */
    const real_t a_2 = c->R_e * u[LPVOBS_IN_T_em] / c->V_em;  /* Eq. (5) */
    real_t delivered;
    const real_t rho_4 = turbine(u, &delivered);

    system->parameters[0] = rho_1;
    system->parameters[1] = rho_2;
    system->parameters[2] = rho_3;
    system->parameters[3] = rho_4;
    system->parameters[4] = rho_5;
    system->parameters[5] = a_1;
    system->parameters[6] = a_2;
    system->A[0][0] = -a_1 * rho_3; /* Eq. (5) */
    system->A[0][1] = a_1 * rho_2;
    system->A[0][2] = a_1 * rho_1;
    system->A[1][0] = a_2 * rho_3;
    system->A[1][1] = -a_2 * (rho_2 + rho_4);
    system->A[1][2] = R(0.0);
    system->A[2][0] = R(0.0);
    system->A[2][1] = R(0.0);
    system->A[2][2] = -rho_5;
    system->E[0] = R(0.0);
    system->E[1] = a_2 * (R(1e-6 / 120.0) * c->n_cyl * n_e * u[LPVOBS_IN_u_delta]); /* Eq. (2), (5) */
    system->E[2] = delivered / (c->J_t * omega_t);                                  /* Eq. (5) */
    system->C_2[0] = R(0.0);
    system->C_2[1] = R(0.0);
    system->C_2[2] = rho_1; /* Eq. (25) */
}

void lpvobs_measured(const real_t u[LPVOBS_CHANNELS], real_t x[LPVOBS_STATES])
{
    x[0] = u[LPVOBS_IN_p_im];
    x[1] = u[LPVOBS_IN_p_em];
    x[2] = u[LPVOBS_IN_omega_t];
}
