# SPDX-License-Identifier: Apache-2.0
"""A wheel as the estimator follows it: its readings on one stretch of its own path become one measurement.

Within a stretch as long as the soil's deviations are correlated, readings are of one piece of soil:
their mean is what the filters are given. Two things are learnt from the readings themselves, so that
what the user says of the sensors hardly matters: the noise of a single reading, from second
differences (a trend over the stretch does not count as noise), and how much of the spread of the
loads is noise.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.estimator.reading import Reading
from smallwheel_ros.physics.conditions import ROLLING
from smallwheel_ros.physics.wheel import Quantity, Wheel

Array = NDArray[np.float64]

_SECOND_DIFFERENCE = 6.0  # variance of a - 2 b + c over that of one of three independent readings
_NOISE_MEMORY = 200.0  # readings that the learnt noise rests on
_TOLD_READINGS = 20.0  # readings that what the user told of the noise counts for
# A squared second difference counts at most so often, so that wild readings in every third stretch
# do not raise the noise; and the mean of a chi-square of one degree of freedom that is cut there.
_WORST_NOISE, _CUT_MEAN = 2.0, 0.742
_KEPT = 3.0  # readings so many deviations from the median are left out of the mean
_MOST_ROWS = 256  # of a wheel that stands; then every second one is dropped
_LOAD_MEMORY = 100  # stretches
_LEAST_LOAD_SPREAD = 0.02  # of ln load between stretches, before it is measured
_STANDS = 0.02  # m: a wheel that has moved less stands in the rut that it made
_RECENT = 9  # readings, for the median that an outlier is far from


@dataclass(frozen=True, eq=False)  # each is made once, and is looked up by what it is
class Position:
    """Where a wheel is: in the state (None: it has no place there) and on the vehicle.

    passes: how much of a rut the wheel meets: 0 in fresh soil, 1 behind one wheel; pass_doubt: what that is
    off by where more have passed. side: 1 on the left, -1 on the right, 0 in the middle or not known.
    ahead: of the vehicle's middle, the way it drives, m. leads: no wheel runs ahead of it in its track.
    """

    index: int | None = None
    passes: float = 0.0
    side: float = 0.0
    ahead: float = 0.0
    leads: bool = True
    pass_doubt: float = 0.0

    @classmethod
    def of(cls, index: int, name: str, wheels: Mapping[str, Wheel], forward: bool) -> Position:
        """The position of a wheel among those of a vehicle that drives forward or backward."""
        wheel = wheels.get(name)
        if wheel is None:
            return cls(index)
        way = 1.0 if forward else -1.0
        ahead = [
            other
            for other in wheels.values()
            if other.contact == ROLLING == wheel.contact
            and way * (other.longitudinal_position - wheel.longitudinal_position) > 0.0
            and abs(other.lateral_position - wheel.lateral_position)
            < 0.5 * (wheel.width + other.width)
        ]
        side = math.copysign(1.0, wheel.lateral_position) if wheel.lateral_position else 0.0
        place = way * wheel.longitudinal_position
        found = cls(index, side=side, ahead=place, leads=not ahead)
        return found.on_pass(1.0 + len(ahead))

    @lru_cache(maxsize=64)  # noqa: B019  # of positions there are two a wheel, and of numbers a few
    def on_pass(self, number: float | None) -> Position:
        """The position where the number of the pass is known; None: as the wheels' places say.

        Ruts deepen with a power of the number (Holm 1969), so their logarithm with log2 n; what passes
        compact is mostly done by the first ones, as 2 (1 - 1/n). Ruts are taken to be half way between.
        """
        if number is None:
            return self
        count = max(number, 1.0)
        deepens, compacts = math.log2(count), 2.0 * (1.0 - 1.0 / count)
        doubt = 0.5 * (deepens - compacts)
        return replace(self, passes=compacts + doubt, pass_doubt=abs(doubt))


NOWHERE = Position()


@dataclass(frozen=True)
class Segment:
    """A wheel on one stretch of its path: means of readings, distance is that of the last one.

    wheel: its name. sinkage, load, diameter, width, distance: m, N. slip, speed: 1, m/s, None where not
    known. pitch: rad. variance: m^2, of the mean sinkage, from the sensor's noise. log_load_variance: of ln
    load, from the sensor's. load_rate: d ln load / d time, 1/s. place: of the wheel along the vehicle's path,
    m. count: readings in the mean; dropped: left out as outliers. shown: least and most that was shown, m.
    step: least difference of two readings of this sensor so far, m.
    """

    wheel: str
    diameter: float
    width: float
    contact: str
    sinkage: float
    load: float
    distance: float
    slip: float | None
    speed: float | None
    pitch: float
    position: Position
    log_load_variance: float
    variance: float = 0.0
    load_rate: float = 0.0
    place: float = 0.0
    count: int = 1
    dropped: int = 0
    shown: tuple[float, float] = (0.0, 0.0)
    step: float = 0.0

    @classmethod
    def single(
        cls, reading: Reading, load: float, log_load_variance: float, position: Position = NOWHERE
    ) -> Segment:
        """One reading, to predict by. load: N, without its noise."""
        wheel, sinkage, speed = reading.wheel, reading.sinkage, reading.speed
        slip = None if reading.slip is None else reading.slip.value
        return cls(
            wheel.name,
            wheel.diameter,
            wheel.width,
            wheel.contact,
            0.0 if sinkage is None else sinkage.value,
            load,
            reading.distance,
            slip if slip is not None and math.isfinite(slip) else None,
            speed if speed is not None and math.isfinite(speed) else None,
            reading.pitch,
            position,
            log_load_variance,
        )


class WheelTrack:
    """The readings of one wheel.

    length: m of a stretch. sinkage_std: m, noise of one reading until it is learnt; load_std: of ln load.
    positions: driving forward, and backward; position: the newest. at: m along the vehicle's path. recent:
    the newest sinkages (m).
    """

    def __init__(
        self,
        length: float,
        sinkage_std: float,
        load_std: float,
        positions: tuple[Position, Position],
    ) -> None:
        self._length, self._positions = length, positions
        self.position = positions[0]
        self.reading_variance = sinkage_std**2  # m^2, of one reading of sinkage, as learnt
        self._load_noise = load_std**2  # of ln load
        self._noise_readings = _TOLD_READINGS
        self._step = math.inf  # m, least difference of two readings so far
        self._load_mean, self._load_spread, self._segments = 0.0, _LEAST_LOAD_SPREAD**2, 0
        self._readings: list[Reading] = []
        self._log_loads: list[float] = []
        self._log_load = 0.0  # their sum
        self._start = 0.0
        self._last: Reading | None = None
        self._slip: tuple[Quantity, float] | None = None  # the newest that was known, and where
        self.recent: deque[float] = deque(maxlen=_RECENT)
        self.at = 0.0

    def in_its_rut(self, given: Reading) -> Reading:
        """A wheel that stands is as deep as it dug itself when it last rolled: so is its slip."""
        if given.slip is not None or self._slip is None:
            return given
        slip, where = self._slip
        return given if given.path - where > _STANDS else given._replace(slip=slip)

    def out_of_order(self, given: Reading) -> tuple[str, str] | None:
        """Reason and message if a reading is not behind the newest one."""
        last, name = self._last, given.wheel.name
        if last is not None and given.stamp <= last.stamp:
            return "time_backwards", (
                f"wheel '{name}': time {given.time:.6f} s is not after the last one, {last.time:.6f} s"
            )
        if last is not None and (given.distance < last.distance or given.path < last.path):
            return "distance_backwards", (
                f"wheel '{name}': distance {given.distance:g} m is less than the last one, "
                f"{last.distance:g} m"
            )
        return None

    def add(self, given: Reading) -> Segment | None:
        """Take a reading with load and sinkage; return the segment that it closes, if any."""
        closed, path = None, given.path
        load, sinkage = given.measured
        turns = self._last is not None and given.onward is not self._last.onward
        if self._closes(path) or turns:
            if self._readings and self._last is not None:
                whole = self._length if not turns else 0.5 * self._length
                closed = self._close() if path - self._start >= whole else None
            self._readings, self._log_loads, self._log_load = [], [], 0.0
        self.position = self.position_of(given)
        if not self._readings:
            self._start = path
        elif len(self._readings) >= _MOST_ROWS:
            del self._readings[1::2], self._log_loads[1::2]
            self._log_load = sum(self._log_loads)
        log_load = math.log(load)
        self._log_load += log_load
        self._log_loads.append(log_load)
        self._readings.append(given)
        if given.slip is not None and math.isfinite(given.slip.value):
            self._slip = given.slip, path
        self.recent.append(sinkage)
        self.at = given.distance + self.position.ahead
        self._last = given
        return closed

    def position_of(self, given: Reading) -> Position:
        """Position of the wheel at a reading."""
        return self._positions[0 if given.onward else 1].on_pass(given.pass_number)

    def load(self, new: Reading | None = None) -> tuple[float, float]:
        """Load (N) without its noise, and variance of its logarithm, from this stretch's readings.

        new: a reading that is not added yet, and counts too.
        """
        total, count = self._log_load, len(self._readings)
        if new is not None:
            if self._closes(new.path):
                total, count = 0.0, 0
            total, count = total + math.log(new.measured[0]), count + 1
        return self._calibrated(total / count, count)

    def _closes(self, path: float) -> bool:
        """Whether a reading there is behind the end of this stretch."""
        return bool(self._readings) and path - self._start >= self._length

    def _calibrated(self, mean: float, count: int) -> tuple[float, float]:
        """Regression calibration (Carroll et al. 2006, section 4): shrink by the share of noise."""
        noise = self._load_noise / count
        if self._segments == 0:
            return math.exp(mean), noise
        share = min(noise / max(self._load_spread, 1e-8), 1.0)
        return math.exp(mean - share * (mean - self._load_mean)), noise * (1.0 - share)

    def _close(self) -> Segment:
        readings, last = self._readings, self._readings[-1]
        wheel, count = last.wheel, len(readings)
        time, distance, pitch = np.array(
            [(one.time, one.distance, one.pitch) for one in readings]
        ).T
        sinkage = np.array([one.measured[1] for one in readings])
        log_load = np.array(self._log_loads)
        passes = _known_mean([one.pass_number for one in readings])
        position = self._positions[0 if last.onward else 1].on_pass(passes)
        self._learn_noise(sinkage, log_load)
        middle = float(np.median(sinkage))
        deviation = math.sqrt(self.reading_variance) + float(np.median(np.abs(sinkage - middle)))
        kept = np.abs(sinkage - middle) <= _KEPT * deviation
        in_mean = int(kept.sum())
        mean_log_load = float(log_load.mean())
        self._learn_loads(mean_log_load, count)
        load, load_variance = self._calibrated(mean_log_load, count)
        return Segment(
            wheel.name,
            wheel.diameter,
            wheel.width,
            wheel.contact,
            float(sinkage[kept].mean()),
            load,
            last.distance,
            _known_mean([None if one.slip is None else one.slip.value for one in readings]),
            _known_mean([one.speed for one in readings]),
            float(pitch.mean()),
            position,
            load_variance,
            variance=self.reading_variance / in_mean,
            load_rate=_slope(time, log_load),
            place=float(distance.mean()) + position.ahead,
            count=in_mean,
            dropped=count - in_mean,
            shown=(float(sinkage.min()), float(sinkage.max())),
            step=self._step,
        )

    def _learn_noise(self, sinkage: Array, log_load: Array) -> None:
        apart = np.abs(np.diff(sinkage))
        self._step = min(self._step, float(np.min(apart, where=apart > 0.0, initial=math.inf)))
        if sinkage.size < 3:
            return
        weight = min(1.0, sinkage.size / (self._noise_readings + sinkage.size))
        self.reading_variance += weight * (
            _noise(sinkage, self.reading_variance) - self.reading_variance
        )
        self._load_noise += weight * (_noise(log_load, self._load_noise) - self._load_noise)
        # A sensor that shows whole steps, or one number, is not for that without noise.
        self.reading_variance = max(self.reading_variance, 1e-10)
        self._noise_readings = min(self._noise_readings + sinkage.size, _NOISE_MEMORY)

    def _learn_loads(self, mean: float, count: int) -> None:
        """Mean and spread of ln load from stretch to stretch, noise included."""
        self._segments += 1
        gain = max(1.0 / self._segments, 1.0 / _LOAD_MEMORY)
        if self._segments == 1:
            self._load_mean = mean
            self._load_spread += self._load_noise / count
            return
        off = mean - self._load_mean
        self._load_mean += gain * off
        self._load_spread += gain * ((1.0 - gain) * off * off - self._load_spread)


def _noise(values: Array, believed: float) -> float:
    """Variance of one reading from second differences, a few wild ones cut."""
    squares = np.diff(values, 2) ** 2 / _SECOND_DIFFERENCE
    return float(np.minimum(squares, _WORST_NOISE * believed).mean()) / _CUT_MEAN


def _slope(time: Array, values: Array) -> float:
    """Slope of values over time, 0 for too few."""
    centred = time - time.mean()
    square = float(centred @ centred)
    return float(centred @ values) / square if time.size >= 3 and square > 0.0 else 0.0


def _known_mean(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None and math.isfinite(value)]
    return float(np.mean(known)) if known else None
