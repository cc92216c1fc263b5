# SPDX-License-Identifier: Apache-2.0
"""A picture of a cost map."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.image import imread

from smallwheel_ros.costmap.cost_picture import draw_cost
from smallwheel_ros.costmap.grid import UNKNOWN, Grid


def test_a_picture_shows_lethal_ground_dark_and_unknown_ground_light(tmp_path: Path) -> None:
    cells = np.full((20, 20), UNKNOWN, dtype=np.int8)
    cells[5:15, 5:10], cells[5:15, 10:15] = 0, 100
    grid = Grid("odom", 0.1, (0.0, 0.0), cells)
    draw_cost(grid, tmp_path / "cost.png", way=np.array([[0.5, 1.0], [1.0, 1.0]]))
    image = imread(tmp_path / "cost.png")[..., :3]
    dark, light = (np.abs(image - shade / 255.0).max(axis=2) < 0.01 for shade in (0x1A, 0xE8))
    assert dark.sum() > 1000
    assert light.sum() > 1000
    assert np.argwhere(dark)[:, 1].mean() > np.argwhere(light)[:, 1].mean()
