# SPDX-License-Identifier: Apache-2.0
# ruff: noqa: D102 - HiddenEffect describes the methods once, for all effects
"""Hidden effects on how firm the soil is: by rate, load, width, layers, or something recorded."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from smallwheel_ros.simulate.contact import Array, Contact
from smallwheel_ros.simulate.hidden_effects import Form, HiddenEffect
from smallwheel_ros.simulate.truth import Circumstances, TruthSoil


class PenetrationRate(HiddenEffect):
    """Soil is stiffer where it is pressed faster: 15 to 20 % of sinkage over 0.01 to 0.5 m/s.

    A point of the rim goes down at v sin(theta): fastest at the entry, not at all at the bottom.
    """

    name = "penetration_rate"
    formula: ClassVar = {
        "own": "stress (1 + A x / (1 + x)), x = v sin(theta) / 0.02 m/s",
        "published": "k (v / 0.1 m/s)^A",
    }
    typical: ClassVar = {"own": 0.45, "published": 0.06}
    on_stiffness = True

    def modulus(self, at: Circumstances) -> Array | float:
        if self.form == "own":
            return 1.0
        return np.power(np.maximum(at.speed, 1e-3) / 0.1, self.amplitude)

    def local(self, contact: Contact, at: Circumstances) -> Array | float:
        if self.form == "published":
            return 1.0
        x = at.speed[:, None] * np.sin(contact.angle) / 0.02
        return np.asarray(1.0 + self.amplitude * x / (1.0 + x))


class LoadDependentModulus(HiddenEffect):
    """Soil is stiffer under a heavier wheel, a little more so right under its axle.

    Only a little: confinement of the axle alone would change the shape of the stress more than its
    size, and be another effect than one of the load.
    """

    name = "load_dependent_modulus"
    formula: ClassVar = {
        "own": "stress (1 + A W / (W + 60 N) (1 - 0.1 (theta / theta0)^2))",
        "published": "k (W / 60 N)^A",
    }
    typical: ClassVar = {"own": 2.0, "published": 0.25}
    on_stiffness = True

    def modulus(self, at: Circumstances) -> Array | float:
        return 1.0 if self.form == "own" else np.power(at.load / 60.0, self.amplitude)

    def local(self, contact: Contact, at: Circumstances) -> Array | float:
        if self.form == "published":
            return 1.0
        confined = 1.0 - 0.1 * (contact.angle / np.maximum(contact.entry, 1e-12)[:, None]) ** 2
        return np.asarray(1.0 + self.amplitude * (at.load / (at.load + 60.0))[:, None] * confined)


class WidthDependentModulus(HiddenEffect):
    """Soil is stiffer under a narrower wheel: its edges shear soil that holds on beside it.

    Own form: the share A exp(-y / l) at a distance y from the nearer edge, integrated over the width;
    the zone at the edges is wider where the wheel is deeper.
    """

    name = "width_dependent_modulus"
    formula: ClassVar = {
        "own": "stress (1 + A (2 l / b) (1 - exp(-b / (2 l)))), l = 20 mm + z",
        "published": "k (1 + A 0.1 m / b): Bekker's kc/b + kphi",
    }
    typical: ClassVar = {"own": 3.0, "published": 0.3}
    on_stiffness = True

    def modulus(self, at: Circumstances) -> Array | float:
        return 1.0 if self.form == "own" else 1.0 + self.amplitude * 0.1 / at.width

    def local(self, contact: Contact, at: Circumstances) -> Array | float:
        if self.form == "published":
            return 1.0
        x = at.width[:, None] / (2.0 * (0.02 + contact.depth))
        return np.asarray(1.0 - self.amplitude * np.expm1(-x) / x)


@dataclass(frozen=True)
class Hardpan(HiddenEffect):
    """A hard layer below; `level` (m) is where it makes itself felt."""

    level: float = 0.02

    name = "hardpan"
    formula: ClassVar = {
        "own": "p = p0(z) + A p0(level) ln(1 + exp((z - level) / d)) d / level, d = level / 10:"
        " two layers, the lower one a bed of springs",
        "published": "p = k z^n D^m (-ln(1 - x) / x)^A, x = z / (2 level) (Preston and Thomas)",
    }
    typical: ClassVar = {"own": 8.0, "published": 1.0}

    @classmethod
    def draw(cls, rng: np.random.Generator, strength: float, form: Form) -> HiddenEffect:
        return cls(form, strength * cls.typical[form], rng.uniform(0.014, 0.024))

    def layering(self, depth: Array, soil: TruthSoil) -> Array:
        if self.form == "own":
            x = np.maximum(depth, 1e-9) / self.level
            below = 0.1 * np.logaddexp(0.0, (x - 1.0) / 0.1)
            return np.asarray(1.0 + self.amplitude * below / x**soil.n)
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
    on_stiffness = True
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
