/* A throttled engine with intercooler; the relations of lpvobs.engines.throttled.relations with their learned curves as tables. */
#include <math.h>

#include "lpvobs.h"

#define R(x) ((real_t)(x))
#define NEARLY_EQUAL R(0.999)
#define COUNT(a) ((uint32_t)(sizeof(a) / sizeof((a)[0])))

static real_t power(real_t x, real_t exponent)
{
    return LPVOBS_POW(x, exponent);
}

static real_t within(real_t x, real_t low, real_t high)
{
    real_t inside = x;
    if (x < low) {
        inside = low;
    } else if (x > high) {
        inside = high;
    } else {
        /* as it is */
    }
    return inside;
}

static real_t throttle_flow(const real_t u[LPVOBS_CHANNELS])
{
    const lpvobs_constants *c = &lpvobs_engine;
    const real_t k = c->gamma_a;
    const real_t critical = power(R(2.0) / (k + R(1.0)), k / (k - R(1.0)));
    const real_t ratio = within(u[LPVOBS_IN_p_im] / u[LPVOBS_IN_p_ic], critical, NEARLY_EQUAL);
    const real_t inside = power(ratio, R(2.0) / k) - power(ratio, (k + R(1.0)) / k);
    const real_t psi = LPVOBS_SQRT(R(2.0) * k / (k - R(1.0)) * inside);
    real_t share;
    const uint32_t i = lpvobs_cell(c->alpha_th, COUNT(c->alpha_th), u[LPVOBS_IN_alpha_th], &share);
    const real_t area = ((R(1.0) - share) * c->area[i]) + (share * c->area[i + 1U]);
    return area * (u[LPVOBS_IN_p_ic] * psi / LPVOBS_SQRT(c->R_a * u[LPVOBS_IN_T_ic]));
}

static real_t cylinder_flow(const real_t u[LPVOBS_CHANNELS])
{
    const lpvobs_constants *c = &lpvobs_engine;
    const uint32_t across = COUNT(c->p_im);
    real_t a;
    real_t b;
    const uint32_t i = lpvobs_cell(c->n_e, COUNT(c->n_e), u[LPVOBS_IN_n_e], &a);
    const uint32_t j = lpvobs_cell(c->p_im, across, u[LPVOBS_IN_p_im], &b);
    const uint32_t at = (i * across) + j;
    const real_t eta_vol = ((R(1.0) - a) * (R(1.0) - b) * c->eta_vol[at]) + ((R(1.0) - a) * b * c->eta_vol[at + 1U]) +
                           (a * (R(1.0) - b) * c->eta_vol[at + across]) + (a * b * c->eta_vol[at + across + 1U]);
    return eta_vol * (u[LPVOBS_IN_p_im] * u[LPVOBS_IN_n_e] * c->V_d / (R(120.0) * c->R_a * u[LPVOBS_IN_T_ic]));
}

void lpvobs_model(const real_t u[LPVOBS_SIGNALS], lpvobs_system *system)
{
    const lpvobs_constants *c = &lpvobs_engine;
    const real_t rho_th = throttle_flow(u) / u[LPVOBS_IN_p_ic];
    const real_t rho_cyl = cylinder_flow(u) / u[LPVOBS_IN_p_im];
    const real_t a_ic = c->R_a * u[LPVOBS_IN_T_ic] / c->V_ic;
    const real_t a_im = c->R_a * u[LPVOBS_IN_T_ic] / c->V_im;
    static const lpvobs_system empty = {0};
    *system = empty;
    system->parameters[0] = rho_th;
    system->parameters[1] = rho_cyl;
    system->parameters[2] = a_ic;
    system->parameters[3] = a_im;
    system->A[0][0] = -a_ic * rho_th;
    system->A[0][2] = a_ic;
    system->A[1][0] = a_im * rho_th;
    system->A[1][1] = -a_im * rho_cyl;
    system->C_2[2] = R(1.0);
}

void lpvobs_measured(const real_t u[LPVOBS_CHANNELS], real_t x[LPVOBS_STATES])
{
    x[0] = u[LPVOBS_IN_p_ic];
    x[1] = u[LPVOBS_IN_p_im];
    x[2] = throttle_flow(u);
}
