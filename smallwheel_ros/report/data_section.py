# SPDX-License-Identifier: Apache-2.0
"""What a report says of the data itself."""

from __future__ import annotations

import numpy as np

from smallwheel_ros.compare.comparison import Comparison
from smallwheel_ros.measurements.columns import CHANNEL_UNITS
from smallwheel_ros.measurements.display import brief, column_display, display, number, sentence
from smallwheel_ros.measurements.settings import setting_columns, varies
from smallwheel_ros.report.page import Block, Callout, Details, Table, Text


def data_blocks(comparison: Comparison) -> list[Block]:
    """What was measured, over which ranges, how well it repeats, and what is odd about it."""
    data = comparison.measurements
    runs = (
        f"{data.runs.size} runs" if data.runs_given else f"no runs named, {data.runs.size} settings"
    )
    lines = f"{len(data)} rows, {runs}."
    rows = [
        [column_display(data, name).label, *_range(comparison, name),
         "varied" if varies(values) else "one value"]
        for name, values in setting_columns(data).items()
    ]  # fmt: skip
    known = any(floor.value is not None for floor in comparison.noise.values())
    expected = ["expected of a true model", "known from"] if known else []
    blocks: list[Block] = [
        Text(lines),
        Table(["condition", "from", "to", ""], rows, "Conditions", numbers=(1, 2)),
        Table(
            ["channel", "rows", "from", "to", "repeats differ by", *expected],
            [_channel_row(comparison, name, bool(expected)) for name in comparison.noise],
            "Measured channels",
            numbers=range(1, 6),
        ),
    ]
    odd = [f"{lines.size} rows left out: {why} (first in line {lines[0]})."
           for why, lines in comparison.left_out]  # fmt: skip
    odd += data.warnings
    if odd:
        blocks.append(Callout("Worth a second look", [sentence(o) for o in odd], "warning"))
    notes = [sentence(note) for note in (*data.notes, *comparison.notes)]
    if notes:
        blocks.append(Details("What was assumed", [Text(items=notes)]))
    return blocks


def _range(comparison: Comparison, name: str) -> list[str]:
    data = comparison.measurements
    scale = column_display(data, name).scale
    values = data.conditions[name]
    known = values[np.isfinite(values)]
    if known.size == 0:
        return ["-", "-"]
    return [brief(scale * known.min()), brief(scale * known.max())]


def _channel_row(comparison: Comparison, name: str, expected: bool) -> list[str]:
    shown = display(name, CHANNEL_UNITS[name])
    values = comparison.measurements.channels[name]
    known = values[np.isfinite(values)]
    floor = comparison.noise[name]
    found = [known.min(), known.max(), floor.repeatability, floor.value]
    low, high, repeats, value = (number(None if v is None else v * shown.scale) for v in found)
    source = {"repeats": "repeated rows", "declared": "the table's own figures", None: "unknown"}
    of_truth = [value, f"{source[floor.source]}: {floor.reason}"] if expected else []
    return [shown.label, str(known.size), low, high, repeats, *of_truth]
