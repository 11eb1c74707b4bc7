"""Every tuned number of the search for effects: value, [unit], meaning, and the run that set it.

One constant, one docstring: `[unit] what it decides. Set by ...`. `make thresholds` records how near the decisions of a small
bank come to each value, halves and doubles those that decide, and writes what changes to `benchmarks/results/thresholds.md`,
run 11 here: it holds a value where decisions came within a factor of two, and half and twice turned no verdict on the drives
nearest to it. Run 11 had no `SLIGHT`. Values are replaced before the rest of the package is imported: this imports nothing.
"""

# --- Where residuals are taken ---------------------------------------------------------------------------------------------
SPACING = 0.0973
"""[s] Spacing of the instants at which residuals are taken. It is no simple part of a second, so that what happens on the second
(set-points of a cycle, tasks of a control unit) is seen at all phases. Set by clean logs of all cycles: at tenths of a second,
kinks at whole seconds looked like a delay of half a millisecond; twice of it turns a verdict of run 11."""
TAKEN = 0.9
"""[1] Share of what a balance tells that instants farther apart must tell. Set by time: an engine with 0.99 took twice of it."""
MOST_INSTANTS = 15000
"""[1] Largest number of instants of all logs together. Beyond 25 minutes of driving the instants lie farther apart. Set by time:
one hour of driving is searched within a minute."""
HALF_WIDTH = 0.1
"""[s] Half width of the smoothing windows around instants. Set by choice: wider ones blur fast transients more, narrower ones let
more noise through; twice of it turns two verdicts of run 11."""
WIDER = 1.5
"""[1] Factor on the windows' width for the fit that shows how far a size depends on it. Set by trial, no run is recorded."""
LEAST_SAMPLES = 14
"""[1] Samples that a window must hold. Set by choice: seven for each half of the samples, for a parabola; held by run 11."""
MOST_LEVELS = 3
"""[1] Number of values of a switch, at most. Set by choice: on, off, and not known; twice of it turns a verdict of run 11."""
PAUSE = 60.0
"""[s] Pause between two logs on the common clock. Set by choice: longer than the noise is remembered."""
WIDE = 1.5
"""[s] Half width of the windows that give the rates of slow signals: narrower windows see mostly noise there. Set by an intake
temperature 6 s late, its noise coloured: through 0.5 s it seemed 2.9 s late, through 1.5 s 5.1 s, through 2.5 s 5.2 s."""
BLOCK = 2.0
"""[s] Resolution of the search for onsets. Set by time; `sharpened` finds the instant; twice of it reorders two names of run 11."""
MOST_BLOCKS = 400
"""[1] Largest number of stretches between which onsets are sought. Set by time: the search grows with their square."""
STRETCH = 20.0
"""[s] Length of stretches kept from fits and choices. Set by choice: long against memory, short against a drive; held by run 11."""
EVERY = 5
"""[1] One stretch in this many is kept from fits and choices. Set by choice: a fifth."""
COARSE = 10.0
"""[s] Length of blocks whose sums count as independent. Set by choice: what a clean log leaves is correlated for less."""
GUARD = 1.0
"""[s] Margin at either end of a kept stretch, not used, not judged. Set by choice: beyond every window and lag; held by run 11."""
TRANSIENT = (0.7, 0.85, 0.93, 0.97, 0.99)
"""[1] Quantiles of the rate of change between classes of transience. Set by choice: the fastest hundredth is a class of its own."""
NEAR = 0.1
"""[1] Share of a half width between the two values whose difference gives a rate. Set by rounding against curvature."""

