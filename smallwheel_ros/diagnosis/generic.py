"""Columns that stand for no effect: an error follows one setting, for whatever reason."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.diagnosis.candidates import kinematic, settings_of, varies
from smallwheel_ros.diagnosis.score import Columns
from smallwheel_ros.diagnosis.workbench import Explanation

Array = NDArray[np.float64]

RIG = "resistance of the rig itself (the same amount everywhere, or a share of the load)"
_FEWEST_RUNS = 6
_WIDE = 5.0  # largest over smallest, from which a setting is also tried by its logarithm


def generic_columns(explanation: Explanation, prefix: str) -> Columns:
    """Straight and bent ones for each channel and each setting that varies; what a rig itself resists.

    Groups are named `prefix` + channel + " over " + setting, or `RIG` behind the prefix.
    """
    observations = explanation.predictor.observations
    level = np.abs(explanation.fit.solution.predicted)
    columns, groups = [], []
    for name, setting, used in _varied(explanation):
        shapes = _shapes(setting[observations.row], used)
        if _wide(used):
            shapes.append(_logged(setting[observations.row], used))
        for c, channel in enumerate(observations.channels):
            for shape in shapes:
                columns.append(np.where(observations.channel == c, shape * level, 0.0))
                groups.append(f"{prefix}{channel} over {name}")
    if columns and "resistance" in observations.channels:
        # Friction of bearings, or a load cell that is off: of any size, and in each setting alike.
        resists = observations.channel == observations.channels.index("resistance")
        load = observations.conditions.load[observations.row]
        columns += [resists.astype(float), np.where(resists, load, 0.0)]
        groups += [prefix + RIG] * 2
    return _columns(columns, groups, len(observations))


def soil_columns(explanation: Explanation, prefix: str) -> Columns:
    """The same for the soil's stiffness, which moves all channels together.

    What makes the soil of a run softer looks like scatter from run to run, and is hidden from columns
    of one channel. Groups are named `prefix` + "soil stiffness over " + setting.
    """
    observations = explanation.predictor.observations
    columns, groups = [], []
    # As the fit itself has it: a column nearly along m must not gain from another linearisation.
    stiffness = [slot.field == "log_reference_pressure" for slot in explanation.layout.slots]
    slope = explanation.fit.solution.slopes[:, stiffness].sum(axis=1)
    for name, setting, used in _varied(explanation):
        values = setting[observations.row]
        shapes = _shapes(values, used)
        if _wide(used):
            shapes += _shapes(np.log(np.maximum(values, used.min())), np.log(used))
        columns += [shape * slope for shape in shapes]
        groups += [f"{prefix}soil stiffness over {name}"] * len(shapes)
    return _columns(columns, groups, len(observations))


def _varied(explanation: Explanation) -> Iterator[tuple[str, Array, Array]]:
    """Each setting that varies: name, value by row of the table, values of the rows in use."""
    observations = explanation.predictor.observations
    if np.unique(observations.run).size < _FEWEST_RUNS:
        return
    rows = np.unique(observations.row)
    derived = kinematic(observations.conditions)
    for name, setting in settings_of(observations).items():
        if name not in derived and varies(setting[rows]):
            yield name, setting, setting[rows]


def _shapes(values: Array, used: Array) -> list[Array]:
    x = (values - used.mean()) / used.std()
    if np.unique(np.round(x, 2)).size <= 2:
        return [x]
    return [x, x**2, (x - x.min()) ** 2, (x.max() - x) ** 2]


def _wide(used: Array) -> bool:
    return bool(used.min() > 0 and used.max() > _WIDE * used.min())


def _logged(values: Array, used: Array) -> Array:
    logged = np.log(np.maximum(values, used.min()))
    return np.asarray((logged - np.mean(logged)) / np.std(logged))


def _columns(columns: list[Array], groups: list[str], rows: int) -> Columns:
    if not columns:
        return Columns(np.zeros((rows, 0)), (), (), (), np.zeros(0, dtype=bool))
    count = len(columns)
    return Columns(
        np.column_stack(columns),
        tuple(groups),
        (None,) * count,
        tuple({} for _ in range(count)),
        np.zeros(count, dtype=bool),
    )
