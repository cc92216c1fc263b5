# SPDX-License-Identifier: Apache-2.0
"""A comparison in words, and as a JSON document, in SI units; null where there is no number.

    {"schema": 1,
     "data": {"source", "sha256", "rows", "runs", "runs_given", "channels": {channel: rows measured},
              "left_out": [{"reason", "rows", "lines": [first 20]}], "warnings": [], "notes": []},
     "folds": parts that the runs were dealt into for the held-out error, 0 where there is one run,
     "noise_floor": {channel: {"value", "source": "repeats" | "declared" | null, "reason",
                               "repeatability"}},
     "models": [{"name", "description", "fitted": whether to this data, "file", "notes": [],
                 "geometry": null of a constant,
                 "soils": [{"name", "k", "n", "m", "cohesion", "friction_angle", "shear_displacement"}],
                 "effects": [{"id", "form", "parameters": {name: value}}],
                 "channels": {channel: {"in_sample": SCORE | null, "held_out": SCORE | null}},
                 "not_predicted": [{"reason", "rows", "lines": [first 20]}],
                 "parts": [{"by", "label", "channel", "in_sample", "held_out"}]}],
     "differences": [{"channel", "best", "other", "increase", "z_score", "within_standard_error"}]}

SCORE is {"rows", "runs", "rmse", "rmse_std", "bias"}; bias is the mean of measured less predicted.
noise_floor is the held-out error that a true model would leave: null here, since it is not known before
what is missing is (`smallwheel diagnose`); repeatability is what rows of one run differ by. Of differences,
increase is the relative one of the held-out rmse over the best model's on the rows of both; z_score is of
the difference over its standard error, negative where other is worse.
"""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from smallwheel_ros.common.tables import text_table
from smallwheel_ros.compare.comparison import Comparison, Index, ModelResult
from smallwheel_ros.compare.contenders import STANDARD
from smallwheel_ros.measurements.columns import CHANNEL_UNITS, Mask
from smallwheel_ros.measurements.display import display, number, percent, sentence, words
from smallwheel_ros.model.model import Model

_SHOWN_LINES = 20
BEST, WITHIN = "best", "within s.e."
_LEGEND = (
    "+-: standard error over runs",
    f"{WITHIN}: worse than the best model by no more than the standard error of the difference",
)
# Said with the table, as no other page of the bench names them.
_NO_LAW_OF_DEPTH = (STANDARD[0], STANDARD[3])


def comparison_document(comparison: Comparison) -> dict[str, Any]:
    """The comparison in the form above, ready for json.dump(..., allow_nan=False)."""
    data = comparison.measurements
    return {
        "schema": 1,
        "data": {
            "source": data.source,
            "sha256": data.sha256,
            "rows": len(data),
            "runs": int(data.runs.size),
            "runs_given": data.runs_given,
            "channels": {name: int(data.channel_rows(name).size) for name in data.channels},
            "left_out": [_reason(why, lines) for why, lines in comparison.left_out],
            "warnings": list(data.warnings),
            "notes": [*data.notes, *comparison.notes],
        },
        "folds": comparison.folds,
        "noise_floor": {name: asdict(floor) for name, floor in comparison.noise.items()},
        "models": [_model(comparison, result) for result in comparison.models],
        "differences": [
            {
                "channel": channel,
                "best": best.contender.name,
                "other": name,
                "increase": -change.reduction[channel],
                "z_score": change.z_score[channel],
                "within_standard_error": channel not in change.worse,
            }
            for channel in comparison.channels
            if (best := comparison.best(channel)) is not None
            for name, change in comparison.differences(channel).items()
        ],
    }


def _reason(why: str, lines: Index) -> dict[str, Any]:
    return {"reason": why, "rows": int(lines.size), "lines": lines[:_SHOWN_LINES].tolist()}


def _model(comparison: Comparison, result: ModelResult) -> dict[str, Any]:
    contender, line = result.contender, comparison.measurements.line
    return {
        "name": contender.name,
        "description": contender.description,
        "fitted": contender.fitted,
        "file": contender.file or None,
        "notes": list(result.notes),
        **_parameters(result.model),
        "channels": {
            name: _scores(comparison, result, name) for name in comparison.measurements.channels
        },
        "not_predicted": [_reason(why, line[rows]) for why, rows in result.not_predicted],
        "parts": [
            {"by": part.by, "label": part.label, "channel": channel}
            | _scores(comparison, result, channel, part.rows)
            for part in comparison.parts
            for channel in comparison.channels
        ],
    }


def _parameters(model: Model | None) -> dict[str, Any]:
    if model is None:
        return {"geometry": None, "soils": [], "effects": []}
    names = ("k", "n", "m", "cohesion", "friction_angle", "shear_displacement")
    return {
        "geometry": model.geometry,
        "soils": [
            {"name": soil.name} | {name: float(getattr(soil, name)) for name in names}
            for soil in model.soils
        ],
        "effects": [
            {"id": effect.id, "form": effect.form, "parameters": dict(effect.values())}
            for effect in model.effects
        ],
    }


def _scores(
    comparison: Comparison, result: ModelResult, channel: str, rows: Mask | None = None
) -> dict[str, Any]:
    scores = {
        "in_sample": comparison.score(result, channel, rows=rows),
        "held_out": comparison.score(result, channel, held_out=True, rows=rows),
    }
    return {kind: None if score is None else asdict(score) for kind, score in scores.items()}


def comparison_text(comparison: Comparison) -> str:
    """The comparison in tables of a line for each model; details are in the JSON and the report."""
    data = comparison.measurements
    lines = [f"{data.source}: {len(data)} rows, {data.runs.size} runs, {comparison.folds} folds"]
    lines += [f"{rows.size} rows left out: {why}" for why, rows in comparison.left_out]
    for channel in comparison.channels:
        lines += ["", *_table(comparison, channel)]
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


def _table(comparison: Comparison, channel: str) -> list[str]:
    shown = display(channel, CHANNEL_UNITS[channel])
    floor = comparison.noise[channel]
    title = f"{words(channel)} [{shown.unit}]"
    repeats = floor.repeatability
    if repeats is None:
        title += ", repeatability unknown"
    else:
        title += f", repeats of one run differ by {number(repeats * shown.scale)} {shown.unit}"
    rows = [_cells(comparison, model, channel, shown.scale) for model in comparison.models]
    header = ["model", "rows", "held-out RMSE", "+-", "bias", "in-sample RMSE", "bias",
              "against the best"]  # fmt: skip
    useless = comparison.useless(channel)
    return [
        title,
        *(f"  {line}" for line in text_table(header, rows).splitlines()),
        *([sentence(useless)] if useless else []),
    ]


def _cells(comparison: Comparison, model: ModelResult, channel: str, scale: float) -> list[str]:
    outside = comparison.score(model, channel, held_out=True)
    inside = comparison.score(model, channel)
    shown = outside or inside
    cells = [model.contender.name, str(shown.rows if shown else 0)]
    for score, names in ((outside, ("rmse", "rmse_std", "bias")), (inside, ("rmse", "bias"))):
        for name in names:
            value = None if score is None else getattr(score, name)
            cells.append("-" if value is None else number(value * scale))
    return [*cells, against_best(comparison, channel, model)]
