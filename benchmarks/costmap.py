# SPDX-License-Identifier: Apache-2.0
"""Cost map: a grid of terrain classes turned into a grid of costs.

Limit: one numpy table lookup over the same cells. Target: at most 3 times that.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from smallwheel_ros.costmap.cost_map import CostMap, CostSettings
from smallwheel_ros.costmap.grid import Grid, Pose
from smallwheel_ros.physics.wheel import Quantity, Wheel

SIDE = 1000
REPEATS = 40
TARGET = 3.0


def in_turn(*works: Callable[[], object]) -> list[list[float]]:
    """Seconds of each call; they take turns, so that a busy machine slows all of them."""
    taken: list[list[float]] = [[] for _ in works]
    for work in works:
        work()
    for _ in range(REPEATS):
        for work, spent in zip(works, taken, strict=True):
            start = time.perf_counter()
            work()
            spent.append(time.perf_counter() - start)
    return taken


def main() -> None:
    rng = np.random.default_rng(1)
    cells = rng.integers(-1, 12, (SIDE, SIDE)).astype(np.int8)
    table = rng.integers(0, 100, 256).astype(np.int8)
    wheels = [Wheel(name, 0.2, 0.1, lateral_position=y) for name, y in (("a", -0.3), ("b", 0.3))]
    plain = CostSettings(spread=0.0, unknown="none")
    empty, crossed = CostMap(plain, wheels), CostMap(plain, wheels)
    wide = CostMap(CostSettings(), wheels)
    for cost_map in (empty, crossed, wide):
        cost_map.take_classes(Grid("odom", 0.05, (-25.0, -25.0), cells))
    # 15 m of a vehicle's swath: what lies over the classes
    for x in np.arange(0.0, 15.0, 0.02):
        for wheel in wheels:
            for cost_map in (crossed, wide):
                pose = Pose(float(x) - 7.5, 0.0, 0.0)
                cost_map.add(wheel, "odom", pose, float(x), Quantity(0.1, 0.01))

    names = (
        "one numpy table lookup (np.take), the limit",
        "classes only",
        "classes, and 15 m of crossed ground laid over them",
        "the same, spread by half the width",
    )
    taken = in_turn(
        lambda: np.take(table, cells.view(np.uint8)), empty.grid, crossed.grid, wide.grid
    )
    limit = float(np.median(taken[0]))
    print(f"class grid of {SIDE} x {SIDE} cells to cost grid, median of {REPEATS} (quartiles)")
    for name, spent in zip(names, taken, strict=True):
        low, median, high = 1e3 * np.percentile(spent, (25, 50, 75))
        print(
            f"{name:<52} {median:6.2f} ms ({low:.2f} .. {high:.2f}) {1e-3 * median / limit:5.2f}x"
        )
    worst = max(float(np.median(spent)) for spent in taken) / limit
    print(f"target: at most {TARGET:g}x: {'met' if worst <= TARGET else 'MISSED'}")


if __name__ == "__main__":
    main()
