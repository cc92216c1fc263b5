"""Where to look on: what the best explanation leaves, over every setting and between groups of rows."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.diagnosis.competitors import varied
from smallwheel_ros.diagnosis.curves import Curve
from smallwheel_ros.diagnosis.search import CandidateFit
from smallwheel_ros.fitting.fit import Fitter
from smallwheel_ros.physics.conditions import Conditions

Array = NDArray[np.float64]

_PARTS = 3  # low, middle and high of a setting
_MOST_GROUPS = 12
_POINTS = 25  # of a curve that is shown


def residuals_left(fitter: Fitter, model: CandidateFit) -> list[dict[str, Any]]:
    """Mean relative residual of the best model, by channel, in thirds of each setting and by group."""
    points = fitter.points
    share = (points.value - model.fit.predicted) / fitter.level
    found = []
    for c, channel in enumerate(points.channels):
        mine = points.channel == c
        for name, column in varied(points).items():
            edges = np.unique(np.quantile(column[mine], np.linspace(0, 1, _PARTS + 1)))
            place = np.clip(np.searchsorted(edges, column, side="right") - 1, 0, edges.size - 2)
            parts = [
                _part(share, points.run, mine & (place == i), float(np.median(column[mine & (place == i)])))
                for i in range(edges.size - 1)
                if (mine & (place == i)).any()
            ]  # fmt: skip
            found.append({"channel": channel, "setting": name, "parts": parts})
        for name, label in _groups(fitter).items():
            values = np.unique(label[mine])
            if not 1 < values.size <= _MOST_GROUPS:
                continue
            parts = [_part(share, points.run, mine & (label == v), str(v)) for v in values]
            found.append({"channel": channel, "group": name, "parts": parts})
    return found


def _part(
    share: Array, run: NDArray[np.intp], mask: NDArray[np.bool_], at: object
) -> dict[str, Any]:
    runs = np.unique(run[mask])
    means = np.array([share[mask & (run == r)].mean() for r in runs])
    error = float(means.std(ddof=1) / np.sqrt(means.size)) if means.size > 1 else None
    return {"at": at, "runs": int(runs.size), "mean": float(means.mean()), "std": error}


def _groups(fitter: Fitter) -> dict[str, NDArray[np.str_]]:
    """Labels of each value: the wheel, the soil, and every column of text."""
    points = fitter.points
    measurements = points.measurements
    first = np.array([rows[0] for rows in points.rows])
    columns = {"wheel": measurements.wheel, "soil": measurements.soil, **measurements.labels}
    return {name: np.asarray(column)[first] for name, column in columns.items()}


def worst_left(left: list[dict[str, Any]]) -> str:
    """The setting or group over which the residual differs most, in words; "" where none does."""
    best, words = 3.0, ""  # standard errors
    for entry in left:
        for part in entry["parts"]:
            if part["std"] and abs(part["mean"]) / part["std"] > best and part["runs"] > 2:
                best = abs(part["mean"]) / part["std"]
                what = entry.get("setting") or entry.get("group")
                at = part["at"] if isinstance(part["at"], str) else f"{part['at']:.3g}"
                words = f"{entry['channel']} is {100 * part['mean']:+.0f} % off where {what} is about {at}"
    return words


def curve_shown(fitter: Fitter, model: CandidateFit) -> list[dict[str, Any]]:
    """The curves without a name of a model: factor over the setting, with its 95 % band."""
    fit = model.fit
    found = []
    for competitor in model.competitors:
        span = competitor.span
        if span is None or competitor.stage == "pressure":
            continue
        at = [j for j, p in enumerate(fit.vector.free)
              if p.of_effect and p.owner == competitor.part.id]  # fmt: skip
        column = fitter.points.column(span.column)
        mine = column if not span.side else column[span.side * (column - span.middle) >= 0]
        x = np.linspace(float(mine.min()), float(mine.max()), _POINTS)
        conditions = Conditions.of(1.0, 1.0, 1.0, **{span.column: x}) if span.column not in (
            "load", "diameter", "width") else Conditions.of(**(
                {"load": 1.0, "diameter": 1.0, "width": 1.0} | {span.column: x}))  # fmt: skip
        names = [name for name, *_ in competitor.part.parameters]
        rows = []
        for i in range(len(names)):
            unit = {name: 1.0 if k == i else 0.0 for k, name in enumerate(names)}
            curve = competitor.part.build(unit)
            assert isinstance(curve, Curve)
            rows.append(curve.log_factor(conditions))
        basis = np.array(rows).T
        middle = basis @ fit.theta[at]
        spread = np.sqrt(np.einsum("ij,jk,ik->i", basis, fit.covariance[np.ix_(at, at)], basis))
        found.append({
            "setting": span.column, "stage": competitor.stage, "x": x, "factor": np.exp(middle),
            "low": np.exp(middle - 1.96 * spread), "high": np.exp(middle + 1.96 * spread),
        })  # fmt: skip
    return found
