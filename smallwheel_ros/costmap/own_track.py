# SPDX-License-Identifier: Apache-2.0
"""The cells that base_link was in, over which the vehicle can drive back."""

from __future__ import annotations

import math

import numpy as np

from smallwheel_ros.costmap.crossed_ground import LONGEST_STEP, Places
from smallwheel_ros.costmap.grid import HIGHEST, Cells, Grid, Pose

# Four places in each cell, so that no cell of a rotated grid is missed.
_PARTS = np.array([(a, b) for a in (0.25, 0.75) for b in (0.25, 0.75)])


class OwnTrack:
    """Cells in which base_link has been, and the cost of driving back over them.

    With base_link in such a cell, all wheels were on crossed ground, whatever lies beside it.

    Parameters
    ----------
    resolution
        Side of a cell, m.
    """

    def __init__(self, resolution: float) -> None:
        self.resolution = resolution
        self.clear()

    def clear(self) -> None:
        """Forget all cells."""
        self._numbers: dict[tuple[int, int], int] = {}  # of each cell, by its row and column
        # By that number: row and column, and the cost, `HIGHEST` where it was stuck; with room for more.
        self._cells: Places = np.empty((64, 2), dtype=np.int32)
        self._homes: Cells = np.empty(64, dtype=np.int8)

    def follow(self, last: Pose, pose: Pose, home: int) -> None:
        """Record the cells from the vehicle's last place to this one, and the cost of driving back over them.

        Where the two are more than `LONGEST_STEP` apart, only the present cell is recorded.

        Parameters
        ----------
        last, pose
            Last and present pose of base_link, in the frame of the costs: x, y (m) and heading (rad).
        home
            Cost of the cells on the way back, 0 to 99; 100 if the vehicle is stuck, which stays.
        """
        gone = math.dist(pose[:2], last[:2])
        steps = max(math.ceil(2.0 * gone / self.resolution), 1)
        parts = [(k + 1) / steps for k in range(steps)] if gone <= LONGEST_STEP else [1.0]
        for part in parts:
            x, y = (a + part * (b - a) for a, b in zip(last[:2], pose[:2], strict=True))
            self._note((math.floor(y / self.resolution), math.floor(x / self.resolution)), home)

    def _note(self, cell: tuple[int, int], home: int) -> None:
        number = self._numbers.get(cell)
        if number is None:
            number = self._numbers[cell] = len(self._numbers)
            if number == len(self._homes):
                self._cells = np.concatenate([self._cells, np.empty_like(self._cells)])
                self._homes = np.concatenate([self._homes, np.empty_like(self._homes)])
            self._cells[number], self._homes[number] = cell, home
        elif self._homes[number] != HIGHEST:
            self._homes[number] = home

    def leave_way_home(self, costs: Grid, pose: Pose, free: int) -> None:
        """Reduce the costs of the track's cells to those of driving back; never where the vehicle was stuck.

        Parameters
        ----------
        costs
            Grid, which is changed in place.
        pose
            Pose of the track's frame in that of the costs.
        free
            Cost up to which the way back counts as free (0).
        """
        homes, cells = (one[: len(self._numbers)] for one in (self._homes, self._cells))
        # The highest last: of several that are written to one cell, the last one stays.
        order = np.argsort(homes, kind="stable")
        order = order[homes[order] != HIGHEST]
        homes = np.repeat(np.where(homes[order] <= free, np.int8(0), homes[order]), len(_PARTS))
        y, x = self.resolution * (cells[order][:, None] + _PARTS).reshape(-1, 2).T
        x, y = pose.place(x, y)
        at = np.floor((np.stack([y, x]) - np.array(costs.origin)[::-1, None]) / costs.resolution)
        inside = ((at >= 0) & (at < np.array(costs.cells.shape)[:, None])).all(axis=0)
        row, column = at[:, inside].astype(int)
        costs.cells[row, column] = np.minimum(costs.cells[row, column], homes[inside])
