# SPDX-License-Identifier: Apache-2.0
"""The truth: a rigid wheel in a truth soil, with numerics and a composition of its own.

No code is shared with the library's model, so that a fit of the model to simulated data is a test
and not a mirror. What truth and model still share are assumptions:

- the law of the untouched soil, pressure p = k z^n D^m, the one that the library claims to know,
  and with it the load that a rigid wheel's front arc carries: without hidden effects both solve
  the same equation, each in its way, and compaction resistance is then the work of that pressure;
- shear does not carry load: vertical balance is that of the normal stress alone;
- Janosi and Hanamoto's law of shear, here along the arc, there on the contact's length as a whole;
- one wheel at a time, steady, with one slip and one load.

What is not shared is how effects come in. The library lets them act in stages: a factor on k, a
change of the sinkage after the solve, a term added to the compaction work. Here they change the
stress at the points of the contact (module `hidden_effects`), by quantities that a point has of its
own: how far soil was carried along under the wheel, how fast it is pressed, what an earlier pass
left of it. Sinkage and resistance both come out of the one stress. A library's law of sinkage over
slip is therefore never exactly right, nor is the resistance that it adds to it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.common.errors import SmallwheelError
from smallwheel_ros.simulate.contact import Array, Contact, sinkage_under

Places = NDArray[np.intp]  # indices
# Pressure (Pa) at a depth (m); both of shape (rows, nodes).
PressureLaw = Callable[[Array], Array]


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


def supported_load(law: PressureLaw, diameter: Array, width: Array, sinkage: Array) -> Array:
    """Load (N) that a soil carries at a sinkage (m) where depth alone decides about pressure."""
    contact = Contact.at(diameter, sinkage)
    return contact.upward(law(contact.depth), width)


def motion_resistance(law: PressureLaw, diameter: Array, width: Array, sinkage: Array) -> Array:
    """Horizontal component (N) of the pressure on the front of the wheel at a sinkage (m)."""
    contact = Contact.at(diameter, sinkage)
    return contact.backward(law(contact.depth), width)


def static_sinkage(law: PressureLaw, load: Array, diameter: Array, width: Array) -> Array:
    """Sinkage (m) at which the soil carries the load; NaN where the wheel sinks to its axle."""
    return sinkage_under(load, diameter, lambda z: supported_load(law, diameter, width, z))


def shear_stress(stress: Array, contact: Contact, soil: TruthSoil, at: Circumstances) -> Array:
    """Shear stress (Pa) along the arc, negative when skidding, after Janosi and Hanamoto.

    A wheel that has dug itself in presses on the soil with its load still, no more: the stress
    (Pa, shape (rows, nodes)) over the longer arc is scaled to that.
    """
    # v / (r omega), from either definition of slip
    ratio = np.where(at.slip >= 0, 1.0 - at.slip, 1.0 / (1.0 + np.minimum(at.slip, 0.0)))
    # Zero at zero slip, so that a free wheel has no thrust: the rolling part of the displacement
    # (the wheel's lowest points move slower than its rim) is what motion resistance stands for.
    length = at.diameter / 2 * np.sin(contact.entry)
    displacement = ((1.0 - ratio) * length)[:, None] * contact.passed
    mobilised = np.sign(displacement) * -np.expm1(-np.abs(displacement) / soil.shear_deformation)
    pressure = stress * (at.load / contact.upward(stress, at.width))[:, None]
    shear: Array = (soil.cohesion + pressure * np.tan(soil.friction_angle)) * mobilised
    return shear
