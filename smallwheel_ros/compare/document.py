"""A comparison as a JSON document, in SI units; null where there is no number.

    {"schema": 1,
     "data": {"source", "sha256", "rows", "runs", "runs_given", "channels": {channel: rows measured},
              "left_out": [{"reason", "rows", "lines": [first 20]}], "warnings": [], "notes": []},
     "folds": parts that the runs were dealt into for the held-out error, 0 where there are too few,
     "noise_floor": {channel: {"value", "std", "source": "repeats" | "declared" | null, "reason"}},
     "models": [{"name", "description", "fitted": whether to this data, "file", "notes": [],
                 "soils": [{"name", "k", "n", "m", "cohesion", "friction_angle", "shear_displacement"}],
                 "effects": [{"id", "form", "parameters": {name: value}}],
                 "channels": {channel: {"in_sample": SCORE | null, "held_out": SCORE | null}},
                 "not_predicted": [{"reason", "rows", "lines": [first 20]}],
                 "parts": [{"by", "label", "channel", "in_sample", "held_out"}]}]}

SCORE is {"rows", "runs", "rmse", "rmse_std", "bias"}; bias is the mean of measured minus predicted.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from smallwheel_ros.compare.comparison import Comparison, ModelResult
from smallwheel_ros.compare.scores import Index, Mask, Score
from smallwheel_ros.model import Model

_SHOWN_LINES = 20


def comparison_document(comparison: Comparison) -> dict[str, Any]:
    """The comparison in the form above, ready for json.dump(..., allow_nan=False)."""
    data = comparison.measurements
    left_out = sum(lines.size for _, lines in comparison.left_out)
    return {
        "schema": 1,
        "data": {
            "source": data.source,
            "sha256": data.sha256,
            "rows": len(data) + left_out,
            "runs": int(data.runs.size),
            "runs_given": data.runs_given,
            "channels": {name: int(data.channel_rows(name).size) for name in data.channels},
            "left_out": [_reason(why, lines) for why, lines in comparison.left_out],
            "warnings": list(data.warnings),
            "notes": [*data.notes, *comparison.notes],
        },
        "folds": comparison.folds,
        "noise_floor": {
            name: {"value": f.value, "std": f.std, "source": f.source, "reason": f.reason}
            for name, f in comparison.noise.items()
        },
        "models": [_model(comparison, result) for result in comparison.models],
    }


def _reason(why: str, lines: Index) -> dict[str, Any]:
    return {"reason": why, "rows": int(lines.size), "lines": lines[:_SHOWN_LINES].tolist()}


def _model(comparison: Comparison, result: ModelResult) -> dict[str, Any]:
    contender, line = result.contender, comparison.measurements.line
    predicted = [result.in_sample, *([result.held_out] if result.held_out else [])]
    reasons: dict[str, Index] = {}
    for why, rows in (pair for part in predicted for pair in part.reasons):
        reasons[why] = np.union1d(reasons.get(why, rows), rows)
    return {
        "name": contender.name,
        "description": contender.description,
        "fitted": contender.fit is not None,
        "file": contender.file or None,
        "notes": list(result.notes),
        **_parameters(result.model),
        "channels": {
            name: _scores(comparison, result, name) for name in comparison.measurements.channels
        },
        "not_predicted": [_reason(why, line[rows]) for why, rows in reasons.items()],
        "parts": [
            {"by": part.by, "label": part.label, "channel": channel}
            | _scores(comparison, result, channel, part.rows)
            for part in comparison.parts
            for channel in comparison.channels
        ],
    }


def _parameters(model: Model | None) -> dict[str, Any]:
    if model is None:
        return {"soils": [], "effects": []}
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
    return {
        "in_sample": _score(comparison.score(result, channel, rows=rows)),
        "held_out": _score(comparison.score(result, channel, held_out=True, rows=rows)),
    }


def _score(score: Score | None) -> dict[str, Any] | None:
    if score is None:
        return None
    return {
        "rows": score.rows,
        "runs": score.runs,
        "rmse": score.rmse,
        "rmse_std": score.rmse_std,
        "bias": score.bias,
    }
