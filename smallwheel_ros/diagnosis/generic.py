"""Columns that stand for no effect: one channel's error follows one setting, for whatever reason."""

from __future__ import annotations

import numpy as np

from smallwheel_ros.diagnosis.candidates import kinematic, settings_of, varies
from smallwheel_ros.diagnosis.score import Columns
from smallwheel_ros.diagnosis.workbench import Explanation

_FEWEST_RUNS = 6
_WIDE = 5.0  # largest over smallest, from which a setting is also tried by its logarithm


def generic_columns(explanation: Explanation, prefix: str) -> Columns:
    """Straight and bent ones for each channel and each setting that varies.

    Groups are named `prefix` + channel + " over " + setting.
    """
    observations = explanation.predictor.observations
    rows = np.unique(observations.row)
    columns, groups = [], []
    level = np.abs(explanation.fit.solution.predicted)
    derived = kinematic(observations.conditions)
    for name, setting in settings_of(observations).items():
        used = setting[rows]
        if name in derived or not varies(used) or np.unique(observations.run).size < _FEWEST_RUNS:
            continue
        x = (setting[observations.row] - used.mean()) / used.std()
        shapes = [x]
        if np.unique(np.round(x, 2)).size > 2:
            shapes += [x**2, (x - x.min()) ** 2, (x.max() - x) ** 2]
        if used.min() > 0 and used.max() > _WIDE * used.min():
            logged = np.log(np.maximum(setting[observations.row], used.min()))
            shapes.append((logged - np.mean(logged)) / np.std(logged))
        for c, channel in enumerate(observations.channels):
            for shape in shapes:
                columns.append(np.where(observations.channel == c, shape * level, 0.0))
                groups.append(f"{prefix}{channel} over {name}")
    if not columns:
        return Columns(np.zeros((len(observations), 0)), (), (), (), np.zeros(0, dtype=bool))
    count = len(columns)
    return Columns(
        np.column_stack(columns),
        tuple(groups),
        (None,) * count,
        tuple({} for _ in range(count)),
        np.zeros(count, dtype=bool),
    )
