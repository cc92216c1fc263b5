# SPDX-License-Identifier: Apache-2.0
"""Readings of wheels become steps of the path: means over 0.1 m, with what they are off by.

    steps = PathSteps(mean_contacts)
    step = steps.add(Sample(reading, law, load))     # None until the path has come 0.1 m on

Slip is worked out once a step, as that of mean speed and mean rim speed: the mean of single slips is bent
by their noise, all the more the slower the vehicle. Its deviation is that of the mean speed. Who stands has
no slip, so standing adds nothing to a step and ends none.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from smallwheel_ros.estimator.reading import SECOND, Reading
from smallwheel_ros.estimator.soil_filter import LocalLaw
from smallwheel_ros.physics.wheel import Quantity, wheel_slip

CELL = 0.1  # m
_SPINS = 3.0 * CELL  # m that the rims turn, of wheels that spin on one spot
_PAUSE = 2.0  # s without a sample: the vehicle stood, or nobody knows
# s over which the errors of an odometry are alike: they are filtered, and made from pictures or echoes of
# some tenths of a second.
_ALIKE = 0.3
# Of the specific force's mean over a step: 0.05 m/s^2 of acceleration, as much of a pitch that shakes.
FORCE_STD = 0.07
_LAG = 0.2  # s, by which an acceleration from speeds is late


class RollingContact(NamedTuple):
    """A wheel that rolls: load on the soil (N), sinkage, diameter, width (m), and the soil's exponent n.

    other: resistance (N) of the model's effects. thrust_factor: of the effects on thrust, 1 without. own:
    what is the wheel's own, by place and load: variances and covariance of sinkage and ln load (zz, zw, ww).
    """

    load: float
    sinkage: float
    diameter: float
    width: float
    exponent: float
    other: float = 0.0
    thrust_factor: float = 1.0
    own: tuple[float, float, float] = (0.0, 0.0, 0.0)


class Sample(NamedTuple):
    """A reading of a wheel that rolls; law: under it, load: without its cell's noise, None: not known."""

    reading: Reading
    law: LocalLaw
    load: Quantity | None


# By name the samples of the wheels on a step, to their mean contacts; a wheel without one is left out.
MeanContacts = Callable[[Mapping[str, Sequence[Sample]]], Mapping[str, RollingContact]]


class WheelMean(NamedTuple):
    """Means of a wheel over a step: slip, contact, torque (N m) and pull (N), None where not known.

    doubt: standard deviation of the slip by what this wheel alone may be wrong by.
    """

    slip: Quantity
    contact: RollingContact | None
    torque: float | None
    pull: Quantity | None
    doubt: float = 0.0


class PathStep(NamedTuple):
    """A step of the path that ends at `time` (s) and `distance` (m), `length` (m) long.

    follows: the step before went the same way, and ended where this one begins.
    slope, gained: m/s^2, what they take of the wheels per mass, None where not known; deviation: of their
    sum.
    """

    time: float
    distance: float
    length: float
    forward: bool
    follows: bool
    wheels: Mapping[str, WheelMean]
    slope: float | None
    gained: float | None
    deviation: float

    @property
    def force(self) -> Quantity | None:
        """What the wheels pull per mass of the vehicle along its travel, m/s^2."""
        if self.slope is None or self.gained is None:
            return None
        return Quantity(self.slope + self.gained, self.deviation)


