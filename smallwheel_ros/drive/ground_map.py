# SPDX-License-Identifier: Apache-2.0
"""From estimates to the cost of the ground under the vehicle."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.costmap.cost_map import CostMap
from smallwheel_ros.costmap.grid import Pose
from smallwheel_ros.physics.wheel import Quantity, Wheel
from smallwheel_ros.pipeline.intake.buffer import NEVER
from smallwheel_ros.pipeline.mobility.answer import STALE
from smallwheel_ros.pipeline.mobility.status import Condition, Status
from smallwheel_ros.pipeline.tables import Estimates
from smallwheel_ros.pipeline.warning.hazard import risk_of


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
        self._newest: list[NDArray[Any]] = [
            np.full(count, NEVER), *np.full((3, count), np.nan), np.zeros(count, dtype=bool)
        ]  # fmt: skip

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
        stuck = found.spins | sunk
        level = np.where(
            found.digging_in, 2, ((found.conditions & Condition.WARNED) > 0).astype(int)
        )
        risk = risk_of(np.zeros(len(found)), level)
        refused = found.status == Status.REJECTED
        columns = (
            found.wheel,
            found.x,
            found.y,
            found.heading,
            found.distance,
            refused,
            stuck,
            risk,
            found.tilt,
        )
        margins = self._margins(found)
        rows = zip(*(column.tolist() for column in columns), margins, strict=True)
        for wheel, x, y, heading, distance, unknown, held, likely, slope, margin in (
            rows if frame else ()
        ):
            if math.isfinite(x + y + heading):
                self.map.add(
                    self._wheels[wheel], frame, Pose(x, y, heading), distance,
                    None if unknown else margin, stuck=held, risk=likely, slope=slope,
                )  # fmt: skip

    def _margins(self, found: Estimates) -> list[Quantity | None]:
        """Margin of the vehicle at each row, by the wheels that are on one soil with the row's."""
        count, rows = len(self._wheels), np.arange(len(found))
        columns = (found.stamp, found.load, found.margin, found.margin_std, found.elsewhere)
        # What was newest of each wheel before these rows, then the rows; and which is at each row.
        stamp, load, margin, deviation, elsewhere = (
            np.concatenate([before, column])
            for before, column in zip(self._newest, columns, strict=True)
        )
        at = np.tile(np.arange(count), (rows.size, 1))
        at[rows, found.wheel] = rows + count
        at = np.maximum.accumulate(at, axis=0)
        if rows.size:
            self._newest = [
                column[at[-1]] for column in (stamp, load, margin, deviation, elsewhere)
            ]
        known = np.isfinite(margin[at]) & (stamp[at] >= found.stamp[:, None] - STALE)
        known &= elsewhere[at] == found.elsewhere[:, None]
        weight = np.where(known, load[at], 0.0)
        weighed = np.isfinite(weight).all(axis=1, keepdims=True)
        weight = np.where(weighed, weight, known)
        total = weight.sum(axis=1)
        # All wheels stand on one estimated soil, so their errors are taken to go together.
        sums = (
            (weight * np.where(known, column[at], 0.0)).sum(axis=1)
            for column in (margin, deviation)
        )
        return [
            Quantity(value / whole, spread / whole) if whole else None
            for value, spread, whole in zip(
                *(one.tolist() for one in sums), total.tolist(), strict=True
            )
        ]
