/* Eq. (26) and (36) by backward Euler on smoothed signals; the same operations in the same order as lpvobs.observer.recursion. */
#include <math.h>

#include "lpvobs.h"

#define R(x) ((real_t)(x))
#define LEAST 2U        /* samples that a window has on either side at least, if the segment has them */
#define HUGE_STATE 1e12 /* beyond any state in SI units */
#define N LPVOBS_STATES

typedef struct {
    uint32_t node; /* the lowest of the four */
    real_t weight[4];
    uint32_t outside;
} lpvobs_place;

uint32_t lpvobs_cell(const real_t nodes[], uint32_t count, real_t value, real_t *share)
{
    uint32_t i = 0U;
    real_t eta;
    while ((i < (count - 2U)) && (value > nodes[i + 1U])) {
        i++;
    }
    eta = (value - nodes[i]) * (R(1.0) / (nodes[i + 1U] - nodes[i])); /* Eq. (35) */
    if (eta < R(0.0)) {
        eta = R(0.0);
    } else if (eta > R(1.0)) {
        eta = R(1.0);
    } else {
        /* inside */
    }
    *share = eta;
    return i;
}

static lpvobs_place place_of(real_t fuel, real_t speed)
{
    lpvobs_place at;
    real_t eta_1;
    real_t eta_2;
    const uint32_t i = lpvobs_cell(lpvobs_fuel, LPVOBS_FUEL_NODES, fuel, &eta_1);
    const uint32_t j = lpvobs_cell(lpvobs_speed, LPVOBS_SPEED_NODES, speed, &eta_2);
    at.node = (j * LPVOBS_FUEL_NODES) + i;                    /* Eq. (23) */
    at.weight[0] = (R(1.0) - eta_1) * (R(1.0) - eta_2);       /* Eq. (34) */
    at.weight[1] = eta_1 * (R(1.0) - eta_2);
    at.weight[2] = (R(1.0) - eta_1) * eta_2;
    at.weight[3] = eta_1 * eta_2;
    at.outside = 0U;
    if ((fuel < lpvobs_fuel[0]) || (fuel > lpvobs_fuel[LPVOBS_FUEL_NODES - 1U]) || (speed < lpvobs_speed[0]) ||
        (speed > lpvobs_speed[LPVOBS_SPEED_NODES - 1U])) {
        at.outside = LPVOBS_OUTSIDE_MAP;
    }
    return at;
}

static uint32_t node_of(const lpvobs_place *at, uint32_t m)
{
    return at->node + (m % 2U) + ((m / 2U) * LPVOBS_FUEL_NODES);
}

static real_t over(const real_t values[LPVOBS_NODES], const lpvobs_place *at)
{
    return ((at->weight[0] * values[node_of(at, 0U)]) + (at->weight[1] * values[node_of(at, 1U)])) +
           ((at->weight[2] * values[node_of(at, 2U)]) + (at->weight[3] * values[node_of(at, 3U)])); /* Eq. (22) */
}

static uint32_t index_of(const lpvobs_state *s, uint32_t k)
{
    return (s->first + k) % LPVOBS_RING;
}

/* Seconds from held sample j to held sample k. */
static double between(const lpvobs_state *s, uint32_t j, uint32_t k)
{
    return s->time[index_of(s, k)] - s->time[index_of(s, j)];
}

