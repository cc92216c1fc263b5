# SPDX-License-Identifier: Apache-2.0
"""The risk of getting stuck, and the warning before it.

Over steps of 0.1 m of the vehicle's path, means over the step:

    slip      of the middle wheel
    demand    what slope and gaining speed take, over the weight (0 where that is not measured)
    margin    net traction of all wheels at the reference slip over their load

The risk is the probability that within the next metre demand is more than the margin is here, where the
rise of the slope over the last metre, a straight line, goes on: gaining speed is the driver's will, and ends.
The margin's own trend is not used: grip comes in patches of half a metre to two, and what it did says little
of what it will do, while a slope that steepens mostly does so for a metre more. Lines begin anew where the
vehicle turns back, turns on the spot or stops.

A warning is given where

    slip is over 0.3: from there on the net traction of small wheels hardly rises;
    slip is over 0.2 and by its line through the last half metre at the reference slip within the next
    half metre, the time to stop on a slippery patch;
    slip is over 0.2 and the risk over 0.8: a slope that is too steep ahead.

Slip has to be up in each of them, and not of a vehicle that gains speed: it is known without mass, slope and
strength, and the margin within a few hundredths of the load only.

Where no sinkage is measured the warning is `SlipWarning`. That a wheel digs itself in is told by its slip,
sinkage and speed: `DiggingInAlarm`.
"""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.estimator.path_steps import CELL, PathStep
from smallwheel_ros.estimator.reading import SECOND, Reading
from smallwheel_ros.estimator.traction import GRAVITY
from smallwheel_ros.onboard.mobility import probability_positive
from smallwheel_ros.onboard.settings import DiggingInRules
from smallwheel_ros.onboard.streams import nanoseconds
from smallwheel_ros.physics.wheel import Quantity

Array = NDArray[np.float64]

_AHEAD = 1.0  # m, over which the line of the demand is laid, and goes on
_SOON = 0.5  # m, the same for the slip
_LIKELY = 0.8  # risk: four times in five
_SURELY = 2.0  # deviations
_ENOUGH = 4  # steps
_ORDINARY, _HIGH = 0.2, 0.3  # slip
_KNOWN = 0.03  # deviation of a step's slip at 0.3 m/s, with which warnings were measured
STALE = 2 * SECOND  # ns, after which a wheel's margin does not count


class _Wheel(NamedTuple):
    """The newest of a wheel."""

    stamp: int
    load: float
    margin: Quantity


class _Step(NamedTuple):
    """Of a step of the path that ends at this distance (m); slip NaN where none is known.

    deviation: of the slip. slope: what it takes, over the weight.
    """

    distance: float
    slip: float
    deviation: float
    slope: float


