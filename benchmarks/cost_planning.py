# SPDX-License-Identifier: Apache-2.0
"""What cost is worth: how often vehicles are stuck where the map says so, and on paths planned over it.

    python benchmarks/cost_planning.py --drives 300 --fields 300

Drives: one place of each drive over ground with a long slippery patch (`traction_worlds`), drawn at
random; its cost as the estimator states it with the balance of the vehicle, and whether the vehicle could
not pull itself along there at the reference slip. One place a drive, so that they are independent.

Fields: kinds of soil in blobs, each known as well as a few crossings make it known; paths across by
Dijkstra's algorithm over the cost, over the cost of what is expected (no deviation), and straight on.
"""

from __future__ import annotations

import argparse
import sys
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra
from scipy.stats import binomtest

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.traction_rates import run
from benchmarks.traction_worlds import WORLDS, make_drive
from smallwheel_ros.costmap.cost_map import CLASS_SCATTER, CostRules

Array = NDArray[np.float64]

_DISTANCE, _SETTLE = 7.0, 2.0  # m
_SIDE, _KINDS, _BLOBS = 24, 6, 40  # cells of a field, kinds of soil, blobs
_WEIGHT = 0.2  # of a per cent of cost, in cells of a way round


def place_of_a_drive(seed: int) -> tuple[float, bool]:
    """Stated cost, and whether the vehicle could not get on, at one place of a drive."""
    name = "patch" if seed % 2 else "patch, equal"
    drive = make_drive(replace(WORLDS[name], distance=_DISTANCE), seed)
    _, found = run(drive, "balance", _SETTLE)
    if not found.margin:
        return np.nan, False
    i = int(np.random.default_rng([seed, 3]).integers(len(found.margin)))
    cost = CostRules().cost(found.margin[i], found.margin_deviation[i])
    return float(cost), found.true_margin[i] < 0.0


def table_of_fifths(cost: Array, stuck: NDArray[np.bool_]) -> None:
    """Print stated and actual rates with their binomial 95 % intervals (Clopper and Pearson)."""
    for low in range(0, 100, 20):
        inside = (cost >= low) & (cost < low + 20 + (low == 80))
        if not inside.any():
            print(f"cost {low} to {low + 19}: no place")
            continue
        interval = binomtest(int(stuck[inside].sum()), int(inside.sum())).proportion_ci(0.95)
        stated = cost[inside].mean() / 100.0
        verdict = "inside" if interval.low <= stated <= interval.high else "OUTSIDE"
        print(
            f"cost {low} to {low + 19}: stated {stated:.2f}, stuck {stuck[inside].sum()} of"
            f" {inside.sum()}, 95 % interval {interval.low:.2f} to {interval.high:.2f}: {verdict}"
        )


def paths_over_a_field(seed: int) -> dict[str, tuple[bool, float]]:
    """Whether each way of planning gets stuck, and the length of its path (cells)."""
    rng = np.random.default_rng([seed, 77])
    true_mean = rng.normal(0.12, 0.12, _KINDS)
    deviation = rng.choice([0.02, 0.07, 0.15], _KINDS)
    believed = true_mean + deviation * rng.standard_normal(_KINDS)
    centres = rng.uniform(0, _SIDE, (_BLOBS, 2))
    kind = rng.integers(_KINDS, size=_BLOBS)
    margin = true_mean[kind] + CLASS_SCATTER * rng.standard_normal(_BLOBS)
    cells = np.stack(np.meshgrid(range(_SIDE), range(_SIDE), indexing="ij"), -1).reshape(-1, 2)
    blob = np.argmin(((cells[:, None] - centres) ** 2).sum(-1), axis=1)
    rules = CostRules()
    spread = np.hypot(deviation, CLASS_SCATTER)
    maps = {
        "cost": rules.cost(believed, spread)[kind[blob]],
        "cost of what is expected": rules.cost(believed, np.full(_KINDS, 1e-6))[kind[blob]],
        "straight": np.zeros(len(cells)),
    }
    start = int(np.flatnonzero((cells == (_SIDE // 2, 0)).all(axis=1))[0])
    goal = int(np.flatnonzero((cells == (_SIDE // 2, _SIDE - 1)).all(axis=1))[0])
    # Where it starts and where it has to go is no choice.
    free = (blob != blob[start]) & (blob != blob[goal])
    found = {}
    for name, cost in maps.items():
        path = _path(np.asarray(cost, dtype=np.float64), cells, start, goal)
        found[name] = (bool(((margin[blob] < 0.0) & free)[path].any()), float(len(path)))
    return found


def _path(cost: Array, cells: NDArray[np.intp], start: int, goal: int) -> list[int]:
    rows, columns, weights = [], [], []
    for step in ((1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (1, -1), (-1, 1), (-1, -1)):
        there = cells + step
        inside = ((there >= 0) & (there < _SIDE)).all(axis=1)
        to = there[inside] @ (_SIDE, 1)
        rows.append(np.flatnonzero(inside))
        columns.append(to)
        weights.append(np.hypot(*step) * (1.0 + _WEIGHT * cost[to]))
    edges = (np.concatenate(weights), (np.concatenate(rows), np.concatenate(columns)))
    graph = csr_matrix(edges, shape=(len(cells), len(cells)))
    _, before = dijkstra(graph, indices=start, return_predecessors=True)
    path = [goal]
    while path[-1] != start:
        path.append(int(before[path[-1]]))
    return path


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--drives", type=int, default=300)
    parser.add_argument("--fields", type=int, default=300)
    parser.add_argument("--first", type=int, default=1000)
    parser.add_argument("--processes", type=int, default=1)
    given = parser.parse_args()
    seeds = range(given.first, given.first + given.fields)
    found = [paths_over_a_field(seed) for seed in seeds]
    for name in found[0] if found else ():
        stuck = sum(one[name][0] for one in found)
        length = np.mean([one[name][1] for one in found])
        print(f"{name}: stuck on {stuck} of {len(found)} fields, {length:.1f} cells a path")
    jobs = range(given.first, given.first + given.drives)
    with ProcessPoolExecutor(given.processes) as pool:
        places = [p for p in pool.map(place_of_a_drive, jobs) if np.isfinite(p[0])]
    if places:
        cost, stuck_at = (np.array(column) for column in zip(*places, strict=True))
        table_of_fifths(cost, stuck_at.astype(bool))


if __name__ == "__main__":
    main()