/* Fill u with held sample k, its smoothed channels from a local quadratic with biweight window over the samples lo to hi. */
static void smooth(const lpvobs_state *s, uint32_t k, real_t u[LPVOBS_CHANNELS])
{
    uint32_t lo = k;
    uint32_t hi = k;
    uint32_t i;
    uint32_t c;
    double width = LPVOBS_HALF_WIDTH;
    real_t scale;
    real_t determinant;
    real_t s0 = R(0.0);
    real_t s1 = R(0.0);
    real_t s2 = R(0.0);
    real_t s3 = R(0.0);
    real_t s4 = R(0.0);
    real_t c00;
    real_t c01;
    real_t c02;
    real_t value[LPVOBS_SMOOTHED];
    for (c = 0U; c < LPVOBS_CHANNELS; c++) {
        u[c] = s->channel[index_of(s, k)][c];
    }
    while ((lo > 0U) && ((between(s, lo - 1U, k) < LPVOBS_HALF_WIDTH) || ((k - lo) < LEAST))) {
        lo--;
    }
    while (((hi + 1U) < s->held) && ((between(s, k, hi + 1U) < LPVOBS_HALF_WIDTH) || ((hi - k) < LEAST))) {
        hi++;
    }
    if ((hi - lo) >= LEAST) { /* fewer are too short for a quadratic */
        if (between(s, lo, k) > width) {
            width = between(s, lo, k);
        }
        if (between(s, k, hi) > width) {
            width = between(s, k, hi);
        }
        scale = R(1.0 / (1.001 * width));
        for (i = lo; i <= hi; i++) {
            const real_t tau = R(between(s, k, i)) * scale;
            const real_t t2 = tau * tau;
            const real_t w = (R(1.0) - t2) * (R(1.0) - t2);
            s0 += w;
            s1 += w * tau;
            s2 += w * t2;
            s3 += w * (t2 * tau);
            s4 += w * (t2 * t2);
        }
        c00 = (s2 * s4) - (s3 * s3);
        c01 = (s2 * s3) - (s1 * s4);
        c02 = (s1 * s3) - (s2 * s2);
        determinant = (s0 * c00) + (s1 * c01) + (s2 * c02);
        if ((determinant < R(0.0)) || (determinant > R(0.0))) { /* stamps that all but repeat have none */
            const real_t inverse = R(1.0) / determinant;
            for (c = 0U; c < LPVOBS_SMOOTHED; c++) {
                value[c] = R(0.0);
            }
            for (i = lo; i <= hi; i++) {
                const real_t tau = R(between(s, k, i)) * scale;
                const real_t t2 = tau * tau;
                const real_t w = ((R(1.0) - t2) * (R(1.0) - t2)) * inverse;
                const real_t value_weight = w * (c00 + (c01 * tau) + (c02 * t2));
                for (c = 0U; c < LPVOBS_SMOOTHED; c++) {
                    value[c] += value_weight * s->channel[index_of(s, i)][lpvobs_smoothed[c]];
                }
            }
            for (c = 0U; c < LPVOBS_SMOOTHED; c++) {
                const uint32_t to = lpvobs_smoothed[c];
                if ((value[c] >= lpvobs_range[to][0]) && (value[c] <= lpvobs_range[to][1])) {
                    u[to] = value[c];
                }
            }
        }
    }
}

/* Fill T with the inverse of the 3 x 3 matrix M, by its cofactors. */
static void invert(real_t M[N][N], real_t T[N][N])
{
    uint32_t i;
    uint32_t j;
    real_t factor;
    for (i = 0U; i < N; i++) {
        const uint32_t a = (i + 1U) % N;
        const uint32_t b = (i + 2U) % N;
        for (j = 0U; j < N; j++) {
            const uint32_t c = (j + 1U) % N;
            const uint32_t d = (j + 2U) % N;
            T[j][i] = (M[a][c] * M[b][d]) - (M[a][d] * M[b][c]);
        }
    }
    factor = R(1.0) / ((M[0][0] * T[0][0]) + (M[0][1] * T[1][0]) + (M[0][2] * T[2][0]));
    for (i = 0U; i < N; i++) {
        for (j = 0U; j < N; j++) {
            T[i][j] *= factor;
        }
    }
}

static uint32_t certified(const real_t parameters[LPVOBS_PARAMETERS])
{
    uint32_t m;
    uint32_t flags = 0U;
    for (m = 0U; m < LPVOBS_PARAMETERS; m++) {
        if (!((parameters[m] >= lpvobs_region[m][0]) && (parameters[m] <= lpvobs_region[m][1]))) {
            flags = LPVOBS_UNCERTIFIED;
        }
    }
#if LPVOBS_SUMS > 0
    for (m = 0U; m < LPVOBS_SUMS; m++) {
        if (!((parameters[lpvobs_sums[m][0]] + parameters[lpvobs_sums[m][1]]) >= R(0.0))) {
            flags = LPVOBS_UNCERTIFIED;
        }
    }
#endif
    return flags;
}

/* Move the map by the innovation e of a step of h seconds at a place of the map, with gain gamma; Eq. (36). */
static uint32_t move_map(lpvobs_state *s, const lpvobs_place *at, real_t h, real_t gamma, real_t e)
{
    uint32_t m;
    uint32_t flags = 0U;
    const real_t by = h * gamma * e;
    for (m = 0U; m < 4U; m++) {
        const uint32_t node = node_of(at, m);
        real_t theta = s->theta[node] + (by * at->weight[m]);
        if (theta > LPVOBS_LARGEST) {
            theta = LPVOBS_LARGEST;
            flags = LPVOBS_MAP_LIMIT;
        } else if (theta < -LPVOBS_LARGEST) {
            theta = -LPVOBS_LARGEST;
            flags = LPVOBS_MAP_LIMIT;
        } else {
            /* as it should be */
        }
        s->theta[node] = theta;
#if LPVOBS_FALLING
        s->driven[node] += h * at->weight[m];
        if (s->driven[node] > LPVOBS_MEMORY) {
            s->driven[node] = LPVOBS_MEMORY;
        }
#endif
    }
    return flags;
}

