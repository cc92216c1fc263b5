# SPDX-License-Identifier: Apache-2.0
"""What wheels really do in a truth soil with hidden effects in it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from smallwheel_ros.simulate.contact import Array, Contact, sinkage_under
from smallwheel_ros.simulate.hidden_effects import HiddenEffect, acting
from smallwheel_ros.simulate.truth import Circumstances, TruthSoil, shear_stress


@dataclass(frozen=True)
class Response:
    """True values, each of shape (rows,); NaN in all of them where a wheel sinks to its axle.

    What is `shown` is what an instrument without noise shows: it differs by the instrument's fault
    and, for sinkage, by soil that comes up again behind the wheel.
    """

    depth: Array  # m, lowest point of the wheel below the untouched surface
    shown_sinkage: Array  # m
    resistance: Array  # N
    shown_resistance: Array  # N
    thrust: Array  # N
    torque: Array  # N m, that drives the wheel

    @property
    def drawbar_pull(self) -> Array:
        """Thrust less resistance, N."""
        return self.thrust - self.resistance


@dataclass(frozen=True)
class Ground:
    """Soil with effects, as certain wheels meet it; `scatter` multiplies k."""

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
        """Load that is carried and horizontal force on the wheel, both N, at a sinkage (m)."""
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
        """Sinkage (m) under the load; NaN where the wheel sinks to its axle."""
        at = self.at
        return sinkage_under(at.load, at.diameter, lambda z: self.forces(z, rut)[0])

    def rut(self) -> Array:
        """Depth (m) of the rut that earlier passes of the same wheel under the same load left."""
        rut = np.zeros(self.at.load.shape)
        if not any(effect.law.in_ruts for effect in self.effects):
            return rut
        passes = self.at.pass_number
        for earlier in range(1, int(np.max(passes))):
            rut = np.where(passes > earlier, self.depth(rut), rut)
        return rut


def traction_at(
    soil: TruthSoil,
    effects: Sequence[HiddenEffect],
    at: Circumstances,
    scatter: Array | float,
    depth: Array,
) -> tuple[Array, Array]:
    """Thrust (N) and driving torque (N m) of wheels whose depth (m) is known."""
    contact = Contact.at(at.diameter, depth)
    return _traction(Ground(soil, effects, at, scatter).stress(contact), contact, soil, at)


def _traction(
    stress: Array, contact: Contact, soil: TruthSoil, at: Circumstances
) -> tuple[Array, Array]:
    """Thrust (N) and driving torque (N m) of the shear stress that a normal stress (Pa) goes with."""
    shear = shear_stress(stress, contact, soil, at)
    return contact.upward(shear, at.width), at.diameter / 2 * contact.along(shear, at.width)


def wheel_response(
    soil: TruthSoil,
    effects: Sequence[HiddenEffect],
    at: Circumstances,
    scatter: Array | float = 1.0,
) -> Response:
    """Compute the truth for each row.

    Sinkage is where the stress over the contact carries the load, resistance the horizontal
    component of the same stress. Bulldozing comes on top, at the final depth. Effects of the form
    `published` that deepen the rut do so after that balance, as their authors have it; resistance
    is then that of the undisturbed soil down to the greater depth.

    Parameters
    ----------
    scatter
        Factor on k, by row or for all.
    """
    ground = Ground(soil, effects, at, scatter)
    rut = ground.rut()
    depth = ground.depth(rut)
    for deeper in acting(effects, "sinkage"):
        depth = deeper(depth, at)
    depth = np.where(depth < at.diameter / 2, depth, np.nan)
    _, resistance = ground.forces(depth, rut)
    contact = Contact.at(at.diameter, depth, rut)
    stress = ground.stress(contact)
    thrust, torque = _traction(stress, contact, soil, at)
    shown = depth
    for pushed in acting(effects, "resistance"):
        resistance = resistance + pushed(depth, soil, at)
    for rebound in acting(effects, "rebound"):
        shown = shown - rebound(stress[:, -1])[0]
    return Response(
        depth=depth,
        shown_sinkage=shown_by_instrument(effects, "sinkage", shown, at),
        resistance=resistance,
        shown_resistance=shown_by_instrument(effects, "resistance", resistance, at),
        thrust=thrust,
        torque=torque,
    )


def firmness(soil: TruthSoil, effects: Sequence[HiddenEffect], at: Circumstances) -> float:
    """How much firmer the effects on stiffness make the soil: as a factor on the load it carries.

    Taken at the sinkage without them, averaged over the rows.
    """
    plain = Ground(soil, (), at)
    there = Ground(soil, [effect for effect in effects if effect.law.on_stiffness], at)
    fresh = np.zeros(at.load.shape)
    depth = plain.depth(fresh)
    return float(np.mean(there.forces(depth, fresh)[0] / at.load))


def shown_by_instrument(
    effects: Sequence[HiddenEffect], channel: str, value: Array, at: Circumstances
) -> Array:
    """Let the faults of instruments have their say about `sinkage`, `resistance` or `load`."""
    for shows in acting(effects, f"shown_{channel}"):
        value = shows(value, at)
    return value
