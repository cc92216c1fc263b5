# SPDX-License-Identifier: Apache-2.0
"""Hidden effects that the truth can contain.

Each acts on the stress at the points of the contact. Its form differs from the published forms, which the
library fits: to find an effect by its exact formula would prove nothing. Faults of instruments are the
exception.

An effect is an entry of `EFFECTS`: its formula, its typical size, the stage of the truth at which it acts,
and the function that it applies there. In the formulas A is the amplitude, i slip, and s the share of the
contact's length that the soil at a point has passed (0 at the entry, 1 at the lowest point). At slip i the
rim has carried it along by i s of that length: Wong and Reece's (1967) shear displacement less its part at
no slip, over the length of the contact.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from smallwheel_ros.simulate.truth import Array, Circumstances, Contact, TruthSoil


@dataclass(frozen=True)
class HiddenLaw:
    """The law of one effect of the simulated truth: its formula, and the function that computes it.

    The simulation of a wheel calls the function at one stage, with the amplitude, the arguments that the
    table lists, and `numbers` by name:

    | stage | arguments | returns |
    | --- | --- | --- |
    | `modulus` | circumstances | factor on the soil's k, (rows,) |
    | `stress` | contact, circumstances, soil | factor on the normal stress, (rows, nodes) |
    | `carried_away` | contact, circumstances | thickness of the soil removed, m, (rows, nodes) |
    | `resistance` | sinkage (m), soil, circumstances | resistance to be added, N, (rows,) |
    | `rebound` | stress (Pa) at the lowest point | rise of the soil after it, m, (rows,); exponent e |
    | `shown_sinkage`, `shown_resistance`, `shown_load` | true value, circumstances | reading, same unit |

    While the soil rises after the lowest point, the stress falls to x^e of its value there, with x the share
    of the rise that is still to come.

    Attributes
    ----------
    formula
        The law as text to be shown, with A for the amplitude.
    typical
        Amplitude at strength 1, in the SI unit of the formula.
    stage, does
        Stage at which the law acts, and its function: name and callable of the table above.
    needs
        Extra columns that a simulated table gets with this effect, since its law depends on them.
    on_stiffness
        Whether it makes all soil firmer or softer. Then k is scaled so that soil stays as firm as drawn
        (`rig.draw_design`).
    in_ruts
        Whether it depends on the depth of the rut that earlier passes left.
    either_sign
        Whether the amplitude's sign is drawn at random where the user gives no amplitude.
    numbers
        Constants of the formula besides A, by name. For a pair of numbers, a value between them is drawn.
    """

    formula: str
    typical: float
    stage: str
    does: Callable[..., Any]
    needs: tuple[str, ...] = ()
    on_stiffness: bool = False
    in_ruts: bool = False
    either_sign: bool = False
    # Where one of them is drawn, the amplitude is not varied about the typical one.
    numbers: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class HiddenEffect:
    """A hidden effect with the amplitude and numbers drawn for one simulation.

    Attributes
    ----------
    name
        Its name in `EFFECTS`, or `column` for `OF_COLUMN`.
    law
        Its law.
    amplitude
        A of the law's formula, in the formula's SI unit.
    numbers
        The other numbers of the formula, by name, SI units.
    """

    name: str
    law: HiddenLaw
    amplitude: float
    numbers: Mapping[str, Any]

    def describe(self) -> dict[str, Any]:
        """`effect` (the name), `formula`, `amplitude` and the other numbers, for the file of the truth."""
        told = {"effect": self.name, "formula": self.law.formula}
        return {**told, "amplitude": self.amplitude, **self.numbers}


def acting(effects: Sequence[HiddenEffect], stage: str) -> Iterator[Callable[..., Any]]:
    """Yield the actions of the effects at one stage, in the order of the effects.

    Parameters
    ----------
    effects
        Hidden effects.
    stage
        Name of the stage, as in `HiddenLaw`.

    Yields
    ------
    callable
        Function that takes the stage's arguments (`HiddenLaw`); amplitude and numbers are bound already.
    """
    for effect in effects:
        if effect.law.stage == stage:
            yield partial(effect.law.does, effect.amplitude, **effect.numbers)


def shown_by_instrument(
    effects: Sequence[HiddenEffect], channel: str, value: Array, at: Circumstances
) -> Array:
    """Apply the faults of the instruments of a channel to its true value.

    Parameters
    ----------
    effects
        Hidden effects, in the order in which they act.
    channel
        `sinkage`, `resistance` or `load`.
    value
        True value, shape (rows,), m or N.
    at
        Circumstances of the rows.

    Returns
    -------
    ndarray
        Reading without noise, same shape and unit.
    """
    for shows in acting(effects, f"shown_{channel}"):
        value = shows(value, at)
    return value


# --- Actions that are longer than a line


def _driven(at: Circumstances) -> Array:
    return np.maximum(at.slip, 0.0)


def _braked(at: Circumstances) -> Array:
    return np.maximum(-at.slip, 0.0)


def _carried(contact: Contact, slip: Array) -> Array:
    """Distance that the rim carried soil along, over the contact's length, at each point, (rows, nodes)."""
    return slip[:, None] * contact.passed


