# SPDX-License-Identifier: Apache-2.0
"""Speed of steered wheels along and across their heading, and the course of a vehicle that steers.

Of a wheel at (x, y) that points d to the left, its middle a to the left of the steering axis:

    c     = (vx - w y, vy + w x)                  velocity of its place
    speed = c . (cos d, sin d) - a dd/dt          compared with its rim's speed
    aside = c . (-sin d, cos d)
    slip angle = atan2(aside, |speed|)
    variance of speed: + (a dd/dt)^2 + (aside 0.02 rad)^2     a quarter of the diameter where a is not known
"""

from __future__ import annotations

import math

import numpy as np

from smallwheel_ros.onboard.settings import OnboardSettings
from smallwheel_ros.pipeline.checks.believed import BelievedRows, arms_of
from smallwheel_ros.pipeline.checks.rigid_motion import places_of, rows_along
from smallwheel_ros.pipeline.tables import Array, Integers, unknown

# rad that wheels point or go off the way, over which sideways forces are a tenth of the grip and more.
ASIDE = 0.15
_ANGLE_STD = 0.02  # rad: what potentiometers and servos of steering are off by
_STEP_S = 0.1 / math.sqrt(12.0)  # s: an angle that came in steps is anywhere within the last tenth
_SLOWEST = 0.02  # m/s, under which a direction of travel is noise
_SHOWN = math.radians(60.0)  # of a course up to which the speed ahead tells the whole
_SIDEWAYS = math.radians(
    100.0
)  # beyond 90 degrees the course is kept to here, so that none flickers


class SteeredRows:
    """Rows of wheels on a vehicle that steers; the angle of wheels that do not roll is 0.

    Attributes
    ----------
    angle
        Steering angle, rad; NaN if unknown.
    speed, aside
        Speed along the heading and to its left, m/s.
    lever
        Factor of the yaw rate in the speed, m.
    std
        Part of the speed's standard deviation that is due to steering, m/s.
    slip_angle
        Direction of the wheel's motion to the left of its heading, rad.
    """

    def __init__(
        self, believed: BelievedRows, wheel: Integers, stamps: Integers, order: Integers,
        motion: tuple[Array, Array, Array],
    ) -> None:  # fmt: skip
        """order: number among the rolling wheels of each wheel. motion: vx, vy, yaw rate at the rows."""
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
    """Size (m) of the distance of a rolling wheel's middle from its steering axis."""
    wheel = settings.rolling[number]
    steered = settings.steered.get(wheel.name)
    if steered is None:
        return 0.0
    return 0.25 * wheel.diameter if steered.arm is None else abs(steered.arm)


def speed_aside(
    settings: OnboardSettings, told: Array, ahead: Array, turn: Array, course: Array
) -> Array:
    """Compute the sideways speed of the base frame: as measured, or as the wheels' angles imply.

    Wheels that are not steered allow no sideways motion of the line that they stand on. Where all are
    steered, the vehicle goes in the direction of its rims, at its speed ahead; nearly sideways that is
    unknown.

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
    """Direction of travel of the vehicle by its rims, within 90 degrees of straight ahead, also in reverse.

    The last one is kept while the vehicle hardly moves, or while the rims do not determine it.
    """

    def __init__(self) -> None:
        self._last = 0.0

    def take(self, believed: BelievedRows, stamps: Integers) -> Array:
        """Course at stamps, positive to the left.

        Parameters
        ----------
        believed
            Streams as they are believed.
        stamps
            Rising, shape (rows,), ns.

        Returns
        -------
        ndarray
            Shape (rows,), rad; NaN before the rims have moved.
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
    """Whichever of a direction and its opposite is near the last course, at most `_SIDEWAYS` from ahead."""
    near = last + math.remainder(way - last, math.pi)
    return near if abs(near) <= _SIDEWAYS else math.remainder(way, math.pi)


def along_course(course: Array, ahead: Array, left: Array) -> tuple[Array, Array]:
    """Components of a vector along the course and to its left.

    Parameters
    ----------
    course
        To the left of the heading, rad, any shape.
    ahead, left
        Components along the heading and to its left, same shape.

    Returns
    -------
    along, across : ndarray
        In the unit of the components.
    """
    cosine, sine = np.cos(course), np.sin(course)
    return cosine * ahead + sine * left, cosine * left - sine * ahead