# --- How residuals are weighted --------------------------------------------------------------------------------------------
LEAST_IN_CELL = 5.0
"""[1] Instants of the average cell that are added to each, for its noise. Set by choice: a cell never visited has noise, too."""
FIRST_NOISE = 1e-3
"""[kg/s] Noise that every balance is given before the first fit. Set by choice: any value, the first pass replaces it."""
SHORT = 4.0
"""[s] Time constant with which a learned model's fast error decays. Set by trial on the real engine's healthy recording."""
AT_ONCE = 0.25
"""[1] Share of the fast error that is new in every block. Set by trial on the same recording."""
SLOW = 100.0
"""[s] Time constant with which the slow error of a learned model decays. Set by trial on the same recording."""
MOST_ASKED = 2000.0
"""[1] Largest number of instants at which healthy drives are asked for the engine's constants. Set by time and memory: a calibrated
engine has hundreds of unknowns, and took 3 GB with all instants of an hour."""
LEAST_LEFT = 1.0 / 3.0
"""[1] Share of a prior's standard deviation that an estimate, a refinement or a healthy drive leaves at least. Set by choice: their
own interval is of a model that is linear around its optimum, and of noise that is less independent than it assumes."""
HEALTHY_LEAST = 300.0
"""[s] Least driving a healthy engine is learned from. Set by trial: with 80 s a sensor that read 20 % too much was not found."""
HEALTHY_SECONDS = 3600.0
"""[s] Driving that is enough to learn what a healthy engine leaves. Set by time: an hour in six logs takes about a minute."""
BELLS = 600
"""[1] Most bells of the function that says what a balance leaves on a healthy engine. Set by time: it grows with the square."""
UNTOLD = 0.1
"""[1] Variance of that function that its bells may miss on average, over the usual error's. Set by choice: it counts as noise."""
BELL_LENGTHS = (0.5, 50.0)
"""[1] Shortest and longest bell along a channel, over its length before any data. Set by held-out drives of two engines: shorter
ones follow what one drive happens to leave; a seventh of it raised the error of the power balance by half."""
LENGTH_SPREAD = 0.25
"""[1] Half width of Cauchy's distribution of the logarithm of that length. Set by choice: few channels differ from the others."""
SHARPER = 4.0
"""[1] Power of the bells that makes those by which days differ: they reach half as far. Set by three clean drives that were idle
in another way than the healthy ones: bells as long as the function's named two of them, these one."""
SHAPES = 40
"""[1] Most shapes by which a balance of one day differs. Set by time: each is an unknown of a search."""
PIECE = 6.0
"""[s] Length of the means that show the errors of a healthy engine. Set by choice: their scatter counts as fast."""
MEMORY = 60.0
"""[s] Time constant of what lasts for minutes; effects that act for less count as a share. Set by held-out drives: 30 to 100 s."""
SLOW_SHARE = 0.05
"""[1] Variance of every slow error before any data, in usual errors squared. Set by choice; SLOW_SPREAD says how loosely."""
SLOW_SPREAD = 3.0
"""[1] Standard deviation of the logarithm of that. Set by choice: a factor of 20."""
TOLD = 0.5
"""[1] Power over noise below which a pattern of errors or constants is left out. Set by time: noise varies by at most half more."""
STANDS = 0.005
"""[1] Standard deviation over the mean up to which a channel stands still on a healthy drive. Set by choice: ambient pressure and
temperature of one drive say nothing of another day; held by run 11."""
RIDGE = 1e-6
"""[1] Added to the bells' own kernel. Set by rounding."""
FAR = 4.0
"""[1] Standard deviations beyond which an input of the function, or an error judged, is cut. Set by choice; held by run 11."""
OUTLIER = 4.0
"""[1] Standard deviations beyond which an instant weighs as if it stood there. Set by a healthy drive whose exhaust ran backwards
through the EGR valve for a moment, where the balances are off by forty: one instant named a curve of that valve; half or twice of
it turns a verdict of run 11."""
MOST_STRETCHED = 3.0
"""[1] Largest factor on the scale of an outlier. Set by choice: a second fault is none; half of it turns two verdicts of run 11."""

