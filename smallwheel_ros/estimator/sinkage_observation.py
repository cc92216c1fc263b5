# SPDX-License-Identifier: Apache-2.0
"""The estimator's measurement model: sinkage or resistance of one wheel, with slopes by the soil.

The soil enters as s, ln of the pressure at the reference sinkage under *this* wheel, and n: sinkage
depends on k, m and the soil's scatter through s alone.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.effects.base import Effect
from smallwheel_ros.estimator.point_sinkage import point_sinkage
from smallwheel_ros.model import Model, predict
from smallwheel_ros.physics.conditions import PRESSED, ROLLING, Conditions
from smallwheel_ros.physics.soil import REFERENCE_DIAMETER, REFERENCE_SINKAGE, Soil
from smallwheel_ros.stages import Stages

Array = NDArray[np.float64]

LOG_REFERENCE_SINKAGE = math.log(REFERENCE_SINKAGE)
_STEP = 1e-4  # of ln z, s and n in central differences: error 1e-8


class Observed(NamedTuple):
    """What the instrument would show (m or N), with its slopes by s, by n and by ln load."""

    value: float
    by_pressure: float
    by_exponent: float
    by_load: float
    sunk_to_axle: bool


class Observation(Protocol):
    """One wheel under one load; `diameter_log`: ln of its diameter over the reference.

    wheel: load (N), diameter and width (m) of the plain rolling wheel that it comes nearest to.
    """

    diameter_log: float
    wheel: tuple[float, float, float]

    def __call__(self, log_pressure: float, exponent: float) -> Observed:
        """What is shown in a soil. Raises ArithmeticError or ValueError where there is nothing."""


class _Plain:
    """A rolling or pressed wheel without effects."""

    __slots__ = "diameter_log", "wheel"

    def __init__(self, load: float, diameter: float, width: float, contact: str) -> None:
        if contact == PRESSED:
            load *= 0.5  # it meets the soil on both sides of its lowest point: each carries half
        self.wheel = load, diameter, width
        self.diameter_log = math.log(diameter / REFERENCE_DIAMETER)

    def __call__(self, log_pressure: float, exponent: float) -> Observed:
        log_modulus = log_pressure - exponent * LOG_REFERENCE_SINKAGE
        found = point_sinkage(*self.wheel, log_modulus, exponent)
        log_z, slope_load, slope_exponent, sunk = found
        z = math.exp(log_z)
        by_exponent = z * (slope_exponent + slope_load * LOG_REFERENCE_SINKAGE)
        return Observed(z, -z * slope_load, by_exponent, z * slope_load, sunk)


class _WithEffects:
    """A wheel with effects that leave pressure a power of depth; order of `model.predict`."""

    def __init__(self, effects: Sequence[Effect], conditions: Conditions) -> None:
        conditions = Stages(effects, conditions).conditions  # with the load itself
        load, diameter = conditions.load, conditions.diameter
        for effect in effects:
            load = effect.normal_load(load, conditions)
            diameter = effect.wheel_diameter(diameter, conditions)
        factor: Array = np.ones(1)
        shift: Array = np.zeros(1)
        for effect in effects:
            factor = factor * effect.modulus_factor(conditions)
            shift = shift + effect.exponent_shift(conditions)
        self.log_factor, self.shift = math.log(float(factor[0])), float(shift[0])
        self.rolling = str(conditions.contact[0]) == ROLLING
        self.plain = _Plain(
            float(load[0]),
            float(diameter[0]),
            float(conditions.width[0]),
            str(conditions.contact[0]),
        )
        self.diameter_log, self.wheel = self.plain.diameter_log, self.plain.wheel
        self.digging = [e for e in effects if type(e).sinkage is not Effect.sinkage]
        self.showing = [
            e for e in effects if type(e).measured_sinkage is not Effect.measured_sinkage
        ]
        self.three = conditions.take(np.zeros(3, dtype=np.intp))

    def __call__(self, log_pressure: float, exponent: float) -> Observed:
        # The pressure at the reference sinkage, with the exponent and the modulus as shifted.
        shifted = log_pressure + self.log_factor + self.shift * LOG_REFERENCE_SINKAGE
        return self._shown(self.plain(shifted, exponent + self.shift))

    def _shown(self, static: Observed) -> Observed:
        """Let the wheel dig, and the instrument show what it shows."""
        if not (self.digging and self.rolling) and not self.showing:
            return static
        z = static.value * np.array([1.0 - _STEP, 1.0, 1.0 + _STEP])
        if self.rolling:
            for effect in self.digging:
                z = effect.sinkage(z, self.three)
        for effect in self.showing:
            z = effect.measured_sinkage(z, self.three)
        slope = float(z[2] - z[0]) / (2.0 * _STEP * static.value)
        shown = float(z[1])
        sunk = static.sunk_to_axle or shown > 0.5 * self.wheel[1]
        return Observed(
            shown,
            static.by_pressure * slope,
            static.by_exponent * slope,
            static.by_load * slope,
            sunk,
        )


class _Layered(Observation):
    """Any effects at all, by `model.predict` and central differences: a hundred times slower."""

    def __init__(self, effects: Sequence[Effect], conditions: Conditions) -> None:
        diameter = conditions.diameter
        for effect in effects:
            diameter = effect.wheel_diameter(diameter, conditions)
        self.effects = tuple(effects)
        plain = _Plain(
            float(Stages(effects, conditions).conditions.load[0]),
            float(diameter[0]),
            float(conditions.width[0]),
            str(conditions.contact[0]),
        )
        self.diameter_log, self.wheel = plain.diameter_log, plain.wheel
        rows = conditions.take(np.zeros(7, dtype=np.intp))
        self.conditions = Conditions(
            rows.load * np.exp(np.array([0.0, 0.0, 0.0, 0.0, 0.0, -_STEP, _STEP])),
            rows.diameter,
            rows.width,
            rows.contact,
            np.array([str(i) for i in range(7)]),
            rows.covariates,
        )

    def __call__(self, log_pressure: float, exponent: float) -> Observed:
        still = (0.0, 0.0)
        steps = (still, (-_STEP, 0.0), (_STEP, 0.0), (0.0, -_STEP), (0.0, _STEP), still, still)
        soils = [
            Soil(
                str(i),
                math.exp(log_pressure + ds - (exponent + dn) * LOG_REFERENCE_SINKAGE),
                exponent + dn,
            )
            for i, (ds, dn) in enumerate(steps)
        ]
        predicted = predict(Model(soils, effects=self.effects), self.conditions)
        z = predicted.sinkage
        return Observed(
            float(z[0]),
            float(z[2] - z[1]) / (2.0 * _STEP),
            float(z[4] - z[3]) / (2.0 * _STEP),
            float(z[6] - z[5]) / (2.0 * _STEP),
            bool(predicted.immobilised[0]),
        )


def observation(
    effects: Sequence[Effect],
    load: float,
    diameter: float,
    width: float,
    contact: str,
    slip: float | None,
    speed: float | None,
) -> Observation:
    """Describe a wheel's sinkage under a load, with the covariates that the effects need."""
    if not effects:
        return _Plain(load, diameter, width, contact)
    covariates = {"slip": slip, "speed": speed}
    conditions = Conditions(
        np.array([load]),
        np.array([diameter]),
        np.array([width]),
        np.array([contact]),
        None,
        {name: np.array([value]) for name, value in covariates.items() if value is not None},
    )
    if any(type(e).pressure_factor is not Effect.pressure_factor for e in effects):
        return _Layered(effects, conditions)
    return _WithEffects(effects, conditions)
