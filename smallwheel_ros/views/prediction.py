# SPDX-License-Identifier: Apache-2.0
"""Predictions as a table and as plots: a quantity over one setting, a curve for each value of the others."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from smallwheel_ros.common.errors import nearest
from smallwheel_ros.common.tables import text_table
from smallwheel_ros.measurements.columns import unit_of
from smallwheel_ros.prediction.prediction import (
    SHOWN,
    SUNK,
    UNITS,
    PredictionError,
    PredictionTable,
    cell,
)
from smallwheel_ros.views.plots import CYCLE, Layer, Panel
from smallwheel_ros.views.plots import draw as draw_panel

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_PANELS = ("sinkage", "resistance", "drawbar_pull")
_MOST_CURVES = 8
_MOST_ROWS = 200
_DEVIATIONS = "+- is the standard deviation of the law, in brackets that of one row of one new run"
_DASHES = ("-", "--", "-.", ":")  # curves may lie on each other


def text(table: PredictionTable) -> str:
    """The table as the command prints it, with notes on what the numbers rest on."""
    rows = table.rows()
    shown = [q for q in SHOWN if q in rows[0]]
    units = {name: unit_of(name) for name in table.settings}
    named = [f"{name} [{u}]" if u not in ("", "1") else name for name, u in units.items()]
    header = [*table.names, *named, *(SHOWN[q][0] for q in shown), "status"]
    body = [
        [
            *(row[name] for name in table.names),
            *("-" if row[name] is None else f"{row[name]:g}" for name in table.settings),
            *(cell(row, q) for q in shown),
            "sunk to the axle" if row["status"] == SUNK else "ok",
        ]
        for row in rows[:_MOST_ROWS]
    ]
    notes = [f"note: {note}" for note in table.notes]
    if table.result.run_deviation:
        notes.insert(0, _DEVIATIONS)
    if len(rows) > _MOST_ROWS:
        notes.insert(0, f"and {len(rows) - _MOST_ROWS} more rows: -o writes all of them")
    return "\n\n".join([text_table(header, body), *notes])


def panels(table: PredictionTable) -> list[Panel]:
    """Plots of sinkage, resistance and, if there is slip, drawbar pull."""
    known = [q for q in _PANELS if getattr(table.result.prediction, q) is not None]
    return [_panel(table, quantity) for quantity in known]


def draw(axes: Axes, table: PredictionTable, quantity: str = "sinkage") -> None:
    """Draw one predicted quantity over the setting with most values, a curve for each value of the others.

    Parameters
    ----------
    axes
        Axes to draw on.
    table
        The predictions.
    quantity
        Name of the quantity, such as `sinkage` or `drawbar_pull`.

    Raises
    ------
    PredictionError
        If it was not predicted.
    """
    if getattr(table.result.prediction, quantity, None) is None:
        known = [q for q in SHOWN if getattr(table.result.prediction, q) is not None]
        raise PredictionError(f"no '{quantity}' was predicted: {nearest(quantity, known)}")
    draw_panel(axes, _panel(table, quantity))


def _panel(table: PredictionTable, quantity: str) -> Panel:
    """Bands are one standard deviation. A wheel sunk to its axle is left out."""
    title, factor = SHOWN[quantity]
    sizes = {name: np.unique(values).size for name, values in table.settings.items()}
    along = max(sizes, key=lambda name: sizes[name])
    others = [name for name in table.varied if name != along]
    prediction, std = table.result.prediction, table.result.standard_deviation.get(quantity)
    rows = len(table.settings[along])
    keys = np.stack([table.settings[n] for n in others]) if others else np.zeros((1, rows))
    curves, layers = np.unique(keys, axis=1).T, []
    for i, curve in enumerate(curves[:_MOST_CURVES]):
        at = np.all(keys == curve[:, None], axis=0) & ~prediction.immobilised
        name = ", ".join(f"{n} {v:g}" for n, v in zip(others, curve, strict=False))
        x, y = table.settings[along][at], factor * getattr(prediction, quantity)[at]
        half = None if std is None else factor * std[at]
        low, high = (None, None) if half is None else (y - half, y + half)
        layers.append(Layer("points" if x.size == 1 else "line", x, y, low, high, CYCLE[i % len(CYCLE)],
                            name, dash=_DASHES[i % len(_DASHES)]))  # fmt: skip
    unit = UNITS.get(along, "1")
    across = along.replace("_", " ") + (f" [{unit}]" if unit != "1" else "")
    more = f"the first {_MOST_CURVES} of {len(curves)} curves" if len(curves) > _MOST_CURVES else ""
    return Panel(across, title, more, layers)
