# SPDX-License-Identifier: Apache-2.0
"""Estimates of each row that is due: forces, conditions, margin and risk, with NaN for what is unknown.

margin   of any ground (`warning.margin`), or the strength filter's, where the soil's law is measured and
         something has shown its strength: the one of smaller deviation, never a mean of both
risk     probability that a place ahead does not give the pull still needed, at any slip: the cost of a
         cell of the map that requires as much; at least 0.5 above the first level of the warning
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from statistics import median
from typing import NamedTuple

import numpy as np
from scipy.special import chdtri, ndtr

from smallwheel_ros.common.stamps import SECOND
from smallwheel_ros.onboard.settings import SLOWEST_RIM, OnboardSettings
from smallwheel_ros.physics.conditions import ROLLING
from smallwheel_ros.pipeline.soil.local_law import Version
from smallwheel_ros.pipeline.soil.stretches import Loads
from smallwheel_ros.pipeline.strength.two_filters import Strengths
from smallwheel_ros.pipeline.strength.words import is_determined, is_told
from smallwheel_ros.pipeline.tables import (
    Array,
    Estimates,
    Flags,
    Integers,
    Mobility,
    Readings,
    none_of,
)
from smallwheel_ros.pipeline.versions import Versions
from smallwheel_ros.pipeline.warning.hazard import risk_of
from smallwheel_ros.pipeline.warning.judgement import Judged
from smallwheel_ros.pipeline.warning.margin import is_prior, risk_ahead

from .status import Condition, status_of
from .wheel import SUNK, Predicted, mobility

STALE = 2 * SECOND  # ns, after which a wheel's margin does not count for the vehicle
# A sinkage is compared with the median of the 7 newest ones, and is far off from 3 deviations of the sensor
# on. One that is far from the prediction only is good: then the soil is another.
_NEWEST, _FAR = (
    7,
    3.0,
)
_STEEPEST = 0.87  # sine of 60 degrees, on which no vehicle drives
_GOOD = 0.999  # share of good readings that are recognised as good: at 10 Hz all but one in 100 s


@dataclass(frozen=True)
class OnGround(Loads):
    """Load, and numbers of the versions of soil and strength, at each row.

    Attributes
    ----------
    load, load_std
        Load without its cell's noise, and its standard deviation, N.
    soil_version
        Number of the version of the soil under the wheel.
    first_soil
        Number of the soil that the first wheels are on.
    strength_version
        Number of the version of the strength.
    refused
        Number of measured sinkages that were refused as implausible or untimely up to then.
    """

    soil_version: Integers
    first_soil: Integers
    strength_version: Integers
    refused: Integers


class KnownGround(NamedTuple):
    """Soils and strengths by the numbers of their versions.

    Attributes
    ----------
    soils
        Versions of the soil's law.
    strengths
        Estimator of the strength, whose `believed` holds the versions.
    """

    soils: Versions[Version]
    strengths: Strengths


@dataclass
class AnswerState:
    """State carried from block to block.

    Attributes
    ----------
    newest
        Newest row of each wheel with a margin by soil and strength, by number: stamp (ns), load (N), median
        of the margin, standard deviation of its lower half, and its gain beyond the reference slip. The
        median of a wheel that is sunk to its axle is `SUNK`.
    shown
        Newest measured sinkages of each wheel, m, by number.
    risk
        Newest risk of getting stuck, 0 to 1; NaN before the first.
    slopes
        Stamps (ns), and gravity's components ahead and to the side (m/s^2), over the last 2 s.
    """

    newest: dict[int, tuple[int, float, float, float, float]] = field(default_factory=dict)
    shown: dict[int, list[float]] = field(default_factory=dict)
    risk: float = np.nan
    slopes: tuple[Integers, Array, Array] = field(
        default_factory=lambda: (np.empty(0, dtype=np.int64), np.empty(0), np.empty(0))
    )


def answer(
    state: AnswerState, rows: Readings, judged: Judged, ground: OnGround, known: KnownGround,
    settings: OnboardSettings,
) -> Estimates:  # fmt: skip
    """Compute the estimates of all rows that are due.

    Parameters
    ----------
    state
        State carried from block to block; it is updated.
    rows
        Readings of the block, due or not.
    judged
        Level of the warning, and margin by slip and accelerometer alone, at each row.
    ground
        Load, and versions of soil and strength, at each row.
    known
        Soils and strengths by version.
    settings
        The pipeline's settings.

    Returns
    -------
    Estimates
        A row for each row that is due, in the same order; empty if there is none.
    """
    due = np.flatnonzero(rows.due)
    if not due.size:
        return none_of(Estimates)
    rows, judged, ground = rows.take(due), judged.take(due), ground.take(due)
    soils, strengths, loads = known.soils, known.strengths, ground
    soil_version, strength_version = ground.soil_version, ground.strength_version
    wheels, count = settings.wheels, len(rows)
    rolls = np.array([w.contact == ROLLING for w in wheels])[rows.wheel]
    static = np.array([w.name in settings.static_loads for w in wheels])[rows.wheel]
    sensed = np.array([w.name not in settings.without_sinkage for w in wheels])[rows.wheel]
    of = [soils[one] for one in soil_version.tolist()]
    measured = np.array([version.accepted > 0 for version in of])
    by_law = measured | strengths.measured  # also one from a model file
    loaded = np.flatnonzero(np.isfinite(loads.load))
    made = mobility(
        rows.take(loaded), loads.load[loaded], loads.load_std[loaded], soil_version[loaded],
        strength_version[loaded], soils, strengths, settings,
    )  # fmt: skip
    can = _among(made, loaded, count)
    predicted = np.isfinite(can.sinkage) & (measured | (not settings.law_unknown))
    if settings.law_unknown:
        can = _without_law(can, measured)
    sunk = can.sunk & by_law
    digging = rolls & (judged.level == 2)
    slip_unknown = rolls & ~np.isfinite(rows.slip)
    # Without slip a model whose effects read it has no sinkage: then slip is what is missing.
    waits = slip_unknown & bool(settings.covariates)
    has = {
        Condition.PRIOR_ONLY: ~measured,
        Condition.LAW_UNKNOWN: ~measured & settings.law_unknown,
        Condition.SLIP_UNKNOWN: slip_unknown,
        Condition.STANDS: slip_unknown & (np.abs(rows.speed) <= SLOWEST_RIM),
        Condition.ANGLE_UNKNOWN: slip_unknown & np.isnan(rows.steering),
        Condition.DOES_NOT_FIT: _does_not_fit(state, rows, can, settings),
        Condition.NOT_USED: sensed & ~np.isfinite(rows.sinkage),
        Condition.LOAD_MISSING: ~np.isfinite(loads.load),
        Condition.NOTHING_PREDICTED: np.isfinite(loads.load)
        & ~can.sunk & ~predicted & ~waits & (measured | (not settings.law_unknown)),
        Condition.SUNK_TO_AXLE: sunk,
        Condition.LOAD_STATIC: static & np.isfinite(loads.load),
        Condition.DIGS: digging,
        Condition.WARNED: rolls & (judged.level > 0),
    }  # fmt: skip
    pull_known, reserve_told = _known_strength(strengths, strength_version)
    margin, margin_std, median, lower_std, beyond, by_soil, risk = _margins(
        state, rows, can, judged, measured & reserve_told, sunk, strengths.measured, rolls
    )  # fmt: skip
    has[Condition.MARGIN_OF_PRIOR] = (
        rolls & (not strengths.measured) & is_prior(margin_std, settings.reference_slip)
    )
    has[Condition.STRENGTH_OF_PRIOR] = (
        np.isfinite(can.drawbar_pull) & (not strengths.measured) & ~pull_known
    )
    conditions = np.zeros(count, dtype=np.int64)
    for condition, applies in has.items():
        conditions |= np.where(applies, int(condition), 0)
    columns = {column.name: getattr(can, column.name) for column in fields(Mobility)}
    columns |= {"margin": margin, "margin_std": margin_std}
    return Estimates(
        **columns, stamp=rows.stamp, wheel=rows.wheel, slip=rows.slip, slip_std=rows.slip_std,
        sinkage_measured=rows.sinkage, sinkage_measured_std=rows.sinkage_std, distance=rows.distance,
        x=rows.x, y=rows.y, heading=rows.heading,
        steering=rows.steering, slip_angle=rows.slip_angle, course=rows.course,
        tilt=_tilt(state, rows, settings.gravity),
        status=status_of(conditions), conditions=conditions,
        probability_drawbar_pull_positive=ndtr(can.drawbar_pull / can.drawbar_pull_std),
        steepest_slope=np.arctan(margin), steepest_slope_std=margin_std / (1.0 + margin**2),
        margin_median=median, margin_lower_std=lower_std, margin_beyond=beyond, demand=judged.asked,
        risk=risk, digging_in=digging, spins=judged.spins,
        elsewhere=np.array([v.number for v in of], dtype=np.int64) != ground.first_soil,
        margin_by_soil=by_soil,
        rejected=ground.refused + np.array([v.outliers for v in of], dtype=np.int64),
        soil_version=soil_version, strength_version=strength_version,
    )  # fmt: skip


def _among(some: Predicted, known: Integers, count: int) -> Predicted:
    """Put predictions of the rows with these indices into a table of `count` rows, the others unknown."""
    if known.size == count:
        return some
    whole = Predicted.unknown(count)
    for name, column in vars(whole).items():
        column[known] = getattr(some, name)
    return whole


def _without_law(can: Predicted, measured: Flags) -> Predicted:
    """Set to NaN what rests on the law alone where that is not measured, for a soil that nobody has named."""
    names = (
        "sinkage",
        "compaction_resistance",
        "other_resistance",
        "rolling_resistance_coefficient",
    )
    columns = vars(can).copy()
    for name in (*names, *(f"{one}_std" for one in names)):
        columns[name] = np.where(measured, columns[name], np.nan)
    return Predicted(**columns)


def _does_not_fit(
    state: AnswerState, rows: Readings, can: Predicted, settings: OnboardSettings
) -> Flags:
    """Whether a sinkage is far both from those just before it and from the predicted one, (rows,)."""
    gate = float(chdtri(1, 1.0 - _GOOD))
    noise = np.where(
        np.isfinite(rows.sinkage_std), rows.sinkage_std, settings.estimator.sinkage_std
    )
    off = (rows.sinkage - can.sinkage) ** 2 > gate * (can.sinkage_std**2 + noise**2)
    found = np.zeros(off.shape, dtype=bool)
    for i in np.flatnonzero(np.isfinite(rows.sinkage)).tolist():
        shown = state.shown.setdefault(int(rows.wheel[i]), [])
        shown.append(float(rows.sinkage[i]))
        del shown[:-_NEWEST]
        far = abs(shown[-1] - median(shown)) > _FAR * noise[i]
        found[i] = far and bool(off[i])
    return found


def _margins(
    state: AnswerState, rows: Readings, can: Predicted, judged: Judged, told: Flags, sunk: Flags,
    measured: bool, rolls: Flags,
) -> tuple[Array, Array, Array, Array, Array, Flags, Array]:  # fmt: skip
    """Choose the margin of each row, and compute its risk.

    told: mask of the rows for which the soil's law was measured, and its strength narrowed by some
    measurement; sunk: of those whose wheel is sunk to its axle by a measured law. The deviations of both
    margins are honest, so the margin with the smaller one is closer: that of any ground is the mean of a
    belief with a long upper half, and is too high for as long as little is known. measured: whether the
    strength is from a model file, as measured; then the margin is the filter's from the start. rolls: mask of
    the rows of rolling wheels; of others all is NaN.

    A wheel that is sunk to its axle has no margin of its own. It counts as `SUNK` in the vehicle's risk,
    which is that of all rows as long as such a wheel's newest row is at most 2 s old.

    Returns seven columns: margin, its standard deviation, its median, standard deviation of its lower half,
    its gain from the reference slip to the slip at which the vehicle no longer moves, whether it is the
    strength filter's, and the risk.
    """
    by_filter = told & ~(can.margin_std >= judged.margin_std)
    by_filter = (by_filter | measured) & np.isfinite(can.margin)
    by_filter |= sunk
    margins = [
        np.where(rolls, np.where(by_filter, ours, of_any), np.nan)
        for ours, of_any in (
            (can.margin, judged.margin), (can.margin_std, judged.margin_std),
            (can.margin, judged.median), (can.margin_std, judged.lower_std),
            (can.beyond, judged.beyond),
        )
    ]  # fmt: skip
    shown = [np.where(sunk, np.nan, column) for column in margins]
    _, _, median, lower, beyond = margins
    risk = judged.risk.copy()
    known, of_vehicles = list[int](), []
    for i in np.flatnonzero(rolls).tolist():
        now = int(rows.stamp[i])
        if by_filter[i]:
            state.newest[int(rows.wheel[i])] = now, can.load[i], median[i], lower[i], beyond[i]
        recent = [one[1:] for one in state.newest.values() if now - one[0] <= STALE]
        if by_filter[i] or any(one[1] == SUNK for one in recent):
            # All wheels stand on one estimated soil, so their errors are taken to go together.
            load, *of_vehicle = np.array(recent).T
            known.append(i)
            of_vehicles.append([float(load @ each) / float(load.sum()) for each in of_vehicle])
    if known:
        risk[known] = risk_ahead(judged.asked[known], *np.array(of_vehicles).T)
    risk = np.where(rolls, risk_of(risk, judged.level), np.nan)
    if risk.size and np.isfinite(risk).any():
        state.risk = float(risk[np.isfinite(risk)][-1])
    margin, deviation, median, lower, beyond = shown
    return margin, deviation, median, lower, beyond, by_filter & rolls, risk


def _known_strength(strengths: Strengths, versions: Integers) -> tuple[Flags, Flags]:
    """Masks of rows whose strength is determined for the present pull, and measured at all for the margin."""
    kinds, index = np.unique(versions, return_inverse=True)
    believed = zip(*(strengths.believed[kind] for kind in kinds.tolist()), strict=True)
    now, reserve = (np.array([one.P for one in column]) for column in believed)
    determined = is_determined(now, strengths.now.prior_std)
    return determined[index], is_told(reserve, strengths.reserve.prior_std)[index]


def _tilt(state: AnswerState, rows: Readings, gravity: float) -> Array:
    """Tangent of the steepest slope in any direction, by means over 2 s; 0 where it is not measured."""
    known = np.isfinite(rows.slope + rows.across)
    stamp, ahead, aside = state.slopes
    stamp = np.concatenate([stamp, rows.stamp])
    sums = [
        np.concatenate([[0.0], np.cumsum(np.concatenate([before, np.where(known, column, 0.0)]))])
        for before, column in ((ahead, rows.slope), (aside, rows.across))
    ]
    last = np.arange(stamp.size - len(rows), stamp.size)
    lost = np.maximum.accumulate(
        np.where(known, -1, last)
    )  # the newest row of which nothing is known
    first = np.maximum(np.searchsorted(stamp, rows.stamp - STALE), lost + 1)
    count = np.maximum(last + 1 - first, 1)
    ahead, aside = ((total[last + 1] - total[first]) / count for total in sums)
    sine = np.minimum(np.hypot(ahead, aside) / gravity, _STEEPEST)
    begin = int(first[-1])
    state.slopes = stamp[begin:], np.diff(sums[0])[begin:], np.diff(sums[1])[begin:]
    return np.where(known, sine / np.sqrt(1.0 - sine * sine), 0.0)
