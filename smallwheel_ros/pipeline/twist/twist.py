# SPDX-License-Identifier: Apache-2.0
"""Twist of the vehicle with a covariance that grows with slip: rows of rims and imu in, Twists out.

For vehicles with encoders and an imu, and a ground speed where there is one. The filter is that of
`twist/filter.py`. An instant uses only rows stamped up to it, so that blocks may be cut anywhere.
Doubted and implausible rows are left out.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from smallwheel_ros.common.errors import SmallwheelError
from smallwheel_ros.common.stamps import SECOND
from smallwheel_ros.onboard.declared import TwistSettings
from smallwheel_ros.onboard.settings import IMU, ODOMETRY, VELOCITY, OnboardSettings
from smallwheel_ros.physics.conditions import ROLLING
from smallwheel_ros.pipeline.checks.ground_speed import SPEED_VARIANCE
from smallwheel_ros.pipeline.checks.rigid_motion import places_of, rigid_motion
from smallwheel_ros.pipeline.intake.layout import MAXIMUM_GAP
from smallwheel_ros.pipeline.tables import Array, Columns, Integers

from .filter import LONGEST, TwistFilter

Rows = Mapping[str, tuple[Integers, Array]]  # of streams by name: stamps (N,) ns, values (N, width)

_CHI = 1.5  # initial ratio of effective to geometric track of skid steering; 1 on one axle
_ACROSS = 0.3  # rad of a course, from which on rows are left out: the filter has no way aside
_PART = 0.1  # s: longest interval in which the twist is predicted from late rims to their stamp
# m/s, rad/s, m/s^2: no vehicle and no imu of one has more
_FASTEST, _TURNS, _SHAKES = 100.0, 35.0, 500.0
_UNKNOWN = 1e6  # variance of what is not measured: 0 would be certain, 1e308 makes NaN in filters


class TwistError(SmallwheelError):
    """The vehicle has no rolling wheel on one of its sides, so that its rims do not determine a twist."""


@dataclass(frozen=True)
class Twists(Columns):
    """The vehicle's twist at each stamp of the rims; no value is NaN.

    Attributes
    ----------
    stamp
        Stamp of the rims, ns.
    vx, vx_var
        Speed ahead, m/s, and the variance of its error at one row, m^2/s^2.
    vy_var
        Variance of the error of taking the speed to the left as 0, m^2/s^2: dead reckoning with 0 is better
        than with an estimate.
    yaw, yaw_var
        Yaw rate, rad/s, and the variance of its error, rad^2/s^2; from the rims alone where both sides are
        known, so that a gyro may be fused as well.
    slip
        Learnt standard deviation of the slip speed over the rim's speed, 1.
    period
        Mean time from row to row over the last twenty rows, s.
    """

    stamp: Integers
    vx: Array
    vx_var: Array
    vy_var: Array
    yaw: Array
    yaw_var: Array
    slip: Array
    period: Array


class TwistState:
    """State carried from block to block: the filter, and the rows of each stream that are still needed.

    Parameters
    ----------
    vehicle
        Settings of the vehicle.
    settings
        Settings of the twist.

    Raises
    ------
    TwistError
        If no wheel rolls on the left side, or none on the right.
    """

    def __init__(self, vehicle: OnboardSettings, settings: TwistSettings) -> None:
        rolling = [wheel for wheel in vehicle.wheels if wheel.contact == ROLLING]
        sides = [[w for w in rolling if sign * w.lateral_position > 0.0] for sign in (1.0, -1.0)]
        if not all(sides):
            raise TwistError(
                "twist: no rolling wheel on one side of the vehicle: set lateral_position of the wheels"
                " (m, positive left), or leave twist.publish false"
            )
        self.settings, self.gravity = settings, vehicle.gravity
        self.rolling = tuple(rolling)
        self.steering = [f"{w.name}/steering" if w.name in vehicle.steered else "" for w in rolling]
        self.sides = [[f"{w.name}/wheel_speed" for w in side] for side in sides]
        self.radius = {f"{w.name}/wheel_speed": w.diameter / 2.0 for w in rolling}
        self.ground = {"odometry": ODOMETRY, "topic": VELOCITY}.get(vehicle.velocity, "")
        self.ground_std = vehicle.noise.speed
        self.hold = round(MAXIMUM_GAP * SECOND)
        self.tail: dict[str, tuple[Integers, Array]] = {}
        self.last = -2 * LONGEST  # stamp of the last row, ns
        self.level: Array = np.zeros(
            2
        )  # m/s^2 of gravity ahead and to the left, by the last known orientation
        places = np.array([np.mean([w.lateral_position for w in side]) for side in sides])
        axles = {w.longitudinal_position for side in sides for w in side}
        # Steered wheels turn the vehicle without skidding.
        self.track = places, _CHI if len(axles) > 1 and not vehicle.steered else 1.0
        self.filter = TwistFilter(*self.track)
        self.anew: list[int] = []  # stamps still to come at which the filter begins anew


def twist(state: TwistState, rows: Rows, anew: Sequence[int] = ()) -> Twists:
    """Compute twists at the stamps of the rims in a block of rows.

    Stamps at which the rims of neither side are known are left out. The speed of a side is the mean of its
    wheels that are known.

    Parameters
    ----------
    state
        State carried from block to block; it is updated.
    rows
        All rows of each stream since the last call, up to one stamp for all streams, by name: stamps (ns)
        and values, shape (rows,) and (rows, width); NaN where doubted.
    anew
        Stamps at which a doubt begins, ns, rising: the filter then forgets what it has learnt.

    Returns
    -------
    Twists
        One row for each stamp; empty if there are none.
    """
    state.anew += anew
    streams = _streams(state, rows)
    rims = [name for side in state.sides for name in side]
    stamps = np.unique(np.concatenate([streams[name][0] for name in rims]))
    stamps = stamps[stamps > state.last]
    if any(state.steering):
        left, right = _sides_of_steered(state, streams, stamps)
    else:
        left, right = (
            _mean(np.array([_held(*streams[n], stamps, state.hold)[:, 0] for n in side]))
            for side in state.sides
        )
    seen = ~(np.isnan(left) & np.isnan(right))
    stamps, both = stamps[seen], np.column_stack([left, right])[seen]
    before = np.maximum(
        np.concatenate([[state.last], stamps[:-1]])[: stamps.size], stamps - LONGEST
    )
    delay = round(state.settings.rim_delay * SECOND)
    parts = max(1, math.ceil(state.settings.rim_delay / _PART)) if delay else 0
    ends = [(before - delay, stamps - delay)]
    cuts = [delay - delay * i // max(parts, 1) for i in range(parts + 1)]
    ends += [(stamps - a, stamps - b) for a, b in pairwise(cuts)]
    felt = [_felt(streams[_GYRO], streams[_FORCE], *each, state.hold) for each in ends]
    speed, speed_std = _ground(state, streams.get(state.ground), *ends[0])
    steps = [delay / max(parts, 1) / SECOND] * parts
    found = np.empty((stamps.size, 7))
    for i, stamp in enumerate(stamps.tolist()):
        while state.anew and stamp > state.anew[0]:
            del state.anew[0]
            state.filter, state.last = TwistFilter(*state.track), stamp - 2 * LONGEST
        state.filter.step(stamp - state.last, both[i], felt[0][i], speed[i], speed_std[i])
        later = [(step, part[i]) for step, part in zip(steps, felt[1:], strict=True)]
        found[i] = state.filter.told(both[i], later)
        state.last = stamp
    newest = max((int(own[-1]) for own, _ in streams.values() if own.size), default=0)
    for name, (own, values) in streams.items():  # rows to come are newer than the newest
        keep = own > newest - LONGEST - delay - state.hold
        state.tail[name] = own[keep], values[keep]
    return Twists(stamps, *found.T)


def _sides_of_steered(
    state: TwistState, streams: Mapping[str, _Stream], stamps: Integers
) -> tuple[Array, Array]:
    """Speeds ahead (m/s) of both sides by the rigid motion of steered wheels, shape (stamps,) each.

    NaN where the vehicle moves sideways, for which the filter has no state.
    """
    rims = np.array([_held(*streams[n], stamps, state.hold)[:, 0] for n in state.radius])
    angle = np.array(
        [
            _held(*streams[n], stamps, state.hold)[:, 0] if n else np.zeros(stamps.size)
            for n in state.steering
        ]
    )
    vx, vy, turn = rigid_motion(rims, *places_of(state.rolling, angle), angle)
    across = np.hypot(vx, vy) * np.sin(_ACROSS) < np.abs(vy)
    left, right = (np.where(across, np.nan, vx - place * turn) for place in state.track[0])
    return left, right


def messages(rows: Twists, settings: TwistSettings) -> tuple[Array, Array, Array]:
    """Compute the fields of geometry_msgs/TwistWithCovariance.

    An EKF takes the errors of messages as independent, but errors due to slip last: variances are therefore
    multiplied by 2 correlation_time / period, or by 1 where that is less.

    Parameters
    ----------
    rows
        The twists.
    settings
        Settings of the twist, of which `correlation_time` (s) is used.

    Returns
    -------
    linear, angular : ndarray
        Velocities, shape (rows, 3), m/s and rad/s; those that are not estimated are 0.
    covariance : ndarray
        Shape (rows, 36): 6 x 6 by rows, in the order of the message, SI; at most 1e6, which is the variance
        of what is not estimated.
    """
    white = np.maximum(1.0, 2.0 * settings.correlation_time / rows.period)
    linear, angular = np.zeros((len(rows), 3)), np.zeros((len(rows), 3))
    linear[:, 0], angular[:, 2] = rows.vx, rows.yaw
    covariance = np.zeros((len(rows), 6, 6))
    covariance[:, range(6), range(6)] = _UNKNOWN
    for axis, variance in ((0, rows.vx_var), (1, rows.vy_var), (5, rows.yaw_var)):
        covariance[:, axis, axis] = np.minimum(variance * white, _UNKNOWN)
    return linear, angular, covariance.reshape(-1, 36)


_GYRO, _FORCE = "imu yaw rate", "imu force"  # plausible readings of the imu's two sensors
_Stream = tuple[Integers, Array]
_NONE: _Stream = np.empty(0, dtype=np.int64), np.empty((0, 10))


def _streams(state: TwistState, rows: Rows) -> dict[str, _Stream]:
    """Plausible rows by stream, those kept from earlier first; rims in m/s, force without gravity."""

    def read(stream: str) -> _Stream:
        return rows.get(stream, _NONE)

    def good(name: str, stamps: Integers, values: Array, most: float) -> None:
        """Put into `found` the rows kept from earlier, and newer ones with |values| of at most `most`."""
        before = state.tail.get(name, (stamps[:0], values[:0]))
        keep = (np.abs(values) <= most).all(axis=1)  # NaN is not
        known = np.concatenate([before[0][-1:], np.where(keep, stamps, -1)])
        newest = np.maximum.accumulate(np.concatenate([[-1], known]))
        keep &= stamps > newest[newest.size - 1 - stamps.size : -1]
        found[name] = (
            np.concatenate([before[0], stamps[keep]]),
            np.concatenate([before[1], values[keep]]),
        )

    found: dict[str, _Stream] = {}
    for name, radius in state.radius.items():
        stamps, values = read(name)
        good(name, stamps, radius * values[:, :1], _FASTEST)
    for name in filter(None, state.steering):
        stamps, values = read(name)
        good(name, stamps, values[:, :1], _TURNS)
    stamps, values = read(IMU)
    good(_GYRO, stamps, values[:, :1], _TURNS)
    good(_FORCE, stamps, values[:, 1:3] - _level(state, state.gravity * values[:, 4:6]), _SHAKES)
    if state.ground:
        stamps, values = read(state.ground)
        variance = values[:, SPEED_VARIANCE] if state.ground == ODOMETRY else np.zeros(stamps.size)
        usual = state.ground_std
        spread = np.sqrt(np.where(variance > 0.0, variance, usual**2))
        spread = np.minimum(spread, _FASTEST)
        good(state.ground, stamps, np.column_stack([values[:, 0], spread]), _FASTEST)
    return found


def _level(state: TwistState, level: Array) -> Array:
    """Gravity's part of the specific force ahead and to the left, (N, 2), m/s^2.

    level: the same, as the imu's orientation gives it. Where that is unknown, the last known one is used.
    """
    known = (np.abs(level) <= 1.1 * state.gravity).all(axis=1)
    index = np.maximum.accumulate(np.where(known, np.arange(known.size), -1))
    filled = np.where(index[:, None] >= 0, level[index], state.level)
    state.level = filled[-1] if known.size else state.level
    return filled


def _mean(values: Array) -> Array:
    """Mean over the first axis, without NaN; NaN where all are NaN."""
    there = ~np.isnan(values)
    count = there.sum(axis=0)
    sums = np.where(there, values, 0.0).sum(axis=0)
    return np.where(count > 0, sums / np.maximum(count, 1), np.nan)


def _held(stamps: Integers, values: Array, at: Integers, hold: int) -> Array:
    """The last values at or before instants, (len(at), width); NaN where they are older than `hold` ns."""
    index = np.searchsorted(stamps, at, side="right") - 1
    if not stamps.size:
        return np.full((at.size, values.shape[1]), np.nan)
    fresh = (index >= 0) & (at - stamps[np.maximum(index, 0)] <= hold)
    return np.where(fresh[:, None], values[np.maximum(index, 0)], np.nan)


def _felt(gyro: _Stream, force: _Stream, start: Integers, end: Integers, hold: int) -> Array:
    """Means of yaw rate and force over the intervals (`start`, `end`], (N, 3).

    The last value is used for an interval without readings, and NaN if that is older than `hold` ns.
    """
    found = np.empty((end.size, 3))
    for columns, (stamps, values) in ((slice(0, 1), gyro), (slice(1, 3), force)):
        held = _held(stamps, values, end, hold)
        first, last = (np.searchsorted(stamps, at, side="right") for at in (start, end))
        sums = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(values, axis=0)])
        count = (last - first)[:, None]
        mean = (sums[last] - sums[first]) / np.maximum(count, 1)
        found[:, columns] = np.where(np.isnan(held) | (count < 1), held, mean)
    return found


def _ground(
    state: TwistState, stream: _Stream | None, start: Integers, end: Integers
) -> tuple[Array, Array]:
    """Speed over ground of the vehicle's middle and its deviation, m/s, by the newest message of an interval.

    NaN for intervals (`start`, `end`] without a message, so that each message is used only once.
    """
    if stream is None or not stream[0].size:
        return np.full(end.size, np.nan), np.full(end.size, np.nan)
    stamps, values = stream
    last = np.searchsorted(stamps, end, side="right") - 1
    new = (last >= 0) & (stamps[np.maximum(last, 0)] > start)
    speed, spread = np.where(new[:, None], values[np.maximum(last, 0)], np.nan).T
    return speed, spread
