# SPDX-License-Identifier: Apache-2.0
"""The truth: rigid wheels in soils, with numerics and composition independent of the library's model.

No code is shared with the library's model, so that a fit of the model to simulated data is a test
and not a mirror. What truth and model still share are assumptions:

- the law of the untouched soil, pressure p = k z^n D^m, the one that the library claims to know,
  and with it the load that a rigid wheel's front arc carries: without hidden effects both solve
  the same equation by different means, and compaction resistance is then the work of that pressure;
- shear does not carry load: vertical balance is that of the normal stress alone;
- Janosi and Hanamoto's law of shear, here along the arc, there on the contact's length as a whole;
- one wheel at a time, steady, with one slip and one load.

The action of effects is not shared. The library lets them act in stages: a factor on k, a
change of the sinkage after the solve, a term added to the compaction work. Here they change the
stress at each point of the contact (`hidden`, `wheel_laws`) by the state of the soil there: the distance
that the rim carried it along, the speed at which it is pressed, the change that an earlier pass left.
Sinkage and resistance both follow from this one stress. A law of sinkage over slip in the library is
therefore never exactly right, nor is the resistance that it adds.

Numerics: Simpson's rule over the arc and bracketing, where the library has a series, Gauss nodes and
Newton steps. A stress is any function of the points of the contact; forces are its components over
the arc that is in contact:

    W = b r ∫ σ cosθ dθ      R = b r ∫ σ sinθ dθ      θ from 0, the lowest point, to θ0, the entry
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Places = NDArray[np.intp]  # indices
# Pressure (Pa) at a depth (m); both of shape (rows, nodes).
PressureLaw = Callable[[Array], Array]

# Points on the arc, closer together near the entry: within 4e-6 of adaptive quadrature for n 0.2 to 2.2.
_NODES = 65
_ITERATIONS = 60
# m: depth and diameter at which `soil_of_pressure` takes the pressure.
_REFERENCE_SINKAGE, _REFERENCE_DIAMETER = 0.01, 0.25


# --- The contact of a rigid wheel with soil


@dataclass(frozen=True)
class Contact:
    """Points of the contact between wheels and soil, from the entry to the lowest point.

    Attributes
    ----------
    diameter, sinkage
        m, shape (rows,).
    entry
        Angle of the entry from the lowest point, rad, shape (rows,).
    angle
        Angle of each point from the lowest point, rad, shape (rows, nodes).
    depth
        Depth of each point below the untouched surface, m, shape (rows, nodes).
    weight
        Weight of each point in the quadrature, rad, shape (rows, nodes).
    rut
        Depth of the rut that earlier passes left, m, shape (rows,); 0 on fresh soil.
    """

    diameter: Array
    sinkage: Array
    entry: Array
    angle: Array
    depth: Array
    weight: Array
    rut: Array

    @classmethod
    def at(cls, diameter: Array, sinkage: Array, rut: Array | None = None) -> Contact:
        """Place the points of the contact at a sinkage, closer together towards the entry.

        At the entry z^n has an infinite slope or curvature. With theta = theta_0 (1 - u^3) and even steps of
        u the integrand goes to zero like u^(3n+2) there, which suits Simpson's rule for every soil's n.

        Parameters
        ----------
        diameter
            Shape (rows,), m.
        sinkage
            Depth of the lowest point below the untouched surface, rut included, shape (rows,), m.
        rut
            Depth of the rut that earlier passes left, shape (rows,), m; 0 if not given.

        Returns
        -------
        Contact
            Points from the entry (first) to the lowest point of the rim (last).
        """
        u = np.linspace(0.0, 1.0, _NODES)
        simpson = np.full(_NODES, 2.0)
        simpson[1::2] = 4.0
        simpson[[0, -1]] = 1.0
        simpson /= 3.0 * (_NODES - 1)
        radius = diameter / 2
        entry = np.arccos(np.clip(1.0 - sinkage / radius, -1.0, 1.0))
        angle = entry[:, None] * (1.0 - u**3)
        # cos(angle) - cos(entry) without the cancellation near the entry
        half_sum, half_difference = (entry[:, None] + angle) / 2, (entry[:, None] - angle) / 2
        depth = 2.0 * radius[:, None] * np.sin(half_sum) * np.sin(half_difference)
        weight = entry[:, None] * 3.0 * u**2 * simpson
        fresh = np.zeros(sinkage.shape) if rut is None else rut
        return cls(diameter, sinkage, entry, angle, depth, weight, fresh)

    @property
    def passed(self) -> Array:
        """Share of the contact's length that the soil at each point has passed, shape (rows, nodes).

        0 at the entry, 1 at the lowest point.
        """
        length = np.maximum(np.sin(self.entry), 1e-12)[:, None]
        share: Array = 1.0 - np.sin(self.angle) / length
        return share

    def upward(self, stress: Array, width: Array) -> Array:
        """Integrate stress times cos(angle) over the arc.

        For a normal stress this is the load that it carries, for a shear stress along the rim the thrust.

        Parameters
        ----------
        stress
            Stress at each point, shape (rows, nodes), Pa.
        width
            Shape (rows,), m.

        Returns
        -------
        ndarray
            Shape (rows,), N.
        """
        return self.along(stress * np.cos(self.angle), width)

    def backward(self, stress: Array, width: Array) -> Array:
        """Integrate stress times sin(angle) over the arc: for a normal stress, the resistance to motion.

        Parameters
        ----------
        stress
            Stress at each point, shape (rows, nodes), Pa.
        width
            Shape (rows,), m.

        Returns
        -------
        ndarray
            Shape (rows,), N.
        """
        return self.along(stress * np.sin(self.angle), width)

    def along(self, stress: Array, width: Array) -> Array:
        """Integrate a stress over the arc: for a shear stress, its torque divided by the radius.

        Parameters
        ----------
        stress
            Stress at each point, shape (rows, nodes), Pa.
        width
            Shape (rows,), m.

        Returns
        -------
        ndarray
            Shape (rows,), N.
        """
        force: Array = width * self.diameter / 2 * np.sum(stress * self.weight, axis=1)
        return force


def sinkage_under(load: Array, diameter: Array, carried: Callable[[Array], Array]) -> Array:
    """Find the sinkage at which `carried` equals the load.

    Solved for ln(load) over ln(sinkage), which is nearly a straight line.

    Parameters
    ----------
    load
        Shape (rows,), N.
    diameter
        Shape (rows,), m.
    carried
        Function that returns the load (N) carried at a sinkage (m), both of shape (rows,).

    Returns
    -------
    ndarray
        Sinkage, shape (rows,), m; NaN where the wheel would sink to its axle.
    """

    def excess(log_sinkage: Array) -> Array:
        # Where every bit of soil is dug away nothing is carried, which has no logarithm.
        share = carried(np.exp(log_sinkage)) / load
        return np.asarray(np.log(np.maximum(share, 1e-12)))

    axle = np.log(diameter / 2)
    root = bracketed_root(excess, np.log(diameter / 2 * 1e-7), axle, 1e-10)
    sinkage: Array = np.where(root < axle, np.exp(root), np.nan)
    return sinkage


def bracketed_root(
    function: Callable[[Array], Array], low: Array, high: Array, tolerance: float
) -> Array:
    """Find the zeros of rising functions, one for each element, by regula falsi (Illinois rule).

    Parameters
    ----------
    function
        Takes and returns shape (n,); each element rises with its argument, independent of the others.
    low, high
        Ends of the brackets, shape (n,).
    tolerance
        Change of the root below which the iteration ends, in the unit of the argument.

    Returns
    -------
    ndarray
        Zeros within the brackets, shape (n,); for a function without one, `low` where it is positive
        throughout, `high` where it is negative.
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
        # The value at an end that stayed twice is halved, so that this end moves, too.
        at_low = np.where(up & (side == 1), at_low / 2, at_low)
        at_high = np.where(~up & (side == -1), at_high / 2, at_high)
        high, at_high = np.where(up, middle, high), np.where(up, value, at_high)
        low, at_low = np.where(up, low, middle), np.where(up, at_low, value)
        side = np.where(up, 1.0, -1.0)
        if np.all((np.abs(middle - previous) < tolerance) | below | above):
            break
    return np.where(below, last, np.where(above, first, middle))


