# SPDX-License-Identifier: Apache-2.0
"""What a planner is told after a drive: the cost grid of the node, made without ROS.

    .venv/bin/python examples/cost_map.py [BAG --config ROVER.yaml] [-o out/cost_map.png]

With a bag: its drive through the node's own code, and the cost of the ground that was crossed; if it
has grids of terrain classes (topic terrain_classes), the cost of their cells too. Without a bag: a
simulated drive over firm sand into a patch so soft that the wheels hardly get through, in a field
where a classifier has told the two apart.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

import numpy as np

from smallwheel_ros.bags import BagReader
from smallwheel_ros.common.errors import SmallwheelError
from smallwheel_ros.costmap.cost_map import CostMap
from smallwheel_ros.costmap.cost_picture import draw_cost
from smallwheel_ros.costmap.grid import Grid, grid_from
from smallwheel_ros.drive.ground_map import GroundMapper, cost_map_of
from smallwheel_ros.onboard.parameters import read_parameters, settings_from
from smallwheel_ros.replay.recording import turns_of
from smallwheel_ros.ros import config_file
from smallwheel_ros.simulate import DriveSettings, simulate_drive, write_drive_bag
from smallwheel_ros.simulate.settings import Stretch
from smallwheel_ros.simulate.truth import soil_of_pressure

CLASSES = "terrain_classes"
FIRM, SOFT = 0, 1
BORDERS = (8.0, 12.0)  # m along the way: where the soft patch of the simulated field is


def cost_map(bag: Path, config: Path, classes: Grid | None = None) -> tuple[CostMap, np.ndarray]:
    """Return the cost map after a bag, and the places of the robot, shape (places, 2)."""
    settings = settings_from(read_parameters(config))
    wheels = settings.onboard.wheels
    mapper = GroundMapper(cost_map_of(settings), wheels)
    if classes is not None:
        mapper.map.take_classes(classes)
    way: list[tuple[float, float]] = []
    frame = ""
    with BagReader(bag) as reader:
        for name, kind, _, message in reader.messages({f"/{CLASSES}", "/odom"}):
            if name == f"/{CLASSES}":
                mapper.map.take_classes(grid_from(message))
            elif kind == "nav_msgs/msg/Odometry":
                frame = message.header.frame_id
                way.append((message.pose.pose.position.x, message.pose.pose.position.y))
    for turn in turns_of(bag, settings, clock=False):
        mapper.add(turn.estimates, frame)
    return mapper.map, np.array(way)


def simulated(folder: Path) -> tuple[Path, Grid]:
    """Write a bag of a drive over firm and soft sand, and draw the classifier's grid of the field."""
    firm = soil_of_pressure("firm", 36e3, 0.75, 0.3, friction_angle=0.60, cohesion=1200.0)
    soft = soil_of_pressure("soft", 1.5e3, 0.95, 0.3, friction_angle=0.40, cohesion=300.0)
    stretches = tuple(
        Stretch(start, kind)
        for start, kind in zip((0.0, *BORDERS), (firm, soft, firm), strict=True)
    )
    drive = simulate_drive(DriveSettings(seed=4, distance=16.0, stretches=stretches))
    bag = folder / "drive"
    write_drive_bag(drive, bag)
    x, y = np.meshgrid(np.arange(-1.9, 30.0, 0.2), np.arange(-3.9, 8.0, 0.2))
    start, end = np.interp(BORDERS, drive.truth.path, drive.truth.course[0])
    patches = (start < x) & (x < end)
    patches |= np.hypot(x - 21.0, y - 2.5) < 2.5
    patches |= np.hypot(x - 25.5, y + 3.0) < 2.0
    cells = np.where(patches, SOFT, FIRM).astype(np.int8)
    cells[y > 7.5] = -1  # the camera did not see that far
    return bag, Grid("odom", 0.2, (-2.0, -4.0), cells)


def main() -> int:
    """Draw the picture; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("bag", nargs="?", type=Path, help="a recorded drive")
    parser.add_argument("--config", type=Path, help="the node's parameter file for that drive")
    parser.add_argument("-o", "--output", type=Path, default=Path("out") / "cost_map.png")
    options = parser.parse_args()
    try:
        with tempfile.TemporaryDirectory() as folder:
            bag, classes = options.bag, None
            if bag is None:
                bag, classes = simulated(Path(folder))
            config = options.config or config_file("four_wheels.yaml")
            found, way = cost_map(bag, config, classes)
        grids = found.grids()
        if grids is None:
            print("no cost map: the bag has no poses", file=sys.stderr)
            return 1
        grid = grids.spread
        options.output.parent.mkdir(parents=True, exist_ok=True)
        draw_cost(grid, options.output, way=way, title="Cost of the ground, as Nav2 gets it")
    except SmallwheelError as error:
        print(f"cost_map: {error}", file=sys.stderr)
        return 2
    known = grid.cells[grid.cells >= 0]
    print(
        f"{known.size} of {grid.cells.size} cells are known, costs {known.min()} to {known.max()}"
    )
    classes = found.ahead.classes
    places, table = classes.places(), classes.table()
    for terrain, margin in classes.margins().items():
        print(
            f"class {terrain}: {places[terrain]} places, margin {margin.value:.3f} +-"
            f" {margin.standard_deviation:.3f}, cost {table[terrain]}"
        )
    print(options.output)
    return 0


if __name__ == "__main__":
    sys.exit(main())
