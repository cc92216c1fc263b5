# SPDX-License-Identifier: Apache-2.0
"""Every constant of the statistical model, with its value and the reason for it.

The comment above each one says what it is and, after the dash, why; docs/diagnosis.md prints this file as a
table. No constant here belongs to a single effect or verdict.
"""

# --- Physical: how much soils, rigs and instruments differ. Medians of log-normal priors.

# tau: soil from run to run, of ln k - prepared soil bins repeat to 2 to 15 % in penetration
#   resistance
SOIL_SCATTER = 0.05
# own: a channel from run to run, of its level - a rig is touched down and tared anew for each run
CHANNEL_SCATTER = 0.03
# zero: a channel from run to run, of its median - resolution and drift of a zero, of the median
#   reading
ZERO_SCATTER = 0.01
# fit: the law over settings, of the level - as large as what a channel differs by from run to run:
#   before data neither is preferred
LACK_OF_FIT = 0.03
# along: correlated along a curve, of the level - layers and grains below a plate; as large as a
#   channel's own scatter
CURVE_CORRELATED = 0.03
# shape: error of the power law over depth, of the level - measured plate curves stray by 5 %
#   from any power of depth; fixed, as that of thrust
CURVE_SHAPE = 0.05
# log-deviation of each of these priors - a factor of 2 either way: 2 to 15 % spans what prepared
#   soils scatter by
SPREAD = 0.7
# error of the law of pull and torque, of the load (times the radius) - by the ln evidence of held-out
#   pulls of four rigs 0.03 (0) to 0.05 (-3) rather than 0.1 (-21); fixed, since where it is estimated
#   an effect gains by shrinking it
FORCE_LAW = 0.05
# the same, of a wheel at all slips - pulls of wheels that were left out are off by 0.03 to 0.07 of
#   the load, by up to 0.06 in the mean
FORCE_WHEEL = 0.05
# the same, of a wheel with lugs over a tenth of its radius - no law of lugs holds on all rigs:
#   twice the error of a wheel with lower ones or none
FORCE_LUGS = 0.1
# slip over which that error changes - thrust saturates over slips of 0.2 to 0.4
FORCE_SLIP = 0.3
# strength of an instrument effect, of the reading - a calibration that was not made anew is off by
#   a few per cent
INSTRUMENT = 0.05
# repeatability before any repeats, of the level - counts as one repeat; a few repeats outweigh it
ROW_NOISE = 0.02

# --- Statistical

# degrees of freedom of the priors of effects - a published range is a guide: a strength four half-widths
#   from its middle costs 4 nats, not 8
STUDENT = 3.0
# effects expected to be missing, before the data - one asks because one suspects something
EXPECTED_EFFECTS = 1.0
# probability from which a name is given - 20 to 1
NAMED = 0.95
# largest p at which anything is reported as missing - the usual level, for one test a table
ALARM = 0.05
# least expected misfit of a testable effect, in squared deviations - a strength of the prior's size
#   moves the likelihood by 0.05 nats: this data cannot tell
TESTABLE = 0.1
# nats within which another explanation does as well - 20 to 1
TIE = 3.0
# share of a setting's variance that another predicts, from which they are tied - what is left is as small
#   as the errors of settings, which the model does not have
TOGETHER = 0.95
# draws of the null distribution - p down to 1/200
REPLICATES = 199
# deviations of a row or a run that make it an outlier - no chance for Gaussian noise, and rare for
#   any other that an instrument has
OUTLIER = 6.0
# share of clean tables in which any value exceeds that by chance - a deviation that is estimated from
#   few values is uncertain: the limit then is higher
CLEAN = 0.01
# posterior over prior deviation of a determined parameter - at half, three quarters of what is
#   known is data
DETERMINED = 0.5
# least fall of a held-out error for which a name is given - what an instrument's calibration is
#   good to
USEFUL = 0.02
# probability under which a family is no rival - 50 to 1
MENTIONED = 0.02
# least share of a rival's probability that is in models without the others - two effects that are
#   both missing would have most of it in models with both
APART = 0.7
# nats by which a law must do better than none to be named in place of its free curve - a factor of e
BEATS = 1.0
# share of a column's variance that settings predict, from which it is a response and no setting -
#   designed settings predict each other by less than half
ANSWERS = 0.75
# rank correlation from which a column is another setting in other units - rim speed is slip at one
#   travel speed
SAME_ORDER = 0.98
# share of a load's variance within runs, from which it was not set - a load that is set repeats to
#   a few per cent, and was varied by a factor
WAVERS = 0.05
# fewest different values of a column for which there is no law - the scatter of fewer runs could
#   explain them
FEWEST_VALUES = 8
# prior deviations of ln phi at which the scatter of simulated data is capped - 95 % of prepared soils
#   and rigs scatter less: what is beyond may be the effect itself
HIDE = 2.0
# deviation of ln factor of a curve without a name - half to twice; higher terms fall off
CURVE_SIZE = 0.4
# least probability to decide with which a measurement is proposed - below one in five it is no advice
LEAST_POWER = 0.2

# --- Search budget: larger costs time only

# points of a swept run - neighbours along a curve are correlated
CURVE_POINTS = 10
# points of a table, from which curves have fewer - time grows with the cube
MOST_POINTS = 400
# nats below the best model that are searched on - 1000 to 1 (Occam's window)
WINDOW = 7.0
# models that are extended at each size - search budget
PARENTS = 3
# single effects that are refitted, besides each law once - search budget
FIRST_REFITS = 8
# extensions of each model that are refitted - search budget
REFITS = 6
# effects of the largest model - search budget
MOST_EFFECTS = 3
# folds of the held-out error - up to twice as many runs are left out one by one
FOLDS = 6
# fewest runs of a verdict - scatter between fewer runs cannot be told from an effect
FEWEST_RUNS = 6
