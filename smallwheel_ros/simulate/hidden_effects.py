# SPDX-License-Identifier: Apache-2.0
# ruff: noqa: D102 - HiddenEffect describes the methods once, for all effects
"""Effects that the truth can have in it and the user does not know of.

Each acts on the stress at the points of the contact, and has a form of its own, other than the
published forms which the library fits: a tool that finds the effect only where it knows the exact
formula has found nothing. `form="published"` takes a form from the literature instead, to see what
a fit reaches where its form is right.

Here are the effects that dig, push or spring back; those on the stiffness of the soil are in
`hidden_stiffness`, faults of instruments in `hidden_faults`. In the formulas s is the share of the
contact's length that the soil at a point has passed (0 at the entry, 1 at the lowest point). With
slip i it was carried i s of that length by the rim: Wong and Reece's (1967) shear displacement less
its part at no slip, over the length of the contact.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, ClassVar, Literal

import numpy as np

from smallwheel_ros.simulate.contact import Array, Contact
from smallwheel_ros.simulate.truth import Circumstances, TruthSoil

Form = Literal["own", "published"]
FORMS: tuple[Form, ...] = ("own", "published")


@dataclass(frozen=True)
class HiddenEffect:
    """One effect in the truth; what it does not change stays as it is.

    Methods on a contact give values at its points, of shape (rows, nodes); others by row.
    """

    form: Form
    amplitude: float

    name: ClassVar[str] = ""
    formula: ClassVar[dict[Form, str]] = {}
    typical: ClassVar[dict[Form, float]] = {}  # amplitude at strength 1
    needs: ClassVar[tuple[str, ...]] = ()  # columns that a table has only for this effect
    kind: ClassVar[Literal["soil", "instrument"]] = "soil"
    on_stiffness: ClassVar[bool] = False  # changes how firm the soil is for any wheel
    in_ruts: ClassVar[bool] = False  # depends on the rut that earlier passes left
    in_drives: ClassVar[bool] = True  # false where a drive's bag has no sensor for the driver

    @classmethod
    def draw(cls, rng: np.random.Generator, strength: float, form: Form) -> HiddenEffect:
        """Draw an effect of about the typical size (within 15 %)."""
        return cls(form, strength * cls.typical[form] * rng.uniform(0.85, 1.15))

    def modulus(self, at: Circumstances) -> Array | float:
        """Factor on k for the whole contact."""
        return 1.0

    def local(self, contact: Contact, at: Circumstances) -> Array | float:
        """Factor on the stress at each point."""
        return 1.0

    def layering(self, depth: Array, soil: TruthSoil) -> Array | float:
        """Factor on the pressure at a depth (m)."""
        return 1.0

    def carried_away(self, contact: Contact, at: Circumstances) -> Array | float:
        """Thickness (m) of soil that is gone at each point and not compressed any more."""
        return 0.0

    def sinkage(self, sinkage: Array, at: Circumstances) -> Array:
        """Depth of the wheel (m) where the balance of load gives `sinkage`; published forms."""
        return sinkage

    def added_resistance(self, depth: Array, soil: TruthSoil, at: Circumstances) -> Array | float:
        """Resistance (N) besides that of the stress on the front."""
        return 0.0

    def rebound(self, pressure: Array) -> Array | None:
        """How far the soil comes up again (m) behind a wheel with that pressure (Pa) under it."""
        return None

    def unloading(self, left: Array) -> Array:
        """Share of the pressure that is left where a share `left` of the rebound is to come."""
        return left

    def shown(self, channel: str, value: Array, at: Circumstances) -> Array:
        """What an instrument without noise shows of `sinkage` (m), `resistance` or `load` (N)."""
        return value

    def describe(self) -> dict[str, Any]:
        """Name, formula and numbers, for the answer."""
        return {"effect": self.name, "formula": self.formula[self.form], **asdict(self)}


class SlipSinkage(HiddenEffect):
    """Digging in when driven: 2 to 3 times the sinkage at slip 0.6.

    The soil that the rim has carried along holds less; the front, where it has not moved yet, holds
    as before. The stress moves forward with slip, as Wong and Reece (1967) measured, the wheel
    sinks until it carries the load again, and the front has more soil to push down.
    """

    name = "slip_sinkage"
    formula: ClassVar = {
        "own": "stress / (1 + (A i s)^1.7), i > 0",
        "published": "z = z0 exp(A i), i > 0",
    }
    typical: ClassVar = {"own": 5.5, "published": 1.5}

    def local(self, contact: Contact, at: Circumstances) -> Array | float:
        if self.form == "published":
            return 1.0
        carried = np.maximum(at.slip, 0.0)[:, None] * contact.passed
        return np.asarray(1.0 / (1.0 + (self.amplitude * carried) ** 1.7))

    def sinkage(self, sinkage: Array, at: Circumstances) -> Array:
        if self.form == "own":
            return sinkage
        deeper: Array = sinkage * np.exp(self.amplitude * np.maximum(at.slip, 0.0))
        return deeper


class SkidSinkage(HiddenEffect):
    """Ploughing in when braked: soil dragged along with the rim holds less."""

    name = "skid_sinkage"
    formula: ClassVar = {
        "own": "stress exp(-A (|i| s)^1.3), i < 0",
        "published": "z = z0 exp(A |i|), i < 0",
    }
    typical: ClassVar = {"own": 6.0, "published": 1.5}

    def local(self, contact: Contact, at: Circumstances) -> Array | float:
        if self.form == "published":
            return 1.0
        dragged = np.maximum(-at.slip, 0.0)[:, None] * contact.passed
        return np.asarray(np.exp(-self.amplitude * dragged**1.3))

    def sinkage(self, sinkage: Array, at: Circumstances) -> Array:
        if self.form == "own":
            return sinkage
        deeper: Array = sinkage * np.exp(self.amplitude * np.maximum(-at.slip, 0.0))
        return deeper


class SlipAngleSinkage(HiddenEffect):
    """Ploughing sideways: soil that the rim has pushed aside holds less."""

    name = "slip_angle_sinkage"
    formula: ClassVar = {
        "own": "stress / (1 + A s tan(beta)^2)",
        "published": "z = z0 (1 + A (1 - cos beta))",
    }
    typical: ClassVar = {"own": 4.0, "published": 4.0}
    needs = ("slip_angle",)
    in_drives = False

    def local(self, contact: Contact, at: Circumstances) -> Array | float:
        if self.form == "published":
            return 1.0
        aside = np.tan(at.slip_angle)[:, None] ** 2 * contact.passed
        return np.asarray(1.0 / (1.0 + self.amplitude * aside))

    def sinkage(self, sinkage: Array, at: Circumstances) -> Array:
        if self.form == "own":
            return sinkage
        return sinkage * (1.0 + self.amplitude * (1.0 - np.cos(at.slip_angle)))


class Bulldozing(HiddenEffect):
    """Soil pushed ahead of the wheel: 20 to 60 % more resistance; sinkage does not show it."""

    name = "bulldozing"
    formula: ClassVar = {
        "own": "R = A (b (g z^2 K / 2 + 2 c z sqrt(K)) + g z^3 K tan(phi) / 3), K Coulomb's passive"
        " coefficient with wall friction phi/2: a wall with failing wedges at its sides",
        "published": "R = A b (g z^2 K / 2 + 2 c z sqrt(K)), K Rankine's passive coefficient",
    }
    typical: ClassVar = {"own": 1.0, "published": 1.4}

    def added_resistance(self, depth: Array, soil: TruthSoil, at: Circumstances) -> Array:
        phi = soil.friction_angle
        rankine = np.tan(np.pi / 4 + phi / 2) ** 2
        wall = phi / 2
        root = np.sqrt(np.sin(phi + wall) * np.sin(phi) / np.cos(wall))
        coulomb = np.cos(phi) ** 2 / (np.cos(wall) * (1.0 - root) ** 2)
        passive = coulomb if self.form == "own" else rankine
        weight = soil.unit_weight * depth**2 * passive / 2
        cohesion = 2.0 * soil.cohesion * depth * np.sqrt(passive)
        sides = soil.unit_weight * depth**3 * passive * np.tan(phi) / 3
        total: Array = at.width * (weight + cohesion) + (sides if self.form == "own" else 0.0)
        return self.amplitude * total


class Multipass(HiddenEffect):
    """The rut deepens with each pass, from the untouched surface: 1.5 times at the fifth.

    Loose soil that slid back into the rut holds less than it did; below the rut the soil is as it
    was. Each pass therefore finds its depth a little below the one before, ever less so.
    """

    name = "multipass"
    formula: ClassVar = {
        "own": "stress (1 - A exp(-(z / rut)^4)), rut the depth after the pass before",
        "published": "z = z1 N^A",
    }
    typical: ClassVar = {"own": 0.66, "published": 0.25}
    in_ruts = True

    def local(self, contact: Contact, at: Circumstances) -> Array | float:
        if self.form == "published":
            return 1.0
        rut = contact.rut[:, None]
        with np.errstate(divide="ignore", invalid="ignore"):
            loose = np.where(rut > 0, np.exp(-((contact.depth / rut) ** 4)), 0.0)
        return np.asarray(1.0 - min(self.amplitude, 0.95) * loose)

    def sinkage(self, sinkage: Array, at: Circumstances) -> Array:
        if self.form == "own":
            return sinkage
        return np.asarray(sinkage * np.power(at.pass_number, self.amplitude))


class Grouser(HiddenEffect):
    """Grousers dig when they slip: they carry away soil that the rim would have pressed on."""

    name = "grouser"
    formula: ClassVar = {
        "own": "stress at z - A h (1 - exp(-i s / 0.15)), i > 0",
        "published": "z = z0 + A h i, i > 0",
    }
    typical: ClassVar = {"own": 0.8, "published": 1.3}
    needs = ("grouser_height",)
    in_drives = False

    def carried_away(self, contact: Contact, at: Circumstances) -> Array | float:
        if self.form == "published":
            return 0.0
        carried = np.maximum(at.slip, 0.0)[:, None] * contact.passed
        dug = -self.amplitude * at.grouser_height[:, None] * np.expm1(-carried / 0.15)
        return np.asarray(dug)

    def sinkage(self, sinkage: Array, at: Circumstances) -> Array:
        if self.form == "own":
            return sinkage
        return np.asarray(sinkage + self.amplitude * at.grouser_height * np.maximum(at.slip, 0.0))


@dataclass(frozen=True)
class ElasticRebound(HiddenEffect):
    """The rut, which is measured, is shallower than the wheel was.

    The soil that rises behind the lowest point carries a share of the load and pushes the wheel on.
    """

    softening: float = 60e3

    name = "elastic_rebound"
    formula: ClassVar = {
        "own": "rut = z - A p / (1 + p / softening), p the pressure at z; it unloads as x^1.5, x"
        " the share of the rebound that is still to come",
        "published": "rut = z - A p; it unloads as x",
    }
    typical: ClassVar = {"own": 8e-8, "published": 7e-8}

    def rebound(self, pressure: Array) -> Array | None:
        rise = self.amplitude * pressure
        return rise / (1.0 + pressure / self.softening) if self.form == "own" else rise

    def unloading(self, left: Array) -> Array:
        return left**1.5 if self.form == "own" else left
