# SPDX-License-Identifier: Apache-2.0
"""Sinkage shown by the instrument for rolling wheels in soils near a given one, from one contact solution.

Changes of load, modulus and exponent change ln z to first order, by the derivatives of that solution; effects
that change the sinkage itself are then applied in full.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.effects.base import Effect
from smallwheel_ros.model.model import Model, predict
from smallwheel_ros.model.stages import Stages
from smallwheel_ros.physics.conditions import Conditions
from smallwheel_ros.physics.contact import AXLE_RATIO, ContactSinkage
from smallwheel_ros.physics.sinkage import CONTACT_RULES, Geometry, loads_by_depth
from smallwheel_ros.physics.soil import Soil

Array = NDArray[np.float64]


class NearbySinkage:
    """Sinkage of rolling wheels in soils near a given one, in most cases approximated without a new solution.

    `log_sinkage` lists the effects with which the contact is solved anew at each call.

    Parameters
    ----------
    soil
        The given soil, from which the others differ by little.
    effects
        Effects of the model, in the order in which they act.
    conditions
        Settings of rolling wheels, SI units, shape (rows,) each.
    geometry
        Rule of contact.

    Raises
    ------
    ModelError, EffectError
        As by `model.predict`.
    """

    def __init__(
        self,
        soil: Soil,
        effects: Sequence[Effect],
        conditions: Conditions,
        geometry: Geometry = "contact_integral",
    ) -> None:
        self._soil, self._effects, self._conditions = soil, tuple(effects), conditions
        self._geometry = geometry
        self._stages = Stages(self._effects, conditions)
        self._at = self._stages.loaded(soil.k, soil.n, soil.m)
        self._solved: ContactSinkage | None = None
        if not self._stages.layered:
            load, diameter, modulus, exponent = self._at
            solve = CONTACT_RULES[geometry].sinkage
            self._solved = solve(load, diameter, conditions.width, modulus, exponent)
            self._log_z = np.log(self._solved.sinkage)

    def log_sinkage(self, soil: Soil, *added: Effect) -> Array:
        """ln of the sinkage (m) that the instrument would show, shape (rows,); NaN where that is not above 0.

        To first order in the difference between the soils. The contact is solved anew where an effect of the
        model acts at `pressure_factor`, or an added one at `wheel_diameter` or `corrected_load`.

        Parameters
        ----------
        soil
            A soil near the given one.
        added
            Further effects of small strength, which act after the model's.

        Raises
        ------
        ModelError, EffectError
            As by `model.predict`.
        """
        turned = any(
            "wheel_diameter" in effect.acts or "corrected_load" in effect.acts for effect in added
        )
        if self._solved is None or turned:  # no derivatives for that
            model = Model(soil, self._geometry, (*self._effects, *added))
            return _log(predict(model, self._conditions).sinkage)
        here = self._at
        more_stages = Stages(added, self._stages.conditions)
        there = here if soil is self._soil else self._stages.loaded(soil.k, soil.n, soil.m)
        there = more_stages.on_soil(there)
        more = np.log(there.load / here.load) - np.log(there.modulus / here.modulus)
        if more_stages.layered:
            depth, borne = self._loads_by_depth
            factor = more_stages.pressure_factor(depth)
            more = more + np.log(here.load / np.einsum("ij,ij->j", borne, factor))
        log_z = self._log_z + self._solved.slope_load * more
        log_z = log_z + self._solved.slope_exponent * (there.exponent - here.exponent)
        z = np.exp(log_z)
        for stages in (self._stages, more_stages):
            z = stages.change("sinkage", z)
        for stages in (self._stages, more_stages):
            z = stages.change("measured_sinkage", z)
        return _log(z)

    @cached_property
    def _loads_by_depth(self) -> tuple[Array, Array]:
        """Depths (m) below the wheels, and the load (N) carried at each; both of shape (nodes, rows).

        A wheel that is sunk to its axle carries its load in the shares that it has at the axle.
        """
        assert self._solved is not None
        load, diameter, modulus, exponent = self._at
        sunk, width = self._solved.sunk_to_axle, self._conditions.width
        sinkage = np.where(sunk, AXLE_RATIO * diameter, self._solved.sinkage)
        depth, borne = loads_by_depth(sinkage, diameter, width, modulus, exponent)
        return depth, borne * np.where(sunk, load / borne.sum(axis=0), 1.0)


def _log(sinkage: Array) -> Array:
    return np.asarray(np.log(np.where(sinkage > 0.0, sinkage, np.nan)))
