# SPDX-License-Identifier: Apache-2.0
"""A grid of square cells on the ground, as in nav_msgs/OccupancyGrid: layering, and files.

Files are those of Nav2's map_server: NAME.yaml and NAME.pgm, mode raw: 0 to 100, 255 unknown.
`frame` in the yaml is our addition (map_server takes its frame from a parameter) and is the frame
of positions.
"""

from __future__ import annotations

import hashlib
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.common.errors import SmallwheelError, reason
from smallwheel_ros.common.files import write_together
from smallwheel_ros.common.plain_yaml import PlainYamlError, read_yaml, write_yaml

Cells = NDArray[np.int8]
Length = TypeVar("Length", float, NDArray[np.float64])

UNKNOWN = -1
HIGHEST = 100
_MOST_CELLS = 100_000_000  # of a map of several drives: 100 MB
# A planner's unit quaternion; a grid that is turned in its frame is not supported here.
_STRAIGHT = np.array([0.0, 0.0, 0.0, 1.0])
_TURNED = 1e-3
# Of map_server's files
_MODE = "raw"
_UNKNOWN_PIXEL = 255
_HEADER = re.compile(rb"P5\s+(?:#[^\n]*\n\s*)*(\d+)\s+(\d+)\s+255\s")


class CostMapError(SmallwheelError):
    """A grid that is malformed, or a setting of the cost map outside its domain."""


class Pose(NamedTuple):
    """Position x, y (m) and heading (rad) of base_link, or of a frame, in another frame."""

    x: float
    y: float
    heading: float

    def place(self, ahead: Length, left: Length) -> tuple[Length, Length]:
        """Convert a point in base_link to the frame of this pose.

        Parameters
        ----------
        ahead, left
            Coordinates of the point in base_link, forward and to the left, m, any shape.

        Returns
        -------
        x, y : ndarray or float
            Coordinates of the point in the frame of this pose, m, same shape.
        """
        cosine, sine = math.cos(self.heading), math.sin(self.heading)
        return self.x + cosine * ahead - sine * left, self.y + sine * ahead + cosine * left

    def inverse(self) -> Pose:
        """The inverse transform: the parent frame as seen from this pose."""
        x, y = Pose(0.0, 0.0, -self.heading).place(-self.x, -self.y)
        return Pose(x, y, -self.heading)


