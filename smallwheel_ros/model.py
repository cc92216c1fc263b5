"""A model of wheel and soil: soils, a geometry rule, and effects, composed with `+`.

model = Model(soil("dry_sand")) + SlipSinkage(a=1.2)
prediction = predict(model, Conditions.of(load=60, diameter=0.2, width=0.1, slip=0.3))
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.conditions import PLATE, PRESSED, ROLLING, Conditions
from smallwheel_ros.contact import contact_sinkage
from smallwheel_ros.effects.base import Effect, WheelState
from smallwheel_ros.errors import SmallwheelError
from smallwheel_ros.sinkage import (
    closed_form_sinkage,
    layered_load,
    plate_sinkage,
    solve_layered,
    sunk_to_axle,
)
from smallwheel_ros.soil import Soil, effective_modulus, nearest
from smallwheel_ros.traction import ThrustForm, compaction_resistance, thrust

Array = NDArray[np.float64]
Geometry = Literal["contact_integral", "closed_form"]


class ModelError(SmallwheelError):
    """A model that cannot predict these conditions."""


@dataclass(frozen=True)
class Model:
    """Soils, geometry rule and effects in the order in which they act.

    With one soil, it holds for every row; with several, a row's `soil` picks by name.
    """

    soils: tuple[Soil, ...]
    geometry: Geometry = "contact_integral"
    effects: tuple[Effect, ...] = ()
    thrust_form: ThrustForm = "integrated"

    def __init__(
        self,
        soils: Soil | Sequence[Soil],
        geometry: Geometry = "contact_integral",
        effects: Sequence[Effect] = (),
        thrust_form: ThrustForm = "integrated",
    ) -> None:
        object.__setattr__(self, "soils", (soils,) if isinstance(soils, Soil) else tuple(soils))
        object.__setattr__(self, "geometry", geometry)
        object.__setattr__(self, "effects", tuple(effects))
        object.__setattr__(self, "thrust_form", thrust_form)

    def __add__(self, effect: Effect) -> Model:
        return replace(self, effects=(*self.effects, effect))

    @property
    def contact_rule(self) -> str:
        """The geometry rule after the effects had their say."""
        rule: str = self.geometry
        for effect in self.effects:
            rule = effect.geometry(rule)
        return rule

    def missing_covariates(self, conditions: Conditions) -> dict[str, list[str]]:
        """By effect, the covariates that it needs and that the conditions do not have."""
        lacks = {
            effect.id: [name for name in effect.needs if name not in conditions]
            for effect in self.effects
        }
        return {effect: names for effect, names in lacks.items() if names}


@dataclass(frozen=True)
class Prediction:
    """What the model says of each row; arrays of shape (rows,), SI units.

    sinkage is what the instrument would show. resistance is all of it, compaction_resistance the
    share of compaction. thrust and drawbar_pull are None where the conditions have no slip. Where
    `immobilised` (sunk to the axle) the numbers are a continuation for fits, not predictions.
    """

    sinkage: Array
    compaction_resistance: Array
    resistance: Array
    thrust: Array | None
    drawbar_pull: Array | None
    immobilised: NDArray[np.bool_]


def _soil_columns(model: Model, conditions: Conditions) -> dict[str, Array]:
    """Each soil parameter, one value per row (or one for all where there is one soil)."""
    names = ("k", "n", "m", "cohesion", "friction_angle", "shear_displacement")
    if len(model.soils) == 1:
        rows = np.zeros(len(conditions), dtype=np.intp)
    else:
        known = [s.name for s in model.soils]
        if conditions.soil is None:
            raise ModelError(
                f"the model has several soils ({', '.join(known)}) and the rows name none"
            )
        present = np.unique(conditions.soil)
        unknown = [str(name) for name in present if name not in known]
        if unknown:
            raise ModelError(f"the model has no soil '{unknown[0]}': {nearest(unknown[0], known)}")
        order = np.argsort(known)
        rows = order[np.searchsorted(np.asarray(known)[order], conditions.soil)]
    return {name: np.array([getattr(s, name) for s in model.soils])[rows] for name in names}


def _static_sinkage(
    model: Model, conditions: Conditions, load: Array, diameter: Array, modulus: Array, n: Array
) -> tuple[Array, NDArray[np.bool_]]:
    """Sinkage that carries the load, by each row's contact, before any digging."""
    plate = conditions.contact == PLATE
    # A pressed wheel meets the soil on both sides of its lowest point: each side carries half.
    carried = np.where(conditions.contact == PRESSED, 0.5 * load, load)
    width = np.where(plate, diameter, conditions.width)
    shaping = [e for e in model.effects if type(e).pressure_factor is not Effect.pressure_factor]
    if shaping:
        z, sunk = _layered_sinkage(shaping, conditions, carried, diameter, width, modulus, n)
    elif model.contact_rule == "closed_form":
        z = closed_form_sinkage(carried, diameter, width, modulus, n)
        sunk = sunk_to_axle(z, diameter)
    else:
        solved = contact_sinkage(carried, diameter, width, modulus, n)
        z, sunk = solved.sinkage, solved.sunk_to_axle
    if plate.any() and not shaping:
        z = np.where(plate, plate_sinkage(load, diameter, modulus, n), z)
    return z, sunk & ~plate


