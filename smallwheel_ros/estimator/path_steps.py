# SPDX-License-Identifier: Apache-2.0
"""Samples of wheels become steps of the path: means over 0.1 m, with what they are off by.

    steps = PathSteps(mean_contact)
    step = steps.add(sample)     # None until the path has come 0.1 m on

Slip is worked out once a step, as that of mean speed and mean rim speed: the mean of single slips is bent
by their noise, all the more the slower the vehicle. Its deviation is that of the mean speed. Who stands has
no slip, so standing adds nothing to a step and ends none.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np

from smallwheel_ros.physics.wheel import Quantity, wheel_slip

CELL = 0.1  # m
_VALUE, _DEVIATION = attrgetter("value"), attrgetter("standard_deviation")
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


# Gives the mean contact of a wheel on its soil over a step; None where it has none.
MeanContact = Callable[[str, Sequence[Any]], RollingContact | None]


class WheelSample(NamedTuple):
    """What is known of a rolling wheel at one time (s), `distance` (m) along the vehicle's path.

    speed, rim: m/s, of its place over ground and of its rim. slope_force, gained_force: m/s^2, of the
    vehicle along its travel: what slope and gaining speed take of the wheels per mass. torque: N m, of the
    wheel. pull: N. None where not known. contact: what the mean contact of a step is worked out of.
    """

    wheel: str
    time: float
    distance: float
    speed: Quantity
    rim: Quantity
    contact: Any = None
    forward: bool = True
    slope_force: float | None = None
    gained_force: float | None = None
    torque: float | None = None
    pull: Quantity | None = None


class WheelMean(NamedTuple):
    """Means of a wheel over a step; as in `WheelSample`.

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
    slope, gained: m/s^2, as in `WheelSample`, None where not known; deviation: of their sum.
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

    def __init__(self, mean_contact: MeanContact) -> None:
        self._mean_contact = mean_contact
        self._ended: WheelSample | None = None  # the last sample of the last step
        self.cut()

    def cut(self) -> None:
        """Leave out what was collected: from here on the ground is another one."""
        self._samples: dict[str, list[WheelSample]] = {}
        self._first: WheelSample | None = None
        self._last: WheelSample | None = None
        self._turned = 0.0  # m, by the rims

    def add(self, sample: WheelSample) -> PathStep | None:
        """Take a sample; return the step that it ends.

        One that holds something else than numbers is left out.
        """
        both = (sample.speed, sample.rim, sample.pull or Quantity(0.0, 0.0))
        numbers = [number for one in both for number in (one.value, one.standard_deviation)]
        numbers += [sample.slope_force or 0.0, sample.gained_force or 0.0, sample.torque or 0.0]
        if not all(map(math.isfinite, numbers)):
            return None
        step = None
        first, last = self._first, self._last
        if first is not None and last is not None:
            paused = sample.time - last.time > _PAUSE or sample.forward is not first.forward
            way = (last if paused else sample).distance - first.distance
            if paused and way < 0.5 * CELL:
                self.cut()
            elif paused or way >= CELL or self._turned >= _SPINS:
                step = self._mean(first, last, way)
                self._ended = last
                self.cut()
        if self._first is None:
            self._first = sample
        elif self._last is not None:
            self._turned += abs(sample.rim.value) * max(sample.time - self._last.time, 0.0)
        self._last = sample
        self._samples.setdefault(sample.wheel, []).append(sample)
        return step

    def _mean(self, first: WheelSample, last: WheelSample, way: float) -> PathStep:
        rows = [row for found in self._samples.values() for row in found]
        duration = last.time - first.time
        wheels = {name: self._wheel_mean(found, duration) for name, found in self._samples.items()}
        known = {name: mean for name, mean in wheels.items() if mean is not None}
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
            known,
            _mean_of([row.slope_force for row in rows]),
            _mean_of(gains),
            math.hypot(FORCE_STD, late),
        )

    def _wheel_mean(self, rows: Sequence[WheelSample], duration: float) -> WheelMean | None:
        """Means of a wheel over a step (s); None where noise may be all of its motion."""
        count = min(float(len(rows)), max(1.0, duration / _ALIKE))
        speed, noise = _mean_quantity([row.speed for row in rows])
        rim = Quantity(*_mean_quantity([row.rim for row in rows]))
        slip = wheel_slip(Quantity(speed, noise / math.sqrt(count)), rim, 0.0)
        if slip is None:
            return None
        contact = None
        if rows[0].contact is not None:
            held = [row.contact for row in rows if row.contact is not None]
            contact = self._mean_contact(rows[0].wheel, held)
        torques = [row.torque for row in rows if row.torque is not None]
        pulls = [row.pull for row in rows if row.pull is not None]
        pull = None
        if pulls:
            value, noise = np.mean([(p.value, p.standard_deviation**2) for p in pulls], axis=0)
            pull = Quantity(float(value), math.sqrt(noise / len(pulls)))
        return WheelMean(slip, contact, float(np.mean(torques)) if torques else None, pull)


def _mean_of(values: Sequence[float | None]) -> float | None:
    """Mean of what is known throughout."""
    known = [value for value in values if value is not None]
    return sum(known) / len(known) if len(known) == len(values) else None


def _mean_quantity(rows: Sequence[Quantity]) -> tuple[float, float]:
    """Mean value, and mean deviation."""
    count = len(rows)
    return sum(map(_VALUE, rows)) / count, sum(map(_DEVIATION, rows)) / count
