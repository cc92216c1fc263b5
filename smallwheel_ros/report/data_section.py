"""What a report says of the data itself."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from smallwheel_ros.compare.comparison import Comparison
from smallwheel_ros.compare.scores import UNITS, drivers
from smallwheel_ros.display import brief, column_display, display, number, sentence
from smallwheel_ros.report.page import Block, Callout, Details, Table, Text


def data_blocks(
    comparison: Comparison, repeatability: Mapping[str, float] | None = None
) -> list[Block]:
    """What was measured, over which ranges, how well it repeats, and what is odd about it.

    repeatability: what repeats of one run differ by, by channel in SI, where the comparison's noise
    floor is more than that.
    """
    repeats = repeatability or {}
    apart = ["repeats differ by"] if repeats else []
    data = comparison.measurements
    left_out = sum(lines.size for _, lines in comparison.left_out)
    runs = f"{data.runs.size} runs" if data.runs_given else "no runs named: each row is its own"
    lines = f"{len(data) + left_out} rows, {runs}."
    rows = [
        [column_display(data, name).label, *_range(comparison, name), "varied"]
        for name in drivers(data)
    ]
    fixed = [name for name in ("load", "diameter", "width", *data.conditions.covariates)
             if name not in drivers(data)]  # fmt: skip
    rows += [[column_display(data, name).label, *_range(comparison, name), "one value"]
             for name in fixed]  # fmt: skip
    blocks: list[Block] = [
        Text(lines),
        Table(["condition", "from", "to", ""], rows, "Conditions", numbers=(1, 2)),
        Table(
            ["channel", "rows", "from", "to", *apart, "noise floor", "known from"],
            [_channel_row(comparison, name, repeats) for name in data.channels],
            "Measured channels",
            numbers=range(1, 5 + len(apart)),
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


def _channel_row(comparison: Comparison, name: str, repeats: Mapping[str, float]) -> list[str]:
    shown = display(name, UNITS[name])
    values = comparison.measurements.channels[name]
    known = values[np.isfinite(values)]
    floor = comparison.noise[name]
    level = None if floor.value is None else floor.value * shown.scale
    ends = (
        [number(v * shown.scale) for v in (known.min(), known.max())] if known.size else ["-"] * 2
    )
    source = {"repeats": "repeated rows", "declared": "the table's own figures", None: "unknown"}
    spread = repeats.get(name)
    apart = [number(None if spread is None else spread * shown.scale)] if repeats else []
    return [shown.label, str(known.size), *ends, *apart, number(level),
            f"{source[floor.source]}: {floor.reason}"]  # fmt: skip
