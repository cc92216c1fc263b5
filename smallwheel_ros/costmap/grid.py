# SPDX-License-Identifier: Apache-2.0
"""A grid of square cells on the ground, as nav_msgs/OccupancyGrid has it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.common.errors import SmallwheelError

Cells = NDArray[np.int8]

UNKNOWN = -1
HIGHEST = 100
# A planner's unit quaternion; a grid that is turned in its frame is not supported here.
_STRAIGHT = (0.0, 0.0, 0.0, 1.0)
_TURNED = 1e-3


class CostMapError(SmallwheelError):
    """A grid that is malformed, or a setting of the cost map outside its domain."""


_MOST_CELLS = 100_000_000  # of a map of several drives: 100 MB


def check_count(cells: int) -> None:
    """Raise CostMapError for more cells than a map may have."""
    if cells > _MOST_CELLS:
        raise CostMapError(
            f"the map would have {cells} cells, expected at most {_MOST_CELLS}: a larger"
            " cost.resolution, or drives of one site only"
        )


@dataclass(frozen=True)
class Grid:
    """Cells along the axes of a frame.

    Attributes
    ----------
    frame
        Name of the frame.
    resolution
        Side of a cell, m.
    origin
        Corner of cell [0, 0] with the smallest x and y, m.
    cells
        Shape (rows along y, columns along x), int8.

    Raises CostMapError where a number is not finite, or the cells have no such shape.
    """

    frame: str
    resolution: float
    origin: tuple[float, float]
    cells: Cells

    def __post_init__(self) -> None:
        """Check what a planner checks."""
        if not self.frame:
            raise CostMapError("the grid has no frame: header.frame_id is empty")
        if not (math.isfinite(self.resolution) and self.resolution > 0):
            raise CostMapError(
                f"the grid's resolution is {self.resolution!r} m, expected more than 0"
            )
        if not all(math.isfinite(value) for value in self.origin):
            raise CostMapError(f"the grid's origin is {self.origin!r}, expected finite numbers")
        if self.cells.ndim != 2 or self.cells.dtype != np.int8 or self.cells.size == 0:
            raise CostMapError(
                f"the grid's cells are {self.cells.dtype} of shape {self.cells.shape},"
                " expected int8 with rows and columns, at least one cell"
            )

    @property
    def geometry(self) -> tuple[str, float, tuple[float, float], tuple[int, ...]]:
        """Where the cells are; equal for grids whose cells coincide."""
        return self.frame, self.resolution, self.origin, self.cells.shape

    def cell(self, x: float, y: float) -> tuple[int, int] | None:
        """Row and column of a place (m); None outside."""
        row = math.floor((y - self.origin[1]) / self.resolution)
        column = math.floor((x - self.origin[0]) / self.resolution)
        rows, columns = self.cells.shape
        return (row, column) if 0 <= row < rows and 0 <= column < columns else None


def grid_of(
    frame: str,
    resolution: float,
    size: tuple[int, int],
    position: Sequence[float],
    orientation: Sequence[float],
    data: Cells,
) -> Grid:
    """Take a message's contents for a grid.

    Parameters
    ----------
    size
        Its width and height, cells.
    position, orientation
        Of its origin: m, and a quaternion (x, y, z, w).
    data
        Row-major, shape (width * height,).

    Raises
    ------
    CostMapError
        Naming what is wrong with it, what was found and what was expected.
    """
    width, height = size
    if data.size != width * height:
        raise CostMapError(
            f"the grid has {data.size} cells, expected width * height = {width} * {height}"
        )
    if data.size == 0:
        raise CostMapError(f"the grid is empty: width {width}, height {height}")
    if not all(math.isfinite(value) for value in (*position, *orientation)):
        raise CostMapError("the grid's origin is not finite")
    same = (abs(a - b) for a, b in zip(orientation, _STRAIGHT, strict=True))
    opposite = (abs(a + b) for a, b in zip(orientation, _STRAIGHT, strict=True))
    if max(same) > _TURNED and max(opposite) > _TURNED:
        raise CostMapError(
            f"the grid's origin is turned (quaternion {tuple(orientation)}), expected 0, 0, 0, 1:"
            " planners take no turned grid either"
        )
    return Grid(frame, resolution, (position[0], position[1]), data.reshape(height, width))
