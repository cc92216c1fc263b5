# SPDX-License-Identifier: Apache-2.0
"""A comparison as text for a terminal."""

from __future__ import annotations

from smallwheel_ros.compare.comparison import Comparison
from smallwheel_ros.compare.contenders import STANDARD
from smallwheel_ros.compare.results import ModelResult
from smallwheel_ros.display import display, number, percent, sentence, words
from smallwheel_ros.measurements.columns import CHANNEL_UNITS
from smallwheel_ros.tables import text_table

BEST, WITHIN = "best", "within s.e."
_LEGEND = (
    "+-: standard error over runs",
    f"{WITHIN}: worse than the best model by no more than the standard error of the difference",
)


# Said with the table, as no other page of the bench names them.
_NO_LAW_OF_DEPTH = (STANDARD[0], STANDARD[3])


def comparison_text(comparison: Comparison) -> str:
    """The comparison in tables of a line for each model; details are in the JSON and the report."""
    data = comparison.measurements
    lines = [f"{data.source}: {len(data)} rows, {data.runs.size} runs, {comparison.folds} folds"]
    lines += [f"{rows.size} rows left out: {why}" for why, rows in comparison.left_out]
    for channel in comparison.channels:
        lines += ["", *_channel(comparison, channel)]
    if not comparison.channels:
        lines += ["", "No model could predict any of the measurements."]
    notes: list[str] = [*_LEGEND] if comparison.channels else []
    notes += [
        f"{m.contender.name}: {m.contender.description}"
        for m in comparison.models
        if m.contender.name in _NO_LAW_OF_DEPTH
    ]
    notes += dict.fromkeys(f.reason for f in comparison.noise.values())
    notes += [
        f"{m.contender.name}, {rows.size} rows not predicted: {why}"
        for m in comparison.models
        for why, rows in m.not_predicted
    ]
    notes += [f"{m.contender.name} {note}" for m in comparison.models for note in m.notes]
    notes += comparison.notes
    return "\n".join([*lines, "", *(sentence(note) for note in notes)])


def against_best(comparison: Comparison, channel: str, model: ModelResult) -> str:
    """The best model, no clear difference to it, or how much larger the error is; "-" unknown."""
    change = comparison.differences(channel).get(model.contender.name)
    if model is comparison.best(channel):
        return BEST
    if change is None:
        return "-"
    more = -change.reduction[channel]
    return percent(more, signed=True) if channel in change.worse else WITHIN


def _channel(comparison: Comparison, channel: str) -> list[str]:
    shown = display(channel, CHANNEL_UNITS[channel])
    floor = comparison.noise[channel]
    title = f"{words(channel)} [{shown.unit}]"
    repeats = floor.repeatability
    if repeats is None:
        title += ", repeatability unknown"
    else:
        title += f", repeats of one run differ by {number(repeats * shown.scale)} {shown.unit}"
    rows = [_row(comparison, model, channel, shown.scale) for model in comparison.models]
    header = ["model", "rows", "held-out RMSE", "+-", "bias", "in-sample RMSE", "bias",
              "against the best"]  # fmt: skip
    useless = comparison.useless(channel)
    return [
        title,
        *(f"  {line}" for line in text_table(header, rows).splitlines()),
        *([sentence(useless)] if useless else []),
    ]


def _row(comparison: Comparison, model: ModelResult, channel: str, scale: float) -> list[str]:
    outside = comparison.score(model, channel, held_out=True)
    inside = comparison.score(model, channel)
    shown = outside or inside
    cells = [model.contender.name, str(shown.rows if shown else 0)]
    for score, names in ((outside, ("rmse", "rmse_std", "bias")), (inside, ("rmse", "bias"))):
        for name in names:
            value = None if score is None else getattr(score, name)
            cells.append("-" if value is None else number(value * scale))
    return [*cells, against_best(comparison, channel, model)]
