"""Sinkage of many wheels in models near to one that has been solved, by its slopes.

A score test asks how sinkage changes when n, m or an effect's strength change a little. One
solution of the contact integral with its slopes tells that for all of them: what an effect makes
of load, modulus and exponent moves ln z along the slopes, what it digs comes on top as it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.effects.base import Effect
from smallwheel_ros.model import Model, predict
from smallwheel_ros.physics.conditions import Conditions
from smallwheel_ros.physics.contact import ContactSinkage, contact_sinkage
from smallwheel_ros.physics.sinkage import layered_load
from smallwheel_ros.physics.soil import Soil, effective_modulus
from smallwheel_ros.stages import Stages

Array = NDArray[np.float64]


class _Statics(NamedTuple):
    """What the wheels stand on before they dig; arrays of shape (rows,)."""

    stages: Stages
    load: Array
    diameter: Array
    modulus: Array
    exponent: Array


class NearbySinkage:
    """Sinkage of rolling wheels about one soil with some effects.

    conditions: rolling rows. Raises what `model.predict` raises.
    """

    def __init__(self, soil: Soil, effects: Sequence[Effect], conditions: Conditions) -> None:
        self._effects, self._conditions = tuple(effects), conditions
        self._at = self._statics(soil, ())
        self._solved: ContactSinkage | None = None
        if not self._at.stages.layered:
            self._solved = contact_sinkage(
                self._at.load,
                self._at.diameter,
                conditions.width,
                self._at.modulus,
                self._at.exponent,
            )

    def log_sinkage(self, soil: Soil, *added: Effect) -> Array:
        """Give ln of what the instrument would show (m), shape (rows,).

        soil: near to the one at the start. added: effects of little strength. NaN where there is no
        sinkage.
        """
        turned = any(effect.overrides("wheel_diameter") for effect in added)
        if self._solved is None or turned:  # no slopes for that
            model = Model(soil, effects=(*self._effects, *added))
            return _log(predict(model, self._conditions).sinkage)
        there, here = self._statics(soil, added), self._at
        log_z = np.log(self._solved.sinkage)
        carried = there.load
        if there.stages.layered:
            width = self._conditions.width
            soil_at = there.diameter, width, there.modulus, there.exponent
            factor = there.stages.pressure_factor
            borne = layered_load(self._solved.sinkage, *soil_at, factor)
            log_z = log_z + self._solved.slope_load * np.log(carried / borne)
        else:
            more = np.log(carried / here.load) - np.log(there.modulus / here.modulus)
            log_z = log_z + self._solved.slope_load * more
            log_z = log_z + self._solved.slope_exponent * (there.exponent - here.exponent)
        z = there.stages.change_rolling("sinkage", np.exp(log_z))
        return _log(there.stages.change("measured_sinkage", z))

    def _statics(self, soil: Soil, added: Sequence[Effect]) -> _Statics:
        """Let the effects act as `model.predict` does, up to where the contact is solved."""
        stages = Stages((*self._effects, *added), self._conditions)
        load = stages.change("normal_load", self._conditions.load)
        diameter = stages.change("wheel_diameter", self._conditions.diameter)
        modulus = effective_modulus(np.array(soil.k), np.array(soil.m), diameter)
        exponent = np.full(load.shape, soil.n)
        for effect in stages.acting_at("modulus_factor"):
            modulus = modulus * stages.call(effect, "modulus_factor", 1.0)
        for effect in stages.acting_at("exponent_shift"):
            exponent = exponent + stages.call(effect, "exponent_shift", 0.0)
        return _Statics(stages, load, diameter, modulus, exponent)


def _log(sinkage: Array) -> Array:
    return np.asarray(np.log(np.where(sinkage > 0.0, sinkage, np.nan)))
