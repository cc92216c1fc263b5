# SPDX-License-Identifier: Apache-2.0
"""What is missing and has no name: a smooth of one setting at one stage of the model.

    ln factor = sum over j of c_j P_j(x),  c_j ~ N(0, s_j^2)

with Legendre polynomials of the setting, scaled to -1 .. 1. Slip, slip angle, pass number and the like
have a value at which they do nothing: such a curve is one-sided and anchored there.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.effects.base import Effect, WheelState
from smallwheel_ros.fitting.constants import CURVE_SIZE
from smallwheel_ros.fitting.fit import Fit
from smallwheel_ros.fitting.parameters import EffectPart, FreeParameter, Prior
from smallwheel_ros.physics.conditions import Conditions
from smallwheel_ros.physics.traction import compaction_resistance

Array = NDArray[np.float64]

# Where a setting does nothing to a rolling wheel.
ANCHORS = {"slip": 0.0, "slip_angle": 0.0, "slope": 0.0, "pass_number": 1.0, "grouser_height": 0.0}
_LARGEST = 5.0  # of ln factor: e^5 is two decades
_POINTS = 25  # of a curve that is shown
_DRAG = 0.25  # of the load: what small wheels on loose soil resist with, 0.1 to 0.4 of it
_FALLS = (1.0, 0.5, 0.375)  # of the higher terms: curves are smooth


# Legendre polynomials written out: numpy's own cost more than the rest of a prediction.
_LEGENDRE: tuple[Callable[[Array], Array], ...] = (
    np.ones_like,
    lambda u: u,
    lambda u: 1.5 * u * u - 0.5,
    lambda u: (2.5 * u * u - 1.5) * u,
)


@dataclass(frozen=True)
class Span:
    """The setting that a curve follows. middle, half: its scale. side: 0, or the sign of an anchored one."""

    column: str
    middle: float
    half: float
    side: int = 0

    @property
    def text(self) -> str:
        """`slip`, `slip < 0`."""
        return f"{self.column} < 0" if self.side < 0 else self.column

    def scaled(self, values: Array) -> Array:
        """The setting scaled to -1 .. 1; one-sided, 0 at the anchor to 1 at its largest."""
        x = np.nan_to_num((values - self.middle) / self.half)
        return np.clip(self.side * x, 0.0, 1.2) if self.side else np.clip(x, -1.2, 1.2)


def _series(coefficients: Mapping[str, Any], span: Span, x: Array) -> Array:
    """The curve at scaled settings x; names are `c0`, `c1`, ... ."""
    u = 2.0 * x - 1.0 if span.side else x
    total: Array = np.zeros_like(x)
    for name, c in coefficients.items():
        degree = int(name[1:])
        start = (-1.0) ** degree if span.side else 0.0  # P_j(-1): nothing at the anchor
        total = total + np.asarray(c) * (_LEGENDRE[degree](u) - start)
    return np.clip(total, -_LARGEST, _LARGEST)


@dataclass(frozen=True)
class Curve(Effect):
    """A smooth of one setting; its subclasses say at which stage. size: N or m, of one that is added."""

    id: ClassVar[str] = "unknown"
    span: Span = field(default=Span("load", 0.0, 1.0))
    coefficients: Mapping[str, Any] = field(default_factory=dict)
    size: float = 1.0

    def __post_init__(self) -> None:
        """Coefficients have no bounds to check."""

    def log_factor(self, conditions: Conditions) -> Array:
        """ln of the factor on each row."""
        x = self.span.scaled(conditions[self.span.column])
        return _series(self.coefficients, self.span, x)


class AtModulus(Curve):
    """The soil's stiffness follows the setting."""

    def modulus_factor(self, conditions: Conditions) -> Array:
        return np.exp(self.log_factor(conditions))


class AtSinkage(Curve):
    """The wheel digs: sinkage follows the setting, and resistance with it."""

    def sinkage(self, sinkage: Array, conditions: Conditions) -> Array:
        return np.asarray(sinkage * np.exp(self.log_factor(conditions)))


class AtShownSinkage(Curve):
    """What is shown, or dug without compaction: sinkage alone follows the setting."""

    def measured_sinkage(self, sinkage: Array, conditions: Conditions) -> Array:
        return np.where(conditions.rolling, sinkage * np.exp(self.log_factor(conditions)), sinkage)


class AtResistance(Curve):
    """Resistance alone follows the setting, as a share of what compaction costs."""

    def added_resistance(self, state: WheelState, conditions: Conditions) -> Array:
        work = compaction_resistance(
            np.maximum(state.sinkage, 0.0), state.width, state.modulus, state.exponent
        )
        return np.where(conditions.rolling, work * np.expm1(self.log_factor(conditions)), 0.0)