def _layered_sinkage(
    shaping: list[Effect],
    conditions: Conditions,
    load: Array,
    diameter: Array,
    width: Array,
    modulus: Array,
    n: Array,
) -> tuple[Array, NDArray[np.bool_]]:
    def factor(depth: Array) -> Array:
        product = np.ones_like(depth)
        for effect in shaping:
            product = product * effect.pressure_factor(depth, conditions)
        return product

    plate = conditions.contact == PLATE

    def load_at(z: Array) -> Array:
        on_wheel = layered_load(z, diameter, width, modulus, n, factor)
        if not plate.any():
            return on_wheel
        on_plate = np.pi / 4.0 * diameter**2 * modulus * z**n * factor(z)
        return np.where(plate, on_plate, on_wheel)

    return solve_layered(load, 0.5 * diameter, load_at)


def predict(model: Model, conditions: Conditions) -> Prediction:
    """Predict sinkage, resistance and drawbar pull of each row.

    Raises ModelError where an effect's covariate is missing or a row's soil is not the model's.
    """
    lacking = model.missing_covariates(conditions)
    if lacking:
        name, columns = next(iter(lacking.items()))
        there = ", ".join(("load", "diameter", "width", *conditions.covariates))
        raise ModelError(f"effect '{name}' needs the column '{columns[0]}'. There is: {there}")
    soil = _soil_columns(model, conditions)
    load, diameter = conditions.load, conditions.diameter
    for effect in model.effects:
        load = effect.normal_load(load, conditions)
        diameter = effect.wheel_diameter(diameter, conditions)
    modulus, n = effective_modulus(soil["k"], soil["m"], diameter), soil["n"]
    for effect in model.effects:
        modulus = modulus * effect.modulus_factor(conditions)
        n = n + effect.exponent_shift(conditions)
    z, sunk = _static_sinkage(model, conditions, load, diameter, modulus, n)
    compacted = z
    rolling = conditions.contact == ROLLING
    for effect in model.effects:
        # What digs or compacts further does so because the wheel rolls; a pressed body does not.
        z = np.where(rolling, effect.sinkage(z, conditions), z)
        compacted = np.where(rolling, effect.compaction_sinkage(compacted, conditions), compacted)
    compaction = np.where(
        rolling, compaction_resistance(compacted, conditions.width, modulus, n), 0.0
    )
    state = WheelState(load, diameter, conditions.width, z, modulus, n)
    added = np.zeros(len(conditions))
    for effect in model.effects:
        added = added + np.where(rolling, effect.added_resistance(state, conditions), 0.0)
    resistance = compaction + added
    push: Array | None = None
    if "slip" in conditions:
        push = thrust(
            load,
            conditions["slip"],
            z,
            diameter,
            conditions.width,
            soil["cohesion"],
            soil["friction_angle"],
            soil["shear_displacement"],
            model.thrust_form,
        )
        for effect in model.effects:
            push = push * effect.thrust_factor(state, conditions)
    immobilised = sunk | (sunk_to_axle(z, diameter) & (conditions.contact != PLATE))
    for effect in model.effects:
        z = effect.measured_sinkage(z, conditions)
    return Prediction(
        z,
        compaction,
        resistance,
        push,
        None if push is None else push - resistance,
        immobilised,
    )
