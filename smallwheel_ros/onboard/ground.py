"""From results of the estimate to the cost of the ground under the wheels."""

from __future__ import annotations

from smallwheel_ros.costmap.cost_map import CostMap
from smallwheel_ros.onboard.mobility import Status
from smallwheel_ros.onboard.onboard import Result


def add_to_map(cost_map: CostMap, result: Result, frame: str, width: float) -> None:
    """Lay a result down where its wheel was.

    Nothing is known where the soil has not been measured yet or the measured sinkage did not fit; a
    wheel that is sunk to its axle or digs itself in is stuck there.

    Parameters
    ----------
    frame
        Frame of the odometry, not empty.
    width
        Of the wheel, m.
    """
    mobility, place = result.mobility, result.place
    if place is None or not frame:
        return
    cost_map.follow(frame, *place)
    measured = result.soil.accepted > 0
    stuck = mobility.digging_in or (measured and mobility.status is Status.SUNK_TO_AXLE)
    margin = mobility.forces.margin if mobility.forces is not None else None
    if not measured or mobility.status is Status.REJECTED:
        margin = None
    cost_map.add(mobility.wheel, frame, place, width, margin, stuck=stuck)
