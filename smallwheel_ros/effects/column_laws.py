# SPDX-License-Identifier: Apache-2.0
"""Laws of one recorded column: k that depends on it (`moisture`, `covariate:NAME`), zeros that drift with it.

To find the influence of a column that changes only from run to run, as moisture does, takes at least 8 runs
with different values.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from smallwheel_ros.effects.base import Array, Effect, constant, parameter
from smallwheel_ros.physics.conditions import Conditions

_ANY = (-1e12, 1e12)
_POSITIVE = (1e-12, 1e12)


class ColumnLaw(Effect):
    """A law that depends on the one column in `needs`.

    Attributes
    ----------
    prefix
        Set for a form that any column NAME of the data can drive: its id is then `PREFIX:NAME`, and {} in
        its `summary` and `next_step` is replaced by NAME. Empty for a form of a fixed column.
    """

    prefix: ClassVar[str] = ""

    @classmethod
    def column(cls, conditions: Conditions) -> Array:
        """Values of the column, in its unit, shape (rows,)."""
        return conditions[cls.needs[0]]

    @classmethod
    def known(cls, conditions: Conditions) -> Array:
        """Values of the column that are not blank, shape (values,)."""
        values = cls.column(conditions)
        return np.asarray(values[np.isfinite(values)])


class _Covariate(ColumnLaw):
    prefix = "covariate"
    summary = "The soil's modulus k depends on column '{}'."
    source = "empirical"
    next_step = "Vary '{}' alone, at one load and one slip, in eight runs or more."


def _span(values: Array) -> dict[str, float]:
    """Constants `reference` and `scale` of a law: middle and half the range of the column's values."""
    low, high = float(values.min()), float(values.max())
    # A column that does not vary has no influence to be found: any scale will do.
    scale = 0.5 * (high - low) if high > low else max(abs(high), 1.0)
    return {"reference": 0.5 * (low + high), "scale": scale}


@dataclass(frozen=True)
class ExponentialLaw(_Covariate):
    """Exponential growth of k with a column w: k = k0 exp(a (w - reference) / scale)."""

    form = "exponential"
    formula = "k = k0 exp(a (w - reference) / scale)"

    a: float = parameter(0.2, (-6.0, 6.0), "growth of ln k over one scale of the column")
    reference: float = constant(0.0, _ANY, "value of the column at which k is k0")
    scale: float = constant(1.0, _POSITIVE, "difference in the column that changes ln k by a")

    @classmethod
    def suited_to(cls, conditions: Conditions) -> Effect:
        """Set reference and scale to the middle and half the range of the column."""
        values = cls.known(conditions)
        return cls(**_span(values)) if values.size else cls()

    def modulus_factor(self, conditions: Conditions) -> Array:
        return np.exp(self.a * (self.column(conditions) - self.reference) / self.scale)


@dataclass(frozen=True)
class PowerLaw(_Covariate):
    """Power law of k over a column w of positive values: k = k0 (w / reference)^p."""

    form = "power"
    formula = "k = k0 (w / reference)^p, w > 0"

    p: float = parameter(0.2, (-30.0, 30.0), "growth of ln k with ln of the column")
    reference: float = constant(1.0, _POSITIVE, "value of the column at which k is k0")

    @classmethod
    def suited_to(cls, conditions: Conditions) -> Effect:
        """Set the reference to the column's geometric mean; keep the default if a value is not above 0."""
        values = cls.known(conditions)
        if values.size == 0 or values.min() <= 0:
            return cls()
        return cls(reference=float(np.exp(np.mean(np.log(values)))))

    def objection(self, conditions: Conditions) -> str:
        values = self.column(conditions)
        bad = np.flatnonzero((conditions.rolling) & (values <= 0.0))
        if bad.size:
            return (
                f"its power law needs values over 0 in column '{self.needs[0]}', "
                f"row {bad[0] + 1} has {values[bad[0]]:.6g}; take form 'exponential'"
            )
        return ""

    def modulus_factor(self, conditions: Conditions) -> Array:
        ratio = self.column(conditions) / self.reference
        return np.asarray(np.where(ratio > 0.0, ratio, np.nan) ** self.p)


class _Moisture(ColumnLaw):
    id = "moisture"
    summary = "The soil's modulus k depends on its water content."
    needs = ("moisture",)
    next_step = (
        "Prepare beds of at least three water contents and run each at one load and one slip."
    )


