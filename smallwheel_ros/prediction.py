"""One wheel, or a grid of settings, on one soil: the function behind `smallwheel predict`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.errors import SmallwheelError
from smallwheel_ros.model import Model
from smallwheel_ros.model_file import CalibratedModel
from smallwheel_ros.physics.conditions import Conditions
from smallwheel_ros.physics.soil import nearest
from smallwheel_ros.uncertainty import QUANTITIES, UncertainPrediction, predict_with_uncertainty

Array = NDArray[np.float64]

# SI units of the columns that have one; any other column is in SI whatever its unit.
UNITS = {
    "load": "N",
    "diameter": "m",
    "width": "m",
    "slip": "1",
    "speed": "m/s",
    "slip_angle": "rad",
    "slope": "rad",
    "pass_number": "1",
    "grouser_height": "m",
}
_MOST = 200_000
SUNK = "immobilised: sunk to the axle"


class PredictionError(SmallwheelError):
    """Settings that cannot be predicted."""


@dataclass(frozen=True)
class PredictionTable:
    """Settings by name and what the model says of each combination; arrays of shape (rows,), SI."""

    settings: Mapping[str, Array]
    varied: tuple[str, ...]
    result: UncertainPrediction

    def document(self) -> dict[str, Any]:
        """The table as JSON knows it: one mapping a row; null where the wheel is sunk."""
        prediction = self.result.prediction
        rows = []
        for i in range(prediction.sinkage.size):
            sunk = bool(prediction.immobilised[i])
            row: dict[str, Any] = {name: float(v[i]) for name, v in self.settings.items()}
            for quantity in QUANTITIES:
                values = getattr(prediction, quantity)
                if values is None:
                    continue
                row[quantity] = None if sunk else float(values[i])
                deviation = self.result.standard_deviation.get(quantity)
                if deviation is not None:
                    row[f"{quantity}_std"] = None if sunk else float(deviation[i])
            row["status"] = SUNK if sunk else "ok"
            rows.append(row)
        return {"schema": 1, "rows": rows}


def on_one_soil(calibrated: CalibratedModel, name: str | None, source: str) -> CalibratedModel:
    """Keep one soil of a model, by its name; None where the model has but one.

    Raises PredictionError, naming `source`, where the soil is not there or must be chosen.
    """
    model = calibrated.model
    names = [soil.name for soil in model.soils]
    if name is None and len(names) > 1:
        raise PredictionError(f"{source}: has several soils ({', '.join(names)}): say which")
    if name is not None and name not in names:
        raise PredictionError(f"{source}: has no soil '{name}': {nearest(name, names)}")
    kept = model.soils[names.index(name)] if name is not None else model.soils[0]
    others = tuple(f"{other}." for other in names if other != kept.name)
    rows = [i for i, known in enumerate(calibrated.names) if not known.startswith(others)]
    return CalibratedModel(
        Model(kept, model.geometry, model.effects, model.thrust_form),
        tuple(calibrated.names[i] for i in rows),
        calibrated.covariance[np.ix_(rows, rows)],
        calibrated.provenance,
    )


def predict_table(calibrated: CalibratedModel, settings: Mapping[str, Array]) -> PredictionTable:
    """Predict every combination of the settings.

    settings: load, diameter, width (N, m) and any covariate by name, each of shape (values,).
    Raises PredictionError, ConditionsError or ModelError where a value is missing or wrong.
    """
    count = int(np.prod([v.size for v in settings.values()]))
    if count > _MOST:
        raise PredictionError(f"{count} combinations, at most {_MOST}: widen the steps")
    slip = settings.get("slip")
    if slip is not None and (np.abs(slip) > 1).any():
        worst = slip[np.argmax(np.abs(slip))]
        raise PredictionError(f"slip is {worst:g}, expected -1 to 1")
    grid = np.meshgrid(*settings.values(), indexing="ij")
    columns = {name: g.reshape(-1) for name, g in zip(settings, grid, strict=True)}
    conditions = Conditions.of(**columns)
    result = predict_with_uncertainty(calibrated, conditions)
    varied = tuple(name for name, v in settings.items() if v.size > 1)
    return PredictionTable(columns, varied, result)
