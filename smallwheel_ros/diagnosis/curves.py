# SPDX-License-Identifier: Apache-2.0
"""A missing law without a name: a smooth function of one setting, at one stage of the model.

    ln factor = sum over j of c_j P_j(x),  c_j ~ N(0, s_j^2)

with P_j the Legendre polynomials, and x the setting, scaled to -1 .. 1. Slip, slip angle, pass number and
the like have a value at which they have no effect: their curves are one-sided, and 0 there.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.effects.base import Effect, WheelState
from smallwheel_ros.fitting.constants import CURVE_SIZE
from smallwheel_ros.fitting.fit import Fit
from smallwheel_ros.fitting.parameters import EffectPart, FreeParameter, Prior
from smallwheel_ros.physics.conditions import Conditions
from smallwheel_ros.physics.sinkage import compaction_resistance

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
class CurveSpan:
    """The setting on which a curve depends, and the range over which it is scaled.

    Attributes
    ----------
    column
        Name of the setting.
    middle, half
        Middle and half width of the range, in the setting's SI unit (at the stage `pressure`, of ln depth).
        For a one-sided range, the value at which the setting has no effect, and the distance from there to
        the far end.
    side
        Sign of a one-sided range (1 above `middle`, -1 below), whose curve is 0 at `middle`; 0 if
        two-sided.
    """

    column: str
    middle: float
    half: float
    side: int = 0

    def scaled(self, values: Array) -> Array:
        """Scale a setting to -1 .. 1, or, if one-sided, to 0 at `middle` and 1 at the far end.

        Values beyond the range are clipped at 1.2 and, if two-sided, -1.2; NaN becomes 0.
        """
        x = np.nan_to_num((values - self.middle) / self.half)
        return np.clip(self.side * x, 0.0, 1.2) if self.side else np.clip(x, -1.2, 1.2)


def _series(coefficients: Mapping[str, Any], span: CurveSpan, x: Array) -> Array:
    """Sum of the curve's terms at scaled settings x; the coefficients are named `c0`, `c1`, ... by degree."""
    u = 2.0 * x - 1.0 if span.side else x
    total: Array = np.zeros_like(x)
    for name, c in coefficients.items():
        degree = int(name[1:])
        start = (-1.0) ** degree if span.side else 0.0  # P_j(-1): nothing at the anchor
        total = total + np.asarray(c) * (_LEGENDRE[degree](u) - start)
    return np.clip(total, -_LARGEST, _LARGEST)


@dataclass(frozen=True)
class Curve(Effect):
    """A smooth function of one setting; its subclasses define the stage.

    Attributes
    ----------
    span
        The setting and its range.
    coefficients
        Coefficients of the Legendre polynomials, dimensionless, named `c0`, `c1`, ... by degree.
    size
        Scale of a curve that is added to a value, N or m; 1 for a factor.
    """

    id: ClassVar[str] = "unknown"
    span: CurveSpan = field(default=CurveSpan("load", 0.0, 1.0))
    coefficients: Mapping[str, Any] = field(default_factory=dict)
    size: float = 1.0

    def log_factor(self, conditions: Conditions) -> Array:
        """ln of the factor in each row, shape (rows,); of a curve that is added, its value over a scale.

        The scale is `size`, of a force a quarter of `size` or of the load.
        """
        x = self.span.scaled(conditions[self.span.column])
        return _series(self.coefficients, self.span, x)


def _stiffness(self: Curve, conditions: Conditions) -> Array:
    return np.exp(self.log_factor(conditions))


def _deeper(self: Curve, sinkage: Array, conditions: Conditions) -> Array:
    return np.where(conditions.rolling, sinkage * np.exp(self.log_factor(conditions)), sinkage)


def _work(self: Curve, state: WheelState, conditions: Conditions) -> Array:
    z = np.maximum(state.sinkage, 0.0)
    work = compaction_resistance(z, state.width, state.modulus, state.exponent)
    return np.where(conditions.rolling, work * np.expm1(self.log_factor(conditions)), 0.0)


def _drag(self: Curve, state: WheelState, conditions: Conditions) -> Array:
    return np.where(conditions.rolling, _DRAG * state.load * self.log_factor(conditions), 0.0)


def _force(self: Curve, resistance: Array, conditions: Conditions) -> Array:
    return np.asarray(resistance + _DRAG * self.size * self.log_factor(conditions))


def _height(self: Curve, sinkage: Array, conditions: Conditions) -> Array:
    return np.asarray(sinkage + self.size * self.log_factor(conditions))


def _depth(self: Curve, depth: Array, conditions: Conditions) -> Array:
    x = (np.log(np.maximum(depth, 1e-7)) - self.span.middle) / self.span.half
    return np.exp(_series(self.coefficients, self.span, np.clip(x, -1.5, 1.2)))


class Stage(NamedTuple):
    """Where a curve acts: the method of an effect, and how it changes the value there.

    Attributes
    ----------
    method
        Name of the effect's method.
    acts
        Function that takes the place of that method. It takes what the method takes, the effect first and
        the conditions last, and returns an array of shape (rows,); at the stage `pressure`, of the shape of
        the depths.
    stands_for
        Methods of effects of which the curve is the most general form.
    unit
        Unit of a curve that is added to the value, `1` for a share of the load; `1` for a factor.
    adds
        What a curve of 1 adds, in sizes of the curve (`Curve.size`) or loads; 0 for a factor.
    """

    method: str
    acts: Callable[..., Array]
    stands_for: tuple[str, ...]
    unit: str = "1"
    adds: float = 0.0