class AtDrag(Curve):
    """Something drags besides compaction: a force that is a share of the load and follows the setting."""

    def added_resistance(self, state: WheelState, conditions: Conditions) -> Array:
        return np.where(conditions.rolling, _DRAG * state.load * self.log_factor(conditions), 0.0)


class AtForce(Curve):
    """The same, whatever the load: a force that follows the setting alone."""

    def measured_resistance(self, resistance: Array, conditions: Conditions) -> Array:
        return np.asarray(resistance + _DRAG * self.size * self.log_factor(conditions))


class AtHeight(Curve):
    """The wheel's height is shown wrong, or lifted, by a length that follows the setting alone."""

    def measured_sinkage(self, sinkage: Array, conditions: Conditions) -> Array:
        return np.asarray(sinkage + self.size * self.log_factor(conditions))


class AtDepth(Curve):
    """Pressure is no power of depth. span.middle, half: of ln depth."""

    def pressure_factor(self, depth: Array, conditions: Conditions) -> Array:
        x = (np.log(np.maximum(depth, 1e-7)) - self.span.middle) / self.span.half
        return np.exp(_series(self.coefficients, self.span, np.clip(x, -1.5, 1.2)))


STAGES: dict[str, type[Curve]] = {
    "stiffness": AtModulus,
    "sinkage": AtSinkage,
    "shown sinkage": AtShownSinkage,
    "resistance": AtResistance,
    "drag": AtDrag,
    "force": AtForce,
    "height": AtHeight,
    "pressure": AtDepth,
}
UNITS = {"force": "N", "height": "m"}  # of a curve that is added
# Stages of named effects that such a curve is the most general form of.
GENERALISES = {
    "stiffness": ("modulus_factor", "exponent_shift"),
    "sinkage": ("sinkage",),
    "shown sinkage": ("measured_sinkage", "sinkage"),
    "resistance": ("added_resistance", "measured_resistance"),
    "drag": ("added_resistance",),
    "force": ("measured_resistance",),
    "height": ("measured_sinkage",),
    "pressure": ("pressure_factor",),
}


def curve_part(
    name: str, stage: str, span: Span, first: int, terms: int, size: float = 1.0
) -> EffectPart:
    """A curve as a part of a fit, with terms of degree `first` on. size: N or m, of one that is added."""
    kind = STAGES[stage]
    deviations = [CURVE_SIZE * fall for fall in _FALLS]
    if first == 0:
        deviations = [CURVE_SIZE, *deviations]
    priors = [Prior(0.0, deviation, -_LARGEST, _LARGEST) for deviation in deviations[:terms]]
    listed = [FreeParameter(name, f"c{first + i}", 0.0, "1", p) for i, p in enumerate(priors)]
    return EffectPart(
        name, tuple(listed), lambda numbers: kind(span=span, coefficients=numbers, size=size)
    )


def spans_of(column: str, values: Array) -> list[Span]:
    """The spans over which a setting varies: one, or one on each side of its anchor."""
    low, high = float(values.min()), float(values.max())
    if column not in ANCHORS:
        return [Span(column, 0.5 * (low + high), 0.5 * (high - low))]
    anchor = ANCHORS[column]
    found = []
    for side in (1, -1):
        reach = float(np.max(side * (values - anchor)))
        if reach > 0.05 * (high - low):
            found.append(Span(column, anchor, reach, side))
    return found


def distinct(values: Array, span: Span) -> int:
    """How many settings of a span were met, to a hundredth of it: as many terms a curve may have."""
    x = (values - span.middle) / span.half
    if not span.side:
        return int(np.unique(np.round(x, 2)).size) - 1
    x = span.side * x
    return int(np.unique(np.round(x[x > 1e-9], 2)).size)


def curve_shown(
    part: EffectPart, stage: str, span: Span, values: Array, fit: Fit
) -> dict[str, Any]:
    """A fitted curve: factor over the setting, with its 95 % band. values: of the setting, met."""
    mine = values if not span.side else values[span.side * (values - span.middle) >= 0]
    x = np.linspace(float(mine.min()), float(mine.max()), _POINTS, dtype=np.float64)
    at, u = fit.vector.places(part.id), span.scaled(x)
    basis = np.column_stack([_series({p.field: 1.0}, span, u) for p in part.parameters])
    middle = basis @ fit.theta[at]
    spread = 1.96 * np.sqrt(np.einsum("ij,jk,ik->i", basis, fit.covariance[np.ix_(at, at)], basis))
    return {
        "setting": span.column, "stage": stage, "x": x, "factor": np.exp(middle),
        "low": np.exp(middle - spread), "high": np.exp(middle + spread),
    }  # fmt: skip
