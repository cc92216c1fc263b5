# SPDX-License-Identifier: Apache-2.0
"""From results of the estimate to the cost of the ground under the wheels."""

from __future__ import annotations

from collections.abc import Iterable

from smallwheel_ros.costmap.cost_map import CostMap
from smallwheel_ros.onboard.result import Result, Status
from smallwheel_ros.onboard.stuck_warning import STALE, mean_margin
from smallwheel_ros.physics.wheel import Quantity


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


class GroundMapper:
    """Lays results down where their wheels were: what the vehicle can do on such ground.

    It is the vehicle's margin that counts, not the single wheel's: a wheel that cannot even move
    itself is dragged along by the others. At a border those that are on the other soil do not count.
    """

    def __init__(self, cost_map: CostMap) -> None:
        self.map = cost_map
        self._newest: dict[str, Result] = {}

    def clear(self) -> None:
        """Forget the ground."""
        self.map.clear()
        self._newest.clear()

    def add(self, result: Result, frame: str) -> None:
        """Take a result; frame is that of the odometry, empty where it is not known.

        Nothing is known where the soil has not been measured yet or the measured sinkage did not
        fit; a wheel that is sunk to its axle or digs itself in is stuck there.
        """
        wheel, place = result.instant.wheel, result.instant.place
        self._newest[wheel.name] = result
        if place is None or not frame:
            return
        self.map.follow(frame, *place)
        measured = result.soil.accepted > 0
        stuck = result.digging_in or (measured and result.status is Status.SUNK_TO_AXLE)
        margin: Quantity | None = None
        if measured and result.status is not Status.REJECTED:
            since = result.instant.stamp - STALE
            margin = vehicle_margin(
                other
                for name, other in self._newest.items()
                if other.instant.stamp >= since and name not in result.elsewhere
            )
        slope = result.slope if self.map.settings.slope == "measured" else 0.0
        self.map.add(wheel.name, frame, place, wheel.width, margin, stuck=stuck, slope=slope)
