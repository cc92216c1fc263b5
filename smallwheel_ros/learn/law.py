# SPDX-License-Identifier: Apache-2.0
"""A law that is sought: where in the model it acts, how, and with which terms.

factor = exp(a1 t1 + a2 t2)   or   1 + a1 t1 + a2 t2      of k, of the sinkage, of the diameter
shift  = a1 t1 + a2 t2                                    of n, the sinkage or the resistance
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.effects.base import Effect, WheelState
from smallwheel_ros.fitting.parameters import EffectPart, FreeParameter, with_values
from smallwheel_ros.fitting.prior import Prior
from smallwheel_ros.learn.grammar import Term
from smallwheel_ros.physics.conditions import Conditions
from smallwheel_ros.physics.traction import compaction_resistance

Array = NDArray[np.float64]
Link = Literal["exponential", "linear"]

CONSTANT = Term(())
SOUGHT = "sought"  # id of the law while it is sought
LEAST_FACTOR = 0.05  # of a linear link: a factor on a stiffness or a depth does not change sign
_WIDE = 3.0  # prior deviation of ln factor: twenty times either way
_FAR = 1e3  # prior deviations at which a strength is bounded: nowhere


@dataclass(frozen=True)
class Place:
    """One place of the model where a law can act.

    stage: as in documents: k, z, z without resistance, n, D, R. carrier: of what is added, what its
    strength multiplies. nats: what it costs beside others, since it is the rarer explanation.
    """

    name: str
    stage: str
    carrier: str = ""
    nats: float = 0.0

    @property
    def shifts(self) -> bool:
        """Whether what acts there is added; elsewhere it is a factor."""
        return self.stage == "n" or self.carrier != ""

    @property
    def links(self) -> tuple[Link, ...]:
        """Ways in which terms can make its change."""
        return ("exponential",) if self.shifts else ("exponential", "linear")


PLACES = (
    Place("k", "k"),
    Place("z", "z"),
    Place("z/length", "z", "length"),
    Place("z without resistance", "z without resistance", nats=1.0),
    Place("n", "n", nats=2.0),
    Place("D", "D", nats=2.0),
    Place("R/force", "R", "force"),
    Place("R/load", "R", "load"),
    Place("R/width sinkage^2", "R", "width sinkage^2"),
    Place("R/width sinkage", "R", "width sinkage"),
    Place("R/compaction", "R", "compaction"),
)


def places_for(channels: Sequence[str]) -> tuple[Place, ...]:
    """The places that these channels show, each apart from the others."""
    if "resistance" not in channels:
        return tuple(p for p in PLACES if p.stage in ("k", "z", "n", "D"))
    if "sinkage" not in channels:
        return tuple(p for p in PLACES if p.stage != "z without resistance")
    return PLACES


def carried(carrier: str, state: WheelState) -> Array:
    """What a law of resistance multiplies, shape (rows,)."""
    if carrier == "force":
        return np.ones_like(state.load)
    if carrier == "load":
        return state.load
    if carrier == "compaction":
        return compaction_resistance(state.sinkage, state.width, state.modulus, state.exponent)
    power = 2.0 if carrier == "width sinkage^2" else 1.0
    return np.asarray(state.width * state.sinkage**power)


@dataclass(frozen=True)
class Law:
    """A place, a link and one or two terms."""

    place: Place
    link: Link
    terms: tuple[Term, ...]

    @property
    def key(self) -> tuple[Any, ...]:
        """What tells it from others, whatever its constants."""
        return self.place.name, self.link, tuple(t.kind for t in self.terms)

    @property
    def drivers(self) -> tuple[str, ...]:
        """Names of its drivers, in the order of its terms."""
        names = [d.name for t in self.terms for d, _ in t.factors]
        return tuple(dict.fromkeys(names))

    @property
    def columns(self) -> frozenset[str]:
        """Settings that its drivers are made of."""
        return frozenset(c for t in self.terms for c in t.columns)

    @property
    def weight(self) -> float:
        """How many drivers it counts as; a constant as one."""
        known = {d.name: d.source.weight for t in self.terms for d, _ in t.factors}
        return max(1.0, sum(known.values()))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of its numbers: strengths, then constants."""
        strengths = [f"a{i}" for i in range(1, len(self.terms) + 1)]
        constants = [f"c{i}" for i, t in enumerate(self.terms, 1) if t.free]
        return (*strengths, *constants)

    def eta(
        self, numbers: Mapping[str, Any], conditions: Conditions, sinkage: Array | None
    ) -> Array:
        """Sum of its terms, shape (rows,). sinkage: m, where a term follows it."""
        total = np.zeros(len(conditions))
        for i, term in enumerate(self.terms, 1):
            constant = numbers[f"c{i}"] if term.free else None
            total = total + numbers[f"a{i}"] * term(conditions, sinkage, constant)
        return total

    def change(self, eta: Array) -> Array:
        """The factor that a sum of terms makes; of what is added the sum itself."""
        if self.place.shifts:
            return eta
        if self.link == "exponential":
            return np.asarray(np.exp(eta))
        return np.maximum(1.0 + eta, LEAST_FACTOR)