# --- How models are fitted -------------------------------------------------------------------------------------------------
STEP = 1e-4
"""[1] Relative step of difference quotients by constants. Set by rounding against curvature."""
AHEAD = 0.1
"""[s] Time by which a late temperature is taken along its rate. Set by choice: where a flow turns, no derivative holds for long."""
EFFECT_STEP = 0.02
"""[1] Step of differences by an effect, in its noticeable size; from none all of that. Set by rounding against curvature."""
WIDEST = 100.0
"""[1] Prior standard deviation of an accepted effect in noticeable sizes. Set by choice: so wide that it says nothing."""
ANEW = 5
"""[1] Gauss-Newton steps between new derivatives by the unknowns. Set by time: they change little, and are most of the work."""
MOST_STEPS = 12
"""[1] Gauss-Newton steps between two sets of weights. Set by time: a fit that needs more gets new weights and goes on."""
MOST_HALVINGS = 4
"""[1] Lengths tried of a Gauss-Newton step that raises the sum of squares, each half of the last. Set by choice: down to 1/8."""
STILL = 1.0
"""[1] A fit stops when a further step would lower the sum of squares, over the noise, by less. Set by choice; held by run 11."""
SETTLED = 0.01
"""[1] A fit stops when its own weights would change its residual by less than this. Set by choice: noise is known no better."""
PIN = 1e6
"""[1] Precision of a pinned unknown in units of its prior's. Set by rounding."""
FARTHEST = 2.0
"""[1] Standard deviations of its prior within which an unknown is sought. Set by choice: 15 % beyond a uniform tolerance; half or
twice of it turned a verdict of run 9, no decision of run 11 comes near it."""
PASSES = 2
"""[1] Times that a curve beside all the rest, or levels of a day on an unseen log, are found. Set by time: a tenth moves then."""
HEALTHY_PASSES = 3
"""[1] The same of a healthy engine's function and errors. Set by two turbines: with two, errors were 1.7 times as large."""
SIZE_PASSES = 6
"""[1] Gauss-Newton steps in the size of one candidate. Set by time."""
STRAIGHT = 1e-6
"""[1] Share of its change by which an effect may miss a straight line in its size. Set by rounding: below it, one step is exact."""
STRONG = 5.0
"""[1] Standard deviations of its noise by which the information about a size must exceed zero. Set by choice; held by run 11."""
LEVEL_SHARE = 0.333
"""[1] Share of the places that count as independent for a level of the day. Set by choice: errors last for seconds."""

