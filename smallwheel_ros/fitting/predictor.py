# SPDX-License-Identifier: Apache-2.0
"""Predictions and their slopes for many parameter vectors at once, in one call of the model.

The model works row by row, so the conditions are repeated once for each vector: a call costs little
more for ten vectors than for one.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.effects.base import EffectError
from smallwheel_ros.fitting.parameters import ParameterVector
from smallwheel_ros.fitting.points import FittingError, Points
from smallwheel_ros.model.model import Prediction, predict
from smallwheel_ros.physics.conditions import Conditions

Array = NDArray[np.float64]
Index = NDArray[np.intp]

_AGREE = 1e-9  # rounding of one model evaluated alone or among copies


class Predictor:
    """Predicts values: of a channel (an index into channels) at a row of the conditions each.

    Keeps the repeated conditions between calls.
    """

    def __init__(
        self, conditions: Conditions, channels: Sequence[str], channel: Index, row: Index
    ) -> None:
        self.conditions, self.channels = conditions, tuple(channels)
        self.channel, self.row = channel, row
        self._tiled: dict[int, Conditions] = {}
        self._singly: set[tuple[str, ...]] = set()
        self._checked: set[tuple[str, ...]] = set()
        names = conditions.soil
        codes = np.zeros(len(conditions), dtype=np.intp)
        if names is not None:
            codes = np.unique(names, return_inverse=True)[1].reshape(-1)
        self._soil = codes.astype(str)

    @classmethod
    def of(cls, points: Points) -> Predictor:
        """Predicts these points."""
        return cls(points.conditions, points.channels, points.channel, points.row)

    def __call__(self, vector: ParameterVector, theta: Array) -> Array:
        """Predictions, shape (values,)."""
        return np.asarray(self._picked(predict(vector.model(theta), self.conditions), 1)[0])

    def _picked(self, predicted: Prediction, count: int) -> Array:
        """The values of each copy of the conditions, shape (copies, values)."""
        columns = np.stack([getattr(predicted, n).reshape(count, -1) for n in self.channels])
        return np.asarray(columns[self.channel, :, self.row].T)

    def many(self, vector: ParameterVector, thetas: Array) -> Array:
        """Predictions of each parameter vector, shape (vectors, values).

        An effect that cannot take arrays (a user's own) is evaluated one vector after the other.
        """
        key = tuple(part.id for part in vector.parts)
        if len(thetas) == 1 or key in self._singly:
            return np.stack([self(vector, theta) for theta in thetas])
        try:
            found = self._together(vector, thetas)
        except (EffectError, TypeError, ValueError):
            if not vector.parts:
                raise
            found = None
        if found is not None and vector.parts and key not in self._checked:
            self._checked.add(key)
            alone = self(vector, thetas[-1])
            if not np.allclose(found[-1], alone, rtol=_AGREE, atol=0.0, equal_nan=True):
                found = None
        if found is None:
            self._singly.add(key)
            return np.stack([self(vector, theta) for theta in thetas])
        return found

    def _together(self, vector: ParameterVector, thetas: Array) -> Array:
        model = vector.tiled_model(thetas, len(self.conditions))
        return self._picked(predict(model, self._copies(len(thetas))), len(thetas))

    def _copies(self, count: int) -> Conditions:
        if count not in self._tiled:
            c = self.conditions
            tags = np.concatenate([np.char.add(f"{i}:", self._soil) for i in range(count)])
            self._tiled[count] = Conditions(
                np.tile(c.load, count),
                np.tile(c.diameter, count),
                np.tile(c.width, count),
                np.tile(c.contact, count),
                tags,
                {name: np.tile(column, count) for name, column in c.covariates.items()},
            )
        return self._tiled[count]

    def with_slopes(self, vector: ParameterVector, theta: Array) -> tuple[Array, Array]:
        """Predictions (values,) and their slopes by parameter (values, parameters).

        Raises FittingError where the model has no finite prediction there.
        """
        steps = vector.steps(theta)
        thetas = np.vstack([theta, theta + np.diag(steps)])
        with np.errstate(all="ignore"):  # what is no number is refused below
            found = self.many(vector, thetas)
        bad = np.flatnonzero(~np.isfinite(found).all(axis=0))
        if bad.size:
            raise FittingError(self._no_number(vector, theta, int(bad[0])))
        return found[0], np.asarray((found[1:] - found[0]).T / steps)

    def _no_number(self, vector: ParameterVector, theta: Array, value: int) -> str:
        """Say of which effects the model gives no finite prediction, and at which setting."""
        effects = vector.model(theta).effects
        needs = dict.fromkeys(name for effect in effects for name in effect.needs)
        row = self.row[value]
        setting = [
            f"{n} {self.conditions[n][row]:g}" for n in ("load", "diameter", "width", *needs)
        ]
        return (
            f"the model with {', '.join(e.id for e in effects) or 'no effect'} gives no finite "
            f"{self.channels[self.channel[value]]} at {', '.join(setting)} for the numbers tried"
        )