STAGES = {
    # the soil's stiffness
    "stiffness": Stage("modulus_factor", _stiffness, ("modulus_factor", "exponent_shift")),
    # the wheel digs, and resistance goes with it
    "sinkage": Stage("sinkage", _deeper, ("sinkage",)),
    # what is shown, or dug without compaction: sinkage alone
    "shown sinkage": Stage("measured_sinkage", _deeper, ("measured_sinkage", "sinkage")),
    # resistance alone, as a share of what compaction costs
    "resistance": Stage("added_resistance", _work, ("added_resistance", "measured_resistance")),
    # something drags besides compaction: a force that is a share of the load
    "drag": Stage("added_resistance", _drag, ("added_resistance",), adds=_DRAG),
    # the same, whatever the load
    "force": Stage("measured_resistance", _force, ("measured_resistance",), "N", _DRAG),
    # the wheel's height is shown wrong, or lifted, by a length
    "height": Stage("measured_sinkage", _height, ("measured_sinkage",), "m", 1.0),
    # pressure is no power of depth; middle, half of the span: of ln depth
    "pressure": Stage("pressure_factor", _depth, ("pressure_factor",)),
}
_KINDS = {name: type("Curve", (Curve,), {s.method: s.acts}) for name, s in STAGES.items()}


def curve_part(
    name: str, stage: str, span: CurveSpan, first: int, terms: int, size: float = 1.0
) -> EffectPart:
    """Make a curve that a fit can use as an effect.

    Its coefficients have Gaussian priors about 0, narrower for higher degrees.

    Parameters
    ----------
    name
        Id of the part.
    stage
        Where the curve acts: a name in `STAGES`.
    span
        The setting that it follows, and the range.
    first
        Degree of its first term.
    terms
        Number of its terms, up to 3, or 4 from degree 0.
    size
        Scale of a curve that is added to a value, N or m; 1 for a curve that is a factor.
    """
    kind = _KINDS[stage]
    falls = _FALLS if first else (1.0, *_FALLS)
    listed = [
        FreeParameter(name, f"c{first + i}", 0.0, "1",
                      Prior(0.0, CURVE_SIZE * fall, -_LARGEST, _LARGEST))
        for i, fall in enumerate(falls[:terms])
    ]  # fmt: skip
    return EffectPart(
        name, tuple(listed), lambda numbers: kind(span=span, coefficients=numbers, size=size)
    )


def spans_of(column: str, values: Array) -> list[CurveSpan]:
    """Return the spans of a setting: one, or one on each side of the value at which it has no effect.

    Parameters
    ----------
    column
        Name of the setting.
    values
        Its values, shape (rows,), SI.

    Returns
    -------
    list of CurveSpan
        A side that has under a twentieth of the range is left out.
    """
    low, high = float(values.min()), float(values.max())
    if column not in ANCHORS:
        return [CurveSpan(column, 0.5 * (low + high), 0.5 * (high - low))]
    anchor = ANCHORS[column]
    reach = {side: float(np.max(side * (values - anchor))) for side in (1, -1)}
    return [
        CurveSpan(column, anchor, r, side) for side, r in reach.items() if r > 0.05 * (high - low)
    ]


def distinct(values: Array, span: CurveSpan) -> int:
    """Return the largest number of terms that a curve can have, given the different settings in its span.

    Parameters
    ----------
    values
        Values of the setting, shape (rows,), SI.
    span
        Setting and range over which the curve is scaled.
    """
    x = (values - span.middle) / span.half
    if not span.side:
        return int(np.unique(np.round(x, 2)).size) - 1
    x = span.side * x
    return int(np.unique(np.round(x[x > 1e-9], 2)).size)


def curve_shown(
    part: EffectPart, stage: str, span: CurveSpan, values: Array, fit: Fit
) -> dict[str, Any]:
    """Compute a fitted curve for display, with a 95 % band.

    Parameters
    ----------
    part
        The curve with its coefficients, as `curve_part` makes it.
    stage
        Where it acts: a name in `STAGES`.
    span
        The setting that it follows, and the range.
    values
        Values of the setting where it was measured, shape (rows,), SI.
    fit
        A fit with the curve.

    Returns
    -------
    dict
        `setting` and `stage`, and arrays of shape (25,): `x` (the setting, SI) and `factor`, `low`, `high`,
        exp of `Curve.log_factor` and of its band. At a stage where the curve is added, `added` in place of
        `factor`, with `low` and `high` in its `unit`: N, m, or 1 for a share of the load.
    """
    mine = values if not span.side else values[span.side * (values - span.middle) >= 0]
    x = np.linspace(float(mine.min()), float(mine.max()), _POINTS, dtype=np.float64)
    at, u = fit.vector.places(part.id), span.scaled(x)
    basis = np.column_stack([_series({p.field: 1.0}, span, u) for p in part.parameters])
    middle = basis @ fit.theta[at]
    spread = 1.96 * np.sqrt(np.einsum("ij,jk,ik->i", basis, fit.covariance[np.ix_(at, at)], basis))
    band = {"low": middle - spread, "high": middle + spread}
    kind, found = STAGES[stage], {"setting": span.column, "stage": stage, "x": x}
    if not kind.adds:
        return found | {n: np.exp(c) for n, c in ({"factor": middle} | band).items()}
    made = part.build({})
    assert isinstance(made, Curve)  # as `curve_part` makes it
    scale = kind.adds * made.size
    shown = {n: scale * c for n, c in ({"added": middle} | band).items()}
    return found | {"unit": kind.unit} | shown
