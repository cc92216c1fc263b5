# SPDX-License-Identifier: Apache-2.0
"""The risk of getting stuck, and the warning before it.

Over steps of 0.1 m of the vehicle's path, means over the step:

    slip      of the middle wheel
    demand    what slope and gaining speed take, over the weight (0 where that is not measured)
    margin    net traction of all wheels at the reference slip over their load

The risk is the probability that within the next metre demand is more than the margin is here, where the
rise of the demand over the last metre, a straight line, goes on. The margin's own trend is not used: grip
comes in patches of half a metre to two, and what it did says little of what it will do, while a slope that
steepens mostly does so for a metre more.

A warning is given where

    slip is over 0.3: from there on the net traction of small wheels hardly rises;
    slip is over 0.2 and by its line through the last half metre at the reference slip within the next
    half metre, the time to stop on a slippery patch;
    slip is over 0.2 and the risk over 0.8: a slope that is too steep ahead.

Slip has to be up in each of them: it is known without mass, slope and strength, and the margin within a
few hundredths of the load only.
"""

from __future__ import annotations

import math
from collections import defaultdict, deque
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.estimator.traction import GRAVITY
from smallwheel_ros.onboard.instant import Instant
from smallwheel_ros.onboard.mobility import probability_positive
from smallwheel_ros.onboard.streams import SECOND
from smallwheel_ros.physics.wheel import Quantity

Array = NDArray[np.float64]

_AHEAD = 1.0  # m, over which the line of the demand is laid, and goes on
_SOON = 0.5  # m, the same for the slip
_LIKELY = 0.8  # risk: four times in five
_STEP, _LONGEST_STEP = 0.1, 0.5  # m, s: wheels that spin on one spot
_ENOUGH = 4  # steps
_ORDINARY, _HIGH = 0.2, 0.3  # slip
STALE = 2 * SECOND  # ns, after which a wheel's margin does not count


class _Wheel(NamedTuple):
    """The newest of a wheel."""

    stamp: int
    load: float
    margin: Quantity


class _Step(NamedTuple):
    """The means of a step that ends at this distance (m); slip NaN where none is known."""

    distance: float
    slip: float
    demand: float


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

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self.risk: float | None = None
        self.warning = ""
        self._wheels: dict[str, _Wheel] = {}
        self._steps: deque[_Step] = deque(maxlen=round(_AHEAD / _STEP))
        self._begin: tuple[int, float] | None = None  # stamp and distance of the step
        self._demands: list[float] = []
        self._slips: dict[str, list[float]] = defaultdict(list)

    def add(self, instant: Instant, margin: Quantity | None, reference_slip: float) -> None:
        """Take an instant, and the margin of its wheel."""
        name, load = instant.wheel.name, instant.load
        if load is not None and margin is not None:
            self._wheels[name] = _Wheel(instant.stamp, load.value, margin)
        if instant.specific_force is not None:
            self._demands.append(instant.specific_force / GRAVITY)
        if instant.slip is not None:
            self._slips[name].append(instant.slip.value)
        if self._begin is None:
            self._begin = instant.stamp, instant.distance
        stamp, distance = self._begin
        long = instant.stamp - stamp >= _LONGEST_STEP * SECOND and bool(self._slips)
        if long or instant.distance - distance >= _STEP:
            slips = sorted(float(np.mean(values)) for values in self._slips.values())
            self._steps.append(
                _Step(
                    instant.distance,
                    slips[(len(slips) - 1) // 2] if slips else math.nan,
                    float(np.mean(self._demands)) if self._demands else 0.0,
                )
            )
            self._judge(instant, reference_slip)
            self._begin = instant.stamp, instant.distance
            self._demands.clear()
            self._slips.clear()

    def _judge(self, instant: Instant, reference_slip: float) -> None:
        """A step has ended."""
        known = [w for w in self._wheels.values() if instant.stamp - w.stamp <= STALE]
        self.risk, steps = None, np.array(self._steps)
        if known:
            margin = mean_margin([(w.load, w.margin) for w in known])
            now, trend = _line(steps[:, 0], steps[:, 2], _AHEAD)
            left = margin.value - now - max(trend, 0.0) * _AHEAD
            self.risk = 1.0 - probability_positive(Quantity(left, margin.standard_deviation))
        self.warning = ""
        if not math.isnan(self._steps[-1].slip):
            known_slip = steps[~np.isnan(steps[:, 1])]
            self.warning = self._words(known_slip, reference_slip, instant.speed)

    def _words(self, steps: Array, reference_slip: float, speed: float | None) -> str:
        """Return the warning; steps: those with a slip, as rows."""
        places, values = steps[:, 0], steps[:, 1]
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
    inside = way > -length + 0.5 * _STEP
    way, values = way[inside], value[inside]
    if len(way) < _ENOUGH or np.ptp(way) < 0.5 * _STEP * _ENOUGH:
        return float(np.mean(value[-_ENOUGH:])), 0.0
    trend, now = np.polyfit(way, values, 1)
    return float(now), float(trend)


def _in_time(left: float, speed: float | None) -> str:
    return f", {left / abs(speed):.0f} s" if speed else ""