/* Fill u, behind the channels, with the signals that follow one of them: tau ds/dt = x - s. */
static void follow(lpvobs_state *s, uint32_t k, real_t u[LPVOBS_SIGNALS])
{
#if LPVOBS_FOLLOWERS
    const uint32_t at = index_of(s, k);
    uint32_t i;
    for (i = 0U; i < LPVOBS_FOLLOWERS; i++) {
        const real_t x = s->channel[at][lpvobs_followed[i]];
        if (s->begun == 0U) {
            s->following[i] = x;
        } else {
            s->following[i] = x + ((s->following[i] - x) * LPVOBS_POW(lpvobs_kept[i], R(s->time[at] - s->before)));
        }
        u[LPVOBS_CHANNELS + i] = s->following[i];
    }
#else
    (void)s;
    (void)k;
    (void)u;
#endif
}

/* Work on held sample k: Eq. (26), its map part local as in Eq. (36). */
static uint32_t observe(lpvobs_state *s, uint32_t k)
{
    uint32_t i;
    uint32_t j;
    uint32_t o;
    uint32_t flags;
    uint32_t sound = 1U;
    real_t u[LPVOBS_SIGNALS];
    real_t M[N][N];
    real_t T[N][N];
    real_t drive[N];
    real_t fresh[N];
    real_t lent[N];
    real_t h = R(0.0);
    real_t a;
    real_t b = R(1.0);
    real_t g;
    real_t e;
    real_t gamma = LPVOBS_GAMMA;
    real_t known;
    lpvobs_system sys;
    lpvobs_place at;

    smooth(s, k, u);
    follow(s, k, u);
    lpvobs_model(u, &sys);
    flags = certified(sys.parameters);
    if (s->begun == 0U) {
        lpvobs_measured(u, s->x);
        s->begun = 1U;
    } else {
        h = R(s->time[index_of(s, k)] - s->before);
    }
    s->before = s->time[index_of(s, k)];
    for (i = 0U; i < N; i++) {
        for (j = 0U; j < N; j++) {
            real_t constant = R(0.0);
            for (o = 0U; o < (LPVOBS_OUTPUTS - 1U); o++) {
                if (lpvobs_output_state[o] == j) {
                    constant += lpvobs_L[i][o];
                }
            }
            M[i][j] = ((i == j) ? R(1.0) : R(0.0)) + (h * (constant - sys.A[i][j]));
            M[i][j] += h * lpvobs_L[i][LPVOBS_OUTPUTS - 1U] * sys.C_2[j];
        }
        drive[i] = h * sys.E[i];
        for (o = 0U; o < LPVOBS_OUTPUTS; o++) {
            drive[i] += h * lpvobs_L[i][o] * u[lpvobs_output_channel[o]];
        }
    }
    invert(M, T);
    a = u[LPVOBS_SENSOR];
    for (i = 0U; i < N; i++) {
        real_t push = R(0.0);
        lent[i] = R(0.0);
        for (j = 0U; j < N; j++) {
            push += T[i][j] * drive[j];
            lent[i] += T[i][j] * lpvobs_L[j][LPVOBS_OUTPUTS - 1U];
        }
        lent[i] = h * lent[i];
        for (j = 0U; j < N; j++) {
            push += T[i][j] * s->x[j];
        }
        fresh[i] = push;
        a -= sys.C_2[i] * push;
        b -= sys.C_2[i] * lent[i];
    }
    at = place_of(u[LPVOBS_FUEL], u[LPVOBS_SPEED]);
    flags |= at.outside;
    known = over(s->theta, &at);
#if LPVOBS_FALLING
    gamma = LPVOBS_PACE / ((LPVOBS_PACE / gamma) + over(s->driven, &at));
#endif
    g = h * gamma *
        (((at.weight[0] * at.weight[0]) + (at.weight[1] * at.weight[1])) +
         ((at.weight[2] * at.weight[2]) + (at.weight[3] * at.weight[3])));
    e = (a - (b * known)) * (R(1.0) / (R(1.0) + (b * g)));
    for (i = 0U; i < N; i++) {
        fresh[i] -= lent[i] * (known + (g * e));
        if (!((fresh[i] >= R(-HUGE_STATE)) && (fresh[i] <= R(HUGE_STATE)))) {
            sound = 0U;
        }
    }
    if (!((e >= R(-HUGE_STATE)) && (e <= R(HUGE_STATE)))) {
        sound = 0U;
    }
    if (sound != 0U) {
        for (i = 0U; i < N; i++) {
            s->x[i] = fresh[i];
        }
        s->innovation = e;
        flags |= move_map(s, &at, h, gamma, e);
    } else {
        flags |= LPVOBS_RESET;
        lpvobs_measured(u, s->x);
    }
    return flags;
}

