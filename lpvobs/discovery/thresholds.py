"""Every tuned number of the search for effects: value, [unit], meaning, and the run that set it.

One constant, one docstring: `[unit] what it decides. Set by ...`. `make thresholds` reads this file, records how near the
decisions of a small bank come to each value, halves and doubles those that decide, and writes what changes to
`benchmarks/results/thresholds.md`. It replaces values before the rest of the package is imported: this module imports nothing.
"""

LEAST_SHARE = 0.008
"""[1] Share of the noise's sum of squares that an effect must explain. Set by clean logs of all cycles, seeds 1000 to 1009: what
smoothing and a bilinear map leave gained 0.0015 at most with constants anywhere in their tolerance; this is five times that."""
MOST_STRUCTURE = 0.02
"""[1] Share of the noise's sum of squares that sizes which change from block to block may gain before a residual counts as
unexplained. Set by clean logs of all cycles, which stay under 0.003."""
SLOWEST = 0.055
"""[s] Sample spacing up to which a residual without a name says something of the engine. Set by clean logs on all cycles: none at
20 and 50 Hz leaves a residual; at 10 and 5 Hz every cycle does, the windows that hold enough samples blur fast transients."""
WEAKEST = 15.1
"""[1] Squared distance from none, in standard deviations, that an effect keeps when all are fitted together. Set by choice: one in
ten thousand by chance."""
