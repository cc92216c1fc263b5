# SPDX-License-Identifier: Apache-2.0
"""Which rows of a table were measured at the same setting, and which are repeats of one run.

A rig does not hit a setting exactly and a load cell does not read it exactly, so two rows are of one
setting if everything that was set agrees within a tolerance:

    load        10 % (in ln load): wheels lift and dive by that much at one dead weight
    diameter     2 % (in ln diameter): a wheel's rubber and wear
    width        2 mm: the same
    covariates   the largest of 4 % of the column's range, 2 % of its largest absolute value (not for a
                 temperature in K), and `ColumnSpec.same`: differences finer than a twenty-fifth of the
                 range cannot show an effect. The pass is a count: half a pass.
    contact, soil, and the wheel where the table names wheels: equal

Responses of the wheel (`Measurements.responses`), and columns that only identify a row (time,
trial), are not settings.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.measurements.columns import COLUMNS, OTHER, Array, Mask, is_bookkeeping
from smallwheel_ros.measurements.measurements import Measurements, codes_of

Index = NDArray[np.intp]

LOAD_TOLERANCE = 0.10  # of ln load
DIAMETER_TOLERANCE = 0.02  # of ln diameter
VARIES = 0.05  # of a setting's largest value: one that spans less was not varied
OF_RANGE = 0.04
_OF_SIZE = 0.02
_BACK = 0.5  # of what a curve had reached: less begins another
# Numbers that differ by less are equal but for the rounding of a unit's conversion.
_EXACT = 1e-9
# Gap between set points over the scatter of readings at one of them. With 2, no reading is nearer to
# one of another set point than to the furthest of its own, with room for the next reading.
_APART = 2.0
_FEW_VALUES = 5  # a column with at most so many different values is split by value
_PARTS = 4  # otherwise into so many parts of about as many rows
_FEWEST = 3  # degrees of freedom below which a spread says nothing


def one_row_a_wheel(data: Measurements) -> bool:
    """Whether runs have one row for each of several named wheels, as on a vehicle.

    Tables that `replay` writes are of this kind: their runs are stretches of the drive.
    """
    if not data.wheels_given:
        return False
    pairs = set(zip(data.run.tolist(), data.wheel.tolist(), strict=True))
    return len(pairs) == len(data) > len({run for run, _ in pairs})


def set_columns(measurements: Measurements) -> tuple[str, ...]:
    """Covariates that were set: neither responses of the wheel nor the row's time or number."""
    answers = measurements.responses
    names = measurements.conditions.covariates
    return tuple(name for name in names if name not in answers and not is_bookkeeping(name))


def order_columns(measurements: Measurements) -> tuple[str, ...]:
    """Covariates that may show when a row was measured: a time, or the number of row or trial."""
    names = measurements.conditions.covariates
    return tuple(name for name in names if is_bookkeeping(name))


def setting_columns(measurements: Measurements) -> dict[str, Array]:
    """Settings by name: load, diameter, width and every covariate that was set, shape (rows,)."""
    names = ("load", "diameter", "width", *set_columns(measurements))
    return {name: measurements.conditions[name] for name in names}


def varies(column: Array) -> bool:
    """Whether the range of a setting is over 5 % (`VARIES`) of its largest absolute value; NaN is ignored."""
    known = column[np.isfinite(column)]
    size = float(np.max(np.abs(known), initial=0.0))
    return size > 0.0 and float(np.ptp(known)) > VARIES * size


def varied_settings(measurements: Measurements) -> dict[str, Array]:
    """The settings that were varied, by name, shape (rows,)."""
    return {n: column for n, column in setting_columns(measurements).items() if varies(column)}


def _tolerances(measurements: Measurements, wheels: bool) -> list[tuple[Array, float]]:
    """Columns of the settings, texts as codes, and the largest difference of two values of one setting.

    wheels: whether the wheel's name is a part of the setting.
    """
    c = measurements.conditions
    found = [
        (np.log(c.load), LOAD_TOLERANCE),
        (np.log(c.diameter), DIAMETER_TOLERANCE),
        (c.width, COLUMNS["width"].same),
    ]
    for name in set_columns(measurements):
        same = COLUMNS.get(name, OTHER).same
        known = c[name][np.isfinite(c[name])]
        if name != "pass_number" and known.size:
            # The zero of the kelvin scale is far from any setting, so the size of a value in K means nothing.
            size = 0.0 if measurements.units.get(name) == "K" else np.max(np.abs(known))
            same = max(same, OF_RANGE * float(np.ptp(known)), _OF_SIZE * float(size))
        found.append((c[name], same))
    texts = [c.contact, measurements.soil, *([measurements.wheel] if wheels else [])]
    return found + [(codes_of(text)[1].astype(float), 0.0) for text in texts]