/* Work on held samples up to, not including, the one at `until`. */
static uint32_t work_on(lpvobs_state *s, uint32_t until, uint32_t *updates)
{
    uint32_t flags = 0U;
    while (s->done < until) {
        flags |= observe(s, s->done);
        s->done++;
        (*updates)++;
    }
    return flags;
}

/* Put a sample into the ring, with room made where it is full. */
static uint32_t take(lpvobs_state *s, const lpvobs_inputs *in, uint32_t *updates)
{
    uint32_t flags = 0U;
    uint32_t c;
    uint32_t at;
    if (s->held == LPVOBS_RING) {
        if (s->done == 0U) {
            flags |= work_on(s, 1U, updates);
        }
        if ((s->done == s->held) || (between(s, 0U, s->done) < LPVOBS_HALF_WIDTH)) {
            flags |= LPVOBS_WINDOW_CUT;
        }
        s->first = index_of(s, 1U);
        s->held--;
        s->done--;
    }
    at = index_of(s, s->held);
    s->time[at] = in->time;
    for (c = 0U; c < LPVOBS_CHANNELS; c++) {
        s->channel[at][c] = in->channel[c];
    }
    s->held++;
    return flags;
}

/* Return up to which held sample this step works: windows must be complete, and it is one sample, or two where many wait. */
static uint32_t ready(const lpvobs_state *s)
{
    const uint32_t most = s->done + (((s->held - s->done) > (LPVOBS_RING / 2U)) ? 2U : 1U);
    uint32_t k = s->done;
    while ((k < most) && ((k + LEAST) < s->held) && (between(s, k, s->held - 1U) >= LPVOBS_HALF_WIDTH)) {
        k++;
    }
    return k;
}

static uint32_t refused(lpvobs_state *s, const lpvobs_inputs *in)
{
    uint32_t c;
    uint32_t flags = 0U;
    if (!((in->time >= -LPVOBS_LATEST) && (in->time <= LPVOBS_LATEST))) {
        flags |= LPVOBS_BAD_TIME;
    } else if ((s->started != 0U) && (in->time <= s->latest)) {
        flags |= LPVOBS_BAD_TIME;
        s->backward++;
    } else {
        s->backward = 0U;
    }
    for (c = 0U; c < LPVOBS_CHANNELS; c++) {
        if (!((in->channel[c] >= lpvobs_range[c][0]) && (in->channel[c] <= lpvobs_range[c][1]))) {
            flags |= LPVOBS_BAD_CHANNEL;
        }
    }
    return flags;
}

void lpvobs_init(lpvobs_state *state)
{
    static const lpvobs_state nothing = {0};
    uint32_t node;
    *state = nothing;
    for (node = 0U; node < LPVOBS_NODES; node++) {
        state->theta[node] = lpvobs_map[node];
#if LPVOBS_FALLING
        state->driven[node] = lpvobs_driven[node];
#endif
    }
}

void lpvobs_step(const lpvobs_inputs *inputs, lpvobs_state *state, lpvobs_outputs *outputs)
{
    uint32_t i;
    uint32_t updates = 0U;
    uint32_t flags = refused(state, inputs);
    if (state->backward >= LPVOBS_RING) { /* not single stamps: the clock has begun anew */
        flags &= ~LPVOBS_BAD_TIME;
    }
    if (flags == 0U) {
        const lpvobs_place now = place_of(inputs->channel[LPVOBS_FUEL], inputs->channel[LPVOBS_SPEED]);
        const double step = inputs->time - state->latest;
        if ((state->started == 0U) || (step > LPVOBS_GAP) || (state->backward > 0U)) {
            flags |= work_on(state, state->held, &updates) | LPVOBS_NEW_SEGMENT;
            state->held = 0U;
            state->done = 0U;
            state->begun = 0U;
            state->backward = 0U;
        }
        state->started = 1U;
        state->latest = inputs->time;
        flags |= take(state, inputs, &updates);
        flags |= work_on(state, ready(state), &updates);
        flags |= now.outside;
        state->map_value = over(state->theta, &now);
    }
    if (state->begun == 0U) {
        flags |= LPVOBS_WAITING;
    }
    outputs->time = state->before;
    for (i = 0U; i < N; i++) {
        outputs->x[i] = state->x[i];
    }
    outputs->map_value = state->map_value;
    outputs->innovation = state->innovation;
    outputs->updates = updates;
    outputs->flags = flags;
}
