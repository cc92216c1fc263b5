"""The risk of getting stuck, and the warning before it.

Over steps of 0.1 m of the vehicle's path, straight lines through the last metre:

    slip      of the middle wheel, mean over the step
    reserve   net traction of all wheels at the reference slip over their load, less what slope and
              gaining speed take now, over the weight (0 where that is not measured)

The risk is the probability that reserve is below 0 within the next metre, where a fall goes on. A
warning is given where slip is over 0.3, or over 0.2 and on the way to the reference slip within the next
metre: from there on the net traction of small wheels hardly rises. The warning rests on slip, not on
the reserve, since slip is known without mass, slope or strength, and reserve within a few hundredths
of the load only.
"""

from __future__ import annotations

from collections import defaultdict, deque
from typing import NamedTuple

import numpy as np

from smallwheel_ros.estimator.traction import GRAVITY
from smallwheel_ros.onboard.instant import Instant
from smallwheel_ros.onboard.mobility import probability_positive
from smallwheel_ros.onboard.streams import SECOND
from smallwheel_ros.physics.wheel import Quantity

_AHEAD = 1.0  # m, over which a line is laid, and goes on
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
    """The means of a step that ends at this distance (m); None where nothing is known."""

    distance: float
    slip: float | None
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
        self._reserves: deque[float] = deque(maxlen=round(_AHEAD / _STEP))
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
                    slips[(len(slips) - 1) // 2] if slips else None,
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
        if known:
            margin = mean_margin([(w.load, w.margin) for w in known])
            self._reserves.append(margin.value - self._steps[-1].demand)
            places = [step.distance for step in self._steps][-len(self._reserves) :]
            now, trend = _line(places, list(self._reserves))
            ahead = now + min(trend, 0.0) * _AHEAD
            self.risk = 1.0 - probability_positive(Quantity(ahead, margin.standard_deviation))
        else:
            self.risk = None
            self._reserves.clear()
        slips = [(step.distance, step.slip) for step in self._steps if step.slip is not None]
        self.warning = ""
        if slips and self._steps[-1].slip is not None:
            now, trend = _line(*map(list, zip(*slips, strict=True)))
            if max(now, self._steps[-1].slip) > _HIGH:
                self.warning = f"the wheels slip by {now:.2f}: the vehicle may get stuck"
            elif now > _ORDINARY and now + trend * _AHEAD > reference_slip:
                left = (reference_slip - now) / trend
                self.warning = (
                    f"the wheels slip by {now:.2f} and more and more: the vehicle may get stuck in"
                    f" {left:.1f} m{_in_time(left, instant.speed)}"
                )


def mean_margin(wheels: list[tuple[float, Quantity]]) -> Quantity:
    """Margin of a vehicle from loads (N) and margins of its wheels.

    All wheels stand on one estimated soil, so their errors are taken to go together.
    """
    loads, values, deviations = np.array(
        [(load, margin.value, margin.standard_deviation) for load, margin in wheels]
    ).T
    return Quantity(float(loads @ values / loads.sum()), float(loads @ deviations / loads.sum()))


def _line(distance: list[float], value: list[float]) -> tuple[float, float]:
    """End of a straight line through the last metre, and its slope (1/m)."""
    way = np.array(distance) - distance[-1]
    if len(way) < _ENOUGH or np.ptp(way) < 0.5 * _STEP * _ENOUGH:
        return float(np.mean(value[-_ENOUGH:])), 0.0
    trend, now = np.polyfit(way, value, 1)
    return float(now), float(trend)


def _in_time(left: float, speed: float | None) -> str:
    return f", {left / abs(speed):.0f} s" if speed else ""