# --- Soil, circumstances, and the load that depth alone carries


@dataclass(frozen=True)
class TruthSoil:
    """A soil of the simulator, with its true parameters.

    Attributes
    ----------
    name
        Name of the soil.
    k, n, m
        Constants of the pressure p = k z^n D^m at depth z under a wheel of diameter D; k in Pa/m^(n+m), n and
        m dimensionless.
    cohesion, friction_angle
        Shear strength c + p tan(phi): Pa, rad.
    shear_deformation
        K of Janosi and Hanamoto (1961), m.
    unit_weight
        Weight of the soil, N/m^3.
    """

    name: str
    k: float
    n: float
    m: float
    cohesion: float = 500.0
    friction_angle: float = 0.55
    shear_deformation: float = 0.015
    unit_weight: float = 15_500.0


def soil_of_pressure(name: str, pressure: float, n: float, m: float, **rest: float) -> TruthSoil:
    """Make a soil from its pressure at a depth of 10 mm under a wheel of 0.25 m diameter.

    Parameters
    ----------
    name
        Name of the soil.
    pressure
        That pressure, Pa.
    n, m
        Exponents of depth and of diameter in p = k z^n D^m, dimensionless.
    **rest
        Further fields of `TruthSoil`, SI units.

    Returns
    -------
    TruthSoil
        With the k at which k z^n D^m is that pressure.
    """
    k = pressure / (_REFERENCE_SINKAGE**n * _REFERENCE_DIAMETER**m)
    return TruthSoil(name, k, n, m, **rest)


