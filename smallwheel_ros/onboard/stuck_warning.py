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
"""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.estimator.path_steps import CELL, PathStep
from smallwheel_ros.estimator.traction import GRAVITY
from smallwheel_ros.onboard.instant import Instant
from smallwheel_ros.onboard.mobility import probability_positive
from smallwheel_ros.onboard.streams import SECOND
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
    """Of a vehicle; feed it every instant in the order of time.

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

    def know(self, instant: Instant, margin: Quantity | None) -> None:
        """Take the margin of a wheel."""
        if instant.load is not None and margin is not None:
            found = _Wheel(instant.stamp, instant.load.value, margin)
            self._wheels[instant.wheel.name] = found

    def take(self, step: PathStep, instant: Instant, reference_slip: float) -> None:
        """A step of the path has ended; instant: the one that ended it."""
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
        newest = [w for w in self._wheels.values() if instant.stamp - w.stamp <= STALE]
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
            self.warning = self._words(known_slip, reference_slip, instant.speed)

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
    loads, values, deviations = np.array(
        [(load, margin.value, margin.standard_deviation) for load, margin in wheels]
    ).T
    return Quantity(float(loads @ values / loads.sum()), float(loads @ deviations / loads.sum()))


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
