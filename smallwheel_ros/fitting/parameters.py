"""The parameters of a fit: which there are, what is known of them before, and the model they make.

A soil is fitted in numbers that behave: ln of the pressure at the reference sinkage and diameter, n
and m. k itself is the pressure at one metre, an extrapolation whose error is tied to n and m.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.effects.base import Effect
from smallwheel_ros.model import Model
from smallwheel_ros.physics.conditions import Conditions
from smallwheel_ros.physics.soil import Soil

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Field:
    """What is known of one parameter of a soil before any data. bounds are what a fit may reach."""

    name: str
    unit: str
    bounds: tuple[float, float]
    prior: tuple[float, float]  # mean and standard deviation: weak, only to keep a fit defined


# Prior means: the middle of what the soils of the library and of Wong (2008) show.
SOIL_FIELDS = (
    Field("log_reference_pressure", "ln Pa", (2.0, 20.0), (10.5, 3.0)),
    Field("n", "1", (0.05, 2.9), (0.9, 0.6)),
    Field("m", "1", (-3.0, 3.0), (0.0, 1.0)),
)
# Published: phi 28 to 42 deg, c 0.1 to 2 kPa, kappa 10 to 28 mm for small wheels (bounds 2 to 60
# mm).
THRUST_FIELDS = (
    Field("friction_angle", "rad", (0.1, 1.0), (0.56, 0.12)),
    Field("log_shear_displacement", "ln m", (-6.2, -2.8), (-4.2, 0.6)),
    Field("cohesion", "Pa", (0.0, 20e3), (700.0, 700.0)),
)

# What no simple law of thrust gets right, as shares of the load that are added to drawbar pull: a
# constant, one that turns over at zero slip, one that goes on with slip. Only a diagnosis uses
# them, so that an error of the thrust law does not pass for a missing effect of the soil.
CORRECTIONS = ("constant", "turning", "rising")
CORRECTION_PRIOR = 0.15
CORRECTION = "thrust_correction"


def correction_columns(conditions: Conditions) -> Array:
    """What a correction of 1 adds to drawbar pull, N: shape (rows, corrections)."""
    slip = conditions["slip"]
    return (
        np.column_stack([np.ones_like(slip), np.tanh(slip / 0.1), slip]) * conditions.load[:, None]
    )


@dataclass(frozen=True)
class Slot:
    """One free parameter: of which soil or effect, its bounds, and where the fit starts.

    A slot of owner -1 is a correction of thrust.
    """

    owner: int  # index into the model's soils, or effects
    of_effect: bool
    field: str
    start: float
    bounds: tuple[float, float]
    step: float  # of the finite difference
    unit: str


def soil_vector(soil: Soil) -> dict[str, float]:
    """The soil in the numbers that a fit works with."""
    return {
        "log_reference_pressure": soil.log_reference_pressure,
        "n": soil.n,
        "m": soil.m,
        "friction_angle": soil.friction_angle,
        "log_shear_displacement": float(np.log(soil.shear_displacement)),
        "cohesion": soil.cohesion,
    }


def soil_from(soil: Soil, values: Mapping[str, float]) -> Soil:
    """The soil with these of its numbers replaced."""
    v = soil_vector(soil) | dict(values)
    return replace(
        soil.with_parameters(v["log_reference_pressure"], v["n"], v["m"]),
        friction_angle=v["friction_angle"],
        shear_displacement=float(np.exp(v["log_shear_displacement"])),
        cohesion=v["cohesion"],
    )


@dataclass(frozen=True)
class SoilPrior:
    """A soil that is known from elsewhere: its mean, and the covariance of (ln p_ref, n, m), shape (3, 3)."""

    soil: Soil
    covariance: Array


@dataclass(frozen=True)
class Layout:
    """The free parameters of a model, with the Gaussian prior N(centre, inverse of precision).

    start, low, high, centre: shape (parameters,). precision: shape (parameters, parameters).
    """

    model: Model
    slots: tuple[Slot, ...]
    low: Array
    high: Array
    centre: Array
    precision: Array

    @property
    def start(self) -> Array:
        """Where the fit starts, shape (parameters,)."""
        return np.array([slot.start for slot in self.slots])

    @property
    def names(self) -> tuple[str, ...]:
        """`dry_sand.n`, `slip_sinkage.a`: unique, since a model holds an effect once."""
        return tuple(f"{self.owner_name(s)}.{s.field}" for s in self.slots)

    def owner_name(self, slot: Slot) -> str:
        """The soil or effect that a parameter belongs to."""
        if slot.owner < 0:
            return CORRECTION
        if slot.of_effect:
            return self.model.effects[slot.owner].id
        return self.model.soils[slot.owner].name

    def base(self) -> NDArray[np.bool_]:
        """Mask of the parameters that are the soils'."""
        return np.array([not slot.of_effect for slot in self.slots], dtype=bool)

    def only(self, keep: NDArray[np.bool_]) -> Layout:
        """The layout with these of its parameters; the others stay where the model has them."""
        slots = tuple(slot for slot, kept in zip(self.slots, keep, strict=True) if kept)
        return Layout(
            self.model,
            slots,
            self.low[keep],
            self.high[keep],
            self.centre[keep],
            self.precision[np.ix_(keep, keep)],
        )

    def model_at(self, theta: Array) -> Model:
        """The model with the parameters theta, shape (parameters,)."""
        soil_values: dict[int, dict[str, float]] = {}
        effect_values: dict[int, dict[str, float]] = {}
        for slot, value in zip(self.slots, theta, strict=True):
            if slot.owner < 0:
                continue
            store = effect_values if slot.of_effect else soil_values
            store.setdefault(slot.owner, {})[slot.field] = float(value)
        soils = [
            soil_from(s, soil_values[i]) if i in soil_values else s
            for i, s in enumerate(self.model.soils)
        ]
        effects = [
            replace(e, **effect_values[i]) if i in effect_values else e
            for i, e in enumerate(self.model.effects)
        ]
        return replace_model(self.model, soils, effects)


def replace_model(model: Model, soils: Sequence[Soil], effects: Sequence[Effect]) -> Model:
    """The same geometry and thrust law with other soils and effects."""
    return Model(soils, model.geometry, effects, model.thrust_form)
