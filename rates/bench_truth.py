# SPDX-License-Identifier: Apache-2.0
"""A single wheel on a bench as another author would simulate it: stresses summed along the arc.

It shares nothing with the package: pressure under the rim from the undisturbed soil at each angle, shear
after Janosi and Hanamoto, on a fixed grid of angles; a wheel that digs carries its load over a longer arc.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

Array = NDArray[np.float64]
Layer = Callable[[Array, Array], Array]  # of pressure and depth, the pressure with what lies below

_NODES = 400
_LEAST, _DEEPEST = 1e-6, 0.49  # m; of the diameter


@dataclass(frozen=True)
class BenchSoil:
    """k in Pa/m^(n+m). bekker: kc (Pa/m^(n-1)) and kphi (Pa/m^n) in the place of k and m.

    lift: whether shear carries load. peak: place of the largest pressure, of the entry angle, at slip 0 and
    its growth with slip. rear: exit over entry angle.
    """

    k: float = 2.2e6
    n: float = 0.9
    m: float = 0.25
    bekker: tuple[float, float] | None = None
    cohesion: float = 400.0
    friction: float = np.radians(31.0)
    shear_modulus: float = 0.011
    rim: float = 0.8
    lift: bool = False
    peak: tuple[float, float] | None = None
    rear: float = 0.0
    unit_weight: float = 15.5e3

    def pressure(self, depth: Array, diameter: float, width: float) -> Array:
        """Pa, at depths (m) under a wheel."""
        if self.bekker is not None:
            kc, kphi = self.bekker
            return np.asarray((kc / width + kphi) * depth**self.n)
        return np.asarray(self.k * depth**self.n * diameter**self.m)

    @property
    def passive(self) -> float:
        """Rankine's coefficient of passive earth pressure."""
        return float(np.tan(np.pi / 4 + self.friction / 2) ** 2)


@dataclass(frozen=True)
class BenchWheel:
    """Load (N), diameter and width (m), and slip."""

    load: float
    diameter: float
    width: float
    slip: float = 0.0


@dataclass(frozen=True)
class Rolled:
    """What is there when a wheel has rolled: sinkage (m), forces (N), torque (N m)."""

    sinkage: float
    resistance: float
    drawbar_pull: float
    torque: float


def rolled(
    soil: BenchSoil,
    wheel: BenchWheel,
    firmer: float = 1.0,
    layer: Layer = lambda pressure, depth: pressure,
    dug: Callable[[float], float] = lambda sinkage: sinkage,
) -> Rolled:
    """One wheel in a soil. firmer: factor on its pressure; dug: sinkage that slip or passes make of it."""
    radius, width = wheel.diameter / 2, wheel.width

    def stresses(sinkage: float, size: float) -> tuple[Array, Array, Array, float]:
        entry = float(np.arccos(1.0 - sinkage / radius))
        leave = -soil.rear * entry
        angle = leave + (np.arange(_NODES) + 0.5) / _NODES * (entry - leave)
        depth = _depth(soil, angle, entry, leave, sinkage, wheel)
        normal = size * firmer * layer(soil.pressure(depth, wheel.diameter, width), depth)
        ratio = 1.0 - wheel.slip if wheel.slip >= 0 else 1.0 / (1.0 + wheel.slip + 1e-9)
        way = radius * ((entry - angle) - ratio * (np.sin(entry) - np.sin(angle)))
        strength = soil.cohesion + normal * np.tan(soil.friction)
        shear = soil.rim * np.sign(way) * strength * -np.expm1(-np.abs(way) / soil.shear_modulus)
        return angle, normal, shear, (entry - leave) / _NODES

    def carried(sinkage: float, size: float = 1.0) -> float:
        angle, normal, shear, step = stresses(sinkage, size)
        lift = shear * np.sin(angle) if soil.lift else 0.0
        return float(width * radius * np.sum(normal * np.cos(angle) + lift) * step)

    deepest = _DEEPEST * wheel.diameter
    static = float(brentq(lambda z: carried(z) - wheel.load, _LEAST, deepest, xtol=1e-9))
    sinkage = dug(static)
    deep = min(sinkage, deepest)
    size = float(np.exp(brentq(lambda ln: carried(deep, np.exp(ln)) - wheel.load, -7.0, 7.0)))
    angle, normal, shear, step = stresses(deep, size)
    depths = (np.arange(_NODES) + 0.5) / _NODES * static
    compaction = firmer * layer(soil.pressure(depths, wheel.diameter, width), depths)
    forward = np.sum(shear * np.cos(angle) - normal * np.sin(angle))
    return Rolled(
        sinkage,
        float(width * np.sum(compaction) * static / _NODES),
        float(width * radius * forward * step),
        float(width * radius**2 * np.sum(shear) * step),
    )


def _depth(
    soil: BenchSoil, angle: Array, entry: float, leave: float, sinkage: float, wheel: BenchWheel
) -> Array:
    """Depth at which the undisturbed soil bears what presses at each angle; a peak moves it forward."""
    radius, at = wheel.diameter / 2, angle
    if soil.peak is not None:
        top = (soil.peak[0] + soil.peak[1] * max(wheel.slip, 0.0)) * entry
        back = entry - (angle - leave) / (top - leave + 1e-12) * (entry - top)
        at = np.where(angle >= top, angle, back)
        full = radius * (np.cos(top) - np.cos(entry))
    else:
        full = sinkage
    depth = radius * (np.cos(at) - np.cos(entry)) * sinkage / full
    return np.asarray(np.maximum(depth, 0.0))
