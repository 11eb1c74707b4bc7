/* The adaptive observer of Liu and Wang (2015) for a control unit: one step a sample, no heap, sqrt and pow of libm alone.
 *
 * A sample waits until the window around it is complete: state and map are late by the half width of the window and up to two
 * samples (lpvobs_outputs.time says which sample they belong to). What the map says at the operating point is of now.
 * Compile with -DLPVOBS_FLOAT for single precision; time stays double, since a float of 900 s counts in steps of 0.06 ms.
 */
#ifndef LPVOBS_H
#define LPVOBS_H

#include <stdint.h>

#if defined(__FINITE_MATH_ONLY__) && (__FINITE_MATH_ONLY__ != 0)
#error "compile without -ffast-math, -Ofast and -ffinite-math-only: they remove the guards against NaN"
#endif

#ifdef LPVOBS_FLOAT
typedef float real_t;
#define LPVOBS_SQRT(x) sqrtf(x)
#define LPVOBS_POW(x, y) powf((x), (y))
#else
typedef double real_t;
#define LPVOBS_SQRT(x) sqrt(x)
#define LPVOBS_POW(x, y) pow((x), (y))
#endif

#include "lpvobs_config.h"

#define LPVOBS_BAD_CHANNEL 1U  /* a reading is no number or out of range: the sample is dropped */
#define LPVOBS_BAD_TIME 2U     /* time is no number or not later than before: the sample is dropped */
#define LPVOBS_NEW_SEGMENT 4U  /* a gap: the state begins anew, the map goes on */
#define LPVOBS_UNCERTIFIED 8U  /* scheduling parameters outside the region of the certificate */
#define LPVOBS_OUTSIDE_MAP 16U /* operating point beyond the axes: the map is held */
#define LPVOBS_WINDOW_CUT 32U  /* samples come faster than stated: a window was cut short */
#define LPVOBS_RESET 64U       /* the state left all bounds and begins anew */
#define LPVOBS_MAP_LIMIT 128U  /* a node has reached the limit of the sensor's range */
#define LPVOBS_WAITING 256U    /* no state yet: the first window is not complete */

typedef struct {
    double time;                      /* s */
    real_t channel[LPVOBS_CHANNELS];  /* in the order, units and ranges of the enumeration in lpvobs_config.h */
} lpvobs_inputs;

typedef struct {
    double time[LPVOBS_RING];
    double before;                    /* s, time of the sample that x belongs to */
    double latest;                    /* s */
#if LPVOBS_FOLLOWERS
    real_t following[LPVOBS_FOLLOWERS]; /* signals without a sensor, behind the sample that x belongs to */
#endif
    real_t channel[LPVOBS_RING][LPVOBS_CHANNELS];
    real_t x[LPVOBS_STATES];
    real_t theta[LPVOBS_NODES];       /* kg/s, the map, speed by speed as in Eq. (23) */
#if LPVOBS_FALLING
    real_t driven[LPVOBS_NODES];      /* s, how long each node has been driven, up to LPVOBS_MEMORY */
#endif
    real_t map_value;
    real_t innovation;
    uint32_t first;                   /* place of the oldest sample */
    uint32_t held;                    /* samples in the ring */
    uint32_t done;                    /* of these, at the front, worked on already */
    uint32_t started;                 /* a sample has come */
    uint32_t begun;                   /* x holds a state of this segment */
    uint32_t backward;                /* samples in a row whose time was not later */
} lpvobs_state;

typedef struct {
    double time;                      /* s, of the sample that x belongs to */
    real_t x[LPVOBS_STATES];
    real_t map_value;                 /* kg/s, the map at the operating point of the inputs: subtract it from the reading */
    real_t innovation;                /* kg/s, y_m2 - C_2 x - Psi theta behind the last update */
    uint32_t updates;                 /* samples worked on in this step: one, at most two; at a gap all that wait */
    uint32_t flags;                   /* LPVOBS_BAD_CHANNEL and the following */
} lpvobs_outputs;

void lpvobs_init(lpvobs_state *state);
void lpvobs_step(const lpvobs_inputs *inputs, lpvobs_state *state, lpvobs_outputs *outputs);

/* The engine, in lpvobs_model.c: scheduling parameters, and A, E and the last row of C of Eq. (24); the measured states. */
typedef struct {
    real_t parameters[LPVOBS_PARAMETERS];
    real_t A[LPVOBS_STATES][LPVOBS_STATES];
    real_t E[LPVOBS_STATES];
    real_t C_2[LPVOBS_STATES];
} lpvobs_system;

/* Return the node below a value, and fill share with how far it is to the next one; outside, the end holds. */
uint32_t lpvobs_cell(const real_t nodes[], uint32_t count, real_t value, real_t *share);

/* u holds the channels, and behind them the followers. */
void lpvobs_model(const real_t u[LPVOBS_SIGNALS], lpvobs_system *system);
void lpvobs_measured(const real_t u[LPVOBS_CHANNELS], real_t x[LPVOBS_STATES]);

#endif
