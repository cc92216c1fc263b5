# SPDX-License-Identifier: Apache-2.0
"""From results of the estimate to the cost of the ground under the vehicle."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable

from smallwheel_ros.costmap.cost_map import CostMap
from smallwheel_ros.costmap.grid import Pose
from smallwheel_ros.onboard.instant import Instant
from smallwheel_ros.onboard.result import Result, Status
from smallwheel_ros.onboard.streams import SECOND
from smallwheel_ros.onboard.stuck_warning import STALE, mean_margin
from smallwheel_ros.physics.wheel import Quantity

# Slip with which nothing is gained any more: the wheel turns five times as far as it gets.
_SPINS = 0.8


def vehicle_margin(newest: Iterable[Result]) -> Quantity | None:
    """Margin of a whole vehicle: drawbar pull of all wheels over load of all wheels.

    None where no wheel has a margin.
    """
    wheels = [
        (result.instant.load.value, result.forces.margin)
        for result in newest
        if result.forces is not None
        and result.forces.margin is not None
        and result.instant.load is not None
    ]
    return mean_margin(wheels) if wheels else None


class Spinning:
    """Whether wheels spin on the spot: mean speed against mean rim speed over a second."""

    def __init__(self) -> None:
        self._seen: dict[str, deque[tuple[int, float, float]]] = {}

    def add(self, instant: Instant) -> bool:
        """Take an instant of a wheel; return whether it spins, as does most of the vehicle."""
        seen = self._seen.setdefault(instant.wheel.name, deque())
        if instant.speed is None or instant.rim_speed is None or instant.stands:
            seen.clear()
            return False
        if seen and not 0 <= instant.stamp - seen[-1][0] <= SECOND:
            seen.clear()
        seen.append((instant.stamp, instant.speed, instant.rim_speed))
        while len(seen) > 1 and instant.stamp - seen[1][0] >= SECOND:
            seen.popleft()
        spinning = [self._spins(wheel, instant.stamp) for wheel in self._seen]
        return self._spins(instant.wheel.name, instant.stamp) and 2 * sum(spinning) > len(spinning)

    def _spins(self, wheel: str, now: int) -> bool:
        seen = self._seen[wheel]
        if not seen or now - seen[-1][0] > SECOND or seen[-1][0] - seen[0][0] < SECOND:
            return False
        speed, rim = sum(each[1] for each in seen), sum(each[2] for each in seen)
        return abs(speed) < (1.0 - _SPINS) * abs(rim)


class GroundMapper:
    """Lays results down where their wheels were: what the vehicle can do on such ground.

    It is the vehicle's margin that counts, not the single wheel's: a wheel that cannot even move
    itself is dragged along by the others. At a border those that are on the other soil do not count.
    """

    def __init__(self, cost_map: CostMap) -> None:
        self.map = cost_map
        self.clear()

    def clear(self) -> None:
        """Forget the ground."""
        self.map.clear()
        self._newest: dict[str, Result] = {}
        self._spinning = Spinning()

    def add(self, result: Result, frame: str) -> None:
        """Take a result; frame is that of the odometry, empty where it is not known.

        Nothing is known where the soil has not been measured yet or the measured sinkage did not
        fit; a wheel that is sunk to its axle, digs itself in or spins on the spot is stuck there.
        """
        instant = result.instant
        self._newest[result.wheel] = result
        spins = self._spinning.add(instant)
        since = instant.stamp - STALE
        margin = vehicle_margin(
            other
            for name, other in self._newest.items()
            if other.instant.stamp >= since and name not in result.elsewhere
        )
        if self.map.prior is None:
            self.map.prior = margin
        if instant.vehicle is None or instant.heading is None or not frame:
            return
        measured = result.soil.accepted > 0
        stuck = result.digging_in or spins or (measured and result.status is Status.SUNK_TO_AXLE)
        if not measured or result.status is Status.REJECTED:
            margin = None
        pose = Pose(*instant.vehicle, instant.heading)
        slope = result.slope if self.map.settings.slope == "measured" else 0.0
        self.map.add(instant.wheel, frame, pose, instant.distance, margin, stuck=stuck, slope=slope)
