"""Predictions for a parameter vector, and their slopes, with as few calls of the model as possible."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.fitting.observations import Observations
from smallwheel_ros.fitting.parameters import Layout, correction_columns, replace_model
from smallwheel_ros.model import Model, predict
from smallwheel_ros.physics.conditions import Conditions
from smallwheel_ros.physics.soil import Soil

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Tiling:
    """The conditions, repeated with the soils renamed, so that one call predicts several soils.

    Copy c of a row whose soil is number s of the model has the soil `c:s`.
    """

    conditions: Conditions
    soil_number: NDArray[np.intp]  # of each row

    @classmethod
    def of(cls, conditions: Conditions, model: Model) -> Tiling:
        """The tiling of these rows for the soils of a model."""
        names = [s.name for s in model.soils]
        if conditions.soil is None or len(names) == 1:
            return cls(conditions, np.zeros(len(conditions), dtype=np.intp))
        order = np.argsort(names)
        found = order[np.searchsorted(np.asarray(names)[order], conditions.soil)]
        return cls(conditions, found.astype(np.intp))

    def copies(self, count: int) -> Conditions:
        """The conditions `count` times over."""
        c = self.conditions
        tags = np.concatenate(
            [np.char.add(f"{i}:", self.soil_number.astype(str)) for i in range(count)]
        )
        return Conditions(
            np.tile(c.load, count),
            np.tile(c.diameter, count),
            np.tile(c.width, count),
            np.tile(c.contact, count),
            tags,
            {name: np.tile(column, count) for name, column in c.covariates.items()},
        )


def _renamed(soils: tuple[Soil, ...], copy: int) -> list[Soil]:
    return [replace(soil, name=f"{copy}:{i}") for i, soil in enumerate(soils)]


class Predictor:
    """Predicts one set of observations for one layout of parameters."""

    def __init__(self, observations: Observations, layout: Layout) -> None:
        self.observations = observations
        self.layout = layout
        self._tiling = Tiling.of(observations.conditions, layout.model)
        self._tiled: dict[int, Conditions] = {}
        self._corrections = np.flatnonzero([slot.owner < 0 for slot in layout.slots])
        self._columns: Array = np.zeros((len(observations), self._corrections.size))
        if self._corrections.size:
            added = correction_columns(observations.conditions)[observations.row]
            pull = observations.of_channel("drawbar_pull")[:, None]
            self._columns = np.where(pull, added, 0.0)

    def __call__(self, theta: Array) -> Array:
        """Predictions, shape (observations,)."""
        model = self.layout.model_at(theta)
        found = self.observations.pick(predict(model, self.observations.conditions))
        return np.asarray(found + self._columns @ theta[self._corrections])

    def _stepped(self, theta: Array) -> tuple[Array, Array]:
        """Each parameter's step, inward where the bound is near, and the stepped value."""
        steps = np.array([slot.step for slot in self.layout.slots])
        over = theta + steps > self.layout.high
        steps = np.where(over, -steps, steps)
        return steps, theta + steps

    def with_slopes(self, theta: Array) -> tuple[Array, Array]:
        """Predictions (observations,) and their slopes by parameter (observations, parameters).

        All soil parameters in one call of the model over a tiled table (a field is stepped in all soils
        at once, since a row has one soil), one call for each parameter of an effect.
        """
        layout, obs = self.layout, self.observations
        steps, stepped = self._stepped(theta)
        fields = list(
            dict.fromkeys(s.field for s in layout.slots if not s.of_effect and s.owner >= 0)
        )
        vectors = [theta]
        for name in fields:
            moved = theta.copy()
            for j, slot in enumerate(layout.slots):
                if not slot.of_effect and slot.field == name:
                    moved[j] = stepped[j]
            vectors.append(moved)
        models = [layout.model_at(v) for v in vectors]
        count = len(models)
        if count not in self._tiled:
            self._tiled[count] = self._tiling.copies(count)
        soils = [s for c, model in enumerate(models) for s in _renamed(model.soils, c)]
        together = replace_model(layout.model, soils, models[0].effects)
        predicted = predict(together, self._tiled[count])
        rows = len(obs.conditions)
        columns = np.stack([getattr(predicted, name).reshape(count, rows) for name in obs.channels])
        values = columns[obs.channel, :, obs.row]  # (observations, copies)
        base = values[:, 0] + self._columns @ theta[self._corrections]
        values = values + (base - values[:, 0])[:, None]
        slopes = np.zeros((len(obs), len(layout.slots)))
        slopes[:, self._corrections] = self._columns
        number = self._tiling.soil_number[obs.row]
        for j, slot in enumerate(layout.slots):
            if slot.owner < 0:
                continue
            if slot.of_effect:
                moved = theta.copy()
                moved[j] = stepped[j]
                slopes[:, j] = (self(moved) - base) / steps[j]
            else:
                change = values[:, 1 + fields.index(slot.field)] - base
                slopes[:, j] = np.where(number == slot.owner, change / steps[j], 0.0)
        return base, slopes
