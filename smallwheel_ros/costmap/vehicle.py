# SPDX-License-Identifier: Apache-2.0
"""The ground that a vehicle covers: over its wheels' outer edges, from its first axle to its last."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.costmap.grid import Grid
from smallwheel_ros.physics.wheel import Wheel

Line = tuple[tuple[float, float], tuple[float, float]]  # two places, m


class Pose(NamedTuple):
    """Place (m) and heading (rad) of base_link."""

    x: float
    y: float
    heading: float

    def place(self, ahead: float, left: float) -> tuple[float, float]:
        """Where something is that is so far ahead and left of base_link, m."""
        cosine, sine = math.cos(self.heading), math.sin(self.heading)
        return self.x + cosine * ahead - sine * left, self.y + sine * ahead + cosine * left

    def inverse(self) -> Pose:
        """The pose of what this one is in, in it."""
        x, y = Pose(0.0, 0.0, -self.heading).place(-self.x, -self.y)
        return Pose(x, y, -self.heading)


HERE = Pose(0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Outline:
    """Ends of the rectangle that the wheels stand on, m from base_link: ahead and left positive.

    radius: m, by which a wheel may look out over it in front and behind.
    """

    front: float
    rear: float
    left: float
    right: float
    radius: float

    @classmethod
    def of(cls, wheels: Sequence[Wheel]) -> Outline:
        """From one axle to the other, and over the outer edges of the wheels."""
        ahead = [wheel.longitudinal_position for wheel in wheels]
        edges = [w.lateral_position + s * w.width for w in wheels for s in (-0.5, 0.5)]
        radius = 0.5 * max(wheel.diameter for wheel in wheels)
        return cls(max(ahead), min(ahead), max(edges), min(edges), radius)

    @property
    def half_width(self) -> float:
        """From base_link to the outermost edge, m: whoever plans by base_link keeps so far off."""
        return max(self.left, -self.right)

    @property
    def length(self) -> float:
        """From the front of the first wheels to the back of the last, m."""
        return self.front - self.rear + 2.0 * self.radius

    def across(self, pose: Pose, wheel: Wheel) -> tuple[Line, Line]:
        """Where the vehicle's whole width is at a wheel's axle, and where the wheel itself is."""
        ahead, middle, half = (
            wheel.longitudinal_position,
            wheel.lateral_position,
            0.5 * wheel.width,
        )
        whole = pose.place(ahead, self.left), pose.place(ahead, self.right)
        return whole, (pose.place(ahead, middle + half), pose.place(ahead, middle - half))

    def near(
        self, grid: Grid, pose: Pose, reach: float
    ) -> tuple[tuple[slice, slice], NDArray[np.float64]]:
        """A block of cells that holds all within a reach (m), and how far (m) each is from the outline."""
        middle = pose.place(0.5 * (self.front + self.rear), 0.5 * (self.left + self.right))
        half = 0.5 * (self.front - self.rear), 0.5 * (self.left - self.right)
        radius, side = math.hypot(*half) + reach, grid.resolution
        slices = []
        for at, origin, count in zip(
            reversed(middle), reversed(grid.origin), grid.cells.shape, strict=True
        ):
            ends = [math.floor((at + by - origin) / side) for by in (-radius, radius)]
            low, high = (min(max(end, 0), count) for end in (ends[0], ends[1] + 1))
            slices.append(slice(low, high))
        rows, columns = (np.arange(part.start, part.stop) + 0.5 for part in slices)
        y = (grid.origin[1] + side * rows - middle[1])[:, None]
        x = (grid.origin[0] + side * columns - middle[0])[None, :]
        cosine, sine = math.cos(pose.heading), math.sin(pose.heading)
        ahead = np.maximum(np.abs(cosine * x + sine * y) - half[0], 0.0)
        aside = np.maximum(np.abs(cosine * y - sine * x) - half[1], 0.0)
        return (slices[0], slices[1]), np.hypot(ahead, aside)