def _wall(a: float, depth: Array, soil: TruthSoil, at: Circumstances) -> Array:
    """Resistance (N) of a wall by Coulomb's passive pressure, with failing wedges at its sides."""
    phi = soil.friction_angle
    friction = phi / 2
    root = np.sqrt(np.sin(phi + friction) * np.sin(phi) / np.cos(friction))
    passive = np.cos(phi) ** 2 / (np.cos(friction) * (1.0 - root) ** 2)
    sides = soil.unit_weight * depth**3 * passive * np.tan(phi) / 3
    return np.asarray(a * (_pushed(passive, depth, soil, at) + sides))


def _pushed(passive: float, depth: Array, soil: TruthSoil, at: Circumstances) -> Array:
    weight = soil.unit_weight * depth**2 * passive / 2
    cohesion = 2.0 * soil.cohesion * depth * np.sqrt(passive)
    return np.asarray(at.width * (weight + cohesion))


def _loose(a: float, contact: Contact, *_: object) -> Array:
    rut = contact.rut[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        loose = np.where(rut > 0, np.exp(-((contact.depth / rut) ** 4)), 0.0)
    return np.asarray(1.0 - min(a, 0.95) * loose)


def _pressed_faster(a: float, contact: Contact, at: Circumstances, *_: object) -> Array:
    x = at.speed[:, None] * np.sin(contact.angle) / 0.02
    return np.asarray(1.0 + a * x / (1.0 + x))


def _confined(a: float, contact: Contact, at: Circumstances, *_: object) -> Array:
    confined = 1.0 - 0.1 * (contact.angle / np.maximum(contact.entry, 1e-12)[:, None]) ** 2
    return np.asarray(1.0 + a * (at.load / (at.load + 60.0))[:, None] * confined)


def _held_at_edges(a: float, contact: Contact, at: Circumstances, *_: object) -> Array:
    """Factor 1 + A exp(-y / l) at a distance y from the nearer edge, averaged over the width."""
    x = at.width[:, None] / (2.0 * (0.02 + contact.depth))
    return np.asarray(1.0 - a * np.expm1(-x) / x)


def _lower_layer(
    a: float, contact: Contact, _: Circumstances, soil: TruthSoil, level: float
) -> Array:
    x = np.maximum(contact.depth, 1e-9) / level
    below = 0.1 * np.logaddexp(0.0, (x - 1.0) / 0.1)
    return np.asarray(1.0 + a * below / x**soil.n)


def _dug_away(a: float, contact: Contact, at: Circumstances) -> Array:
    carried = _carried(contact, _driven(at))
    return np.asarray(-a * at.grouser_height[:, None] * np.expm1(-carried / 0.15))


def _in_column(at: Circumstances, column: str, centre: float, half_range: float) -> Array:
    """Place of a column's values in its range, from -1 to 1 (beyond these outside it), shape (rows,)."""
    return (at.covariates[column] - centre) / half_range


# --- The effects


def _fault(
    formula: str, typical: float, channel: str, does: Callable[..., Any], either_sign: bool = False
) -> HiddenLaw:
    """A fault of an instrument, in the form that the library fits. channel: as in `shown_CHANNEL`."""
    return HiddenLaw(
        f"measured {formula}", typical, f"shown_{channel}", does, either_sign=either_sign
    )


def _offset(a: float, shown: Array, _: Circumstances) -> Array:
    return shown + a


def _gain(a: float, shown: Array, _: Circumstances) -> Array:
    return shown * (1.0 + a)


# fmt: off
EFFECTS: dict[str, HiddenLaw] = {
    # Digging in when driven: 2 to 3 times the sinkage at slip 0.6. The soil that the rim has carried
    # along holds less; the front, where it has not moved yet, holds as before. The stress moves
    # forward with slip, as Wong and Reece (1967) measured, the wheel sinks until it carries the load
    # again, and the front has more soil to push down.
    "slip_sinkage": HiddenLaw(
        "stress / (1 + (A i s)^1.7), i > 0", 5.5, "stress",
        lambda a, contact, at, _: 1.0 / (1.0 + (a * _carried(contact, _driven(at))) ** 1.7),
    ),
    # Ploughing in when braked: soil dragged along with the rim holds less.
    "skid_sinkage": HiddenLaw(
        "stress exp(-A (|i| s)^1.3), i < 0", 6.0, "stress",
        lambda a, contact, at, _: np.exp(-a * _carried(contact, _braked(at)) ** 1.3),
    ),
    # Ploughing sideways: soil that the rim has pushed aside holds less.
    "slip_angle_sinkage": HiddenLaw(
        "stress / (1 + A s tan(beta)^2)", 4.0, "stress",
        lambda a, contact, at, _:
            1.0 / (1.0 + a * _carried(contact, np.tan(at.slip_angle) ** 2)),
        needs=("slip_angle",),
    ),
    # Soil pushed ahead of the wheel: 20 to 60 % more resistance; sinkage does not show it.
    "bulldozing": HiddenLaw(
        "R = A (b (g z^2 K / 2 + 2 c z sqrt(K)) + g z^3 K tan(phi) / 3), K Coulomb's passive"
        " coefficient with wall friction phi/2: a wall with failing wedges at its sides",
        1.0, "resistance", _wall,
    ),
    # Soil is stiffer where it is pressed faster: 15 to 20 % of sinkage over 0.01 to 0.5 m/s. A point
    # of the rim goes down at v sin(theta): fastest at the entry, not at all at the bottom.
    "penetration_rate": HiddenLaw(
        "stress (1 + A x / (1 + x)), x = v sin(theta) / 0.02 m/s", 0.45, "stress",
        _pressed_faster,
        on_stiffness=True,
    ),
    # Soil is stiffer under a heavier wheel, a little more so right under its axle. Only a little:
    # confinement of the axle alone would change the shape of the stress more than its size, and be
    # another effect than one of the load.
    "load_dependent_modulus": HiddenLaw(
        "stress (1 + A W / (W + 60 N) (1 - 0.1 (theta / theta0)^2))", 2.0, "stress",
        _confined,
        on_stiffness=True,
    ),
    # Soil is stiffer under a narrower wheel: its edges shear soil that holds on beside it; the zone at
    # the edges is wider where the wheel is deeper.
    "width_dependent_modulus": HiddenLaw(
        "stress (1 + A (2 l / b) (1 - exp(-b / (2 l)))), l = 20 mm + z", 3.0, "stress",
        _held_at_edges,
        on_stiffness=True,
    ),
    # The rut deepens with each pass, from the untouched surface: 1.5 times at the fifth. Loose soil
    # that slid back into the rut holds less than it did; below the rut the soil is as it was. Each pass
    # therefore finds its depth a little below the one before, ever less so.
    "multipass": HiddenLaw(
        "stress (1 - A exp(-(z / rut)^4)), rut the depth after the pass before", 0.66,
        "stress", _loose,
        in_ruts=True,
    ),
    # A hard layer below; `level` (m) is where it makes itself felt.
    "hardpan": HiddenLaw(
        "p = p0(z) + A p0(level) ln(1 + exp((z - level) / d)) d / level, d = level / 10:"
        " two layers, the lower one a bed of springs", 8.0, "stress", _lower_layer,
        numbers={"level": (0.014, 0.024)},
    ),
    # Grousers dig when they slip: they carry away soil that the rim would have pressed on.
    "grouser": HiddenLaw(
        "stress at z - A h (1 - exp(-i s / 0.15)), i > 0", 0.8, "carried_away", _dug_away,
        needs=("grouser_height",),
    ),
    # The rut, which is measured, is shallower than the wheel was. The soil that rises behind the lowest
    # point carries a share of the load and pushes the wheel on.
    "elastic_rebound": HiddenLaw(
        "rut = z - A p / (1 + p / softening), p the pressure at z; it unloads as x^1.5, x"
        " the share of the rebound that is still to come", 8e-8, "rebound",
        lambda a, p, softening: (a * p / (1.0 + p / softening), 1.5),
        numbers={"softening": 60e3},
    ),
    # k follows something that was not recorded, one value u a run, even between -1 and 1.
    "unrecorded": HiddenLaw("k exp(A u)", 0.4, "modulus", lambda a, at: np.exp(a * at.hidden)),
    # The zero of the sinkage sensor is off by 2 to 3 mm, always the same way.
    "sinkage_offset": _fault("z = z + A, m", 0.0025, "sinkage", _offset),
    # Scales are off by 10 %, zeros of the load cell by 4 N and of the sensor of resistance by 2 N.
    "sinkage_gain": _fault("z = z (1 + A)", 0.10, "sinkage", _gain, either_sign=True),
    "load_offset": _fault("W = W + A, N", 4.0, "load", _offset, either_sign=True),
    "load_gain": _fault("W = W (1 + A)", 0.10, "load", _gain, either_sign=True),
    "resistance_offset": _fault("R = R + A, N", 2.0, "resistance", _offset, either_sign=True),
    "resistance_gain": _fault("R = R (1 + A)", 0.10, "resistance", _gain, either_sign=True),
    # The rig itself resists: 6 % of the load.
    "rig_friction": _fault("R = R + A W", 0.06, "resistance",
                           lambda a, shown, at: shown + a * at.load),
    # The measured resistance grows with slip, the sinkage does not: by half at slip 1.
    "slip_resistance": HiddenLaw(
        "measured R = R (1 + A (1 - exp(-2 i)) / (1 - exp(-2))), i > 0", 0.5,
        "shown_resistance", lambda a, shown, at:
            shown * (1.0 + a * (np.expm1(-2.0 * _driven(at)) / np.expm1(-2.0))),
    ),
}
# k follows something else that is recorded: its column is `column`, its middle `centre`.
OF_COLUMN = HiddenLaw(
    "k (1 + A tanh((w - centre) / half_range))", 0.4, "modulus",
    lambda a, at, **of: 1.0 + a * np.tanh(_in_column(at, **of)),
    on_stiffness=True,
)
# fmt: on
