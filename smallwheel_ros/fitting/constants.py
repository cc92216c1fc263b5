# SPDX-License-Identifier: Apache-2.0
"""Every constant of the statistical model, with its value and the reason for it.

`TABLE` is what docs/diagnosis.md prints. Nothing here belongs to one effect or one verdict.
"""

from __future__ import annotations

from typing import NamedTuple


class Constant(NamedTuple):
    """One row of the table: what it is called in the text, its value, and why."""

    name: str
    value: float
    why: str


TABLE: list[Constant] = []


def _constant(name: str, value: float, why: str) -> float:
    TABLE.append(Constant(name, value, why))
    return value


# Physical: how much soils, rigs and instruments differ. Medians of log-normal priors.
SOIL_SCATTER = _constant(
    "tau: soil from run to run, of ln k", 0.05,
    "prepared soil bins repeat to 2 to 15 % in penetration resistance",
)  # fmt: skip
CHANNEL_SCATTER = _constant(
    "own: a channel from run to run, of its level", 0.03,
    "a rig is touched down and tared anew for each run",
)  # fmt: skip
ZERO_SCATTER = _constant(
    "zero: a channel from run to run, of its median", 0.01,
    "resolution and drift of a zero, of the median reading",
)  # fmt: skip
LACK_OF_FIT = _constant(
    "fit: the law over settings, of the level", 0.03,
    "as large as what a channel differs by from run to run: before data neither is preferred",
)  # fmt: skip
CURVE_CORRELATED = _constant(
    "along: correlated along a curve, of the level", 0.03,
    "layers and grains below a plate; as large as a channel's own scatter",
)  # fmt: skip
CURVE_SHAPE = _constant(
    "shape: discrepancy of the power law over depth, of the level", 0.05,
    "measured plate curves stray by 5 % from any power of depth; fixed, as that of thrust",
)  # fmt: skip
SPREAD = _constant(
    "log-deviation of each of these priors", 0.7,
    "a factor of 2 either way: 2 to 15 % spans what prepared soils scatter by",
)  # fmt: skip
FORCE_LAW = _constant(
    "discrepancy of the law of pull and torque, of the load (times the radius)", 0.05,
    "held-out pulls of four rigs say 0.03 to 0.05 (ln evidence 0, -3; at 0.1 -21); fixed, since "
    "where it is estimated an effect gains by shrinking it",
)  # fmt: skip
FORCE_WHEEL = _constant(
    "the same, of a wheel at all slips", 0.05,
    "pulls of wheels that were left out are off by 0.03 to 0.07 of the load, by up to 0.06 in the mean",
)  # fmt: skip
FORCE_LUGS = _constant(
    "the same, of a wheel with lugs over a tenth of its radius", 0.1,
    "no law of lugs holds on all rigs: twice the error of a wheel with lower ones or none",
)  # fmt: skip
FORCE_SLIP = _constant(
    "slip over which that discrepancy changes", 0.3, "thrust saturates over slips of 0.2 to 0.4"
)
INSTRUMENT = _constant(
    "strength of an instrument effect, of the reading", 0.05,
    "a calibration that was not made anew is off by a few per cent",
)  # fmt: skip
SHOWN_SINKAGE = _constant(
    "zero of the sinkage, where pull and torque speak of it, m", 0.008,
    "what a small wheel sinks under its own weight, on which the zero may have been taken",
)  # fmt: skip
ROW_NOISE = _constant(
    "repeatability before any repeats, of the level", 0.02,
    "counts as one repeat; a few repeats outweigh it",
)  # fmt: skip

