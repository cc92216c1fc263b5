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
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.estimator.sinkage_measurement import SinkageMeasurement
from smallwheel_ros.physics.conditions import ROLLING
from smallwheel_ros.physics.wheel import Wheel

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


@dataclass(frozen=True)
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
class Segment(SinkageMeasurement):
    """A mean of readings; time and distance are those of the last one.

    variance: of the mean sinkage, from the sensor's noise. log_load_variance: of ln load, from the
    sensor's. load_rate: d ln load / d time, 1/s. place: of the wheel along the vehicle's path, m.
    count: readings in the mean; dropped: left out as outliers. shown: least and most that was shown, m. step:
    least difference of two readings of this sensor so far, m.
    """

    log_load_variance: float = 0.0
    load_rate: float = 0.0
    place: float = 0.0
    count: int = 1
    dropped: int = 0
    shown: tuple[float, float] = (0.0, 0.0)
    step: float = 0.0
    position: Position = NOWHERE

    @classmethod
    def of(cls, reading: SinkageMeasurement, **means: Any) -> Segment:
        """What a reading says, but for these means."""
        return cls(**{name: getattr(reading, name) for name in _OF_READINGS} | means)

    @classmethod
    def single(
        cls,
        reading: SinkageMeasurement,
        load: float,
        log_load_variance: float,
        position: Position = NOWHERE,
    ) -> Segment:
        """One reading, to predict by. load: N, without its noise."""
        slip, speed = (
            None if value is None or not math.isfinite(value) else value
            for value in (reading.slip, reading.speed)
        )
        return cls.of(
            reading,
            variance=0.0,
            load=load,
            log_load_variance=log_load_variance,
            slip=slip,
            speed=speed,
            position=position,
        )


_OF_READINGS = tuple(field.name for field in fields(SinkageMeasurement))


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
        self._rows: list[tuple[float, ...]] = []
        self._log_loads = 0.0  # sum over the rows
        self._start = 0.0
        self._last: SinkageMeasurement | None = None
        self._slip: tuple[float, float] | None = None  # the newest that was known, and where
        self.recent: deque[float] = deque(maxlen=_RECENT)
        self.at = 0.0

    def in_its_rut(self, given: SinkageMeasurement) -> SinkageMeasurement:
        """A wheel that stands is as deep as it dug itself when it last rolled: so is its slip."""
        if given.slip is not None or self._slip is None:
            return given
        slip, where = self._slip
        return given if given.own_path - where > _STANDS else replace(given, slip=slip)

    def out_of_order(self, given: SinkageMeasurement) -> tuple[str, str] | None:
        """Reason and message if a reading is not behind the newest one."""
        last = self._last
        if last is not None and given.time <= last.time:
            return "time_backwards", (
                f"wheel '{given.wheel}': time {given.time:.6f} s is not after the last one, "
                f"{last.time:.6f} s"
            )
        if last is not None and (given.distance < last.distance or given.own_path < last.own_path):
            return "distance_backwards", (
                f"wheel '{given.wheel}': distance {given.distance:g} m is less than the last one, "
                f"{last.distance:g} m"
            )
        return None

    def add(self, given: SinkageMeasurement) -> Segment | None:
        """Take a reading; return the segment that it closes, if any."""
        closed, path = None, given.own_path
        turns = self._last is not None and given.forward is not self._last.forward
        if self._closes(path) or turns:
            if self._rows and self._last is not None:
                whole = self._length if not turns else 0.5 * self._length
                closed = self._close() if path - self._start >= whole else None
            self._rows, self._log_loads = [], 0.0
        self.position = self.position_of(given)
        if not self._rows:
            self._start = path
        elif len(self._rows) >= _MOST_ROWS:
            del self._rows[1::2]
            self._log_loads = sum(row[3] for row in self._rows)
        log_load = math.log(given.load)
        self._log_loads += log_load
        slip = math.nan if given.slip is None else given.slip
        speed = math.nan if given.speed is None else given.speed
        self._rows.append(
            (
                given.time,
                given.distance,
                given.sinkage,
                log_load,
                slip,
                speed,
                given.pitch,
                math.nan if given.pass_number is None else float(given.pass_number),
            )
        )
        if math.isfinite(slip):
            self._slip = slip, path
        self.recent.append(given.sinkage)
        self.at = given.distance + self.position.ahead
        self._last = given
        return closed

    def position_of(self, given: SinkageMeasurement) -> Position:
        """Position of the wheel at a reading."""
        return self._positions[0 if given.forward else 1].on_pass(given.pass_number)

    def load(self, new: SinkageMeasurement | None = None) -> tuple[float, float]:
        """Load (N) without its noise, and variance of its logarithm, from this stretch's readings.

        new: a reading that is not added yet, and counts too.
        """
        total, count = self._log_loads, len(self._rows)
        if new is not None:
            if self._closes(new.own_path):
                total, count = 0.0, 0
            total, count = total + math.log(new.load), count + 1
        return self._calibrated(total / count, count)

    def _closes(self, path: float) -> bool:
        """Whether a reading there is behind the end of this stretch."""
        return bool(self._rows) and path - self._start >= self._length

    def _calibrated(self, mean: float, count: int) -> tuple[float, float]:
        """Regression calibration (Carroll et al. 2006, section 4): shrink by the share of noise."""
        noise = self._load_noise / count
        if self._segments == 0:
            return math.exp(mean), noise
        share = min(noise / max(self._load_spread, 1e-8), 1.0)
        return math.exp(mean - share * (mean - self._load_mean)), noise * (1.0 - share)

    def _close(self) -> Segment:
        last = self._last
        assert last is not None
        time, distance, sinkage, log_load, slip, speed, pitch, passes = np.array(self._rows).T
        position = self._positions[0 if last.forward else 1].on_pass(_known_mean(passes))
        self._learn_noise(sinkage, log_load)
        middle = float(np.median(sinkage))
        deviation = math.sqrt(self.reading_variance) + float(np.median(np.abs(sinkage - middle)))
        kept = np.abs(sinkage - middle) <= _KEPT * deviation
        count = int(kept.sum())
        mean_log_load = float(log_load.mean())
        self._learn_loads(mean_log_load, len(self._rows))
        load, load_variance = self._calibrated(mean_log_load, len(self._rows))
        return Segment.of(
            last,
            sinkage=float(sinkage[kept].mean()),
            variance=self.reading_variance / count,
            load=load,
            log_load_variance=load_variance,
            slip=_known_mean(slip),
            speed=_known_mean(speed),
            pitch=float(pitch.mean()),
            load_rate=_slope(time, log_load),
            place=float(distance.mean()) + position.ahead,
            count=count,
            dropped=len(self._rows) - count,
            shown=(float(sinkage.min()), float(sinkage.max())),
            step=self._step,
            position=position,
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


def _known_mean(values: Array) -> float | None:
    known = values[np.isfinite(values)]
    return float(known.mean()) if known.size else None
