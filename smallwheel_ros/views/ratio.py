# SPDX-License-Identifier: Apache-2.0
"""Resistance over load against sinkage over diameter: a check that is free of k and m."""

from __future__ import annotations

import numpy as np

from smallwheel_ros.compare.resistance_ratio import resistance_ratio
from smallwheel_ros.measurements.measurements import Measurements
from smallwheel_ros.views.blocks import Block, Figure
from smallwheel_ros.views.leftovers import thinned
from smallwheel_ros.views.plots import CYCLE, Layer, Panel

_DASHES = ("-", "--", ":")
_CAPTION = (
    "A check free of k and m: compaction alone puts every point on the line of its n. Points above the lines "
    "are a resistance that compaction does not cause, or a wheel that digs itself deeper than its load "
    "presses it."
)


def ratio_blocks(data: Measurements) -> list[Block]:
    """R/W over sqrt(z/D), where sinkage and resistance were measured together."""
    found = resistance_ratio(data)
    if found is None:
        return []
    layers = [
        Layer(
            "line", found.line_x, y, colour="base", dash=dash, name=f"compaction alone, n = {n:g}"
        )
        for (n, y), dash in zip(found.lines.items(), _DASHES, strict=True)
    ]
    shown = thinned(np.arange(found.rows.size))
    for i, soil in enumerate(np.unique(found.soil)):
        at = shown[found.soil[shown] == soil]
        layers.append(Layer("points", found.x[at], found.y[at], colour=CYCLE[i % len(CYCLE)],
                            name=str(soil) or "measured"))  # fmt: skip
    panel = Panel("√(sinkage / diameter)", "resistance / load", "", layers)
    return [Figure("resistance_ratio", [panel], _CAPTION)]
