"""The truth: a rigid wheel in a truth soil, with numerics of its own.

Nothing here is shared with the library's model, so that a fit of the model to simulated data is a
test and not a mirror. The law of the soil is the one that the library claims to know, pressure
p = k z^n D^m; what is computed from it is computed another way: Simpson's rule over the contact arc
(the library uses a series and Gauss nodes), bracketing instead of Newton steps, resistance from
the horizontal component of the pressure (the library uses its work in closed form), thrust from the
shear stress along the arc (the library lets it act on the chord's length as a whole).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.errors import SmallwheelError

Array = NDArray[np.float64]
Places = NDArray[np.intp]  # indices
# Pressure (Pa) at a depth (m); both of shape (rows, nodes).
PressureLaw = Callable[[Array], Array]

# 65 points on the stretched arc (see `_arc`): within 4e-6 of adaptive quadrature for n 0.2 to 2.2.
_NODES = 65
_ITERATIONS = 60


class SimulationError(SmallwheelError):
    """A simulation that cannot be made: which setting, what was given, what was expected."""


def check_range(name: str, value: float, low: float, high: float, unit: str = "") -> None:
    """Raise `SimulationError` unless a setting is a number between two others, both allowed."""
    if not (math.isfinite(value) and low <= value <= high):
        unit = f" {unit}" if unit else ""
        raise SimulationError(
            f"{name} is {value}: expected a number from {low:g} to {high:g}{unit}"
        )


@dataclass(frozen=True)
class TruthSoil:
    """A soil as it really is.

    p = k z^n D^m in Pa with z and D in m, so k is in Pa/m^(n+m); cohesion in Pa, friction_angle in
    rad, shear_deformation in m (Janosi and Hanamoto's K), unit_weight in N/m^3.
    """

    name: str
    k: float
    n: float
    m: float
    cohesion: float = 500.0
    friction_angle: float = 0.55
    shear_deformation: float = 0.015
    unit_weight: float = 15_500.0


@dataclass(frozen=True)
class Circumstances:
    """Where and how wheels roll; arrays of shape (rows,), SI units and radians.

    Slip is 1 - v/(r omega) when driven and r omega/v - 1 when skidding. `covariates` holds what
    else is recorded, `hidden` what is not.
    """

    load: Array
    diameter: Array
    width: Array
    slip: Array
    speed: Array
    pass_number: Array
    slip_angle: Array
    grouser_height: Array
    covariates: Mapping[str, Array] = field(default_factory=dict)
    hidden: Array | None = None

    @classmethod
    def of(cls, covariates: Mapping[str, Any] | None = None, **settings: Any) -> Circumstances:
        """Broadcast numbers and arrays to one length; what is not given is at its plain value.

        Plain: no slip, 0.1 m/s, fresh soil, no slip angle, no grousers.
        """
        plain = {"slip": 0.0, "speed": 0.1, "pass_number": 1.0}
        plain |= {"slip_angle": 0.0, "grouser_height": 0.0}
        extra = {} if covariates is None else dict(covariates)
        hidden = settings.pop("hidden", None)
        named = plain | settings
        values = [*named.values(), *extra.values(), *([] if hidden is None else [hidden])]
        shape = np.broadcast_shapes((1,), *(np.shape(value) for value in values))

        def filled(value: Any) -> Array:
            return np.broadcast_to(np.asarray(value, dtype=np.float64), shape)

        return cls(
            **{name: filled(value) for name, value in named.items()},
            covariates={name: filled(value) for name, value in extra.items()},
            hidden=None if hidden is None else filled(hidden),
        )

    def with_slip(self, slip: Array) -> Circumstances:
        """Return the same with another slip."""
        return replace(self, slip=slip)


def _arc(radius: Array, sinkage: Array) -> tuple[Array, Array, Array]:
    """Angles from the lowest point, depths there and weights, each of shape (rows, nodes).

    z^n has an infinite slope or curvature where the wheel enters the soil. With
    theta = theta_0 (1 - u^3) the integrand goes to zero like u^(3n+2) there, which suits Simpson's
    rule for every n that soils have.
    """
    u = np.linspace(0.0, 1.0, _NODES)
    simpson = np.full(_NODES, 2.0)
    simpson[1::2] = 4.0
    simpson[[0, -1]] = 1.0
    simpson /= 3.0 * (_NODES - 1)
    entry = np.arccos(np.clip(1.0 - sinkage / radius, -1.0, 1.0))[:, None]
    angle = entry * (1.0 - u**3)
    # cos(angle) - cos(entry) without the cancellation near the entry
    depth = 2.0 * radius[:, None] * np.sin((entry + angle) / 2) * np.sin((entry - angle) / 2)
    return angle, depth, entry * 3.0 * u**2 * simpson


def supported_load(law: PressureLaw, diameter: Array, width: Array, sinkage: Array) -> Array:
    """Load (N) that the soil carries at a sinkage (m): vertical component of the pressure."""
    angle, depth, weight = _arc(diameter / 2, sinkage)
    load: Array = width * diameter / 2 * np.sum(law(depth) * np.cos(angle) * weight, axis=1)
    return load


def motion_resistance(law: PressureLaw, diameter: Array, width: Array, sinkage: Array) -> Array:
    """Horizontal component (N) of the pressure on the front of the wheel at a sinkage (m)."""
    angle, depth, weight = _arc(diameter / 2, sinkage)
    force: Array = width * diameter / 2 * np.sum(law(depth) * np.sin(angle) * weight, axis=1)
    return force


def shear_thrust(law: PressureLaw, soil: TruthSoil, at: Circumstances, sinkage: Array) -> Array:
    """Thrust (N), negative when skidding: Janosi and Hanamoto's shear stress along the arc.

    A wheel that has dug itself in presses on the soil with its load still, no more: the pressure
    over the longer arc is scaled to that.
    """
    radius = at.diameter / 2
    angle, depth, weight = _arc(radius, sinkage)
    entry = np.arccos(np.clip(1.0 - sinkage / radius, -1.0, 1.0))[:, None]
    # v / (r omega), from either definition of slip
    ratio = np.where(at.slip >= 0, 1.0 - at.slip, 1.0 / (1.0 + np.minimum(at.slip, 0.0)))
    # Zero at zero slip, so that a free wheel has no thrust: the rolling part of the displacement
    # (the wheel's lowest points move slower than its rim) is what motion resistance stands for.
    displacement = (radius * (1.0 - ratio))[:, None] * (np.sin(entry) - np.sin(angle))
    mobilised = np.sign(displacement) * -np.expm1(-np.abs(displacement) / soil.shear_deformation)
    area = (at.width * radius)[:, None] * np.cos(angle) * weight
    pressure = law(depth)
    pressure = pressure * (at.load / np.sum(pressure * area, axis=1))[:, None]
    strength = soil.cohesion + pressure * np.tan(soil.friction_angle)
    thrust: Array = np.sum(strength * mobilised * area, axis=1)
    return thrust


def bracketed_root(
    function: Callable[[Array], Array], low: Array, high: Array, tolerance: float
) -> Array:
    """Where rising functions are zero, one for each element, by regula falsi (Illinois rule).

    Never leaves the bracket; gives its nearer end where a function has no zero in it.
    """
    at_low, at_high = function(low), function(high)
    below, above = at_high <= 0, at_low >= 0
    first, last = low, high
    side = np.zeros(low.shape)
    middle = high
    for _ in range(_ITERATIONS):
        previous = middle
        with np.errstate(invalid="ignore", divide="ignore"):
            middle = high - at_high * (high - low) / (at_high - at_low)
        middle = np.where(np.isfinite(middle), np.clip(middle, low, high), (low + high) / 2)
        value = function(middle)
        up = value > 0
        # The end that stayed twice counts half, so that it moves at last.
        at_low = np.where(up & (side == 1), at_low / 2, at_low)
        at_high = np.where(~up & (side == -1), at_high / 2, at_high)
        high, at_high = np.where(up, middle, high), np.where(up, value, at_high)
        low, at_low = np.where(up, low, middle), np.where(up, at_low, value)
        side = np.where(up, 1.0, -1.0)
        if np.all((np.abs(middle - previous) < tolerance) | below | above):
            break
    return np.where(below, last, np.where(above, first, middle))


def static_sinkage(law: PressureLaw, load: Array, diameter: Array, width: Array) -> Array:
    """Sinkage (m) at which the soil carries the load; NaN where the wheel sinks to its axle.

    Solved for ln(load) over ln(sinkage), which is nearly a straight line.
    """
    target = np.log(load)

    def excess(log_sinkage: Array) -> Array:
        carried = supported_load(law, diameter, width, np.exp(log_sinkage))
        return np.asarray(np.log(carried) - target)

    axle = np.log(diameter / 2)
    root = bracketed_root(excess, np.log(diameter / 2 * 1e-7), axle, 1e-10)
    sinkage: Array = np.where(root < axle, np.exp(root), np.nan)
    return sinkage
