# SPDX-License-Identifier: Apache-2.0
"""Conversions between messages and values, without any computation."""

from __future__ import annotations

import importlib
import math
from array import array
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from nav_msgs.msg import OccupancyGrid
from std_msgs.msg import Header

from smallwheel_ros.common.stamps import SECOND
from smallwheel_ros.costmap.grid import Grid, Pose
from smallwheel_ros.pipeline.intake.inputs import angles_of


def message_class(kind: str) -> Any | None:
    """Return the ROS class of a message type such as nav_msgs/msg/Odometry; None if it is not installed."""
    try:
        package, _, name = kind.split("/")
        return getattr(importlib.import_module(f"{package}.msg"), name)
    except (ValueError, ImportError, AttributeError):
        return None


def nanoseconds_of(stamp: Time) -> int:
    """Return a header's stamp in ns."""
    return int(stamp.sec) * SECOND + int(stamp.nanosec)


def time_message(stamp: int) -> Time:
    """Return a stamp (ns) as that of a header."""
    return Time(sec=stamp // SECOND, nanosec=stamp % SECOND)


def header_of(stamp: int, frame: str) -> Header:
    """Make a message header.

    Parameters
    ----------
    stamp
        Stamp of the header, ns.
    frame
        Its frame_id.
    """
    return Header(stamp=time_message(stamp), frame_id=frame)


def grid_message(grid: Grid, stamp: int) -> OccupancyGrid:
    """Turn a grid of costs into a message.

    Parameters
    ----------
    grid
        The grid, of int8 cells.
    stamp
        Stamp of the header, ns.

    Returns
    -------
    OccupancyGrid
        In the grid's frame; its cells are row by row.
    """
    message = OccupancyGrid(header=header_of(stamp, grid.frame))
    info = message.info
    info.map_load_time = message.header.stamp
    info.resolution = grid.resolution
    info.height, info.width = grid.cells.shape
    info.origin.position.x, info.origin.position.y = grid.origin
    info.origin.orientation.w = 1.0
    # An array of the right type is used directly; anything else would be checked cell by cell.
    message.data = array("b", grid.cells.tobytes())
    return message


def pose_of(transform: Any) -> Pose:
    """Return x, y (m) and heading (rad) of a geometry_msgs/Transform.

    The heading is NaN if its quaternion is not of unit length.
    """
    by, turn = transform.translation, transform.rotation
    cosine, sine, *_ = angles_of(*np.array([[turn.x], [turn.y], [turn.z], [turn.w]]))
    return Pose(by.x, by.y, math.atan2(float(sine[0]), float(cosine[0])))