HERE = Pose(0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Grid:
    """Square cells along the axes of a frame, with costs or numbers of terrain classes.

    Attributes
    ----------
    frame
        Name of the frame.
    resolution
        Side of a cell, m.
    origin
        x and y of the corner of cell [0, 0] with the smallest x and y, m.
    cells
        Value of each cell, int8, shape (rows along y, columns along x); below 0 is unknown.

    Raises
    ------
    CostMapError
        If the frame is empty, a number is not finite, the resolution is not above 0, or the cells are not
        int8 of such a shape.
    """

    frame: str
    resolution: float
    origin: tuple[float, float]
    cells: Cells

    def __post_init__(self) -> None:
        """Check frame, numbers and shape, as planners do."""
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
        """Frame, resolution, origin and shape of the cells: equal for grids whose cells coincide."""
        return self.frame, self.resolution, self.origin, self.cells.shape

    def cell(self, x: float, y: float) -> tuple[int, int] | None:
        """Find the row and column of the cell at a place.

        Parameters
        ----------
        x, y
            The place, m.

        Returns
        -------
        (int, int) or None
            None if the place is outside of the grid.
        """
        row = math.floor((y - self.origin[1]) / self.resolution)
        column = math.floor((x - self.origin[0]) / self.resolution)
        rows, columns = self.cells.shape
        return (row, column) if 0 <= row < rows and 0 <= column < columns else None

    def around(self, x: float, y: float, reach: float) -> tuple[slice, slice]:
        """Return slices of the rows and columns that contain all cells within reach of a place.

        Parameters
        ----------
        x, y
            The place, m.
        reach
            Distance along each axis, m.

        Returns
        -------
        rows, columns : slice
            They select no cell if none is within reach.
        """
        rows, columns = (
            slice(
                max(math.floor((at - reach - start) / self.resolution), 0),
                max(math.ceil((at + reach - start) / self.resolution), 0),
            )
            for at, start in zip((y, x), self.origin[::-1], strict=True)
        )
        return rows, columns


def grid_from(message: Any) -> Grid:
    """Make a grid from a nav_msgs/OccupancyGrid, as received by rclpy or read from a bag.

    Raises CostMapError that names what is wrong, what was found and what was expected.
    """
    info, data = message.info, np.array(message.data, dtype=np.int8)
    place = info.origin.position
    if data.size != info.width * info.height:
        raise CostMapError(
            f"the grid has {data.size} cells, expected width * height = {info.width} * {info.height}"
        )
    check_straight(info.origin.orientation, "the grid")
    cells = data.reshape(info.height, info.width)
    return Grid(message.header.frame_id, float(info.resolution), (place.x, place.y), cells)


def check_straight(turn: Any, what: str) -> None:
    """Check that a grid is not rotated in its frame.

    Parameters
    ----------
    turn
        Quaternion of the grid's origin, a message with x, y, z and w.
    what
        Name of the grid, for the error's message.

    Raises
    ------
    CostMapError
        If it is rotated.
    """
    facing = (turn.x, turn.y, turn.z, turn.w)
    off = min(np.abs(facing - _STRAIGHT).max(), np.abs(facing + _STRAIGHT).max())
    if not off <= _TURNED:
        raise CostMapError(
            f"{what} is turned in its frame (quaternion {facing}), expected 0, 0, 0, 1: planners take no"
            " turned grid either"
        )


# --- Grids on top of each other


def lay_over(costs: Grid, above: Grid, pose: Pose = HERE) -> None:
    """Write the known cells of a grid into another one.

    If several fall into one cell, the highest counts. Cells that are not smaller than those of the lower
    grid, and not rotated, are written to each cell whose middle they cover.

    Parameters
    ----------
    costs
        The lower grid, which is changed in place.
    above
        The upper grid.
    pose
        Pose of the upper grid's frame in the frame of the lower one.
    """
    above = _known_part(above)
    if pose.heading == 0.0 and above.resolution >= costs.resolution:
        _lay_coarser(costs, above, pose)
        return
    # The highest last: of several that are written to one cell, the last one stays.
    known = np.flatnonzero(above.cells >= 0)
    known = known[np.argsort(above.cells.ravel()[known], kind="stable")]
    rows, columns = np.divmod(known, above.cells.shape[1])
    # A cell that is coarser, or rotated, covers several: it is divided into parts.
    scale = above.resolution / costs.resolution * (1.0 if pose.heading == 0.0 else math.sqrt(2.0))
    count = math.ceil(scale - 1e-9)
    parts = (np.arange(count) + 0.5) / count
    along = above.origin[0] + above.resolution * (columns[:, None, None] + parts)
    across = above.origin[1] + above.resolution * (rows[:, None, None] + parts[:, None])
    x, y = pose.place(along, across)
    at_row = np.floor((y - costs.origin[1]) / costs.resolution).astype(np.int64)
    at_column = np.floor((x - costs.origin[0]) / costs.resolution).astype(np.int64)
    inside = (at_row >= 0) & (at_row < costs.cells.shape[0])
    inside &= (at_column >= 0) & (at_column < costs.cells.shape[1])
    cost = np.broadcast_to(above.cells[rows, columns][:, None, None], at_row.shape)
    costs.cells[at_row[inside], at_column[inside]] = cost[inside]


def ends(some: NDArray[np.bool_]) -> tuple[slice, slice]:
    """Return slices of the rows and columns from the first to the last marked cell.

    Parameters
    ----------
    some
        Mask of the marked cells, shape (rows, columns).

    Returns
    -------
    rows, columns : slice
        Both are slice(0, 0) if no cell is marked.
    """
    at = (np.flatnonzero(some.any(axis=axis)) for axis in (1, 0))
    rows, columns = (slice(int(e[0]), int(e[-1]) + 1) if e.size else slice(0, 0) for e in at)
    return rows, columns


def _known_part(grid: Grid) -> Grid:
    """Return the part of a grid that has something known, at least one cell."""
    rows, columns = ends(grid.cells >= 0)
    if rows.start == rows.stop:
        rows = columns = slice(0, 1)
    x, y = (
        start + part.start * grid.resolution
        for start, part in zip(grid.origin, (columns, rows), strict=True)
    )
    return replace(grid, origin=(x, y), cells=grid.cells[rows, columns])


def _lay_coarser(costs: Grid, above: Grid, pose: Pose) -> None:
    """Write cells that are not smaller, along the same axes: a lower cell takes the one over its middle."""
    first, inside, found = [], [], []
    for axis, shift in ((0, pose.y), (1, pose.x)):
        start = above.origin[1 - axis] + shift - costs.origin[1 - axis]
        sides, count = costs.resolution, costs.cells.shape[axis]
        low = max(math.floor(start / sides), 0)
        high = min(math.ceil((start + above.cells.shape[axis] * above.resolution) / sides), count)
        middles = sides * (np.arange(low, max(high, low)) + 0.5) - start
        index = np.floor(middles / above.resolution + 1e-9).astype(np.int64)
        known = (index >= 0) & (index < above.cells.shape[axis])
        first.append(low + int(np.argmax(known)) if known.any() else 0)
        inside.append(int(known.sum()))
        found.append(index[known])
    part = costs.cells[first[0] : first[0] + inside[0], first[1] : first[1] + inside[1]]
    # Columns first, of the fewer rows; whole rows are copied fast.
    upper = above.cells.take(found[1], axis=1).take(found[0], axis=0)
    np.copyto(part, upper, where=upper >= 0)


def union(frame: str, layers: Sequence[tuple[Grid, Pose]]) -> Grid:
    """Lay grids over each other, the last on top.

    Parameters
    ----------
    frame
        Name of the frame of the result.
    layers
        Grids, each with the pose of its frame in `frame`; at least one.

    Returns
    -------
    Grid
        New cells of the finest of the resolutions, over the extent of all grids.

    Raises
    ------
    CostMapError
        If there were more than 100 million cells.
    """
    side = min(grid.resolution for grid, _ in layers)
    corners = np.array(
        [
            pose.place(grid.origin[0] + across, grid.origin[1] + along)
            for grid, pose in layers
            for across in (0.0, grid.cells.shape[1] * grid.resolution)
            for along in (0.0, grid.cells.shape[0] * grid.resolution)
        ]
    )
    low = np.floor(corners.min(axis=0) / side + 1e-6)
    columns, rows = (np.ceil(corners.max(axis=0) / side - 1e-6) - low).astype(int)
    _check_count(rows * columns)
    cells: Cells = np.full((rows, columns), UNKNOWN, dtype=np.int8)
    whole = Grid(frame, side, (float(low[0]) * side, float(low[1]) * side), cells)
    for grid, pose in layers:
        lay_over(whole, grid, pose)
    return whole


def _check_count(cells: int) -> None:
    """Raise CostMapError for more cells than a map may have."""
    if cells > _MOST_CELLS:
        raise CostMapError(
            f"the map would have {cells} cells, expected at most {_MOST_CELLS}: a larger"
            " cost.resolution, or drives of one site only"
        )


# --- Files


def write_map(path: Path, grid: Grid) -> None:
    """Write a grid as a map for Nav2's map_server.

    Parameters
    ----------
    path
        File ending in .yaml; the image, ending in .pgm, is written next to it.
    grid
        The grid.

    Raises
    ------
    OutputError
        If a file cannot be written.
    """
    write_together(map_files(path, grid))


def map_files(path: Path, grid: Grid) -> dict[Path, bytes]:
    """Make the contents of the two files of a map.

    Parameters
    ----------
    path
        File ending in .yaml.
    grid
        The grid.

    Returns
    -------
    dict of bytes
        By path: `path`, and the image ending in .pgm next to it.
    """
    image = path.with_suffix(".pgm")
    height, width = grid.cells.shape
    # The first row of an image is its top.
    pixels = np.where(grid.cells < 0, _UNKNOWN_PIXEL, grid.cells).astype(np.uint8)[::-1]
    lines = {
        "image": image.name,
        "mode": _MODE,
        "resolution": float(grid.resolution),
        "origin": [float(grid.origin[0]), float(grid.origin[1]), 0.0],
        "negate": 0,
        "occupied_thresh": 0.65,
        "free_thresh": 0.25,
        "frame": grid.frame,
    }
    return {
        image: f"P5\n{width} {height}\n255\n".encode() + pixels.tobytes(),
        path: write_yaml(lines).encode(),
    }


def digest_of(grid: Grid) -> str:
    """SHA-256 (hexadecimal) of a grid, the same after the grid was written and read again."""
    place = grid.frame, float(grid.resolution), *map(float, grid.origin[:2]), *grid.cells.shape
    return hashlib.sha256(f"{place}".encode() + grid.cells.astype(np.int8).tobytes()).hexdigest()


def read_map(path: Path) -> Grid:
    """Read a map that `write_map` has written; `path` is the file ending in .yaml.

    Raises CostMapError that names the file, the mistake and what was expected.
    """
    try:
        content = read_yaml(path)
        mode, (x, y, turn) = content["mode"], (float(value) for value in content["origin"])
        if mode != _MODE or turn != 0.0:
            raise ValueError(f"mode {mode}, turned by {turn:g}: expected mode {_MODE}, not turned")
        image = path.with_name(content["image"])
        data = image.read_bytes()
        found = _HEADER.match(data)
        if found is None:
            raise ValueError(f"{image.name} is no binary PGM of 255 grey levels")
        width, height = (int(number) for number in found.groups())
        _check_count(width * height)
        pixels = np.frombuffer(data, np.uint8, offset=found.end())
        if pixels.size != width * height:
            raise ValueError(f"{image.name} has {pixels.size} pixels, expected {width} * {height}")
        rows = pixels.reshape(height, width)[::-1].astype(np.int16)
        cells: Cells = np.where(rows <= HIGHEST, rows, UNKNOWN).astype(np.int8)
        return Grid(str(content["frame"]), float(content["resolution"]), (x, y), cells)
    except (OSError, PlainYamlError) as error:
        raise CostMapError(f"{path}: no map can be read there: {reason(error)}") from None
    except (KeyError, TypeError, ValueError) as error:
        why = " ".join(f"{type(error).__name__}: {error}".split())
        raise CostMapError(
            f"{path}: not a map of map_server as it is written here ({why})"
        ) from None
