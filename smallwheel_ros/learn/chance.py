# SPDX-License-Identifier: Apache-2.0
"""How often errors without a law would gain as much: permutations, the whole search for each.

Under the null hypothesis the runs' errors, whitened, could have come in any order and with either
sign. Whole runs are exchanged, among those with as many values, and have their signs flipped: what
points of one run share stays with them. The one statistic is what the best term of the whole grammar
gains at the base's tangent, less the nats of its description.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.fitting.points import Points
from smallwheel_ros.learn.search import Search
from smallwheel_ros.learn.tangent import Tangent

Array = NDArray[np.float64]


def chance(search: Search, permutations: int, rng: np.random.Generator) -> float:
    """p of the best gain. search: one that has not run, with its base's yardstick."""
    white = search.yardstick.white(search.observed - search.base.predicted)
    copies = np.column_stack([white, _permuted(white, search.fitter.points, permutations, rng)])
    tangent = Tangent(search.yardstick, copies, search.base.slopes)
    best = np.full(permutations + 1, -np.inf)
    for place in search.grid.places:
        terms = search.grid.allowed(place)
        gains, _ = tangent.gains(search.base_slopes[place.name], search.values(terms))
        worth = gains - (search.grid.cost[terms] + place.nats)[:, None]
        best = np.maximum(best, worth.max(axis=0))
    return float(1 + np.sum(best[1:] >= best[0])) / (permutations + 1)


def _permuted(white: Array, points: Points, count: int, rng: np.random.Generator) -> Array:
    """Copies of whitened errors with runs exchanged and signs flipped, shape (values, count)."""
    alike: dict[tuple[int, ...], list[NDArray[np.intp]]] = {}
    for run in np.unique(points.run):
        mine = np.flatnonzero(points.run == run)
        mine = mine[np.lexsort((points.path[mine], points.channel[mine]))]
        alike.setdefault(tuple(points.channel[mine].tolist()), []).append(mine)
    found = np.empty((white.size, count))
    for b in range(count):
        for runs in alike.values():
            order = rng.permutation(len(runs))
            signs = rng.choice([-1.0, 1.0], len(runs))
            for i, mine in enumerate(runs):
                found[mine, b] = signs[i] * white[runs[order[i]]]
    return found
