# SPDX-License-Identifier: Apache-2.0
"""Effects that the truth can have in it and the user does not know of: a table of plain functions.

Each acts on the stress at the points of the contact, and has a form of its own, other than the
published forms which the library fits: a tool that finds the effect only where it knows the exact
formula has found nothing. The form ``published`` is one from the literature instead, to see what
a fit reaches where its form is right.

In the formulas s is the share of the contact's length that the soil at a point has passed (0 at the
entry, 1 at the lowest point). With slip i it was carried i s of that length by the rim: Wong and
Reece's (1967) shear displacement less its part at no slip, over the length of the contact.

An effect is a row of `LAWS`: for each form its formula, its typical size, and a function for each
stage of the truth in which it acts. The functions get the effect with its numbers first:

| stage | arguments | gives |
| --- | --- | --- |
| `modulus` | circumstances | factor on k for the whole contact, by row |
| `stress` | contact, circumstances, soil | factor on the stress at each point, (rows, nodes) |
| `carried_away` | contact, circumstances | thickness (m) of soil at each point that is gone |
| `sinkage` | sinkage (m), circumstances | depth (m) where the balance of load gives `sinkage` |
| `resistance` | depth (m), soil, circumstances | resistance (N) besides that of the front's stress |
| `rebound` | pressure (Pa) under the wheel | how far the soil comes up behind it (m); it unloads as the |
| | | share of that which is still to come, to this exponent |
| `shown_sinkage`, `shown_resistance`, `shown_load` | value, circumstances | what an instrument without |
| | | noise shows of it |
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Literal

import numpy as np

from smallwheel_ros.simulate.contact import Array, Contact
from smallwheel_ros.simulate.truth import Circumstances, TruthSoil

Form = Literal["own", "published"]
FORMS: tuple[Form, ...] = ("own", "published")


@dataclass(frozen=True)
class HiddenEffect:
    """One effect in the truth. numbers: besides the amplitude, as its formula names them."""

    name: str
    form: Form
    amplitude: float
    numbers: Mapping[str, Any] = field(default_factory=dict)

    @property
    def law(self) -> Law:
        """Its row of the table."""
        return LAWS[self.name]

    def describe(self) -> dict[str, Any]:
        """Name, formula and numbers, for the answer."""
        told = {"effect": self.name, "formula": self.law.forms[self.form].formula}
        return {**told, "form": self.form, "amplitude": self.amplitude, **self.numbers}


@dataclass(frozen=True)
class Shape:
    """One form of an effect: its formula, its amplitude at strength 1, and its stages."""

    formula: str
    typical: float
    stages: dict[str, Callable[..., Any]]


@dataclass(frozen=True)
class Law:
    """One effect.

    Attributes
    ----------
    own, published
        Its forms.
    needs
        Columns that a table has only for this effect.
    kind
        Whether the soil does it, or an instrument only shows it.
    on_stiffness
        Changes how firm the soil is for any wheel.
    in_ruts
        Depends on the rut that earlier passes left.
    in_drives
        False where a drive's bag has no sensor for the driver or the fault.
    either_sign
        Where no size is given the sign is drawn as well.
    numbers
        What it has besides its amplitude: a number, or two between which one is drawn; then the
        amplitude is the typical one.
    """

    own: Shape
    published: Shape
    needs: tuple[str, ...] = ()
    kind: Literal["soil", "instrument"] = "soil"
    on_stiffness: bool = False
    in_ruts: bool = False
    in_drives: bool = True
    either_sign: bool = False
    numbers: Mapping[str, Any] = field(default_factory=dict)

    @property
    def forms(self) -> dict[Form, Shape]:
        """Its forms by name."""
        return {"own": self.own, "published": self.published}


def acting(effects: Sequence[HiddenEffect], stage: str) -> Iterator[Callable[..., Any]]:
    """Give what effects do in a stage, in their order."""
    for effect in effects:
        function = effect.law.forms[effect.form].stages.get(stage)
        if function is not None:
            yield partial(function, effect)


# --- Stages of what digs, pushes or springs back


def _slip_stress(e: HiddenEffect, contact: Contact, at: Circumstances, _: TruthSoil) -> Array:
    carried = np.maximum(at.slip, 0.0)[:, None] * contact.passed
    return np.asarray(1.0 / (1.0 + (e.amplitude * carried) ** 1.7))


def _slip_sinkage(e: HiddenEffect, sinkage: Array, at: Circumstances) -> Array:
    return np.asarray(sinkage * np.exp(e.amplitude * np.maximum(at.slip, 0.0)))


def _skid_stress(e: HiddenEffect, contact: Contact, at: Circumstances, _: TruthSoil) -> Array:
    dragged = np.maximum(-at.slip, 0.0)[:, None] * contact.passed
    return np.asarray(np.exp(-e.amplitude * dragged**1.3))


def _skid_sinkage(e: HiddenEffect, sinkage: Array, at: Circumstances) -> Array:
    return np.asarray(sinkage * np.exp(e.amplitude * np.maximum(-at.slip, 0.0)))


def _sideways_stress(e: HiddenEffect, contact: Contact, at: Circumstances, _: TruthSoil) -> Array:
    aside = np.tan(at.slip_angle)[:, None] ** 2 * contact.passed
    return np.asarray(1.0 / (1.0 + e.amplitude * aside))


def _sideways_sinkage(e: HiddenEffect, sinkage: Array, at: Circumstances) -> Array:
    return np.asarray(sinkage * (1.0 + e.amplitude * (1.0 - np.cos(at.slip_angle))))


def _wall(e: HiddenEffect, depth: Array, soil: TruthSoil, at: Circumstances) -> Array:
    """Coulomb's passive pressure on a wall with failing wedges at its sides."""
    phi = soil.friction_angle
    friction = phi / 2
    root = np.sqrt(np.sin(phi + friction) * np.sin(phi) / np.cos(friction))
    passive = np.cos(phi) ** 2 / (np.cos(friction) * (1.0 - root) ** 2)
    sides = soil.unit_weight * depth**3 * passive * np.tan(phi) / 3
    return np.asarray(e.amplitude * (_pushed(passive, depth, soil, at) + sides))


