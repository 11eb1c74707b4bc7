"""Every tuned number of the search for effects: value, [unit], meaning, and the run that set it.

One constant, one docstring: `[unit] what it decides. Set by ...`. `make thresholds` reads this file, records how near the
decisions of a small bank come to each value, halves and doubles those that decide, and writes what changes to
`benchmarks/results/thresholds.md`. It replaces values before the rest of the package is imported: this module imports nothing.
"""

# --- Where residuals are taken ---------------------------------------------------------------------------------------------
SPACING = 0.0973
"""[s] Between instants: no simple part of a second, so that what happens on the second (set-points of a cycle, tasks of a control
unit) is seen at all phases. Set by clean logs of all cycles: at tenths, kinks at whole seconds looked like a delay of half a
millisecond."""
MOST_INSTANTS = 15000
"""[1] Instants of all logs; beyond 25 minutes they lie farther apart. Set by time: one hour of driving is searched within a
minute."""
LEAST_DRIVEN = 60.0
"""[s] Of driving without a gap that a log must hold. Set by choice: three kept stretches."""
HALF_WIDTH = 0.1
"""[s] Of the windows around instants. Set by choice: narrower ones blur fast transients less and let more noise through."""
WIDER = 1.5
"""[1] How much wider the windows are that tell what a size owes to their width. Set by trial, no run is recorded."""
LEAST_SAMPLES = 14
"""[1] Samples that a window must hold. Set by choice: seven for each half of the samples, for a parabola through them."""
MOST_LEVELS = 3
"""[1] Values of a channel up to which it is a switch. Set by choice: on, off, and not known."""
PAUSE = 60.0
"""[s] Between two logs on the common clock. Set by choice: longer than the noise is remembered."""
WIDE = 0.5
"""[s] Half width of the windows for rates of slow signals, of which narrower ones see mostly noise. Set by choice: a temperature
behind a sensor that takes seconds."""
BLOCK = 2.0
"""[s] Resolution of the search for onsets. Set by time; `sharpened` finds the instant afterwards."""
MOST_BLOCKS = 400
"""[1] Stretches between which onsets are sought. Set by time: the search grows with their square."""
STRETCH = 20.0
"""[s] That are kept from fits and choices together. Set by choice: long against memory, short against a drive."""
EVERY = 5
"""[1] Of so many stretches one is kept. Set by choice: a fifth."""
COARSE = 10.0
"""[s] Whose sums are taken as independent. Set by choice: longer than the residual of a clean log is correlated."""
GUARD = 1.0
"""[s] At either end of a kept stretch, neither used nor judged. Set by choice: farther than any window or lag reaches."""
TRANSIENT = (0.7, 0.85, 0.93, 0.97, 0.99)
"""[1] Quantiles that part the classes of transience of instants. Set by choice: the fastest hundredth is a class of its own."""
NEAR = 0.1
"""[1] Share of a half width between the two values whose difference is a rate. Set by rounding against curvature."""

# --- How residuals are weighted --------------------------------------------------------------------------------------------
LEAST_IN_CELL = 5.0
"""[1] Instants of the average cell that every cell is given. Set by choice: one far from any visit has a covariance, too."""
FIRST_NOISE = 1e-3
"""[kg/s] Noise of every balance before anything is known of it. Set by choice: any value; the first pass replaces it."""
SHORT = 4.0
"""[s] Over which errors of a learned model are forgotten. Set by trial on the healthy recording of the real engine, no run is
recorded."""
AT_ONCE = 0.25
"""[1] Share of them that is forgotten from block to block. Set by trial on the same recording."""
SLOW = 100.0
"""[s] Over which their slow part is forgotten. Set by trial on the same recording."""
MOST_STRETCHED = 3.0
"""[1] Factor on the scale of an outlier. Set by choice: a second fault must not pass for one."""

# --- How models are fitted -------------------------------------------------------------------------------------------------
STEP = 1e-4
"""[1] Relative step of difference quotients by constants. Set by rounding against curvature."""
EFFECT_STEP = 0.02
"""[1] Step of difference quotients by an effect, as a share of its noticeable size. Set by rounding against curvature."""
WIDEST = 100.0
"""[1] Prior standard deviation of an accepted effect in noticeable sizes. Set by choice: none to speak of."""
ANEW = 5
"""[1] Steps after which derivatives by the unknowns are taken anew. Set by time: they change little, and are most of the work."""
MOST_STEPS = 12
"""[1] Gauss-Newton steps between two sets of weights. Set by time; a fit that needs more is started anew with new weights."""
STILL = 1.0
"""[1] Gain, twice and in units of the noise, below which a further step is not worth taking. Set by choice: half a nat."""
PIN = 1e6
"""[1] Precision of a pinned unknown in units of its prior's. Set by rounding."""
FARTHEST = 2.0
"""[1] Standard deviations of its prior within which an unknown is sought. Set by choice: 15 % beyond a uniform tolerance."""
SIZE_PASSES = 6
"""[1] Gauss-Newton steps in the size of one candidate. Set by time."""
STRONG = 5.0
"""[1] Standard deviations of its own noise by which the information about a size must exceed zero. Set by choice."""
LEVEL_PASSES = 2
"""[1] Times that the levels of a day are sought about the last ones. Set by choice: a gain moves a balance in a curve."""
LEVEL_SHARE = 0.333
"""[1] Share of the places that are independent for a level. Set by choice: errors last for seconds."""

