"""covariate:NAME and moisture: the modulus follows a recorded column."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from smallwheel_ros.conditions import Conditions
from smallwheel_ros.effects.base import Array, Effect, parameter


@dataclass(frozen=True)
class ExponentialLaw(Effect):
    form = "exponential"
    formula = "k exp(a (x - x0)/s)"
    source = "generic"
    stage = "modulus_factor"

    a: float = parameter(0.1, (-5.0, 5.0), "change of ln k per scale of the column")
    # Where the column is centred and by what it is scaled: taken from the data, not fitted.
    reference: float = field(default=0.0, kw_only=True)
    scale: float = field(default=1.0, kw_only=True)

    def modulus_factor(self, conditions: Conditions) -> Array:
        column = conditions[self.needs[0]]
        relative = np.nan_to_num((column - self.reference) / self.scale)
        return np.exp(self.a * relative)


@dataclass(frozen=True)
class PowerLaw(ExponentialLaw):
    form = "power"
    formula = "k (x/x0)^a, columns over 0 only"

    def modulus_factor(self, conditions: Conditions) -> Array:
        column = conditions[self.needs[0]]
        start = self.reference if self.reference > 0 else 1.0
        usable = np.where(np.isnan(column) | (column <= 0), start, column)
        return np.asarray((usable / start) ** self.a)


class Moisture(ExponentialLaw):
    id = "moisture"
    summary = "The modulus changes with the soil's water content."
    formula = "k exp(a (w - w0)/s)"
    needs = ("moisture",)


class MoisturePower(PowerLaw):
    id = "moisture"
    summary = Moisture.summary
    needs = ("moisture",)


def covariate(name: str) -> tuple[type[Effect], ...]:
    """The forms of the family `covariate:NAME` for a recorded column of that name."""
    described = {
        "id": f"covariate:{name}",
        "needs": (name,),
        "summary": f"The modulus follows the column '{name}'.",
    }
    return tuple(type(law.__name__, (law,), described) for law in (ExponentialLaw, PowerLaw))
