# SPDX-License-Identifier: Apache-2.0
"""What is reported of each row that is due: numbers, conditions, margin and risk, whatever is missing.

margin   of any ground (`margin`), or the strength filter's, where the soil's law is measured and
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
from .wheel import Predicted, mobility

STALE = 2 * SECOND  # ns, after which a wheel's margin does not count for the vehicle
_NEWEST, _FAR = (
    7,
    3.0,
)  # sinkages among which one is far; deviations of the sensor: else the soil is another
_STEEPEST = 0.87  # sine of 60 degrees, on which no vehicle drives
_GOOD = 0.999  # share of good readings that pass for good ones: at 10 Hz one in 100 s does not


@dataclass(frozen=True)
class OnGround(Loads):
    """Load, and versions of soil and strength, at each row.

    Attributes
    ----------
    load, load_std
        N, without the cell's noise.
    soil_version
        Version of the soil under the wheel.
    newest
        Version of the soil that the first wheels are on.
    strength_version
        Version of the strength.
    refused
        Number of measured sinkages not used up to then.
    """

    soil_version: Integers
    newest: Integers
    strength_version: Integers
    refused: Integers


class KnownGround(NamedTuple):
    """Soils and strengths by the versions that rows name."""

    soils: Versions[Version]
    strengths: Strengths


@dataclass
class AnswerState:
    """State carried from block to block.

    Attributes
    ----------
    newest
        For each wheel, by number: stamp (ns), load (N), margin, its standard deviation, and the gain of
        margin beyond the reference slip, of its newest row.
    shown
        For each wheel, its newest measured sinkages, m.
    risk
        Newest risk of getting stuck, 0 to 1, or NaN.
    slopes
        Stamps, and gravity's components ahead and to the side (m/s^2), over the last 2 s.
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
        Readings.
    judged
        Warning and margin at each row.
    ground
        Load, and versions of soil and strength, at each row.
    known
        Soils and strengths by version.
    settings
        The pipeline's settings.
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
    of, newest = (
        [soils[one] for one in numbers.tolist()] for numbers in (soil_version, ground.newest)
    )
    measured = np.array([version.accepted > 0 for version in of])
    loaded = np.flatnonzero(np.isfinite(loads.load))
    made = mobility(
        rows.take(loaded), loads.load[loaded], loads.load_std[loaded], soil_version[loaded],
        strength_version[loaded], soils, strengths, settings,
    )  # fmt: skip
    can = _among(made, loaded, count)
    predicted = np.isfinite(can.sinkage) & (measured | (not settings.law_unknown))
    if settings.law_unknown:
        can = _without_law(can, measured)
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
        Condition.SUNK_TO_AXLE: can.sunk & measured,
        Condition.LOAD_STATIC: static & np.isfinite(loads.load),
        Condition.DIGS: digging,
        Condition.WARNED: rolls & (judged.level > 0),
    }  # fmt: skip
    pull_known, reserve_told = _known_strength(strengths, strength_version)
    margin, margin_std, median, lower_std, beyond, by_soil, risk = _margins(
        state, rows, can, judged, measured & reserve_told, strengths.measured, rolls
    )
    has[Condition.MARGIN_OF_PRIOR] = (
        rolls & (not strengths.measured) & is_prior(margin_std, settings.reference_slip)
    )
    has[Condition.STRENGTH_OF_PRIOR] = (
        np.isfinite(can.drawbar_pull) & (not strengths.measured) & ~pull_known
    )
    conditions = np.zeros(count, dtype=np.int64)
    for condition, applies in has.items():
        conditions |= np.where(applies, int(condition), 0)
    numbers = [soil.number for soil in newest]
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
        elsewhere=np.array([v.number for v in of], dtype=np.int64) != np.array(numbers, dtype=np.int64),
        margin_by_soil=by_soil,
        rejected=ground.refused + np.array([v.outliers for v in of], dtype=np.int64),
        soil_version=soil_version, strength_version=strength_version,
    )  # fmt: skip


def _among(some: Predicted, known: Integers, count: int) -> Predicted:
    """Rows of some wheels among those of which nothing is known."""
    if known.size == count:
        return some
    whole = Predicted.unknown(count)
    for name, column in vars(whole).items():
        column[known] = getattr(some, name)
    return whole


def _without_law(can: Predicted, measured: Flags) -> Predicted:
    """What a law says is not known of a soil that is neither named nor measured."""
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
    """A sinkage far from those just before it, and beyond what is expected of it."""
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
    state: AnswerState, rows: Readings, can: Predicted, judged: Judged, told: Flags, measured: bool,
    rolls: Flags,
) -> tuple[Array, Array, Array, Array, Array, Flags, Array]:  # fmt: skip
    """Margin of each wheel, deviation, median, deviation of the lower half, what is beyond; by soil; risk.

    told: mask of the rows for which the soil's law was measured, and its strength narrowed by some
    measurement. Both margins say honestly how unsure they are, so that the one with less deviation errs less:
    that of any ground is the mean of a belief with a long upper half, and is too high for as long as little
    is known. measured: whether a model file has the strength as measured; then the margin is the filter's
    from the start. beyond: gained from the reference slip up to the slip at which the vehicle no longer
    moves; by soil: whether the margin is the filter's.
    """
    by_filter = told & ~(can.margin_std >= judged.margin_std)
    by_filter = (by_filter | measured) & np.isfinite(can.margin)
    by_filter |= can.sunk
    margin, deviation, median, lower, beyond = (
        np.where(rolls, np.where(by_filter, ours, of_any), np.nan)
        for ours, of_any in (
            (can.margin, judged.margin), (can.margin_std, judged.margin_std),
            (can.margin, judged.median), (can.margin_std, judged.lower_std),
            (can.beyond, judged.beyond),
        )
    )  # fmt: skip
    risk = judged.risk.copy()
    known, of_vehicles = np.flatnonzero(by_filter & rolls), []
    for i in known.tolist():
        now = int(rows.stamp[i])
        state.newest[int(rows.wheel[i])] = now, can.load[i], median[i], lower[i], beyond[i]
        recent = [one[1:] for one in state.newest.values() if now - one[0] <= STALE]
        # All wheels stand on one estimated soil, so their errors are taken to go together.
        load, *of_vehicle = np.array(recent).T
        of_vehicles.append([float(load @ each) / float(load.sum()) for each in of_vehicle])
    if known.size:
        risk[known] = risk_ahead(judged.asked[known], *np.array(of_vehicles).T)
    risk = np.where(rolls, risk_of(risk, judged.level), np.nan)
    if risk.size and np.isfinite(risk).any():
        state.risk = float(risk[np.isfinite(risk)][-1])
    return margin, deviation, median, lower, beyond, by_filter & rolls, risk


def _known_strength(strengths: Strengths, versions: Integers) -> tuple[Flags, Flags]:
    """Whether the strength of rows is determined for the present pull, and narrowed at all for the margin."""
    kinds, index = np.unique(versions, return_inverse=True)
    believed = zip(*(strengths.believed[kind] for kind in kinds.tolist()), strict=True)
    now, reserve = (np.array([one.P for one in column]) for column in believed)
    determined = is_determined(now, strengths.now.prior_std)
    return determined[index], is_told(reserve, strengths.reserve.prior_std)[index]


def _tilt(state: AnswerState, rows: Readings, gravity: float) -> Array:
    """Tangent of the steepest slope, whichever way the vehicle looks, by means over 2 s; 0 without any."""
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
