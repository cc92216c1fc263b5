# SPDX-License-Identifier: Apache-2.0
"""The contact of a rigid wheel with soil: its arc, what a stress on it carries, and the sinkage.

Simpson's rule over the arc and bracketing, where the library has a series, Gauss nodes and Newton
steps. A stress is any function of the points of the contact; forces are its components over the arc
that is in contact:

    W = b r ∫ σ cosθ dθ      R = b r ∫ σ sinθ dθ      θ from 0, the lowest point, to θ0, the entry
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# 65 points on the stretched arc: within 4e-6 of adaptive quadrature for n 0.2 to 2.2.
_NODES = 65
_ITERATIONS = 60


@dataclass(frozen=True)
class Contact:
    """Points of the contact between wheels and soil, from the entry to the lowest point.

    angle (rad, from the lowest point), depth (m, below the untouched surface) and weight (rad, of
    the quadrature) have the shape (rows, nodes); the rest (rows,). rut: depth (m) of the rut that
    earlier passes left, 0 on fresh soil.
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
        """Lay the points; z^n has an infinite slope or curvature where the wheel enters.

        With theta = theta_0 (1 - u^3) the integrand goes to zero like u^(3n+2) there, which suits
        Simpson's rule for every n that soils have.
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
        """Share of the contact's length that soil at a point has under it: 0 at entry, 1 lowest."""
        length = np.maximum(np.sin(self.entry), 1e-12)[:, None]
        share: Array = 1.0 - np.sin(self.angle) / length
        return share

    def upward(self, stress: Array, width: Array) -> Array:
        """Vertical component (N) of a stress (Pa) on these points."""
        return self._sum(stress * np.cos(self.angle), width)

    def backward(self, stress: Array, width: Array) -> Array:
        """Horizontal component (N) of a stress (Pa) on these points."""
        return self._sum(stress * np.sin(self.angle), width)

    def along(self, stress: Array, width: Array) -> Array:
        """Sum (N) along the arc of a stress (Pa) on these points: its torque over the radius."""
        return self._sum(stress, width)

    def _sum(self, stress: Array, width: Array) -> Array:
        force: Array = width * self.diameter / 2 * np.sum(stress * self.weight, axis=1)
        return force


def sinkage_under(load: Array, diameter: Array, carried: Callable[[Array], Array]) -> Array:
    """Sinkage (m) at which `carried`, N at a sinkage, is the load; NaN where that is the axle.

    Solved for ln(load) over ln(sinkage), which is nearly a straight line.
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