@dataclass(frozen=True)
class Exponential(_Moisture, ExponentialLaw):
    """Exponential growth of k with the water content w: k = k0 exp(a (w - reference) / scale)."""

    a: float = parameter(0.2, (-6.0, 6.0), "growth of ln k over one scale of moisture")
    reference: float = constant(0.10, (-1e6, 1e6), "moisture at which k is k0")
    scale: float = constant(0.05, (1e-12, 1e6), "difference in moisture that changes ln k by a")


@dataclass(frozen=True)
class Power(_Moisture, PowerLaw):
    """Power law of k over the water content w: k = k0 (w / reference)^p."""

    p: float = parameter(0.2, (-30.0, 30.0), "growth of ln k with ln moisture")
    reference: float = constant(0.10, (1e-12, 1e6), "moisture at which k is k0")


@dataclass(frozen=True)
class Optimum(_Moisture):
    """k with a maximum at one water content: menisci bind grains, water that fills the pores does not."""

    # J. Geotech. Eng. 110(9), known from secondary sources.
    form = "optimum"
    formula = "k = k0 exp(-fall (x - optimum)^2), x = (w - reference) / scale"
    source = "Wu, Gray and Richart 1984 (unverified): stiffest at 5 to 20 % of saturation"

    fall: float = parameter(0.3, (0.0, 6.0), "fall of ln k one scale away from the optimum")
    optimum: float = parameter(
        0.0, (-1.0, 1.0), "where k is largest, in scales from the reference", neutral=None
    )
    reference: float = constant(0.10, (-1e6, 1e6), "moisture from which the optimum is counted")
    scale: float = constant(0.05, (1e-12, 1e6), "difference in moisture that it is counted in")

    @classmethod
    def suited_to(cls, conditions: Conditions) -> Effect:
        """Set reference and scale to the middle and half the range of the column."""
        values = cls.known(conditions)
        return cls(**_span(values)) if values.size else cls()

    def modulus_factor(self, conditions: Conditions) -> Array:
        at = (self.column(conditions) - self.reference) / self.scale
        return np.exp(-self.fall * (at - self.optimum) ** 2)


@dataclass(frozen=True)
class _Drift(ColumnLaw):
    """An instrument's zero that drifts linearly with a column."""

    form = "even"
    kind = "instrument"
    source = "the first order of any slow change"

    reference: float = constant(0.0, _ANY, "value of the column at which the zero is right")
    scale: float = constant(
        1.0, _POSITIVE, "difference in the column over which it moves by `drift`"
    )

    @classmethod
    def suited_to(cls, conditions: Conditions) -> Effect:
        """Set the reference to the column's lowest value and the scale to its range."""
        values = cls.known(conditions)
        if values.size == 0 or np.ptp(values) == 0.0:
            return cls()
        return cls(reference=float(values.min()), scale=float(np.ptp(values)))

    def share(self, conditions: Conditions) -> Array:
        """Part of `drift` that each row has, (w - reference) / scale, shape (rows,)."""
        return np.asarray((self.column(conditions) - self.reference) / self.scale)


@dataclass(frozen=True)
class SinkageDrift(_Drift):
    """The sinkage instrument's zero drifts."""

    prefix = "sinkage_drift"
    summary = "The zero of the sinkage instrument drifts with '{}'."
    formula = "shown z = z + drift (w - reference) / scale"
    next_step = (
        "Take the zero of sinkage at touch-down before each run; repeat the first run at the end."
    )

    drift: float = parameter(0.001, (-0.05, 0.05), "what the zero moves by", unit="m")

    def measured_sinkage(self, sinkage: Array, conditions: Conditions) -> Array:
        return np.asarray(sinkage + self.drift * self.share(conditions))


@dataclass(frozen=True)
class ResistanceDrift(_Drift):
    """The force sensor's zero drifts."""

    prefix = "resistance_drift"
    summary = "The zero of the force sensor drifts with '{}'."
    formula = "shown R = R + drift (w - reference) / scale"
    next_step = (
        "Read the force sensor with the wheel lifted before each run; "
        "repeat the first run at the end."
    )

    drift: float = parameter(1.0, (-1e3, 1e3), "what the zero moves by", unit="N")

    def measured_resistance(self, resistance: Array, conditions: Conditions) -> Array:
        return np.asarray(resistance + self.drift * self.share(conditions))