# --- What counts as evidence -----------------------------------------------------------------------------------------------
START = 0.1
"""[1] Share of the logs: an effect that begins before is not told from one that was there from the first sample. Set by trial, no
run is recorded."""
LEAST_LENGTH = 10
"""[1] Stretches that an interval must have, and must leave. Set by choice: to be told from an outlier."""
KNOTS = (0.0, 0.3333333333333333, 0.6666666666666666, 1.0)
"""[1] Quantiles of a channel between which its curve is straight. Set by choice: three coefficients bend once."""
COST = 8.0
"""[1] What each coefficient of a curve must gain. Set by trial, no run is recorded."""
RATE_WINDOW = 11
"""[1] Instants over which a channel's rate is averaged. Set by choice: a second."""
SHORTLIST = 4
"""[1] Effects that are tried on intervals at their true size. Set by time."""
LOOKED_AT = 9
"""[1] Effects that are fitted at all, of those that a straight line through none promises most. Set by time."""
SIGNIFICANT = 1e-3
"""[1] Probability of naming anything by chance on a log without effects, all candidates and intervals together. Set by choice."""
LEAST_SHARE = 0.008
"""[1] Share of the noise's sum of squares that an effect must explain. Set by clean logs of all cycles, seeds 1000 to 1009: what
smoothing and a bilinear map leave gained 0.0015 at most with constants anywhere in their tolerance; this is five times that."""
PROVEN = 15.0
"""[1] Gain from which on anything is named, e^-15 by chance, with a margin for errors that are not quite as they are assumed.
Set by choice; on long logs LEAST_SHARE asks for more."""
ALWAYS = 2.0
"""[1] Times that gain for what acts all the time, where days differ. Set by choice: how much is known from experience alone."""
SWITCH = 3.0
"""[1] Times the logarithm of the number of instants: what a switch must gain. Set by choice: as much as an end of an interval
costs the search."""
OPPOSITE = 0.7
"""[1] Cosine from which on two effects are each other's opposite. Set by the blind bank 3."""
BLURRED = 0.002
"""[1] Share of what one interval gains that model error may pretend for a pause. Set by the blind bank 3."""
CLOSE = 0.7
"""[1] Share of the best score above which candidates are fitted jointly before one is chosen. Set by trial, no run is
recorded."""
TIE = 1.0
"""[1] Difference of scores that is none: of two names for one thing the one that the catalogue lists first is given. Set by
choice: under a nat."""

# --- When an effect is named -----------------------------------------------------------------------------------------------
MOST_EFFECTS = 4
"""[1] Effects of one set of logs. Set by time."""
MOST_STRUCTURE = 0.02
"""[1] Share of the noise's sum of squares that sizes which change from block to block may gain before a residual counts as
unexplained. Set by clean logs of all cycles, which stay under 0.003."""
STRUCTURE_LEFT = 0.2
"""[1] Share of the structure that was there before which named effects may leave. Set by trial, no run is recorded."""
MOST_UNEVEN = 0.15
"""[1] Share of its gain that a size of its own for every block would gain beside one size. Set by trial, no run is recorded: a
cause has one size."""
WEAKEST = 15.1
"""[1] Squared distance from none, in standard deviations, that an effect keeps when all are fitted together. Set by choice: one
in ten thousand by chance."""
AGAIN = 0.05
"""[1] Share of the first gain that the same effect must bring at another time to count as coming and going. Set by trial, no run
is recorded: less is what an edge leaves."""
REST = 0.1
"""[1] Share of the noise's sum of squares: an uneven effect that gains no more, beside others, is what they leave in transients.
Set by the blind bank 3."""
ALIKE = 1.645
"""[1] Standard deviations of the difference of losses by block within which two effects cannot be told apart. Set by choice: 90
%."""
SLOWEST = 0.055
"""[s] Sample spacing up to which a residual without a name says something of the engine. Set by clean logs on all cycles: none at
20 and 50 Hz leaves a residual; at 10 and 5 Hz every cycle does, the windows that hold enough samples blur fast transients."""

# --- How the error before and after is judged ------------------------------------------------------------------------------
FOLDS = 5
"""[1] Parts that are left out in turn. Set by choice."""
SUPPORT = 10.0
"""[1] Instants that must inform a node for what it predicts elsewhere to count. Set by choice."""
KNOWN = 5e-4
"""[kg/s] Standard error of a nominal map's node up to which it counts as well. Set by choice: noise of one instant."""
NOTHING = 0.02
"""[1] Weight of a node in an interpolation that does not count. Set by choice."""
DRAWS = 1000
"""[1] Of the bootstrap. Set by time: the interval's ends sway by a hundredth of its width."""
UNKNOWN = 1e-3
"""[1] Share of the largest precision of a nominal map under which a node was not estimated. Set by choice."""
LIKENESS = 2e-4
"""[kg/s] How much the nodes of two maps of one surface differ. Set by what bilinear interpolation leaves of the shipped
surface."""
AFFECTED = 1.25
"""[1] Times the usual error from which a balance counts as moved. Set by choice."""
PLACED = 0.2
"""[1] Share of the largest change below which a balance is not an effect's place. Set by choice."""
PROBE = 10.0
"""[1] Noticeable sizes that an effect is given to see what it moves. Set by choice."""

# --- What is said of the rest ----------------------------------------------------------------------------------------------
LARGE = 2.0
"""[1] Times the median power of all stretches above which one is named. Set by choice."""
MOST_NAMED = 5
"""[1] Stretches that are named. Set by choice."""
LEAST_VISIT = 20
"""[1] Places that a cell of the map must hold to be named. Set by choice: two seconds."""
LAGS = 10
"""[1] Blocks up to which correlation is sought, on both sides for other signals. Set by choice."""
COLOURED = 1e-3
"""[1] Probability that white noise is called coloured. Set by choice."""
NOTABLE = 0.15
"""[1] Correlation that is reported. Set by choice: a weaker one explains under a fortieth of the power."""
