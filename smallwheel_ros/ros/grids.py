"""Between nav_msgs/OccupancyGrid and the library's grid."""

from __future__ import annotations

from array import array

import numpy as np
from nav_msgs.msg import OccupancyGrid

from smallwheel_ros.costmap.grid import CostMapError, Grid, grid_of
from smallwheel_ros.ros.conversions import time_message


def grid_message(grid: Grid, stamp: int) -> OccupancyGrid:
    """Turn a grid into its message; stamp in ns."""
    message = OccupancyGrid()
    message.header.stamp = time_message(stamp)
    message.header.frame_id = grid.frame
    info = message.info
    info.map_load_time = message.header.stamp
    info.resolution = grid.resolution
    info.height, info.width = grid.cells.shape
    info.origin.position.x, info.origin.position.y = grid.origin
    info.origin.orientation.w = 1.0
    # An array of the right type is taken as it is; anything else is looked at cell by cell.
    message.data = array("b", grid.cells.tobytes())
    return message


def grid_from(message: OccupancyGrid) -> Grid:
    """Turn a message into a grid.

    Raises
    ------
    CostMapError
        If it is malformed.
    """
    info = message.info
    place, turn = info.origin.position, info.origin.orientation
    if message.header.frame_id == "":
        raise CostMapError("the grid has no frame: header.frame_id is empty")
    return grid_of(
        message.header.frame_id,
        float(info.resolution),
        (info.width, info.height),
        (place.x, place.y, place.z),
        (turn.x, turn.y, turn.z, turn.w),
        np.frombuffer(message.data, dtype=np.int8).copy(),
    )