# Statistical.
STUDENT = _constant(
    "degrees of freedom of the priors of effects", 3.0,
    "a published range is a guide: a strength four half-widths from its middle costs 4 nats, not 8",
)  # fmt: skip
EXPECTED_EFFECTS = _constant(
    "effects expected to be missing, before the data",
    1.0,
    "one asks because one suspects something",
)
NAMED = _constant("probability from which a name is given", 0.95, "20 to 1")
ALARM = _constant(
    "largest p at which anything is said to be missing",
    0.05,
    "the usual level, for one test a table",
)
TESTABLE = _constant(
    "least expected misfit of a testable effect, in squared deviations", 0.1,
    "a strength of the prior's size moves the likelihood by 0.05 nats: this data cannot tell",
)  # fmt: skip
TIE = _constant("nats within which a tied setting does as well", 3.0, "20 to 1")
TIED = _constant("share of a setting's variance that another predicts, in a tie", 0.5, "half")
TOGETHER = _constant(
    "the same, from which two settings are tied whatever the fit says", 0.95,
    "what is left is as small as the errors of settings, which the model does not have",
)  # fmt: skip
REPLICATES = int(_constant("draws of the null distribution", 199, "p down to 1/200"))
OUTLIER = _constant(
    "deviations of a row or a run that make it an outlier", 6.0,
    "no chance for Gaussian noise, and rare for any other that an instrument has",
)  # fmt: skip
CLEAN = _constant(
    "share of clean tables in which few values exceed that by chance", 0.01,
    "a deviation that is known from few values is not known well: the limit then is higher",
)  # fmt: skip
DETERMINED = _constant(
    "posterior over prior deviation of a determined parameter", 0.5,
    "at half, three quarters of what is known is data",
)  # fmt: skip

USEFUL = _constant(
    "least fall of a held-out error for which a name is given", 0.02,
    "what an instrument's calibration is good to: nobody would miss less",
)  # fmt: skip
MENTIONED = _constant("probability under which a family is no rival", 0.02, "50 to 1")
APART = _constant(
    "share of a rival's probability in models without the other", 0.7,
    "two effects that are both there would have most of it in models with both",
)  # fmt: skip
BEATS = _constant(
    "nats by which a law beats none, to stand for its free curve", 1.0, "a factor of e"
)
ANSWERS = _constant(
    "share of a column's variance that settings predict, from which it is an answer", 0.75,
    "designed settings predict each other by less than half",
)  # fmt: skip
SAME_ORDER = _constant(
    "rank correlation of one setting in other units", 0.98, "rim speed and slip at one speed"
)
WAVERS = _constant(
    "share of a load's variance within runs, from which it was not set", 0.05,
    "a load that is set repeats to a few per cent, and was varied by a factor",
)  # fmt: skip
FEWEST_VALUES = int(
    _constant("runs with different values of a column that nobody has a law for", 8,
              "fewer are explained by the scatter of as many runs")
)  # fmt: skip
HIDE = _constant(
    "prior deviations of ln phi that the null's scatter is capped at", 2.0,
    "95 % of prepared soils and rigs scatter less: what is beyond may be the effect itself",
)  # fmt: skip
CURVE_SIZE = _constant(
    "deviation of ln factor of a curve without a name", 0.4, "half to twice; higher terms fall off"
)
LEAST_POWER = _constant(
    "chance to decide from which a measurement is proposed",
    0.2,
    "one in five: else it is no advice",
)

# Search budget: larger costs time only.
CURVE_POINTS = int(
    _constant("points of a swept run", 10, "neighbours along a curve are correlated")
)
MOST_POINTS = int(
    _constant("points of a table, from which curves have fewer", 400, "time grows with the cube")
)
WINDOW = _constant(
    "nats below the best model that are searched on", 7.0, "1000 to 1 (Occam's window)"
)
PARENTS = int(_constant("models that are extended at each size", 3, "search budget"))
FIRST_REFITS = int(_constant("single effects that are refitted", 8, "search budget"))
REFITS = int(_constant("extensions of each model that are refitted", 6, "search budget"))
MOST_EFFECTS = int(_constant("effects of the largest model", 4, "search budget"))
FOLDS = int(
    _constant("folds of the held-out error", 6, "up to twice as many runs are left out one by one")
)
FEWEST_RUNS = int(
    _constant(
        "fewest runs of a verdict", 6, "scatter between fewer runs is not told from an effect"
    )
)
