/* Runs the first samples of log.csv (no names, time first) through one of the three, and counts the instructions of the steps where
 * the machine has a clock that ticks with them: SysTick of QEMU's Cortex-M7 with -icount, 40 instructions a tick at 25 MHz.
 */
#include <stdio.h>

#include "ekf.h"
#include "lpvobs.h"

#ifndef SAMPLES
#define SAMPLES 60000
#endif

static double time[SAMPLES];
static real_t channel[SAMPLES][LPVOBS_CHANNELS];
#if !defined(EKF)
static lpvobs_state state;
static lpvobs_outputs out;
#endif

#if defined(__arm__)
#define SYST_CSR (*(volatile uint32_t *)0xE000E010)
#define SYST_RVR (*(volatile uint32_t *)0xE000E014)
#define SYST_CVR (*(volatile uint32_t *)0xE000E018)
static uint32_t now(void)
{
    return SYST_CVR;
}
#else
static uint32_t now(void)
{
    return 0U;
}
#endif

__attribute__((noinline)) void one_step(int k);
void one_step(int k)
{
#if defined(MODEL)
    static lpvobs_system sys;
    lpvobs_model(channel[k], &sys);
#elif defined(EKF)
    ekf_step(channel[k], (k == 0) ? (real_t)0.0 : (real_t)(time[k] - time[k - 1]));
#else
    lpvobs_inputs in;
    uint32_t c;
    in.time = time[k];
    for (c = 0U; c < LPVOBS_CHANNELS; c++) {
        in.channel[c] = channel[k][c];
    }
    lpvobs_step(&in, &state, &out);
#endif
}

int main(void)
{
    int samples = 0;
    int k;
    uint32_t i;
    double ticks = 0.0;
    double worst = 0.0;
    FILE *log = fopen("log.csv", "r");
    FILE *map;
    if (log == NULL) {
        return 2;
    }
    while ((samples < SAMPLES) && (fscanf(log, "%lf", &time[samples]) == 1)) {
        for (i = 0U; i < LPVOBS_CHANNELS; i++) {
            double value = 0.0;
            (void)fscanf(log, ",%lf", &value);
            channel[samples][i] = (real_t)value;
        }
        samples++;
    }
    fclose(log);
#if defined(__arm__)
    *(volatile uint32_t *)0xE000ED88 |= 0xF00000U;
    SYST_RVR = 0xFFFFFFU;
    SYST_CVR = 0U;
    SYST_CSR = 5U;
#endif
#if defined(EKF)
    ekf_start();
#else
    lpvobs_init(&state);
#endif
    for (k = 0; k < samples; k++) {
        const uint32_t before = now();
        double taken;
        one_step(k);
        taken = (double)((before - now()) & 0xFFFFFFU);
        ticks += taken;
        worst = (taken > worst) ? taken : worst;
    }
#if defined(EKF)
    printf("%d %g %g %lu\n", samples, 40.0 * ticks / samples, 40.0 * worst, (unsigned long)ekf_bytes());
#else
    printf("%d %g %g %lu\n", samples, 40.0 * ticks / samples, 40.0 * worst, (unsigned long)sizeof(state));
#endif
    map = fopen("map.csv", "w");
    for (i = 0U; (i < LPVOBS_NODES) && (map != NULL); i++) {
#if defined(EKF)
        fprintf(map, "%.17g\n", (double)ekf_map()[i]);
#else
        fprintf(map, "%.17g\n", (double)state.theta[i]);
#endif
    }
    return ((map == NULL) || (fclose(map) != 0)) ? 1 : 0;
}