@dataclass(frozen=True)
class _Sought(Effect):
    """A law in the model while it is sought. Only one of its stages is not as if it were not there."""

    law: Law
    a1: Any = 0.0  # a number, or one for each row
    a2: Any = 0.0
    c1: Any = 1.0
    c2: Any = 1.0

    id = SOUGHT

    def _factor(self, stage: str, conditions: Conditions) -> Array | float:
        return self._change(conditions) if self.law.place.stage == stage else 1.0

    def _change(self, conditions: Conditions, sinkage: Array | None = None) -> Array:
        return self.law.change(self.law.eta(vars(self), conditions, sinkage))

    def modulus_factor(self, conditions: Conditions) -> Array | float:
        return self._factor("k", conditions)

    def wheel_diameter(self, diameter: Array, conditions: Conditions) -> Array:
        return diameter * self._factor("D", conditions)

    def exponent_shift(self, conditions: Conditions) -> Array | float:
        return self._change(conditions) if self.law.place.stage == "n" else 0.0

    def sinkage(self, sinkage: Array, conditions: Conditions) -> Array:
        if not self.law.place.stage.startswith("z"):
            return sinkage
        change = self._change(conditions)
        if self.law.place.shifts:
            return np.maximum(sinkage + change, LEAST_FACTOR * sinkage)
        return np.asarray(sinkage * change)

    def compaction_sinkage(self, sinkage: Array, conditions: Conditions) -> Array:
        alone = self.law.place.stage == "z without resistance"
        return sinkage if alone else self.sinkage(sinkage, conditions)

    def added_resistance(self, state: WheelState, conditions: Conditions) -> Array | float:
        if self.law.place.stage != "R":
            return 0.0
        return carried(self.law.place.carrier, state) * self._change(conditions, state.sinkage)


def effect_of(law: Law, numbers: Mapping[str, Any]) -> Effect:
    """The law as an effect of a model; its numbers may differ from row to row."""
    return _Sought(law, **numbers)


def asked(place: Place, shift: Array) -> Effect:
    """An effect that changes each row by its own ln factor or shift, shape (rows,)."""
    return effect_of(Law(place, "exponential", (CONSTANT,)), {"a1": shift})


def part_for(law: Law, numbers: Mapping[str, float], size: Sequence[float]) -> EffectPart:
    """The law with its numbers free. size: of a strength's usual change, one for each term."""
    free = []
    for name in law.names:
        i = int(name[1]) - 1
        value = float(numbers[name])
        if name.startswith("a"):
            value = float(np.clip(value, -_WIDE * size[i], _WIDE * size[i]))
            prior = Prior(0.0, _WIDE * size[i], -_FAR * size[i], _FAR * size[i])
        else:
            low, high = law.terms[i].bounds
            prior = Prior(value, high - low, low, high)
            value = float(np.clip(value, low, high))
        free.append(FreeParameter(SOUGHT, name, value, "1", prior))
    start = {p.field: p.start for p in free}
    return EffectPart(SOUGHT, tuple(free), partial(with_values, effect_of(law, start)))