def _plane_wall(e: HiddenEffect, depth: Array, soil: TruthSoil, at: Circumstances) -> Array:
    """Rankine's."""
    passive = np.tan(np.pi / 4 + soil.friction_angle / 2) ** 2
    return np.asarray(e.amplitude * (_pushed(passive, depth, soil, at) + 0.0))


def _pushed(passive: float, depth: Array, soil: TruthSoil, at: Circumstances) -> Array:
    weight = soil.unit_weight * depth**2 * passive / 2
    cohesion = 2.0 * soil.cohesion * depth * np.sqrt(passive)
    return np.asarray(at.width * (weight + cohesion))


def _loose_stress(e: HiddenEffect, contact: Contact, _: Circumstances, __: TruthSoil) -> Array:
    rut = contact.rut[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        loose = np.where(rut > 0, np.exp(-((contact.depth / rut) ** 4)), 0.0)
    return np.asarray(1.0 - min(e.amplitude, 0.95) * loose)


def _pass_sinkage(e: HiddenEffect, sinkage: Array, at: Circumstances) -> Array:
    return np.asarray(sinkage * np.power(at.pass_number, e.amplitude))


def _dug_away(e: HiddenEffect, contact: Contact, at: Circumstances) -> Array:
    carried = np.maximum(at.slip, 0.0)[:, None] * contact.passed
    return np.asarray(-e.amplitude * at.grouser_height[:, None] * np.expm1(-carried / 0.15))


def _dug_sinkage(e: HiddenEffect, sinkage: Array, at: Circumstances) -> Array:
    dug = e.amplitude * at.grouser_height * np.maximum(at.slip, 0.0)
    return np.asarray(sinkage + dug)


def _softening_rebound(e: HiddenEffect, pressure: Array) -> tuple[Array, float]:
    return e.amplitude * pressure / (1.0 + pressure / e.numbers["softening"]), 1.5


def _linear_rebound(e: HiddenEffect, pressure: Array) -> tuple[Array, float]:
    return e.amplitude * pressure, 1.0


# --- Stages of how firm the soil is: by rate, load, width, layers, or something recorded


def _rate_modulus(e: HiddenEffect, at: Circumstances) -> Array:
    return np.asarray(np.power(np.maximum(at.speed, 1e-3) / 0.1, e.amplitude))


def _rate_stress(e: HiddenEffect, contact: Contact, at: Circumstances, _: TruthSoil) -> Array:
    x = at.speed[:, None] * np.sin(contact.angle) / 0.02
    return np.asarray(1.0 + e.amplitude * x / (1.0 + x))


def _load_modulus(e: HiddenEffect, at: Circumstances) -> Array:
    return np.asarray(np.power(at.load / 60.0, e.amplitude))


def _load_stress(e: HiddenEffect, contact: Contact, at: Circumstances, _: TruthSoil) -> Array:
    confined = 1.0 - 0.1 * (contact.angle / np.maximum(contact.entry, 1e-12)[:, None]) ** 2
    return np.asarray(1.0 + e.amplitude * (at.load / (at.load + 60.0))[:, None] * confined)


def _width_modulus(e: HiddenEffect, at: Circumstances) -> Array:
    return np.asarray(1.0 + e.amplitude * 0.1 / at.width)


def _width_stress(e: HiddenEffect, contact: Contact, at: Circumstances, _: TruthSoil) -> Array:
    """Share A exp(-y / l) at a distance y from the nearer edge, integrated over the width."""
    x = at.width[:, None] / (2.0 * (0.02 + contact.depth))
    return np.asarray(1.0 - e.amplitude * np.expm1(-x) / x)


def _hardpan(e: HiddenEffect, contact: Contact, _: Circumstances, soil: TruthSoil) -> Array:
    x = np.maximum(contact.depth, 1e-9) / e.numbers["level"]
    below = 0.1 * np.logaddexp(0.0, (x - 1.0) / 0.1)
    return np.asarray(1.0 + e.amplitude * below / x**soil.n)


def _rigid_base(e: HiddenEffect, contact: Contact, _: Circumstances, __: TruthSoil) -> Array:
    x = np.clip(contact.depth / (2.0 * e.numbers["level"]), 1e-9, 1.0 - 1e-9)
    return np.asarray(np.power(-np.log1p(-x) / x, e.amplitude))


def _in_column(e: HiddenEffect, at: Circumstances) -> Array:
    """Where a column's value is in its range, from -1 to 1."""
    value = at.covariates[e.numbers["column"]]
    return np.asarray((value - e.numbers["centre"]) / e.numbers["half_range"])


def _column_modulus(e: HiddenEffect, at: Circumstances) -> Array:
    return np.asarray(1.0 + e.amplitude * np.tanh(_in_column(e, at)))


def _column_exponential(e: HiddenEffect, at: Circumstances) -> Array:
    return np.asarray(np.exp(e.amplitude * _in_column(e, at)))


def _unrecorded(e: HiddenEffect, at: Circumstances) -> Array | float:
    return 1.0 if at.hidden is None else np.asarray(np.exp(e.amplitude * at.hidden))


# --- Faults of instruments


def _gain(e: HiddenEffect, value: Array, _: Circumstances) -> Array:
    return value * (1.0 + e.amplitude)


def _zero(e: HiddenEffect, value: Array, _: Circumstances) -> Array:
    return value + e.amplitude


def _friction(e: HiddenEffect, value: Array, at: Circumstances) -> Array:
    return value + e.amplitude * at.load


def _saturating(e: HiddenEffect, value: Array, at: Circumstances) -> Array:
    share = np.expm1(-2.0 * np.maximum(at.slip, 0.0)) / np.expm1(-2.0)
    return np.asarray(value * (1.0 + e.amplitude * share))


def _growing(e: HiddenEffect, value: Array, at: Circumstances) -> Array:
    return np.asarray(value * (1.0 + e.amplitude * np.maximum(at.slip, 0.0)))


def _one_form(
    formula: str, typical: float, stage: str, does: Callable[..., Any], **of_law: Any
) -> Law:
    """Return an effect of which there is one sensible form, the one that the library fits too."""
    shape = Shape(formula, typical, {stage: does})
    return Law(shape, shape, **of_law)


_FAULT: dict[str, Any] = {"kind": "instrument", "in_drives": False}

LAWS: dict[str, Law] = {
    # Digging in when driven: 2 to 3 times the sinkage at slip 0.6. The soil that the rim has carried
    # along holds less; the front, where it has not moved yet, holds as before. The stress moves
    # forward with slip, as Wong and Reece (1967) measured, the wheel sinks until it carries the load
    # again, and the front has more soil to push down.
    "slip_sinkage": Law(
        own=Shape("stress / (1 + (A i s)^1.7), i > 0", 5.5, {"stress": _slip_stress}),
        published=Shape("z = z0 exp(A i), i > 0", 1.5, {"sinkage": _slip_sinkage}),
    ),
    # Ploughing in when braked: soil dragged along with the rim holds less.
    "skid_sinkage": Law(
        own=Shape("stress exp(-A (|i| s)^1.3), i < 0", 6.0, {"stress": _skid_stress}),
        published=Shape("z = z0 exp(A |i|), i < 0", 1.5, {"sinkage": _skid_sinkage}),
    ),
    # Ploughing sideways: soil that the rim has pushed aside holds less.
    "slip_angle_sinkage": Law(
        own=Shape("stress / (1 + A s tan(beta)^2)", 4.0, {"stress": _sideways_stress}),
        published=Shape("z = z0 (1 + A (1 - cos beta))", 4.0, {"sinkage": _sideways_sinkage}),
        needs=("slip_angle",),
        in_drives=False,
    ),
    # Soil pushed ahead of the wheel: 20 to 60 % more resistance; sinkage does not show it.
    "bulldozing": Law(
        own=Shape(
            "R = A (b (g z^2 K / 2 + 2 c z sqrt(K)) + g z^3 K tan(phi) / 3), K Coulomb's passive"
            " coefficient with wall friction phi/2: a wall with failing wedges at its sides",
            1.0,
            {"resistance": _wall},
        ),
        published=Shape(
            "R = A b (g z^2 K / 2 + 2 c z sqrt(K)), K Rankine's passive coefficient",
            1.4,
            {"resistance": _plane_wall},
        ),
    ),
    # Soil is stiffer where it is pressed faster: 15 to 20 % of sinkage over 0.01 to 0.5 m/s. A point
    # of the rim goes down at v sin(theta): fastest at the entry, not at all at the bottom.
    "penetration_rate": Law(
        own=Shape(
            "stress (1 + A x / (1 + x)), x = v sin(theta) / 0.02 m/s",
            0.45,
            {"stress": _rate_stress},
        ),
        published=Shape("k (v / 0.1 m/s)^A", 0.06, {"modulus": _rate_modulus}),
        on_stiffness=True,
    ),
    # Soil is stiffer under a heavier wheel, a little more so right under its axle. Only a little:
    # confinement of the axle alone would change the shape of the stress more than its size, and be
    # another effect than one of the load.
    "load_dependent_modulus": Law(
        own=Shape(
            "stress (1 + A W / (W + 60 N) (1 - 0.1 (theta / theta0)^2))",
            2.0,
            {"stress": _load_stress},
        ),
        published=Shape("k (W / 60 N)^A", 0.25, {"modulus": _load_modulus}),
        on_stiffness=True,
    ),
    # Soil is stiffer under a narrower wheel: its edges shear soil that holds on beside it; the zone at
    # the edges is wider where the wheel is deeper.
    "width_dependent_modulus": Law(
        own=Shape(
            "stress (1 + A (2 l / b) (1 - exp(-b / (2 l)))), l = 20 mm + z",
            3.0,
            {"stress": _width_stress},
        ),
        published=Shape(
            "k (1 + A 0.1 m / b): Bekker's kc/b + kphi", 0.3, {"modulus": _width_modulus}
        ),
        on_stiffness=True,
    ),
    # The rut deepens with each pass, from the untouched surface: 1.5 times at the fifth. Loose soil
    # that slid back into the rut holds less than it did; below the rut the soil is as it was. Each pass
    # therefore finds its depth a little below the one before, ever less so.
    "multipass": Law(
        own=Shape(
            "stress (1 - A exp(-(z / rut)^4)), rut the depth after the pass before",
            0.66,
            {"stress": _loose_stress},
        ),
        published=Shape("z = z1 N^A", 0.25, {"sinkage": _pass_sinkage}),
        in_ruts=True,
    ),
    # A hard layer below; `level` (m) is where it makes itself felt.
    "hardpan": Law(
        own=Shape(
            "p = p0(z) + A p0(level) ln(1 + exp((z - level) / d)) d / level, d = level / 10:"
            " two layers, the lower one a bed of springs",
            8.0,
            {"stress": _hardpan},
        ),
        published=Shape(
            "p = k z^n D^m (-ln(1 - x) / x)^A, x = z / (2 level) (Preston and Thomas)",
            1.0,
            {"stress": _rigid_base},
        ),
        numbers={"level": (0.014, 0.024)},
    ),
    # Grousers dig when they slip: they carry away soil that the rim would have pressed on.
    "grouser": Law(
        own=Shape(
            "stress at z - A h (1 - exp(-i s / 0.15)), i > 0", 0.8, {"carried_away": _dug_away}
        ),
        published=Shape("z = z0 + A h i, i > 0", 1.3, {"sinkage": _dug_sinkage}),
        needs=("grouser_height",),
        in_drives=False,
    ),
    # The rut, which is measured, is shallower than the wheel was. The soil that rises behind the lowest
    # point carries a share of the load and pushes the wheel on.
    "elastic_rebound": Law(
        own=Shape(
            "rut = z - A p / (1 + p / softening), p the pressure at z; it unloads as x^1.5, x"
            " the share of the rebound that is still to come",
            8e-8,
            {"rebound": _softening_rebound},
        ),
        published=Shape("rut = z - A p; it unloads as x", 7e-8, {"rebound": _linear_rebound}),
        numbers={"softening": 60e3},
    ),
    # k follows something that nobody recorded, one value u a run, even between -1 and 1.
    "unrecorded": _one_form("k exp(A u)", 0.4, "modulus", _unrecorded),
    # The zero of the sinkage sensor is off by 2 to 3 mm, always the same way.
    "sinkage_offset": _one_form(
        "measured z = z + A, m", 0.0025, "shown_sinkage", _zero, kind="instrument"
    ),
    # Scales are off by 10 %, zeros of the load cell by 4 N and of the sensor of resistance by 2 N.
    "sinkage_gain": _one_form(
        *("measured z = z (1 + A)", 0.10, "shown_sinkage", _gain),
        kind="instrument",
        either_sign=True,
    ),
    "load_offset": _one_form(
        "measured W = W + A, N", 4.0, "shown_load", _zero, **_FAULT, either_sign=True
    ),
    "load_gain": _one_form(
        "measured W = W (1 + A)", 0.10, "shown_load", _gain, **_FAULT, either_sign=True
    ),
    "resistance_offset": _one_form(
        "measured R = R + A, N", 2.0, "shown_resistance", _zero, **_FAULT, either_sign=True
    ),
    "resistance_gain": _one_form(
        "measured R = R (1 + A)", 0.10, "shown_resistance", _gain, **_FAULT, either_sign=True
    ),
    # The rig itself resists: 6 % of the load.
    "rig_friction": _one_form(
        "measured R = R + A W", 0.06, "shown_resistance", _friction, **_FAULT
    ),
    # The measured resistance grows with slip, the sinkage does not: by half at slip 1.
    "slip_resistance": Law(
        own=Shape(
            "measured R = R (1 + A (1 - exp(-2 i)) / (1 - exp(-2))), i > 0",
            0.5,
            {"shown_resistance": _saturating},
        ),
        published=Shape("measured R = R (1 + A i), i > 0", 0.5, {"shown_resistance": _growing}),
        **_FAULT,
    ),
    # k follows something else that is recorded: its column is `column`, its middle `centre`.
    "column": Law(
        own=Shape("k (1 + A tanh((w - centre) / half_range))", 0.4, {"modulus": _column_modulus}),
        published=Shape(
            "k exp(A (w - centre) / half_range)", 0.4, {"modulus": _column_exponential}
        ),
        on_stiffness=True,
        in_drives=False,
    ),
}
