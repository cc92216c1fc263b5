# SPDX-License-Identifier: Apache-2.0
"""Grids as files of Nav2's map_server: NAME.yaml and NAME.pgm, mode raw: 0 to 100, 255 unknown.

`frame` in the yaml is ours (map_server takes its frame from a parameter): positions there are in it.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import yaml

from smallwheel_ros.common.files import write_bytes
from smallwheel_ros.costmap.grid import HIGHEST, UNKNOWN, Cells, CostMapError, Grid, check_count

_MODE = "raw"
_UNKNOWN = 255
_HEADER = re.compile(rb"P5\s+(?:#[^\n]*\n\s*)*(\d+)\s+(\d+)\s+255\s")


def write_map(path: Path, grid: Grid) -> None:
    """Write a grid into path (.yaml) and an image of that name (.pgm). Raises OutputError."""
    image = path.with_suffix(".pgm")
    height, width = grid.cells.shape
    # The first row of an image is its top.
    pixels = np.where(grid.cells < 0, _UNKNOWN, grid.cells).astype(np.uint8)[::-1]
    write_bytes(image, f"P5\n{width} {height}\n255\n".encode() + pixels.tobytes())
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
    write_bytes(path, yaml.safe_dump(lines, sort_keys=False).encode())


def read_map(path: Path) -> Grid:
    """Read what `write_map` has written.

    Raises CostMapError naming the file, what was found and what was expected.
    """
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
        mode, (x, y, turn) = content["mode"], (float(value) for value in content["origin"])
        if mode != _MODE or turn != 0.0:
            raise ValueError(f"mode {mode}, turned by {turn:g}: expected mode {_MODE}, not turned")
        image = path.with_name(content["image"])
        data = image.read_bytes()
        found = _HEADER.match(data)
        if found is None:
            raise ValueError(f"{image.name} is no binary PGM of 255 grey levels")
        width, height = (int(number) for number in found.groups())
        check_count(width * height)
        pixels = np.frombuffer(data, np.uint8, offset=found.end())
        if pixels.size != width * height:
            raise ValueError(f"{image.name} has {pixels.size} pixels, expected {width} * {height}")
        rows = pixels.reshape(height, width)[::-1].astype(np.int16)
        cells: Cells = np.where(rows <= HIGHEST, rows, UNKNOWN).astype(np.int8)
        return Grid(str(content["frame"]), float(content["resolution"]), (x, y), cells)
    except OSError as error:
        raise CostMapError(f"{path}: no map can be read there: {error.strerror or error}") from None
    except (KeyError, TypeError, ValueError, yaml.YAMLError) as error:
        why = " ".join(f"{type(error).__name__}: {error}".split())
        raise CostMapError(
            f"{path}: not a map of map_server as it is written here ({why})"
        ) from None