class PathSteps:
    """Collects the samples of a vehicle, in the order of time."""

    def __init__(self, mean_contacts: MeanContacts) -> None:
        self._mean_contacts = mean_contacts
        self._ended: Reading | None = None  # the last one of the last step
        self.cut()

    def cut(self) -> None:
        """Leave out what was collected: from here on the ground is another one."""
        self._samples: dict[str, list[Sample]] = {}
        self._first: Reading | None = None
        self._last: Reading | None = None
        self._turned = 0.0  # m, by the rims

    def add(self, sample: Sample) -> PathStep | None:
        """Take a sample whose speed and rim's speed are known; return the step that it ends.

        One that holds something else than numbers is left out.
        """
        reading = sample.reading
        if not math.isfinite(_sum(reading)):
            return None
        step = None
        first, last = self._first, self._last
        if first is not None and last is not None:
            paused = reading.stamp - last.stamp > _PAUSE * SECOND
            paused = paused or reading.forward is not first.forward
            way = (last if paused else reading).distance - first.distance
            if paused and way < 0.5 * CELL:
                self.cut()
            elif paused or way >= CELL or self._turned >= _SPINS:
                step = self._mean(first, last, way)
                self._ended = last
                self.cut()
        if self._first is None:
            self._first = reading
        elif self._last is not None:
            seconds = max(reading.stamp - self._last.stamp, 0) / SECOND
            self._turned += abs(reading.rim_speed or 0.0) * seconds
        self._last = reading
        self._samples.setdefault(reading.wheel.name, []).append(sample)
        return step

    def _mean(self, first: Reading, last: Reading, way: float) -> PathStep:
        readings = {name: [one.reading for one in found] for name, found in self._samples.items()}
        rows = [row for found in readings.values() for row in found]
        duration = last.time - first.time
        slips = {
            name: slip
            for name, found in readings.items()
            if (slip := _mean_slip(found, duration)) is not None
        }
        contacts = self._mean_contacts(
            {
                name: [one for one in self._samples[name] if one.load is not None]
                for name in slips
                if self._samples[name][0].load is not None
            }
        )
        wheels = {
            name: _wheel_mean(readings[name], slip, contacts.get(name))
            for name, slip in slips.items()
        }
        gains, ended = [row.gained_force for row in rows], self._ended
        late = 0.0
        if gains[0] is not None and gains[-1] is not None and duration > 0.0:
            # An acceleration that changes comes late.
            late = abs(gains[-1] - gains[0]) * min(_LAG / duration, 1.0)
        return PathStep(
            last.time,
            last.distance,
            way,
            first.forward,
            ended is not None
            and first.forward is ended.forward
            and first.time - ended.time <= _PAUSE,
            wheels,
            _mean_of([row.slope_force for row in rows]),
            _mean_of(gains),
            math.hypot(FORCE_STD, late),
        )


def _sum(reading: Reading) -> float:
    """Sum of all numbers that a step is made of: finite where each of them is."""
    numbers = reading.speed, reading.rim_speed, reading.slope_force, reading.gained_force
    known = sum(number for number in (*numbers, reading.torque) if number is not None)
    return known + reading.speed_std + reading.rim_std + sum(reading.drawbar_pull or ())


def _mean_slip(rows: Sequence[Reading], duration: float) -> Quantity | None:
    """Slip of the mean speeds of a wheel over a step (s); None where noise may be all of its motion."""
    count = len(rows)
    alone = min(float(count), max(1.0, duration / _ALIKE))
    speed = sum(row.speed or 0.0 for row in rows) / count
    noise = sum(row.speed_std for row in rows) / count
    rim = Quantity(
        sum(row.rim_speed or 0.0 for row in rows) / count, sum(row.rim_std for row in rows) / count
    )
    return wheel_slip(Quantity(speed, noise / math.sqrt(alone)), rim, 0.0)


def _wheel_mean(
    rows: Sequence[Reading], slip: Quantity, contact: RollingContact | None
) -> WheelMean:
    torques = [row.torque for row in rows if row.torque is not None]
    pulls = [row.drawbar_pull for row in rows if row.drawbar_pull is not None]
    pull = None
    if pulls:
        value, noise = np.mean([(p.value, p.standard_deviation**2) for p in pulls], axis=0)
        pull = Quantity(float(value), math.sqrt(noise / len(pulls)))
    return WheelMean(slip, contact, float(np.mean(torques)) if torques else None, pull)


def _mean_of(values: Sequence[float | None]) -> float | None:
    """Mean of what is known throughout."""
    known = [value for value in values if value is not None]
    return sum(known) / len(known) if len(known) == len(values) else None
