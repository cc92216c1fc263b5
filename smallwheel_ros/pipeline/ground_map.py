# SPDX-License-Identifier: Apache-2.0
"""From estimates to the cost of the ground under the vehicle."""

from __future__ import annotations

import math

import numpy as np

from smallwheel_ros.costmap.cost_map import CostMap
from smallwheel_ros.costmap.grid import Pose
from smallwheel_ros.physics.wheel import Quantity, Wheel

from .answer import STALE, Condition
from .answers import Status
from .stream import NEVER
from .tables import Estimates


class GroundMapper:
    """Lays estimates down where their wheels were: what the vehicle can do on such ground.

    It is the vehicle's margin that counts, not the single wheel's: a wheel that cannot even move
    itself is dragged along by the others. At a border those that are on the other soil do not count.
    """

    def __init__(self, cost_map: CostMap, wheels: tuple[Wheel, ...]) -> None:
        self.map, self._wheels = cost_map, wheels
        self.clear()

    def clear(self) -> None:
        """Forget the ground."""
        self.map.clear()
        count = len(self._wheels)
        # Of the newest row of each wheel: stamp; load, margin, its deviation; whether it is elsewhere.
        self._stamps = np.full(count, NEVER)
        self._newest = np.full((count, 3), np.nan)
        self._elsewhere = np.zeros(count, dtype=bool)

    def add(self, found: Estimates, frame: str) -> None:
        """Take rows of estimates; frame is that of the odometry, empty where it is not known.

        Every margin counts, with its deviation: before the soil has been measured, and where its sinkage
        never is, that is what balance and torque tell, or the prior. Nothing is known where the measured
        sinkage did not fit. A wheel that is sunk to its axle in soil that was measured, digs itself in or
        spins on the spot is stuck there.
        """
        sunk = (found.status == Status.SUNK_TO_AXLE) & (
            (found.conditions & Condition.PRIOR_ONLY) == 0
        )
        stuck = found.digging_in | found.spins | sunk
        newest = np.column_stack([found.load, found.margin, found.margin_std])
        for i, wheel in enumerate(found.wheel.tolist()):
            stamp = int(found.stamp[i])
            self._stamps[wheel], self._newest[wheel] = stamp, newest[i]
            self._elsewhere[wheel] = found.elsewhere[i]
            pose = Pose(float(found.x[i]), float(found.y[i]), float(found.heading[i]))
            if not frame or not math.isfinite(sum(pose)):
                continue
            refused = found.status[i] == Status.REJECTED
            margin = None if refused else self._margin(stamp, bool(found.elsewhere[i]))
            self.map.add(
                self._wheels[wheel], frame, pose, float(found.distance[i]), margin,
                stuck=bool(stuck[i]), slope=float(found.tilt[i]),
            )  # fmt: skip

    def _margin(self, stamp: int, elsewhere: bool) -> Quantity | None:
        """Margin of the vehicle by the wheels that are on one soil with this one."""
        load, margin, deviation = self._newest.T
        known = np.isfinite(margin) & (self._stamps >= stamp - STALE)
        known &= self._elsewhere == elsewhere
        if not known.any():
            return None
        load = load[known] if np.isfinite(load[known]).all() else np.ones(int(known.sum()))
        # All wheels stand on one estimated soil, so their errors are taken to go together.
        total = float(load.sum())
        return Quantity(float(load @ margin[known]) / total, float(load @ deviation[known]) / total)
