# ruff: noqa: D102 - HiddenEffect describes the methods once, for all effects
"""Effects that the truth can have in it and the user does not know of.

Each has a form of its own, other than the published forms which the library fits: a tool that finds
the effect only where it knows the exact formula has found nothing. `form="published"` takes a form
from the literature instead, to see what a fit reaches where its form is right. Faults of
instruments are in `hidden_faults`.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, ClassVar, Literal

import numpy as np

from smallwheel_ros.simulate.truth import Array, Circumstances, TruthSoil

Form = Literal["own", "published"]
FORMS: tuple[Form, ...] = ("own", "published")


@dataclass(frozen=True)
class HiddenEffect:
    """One effect in the truth; what it does not change stays as it is."""

    form: Form
    amplitude: float

    name: ClassVar[str] = ""
    formula: ClassVar[dict[Form, str]] = {}
    typical: ClassVar[dict[Form, float]] = {}  # amplitude at strength 1
    needs: ClassVar[tuple[str, ...]] = ()  # columns that a table has only for this effect
    kind: ClassVar[Literal["soil", "instrument"]] = "soil"
    in_drives: ClassVar[bool] = True  # false where a drive's bag has no sensor for the driver

    @classmethod
    def draw(cls, rng: np.random.Generator, strength: float, form: Form) -> HiddenEffect:
        """Draw an effect of about the typical size (within 15 %)."""
        return cls(form, strength * cls.typical[form] * rng.uniform(0.85, 1.15))

    def modulus(self, at: Circumstances) -> Array | float:
        """Factor on k."""
        return 1.0

    def stiffening(self, depth: Array) -> Array | float:
        """Factor on the pressure at a depth (m), shapes (rows, nodes)."""
        return 1.0

    def sinkage(self, sinkage: Array, at: Circumstances) -> Array:
        """Depth of the wheel (m) where the load alone would give `sinkage`."""
        return sinkage

    def added_resistance(self, depth: Array, soil: TruthSoil, at: Circumstances) -> Array | float:
        """Resistance (N) besides that of the pressure."""
        return 0.0

    def rebound(self, pressure: Array) -> Array | float:
        """How far the soil comes up again (m) behind a wheel with that pressure (Pa) under it."""
        return 0.0

    def shown(self, channel: str, value: Array, at: Circumstances) -> Array:
        """What an instrument without noise shows of `sinkage` (m), `resistance` or `load` (N)."""
        return value

    def describe(self) -> dict[str, Any]:
        """Name, formula and numbers, for the answer."""
        return {"effect": self.name, "formula": self.formula[self.form], **asdict(self)}


class SlipSinkage(HiddenEffect):
    """Digging in when driven: 2 to 3 times the sinkage at slip 0.6."""

    name = "slip_sinkage"
    formula: ClassVar = {
        "own": "z = z0 (1 + A i^2 / (i + 0.25)), i > 0",
        "published": "z = z0 exp(A i), i > 0",
    }
    typical: ClassVar = {"own": 3.57, "published": 1.5}

    def sinkage(self, sinkage: Array, at: Circumstances) -> Array:
        slip = np.maximum(at.slip, 0.0)
        if self.form == "own":
            factor = 1.0 + self.amplitude * slip**2 / (slip + 0.25)
        else:
            factor = np.exp(self.amplitude * slip)
        deeper: Array = sinkage * factor
        return deeper


class SkidSinkage(HiddenEffect):
    """Ploughing in when braked."""

    name = "skid_sinkage"
    formula: ClassVar = {
        "own": "z = z0 (1 + A |i|^1.6), i < 0",
        "published": "z = z0 exp(A |i|), i < 0",
    }
    typical: ClassVar = {"own": 3.4, "published": 1.5}

    def sinkage(self, sinkage: Array, at: Circumstances) -> Array:
        skid = np.maximum(-at.slip, 0.0)
        if self.form == "own":
            return sinkage * (1.0 + self.amplitude * skid**1.6)
        deeper: Array = sinkage * np.exp(self.amplitude * skid)
        return deeper


class SlipAngleSinkage(HiddenEffect):
    """Ploughing sideways."""

    name = "slip_angle_sinkage"
    formula: ClassVar = {
        "own": "z = z0 (1 + A (1 - exp(-(beta / 0.4 rad)^2)))",
        "published": "z = z0 (1 + A (1 - cos beta))",
    }
    typical: ClassVar = {"own": 1.2, "published": 4.0}
    needs = ("slip_angle",)
    in_drives = False

    def sinkage(self, sinkage: Array, at: Circumstances) -> Array:
        if self.form == "own":
            return sinkage * (1.0 - self.amplitude * np.expm1(-((at.slip_angle / 0.4) ** 2)))
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


class PenetrationRate(HiddenEffect):
    """Soil is stiffer when loaded faster: 15 to 20 % of sinkage over 0.01 to 0.5 m/s."""

    name = "penetration_rate"
    formula: ClassVar = {
        "own": "k (1 + A x / (1 + x)), x = v / 0.08 m/s",
        "published": "k (v / 0.1 m/s)^A",
    }
    typical: ClassVar = {"own": 0.4, "published": 0.06}

    def modulus(self, at: Circumstances) -> Array:
        if self.form == "own":
            x = at.speed / 0.08
            return 1.0 + self.amplitude * x / (1.0 + x)
        return np.power(np.maximum(at.speed, 1e-3) / 0.1, self.amplitude)


class LoadDependentModulus(HiddenEffect):
    """Soil is stiffer under a heavier wheel."""

    name = "load_dependent_modulus"
    formula: ClassVar = {"own": "k (1 + A W / (W + 60 N))", "published": "k (W / 60 N)^A"}
    typical: ClassVar = {"own": 2.0, "published": 0.25}

    def modulus(self, at: Circumstances) -> Array:
        if self.form == "own":
            return 1.0 + self.amplitude * at.load / (at.load + 60.0)
        return np.power(at.load / 60.0, self.amplitude)


class WidthDependentModulus(HiddenEffect):
    """Soil is stiffer under a narrower wheel."""

    name = "width_dependent_modulus"
    formula: ClassVar = {
        "own": "k (1 + A 0.1 m / (b + 0.02 m)): kc/b + kphi, levelling off for narrow wheels",
        "published": "k (1 + A 0.1 m / b): Bekker's kc/b + kphi",
    }
    typical: ClassVar = {"own": 0.6, "published": 0.3}

    def modulus(self, at: Circumstances) -> Array:
        levelling = 0.02 if self.form == "own" else 0.0
        return 1.0 + self.amplitude * 0.1 / (at.width + levelling)


class Multipass(HiddenEffect):
    """The rut deepens with each pass, from the untouched surface: 1.5 times at the fifth."""

    name = "multipass"
    formula: ClassVar = {
        "own": "z = z1 (1 + A (1 - exp(-(N - 1) / 2)))",
        "published": "z = z1 N^A",
    }
    typical: ClassVar = {"own": 0.58, "published": 0.25}

    def sinkage(self, sinkage: Array, at: Circumstances) -> Array:
        if self.form == "own":
            factor = 1.0 - self.amplitude * np.expm1(-(at.pass_number - 1.0) / 2.0)
        else:
            factor = np.power(at.pass_number, self.amplitude)
        return np.asarray(sinkage * factor)


@dataclass(frozen=True)
class Hardpan(HiddenEffect):
    """A hard layer below; `level` (m) is where it makes itself felt."""

    level: float = 0.02

    name = "hardpan"
    formula: ClassVar = {
        "own": "p = k z^n D^m (1 + A (z / level)^4)",
        "published": "p = k z^n D^m (-ln(1 - x) / x)^A, x = z / (2 level) (Preston and Thomas)",
    }
    typical: ClassVar = {"own": 1.0, "published": 1.0}

    @classmethod
    def draw(cls, rng: np.random.Generator, strength: float, form: Form) -> HiddenEffect:
        return cls(form, strength, rng.uniform(0.014, 0.024))

    def stiffening(self, depth: Array) -> Array:
        if self.form == "own":
            return 1.0 + self.amplitude * (depth / self.level) ** 4
        x = np.clip(depth / (2.0 * self.level), 1e-9, 1.0 - 1e-9)
        return np.power(-np.log1p(-x) / x, self.amplitude)


@dataclass(frozen=True)
class ColumnEffect(HiddenEffect):
    """k follows something else that is recorded: its column is `column`, its middle `centre`."""

    column: str = ""
    centre: float = 0.0
    half_range: float = 1.0

    name = "column"
    formula: ClassVar = {
        "own": "k (1 + A tanh((w - centre) / half_range))",
        "published": "k exp(A (w - centre) / half_range)",
    }
    typical: ClassVar = {"own": 0.4, "published": 0.4}
    in_drives = False

    @property
    def extent(self) -> tuple[float, float]:
        """Lowest and highest value in a table."""
        return self.centre - self.half_range, self.centre + self.half_range

    def modulus(self, at: Circumstances) -> Array:
        x = (at.covariates[self.column] - self.centre) / self.half_range
        return (
            1.0 + self.amplitude * np.tanh(x) if self.form == "own" else np.exp(self.amplitude * x)
        )


class Unrecorded(HiddenEffect):
    """k follows something that nobody recorded, one value u a run, even between -1 and 1."""

    name = "unrecorded"
    formula: ClassVar = {"own": "k exp(A u)", "published": "k exp(A u)"}
    typical: ClassVar = {"own": 0.4, "published": 0.4}

    def modulus(self, at: Circumstances) -> Array | float:
        return 1.0 if at.hidden is None else np.exp(self.amplitude * at.hidden)


class Grouser(HiddenEffect):
    """Grousers dig when they slip."""

    name = "grouser"
    formula: ClassVar = {
        "own": "z = z0 + A h (1 - exp(-i / 0.2)), i > 0",
        "published": "z = z0 + A h i, i > 0",
    }
    typical: ClassVar = {"own": 0.8, "published": 1.3}
    needs = ("grouser_height",)
    in_drives = False

    def sinkage(self, sinkage: Array, at: Circumstances) -> Array:
        slip = np.maximum(at.slip, 0.0)
        share = -np.expm1(-slip / 0.2) if self.form == "own" else slip
        return np.asarray(sinkage + self.amplitude * at.grouser_height * share)


@dataclass(frozen=True)
class ElasticRebound(HiddenEffect):
    """The rut, which is measured, is shallower than the wheel was; some of the work comes back."""

    softening: float = 60e3

    name = "elastic_rebound"
    formula: ClassVar = {
        "own": "rut = z - A p / (1 + p / softening), p the pressure at z",
        "published": "rut = z - A p",
    }
    typical: ClassVar = {"own": 1.2e-7, "published": 1e-7}

    def rebound(self, pressure: Array) -> Array:
        rise = self.amplitude * pressure
        return rise / (1.0 + pressure / self.softening) if self.form == "own" else rise