# --- What counts as evidence -----------------------------------------------------------------------------------------------
START = 0.1
"""[1] Share of the logs from their start: an onset inside it counts as if the effect had been there from the first sample. Set by
trial; held by run 11."""
LEAST_LENGTH = 10
"""[1] Stretches that an interval must have, and must leave. Set by choice: a shorter one may be an outlier; held by run 11."""
KNOTS = (0.0, 0.3333333333333333, 0.6666666666666666, 1.0)
"""[1] Quantiles of a channel that are the knots of its curve. Set by choice: three coefficients."""
COST = 8.0
"""[1] Gain that each coefficient of a curve must bring. Set by trial; twice of it turns two verdicts of run 11."""
CURVE_SIZES = (0.3, 1.0)
"""[1] Sizes of a component's curve that are tried, in its deviation before any data. Set by choice: a curve of which
little shows should not pay for coefficients that a large one needs."""
TENT_WIDTHS = (1.0, 2.0)
"""[1] Half the widths of the tents that a component's curve may be, in its length over the first input. Set by choice: where a
component differs from its model at one speed or opening, one coefficient tells it."""
LARGEST = 4.0
"""[1] Largest amplitude of a component's curve, in its deviation before any data. Set by choice. Without it a leak of the real
engine was taken for cylinders that take 37 % less; held by run 11."""
ADVANTAGE = 1.05
"""[1] Multiple of the score of a plain effect that one with a curve or a course must have. Set by choice: a twentieth is what
smoothing and a linear step leave; half of it turns a verdict of run 11."""
TIME_CONSTANTS = (0.01, 0.03, 0.1, 0.3)
"""[1] Time constants of a course that are tried, over the length of the drive. Set by choice: a housing of seconds to minutes."""
RELAY_LEVELS = (0.1, 0.25, 0.4, 0.6, 0.75, 0.9)
"""[1] Quantiles of an input between which a hysteresis is tried. Set by time: any two of them."""
FINER = (0.06, 0.02)
"""[1] Steps in which the values of a course are sought again around the best ones, over the spread of its input; in octaves for its
time constant. Set by the distance of RELAY_LEVELS: two steps reach the next."""
MOST_SWITCHES = 20
"""[1] Largest number of intervals of an effect that comes and goes. Set by choice: more of them are noise."""
MOST_COURSES = 2
"""[1] Courses of an effect that are fitted at all: those with the largest gain to first order. Set by time."""
SHORTLIST = 4
"""[1] Leading effects that are tried on intervals at their fitted size, and places for which forms of two factors are tried. Set
by time; held by run 11."""
LOOKED_AT = 12
"""[1] Effects that are fitted at all: those with the largest gain to first order. Set by time, and by an intake pressure 2.6 %
too high at little flow: it was tenth to first order, and gained most of all."""
HOPELESS = 0.1
"""[1] Share of the largest gain to first order below which an effect is not fitted in an interval. Set by 477 fits in ten drives of
seed 900352 of the second bank: every effect that gained half as much as the best had 0.28 of it to first order, and more."""
SIGNIFICANT = 1e-2
"""[1] Probability of naming anything by chance on a log without effects, all candidates and intervals together. Set by choice."""
SIGNIFICANT_LEARNED = 1e-3
"""[1] The same of the first effect where healthy drives tell, and that of nothing below which a residual is `unexplained`. Set by
seed 406590 of the second bank: of eleven sound drives that had been accused nine have more, and one of 90 single effects."""
LIKELY = 0.5
"""[1] The same of an effect as all data tell of it, from which it has no name. Set by choice: chance is as likely a cause."""
POOLED = 6.0
"""[1] Healthy drives that what all effects have in common counts as, beside those that show one. Set by choice. With the number
that the effects' own variances ask for (empirical Bayes: 3 to 18 on four engines, 3 to 13 on twelve others), one of 25 clean
drives was accused; held by run 11."""
MODEL_ERROR = 5e-5
"""[1] What the error of a sound model adds to the variance of every gain, per residual, in units of the noise. Set by 24 clean
drives of three cycles with drawn constants, seeds 1100 to 1123: with noise alone the probability of nothing fell to 1e-5."""
LEAST_SHARE = 0.008
"""[1] Share of the noise's sum of squares that an effect must explain. Set by clean logs of all cycles, seeds 1000 to 1009: what
smoothing and a bilinear map leave gained 0.0015 at most with constants anywhere in their tolerance; this is five times that."""
PROVEN = 15.0
"""[1] Smallest gain of anything that is named: e^-15 by chance, with a margin for errors that are not quite as they are assumed.
Set by choice: on long logs LEAST_SHARE asks for more; no decision of run 11 comes near it."""
AS_WELL = 0.5
"""[1] Share of the best gain that another effect must have at least to explain the logs as well. Set by choice."""
SWITCH = 3.0
"""[1] Cost of a switch between acting and not acting, in logarithms of the number of instants. Set by choice: as an interval."""
CLOSE = 0.7
"""[1] Share of the best score above which candidates are fitted jointly. Set by trial; twice of it turns a verdict of run 11."""
TIE = 1.0
"""[1] Largest difference of scores that counts as a tie. The catalogue's order decides between effects that tie. Set by choice: a
nat; held by run 11."""