def cluster(values: Array, tolerance: float) -> Index:
    """Group values that are close to each other; values of one group differ by `tolerance` at most.

    Neighbours are joined over the narrowest gap first, while the span allows (complete linkage in one
    dimension). Values that are close to each other and far from all others thus always are one group,
    where a fixed grid of bins would split some of them.

    Parameters
    ----------
    values
        Shape (values,).
    tolerance
        Largest difference within a group, in the unit of the values.

    Returns
    -------
    ndarray of int
        Number of each value's group, rising with the values from 0, shape (values,); -1 for NaN.
    """
    codes = np.full(values.size, -1, dtype=np.intp)
    known = np.isfinite(values)
    levels, index = np.unique(values[known], return_inverse=True)
    if levels.size == 0:
        return codes
    gaps = np.diff(levels)
    # first[i], last[i]: the ends of the group that begins or ends at level i
    first, last = np.arange(levels.size), np.arange(levels.size)
    joined = np.zeros(gaps.size, dtype=bool)
    narrow = np.flatnonzero(gaps <= tolerance)
    for gap in narrow[np.argsort(gaps[narrow], kind="stable")].tolist():
        low, high = first[gap], last[gap + 1]
        if levels[high] - levels[low] <= tolerance:
            joined[gap] = True
            first[high], last[low] = low, high
    of_level = np.concatenate([[0], np.cumsum(~joined)]).astype(np.intp)
    codes[known] = of_level[index.reshape(-1)]
    return codes


def _combined(columns: Iterable[Index]) -> Index:
    """One code for each combination, numbered in the order in which they first appear."""
    codes: Index = np.zeros(1, dtype=np.intp)
    for column in columns:
        codes = codes_of(codes * (int(column.max(initial=0)) + 2) + column + 1)[1]
    return codes


def settings_of_rows(measurements: Measurements) -> Index:
    """Number of each row's setting, shape (rows,): 0, 1, ... in the order of first appearance.

    Rows with one number agree in everything that was set, within the tolerances of this module's docstring.
    The names of the wheels of one vehicle are no part of the setting. A blank covariate only agrees with a
    blank one.
    """
    wheels = measurements.wheels_given and not one_row_a_wheel(measurements)
    return _combined(cluster(*column) for column in _tolerances(measurements, wheels))


def runs_of_rows(measurements: Measurements) -> tuple[tuple[str, ...], Index]:
    """Names of the runs and each row's index into them, shape (rows,), in order of appearance.

    Where the table names no runs, rows of one setting are repeats and make one run: taking them as
    independent would count one piece of evidence several times. Responses of the wheel, and the row's
    time or number, may differ among repeats.
    """
    if measurements.runs_given:
        names, codes = codes_of(measurements.run)
    else:
        codes = setting_codes(measurements)
        names = [f"setting {i + 1}" for i in range(int(codes.max(initial=-1)) + 1)]
    return tuple(names), codes


def setting_codes(measurements: Measurements) -> Index:
    """Code of the set point that each row was measured at, shape (rows,), in order of appearance."""
    columns = _tolerances(measurements, measurements.wheels_given)
    return _combined(_set_points(*column) for column in columns)


def _set_points(values: Array, tolerance: float) -> Index:
    """Codes of the values that were meant to be equal, shape (rows,); NaN has code -1.

    Readings of one set point scatter, and set points lie apart. So neighbours within the tolerance get one
    code, if every group of them lies further from the next than `_APART` times the width of the widest. In a
    sweep or a curve that does not hold, and only equal values get one code.
    """
    known = np.flatnonzero(np.isfinite(values))
    order = known[np.argsort(values[known])]
    gaps = np.diff(values[order])
    apart = gaps > tolerance
    if order.size:
        first, last = np.append(True, apart), np.append(apart, True)
        widest = np.max(values[order[last]] - values[order[first]])
        if widest > tolerance or np.min(gaps[apart], initial=np.inf) <= _APART * widest:
            apart = gaps > _EXACT * np.max(np.abs(values[order]))
    codes = np.full(values.size, -1, dtype=np.intp)
    codes[order] = np.concatenate([[0], np.cumsum(apart)])[: order.size]
    return codes


def ends_of_runs(values: Array, run: Index, count: int) -> tuple[Array, Array]:
    """Smallest and largest value in each run, each of shape (count,); inf and -inf for a run without values.

    Parameters
    ----------
    values
        Values of a column, shape (rows,); NaN is ignored.
    run
        Number of each row's run, from 0, shape (rows,).
    count
        Number of runs.
    """
    low, high = np.full(count, np.inf), np.full(count, -np.inf)
    np.fmin.at(low, run, values)
    np.fmax.at(high, run, values)
    return low, high


def repeats_of_rows(measurements: Measurements) -> Index:
    """Number of each row's run if the run's rows are repeats of one setting, else -1; shape (rows,).

    A run in which any setting varies by more than its tolerance is a curve or a sweep: its rows
    are not repeats, and neighbours among them show nothing of the repeatability.
    """
    names, run = runs_of_rows(measurements)
    same = np.ones(len(names), dtype=bool)
    for values, tolerance in _tolerances(measurements, measurements.wheels_given):
        low, high = ends_of_runs(values, run, len(names))
        same &= ~(high - low > tolerance)  # all blank: -inf
    return np.where(same[run], run, -1)


