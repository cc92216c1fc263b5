# SPDX-License-Identifier: Apache-2.0
"""A comparison as a JSON document, in SI units; null where there is no number.

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
noise_floor is the held-out error that a true model would leave: its value is null here, since it is unknown
until it is known what is missing (`smallwheel diagnose`); repeatability is the standard deviation of the rows
of one run. In differences, increase is the relative increase of the held-out rmse over the best model's, on
rows that both predict; z_score is the difference over its standard error, negative if other is worse.
"""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from smallwheel_ros.compare.comparison import Comparison, Index, ModelResult
from smallwheel_ros.measurements.columns import Mask
from smallwheel_ros.model.model import Model

_SHOWN_LINES = 20


def comparison_document(comparison: Comparison) -> dict[str, Any]:
    """The comparison as plain values, in the form that this module's docstring gives; without NaN."""
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
