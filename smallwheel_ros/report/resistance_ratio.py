# SPDX-License-Identifier: Apache-2.0
"""The plot of resistance over load against sqrt(sinkage / diameter)."""

from __future__ import annotations

from typing import Any

import numpy as np

from smallwheel_ros.compare.resistance_ratio import resistance_ratio
from smallwheel_ros.measurements.table import Measurements
from smallwheel_ros.report.page import Block, Drawing

_CAPTION = (
    "A check free of k and m: compaction alone puts every point on the line of its n. Points above the "
    "lines are a resistance that compaction does not make, or a wheel that digs itself deeper than its "
    "load presses it."
)
_DASHES: tuple[list[int], ...] = ([], [6, 4], [2, 3])
_MOST = 1000  # points


def ratio_blocks(measurements: Measurements) -> list[Block]:
    """The plot, where sinkage and resistance were measured together."""
    found = resistance_ratio(measurements)
    if found is None:
        return []
    layers: list[dict[str, Any]] = [
        {"kind": "line", "name": f"compaction alone, n = {n:g}", "dash": dash, "colour": "--base",
         "x": found.line_x.tolist(), "y": y.tolist()}
        for (n, y), dash in zip(found.lines.items(), _DASHES, strict=True)
    ]  # fmt: skip
    shown = np.arange(found.rows.size)
    if shown.size > _MOST:
        shown = np.sort(np.random.default_rng(0).choice(shown, _MOST, replace=False))
    for i, soil in enumerate(np.unique(found.soil)):
        at = shown[found.soil[shown] == soil]
        lines = measurements.line[found.rows[at]]
        runs = measurements.run[found.rows[at]]
        layers.append(
            {
                "kind": "points",
                "name": str(soil) or "measured",
                "colour": f"--w{i % 8}",
                "x": found.x[at].tolist(),
                "y": found.y[at].tolist(),
                "names": [f"run {r}, line {n}" for r, n in zip(runs, lines, strict=True)],
            }
        )
    data = {
        "x": "√(sinkage / diameter)",
        "y": "resistance / load",
        "label": "resistance over load against the root of sinkage over diameter",
        "height": 320,
        "layers": layers,
    }
    return [Drawing("xy", data, _CAPTION)]
