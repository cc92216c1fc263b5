"""One wheel, or a grid of settings, on one soil: the function behind `smallwheel predict`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.conditions import Conditions
from smallwheel_ros.errors import SmallwheelError
from smallwheel_ros.model_file import CalibratedModel
from smallwheel_ros.uncertainty import QUANTITIES, UncertainPrediction, predict_with_uncertainty

Array = NDArray[np.float64]

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
