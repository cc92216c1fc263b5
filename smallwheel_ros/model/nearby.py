# SPDX-License-Identifier: Apache-2.0
"""Predictions at small changes of the soil's law and of the load, and derivatives from their differences.

Used with effects, whose derivatives have no formula; without effects `physics.contact` computes them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.effects.base import Effect
from smallwheel_ros.model.model import Model, Prediction, predict
from smallwheel_ros.physics.conditions import Conditions
from smallwheel_ros.physics.sinkage import Geometry
from smallwheel_ros.physics.soil import REFERENCE_DIAMETER, REFERENCE_SINKAGE, SOIL_NUMBERS, Soil

Array = NDArray[np.float64]
Shear = tuple[()] | tuple[float, float, float]

STEP = 1e-4  # of ln K, n, m, ln load and ln sinkage in central differences: error 1e-8
_LOG_DEPTH = math.log(REFERENCE_SINKAGE)


def neighbours(
    laws: Array,
    conditions: Conditions,
    effects: Sequence[Effect],
    shear: Shear = (),
    geometry: Geometry = "contact_integral",
) -> Prediction:
    """Predict wheels at their soil's parameters and load, and at slightly smaller and larger ones.

    `slopes` makes derivatives of the results, as central differences.

    Parameters
    ----------
    laws
        ln K, n and m of each row's soil, shape (rows, 3): of the pressure p = K z^n under a wheel with a
        diameter of `REFERENCE_DIAMETER`, K in Pa/m^n.
    conditions
        Settings of the wheels, SI units, shape (rows,) each.
    effects
        Effects of the model.
    shear
        Cohesion (Pa), friction angle (rad) and shear displacement (m) of all rows, for effects that use them;
        if empty, the defaults of `Soil`.
    geometry
        Rule of contact.

    Returns
    -------
    Prediction
        Without thrust, pull and torque. Its arrays have shape (9 * rows,), in blocks of (rows,): unchanged;
        with ln K, n, m, ln load lower by `STEP`, one in each block; with the same four higher by `STEP`.
        Where n is changed, ln K is changed with it so that the pressure at `REFERENCE_SINKAGE` stays the
        same.

    Raises
    ------
    SoilError
        If a changed k, n or m is outside the domain of a soil.
    ModelError, EffectError
        As by `model.predict`.
    """
    steps = STEP * np.eye(4)
    steps[1, 0] = -STEP * _LOG_DEPTH  # n turns about the reference sinkage
    at = np.column_stack([laws, np.log(conditions.load)])
    rows = np.concatenate([at, *(at - step for step in steps), *(at + step for step in steps)])
    log_modulus, n, m, log_load = rows.T
    law = {"k": np.exp(log_modulus - m * math.log(REFERENCE_DIAMETER)), "n": n, "m": m}
    for bound in (np.min, np.max):  # Soil refuses numbers outside its domain
        numbers = [float(bound(column)) for column in law.values()]
        own = Soil("estimated", numbers[0], numbers[1], numbers[2], *shear)
    soil = {name: np.full(len(rows), getattr(own, name)) for name in SOIL_NUMBERS} | law
    nine = conditions.take(np.tile(np.arange(len(conditions)), 9))
    nine = replace(nine, load=np.exp(log_load))
    return predict(Model([own], geometry, effects), nine, with_forces=False, soil=soil)


def slopes(column: Array) -> Array:
    """Derivatives of a quantity with respect to ln K, n, m and ln load (the others held), shape (4, rows).

    column: the quantity as `neighbours` predicts it, or a function of it, shape (9 * rows,).
    """
    around = column.reshape(9, -1)
    found: Array = (around[5:] - around[1:5]) / (2.0 * STEP)
    found[1] += _LOG_DEPTH * found[0]
    return found
