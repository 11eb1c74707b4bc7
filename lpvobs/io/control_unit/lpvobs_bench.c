/* The test bench: reads a log as CSV, writes the map as CSV, and on demand states and outputs sample by sample.
 *
 *   bench LOG.csv MAP.csv [STATES.csv]
 *
 * LOG.csv has a line of names, time among them, and numbers in the units of lpvobs_config.h; other columns are left out.
 */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "lpvobs.h"

#define LONGEST 16384
#define COLUMNS 1024U
#define OTHER (LPVOBS_CHANNELS + 1U) /* a column that nobody reads */

static lpvobs_state state;

static uint32_t place_of_name(const char *name)
{
    uint32_t c;
    for (c = 0U; c < LPVOBS_CHANNELS; c++) {
        if (strcmp(name, lpvobs_channel_names[c]) == 0) {
            return c;
        }
    }
    return (strcmp(name, "time") == 0) ? LPVOBS_CHANNELS : OTHER;
}

/* Fill `places` with what each column of the line of names holds; return the number of columns, 0 unless each is there once. */
static uint32_t heading(char *line, uint32_t places[COLUMNS])
{
    uint32_t times[OTHER + 1U] = {0U};
    uint32_t columns = 0U;
    uint32_t c;
    char *name = line;
    while ((name != NULL) && (columns < COLUMNS)) {
        char *end = name + strcspn(name, ",\r\n");
        char *next = (*end == ',') ? (end + 1) : NULL;
        *end = '\0';
        places[columns] = place_of_name(name);
        times[places[columns]]++;
        columns++;
        name = next;
    }
    for (c = 0U; c < OTHER; c++) {
        if (times[c] != 1U) {
            return 0U;
        }
    }
    return columns;
}

/* An empty or unreadable field is a missing reading. */
static void sample_of(const char *line, const uint32_t places[COLUMNS], uint32_t columns, lpvobs_inputs *in)
{
    uint32_t column;
    const char *at = line;
    const double missing = strtod("nan", NULL);
    in->time = missing;
    for (column = 0U; column < columns; column++) {
        char *end;
        double value = strtod(at, &end);
        if ((end == at) || ((*end != ',') && (*end != '\r') && (*end != '\n') && (*end != '\0'))) {
            value = missing;
        }
        if (places[column] == LPVOBS_CHANNELS) {
            in->time = value;
        } else if (places[column] != OTHER) {
            in->channel[places[column]] = (real_t)value;
        }
        at = strchr(at, ',');
        if (at == NULL) {
            break;
        }
        at++;
    }
}

static void write_map(FILE *out)
{
    uint32_t j;
    uint32_t i;
    fprintf(out, "%s,%s,delta_W_c,driven\n", lpvobs_channel_names[LPVOBS_SPEED], lpvobs_channel_names[LPVOBS_FUEL]);
    for (j = 0U; j < LPVOBS_SPEED_NODES; j++) {
        for (i = 0U; i < LPVOBS_FUEL_NODES; i++) {
            const uint32_t node = (j * LPVOBS_FUEL_NODES) + i;
#if LPVOBS_FALLING
            const double driven = (double)state.driven[node];
#else
            const double driven = 0.0;
#endif
            fprintf(out, "%.17g,%.17g,%.17g,%.9g\n", (double)lpvobs_speed[j], (double)lpvobs_fuel[i],
                    (double)state.theta[node], driven);
        }
    }
}

int main(int count, char **names)
{
    static char line[LONGEST];
    static uint32_t places[COLUMNS];
    unsigned long samples = 0UL;
    unsigned long dropped = 0UL;
    unsigned long segments = 0UL;
    unsigned long uncertified = 0UL;
    unsigned int seen = 0U;
    uint32_t columns;
    uint32_t i;
    FILE *log = (count >= 3) ? fopen(names[1], "r") : NULL;
    FILE *map = (log != NULL) ? fopen(names[2], "w") : NULL;
    FILE *states = ((map != NULL) && (count == 4)) ? fopen(names[3], "w") : NULL;
    lpvobs_inputs in = {0};
    lpvobs_outputs out;
    if ((map == NULL) || ((count == 4) && (states == NULL))) {
        fprintf(stderr, "usage: %s LOG.csv MAP.csv [STATES.csv]; or a file cannot be opened\n", names[0]);
        return 2;
    }
    if (fgets(line, LONGEST, log) == NULL) {
        line[0] = '\0';
    }
    columns = heading(line, places);
    if (columns == 0U) {
        fprintf(stderr, "%s: needs each of these columns once, with commas between: time", names[1]);
        for (columns = 0U; columns < LPVOBS_CHANNELS; columns++) {
            fprintf(stderr, ", %s", lpvobs_channel_names[columns]);
        }
        fprintf(stderr, "\n");
        return 3;
    }
    lpvobs_init(&state);
    while (fgets(line, LONGEST, log) != NULL) {
        sample_of(line, places, columns, &in);
        lpvobs_step(&in, &state, &out);
        samples++;
        dropped += ((out.flags & (LPVOBS_BAD_CHANNEL | LPVOBS_BAD_TIME)) != 0U) ? 1UL : 0UL;
        segments += ((out.flags & LPVOBS_NEW_SEGMENT) != 0U) ? 1UL : 0UL;
        uncertified += ((out.flags & LPVOBS_UNCERTIFIED) != 0U) ? 1UL : 0UL;
        seen |= out.flags;
        if ((states != NULL) && (out.updates > 0U)) {
            fprintf(states, "%.17g", out.time);
            for (i = 0U; i < LPVOBS_STATES; i++) {
                fprintf(states, ",%.17g", (double)out.x[i]);
            }
            fprintf(states, ",%.17g,%.17g,%u,%u\n", (double)out.innovation, (double)out.map_value, (unsigned)out.updates,
                    (unsigned)out.flags);
        }
    }
    in.time = state.latest + (2.0 * LPVOBS_GAP); /* what waits for the end of its window need wait no longer */
    lpvobs_step(&in, &state, &out);
    write_map(map);
    printf("%s\n", lpvobs_version);
    printf("%lu samples, %lu dropped, %lu segments, %lu outside the certificate; flags seen %u\n", samples, dropped, segments,
           uncertified, seen);
    printf("state %lu bytes, tables %lu bytes\n", (unsigned long)sizeof(lpvobs_state), (unsigned long)lpvobs_table_bytes);
    fclose(log);
    if (dropped == samples) {
        fprintf(stderr, "%s: no sample could be used; see the flags\n", names[1]);
        return 3;
    }
    return ((fclose(map) != 0) || ((states != NULL) && (fclose(states) != 0))) ? 1 : 0;
}