def curves_of_rows(tracks: Sequence[Array], other: Callable[[int, int], bool]) -> Index:
    """Number of each row's curve, from 0, shape (rows,), in a table that lists one curve after the other.

    Parameters
    ----------
    tracks
        Quantities that rise along a curve, shape (rows,) each. A new curve begins where all of them fall
        below half of the largest value that each has reached in the curve.
    other
        Takes the indices of a curve's first row and of a later one; returns whether the later one cannot
        belong to that curve.
    """
    curve = np.zeros(len(tracks[0]), dtype=np.intp)
    first, reached = 0, [track[0] for track in tracks]
    for i in range(1, curve.size):
        now = [track[i] for track in tracks]
        back = all(x < _BACK * most for x, most in zip(now, reached, strict=True))
        if back or other(first, i):
            first, reached = i, now
        else:
            reached = [max(x, most) for x, most in zip(now, reached, strict=True)]
        curve[i] = curve[i - 1] + (first == i)
    return curve


def repeatability(measurements: Measurements) -> dict[str, float]:
    """Standard deviation (SI) among repeats within a run, for each channel that has repeats.

    Repeats differ by noise, the "pure error" of regression, and no model can predict better than that. It is
    pooled over the runs:

        sigma^2 = sum over runs, rows of (y - mean of the run)^2 / sum over runs of (rows - 1)

    Differences between runs, for which the soil was prepared anew, are not included, so the held-out error
    of even the true model is somewhat larger. A channel is absent if it has fewer than three degrees of
    freedom, the sum of (rows - 1), or if repeats never differ.
    """
    index = repeats_of_rows(measurements)
    found = {}
    for name in measurements.channels:
        rows = measurements.channel_rows(name)
        rows = rows[index[rows] >= 0]
        value, run = measurements.channels[name][rows], index[rows]
        count = np.bincount(run)
        mean = np.bincount(run, value) / np.maximum(count, 1)
        freedom = int(np.maximum(count - 1, 0).sum())
        squares = float(np.sum((value - mean[run]) ** 2))
        if freedom >= _FEWEST and squares > 0.0:
            found[name] = float(np.sqrt(squares / freedom))
    return found


@dataclass(frozen=True)
class Part:
    """Rows selected by the values of one column.

    Attributes
    ----------
    by
        Name of the column, as "slip".
    label
        Its values in words, as "0.2 to 0.4".
    rows
        Mask of the rows, shape (rows,).
    range
        Limits of a numeric column, SI: one value if the column has few, else two; empty for a text.
    """

    by: str
    label: str
    rows: Mask
    range: tuple[float, ...] = ()


def parts(measurements: Measurements) -> list[Part]:
    """Parts of the rows: split by soil, by wheel, by contact and by each setting that was varied."""
    texts = {
        "soil": measurements.soil,
        "wheel": _wheels(measurements),
        "contact": measurements.conditions.contact,
    }
    found: list[Part] = []
    for by, names in texts.items():
        kinds = np.unique(names)
        if kinds.size > 1:
            found += [Part(by, str(kind) or "not named", names == kind) for kind in kinds]
    for by, values in varied_settings(measurements).items():
        found += _by_value(by, values)
    return found


def _wheels(measurements: Measurements) -> NDArray[np.str_]:
    """Names of the wheels; with the size where wheels of several sizes share one name."""
    size = measurements.conditions.diameter
    names = measurements.wheel
    shared = any(np.unique(np.round(size[names == n], 6)).size > 1 for n in np.unique(names))
    if not shared:
        return names
    return np.array([f"{n} {1e3 * d:.4g} mm" for n, d in zip(names, size, strict=True)])


def levels(values: Array) -> Array | None:
    """The different values of a column that has at most five, rising, shape (values,); else None.

    Values within 4 % of the column's range count as one, their mean. At least one value must be finite.
    """
    known = values[np.isfinite(values)]
    code = cluster(known, OF_RANGE * float(np.ptp(known)))
    if code.max() >= _FEW_VALUES:
        return None
    return np.asarray(np.bincount(code, known) / np.bincount(code), dtype=float)


def _by_value(by: str, values: Array) -> list[Part]:
    known = np.isfinite(values)
    few = levels(values)
    if few is not None:
        nearest = np.abs(values[:, None] - few).argmin(axis=1)
        return [
            Part(by, f"{level:.4g}", known & (nearest == i), (float(level),))
            for i, level in enumerate(few)
        ]
    edges = np.unique(np.quantile(values[known], np.linspace(0, 1, _PARTS + 1)))
    number = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, edges.size - 2)
    found = [
        Part(by, f"{low:.3g} to {high:.3g}", known & (number == i), (float(low), float(high)))
        for i, (low, high) in enumerate(pairwise(edges))
    ]
    return [part for part in found if part.rows.any()]
