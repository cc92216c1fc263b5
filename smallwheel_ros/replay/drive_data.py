# SPDX-License-Identifier: Apache-2.0
"""A replayed drive as the data that a page draws: the way, each wheel, the soil, what happened."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from smallwheel_ros.costmap.cost_map import CostRules
from smallwheel_ros.onboard.result import Status
from smallwheel_ros.replay.summary import Event

Array = NDArray[np.float64]
Courses = Mapping[str, pd.DataFrame]  # of each wheel, rows of the table of estimates

_BAND = 1.96  # standard deviations: 95 %
_STEPS = 400  # of the way
_MOST_POINTS = 2000  # of a wheel, and of the soil
_MOST_OF_ALL = 12_000  # of all wheels: what a page of two megabytes holds
_GAP = 5.0  # times the usual step of time: a longer one is a gap
_BLOCK = 100_000  # rows of a long drive that are in memory at a time

_WITH_DEVIATION = (
    "sinkage_predicted",
    "drawbar_pull",
    "mobility_margin",
    "soil_k",
    "soil_n",
    "soil_m",
    "soil_reference_pressure",
)
_NUMBERS = (
    *("time", "x", "y", "travel", "load", "slip", "sinkage_measured"),
    *_WITH_DEVIATION,
    *(f"{name}_standard_deviation" for name in _WITH_DEVIATION),
)
_SOIL = (
    ("soil_reference_pressure", "reference pressure [kPa]", 1e-3, True),
    ("soil_k", "k [Pa/m^(n+m)]", 1.0, True),
    ("soil_n", "n", 1.0, False),
    ("soil_m", "m", 1.0, False),
)


def stride(estimates: Mapping[str, int]) -> int:
    """Every how many-th estimate is shown. estimates: how many there are, by wheel."""
    most = min(_MOST_POINTS, _MOST_OF_ALL // max(len(estimates), 1))
    return max(1, -(-max(estimates.values(), default=0) // most))


def read_courses(table: Path, every: int) -> dict[str, pd.DataFrame]:
    """Return every so many-th row of each wheel of a table of estimates (CSV).

    With a column `used`: whether the measured sinkage was used for the soil.
    """
    found: dict[str, list[pd.DataFrame]] = {}
    seen: dict[str, int] = {}
    blocks = pd.read_csv(
        table,
        usecols=["wheel", "status", *_NUMBERS],
        dtype=dict.fromkeys(_NUMBERS, float),
        chunksize=_BLOCK,
    )
    for block in blocks:
        known = block["load"].notna() & block["sinkage_measured"].notna()
        block["used"] = known & (block["status"] != Status.REJECTED.name)
        for wheel, rows in block.groupby("wheel"):
            name = str(wheel)
            first = -seen.get(name, 0) % every
            found.setdefault(name, []).append(rows.iloc[first::every])
            seen[name] = seen.get(name, 0) + len(rows)
    return {wheel: pd.concat(parts) for wheel, parts in found.items()}


def drive_data(courses: Courses, events: Sequence[Event], rules: CostRules) -> dict[str, Any]:
    """Everything that the page draws of a drive; a number that is not known is a gap."""
    rows = pd.concat(list(courses.values())).sort_values("time", kind="stable")
    return {
        "wheels": [_wheel(name, course, rules) for name, course in courses.items()],
        "way": _way(rows, rules),
        "soil": _soil(rows),
        "events": [event._asdict() for event in events],
    }


def _wheel(name: str, course: pd.DataFrame, rules: CostRules) -> dict[str, Any]:
    course = with_gaps(course.sort_values("time", kind="stable"))
    value = {c: course[c].to_numpy(dtype=float) for c in (*_NUMBERS, "used")}
    used = value["used"] > 0
    margin, spread = value["mobility_margin"], value["mobility_margin_standard_deviation"]
    return {
        "name": name,
        "time": value["time"],
        "measured": np.where(used, 1e3 * value["sinkage_measured"], np.nan),
        "unused": np.where(used, np.nan, 1e3 * value["sinkage_measured"]),
        "sinkage": _with_band(value, "sinkage_predicted", 1e3),
        "pull": _with_band(value, "drawbar_pull", 1.0),
        "slip": value["slip"],
        "cost": _cost(rules, margin, spread),
    }


def _with_band(value: Mapping[str, Array], name: str, scale: float) -> dict[str, Array]:
    middle, half = scale * value[name], _BAND * scale * value[f"{name}_standard_deviation"]
    return {"y": middle, "low": middle - half, "high": middle + half}


def with_gaps(rows: pd.DataFrame) -> pd.DataFrame:
    """A blank row wherever time makes a jump, so that no line is drawn across it."""
    time = rows["time"].to_numpy(dtype=float)
    step = np.diff(time)
    if step.size < 2:
        return rows
    jumps = np.flatnonzero(step > _GAP * np.median(step))
    blank = pd.DataFrame(np.nan, index=range(jumps.size), columns=["time"])
    blank["time"] = 0.5 * (time[jumps] + time[jumps + 1])
    return pd.concat([rows, blank]).sort_values("time", kind="stable")


def _cost(rules: CostRules, margin: Array, deviation: Array) -> Array:
    """Cost of each margin, NaN where it is not known."""
    cost = rules.cost(margin, deviation).astype(float)
    return np.where(np.isfinite(margin) & np.isfinite(deviation), cost, np.nan)


def _way(rows: pd.DataFrame, rules: CostRules) -> dict[str, Any] | None:
    """The way in steps of time; None without odometry.

    Sinkage is the mean over the wheels; margin and cost are of the vehicle, wheels weighted by load.
    """
    value = {name: rows[name].to_numpy(dtype=float) for name in _NUMBERS}
    known = np.isfinite(value["x"]) & np.isfinite(value["y"])
    if known.sum() < 2:
        return None
    value = {name: column[known] for name, column in value.items()}
    time = value["time"]
    span = max(float(time[-1] - time[0]), 1e-9)
    index = np.minimum((_STEPS * (time - time[0]) / span).astype(int), _STEPS - 1)
    even, load = np.ones_like(time), value["load"]
    measured, predicted = value["sinkage_measured"], value["sinkage_predicted"]
    deep = np.where(np.isfinite(measured), measured, predicted)
    margin = _mean(index, value["mobility_margin"], load)
    spread = _mean(index, value["mobility_margin_standard_deviation"], load)
    return {
        **{name: _mean(index, value[name], even) for name in ("time", "x", "y")},
        "sinkage": 1e3 * _mean(index, deep, even),
        "margin": 100.0 * margin,
        "cost": _cost(rules, margin, spread),
    }


def _mean(index: NDArray[np.intp], values: Array, weights: Array) -> Array:
    """Weighted mean of the known values in each step, NaN in an empty one."""
    known = np.isfinite(values) & np.isfinite(weights)
    total = np.bincount(index[known], (weights * values)[known], _STEPS)
    weight = np.bincount(index[known], weights[known], _STEPS)
    return np.where(weight > 0, total / np.where(weight > 0, weight, 1.0), np.nan)


def _soil(rows: pd.DataFrame) -> dict[str, Any]:
    """Reference pressure, k, n and m with 95 % bands; of the first two in the logarithm."""
    keep = np.unique(
        np.linspace(0, len(rows) - 1, min(len(rows), _MOST_POINTS)).round().astype(int)
    )
    rows = with_gaps(rows.iloc[keep])
    value = {name: rows[name].to_numpy(dtype=float) for name in _NUMBERS}
    parts = []
    for name, label, scale, logarithmic in _SOIL:
        part: dict[str, Any] = {"label": label, "log": logarithmic}
        if logarithmic:  # closer to log-normal: such a band never reaches below zero
            middle = scale * value[name]
            spread = scale * value[f"{name}_standard_deviation"]
            with np.errstate(divide="ignore", invalid="ignore"):
                factor = np.exp(_BAND * np.minimum(spread / middle, 3.0))
            part |= {"y": middle, "low": middle / factor, "high": middle * factor}
        else:
            part |= _with_band(value, name, scale)
        parts.append(part)
    return {"time": value["time"], "parts": parts}
