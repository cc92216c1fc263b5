# SPDX-License-Identifier: Apache-2.0
"""Speed of steered wheels along and across their heading, and the course of a vehicle that steers.

For a wheel at (x, y) that points d to the left, and whose middle is a to the left of the steering axis:

    c     = (vx - w y, vy + w x)                  velocity of its place
    speed = c . (cos d, sin d) - a dd/dt          compared with its rim's speed
    aside = c . (-sin d, cos d)
    slip angle = atan2(aside, |speed|)
    added to the variance of speed: (a dd/dt)^2 + (aside 0.02 rad)^2

Where a is not known, it is a quarter of the diameter in the variance and 0 elsewhere.
"""

from __future__ import annotations

import math

import numpy as np

from smallwheel_ros.onboard.settings import OnboardSettings
from smallwheel_ros.pipeline.checks.believed import BelievedRows, arms_of
from smallwheel_ros.pipeline.checks.rigid_motion import places_of, rows_along
from smallwheel_ros.pipeline.tables import Array, Integers, unknown

# rad between a wheel's heading, or its motion, and the course: over it sideways forces are a tenth of the
# grip and more.
ASIDE = 0.15
_ANGLE_STD = 0.02  # rad: what potentiometers and servos of steering are off by
_STEP_S = 0.1 / math.sqrt(12.0)  # s: an angle that came in steps is anywhere within the last tenth
_SLOWEST = 0.02  # m/s, under which a direction of travel is noise
_SHOWN = math.radians(60.0)  # course up to which the whole speed can be computed from that ahead
_SIDEWAYS = math.radians(
    100.0
)  # beyond 90 degrees the course is kept to here, so that none flickers


class SteeredRows:
    """Angles and speeds of the wheels of a vehicle that steers, at given rows.

    Parameters
    ----------
    believed
        Believed rows, from which the steering angles are read.
    wheel
        Number of each row's wheel, shape (rows,).
    stamps
        Stamp of each row, shape (rows,), ns.
    order
        Index of each wheel among the rolling ones, -1 for one that does not roll, shape (wheels,).
    motion
        Speeds of the base frame ahead and to the left (m/s), and yaw rate (rad/s), each of shape (rows,).

    Attributes
    ----------
    angle
        Steering angle, positive to the left, rad; NaN if unknown, 0 for a wheel that does not roll.
    speed, aside
        Speed over ground of the wheel along its heading and to the left of it, m/s.
    lever
        Factor of the yaw rate in `speed`, m.
    std
        Part of the standard deviation of `speed` that is due to steering, m/s.
    slip_angle
        Direction of the wheel's motion to the left of its heading, rad; NaN where it hardly moves.
    """

    def __init__(
        self, believed: BelievedRows, wheel: Integers, stamps: Integers, order: Integers,
        motion: tuple[Array, Array, Array],
    ) -> None:  # fmt: skip
        """Compute all attributes; see the class."""
        settings = believed.settings
        own, row = order[wheel], np.arange(stamps.size)
        angles, rates = believed.steering(stamps)
        arms = arms_of(settings)
        xs, ys = places_of(settings.rolling, angles, arms)
        of = [np.where(own >= 0, each[own, row], 0.0) for each in (angles, rates, xs, ys)]
        self.angle, rate, x, y = of
        ahead, left, turn = motion
        along = rows_along(x, y, self.angle)
        self.lever = along[:, 2]
        # Products apart, not one sum: a yaw rate that is not known makes the speed unknown.
        across = -np.sin(self.angle) * (ahead - turn * y) + np.cos(self.angle) * (left + turn * x)
        self.speed = along[:, 0] * ahead + along[:, 1] * left + self.lever * turn
        self.speed = self.speed - rate * arms[own]
        self.aside = across
        reach = np.array([_reach(settings, number) for number in range(len(arms))])[own]
        spread = np.hypot(_ANGLE_STD, _STEP_S * rate)
        self.std = np.nan_to_num(np.hypot(rate * reach, across * spread))
        moves = np.hypot(self.speed, across) > _SLOWEST
        self.slip_angle = np.where(moves, np.arctan2(across, np.abs(self.speed)), np.nan)


