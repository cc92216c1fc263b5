# SPDX-License-Identifier: Apache-2.0
"""A table of measurements in words, as plain values and as a picture."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from smallwheel_ros.display import column_display, number
from smallwheel_ros.measurements.columns import unit_of
from smallwheel_ros.measurements.settings import varied_settings
from smallwheel_ros.measurements.table import Measurements
from smallwheel_ros.physics.soil import nearest
from smallwheel_ros.results import ResultError

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def columns_of(table: Measurements) -> dict[str, Any]:
    """Every column by name, SI units, shape (rows,): settings first, then what was measured."""
    conditions = table.conditions
    names = ("load", "diameter", "width", *conditions.covariates)
    found: dict[str, Any] = {"run": table.run, "wheel": table.wheel}
    if conditions.soil is not None:
        found["soil"] = conditions.soil
    found |= {name: conditions[name] for name in names}
    return found | dict(table.channels)


def table_rows(table: Measurements) -> list[dict[str, Any]]:
    """One mapping for each row; None where nothing was measured."""
    lists = {name: column.tolist() for name, column in columns_of(table).items()}
    return [
        {n: None if v != v else v for n, v in zip(lists, row, strict=True)}
        for row in zip(*lists.values(), strict=True)
    ]


def table_document(table: Measurements) -> dict[str, Any]:
    """What the table is, as plain values in SI units."""
    numbers = {n: c for n, c in columns_of(table).items() if np.asarray(c).dtype.kind == "f"}
    return {
        "schema": 1,
        "source": table.source,
        "sha256": table.sha256,
        "rows": len(table),
        "runs": int(table.runs.size),
        "runs_given": table.runs_given,
        "columns": {
            name: {
                "unit": table.units.get(name, unit_of(name)),
                "from": float(np.nanmin(values)) if np.isfinite(values).any() else None,
                "to": float(np.nanmax(values)) if np.isfinite(values).any() else None,
            }
            for name, values in numbers.items()
        },
        "understood": list(table.understood),
        "warnings": list(table.warnings),
        "notes": list(table.notes),
    }


def table_text(table: Measurements) -> str:
    """What the table is, a line for each column."""
    lines = [table.headline()]
    for name, values in columns_of(table).items():
        if np.asarray(values).dtype.kind != "f" or not np.isfinite(values).any():
            continue
        known = name in ("load", "diameter", "width") or name in table.conditions.covariates
        shown = column_display(table, name) if known else None
        scale, label = (1e3, f"{name} [mm]") if name == "sinkage" else (1.0, f"{name} [N]")
        if shown is not None:
            scale, label = shown.scale, shown.label
        ends = f"{number(scale * np.nanmin(values))} to {number(scale * np.nanmax(values))}"
        lines.append(f"  {label}: {ends}")
    lines += [f"understood: {text}" for text in table.understood]
    lines += [f"warning: {text}" for text in table.warnings]
    return "\n".join([*lines, *(f"note: {text}" for text in table.notes)])


def draw_table(axes: Axes, table: Measurements, channel: str | None, over: str | None) -> None:
    """Draw a channel over a setting. Raises ResultError where there is none of that name."""
    from smallwheel_ros.display import display
    from smallwheel_ros.pictures.house import COLOURS, plain, style

    settings = {"load": table.conditions.load} | dict(varied_settings(table))
    channel, over = channel or next(iter(table.channels)), over or next(iter(settings))
    for name, known in ((channel, table.channels), (over, settings)):
        if name not in known:
            raise ResultError(f"no column '{name}' to draw: {nearest(name, list(known))}")
    across, shown = column_display(table, over), display(channel, unit_of(channel))
    x, y = settings[over] * across.scale, table.channels[channel] * shown.scale
    axes.scatter(x, y, s=12, alpha=0.65, linewidth=0, color=COLOURS[2])
    style(axes, plain(across.label), shown.label)
