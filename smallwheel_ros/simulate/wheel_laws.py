# SPDX-License-Identifier: Apache-2.0
"""Laws of the forces between wheel and soil, all different from the library's.

For drives, curves over depth and slip: `rim_curves` (shear stress by the displacement along the whole rim,
Wong and Reece 1967, with the pressure that the depth alone gives) and `peaked_curves` (pressure that peaks
ahead of the lowest point, shear stress with a hump over displacement; by trapezoids). Digging over time
is another law (`vehicle`). For steady states: `response_of` and, with hidden effects, `WheelsOnSoil`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from smallwheel_ros.simulate.hidden import HiddenEffect, acting, shown_by_instrument
from smallwheel_ros.simulate.truth import Array, Circumstances, Contact, TruthSoil, sinkage_under

SLIPS = np.array(
    [-1, -0.7, -0.4, -0.2, -0.1, -0.04, 0, 0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.65, 0.8, 1]
)
DEPTHS: Array = np.geomspace(0.003, 0.45, 30).astype(np.float64)  # sinkages over the diameter
_NODES = 801


class Curves(NamedTuple):
    """Thrust, resistance, and torque over the radius, each divided by the load.

    Shape (depths, slips) each: at sinkages of `DEPTHS` times the diameter and slips of `SLIPS`.
    """

    thrust: Array
    resistance: Array
    torque: Array


@dataclass(frozen=True)
class RimStrength:
    """Strength of a soil under a rim.

    Attributes
    ----------
    cohesion, friction_angle
        c, Pa, and phi, rad.
    shear_deformation
        K of Janosi and Hanamoto (1961), m.
    rolling
        Share of the displacement by rolling that shears the soil, 0 to 1; a tread that yields takes up the
        rest.
    residual
        Ratio of the shear stress at large displacements to c + p tan(phi); below 1 the stress has a peak at
        smaller displacements (Wong 1979).
    """

    cohesion: float
    friction_angle: float
    shear_deformation: float
    rolling: float = 1.0
    residual: float = 1.0


def rim_curves(
    diameter: float, width: float, load: float, exponent: float, strength: RimStrength
) -> Curves:
    """Compute curves of a wheel by the displacement along its whole rim (Wong and Reece 1967).

    At each depth the pressure, proportional to depth^exponent, is scaled so that it carries the load.

    Parameters
    ----------
    diameter, width
        Size of the wheel, m.
    load
        Load on the wheel, N.
    exponent
        Exponent n of the pressure, which is proportional to depth^n.
    strength
        Shear strength of the soil at the rim, SI units.

    Returns
    -------
    Curves
        Each of shape (depths, slips).
    """
    depth, slips = DEPTHS * diameter, SLIPS[1:-1]
    contact = Contact.at(np.full(depth.size, diameter), depth)
    shape = np.maximum(contact.depth, 0.0) ** exponent
    whole = np.full(depth.size, width)
    stress = shape * (load / contact.upward(shape, whole))[:, None]
    entry, angle = contact.entry[:, None], contact.angle
    lower = np.sin(entry) - np.sin(angle)
    by_rolling = strength.rolling * (entry - angle - lower)
    # A skidding wheel turns slower than it travels.
    ratio = np.where(slips >= 0, 1.0 - slips, 1.0 / (1.0 + np.minimum(slips, 0.0)))
    moved = 0.5 * diameter * (by_rolling + (1.0 - ratio[:, None, None]) * lower)
    passed = np.abs(moved) / strength.shear_deformation
    mobilised = -np.expm1(-passed) * np.sign(moved)
    mobilised *= strength.residual + (1.0 - strength.residual) * np.exp(-passed / 5.0)
    shear = (strength.cohesion + stress * math.tan(strength.friction_angle)) * mobilised
    thrust = np.stack([contact.upward(one, whole) for one in shear], axis=1)
    torque = np.stack([contact.along(one, whole) for one in shear], axis=1)
    resistance = np.repeat(contact.backward(stress, whole)[:, None], SLIPS.size, axis=1)
    ends = ((0, 0), (1, 1))
    return Curves(
        np.pad(thrust, ends, "edge") / load, resistance / load, np.pad(torque, ends, "edge") / load
    )


@dataclass(frozen=True)
class Sand:
    """True values of a sand, and of the rim that digs into it, for `response_of`.

    Attributes
    ----------
    k
        K of the pressure K z^n, Pa/m^n; one for all wheels, or one for each, shape (rows,).
    n
        Exponent of depth.
    strength
        Shear strength.
    rim
        Ratio of the friction under a smooth, driven rim to that of the soil; with lugs, or when skidding, 1
        is used instead.
    dug
        Depth dug at slip 1, as a fraction of the diameter.
    skid
        Growth of the sinkage from slip 0 to slip -1, as a fraction of the static sinkage.
    lugs
        Factor on the depth that lugs dig, h i / (1.05 - i) at slip i, with h their height.
    """

    k: Array | float
    n: float
    strength: RimStrength
    rim: float = 0.85
    dug: float = 0.0
    skid: float = 0.0
    lugs: float = 0.0


@dataclass(frozen=True)
class Stresses:
    """The shape of the stresses along the arc of a wheel.

    Attributes
    ----------
    peak
        c1 and c2 of Wong and Reece (1967): the pressure peaks at (c1 + c2 |slip|) times the entry angle.
    rear
        Angle after the lowest point at which contact ends, over the entry angle.
    moved
        Pressure of soil that the wheel has dug loose, over that of untouched soil.
    hump
        a of the factor 1 + a x e^(1 - x) on Janosi and Hanamoto's shear stress, x the displacement over K.
    bias
        Error that is added to the pull, over the load.
    """

    peak: tuple[float, float] = (0.0, 0.0)
    rear: float = 0.0
    moved: float = 1.0
    hump: float = 0.0
    bias: float = 0.0


def sinkage_of(sand: Sand, at: Circumstances) -> Array:
    """Compute the sinkage of wheels: the static one of a parabolic contact, increased by slip, skid and lugs.

    Parameters
    ----------
    sand
        The soil.
    at
        Circumstances of the rows.

    Returns
    -------
    ndarray
        Shape (rows,), m, at most 0.45 diameters.
    """
    still = (1.5 * at.load / (at.width * sand.k * np.sqrt(at.diameter))) ** (1.0 / (sand.n + 0.5))
    i, j = np.maximum(at.slip, 0.0), np.maximum(-at.slip, 0.0)
    dug = sand.dug * at.diameter * np.sinh(1.2 * i) / np.sinh(1.2)
    dug += sand.lugs * at.grouser_height * i / (1.05 - i)
    found: Array = np.minimum(still * (1.0 + sand.skid * j**1.3) + dug, 0.45 * at.diameter)
    return found


def response_of(sand: Sand, at: Circumstances, shape: Stresses) -> tuple[Array, Array, Array]:
    """Compute sinkage, pull and torque of wheels on a sand.

    Parameters
    ----------
    sand
        The soil.
    at
        Circumstances of the rows.
    shape
        Shape of the stresses along the arc.

    Returns
    -------
    sinkage, pull, torque : ndarray
        Shape (rows,): m, N, N m.
    """
    z, still = sinkage_of(sand, at), sinkage_of(sand, replace(at, slip=0.0 * at.slip))
    thrust, resistance, torque = _forces(sand, at, z, still, shape)
    return z, thrust - resistance + shape.bias * at.load, torque


def _forces(
    sand: Sand, at: Circumstances, z: Array, still: Array, shape: Stresses
) -> tuple[Array, Array, Array]:
    """Thrust, resistance (N) and torque (N m) of wheels, shape (rows,) each.

    z: sinkage, m; still: sinkage without slip, m. Soil shallower than z - still counts as dug loose.
    """
    r = 0.5 * at.diameter
    first = np.arccos(1.0 - z / r)[:, None]
    last = -shape.rear * first
    t = first + (last - first) * np.linspace(0.0, 1.0, _NODES)
    top = (shape.peak[0] + shape.peak[1] * np.abs(at.slip))[:, None] * first
    behind = (t - last) / np.where(top > last, top - last, 1.0)
    down = np.where(t >= top, (first - t) / (first - top), behind)
    if shape.rear == 0.0 and shape.peak == (0.0, 0.0):
        down = 1.0 - t / first
    equal = first * (1.0 - np.clip(down, 0.0, 1.0))
    share = np.maximum(np.cos(equal) - np.cos(first), 0.0) / (1.0 - np.cos(first))
    below = share * z[:, None]
    press = share**sand.n * np.where(below < (z - still)[:, None], shape.moved, 1.0)
    shoe = r + 0.5 * at.grouser_height
    driven, braked = 1.0 - np.minimum(at.slip, 0.98), 1.0 / np.maximum(1.0 + at.slip, 0.02)
    u = np.where(at.slip >= 0, driven, braked)[:, None]
    slid = shoe[:, None] * ((first - t) - u * (np.sin(first) - np.sin(t)))
    x = np.abs(slid) / sand.strength.shear_deformation
    called = np.sign(slid) * (1.0 - np.exp(-x)) * (1.0 + shape.hump * x * np.exp(1.0 - x))
    mu = np.where((at.grouser_height > 0) | (at.slip < 0), 1.0, sand.rim)[:, None]

    def total(f: Array) -> Array:
        return np.asarray(-np.trapezoid(f, t, axis=1))

    rub = mu * np.tan(sand.strength.friction_angle) * press * called
    held = mu * sand.strength.cohesion * called
    lift = r * total(press * np.cos(t)) + shoe * total(rub * np.sin(t))
    p = (at.load / at.width - shoe * total(held * np.sin(t))) / lift
    shear = p[:, None] * rub + held
    thrust = at.width * shoe * total(shear * np.cos(t))
    resistance = at.width * r * p * total(press * np.sin(t))
    return thrust, resistance, at.width * shoe**2 * total(shear)


def peaked_curves(
    diameter: float, width: float, load: float, exponent: float, strength: RimStrength
) -> Curves:
    """Compute curves of a wheel whose pressure peaks ahead of its lowest point, by the law of `response_of`.

    The shear stress has a hump over displacement. `strength.rolling` and `.residual` are ignored.

    Parameters
    ----------
    diameter, width
        Size of the wheel, m.
    load
        Load on the wheel, N.
    exponent
        Exponent n of the pressure, which is proportional to depth^n.
    strength
        Shear strength of the soil at the rim, SI units.

    Returns
    -------
    Curves
        Each of shape (depths, slips).
    """
    depth, slip = (one.ravel() for one in np.meshgrid(DEPTHS * diameter, SLIPS, indexing="ij"))
    at = Circumstances.of(
        load=load, diameter=diameter, width=width, slip=np.clip(slip, -0.95, 0.95)
    )
    sand = Sand(1.0, exponent, strength)
    found = _forces(sand, at, depth, depth, Stresses(peak=(0.25, 0.2), hump=0.15))
    thrust, resistance, torque = (
        np.reshape(one, (DEPTHS.size, SLIPS.size)) / load for one in found
    )
    return Curves(thrust, resistance, torque / (0.5 * diameter))


LAWS = {"rim": rim_curves, "peaked": peaked_curves}


# --- Wheels on a soil with hidden effects


def shear_stress(stress: Array, contact: Contact, soil: TruthSoil, at: Circumstances) -> Array:
    """Compute the shear stress along the arc by Janosi and Hanamoto's law (1961), negative when skidding.

    The normal stress is scaled so that it carries the load, since a wheel that has dug itself in presses on
    the soil over a longer arc with no more than its load.

    Parameters
    ----------
    stress
        Normal stress on the rim, shape (rows, nodes), Pa.
    contact
        Points of the contact.
    soil
        The soil, whose strength is used.
    at
        Circumstances of the rows.

    Returns
    -------
    ndarray
        Shape (rows, nodes), Pa.
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