@dataclass(frozen=True)
class Circumstances:
    """Conditions under which wheels roll; arrays of shape (rows,); make them with `Circumstances.of`.

    Attributes
    ----------
    load
        N.
    diameter, width
        m.
    slip
        1 - v/(r omega) when driven, r omega/v - 1 when skidding (negative).
    speed
        Speed of travel, m/s.
    pass_number
        1 on fresh soil.
    slip_angle
        rad.
    grouser_height
        m.
    hidden
        Value of a variable that is not recorded, -1 to 1.
    covariates
        Further recorded columns by name.
    """

    load: Array
    diameter: Array
    width: Array
    slip: Array
    speed: Array
    pass_number: Array
    slip_angle: Array
    grouser_height: Array
    hidden: Array
    covariates: Mapping[str, Array]

    @classmethod
    def of(cls, /, **settings: Any) -> Circumstances:
        """Make circumstances from numbers and arrays by name, broadcast to shape (rows,).

        Load, diameter and width are needed; speed defaults to 0.1 m/s, pass_number to 1, all else to 0. A
        name that is not an attribute is a covariate.
        """
        plain = {"slip": 0.0, "speed": 0.1, "pass_number": 1.0}
        plain |= {"slip_angle": 0.0, "grouser_height": 0.0, "hidden": 0.0}
        given = plain | settings
        shape = np.broadcast_shapes((1,), *(np.shape(value) for value in given.values()))
        arrays: dict[str, Array] = {
            name: np.broadcast_to(np.asarray(value, dtype=np.float64), shape)
            for name, value in given.items()
        }
        names = [one.name for one in fields(cls) if one.name != "covariates"]
        return cls(**{name: arrays.pop(name) for name in names}, covariates=arrays)

    def rows(self, rows: Places) -> Circumstances:
        """Return the rows of these indices."""
        arrays = dict(vars(self))
        extra = {name: values[rows] for name, values in arrays.pop("covariates").items()}
        return Circumstances(**{n: values[rows] for n, values in arrays.items()}, covariates=extra)


def supported_load(law: PressureLaw, diameter: Array, width: Array, sinkage: Array) -> Array:
    """Compute the load that soil carries at a sinkage, where its pressure depends on depth alone.

    Parameters
    ----------
    law
        Function that returns the pressure (Pa) at depths (m), both of shape (rows, nodes).
    diameter, width, sinkage
        Shape (rows,), m.

    Returns
    -------
    ndarray
        Shape (rows,), N.
    """
    contact = Contact.at(diameter, sinkage)
    return contact.upward(law(contact.depth), width)


def static_sinkage(law: PressureLaw, load: Array, diameter: Array, width: Array) -> Array:
    """Find the sinkage at which soil carries the load, where its pressure depends on depth alone.

    Parameters
    ----------
    law
        Function that returns the pressure (Pa) at depths (m), both of shape (rows, nodes).
    load
        Shape (rows,), N.
    diameter, width
        Shape (rows,), m.

    Returns
    -------
    ndarray
        Shape (rows,), m; NaN where the wheel would sink to its axle.
    """
    return sinkage_under(load, diameter, lambda z: supported_load(law, diameter, width, z))