class StuckWarning:
    """Of a vehicle; feed it every reading in the order of time.

    Attributes
    ----------
    risk
        Probability that within the next metre the wheels cannot pull what they need to at the
        reference slip; None where no margin is known.
    warning
        In words; empty where there is none.
    """

    def __init__(self, wheels: int = 1) -> None:
        """Begin. wheels: that roll."""
        self._rolling = wheels
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self.risk: float | None = None
        self.warning = ""
        self._wheels: dict[str, _Wheel] = {}
        self._steps: deque[_Step] = deque(maxlen=round(_AHEAD / CELL))

    def know(self, reading: Reading, margin: Quantity | None) -> None:
        """Take the margin of a wheel."""
        if reading.load is not None and margin is not None:
            found = _Wheel(reading.stamp, reading.load.value, margin)
            self._wheels[reading.wheel.name] = found

    def take(self, step: PathStep, reading: Reading, reference_slip: float) -> None:
        """A step of the path has ended; reading: the one that ended it."""
        slips = sorted((mean.slip for mean in step.wheels.values()), key=lambda slip: slip.value)
        # Of wheels half of which stand nobody knows.
        known = 2 * len(slips) >= self._rolling and len(slips) > 0
        middle = slips[(len(slips) - 1) // 2] if known else Quantity(math.nan, 0.0)
        slope, gains = (step.slope or 0.0) / GRAVITY, (step.gained or 0.0) / GRAVITY
        if (step.gained or 0.0) > _SURELY * step.deviation:
            # Who gains speed slips because of that.
            middle = Quantity(math.nan, 0.0)
        if not step.follows:
            self._steps.clear()  # a line does not go round corners
        deviation = middle.standard_deviation
        self._steps.append(_Step(step.distance, middle.value, deviation, slope))
        newest = [w for w in self._wheels.values() if reading.stamp - w.stamp <= STALE]
        self.risk, steps = None, np.array(self._steps)
        if newest:
            margin = mean_margin([(w.load, w.margin) for w in newest])
            now, trend = _line(steps[:, 0], steps[:, 3], _AHEAD)
            # Who starts off does so of his own will: only what the ground demands goes on to rise.
            left = margin.value - now - gains - max(trend, 0.0) * _AHEAD
            self.risk = 1.0 - probability_positive(Quantity(left, margin.standard_deviation))
        self.warning = ""
        if not math.isnan(middle.value):
            known_slip = steps[~np.isnan(steps[:, 1])]
            self.warning = self._words(known_slip, reference_slip, reading.speed)

    def _words(self, steps: Array, reference_slip: float, speed: float | None) -> str:
        """Return the warning; steps: those with a slip, as rows."""
        # A slip that is known worse than at ordinary speeds may be its own noise.
        places, values = steps[:, 0], steps[:, 1] - np.maximum(steps[:, 2] - _KNOWN, 0.0)
        mean, _ = _line(places, values, _AHEAD)
        now, trend = _line(places, values, _SOON)
        high = max(mean, float(values[-1]))
        soon = now + max(trend, 0.0) * _SOON > reference_slip
        if high > _HIGH or (now > _ORDINARY and soon):
            words = f"the wheels slip by {max(high, now):.2f}"
            if trend <= 0.0 or not soon:
                return f"{words}: the vehicle may get stuck"
            left = (reference_slip - now) / trend
            when = f"in {left:.1f} m{_in_time(left, speed)}" if left > 0.0 else "at any moment"
            return f"{words} and more and more: the vehicle may get stuck {when}"
        if mean > _ORDINARY and self.risk is not None and self.risk > _LIKELY:
            return (
                f"the wheels slip by {mean:.2f}, and the slope gets too steep for this soil: the vehicle"
                f" may get stuck within {_AHEAD:g} m{_in_time(_AHEAD, speed)}"
            )
        return ""


def mean_margin(wheels: list[tuple[float, Quantity]]) -> Quantity:
    """Margin of a vehicle from loads (N) and margins of its wheels.

    All wheels stand on one estimated soil, so their errors are taken to go together.
    """
    total = sum(load for load, _ in wheels)
    value = sum(load * margin.value for load, margin in wheels)
    deviation = sum(load * margin.standard_deviation for load, margin in wheels)
    return Quantity(value / total, deviation / total)


def _line(distance: Array, value: Array, length: float) -> tuple[float, float]:
    """End of a straight line through the last so many metres, and its slope (1/m)."""
    way = distance - distance[-1]
    inside = way > -length + 0.5 * CELL
    way, values = way[inside], value[inside]
    if len(way) < _ENOUGH or np.ptp(way) < 0.5 * CELL * _ENOUGH:
        return float(np.mean(value[-_ENOUGH:])), 0.0
    trend, now = np.polyfit(way, values, 1)
    return float(now), float(trend)


def _in_time(left: float, speed: float | None) -> str:
    return f", {left / abs(speed):.0f} s" if speed else ""


_WINDOW, _SHORTEST = 1.5, 0.6  # s
_ALIKE = 0.3  # s
_SURE_OF_SLIP = 1.5  # deviations
_STOPS, _WAY, _LONGEST = 3.0, 0.5, 10.0  # s, m, s
_GAINS = 0.1  # m/s^2


class SlipWarning:
    """The warning by slip as odometry and wheel speeds alone show it.

    A straight line through the slip of the middle wheel over 1.5 s, or half a metre of the rims where that is
    longer, weighted by the deviations of the readings, gives the slip now, its trend, and by both the slip
    when a driver who is warned now has stopped: 3 s or half a metre on, whichever is later. It is warned
    where, surely,

        slip is over 0.3: from there on the net traction of small wheels hardly rises;
        slip is over 0.2 and rises, and will be over the reference slip by then;

    or slip is over 0.2 and the risk over 0.8. Surely: by 1.5 deviations of the line, which leave one reading
    in fifteen; errors of an odometry are alike over 0.3 s (`path_steps`). Steps of the path, by which it goes
    where sinkage is measured, take long where wheels slip. Who gains speed slips because of that, and who
    turns on the spot gets nowhere: neither is warned.

    Of a vehicle; feed it every reading in the order of time. wheels: that roll.
    """

    def __init__(self, wheels: int, reference_slip: float) -> None:
        self._wheels, self._reference = wheels, reference_slip
        self._now: list[Reading] = []  # of one stamp
        # s; slip of the middle wheel; m/s, mean of the rims.
        self._readings: deque[tuple[float, Quantity, float]] = deque()
        self.warning = ""

    def add(self, reading: Reading, risk: float | None) -> str:
        """Take a reading; return the warning in words, empty where there is none."""
        if self._now and reading.stamp != self._now[0].stamp:
            self._take()
            self.warning = self._words(risk)
            self._now = []
        self._now.append(reading)
        return self.warning

    def _take(self) -> None:
        """Keep the middle of the wheels' slips.

        Begin anew where the vehicle stands, turns back or turns on the spot.
        """
        slips = sorted((one.slip for one in self._now if one.slip is not None), key=_value)
        ways = {one.forward for one in self._now if one.slip is not None}
        if 2 * len(slips) <= self._wheels or len(ways) > 1:
            self._readings.clear()
            return
        rims = [one.rim_speed for one in self._now if one.rim_speed is not None]
        rim = sum(rims) / len(rims)
        newest = self._readings[-1] if self._readings else None
        time = self._now[0].stamp / SECOND
        if newest is not None and (newest[2] * rim < 0.0 or time - newest[0] > _SHORTEST):
            self._readings.clear()
        self._readings.append((time, slips[(len(slips) - 1) // 2], rim))
        window = min(max(_WINDOW, _WAY / max(abs(rim), 1e-3)), _LONGEST)
        while time - self._readings[0][0] > window:
            self._readings.popleft()

    def _words(self, risk: float | None) -> str:
        first, last = (self._readings[0], self._readings[-1]) if self._readings else (None, None)
        if first is None or last is None or last[0] - first[0] < _SHORTEST:
            return ""
        seconds = last[0] - first[0]
        if (abs(last[2]) - abs(first[2])) / seconds > _GAINS:
            return ""
        times = np.array([reading[0] - last[0] for reading in self._readings])
        slips = np.array([reading[1].value for reading in self._readings])
        weights = [1.0 / max(reading[1].standard_deviation, 1e-3) for reading in self._readings]
        line, spread = np.polyfit(times, slips, 1, w=weights, cov="unscaled")
        alike = max(_ALIKE * (len(times) - 1) / seconds, 1.0)
        trend, now = line.tolist()
        travel = max((1.0 - now) * abs(last[2]), 1e-3)
        until = min(max(_STOPS, _WAY / travel), _LONGEST)
        later = now + trend * until
        unsure, unsure_later = (
            _SURE_OF_SLIP * math.sqrt(alike * float(row @ spread @ row))
            for row in (np.array([0.0, 1.0]), np.array([until, 1.0]))
        )
        words = f"the wheels slip by {now:.2f}"
        if now > _ORDINARY and trend > 0.0 and later - unsure_later > self._reference:
            left = max((self._reference - now) / trend, 0.0)
            when = f"in {left:.0f} s" if left >= 0.5 else "at any moment"
            return f"{words} and more and more: the vehicle may get stuck {when}"
        if now - unsure > _HIGH:
            return f"{words}: the vehicle may get stuck"
        if now > _ORDINARY and risk is not None and risk > _LIKELY:
            return (
                f"{words}, and the ground asks for more than they pull: the vehicle may get stuck"
            )
        return ""


def _value(slip: Quantity) -> float:
    return slip.value


_ORDINARY_SLIP = 0.3  # up to here driving is ordinary
_MEMORY = 20  # measurements over which ordinary driving is averaged
_NO_DOUBT = 0.8  # slip that needs no ordinary speed to compare with


class DiggingInAlarm:
    """The alarm that a wheel digs itself in: slip up, sinkage up, speed over ground down.

    What is up and down is told by ordinary driving: the wheel's sinkage and speed while its slip was
    small. All three have to hold at once, for some time; slip alone is a slippery patch, sinkage alone
    a softer soil, and a low speed alone a driver who takes it easy.

    Of one wheel; feed it every reading of that wheel in the order of time.
    """

    def __init__(self, rules: DiggingInRules) -> None:
        self.rules = rules
        self.on = False
        self._sinkage: float | None = None
        self._speed: float | None = None
        self._since: int | None = None

    def update(self, reading: Reading) -> bool:
        """Take a reading; return whether the wheel digs itself in.

        A reading without slip, speed or measured sinkage changes nothing: a wheel that was stopped
        while it dug in still stands in its hole.
        """
        if reading.slip is None or reading.sinkage is None or reading.speed is None:
            return self.on
        slip, sinkage, speed = reading.slip.value, reading.sinkage.value, abs(reading.speed)
        if slip <= _ORDINARY_SLIP:
            self._sinkage = _averaged(self._sinkage, sinkage)
            self._speed = _averaged(self._speed, speed)
            self._since, self.on = None, False
            return False
        if self._sinkage is None:
            self._sinkage = sinkage
        if not self._digs(slip, sinkage, reading.sinkage.standard_deviation, speed):
            self._since = None
            # Between ordinary driving and digging an alarm stays as it is.
            return self.on
        if self._since is None:
            self._since = reading.stamp
        self.on |= reading.stamp - self._since >= nanoseconds(self.rules.time)
        return self.on

    def _digs(self, slip: float, sinkage: float, noise: float, speed: float) -> bool:
        assert self._sinkage is not None
        rise = max(self.rules.sinkage_rise * self._sinkage, 2.0 * noise)
        slow = slip >= _NO_DOUBT
        if self._speed is not None:
            slow = speed <= (1.0 - self.rules.speed_drop) * self._speed
        return slip >= self.rules.slip and slow and sinkage >= self._sinkage + rise


def _averaged(mean: float | None, value: float) -> float:
    return value if mean is None else mean + (value - mean) / _MEMORY
