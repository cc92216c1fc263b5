# SPDX-License-Identifier: Apache-2.0
"""A law that is sought: where in the model it acts, how, and with which terms.

factor = exp(a1 t1 + a2 t2)   or   1 + a1 t1 + a2 t2      of k, of the sinkage, of the diameter
shift  = a1 t1 + a2 t2                                    of n, the sinkage or the resistance
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from types import CodeType
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.effects.base import Effect, WheelState
from smallwheel_ros.fitting.parameters import EffectPart, FreeParameter, with_values
from smallwheel_ros.fitting.prior import Prior
from smallwheel_ros.learn.drivers import Driver
from smallwheel_ros.learn.grammar import Term
from smallwheel_ros.physics.conditions import Conditions

Array = NDArray[np.float64]
Link = Literal["exponential", "linear"]

CONSTANT = Term(())
SOUGHT = "sought"  # id of the law while it is sought
LEAST_FACTOR = 0.05  # of a linear link: a factor on a stiffness or a depth does not change sign
_WIDE = 3.0  # prior deviation of ln factor: twenty times either way
_FAR = 1e3  # prior deviations at which a strength is bounded: nowhere


@dataclass(frozen=True)
class Carrier:
    """What an added strength multiplies.

    code: Python of the wheel's `state`: the search computes it, and a drafted file contains it. text:
    the same for people; unit: of the strength.
    """

    code: str
    text: str
    unit: str

    @cached_property
    def _compiled(self) -> CodeType:
        return compile(self.code, "<carrier>", "eval")

    def __call__(self, state: WheelState) -> Any:
        """Its value, a number or of shape (rows,)."""
        return eval(self._compiled, {"state": state})


@dataclass(frozen=True)
class Place:
    """One place of the model where a law can act.

    stage: as in documents: k, z, z without resistance, n, D, R. carrier: of what is added; elsewhere
    the law is a factor. nats: what it costs beside others, since it is the rarer explanation.
    """

    name: str
    stage: str
    carrier: Carrier | None = None
    nats: float = 0.0

    @property
    def shifts(self) -> bool:
        """Whether what acts there is added."""
        return self.carrier is not None

    @property
    def links(self) -> tuple[Link, ...]:
        """Ways in which terms can make its change."""
        return ("exponential",) if self.shifts else ("exponential", "linear")


_COMPACTION = (
    "state.width * state.modulus * state.sinkage ** (state.exponent + 1.0) / (state.exponent + 1.0)"
)
PLACES = (
    Place("k", "k"),
    Place("z", "z"),
    Place("z/length", "z", Carrier("1.0", "", "m")),
    Place("z without resistance", "z without resistance", nats=1.0),
    Place("n", "n", Carrier("1.0", "", "1"), nats=2.0),
    Place("D", "D", nats=2.0),
    Place("R/force", "R", Carrier("1.0", "", "N")),
    Place("R/load", "R", Carrier("state.load", "W", "1")),
    Place("R/width sinkage^2", "R", Carrier("state.width * state.sinkage**2", "b z^2", "N/m^3")),
    Place("R/width sinkage", "R", Carrier("state.width * state.sinkage", "b z", "N/m^2")),
    Place("R/compaction", "R", Carrier(_COMPACTION, "Rc", "1")),
)


def places_for(channels: Sequence[str]) -> tuple[Place, ...]:
    """The places that these channels show, each apart from the others."""
    if "resistance" not in channels:
        return tuple(p for p in PLACES if p.stage in ("k", "z", "n", "D"))
    if "sinkage" not in channels:
        return tuple(p for p in PLACES if p.stage != "z without resistance")
    return PLACES


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

    @cached_property
    def by_name(self) -> dict[str, Driver]:
        """Its drivers, in the order of its terms."""
        return {d.name: d for t in self.terms for d, _ in t.factors}

    @property
    def drivers(self) -> tuple[str, ...]:
        """Names of its drivers, in the order of its terms."""
        return tuple(self.by_name)

    @property
    def first_driver(self) -> Driver | None:
        """The driver over which it is drawn; None of a constant."""
        return next(iter(self.by_name.values()), None)

    @property
    def columns(self) -> frozenset[str]:
        """Settings that its drivers are made of."""
        return frozenset(c for d in self.by_name.values() for c in d.columns)

    @property
    def weight(self) -> float:
        """How many drivers it counts as; a constant as one."""
        return max(1.0, sum(d.weight for d in self.by_name.values()))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of its numbers: strengths, then constants."""
        strengths = [f"a{i}" for i in range(1, len(self.terms) + 1)]
        constants = [f"c{i}" for i, t in enumerate(self.terms, 1) if t.free]
        return (*strengths, *constants)

    def eta(self, numbers: Mapping[str, Any], values: Callable[[Driver], Array]) -> Any:
        """Sum of its terms where each driver has these values."""
        total: Any = 0.0
        for i, term in enumerate(self.terms, 1):
            total = total + numbers[f"a{i}"] * term.of(values, numbers.get(f"c{i}"))
        return total

    def change(self, eta: Any) -> Any:
        """The factor that a sum of terms makes; of what is added the sum itself."""
        if self.place.shifts:
            return eta
        if self.link == "exponential":
            return np.exp(eta)
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

    def _change(self, conditions: Conditions, sinkage: Array | None = None) -> Any:
        eta = self.law.eta(vars(self), lambda driver: driver.values(conditions, sinkage))
        return self.law.change(eta)

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
            return np.asarray(np.maximum(sinkage + change, LEAST_FACTOR * sinkage))
        return np.asarray(sinkage * change)

    def compaction_sinkage(self, sinkage: Array, conditions: Conditions) -> Array:
        alone = self.law.place.stage == "z without resistance"
        return sinkage if alone else self.sinkage(sinkage, conditions)

    def added_resistance(self, state: WheelState, conditions: Conditions) -> Array | float:
        carrier = self.law.place.carrier
        if self.law.place.stage != "R" or carrier is None:
            return 0.0
        return np.asarray(carrier(state) * self._change(conditions, state.sinkage))


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
