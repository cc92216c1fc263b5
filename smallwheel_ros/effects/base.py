"""What a physical effect is, and the one class that each effect's file derives from.

An effect is a small frozen dataclass: its fields are its parameters, its methods are the places at
which it changes what the model computes. A model runs the stages in this order, each effect
in turn:

    geometry            the rule by which the contact is computed
    normal_load         the load that reaches the soil                        N      -> N
    wheel_diameter      the diameter that the soil meets                      m      -> m
    modulus_factor      multiplies k                                          1
    exponent_shift      adds to n                                             1
    pressure_factor     multiplies the pressure by a function of depth        1
      (the model solves load against pressure for the static sinkage)
    sinkage             changes the sinkage after the solve                   m      -> m
    compaction_sinkage  the depth to which soil is compacted (default: the same change)
    added_resistance    adds to the compaction resistance                     N
    thrust_factor       multiplies the thrust                                 1
    measured_sinkage    what the instrument shows of the sinkage              m      -> m

The first parameter of every effect is its strength: at 0 the effect is absent. Override only what
the effect changes. To write your own, copy a file of this folder.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import Field, dataclass, field, fields
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.conditions import Conditions
from smallwheel_ros.errors import SmallwheelError

Array = NDArray[np.float64]


class EffectError(SmallwheelError):
    """An effect that does not exist, cannot be loaded, or whose parameter is outside its domain."""


@dataclass(frozen=True)
class Parameter:
    """What is known of one parameter of an effect before any data."""

    name: str
    start: float
    bounds: tuple[float, float]
    published: tuple[float, float] | None
    unit: str
    description: str


def parameter(
    start: float,
    bounds: tuple[float, float],
    description: str,
    *,
    unit: str = "1",
    published: tuple[float, float] | None = None,
) -> Any:  # a dataclass field stands for a value of its annotated type
    """Declare a parameter of an effect: `a: float = parameter(1.0, (0.0, 8.0), "growth")`.

    start: value where a fit starts. bounds: what a fit may reach. published: the range that the
    literature gives (outside it a fitted value is called implausible), None where there is none.
    """
    return field(
        default=start,
        metadata={
            "bounds": bounds,
            "published": published,
            "unit": unit,
            "description": description,
        },
    )


class WheelState(NamedTuple):
    """The wheel in the soil after the solve; arrays of shape (rows,)."""

    load: Array  # N, what reaches the soil
    diameter: Array  # m
    width: Array  # m
    sinkage: Array  # m
    modulus: Array  # K = k D^m times the effects' factors, Pa/m^n
    exponent: Array  # n


@dataclass(frozen=True)
class Effect:
    """Base of every effect: class attributes describe it, fields are its parameters."""

    id: ClassVar[str] = ""  # the physical idea; forms of one idea share it
    form: ClassVar[str] = ""  # which published form of the idea this is
    summary: ClassVar[str] = ""  # one sentence for people
    formula: ClassVar[str] = ""
    source: ClassVar[str] = ""
    needs: ClassVar[tuple[str, ...]] = ()  # covariates that it reads
    channels: ClassVar[tuple[str, ...]] = ("sinkage", "resistance", "drawbar_pull")
    stage: ClassVar[str] = ""  # the first of the stages above that it acts at

    def __post_init__(self) -> None:
        for known in self.parameters():
            value = getattr(self, known.name)
            low, high = known.bounds
            if not (np.isfinite(value) and low <= value <= high):
                raise EffectError(
                    f"effect '{self.id}': {known.name} is {value!r}, "
                    f"expected {low:g} to {high:g} [{known.unit}]"
                )

    @classmethod
    def parameters(cls) -> tuple[Parameter, ...]:
        """The parameters in the order of the fields."""
        return tuple(cls._described(f) for f in fields(cls) if "bounds" in f.metadata)

    @staticmethod
    def _described(f: Field[Any]) -> Parameter:
        return Parameter(
            f.name,
            float(f.default),  # type: ignore[arg-type]  # parameter() always sets one
            f.metadata["bounds"],
            f.metadata["published"],
            f.metadata["unit"],
            f.metadata["description"],
        )

    def values(self) -> Iterator[tuple[str, float]]:
        """Name and value of each parameter."""
        for known in self.parameters():
            yield known.name, float(getattr(self, known.name))

    def geometry(self, rule: str) -> str:
        return rule

    def normal_load(self, load: Array, conditions: Conditions) -> Array:
        return load

    def wheel_diameter(self, diameter: Array, conditions: Conditions) -> Array:
        return diameter

    def modulus_factor(self, conditions: Conditions) -> Array | float:
        return 1.0

    def exponent_shift(self, conditions: Conditions) -> Array | float:
        return 0.0

    def pressure_factor(self, depth: Array, conditions: Conditions) -> Array:
        return np.ones_like(depth)

    def sinkage(self, sinkage: Array, conditions: Conditions) -> Array:
        return sinkage

    def compaction_sinkage(self, sinkage: Array, conditions: Conditions) -> Array:
        return self.sinkage(sinkage, conditions)

    def added_resistance(self, state: WheelState, conditions: Conditions) -> Array | float:
        return 0.0

    def thrust_factor(self, state: WheelState, conditions: Conditions) -> Array | float:
        return 1.0

    def measured_sinkage(self, sinkage: Array, conditions: Conditions) -> Array:
        return sinkage
