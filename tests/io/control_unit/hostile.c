/* Steps of a control unit whose inputs are whatever a broken sensor, clock or memory may give; the sanitizers watch. */
#include <math.h>
#include <stdio.h>

#include "lpvobs.h"

static uint32_t noise = 12345U;

static uint32_t drawn(uint32_t below)
{
    noise = (noise * 1664525U) + 1013904223U;
    return (noise >> 16U) % below;
}

int main(void)
{
    static lpvobs_state state;
    const double nasty[] = {NAN, INFINITY, -INFINITY, 0.0, -0.0, 1e300, -1e300, 5e-324, 1e38, -1.0, 1e-40};
    const double steps[] = {0.01, 0.01, 0.01, 0.01, 0.0, -0.01, 1e-12, 5e-324, 0.9, 3.0, 1e6, 1e300, NAN, INFINITY, -INFINITY};
    double time = 0.0;
    uint32_t k;
    uint32_t i;
    uint32_t seen = 0U;
    uint32_t unflagged = 0U;
    uint32_t updates = 0U;
    uint32_t most = 0U;
    lpvobs_init(&state);
    for (k = 0U; k < 10000U; k++) {
        lpvobs_inputs in;
        lpvobs_outputs out;
        uint32_t bad = 0U;
        const uint32_t phase = (k / 500U) % 3U; /* a fair clock, a broken one, one far too fast */
        const double step = (phase == 2U) ? 1e-4 : steps[drawn((phase == 0U) ? 4U : 15U)];
        const double stamp = (drawn(200U) == 0U) ? nasty[drawn(11U)] : time + step;
        in.time = stamp;
        if ((stamp > -1e8) && (stamp < 1e8)) {
            time = stamp;
        }
        for (i = 0U; i < LPVOBS_CHANNELS; i++) {
            const real_t low = lpvobs_range[i][0];
            const real_t high = lpvobs_range[i][1];
            in.channel[i] = low + ((high - low) * ((real_t)drawn(1001U) / (real_t)1000.0));
        }
        if (drawn(4U) == 0U) {
            const uint32_t c = drawn(LPVOBS_CHANNELS);
            in.channel[c] = (real_t)nasty[drawn(11U)];
            bad = ((in.channel[c] >= lpvobs_range[c][0]) && (in.channel[c] <= lpvobs_range[c][1])) ? 0U : 1U;
        }
        lpvobs_step(&in, &state, &out);
        seen |= out.flags;
        updates += out.updates;
        most = (out.updates > most) ? out.updates : most;
        unflagged += ((bad != 0U) && ((out.flags & LPVOBS_BAD_CHANNEL) == 0U)) ? 1U : 0U;
        for (i = 0U; i < LPVOBS_STATES; i++) {
            if (!isfinite(out.x[i])) {
                printf("step %u: state %u is not finite\n", k, i);
                return 1;
            }
        }
        for (i = 0U; i < LPVOBS_NODES; i++) {
            if (!isfinite(state.theta[i]) || (state.theta[i] > LPVOBS_LARGEST) || (state.theta[i] < -LPVOBS_LARGEST)) {
                printf("step %u: node %u is not within its limit\n", k, i);
                return 1;
            }
        }
        if (!isfinite(out.map_value) || !isfinite(out.innovation)) {
            printf("step %u: an output is not finite\n", k);
            return 1;
        }
    }
    printf("%u %u %u %u\n", seen, unflagged, updates, most);
    return 0;
}
