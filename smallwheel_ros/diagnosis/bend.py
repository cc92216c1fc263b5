"""What an effect may do otherwise than its best form: its law bent over its own driver.

A hidden law is never quite of the library's form. What is then left follows the driver of an effect
that is in already, and must not pass for a second effect.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.diagnosis.candidates import Family, settings_of, varies
from smallwheel_ros.diagnosis.workbench import Explanation
from smallwheel_ros.effects.base import Effect
from smallwheel_ros.fitting.parameters import replace_model
from smallwheel_ros.model import predict
from smallwheel_ros.physics.conditions import Conditions

Array = NDArray[np.float64]

_MISFIT = 0.01  # usual error of a law whose form is not quite right, relative
_ACTING = 0.05  # relative change from which an effect acts in full


@dataclass(frozen=True, eq=False)
class _Bend(Effect):
    """A small change of each row, shape (rows,)."""

    id = "bend"
    by: Array | None = None

    def factor(self) -> Array:
        assert self.by is not None
        return 1.0 + self.by


class _OfSinkage(_Bend):
    def sinkage(self, sinkage: Array, conditions: Conditions) -> Array:
        return np.asarray(sinkage * self.factor())


class _OfDugSinkage(_OfSinkage):
    def compaction_sinkage(self, sinkage: Array, conditions: Conditions) -> Array:
        return sinkage


class _OfModulus(_Bend):
    def modulus_factor(self, conditions: Conditions) -> Array:
        return self.factor()


def _kind(effect: Effect) -> type[_Bend] | None:
    if effect.overrides("sinkage"):
        return _OfDugSinkage if effect.overrides("compaction_sinkage") else _OfSinkage
    laws = ("modulus_factor", "exponent_shift", "pressure_factor")
    return _OfModulus if any(effect.overrides(stage) for stage in laws) else None


def _shapes(column: Array) -> list[Array]:
    x = (column - column.mean()) / column.std()
    return [x, x**2, x**3 / 2.0]


def _acting(sinkage: Array, without: Array) -> Array:
    """From 0, where an effect does nothing (slip sinkage of a wheel that skids), to 1."""
    change = np.abs(sinkage - without) / np.maximum(np.abs(without), 1e-9)
    return np.clip(np.where(np.isfinite(change), change, 0.0) / _ACTING, 0.0, 1.0)


def bent(explanation: Explanation, families: Sequence[Family]) -> list[Array]:
    """Changes of the predictions by laws a little different, each of shape (observations,)."""
    observations = explanation.predictor.observations
    drivers: Mapping[str, Sequence[str]] = {f.name: f.drivers for f in families}
    settings = settings_of(observations)
    model = explanation.model()
    now = predict(model, observations.conditions).sinkage
    columns = []
    for form in explanation.forms:
        kind = _kind(form.effect)
        varied = [settings[driver] for driver in drivers[form.family] if varies(settings[driver])]
        if kind is None or not varied:
            continue
        rest = [effect for effect in model.effects if effect.id != form.family]
        without = predict(replace_model(model, model.soils, rest), observations.conditions)
        acting = _acting(now, without.sinkage)
        for shape in (shape for column in varied for shape in _shapes(column)):
            bend = kind(by=_MISFIT * acting * shape)
            changed = replace_model(model, model.soils, (*model.effects, bend))
            moved = observations.pick(predict(changed, observations.conditions))
            columns.append(moved - explanation.fit.solution.predicted)
    return columns
