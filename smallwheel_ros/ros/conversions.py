# SPDX-License-Identifier: Apache-2.0
"""Between ROS messages and the library's values; nothing is worked out here."""

from __future__ import annotations

import importlib
from array import array
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from nav_msgs.msg import OccupancyGrid

from smallwheel_ros.costmap.grid import CostMapError, Grid, grid_of
from smallwheel_ros.estimator.identifiability import SoilEstimate
from smallwheel_ros.msg import MobilityEstimate as MobilityMessage
from smallwheel_ros.msg import SoilEstimate as SoilMessage
from smallwheel_ros.onboard.result import Result, mobility_fields, soil_fields
from smallwheel_ros.onboard.streams import SECOND


def message_class(kind: str) -> Any | None:
    """Return the ROS class of a type like nav_msgs/msg/Odometry; None: it is not installed."""
    try:
        package, _, name = kind.split("/")
        return getattr(importlib.import_module(f"{package}.msg"), name)
    except (ValueError, ImportError, AttributeError):
        return None


def nanoseconds_of(stamp: Time) -> int:
    """Turn a header's stamp into ns."""
    return int(stamp.sec) * SECOND + int(stamp.nanosec)


def time_message(stamp: int) -> Time:
    """Turn ns into a header's stamp."""
    return Time(sec=stamp // SECOND, nanosec=stamp % SECOND)


def mobility_message(result: Result) -> MobilityMessage:
    """Turn a wheel's result into its message."""
    message = MobilityMessage(**mobility_fields(result))
    message.header.stamp = time_message(result.instant.stamp)
    message.header.frame_id = result.wheel
    return message


def soil_message(soil: SoilEstimate, stamp: int, frame: str, rejected: int) -> SoilMessage:
    """Turn an estimate of the soil into its message."""
    message = SoilMessage(**soil_fields(soil, rejected))
    message.header.stamp = time_message(stamp)
    message.header.frame_id = frame
    return message


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
    """Turn a message into a grid. Raises CostMapError if it is malformed."""
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
