# SPDX-License-Identifier: Apache-2.0
"""The size of each value and its repeatability: how much rows of one point differ, and which are outliers.

The size is that of a log-log regression of the measured values on the settings (`NoiseLine`,
`levels_of`). The regression has no physics; it is the reference that a law has to beat, and a row
of `smallwheel compare`:

    ln value = constant of its soil + b . (ln load, ln diameter, ln width, slip, slip^2, pass, speed)

by least squares, over the settings that were varied. Repeatability is

    sigma^2 = absolute^2 + (relative * level)^2    by channel, from sums of squares within points

Where the table states deviations, these are used, times one factor that repeats determine.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from smallwheel_ros.fitting.constants import CLEAN, FORCE_LUGS, FORCE_WHEEL, OUTLIER, ROW_NOISE
from smallwheel_ros.fitting.points import Index, Points, runs_of
from smallwheel_ros.measurements.columns import FORCES, Texts
from smallwheel_ros.physics.conditions import Conditions

Array = NDArray[np.float64]

_VALUES_A_COLUMN = 2  # at least: a line with fewer would follow single values
_VARIED = 1e-6  # range of a column, below which it was not varied
_SMALLEST = 0.05  # of a channel's median: least level of a value
_SHARES = np.linspace(0.0, 1.0, 21)  # of the variance that grows with the level
MOST_OUTLIERS = 0.10  # of the points; where more than one have some, the noise is heavy
NORMAL = 1.4826  # median absolute deviation to standard deviation, Gaussian
_FEWEST = 3  # rows of a point from which its middle is told from an outlier
_AROUND = 3  # rows on each side of one along a curve: two spikes in a row are told from it
_MOST_SPIKES = 0.2  # of the rows of a curve
_OF_SPAN = 0.01  # of what a curve spans: no gauge resolves less


def _columns(conditions: Conditions) -> Array:
    """Variables that a value may depend on, the most likely first, shape (rows, columns).

    These are ln load, ln diameter, ln width, then slip, slip^2, pass number and speed where the table has
    them. The logarithm of a size that is not positive is NaN: a plate has no width.
    """
    sizes = [conditions[name] for name in ("load", "diameter", "width")]
    columns = [np.log(np.where(size > 0.0, size, np.nan)) for size in sizes]
    for name in ("slip", "pass_number", "speed"):
        if name in conditions:
            column = conditions[name]
            columns += [column, column**2] if name == "slip" else [column]
    return np.column_stack(columns)


def _soil_of(conditions: Conditions, row: Index) -> Texts:
    """Name of the soil of each value, shape (values,); empty where rows name none. row: as in `through`."""
    return np.full(row.size, "") if conditions.soil is None else conditions.soil[row]


def _gain(soil: Texts, soils: Texts, columns: Array, value: Array) -> Array:
    """Matrix that takes ln of the values to the intercept of each soil and the slope of each column.

    soil: of each value, shape (values,). soils: shape (soils,). columns: shape (values, used). Values under
    the median have less weight: their logarithms are less certain, and their size matters least.
    """
    weight = np.sqrt(np.minimum(value / np.median(value), 1.0))
    line = np.hstack([soil[:, None] == soils, columns]) * weight[:, None]
    return np.asarray(np.linalg.pinv(line, rcond=1e-8) * weight)


@dataclass(frozen=True)
class NoiseLine:
    """Log-log regression of measured values on the settings (formula: module's docstring).

    Attributes
    ----------
    soils
        Names of the soils; one empty name where rows name none.
    own
        Intercept of each soil, ln of the value in SI, shape (soils,).
    used
        Indices of the variables that are used, shape (used,), in the order ln load, ln diameter, ln width,
        slip, slip^2, pass number, speed.
    slopes
        Their slopes, shape (used,).
    """

    soils: tuple[str, ...]
    own: Array
    used: Index
    slopes: Array

    @classmethod
    def through(cls, value: Array, row: Index, conditions: Conditions) -> NoiseLine:
        """Fit the regression by weighted least squares.

        Only variables that were varied are used, and no more of them than half the number of values, less
        the number of soils. Values below the median have less weight.

        Parameters
        ----------
        value
            Measured values of one channel, positive, SI, shape (values,).
        row
            Row of the conditions of each value, shape (values,).
        conditions
            Settings of the rows: load, diameter, width and others, SI.
        """
        columns = _columns(conditions)
        known = np.isfinite(columns).all(axis=0)
        columns = columns[row]
        varied = np.flatnonzero(known & (np.ptp(np.where(known, columns, 0.0), axis=0) > _VARIED))
        mine = _soil_of(conditions, row)
        soils = np.unique(mine)
        used = varied[: max(value.size // _VALUES_A_COLUMN - len(soils), 0)]
        found = _gain(mine, soils, columns[:, used], value) @ np.log(value)
        return cls(tuple(soils.tolist()), found[: len(soils)], used, found[len(soils) :])

    def power_of_load(
        self, value: Array, row: Index, conditions: Conditions
    ) -> tuple[float, float]:
        """Return the power of the load to which the values are proportional, and its standard deviation.

        Parameters
        ----------
        value
            The values that the line was fitted to, positive, SI, shape (values,).
        row
            Row of the conditions of each value, shape (values,).
        conditions
            Settings of the rows: load, diameter, width and others, SI.

        Returns
        -------
        power, deviation : float
            (inf, 0) where the regression does not use the load, because it was not varied or values are too
            few.
        """
        if 0 not in self.used:
            return np.inf, 0.0
        columns = _columns(conditions)[row][:, self.used]
        gain = _gain(_soil_of(conditions, row), np.array(self.soils), columns, value)
        left = np.log(value) - np.log(self.at(conditions)[row])
        spare = max(value.size - len(self.own) - self.used.size, 1)
        place = int(np.flatnonzero(self.used == 0)[0])
        of_load = gain[len(self.own) + place]
        return float(self.slopes[place]), float(np.sqrt(left @ left / spare * (of_load @ of_load)))

    def at(self, conditions: Conditions) -> Array:
        """Values by the regression, SI, shape (rows,); soils not fitted have the mean intercept."""
        own = np.full(len(conditions), self.own.mean())
        if conditions.soil is not None:
            for name, level in zip(self.soils, self.own, strict=True):
                own[conditions.soil == name] = level
        return np.asarray(np.exp(own + _columns(conditions)[:, self.used] @ self.slopes))


def of_load(conditions: Conditions, channel: str) -> Array:
    """Return the scale of a force channel: the load, or the load times the radius for a torque.

    Parameters
    ----------
    conditions
        Settings of the rows: load, diameter, width and others, SI.
    channel
        `torque`, or one in N.

    Returns
    -------
    ndarray
        Shape (rows,), N or N m.
    """
    return conditions.load * (0.5 * conditions.diameter if channel == "torque" else 1.0)


def wheel_discrepancy(conditions: Conditions) -> Array:
    """Standard deviation of the error that the law of pull and torque makes for a wheel at all of its slips.

    Relative to the load (of torque, load times radius), shape (rows,): `FORCE_LUGS` for a wheel with lugs
    over a tenth of its radius, else `FORCE_WHEEL`.
    """
    if "grouser_height" not in conditions:
        return np.full(len(conditions), FORCE_WHEEL)
    high = conditions["grouser_height"] >= 0.05 * conditions.diameter
    return np.where(high, FORCE_LUGS, FORCE_WHEEL)


def levels_of(points: Points) -> Array:
    """Size of each value, to which its error is relative, in the unit of its channel, shape (values,).

    It is the value of a regression through the table (`NoiseLine`), within the measured range; for pull it is
    the load, for torque the load times the radius. No model and no effect changes it.

    The measured value itself would not do: with errors relative to it, every fit comes out too low, the more
    so the more values share an error (Peelle's puzzle; Fruehwirth et al. 2012, EPJ Web of Conferences 27,
    00008). Nor would a model's prediction: models are compared by evidence under one and the same variance.
    """
    level = np.maximum(np.abs(points.value), 1e-12)
    for name in points.channels:
        mine = points.of_channel(name)
        use = mine & (points.value > 0)
        if name in FORCES:
            level[mine] = of_load(points.conditions, name)[points.row[mine]]
        elif use.any():
            value = points.value[use]
            line = NoiseLine.through(value, points.row[use], points.conditions)
            found = line.at(points.conditions)[points.row[mine]]
            level[mine] = np.clip(found, value.min(), value.max())
        if mine.any():
            least = _SMALLEST * float(np.median(level[mine]))
            level[mine] = np.maximum(level[mine], max(least, 1e-9))
    return np.asarray(level)


@dataclass(frozen=True)
class RowNoise:
    """Repeatability of one row of a channel, as a standard deviation in two parts.

    Attributes
    ----------
    absolute
        Constant part, m, N or N m.
    relative
        Part proportional to the size of the value (`levels_of`), dimensionless.
    source
        `repeats` of a setting within a run, deviations that the table declares (`declared`), or
        `residuals`: there are neither, and the fit's variance components contain the repeatability.
    freedom
        Degrees of freedom of the repeats; 0 if there are none.
    """

    absolute: float
    relative: float
    source: Literal["repeats", "declared", "residuals"]
    freedom: int

    def variance(self, level: Array) -> Array:
        """Variance of one row: absolute^2 + (relative * level)^2 for values of size `level`, in its shape."""
        return np.asarray(self.absolute**2 + (self.relative * level) ** 2)


@dataclass(frozen=True)
class Repeats:
    """Repeatability of each channel, and the variance that it gives to each value.

    Attributes
    ----------
    channels
        Repeatability of a row, by channel.
    variance
        Variance of each value, the mean of its rows, from repeats, SI, shape (values,); 0 for channels
        without repeats.
    stated
        Variance of that mean by the deviations that the table declares, SI, shape (values,); 0 where
        repeats are used instead, or nothing is declared.
    """

    channels: Mapping[str, RowNoise]
    variance: Array
    stated: Array


def repeats_of(points: Points, level: Array) -> Repeats:
    """Estimate the repeatability of each channel, and the variance that it gives to each value.

    Deviations that the table declares for every value of a channel are used, times one factor that repeats
    determine; else repeats alone, as in `RowNoise`.

    Parameters
    ----------
    points
        Measured values, each a mean over rows of one run and setting.
    level
        L, the size of each value (`levels_of`), shape (values,), m, N or N m.

    Returns
    -------
    Repeats
        By channel, and of each value.
    """
    channels: dict[str, RowNoise] = {}
    variance, stated = np.zeros(len(points)), np.zeros(len(points))
    for name in points.channels:
        mine = np.flatnonzero(points.of_channel(name))
        measured, count = points.measurements.channels[name], points.count[mine]
        apart = [_apart(measured[points.rows[i]], bool(points.swept[i])) for i in mine]
        squares, freedom = (
            np.array([(d @ d, free) for d, free in apart if free > 0]).reshape(-1, 2).T
        )
        kept = mine[[free > 0 for _, free in apart]]
        declared = points.declared[mine]
        if freedom.size and np.isfinite(declared).all():
            noise, factor = _scaled(squares, freedom, points.declared[kept])
            variance[mine] = factor * declared**2 / count
        elif freedom.size:
            noise = _two_terms(squares, freedom, level[kept])
            variance[mine] = noise.variance(level[mine]) / count
        elif np.isfinite(declared).all():
            noise = RowNoise(float(np.sqrt(np.mean(declared**2))), 0.0, "declared", 0)
            stated[mine] = declared**2 / count
        else:
            noise = RowNoise(0.0, ROW_NOISE, "residuals", 0)
        channels[name] = noise
    return Repeats(channels, variance, stated)


def _apart(values: Array, swept: bool) -> tuple[Array, int]:
    """Deviations of the rows of a point from their mean (a line in a swept run), and degrees of freedom."""
    n = values.size
    apart = values - values.mean()
    if not swept or n < 3:
        return apart, (0 if swept else n - 1)
    x = np.arange(n) - (n - 1) / 2
    return np.asarray(apart - x * (x @ apart) / (x @ x)), n - 2


def _scaled(squares: Array, freedom: Array, declared: Array) -> tuple[RowNoise, float]:
    """Noise by the declared deviations times one factor on their squares, and that factor.

    Before any repeats the factor is 1, with the weight of one repeat.
    """
    factor = float((np.sum(squares / declared**2) + 1.0) / (freedom.sum() + 1.0))
    size = float(np.sqrt(factor * np.mean(declared**2)))
    return RowNoise(size, 0.0, "repeats", int(freedom.sum())), factor


def _two_terms(squares: Array, freedom: Array, level: Array) -> RowNoise:
    """Estimate absolute and relative noise, averaged over a grid of shares weighted by their likelihood.

    The most likely share alone would not do: a few repeats hardly show which of the two parts it is.
    `ROW_NOISE` has the weight of one repeat.
    """
    middle = float(np.sqrt(np.mean(level**2)))
    total = float(freedom.sum()) + 1.0
    shape = (1.0 - _SHARES)[:, None] + _SHARES[:, None] * (level / middle) ** 2
    scale = (np.sum(squares / shape, axis=1) + (ROW_NOISE * middle) ** 2) / total
    cost = total * np.log(scale) + np.sum(freedom * np.log(shape), axis=1)
    weight = np.exp(-0.5 * (cost - cost.min()))
    weight /= weight.sum()
    absolute = float(np.sqrt(np.sum(weight * (1.0 - _SHARES) * scale)))
    relative = float(np.sqrt(np.sum(weight * _SHARES * scale))) / middle
    return RowNoise(absolute, relative, "repeats", int(freedom.sum()))


# --- Values that do not belong


def furthest_off(groups: list[Array]) -> list[tuple[int, int]]:
    """Find gross outliers: at most one value in each group, the one furthest from the group's median.

    The distance is measured in robust standard deviations for the size of the group's median, from
    absolute^2 + (relative * size)^2 as in `RowNoise`, so that values near zero (a pull) are judged alike.
    Only the worst value of a group is listed, since it shifts the median of the others.

    Parameters
    ----------
    groups
        Values that should agree, in one unit, shape (values of the group,) each.

    Returns
    -------
    list of (int, int)
        Index of the group, and of the value in it; empty where more than a share `MOST_OUTLIERS` of the
        groups have an outlier, since the noise is then heavy-tailed.
    """
    middles = np.array([np.median(values) for values in groups])
    off = [np.abs(values - middle) for values, middle in zip(groups, middles, strict=True)]
    size = np.maximum(np.abs(middles), 1e-12)
    # The value in the middle is off by nothing, and says nothing.
    counted = [np.delete(one, np.argmin(one)) for one in off]
    usual = _usual_deviation(counted, size)
    shares = [one / deviation for one, deviation in zip(off, usual, strict=True)]
    limit = outlier_limit(sum(one.size for one in counted))
    found = [(g, int(np.argmax(s))) for g, s in enumerate(shares) if float(s.max()) > limit]
    return found if len(found) <= max(1.0, MOST_OUTLIERS * len(groups)) else []


def _usual_deviation(off: list[Array], size: Array) -> Array:
    """Robust standard deviation of values in each group, shape (groups,).

    The absolute part is estimated from the groups of smaller size, the relative part from those of larger
    size.
    """
    middle = np.median(size)
    small = np.concatenate([one for one, s in zip(off, size, strict=True) if s <= middle])
    large = np.concatenate([one / s for one, s in zip(off, size, strict=True) if s >= middle])
    absolute, relative = NORMAL * float(np.median(small)), NORMAL * float(np.median(large))
    return np.asarray(np.maximum(np.hypot(absolute, relative * size), 1e-6 * middle))


def outlier_limit(count: int) -> float:
    """Number of robust standard deviations from which one of `count` values is an outlier.

    This is `OUTLIER`, or more where there are so few values to estimate the deviation from that in more
    than a share `CLEAN` of tables one of them would exceed it by chance. A median is about half as
    efficient as a sum of squares.
    """
    return max(OUTLIER, -float(stdtrit(max(0.5 * count, 1.0), 0.5 * CLEAN / max(count, 1))))


def outlier_rows(points: Points) -> Index:
    """Numbers of the table's rows far from the others of their point, or from neighbours along a curve."""
    found = [row for rows in _curves(points) for row in spikes(rows)]
    for name in points.channels:
        measured = points.measurements.channels[name]
        mask = points.of_channel(name) & (points.count >= _FEWEST) & ~points.swept
        members = [points.rows[i] for i in np.flatnonzero(mask)]
        if members:
            far = furthest_off([measured[rows] for rows in members])
            found += [int(members[g][i]) for g, i in far]
    return np.unique(np.array(found, dtype=np.intp))


def _curves(points: Points) -> Iterator[tuple[Index, Array]]:
    """Rows of each swept run in order, with the values measured there: load, then channel by channel."""
    table, codes = points.measurements, runs_of(points.measurements)[1]
    for run in np.unique(points.run[points.swept]):
        for values in (table.conditions.load, *(table.channels[n] for n in points.channels)):
            rows = np.flatnonzero((codes == run) & np.isfinite(values))
            yield rows, values[rows]


def spikes(curve: tuple[Index, Array]) -> Index:
    """Find rows that differ from their neighbours along a curve by more than `OUTLIER` usual deviations.

    The difference is that from the running median of seven rows. The usual deviation is the largest of
    three numbers: that of all rows from the running median, the median step between the rows around, and a
    hundredth of the range of the curve (20 to 80 %).

    Parameters
    ----------
    curve : (ndarray, ndarray)
        Numbers of the table's rows, and the values measured there, in order along the curve, shape (rows,)
        each.

    Returns
    -------
    ndarray
        Numbers of the rows that are spikes; empty where more than a share `_MOST_SPIKES` of the rows differ
        so much, or the curve has fewer than 12 rows.
    """
    rows, values = curve
    if rows.size < 4 * _AROUND:
        return rows[:0]
    first = np.clip(np.arange(rows.size) - _AROUND, 0, rows.size - 2 * _AROUND - 1)
    around = values[first[:, None] + np.arange(2 * _AROUND + 1)]
    off = np.abs(values - np.median(around, axis=1))
    step = np.median(np.abs(np.diff(around, axis=1)), axis=1)
    span = float(np.quantile(values, 0.8) - np.quantile(values, 0.2))
    usual = np.maximum(step, max(NORMAL * float(np.median(off)), _OF_SPAN * span))
    # Near either end the median is that of rows some steps away.
    away = np.abs(np.arange(rows.size) - first - _AROUND)
    far = off > OUTLIER * usual + away * step
    few = np.count_nonzero(far) <= _MOST_SPIKES * rows.size
    return rows[far] if few else rows[:0]
