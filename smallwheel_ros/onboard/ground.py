# SPDX-License-Identifier: Apache-2.0
"""From results of the estimate to the cost of the ground under the wheels."""

from __future__ import annotations

from collections.abc import Iterable

from smallwheel_ros.costmap.cost_map import CostMap
from smallwheel_ros.onboard.assessment import Result
from smallwheel_ros.onboard.mobility import MobilityEstimate, Status
from smallwheel_ros.onboard.stuck_warning import STALE, mean_margin
from smallwheel_ros.physics.wheel import Quantity


def vehicle_margin(estimates: Iterable[MobilityEstimate]) -> Quantity | None:
    """Margin of a whole vehicle: drawbar pull of all wheels over load of all wheels.

    None where no wheel has a margin.
    """
    wheels = [
        (estimate.load.value, estimate.forces.margin)
        for estimate in estimates
        if estimate.forces is not None
        and estimate.forces.margin is not None
        and estimate.load is not None
    ]
    return mean_margin(wheels) if wheels else None


class GroundMapper:
    """Lays results down where their wheels were: what the vehicle can do on such ground.

    It is the vehicle's margin that counts, not the single wheel's: a wheel that cannot even move
    itself is dragged along by the others. At a border those that are on the other soil do not count.
    """

    def __init__(self, cost_map: CostMap) -> None:
        self.map = cost_map
        self._newest: dict[str, MobilityEstimate] = {}

    def clear(self) -> None:
        """Forget the ground."""
        self.map.clear()
        self._newest.clear()

    def add(self, result: Result, frame: str) -> None:
        """Take a result; frame is that of the odometry, empty where it is not known.

        Nothing is known where the soil has not been measured yet or the measured sinkage did not
        fit; a wheel that is sunk to its axle or digs itself in is stuck there.
        """
        mobility, place = result.mobility, result.instant.place
        self._newest[mobility.wheel] = mobility
        if place is None or not frame:
            return
        self.map.follow(frame, *place)
        measured = result.soil.accepted > 0
        stuck = mobility.digging_in or (measured and mobility.status is Status.SUNK_TO_AXLE)
        margin: Quantity | None = None
        if measured and mobility.status is not Status.REJECTED:
            since = mobility.stamp - STALE
            margin = vehicle_margin(
                e
                for name, e in self._newest.items()
                if e.stamp >= since and name not in result.elsewhere
            )
        wheel = result.instant.wheel
        self.map.add(wheel.name, frame, place, wheel.width, margin, stuck=stuck)