# --- When an effect is named -----------------------------------------------------------------------------------------------
MATTERS = 0.05
"""[1] Share of what is above noise on held-out blocks that a further effect must explain there. Set by choice: wrong names on
engines of another structure came with p = 1e-123 and one per cent of it; a name that leaves the residual as it is helps nobody;
half of it turns a verdict of run 11."""
MATTERS_LEARNED = 0.001
"""[1] The same where healthy drives tell: it is then a share of all that is left, noise included. Set by two readings of the flow
that are a constant too high, 0.14 and 0.15 % of it, and by two wrong names, less than 0.06 %, on seed 106607 of the second bank."""
OWN = 0.3
"""[1] Share of its gain that a further effect keeps where the others may have another shape, at least. Set by pairs of seeds 292192
and 106607 of the second bank, where two clear second effects kept 0.37 and 0.48."""
SLIGHT = 0.5
"""[1] Share of its noticeable size that a lasting effect must have where healthy drives tell: constants that changed since look
like small errors of sensors. Set by seed 512617 of the second bank: five of 17 wrong names were smaller, no true effect is."""
ONE_SIDED = 0.1
"""[1] Share of its range up to which what lies below none is there for estimates alone: no lag and no leak is negative. Set by
choice: their ranges reach 1 to 10 % below."""
MOST_EFFECTS = 4
"""[1] Largest number of effects of one set of logs. Set by time."""
MOST_STRUCTURE = 0.02
"""[1] Share of the noise's sum of squares that sizes which change from block to block may gain before a residual counts as
unexplained; where healthy drives tell, of what the named effects explain, too. Set by clean logs of all cycles, which stay under
0.003; and by an intake pressure 20 hPa too high on seed 305674 of the second bank, of which 0.0014 was left."""
BY_CHANCE = 2.0
"""[1] Standard deviations beyond noise that a size for every block must gain. Set by choice: noise does on one log of 40."""
MOST_UNEVEN = 0.15
"""[1] Share of its gain that an effect may gain more with a size of its own for every block. Set by trial: a cause has one size."""
MOST_UNEVEN_LEARNED = 0.35
"""[1] The same where healthy drives tell. Set by seed 911107 of the second bank: right names come to 0.18, a wrong one to 0.40."""
WEAKEST = 15.1
"""[1] Squared standard deviations from none that an effect keeps beside all others. Set by choice: 1e-4 by chance."""
DATED = 2.0
"""[1] Gain by which two moments differ that are told apart as the onset of an effect. Set by choice: 95 % of the normal law."""
AGAIN = 0.05
"""[1] Share of the first gain that the same effect must bring at another time to count as coming and going. It is the square of
`SHAPE` if healthy drives tell. Set by trial: less is what an edge leaves; half of it turns a verdict of run 11."""
REST = 0.1
"""[1] Share of the noise's sum of squares below which an uneven effect is what the others leave in transients. Set by the blind
bank 3; no decision of run 11 comes near it."""
SHAPE = 0.35
"""[1] Share by which the course of a cause may differ from the catalogue's, rms, where the engine is not the model. Its
square is the share of a gain that decides nothing. A further effect must be proven by what its gain keeps where all others may
differ so. Set by drives of another structure: a sensor 9 % too low was told from an inlet leak by a ninth of the gain, wrongly."""
RESPONSE = 0.07
"""[1] Share by which a size may be off where the engine is not the model: what was learned of it, and the laws of the catalogue,
are not quite its own. Set by sizes on altered drives of the blind banks 9647 and 68529: with 0.07 to 0.1, 85 to 94 % of the
intervals hold. Held by seed 900352 of the second bank: 92 % of 150 hold, 81 % without it."""
SLOWEST = 0.055
"""[s] Sample spacing up to which a residual without a name says something of the engine. Set by clean logs on all cycles: none at
20 and 50 Hz leaves a residual, all at 10 and 5 Hz do, whose windows blur fast transients; half of it turned a verdict of run 10."""

# --- How the error before and after is judged ------------------------------------------------------------------------------
FOLDS = 5
"""[1] Parts that are left out in turn. Set by choice."""
SUPPORT = 10.0
"""[1] Instants that must inform a node before its predictions elsewhere count. Set by choice: a second; held by run 11."""
KNOWN = 5e-4
"""[kg/s] Standard error up to which a node of a nominal map is known. Set by choice: noise of one instant; held by run 11."""
NOTHING = 0.02
"""[1] Interpolation weight below which a node that is not known does no harm. Set by choice; held by run 11."""
DRAWS = 1000
"""[1] Draws of the bootstrap. Set by time: the interval's ends sway by a hundredth of its width."""
UNKNOWN = 1e-3
"""[1] Share of a nominal map's largest precision below which a node is not estimated. Set by choice: a prior alone is far below."""
LIKENESS = 2e-4
"""[kg/s] Standard deviation between nodes of two maps of one surface. Set by what interpolation leaves of the shipped surface."""
AFFECTED = 1.25
"""[1] Multiple of its usual error from which a balance counts as moved. Set by choice; held by run 11."""
PLACED = 0.2
"""[1] Share of the largest change below which a balance is not an effect's place. Set by choice."""
PROBE = 10.0
"""[1] Size of an effect, in noticeable sizes, that shows which balances it moves. Set by choice."""

