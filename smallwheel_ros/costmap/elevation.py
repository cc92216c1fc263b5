# SPDX-License-Identifier: Apache-2.0
"""Ground ahead, from a map of elevations (grid_map_msgs/GridMap): slopes, and classes given by layers.

    ahead = elevation_from(message, "elevation", length=0.9)
    ahead.slope        # tangent of the steepest direction, (rows along y, columns along x), NaN unknown

A layer's data is stored column by column (`column_index`, along y, then `row_index`, along x), with
index (0, 0) at the largest x and y. The map is a ring buffer: cell (0, 0) is stored at
outer_start_index (of rows), inner_start_index (of columns) (grid_map_ros, GridMapRosConverter).

The slope is that of a least-squares plane over a square of the vehicle's length, where at least 70 % of the
square is known. Its deviation is that of the plane's residuals over the length,

    rms residual sqrt(12) / length,

as if all residuals were bumps that a vehicle of that length climbs: with independent errors the
plane would be better known, by the root of their number.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.ndimage import uniform_filter

from smallwheel_ros.costmap.cost import STEEPEST, Array
from smallwheel_ros.costmap.grid import CostMapError, check_straight

KNOWN = 0.7  # share of a square that has to be known
_MOST_CELLS = 4_000_000
_COLUMNS, _ROWS = "column_index", "row_index"
_HEIGHTS = 1e6  # m: more is no elevation


@dataclass(frozen=True)
class Elevation:
    """Slopes of ground ahead, on cells along the axes of a frame.

    Attributes
    ----------
    frame
        Name of the frame.
    resolution
        Side of a cell, m.
    origin
        x and y of the corner of cell [0, 0] with the smallest x and y, m.
    slope, deviation
        Tangent of the steepest direction, and its standard deviation; shape (rows along y, columns
        along x), NaN where they are not known.
    classes
        Probability of each terrain class that has a layer of its name; same shape.
    """

    frame: str
    resolution: float
    origin: tuple[float, float]
    slope: Array
    deviation: Array
    classes: Mapping[str, Array] = field(default_factory=dict)


def elevation_from(message: Any, layer: str, length: float, names: Sequence[str] = ()) -> Elevation:
    """Compute slopes from a grid_map_msgs/GridMap, as received by rclpy or read from a bag.

    Parameters
    ----------
    message
        The map.
    layer
        Name of the layer of elevations, m.
    length
        Length of the vehicle, m, over which slopes are determined.
    names
        Names of terrain classes: layers of such a name are probabilities of the class.

    Returns
    -------
    Elevation
        Cells of the message's resolution. Heights of over 1000 km count as unknown.

    Raises
    ------
    CostMapError
        If the message cannot be used; the error says what is wrong with it, and what was expected.
    """
    info = message.info
    check_straight(info.pose.orientation, "the map of elevations")
    layers = list(message.layers)
    if layer not in layers:
        there = ", ".join(layers) or "none"
        raise CostMapError(
            f"the map of elevations has no layer {layer!r}, it has {there}: elevation_layer names it"
        )
    resolution = float(info.resolution)
    if not message.header.frame_id:
        raise CostMapError("the map of elevations has no frame: header.frame_id is empty")
    if not (math.isfinite(resolution) and resolution > 0.0):
        raise CostMapError(f"its resolution is {resolution!r} m, expected more than 0")
    heights = layer_of(message, layer)
    heights = np.where(np.abs(heights) < _HEIGHTS, heights, np.nan)
    if not np.isfinite(heights).any():
        raise CostMapError(f"no cell of its layer {layer!r} is known, all are NaN")
    slope, deviation = slopes(heights, resolution, length)
    rows, columns = heights.shape
    middle = info.pose.position
    origin = middle.x - 0.5 * columns * resolution, middle.y - 0.5 * rows * resolution
    if not all(math.isfinite(value) for value in origin):
        raise CostMapError(f"its middle is at {middle.x!r}, {middle.y!r}, expected finite numbers")
    classes = {
        name: np.clip(np.nan_to_num(layer_of(message, name)), 0.0, 1.0)
        for name in names
        if name in layers
    }
    return Elevation(message.header.frame_id, resolution, origin, slope, deviation, classes)


def layer_of(message: Any, name: str) -> Array:
    """Read a layer's values, sorted by x and y.

    Parameters
    ----------
    message
        grid_map_msgs/GridMap.
    name
        Name of the layer.

    Returns
    -------
    ndarray
        Shape (rows along y, columns along x), the smallest x and y first.

    Raises
    ------
    CostMapError
        If its sizes, its layout or its start are not those of a grid map.
    """
    info, array = message.info, message.data[list(message.layers).index(name)]
    sides = info.length_x / info.resolution, info.length_y / info.resolution
    columns, rows = (round(side) if math.isfinite(side) else 0 for side in sides)
    labels = [one.label for one in array.layout.dim]
    if labels not in ([_COLUMNS, _ROWS], [_ROWS, _COLUMNS]):
        raise CostMapError(
            f"layer {name!r} has the layout {', '.join(labels) or 'none'}, expected {_COLUMNS}, {_ROWS}"
        )
    # rows of the layer lie along x, its columns along y
    sizes = {one.label: int(one.size) for one in array.layout.dim}
    wanted = {_COLUMNS: rows, _ROWS: columns}
    values = np.asarray(array.data, dtype=np.float64)
    if not (sizes == wanted and 0 < values.size == rows * columns <= _MOST_CELLS):
        raise CostMapError(
            f"layer {name!r} has {values.size} cells, {sizes[_ROWS]} by {sizes[_COLUMNS]}; its lengths"
            f" over its resolution say {columns} by {rows}, and at most {_MOST_CELLS} are taken"
        )
    cells = values.reshape([sizes[label] for label in labels])
    if labels[0] == _ROWS:
        cells = cells.T
    inner, outer = int(message.inner_start_index), int(message.outer_start_index)
    if inner >= rows or outer >= columns:
        raise CostMapError(
            f"its inner_start_index is {inner} and its outer_start_index {outer}, expected less than"
            f" {rows} and {columns}, its cells along y and x"
        )
    return np.roll(cells, (-inner, -outer), axis=(0, 1))[::-1, ::-1]


def slopes(heights: Array, resolution: float, length: float) -> tuple[Array, Array]:
    """Compute the slope at each cell from a plane fitted to the square around it.

    Parameters
    ----------
    heights
        m, NaN where unknown; shape (rows along y, columns along x).
    resolution
        Side of a cell, m.
    length
        Side of the square, m; it is rounded to an odd number of cells, at least 3.

    Returns
    -------
    slope, deviation
        Tangent of the steepest direction, 2 at most, and its standard deviation, each of the same shape; NaN
        where less than `KNOWN` of the square is known.
    """
    cells = max(2 * round(0.5 * (length / resolution - 1.0)) + 1, 3)
    known = np.isfinite(heights)
    there = known.astype(np.float64)
    z = np.where(known, heights - np.nanmean(heights), 0.0)
    y, x = (
        resolution * np.broadcast_to(index - index.mean(), heights.shape)
        for index in np.ogrid[: heights.shape[0], : heights.shape[1]]
    )

    def box(values: Array) -> Array:
        return np.asarray(uniform_filter(values, cells, mode="constant"))

    share = box(there)
    with np.errstate(all="ignore"):
        mean_x, mean_y, mean_z = (box(there * one) / share for one in (x, y, z))

        def product(a: Array, b: Array, mean_a: Array, mean_b: Array) -> Array:
            return np.asarray(box(there * a * b) / share - mean_a * mean_b)

        xx, xy = product(x, x, mean_x, mean_x), product(x, y, mean_x, mean_y)
        yy, zz = product(y, y, mean_y, mean_y), product(z, z, mean_z, mean_z)
        xz, yz = product(x, z, mean_x, mean_z), product(y, z, mean_y, mean_z)
        size = xx * yy - xy * xy
        ahead, aside = (xz * yy - yz * xy) / size, (yz * xx - xz * xy) / size
        residual = np.maximum(zz - ahead * xz - aside * yz, 0.0)
        slope = np.minimum(np.hypot(ahead, aside), STEEPEST)
        deviation = np.sqrt(12.0 * residual) / (cells * resolution)
    told = (share >= KNOWN) & np.isfinite(slope + deviation)
    return np.where(told, slope, np.nan), np.where(told, deviation, np.nan)