class Response(NamedTuple):
    """True values, each of shape (rows,); all are NaN where a wheel sinks to its axle.

    Attributes
    ----------
    depth
        Depth of the wheel's lowest point below the untouched surface, m.
    shown_sinkage, shown_resistance
        m, N: readings without noise. They differ from the true values by faults of the instruments and, for
        sinkage, by soil that rises again after the wheel.
    resistance, thrust
        N.
    torque
        Torque at the axle, N m, positive when driven.
    """

    depth: Array
    shown_sinkage: Array
    resistance: Array
    shown_resistance: Array
    thrust: Array
    torque: Array

    @property
    def drawbar_pull(self) -> Array:
        """Thrust less resistance, N, shape (rows,)."""
        return self.thrust - self.resistance


@dataclass(frozen=True)
class WheelsOnSoil:
    """Steady states of wheels on a soil with hidden effects.

    Attributes
    ----------
    soil
        The soil.
    effects
        Hidden effects, in the order in which they act.
    at
        Circumstances of the rows.
    scatter
        Factor on k, shape (rows,), or one number for all rows.
    """

    soil: TruthSoil
    effects: Sequence[HiddenEffect]
    at: Circumstances
    scatter: Array | float = 1.0

    def stress(self, contact: Contact) -> Array:
        """Normal stress (Pa) at the points of the contact, shape (rows, nodes)."""
        soil, at = self.soil, self.at
        modulus = soil.k * at.diameter**soil.m * self.scatter
        pressed = contact.depth
        for firmer in acting(self.effects, "modulus"):
            modulus = modulus * firmer(at)
        for carried_away in acting(self.effects, "carried_away"):
            pressed = pressed - carried_away(contact, at)
        pressure = modulus[:, None] * np.maximum(pressed, 0.0) ** soil.n
        for more in acting(self.effects, "stress"):
            pressure = pressure * more(contact, at, soil)
        return pressure

    def forces(self, sinkage: Array, rut: Array) -> tuple[Array, Array]:
        """Compute the load that is carried, and the horizontal force on the wheel, at a sinkage.

        Parameters
        ----------
        sinkage
            Shape (rows,), m.
        rut
            Depth of the rut that earlier passes left, shape (rows,), m.

        Returns
        -------
        load, resistance : ndarray
            Shape (rows,), N; the resistance is positive backward, without the effects' own resistance.
        """
        diameter, width = self.at.diameter, self.at.width
        contact = Contact.at(diameter, sinkage, rut)
        stress = self.stress(contact)
        load, resistance = contact.upward(stress, width), contact.backward(stress, width)
        for rebound in acting(self.effects, "rebound"):
            rise, exponent = rebound(stress[:, -1])
            # Behind the lowest point the wheel unloads the soil, which pushes it up and on.
            rear = Contact.at(diameter, np.clip(rise, 1e-12, sinkage))
            left = stress[:, -1:] * (rear.depth / rear.sinkage[:, None]) ** exponent
            load = load + np.where(rise > 0, rear.upward(left, width), 0.0)
            resistance = resistance - np.where(rise > 0, rear.backward(left, width), 0.0)
        return load, resistance

    def depth(self, rut: Array) -> Array:
        """Sinkage (m) under the load, (rows,); NaN where a wheel sinks to its axle. rut: m, (rows,)."""
        at = self.at
        return sinkage_under(at.load, at.diameter, lambda z: self.forces(z, rut)[0])

    def rut(self) -> Array:
        """Depth (m) of the rut that earlier passes of the same wheel under the same load left, (rows,).

        0 without an effect that depends on it.
        """
        rut = np.zeros(self.at.load.shape)
        if not any(effect.law.in_ruts for effect in self.effects):
            return rut
        passes = self.at.pass_number
        for earlier in range(1, int(np.max(passes))):
            rut = np.where(passes > earlier, self.depth(rut), rut)
        return rut

    def traction(self, depth: Array, rut: Array | None = None) -> tuple[Array, Array]:
        """Compute thrust and driving torque due to the shear stress at a depth.

        Parameters
        ----------
        depth
            Sinkage of the rim, shape (rows,), m.
        rut
            Depth of the rut that earlier passes left, shape (rows,), m; 0 if not given.

        Returns
        -------
        thrust, torque : ndarray
            Shape (rows,): N, N m; negative when skidding.
        """
        diameter, width = self.at.diameter, self.at.width
        contact = Contact.at(diameter, depth, rut)
        shear = shear_stress(self.stress(contact), contact, self.soil, self.at)
        return contact.upward(shear, width), diameter / 2 * contact.along(shear, width)

    def response(self) -> Response:
        """Compute the true values of each row.

        At the sinkage, the stress over the contact carries the load; the resistance is the horizontal
        component of the same stress, and bulldozing at that depth in addition.
        """
        at = self.at
        rut = self.rut()
        depth = self.depth(rut)
        _, resistance = self.forces(depth, rut)
        thrust, torque = self.traction(depth, rut)
        for pushed in acting(self.effects, "resistance"):
            resistance = resistance + pushed(depth, self.soil, at)
        rut_behind = depth
        lowest = self.stress(Contact.at(at.diameter, depth, rut))[:, -1]
        for rebound in acting(self.effects, "rebound"):
            rut_behind = rut_behind - rebound(lowest)[0]
        return Response(
            depth=depth,
            shown_sinkage=shown_by_instrument(self.effects, "sinkage", rut_behind, at),
            resistance=resistance,
            shown_resistance=shown_by_instrument(self.effects, "resistance", resistance, at),
            thrust=thrust,
            torque=torque,
        )

    def firmness(self) -> float:
        """Factor by which effects on the soil's stiffness change the load that it carries.

        At the sinkage without effects; the mean over the rows.
        """
        fresh = np.zeros(self.at.load.shape)
        depth = replace(self, effects=()).depth(fresh)
        firmer = [effect for effect in self.effects if effect.law.on_stiffness]
        carried, _ = replace(self, effects=firmer).forces(depth, fresh)
        return float(np.mean(carried / self.at.load))