# --- What is said of the rest ----------------------------------------------------------------------------------------------
LARGE = 2.0
"""[1] Multiple of the median power above which a stretch is named. Set by choice; held by run 11."""
MOST_NAMED = 5
"""[1] Largest number of stretches, and of leading candidates, that a residual without a name is handed over with. Set by choice."""
LEAST_VISIT = 20
"""[1] Places that a cell of the map must hold to be named. Set by choice: two seconds; held by run 11."""
COLOURED = 1e-3
"""[1] Probability of calling white noise coloured. Set by seed 292192 of the second bank: at a hundredth 21 more of 124 residuals
were coloured, with the same names."""
LAGS = 10
"""[1] Largest lag, in blocks, at which correlation is sought; for other signals on both sides. Set by choice: 20 seconds."""
NOTABLE = 0.15
"""[1] Correlation that is reported. Set by choice: a weaker one explains under a fortieth of the power; held by run 11."""

# --- What a formula may be ---------------------------------------------------------------------------------------------------
FORM_CALM = 1.0
"""[s] Time over which the channels of a form, and the rates of a channel, are averaged; the first screening of forms takes means
over as long. Set by choice: their noise would weaken every product, and what a form describes lasts longer."""
FORM_LAGS = (5.0, 10.0, 20.0, 40.0, 80.0, 160.0, 320.0)
"""[s] Time constants that the search starts from. Set by trial: at four times apart a housing of 40 s that follows the exhaust was
taken for one that follows the fuel; the best are refined to a twenty-fifth."""
FORM_SEEN = 1e-3
"""[1] Share of a form's power that map and unknowns must leave. Set by rounding: below, a gain is nothing; held by run 11."""
FORM_REACH = 5.0
"""[1] Standard deviations of a channel within which its reference is sought. Set by choice: farther away, a form is a constant."""
FORM_FLAT = 0.05
"""[1] Relative scatter below which a factor is a constant unless it has a reference. Set by choice: air of a few kelvin more or
less says nothing, and a product with it is what the catalogue has without; held by run 11."""
FORM_OVER_ONE = 0.5
"""[1] Share of what one listed effect leaves that a formula must undercut to take its place. Set by 25 drives with listed
effects, where the best form left 0.92 of it and more, and by a vane that reads wrong, 0.28."""
FORM_OVER_MORE = 1.05
"""[1] The same for two names and more: one formula that leaves as little is the simpler cause. Set by an ambient pressure that
reads 15 hPa too high: three names, and the formula left 0.98 of what they do."""
FORM_CLEAR = 30.0
"""[1] Gain by which a formula must surpass one listed effect to take its place where healthy drives tell, and by which it may stay
behind three, or behind names of the sensor with a channel's curve among them; by which it must surpass such a curve, or a name that
is given up for it. Set by 18 drives of seed 498771: over the right effect the best formula gained 14 at most, the true one over a
wrong effect 34, over a channel's curve 44 to 335."""
FORM_SHARE = 0.01
"""[1] Share of its gain that each further unknown of a form must bring beside COST. Set by choice: as each end of an interval."""
FORM_LEAVES = 0.9
"""[1] Error on blocks left out, after over before, that a named formula must stay under; of the sum of squares if healthy drives
tell. Set by drives with altered readings: a wrong one left 0.935, right ones 0.78 and less. There by seed 241962: 0.95; 0.81."""
FORM_MOST = 50.0
"""[1] Noticeable sizes within which the coefficient of a form is sought. Set by choice: a reading may be off by all of itself."""
FORM_SHARE_MOST = 0.8
"""[1] Largest share of itself that a reading may be off by at any place. Set by choice: at one, the truth is a division by zero,
which a search came upon; no decision of run 11 comes near it."""
FORM_NOTICED = 0.02
"""[1] Share of a reading, rms, that a careful engineer would notice. Set by choice: as for the listed gains; held by run 11."""
FORM_ALIKE = 4
"""[1] Forms that explain the logs alike: so many must share a signal. Set by seed 241962: a wrong one was one of five."""
FORM_RIVALS = 3
"""[1] Forms of one target, each of another signal, that go on from the first screening. Set by trial; held by run 11."""
FORM_FIRST = 12
"""[1] Signals, best alone, that a product of two begins with. Set by 23 drives of seed 811111: of all, two were as right."""
FORM_TRIED = 6
"""[1] Forms that are fitted beside all unknowns. Set by time."""
