/* What $origin says of observer and engine; SI units.
 * State: $double bytes in double, $float in single precision.
 * States: $states. Parameters: $parameters. */
#ifndef LPVOBS_CONFIG_H
#define LPVOBS_CONFIG_H
$constants
#define LPVOBS_HALF_WIDTH $half_width /* s */
#define LPVOBS_GAP $gap /* s */
#define LPVOBS_LATEST 1e9 /* s: 30 years, which a double counts in steps of a tenth of a microsecond */
enum {
$channels
    LPVOBS_IN_END
};
typedef struct {
$members
} lpvobs_constants;
extern const lpvobs_constants lpvobs_engine;
$tables
extern const char *const lpvobs_channel_names[LPVOBS_CHANNELS];
extern const char lpvobs_version[$length];
extern const uint32_t lpvobs_table_bytes;
#endif