def _reach(settings: OnboardSettings, number: int) -> float:
    """Distance (m) of a rolling wheel's middle from its steering axis; its likely size where it is unknown.

    number: index of the wheel among the rolling ones.
    """
    wheel = settings.rolling[number]
    steered = settings.steered.get(wheel.name)
    if steered is None:
        return 0.0
    return 0.25 * wheel.diameter if steered.arm is None else abs(steered.arm)


def speed_aside(
    settings: OnboardSettings, told: Array, ahead: Array, turn: Array, course: Array
) -> Array:
    """Compute the sideways speed of the base frame: as measured, or else as the wheels' angles imply.

    Wheels that are not steered do not move sideways; the base frame ahead of or behind them then does so in
    turns only. Where all wheels are steered, the vehicle moves in the direction in which its wheels roll; if
    that is over 60 degrees from straight ahead, the sideways speed is unknown.

    Parameters
    ----------
    settings
        Settings of the vehicle.
    told
        Sideways speed as measured over ground, shape (rows,), m/s; NaN where it is not measured.
    ahead
        Speed ahead, shape (rows,), m/s.
    turn
        Yaw rate, shape (rows,), rad/s.
    course
        Direction of travel to the left of the heading, shape (rows,), rad.

    Returns
    -------
    ndarray
        Shape (rows,), m/s; NaN if unknown.
    """
    if len(settings.steered) < len(settings.rolling):
        place = settings.unsteered_place
        rolls = -turn * place if place else np.zeros(ahead.size)
    else:
        rolls = np.where(np.abs(course) <= _SHOWN, ahead * np.tan(course), np.nan)
    return np.where(np.isnan(told), rolls, told)


class Course:
    """Direction of travel of the vehicle by its rims and steering angles.

    It is within 90 degrees of straight ahead, also in reverse. The last direction is kept while the vehicle
    hardly moves, or while the rims do not determine it.
    """

    def __init__(self) -> None:
        self._last = 0.0

    def take(self, believed: BelievedRows, stamps: Integers) -> Array:
        """Compute the direction of travel, relative to the vehicle's heading, at stamps.

        Parameters
        ----------
        believed
            Believed rows.
        stamps
            Shape (rows,), ns, none before those of earlier calls.

        Returns
        -------
        ndarray
            Shape (rows,), rad, positive to the left; 0 before the vehicle has moved.
        """
        instants, index = np.unique(stamps, return_inverse=True)
        vx, vy, _ = believed.motion_of_rims(instants, believed.each_rim(instants))
        found = unknown(instants.size)
        moves = np.hypot(vx, vy) > _SLOWEST
        ways = np.arctan2(vy, vx)
        for i in range(instants.size):
            if moves[i]:
                self._last = _folded(float(ways[i]), self._last)
            found[i] = self._last
        return np.asarray(found[index])


def _folded(way: float, last: float) -> float:
    """A direction or its opposite (rad), whichever is nearer the last course, within `_SIDEWAYS` of ahead."""
    near = last + math.remainder(way - last, math.pi)
    return near if abs(near) <= _SIDEWAYS else math.remainder(way, math.pi)


def along_course(course: Array, ahead: Array, left: Array) -> tuple[Array, Array]:
    """Turn vectors from axes along the heading into axes along the course.

    Parameters
    ----------
    course
        Angle of the course to the left of the heading, rad, any shape.
    ahead, left
        Components along the heading and to its left, same shape, any unit.

    Returns
    -------
    along, across : ndarray
        Components along the course and to its left, same shape and unit.
    """
    cosine, sine = np.cos(course), np.sin(course)
    return cosine * ahead + sine * left, cosine * left - sine * ahead
