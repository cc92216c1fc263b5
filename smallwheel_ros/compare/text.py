"""A comparison as text for a terminal."""

from __future__ import annotations

from smallwheel_ros.compare.comparison import Comparison, ModelResult
from smallwheel_ros.compare.scores import UNITS
from smallwheel_ros.display import display, number, sentence, words
from smallwheel_ros.tables import text_table


def comparison_text(comparison: Comparison) -> str:
    """The comparison in tables of a line for each model; details are in the JSON and the report."""
    data = comparison.measurements
    left_out = sum(lines.size for _, lines in comparison.left_out)
    lines = [f"{data.source}: {len(data) + left_out} rows, {data.runs.size} runs"]
    lines += [f"{rows.size} rows left out: {why}" for why, rows in comparison.left_out]
    for channel in comparison.channels:
        lines += ["", *_channel(comparison, channel)]
    if not comparison.channels:
        lines += ["", "No model could predict any of the measurements."]
    notes = [
        f"{m.contender.name}, {rows.size} rows not predicted: {why}"
        for m in comparison.models
        for why, rows in m.in_sample.reasons
    ]
    notes += [f"{m.contender.name} {note}" for m in comparison.models for note in m.notes]
    notes += comparison.notes
    return "\n".join([*lines, *([""] if notes else []), *(sentence(note) for note in notes)])


def _channel(comparison: Comparison, channel: str) -> list[str]:
    shown = display(channel, UNITS[channel])
    floor = comparison.noise[channel]
    level = (
        "unknown" if floor.value is None else f"{number(floor.value * shown.scale)} {shown.unit}"
    )
    rows = [_row(comparison, model, channel, shown.scale) for model in comparison.models]
    header = ["model", "rows", "held-out RMSE", "+-", "bias", "in-sample RMSE", "bias"]
    title = f"{words(channel)} [{shown.unit}], noise floor {level} ({floor.reason})"
    return [title, *(f"  {line}" for line in text_table(header, rows).splitlines())]


def _row(comparison: Comparison, model: ModelResult, channel: str, scale: float) -> list[str]:
    outside = comparison.score(model, channel, held_out=True)
    inside = comparison.score(model, channel)
    shown = outside or inside
    cells = [model.contender.name, str(shown.rows if shown else 0)]
    for score, names in ((outside, ("rmse", "rmse_std", "bias")), (inside, ("rmse", "bias"))):
        for name in names:
            value = None if score is None else getattr(score, name)
            cells.append("-" if value is None else number(value * scale))
    return cells
