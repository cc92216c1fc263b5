# SPDX-License-Identifier: Apache-2.0
"""A law to be learnt: where in the model it acts, how, and with which terms; and its text.

    factor = exp(a1 t1 + a2 t2)   or   1 + a1 t1 + a2 t2      of k, of the sinkage, of the diameter
    shift  = a1 t1 + a2 t2                                    of n, the sinkage or the resistance

During the search the model runs the very method that the law's file will have.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache, partial
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.effects.base import Effect
from smallwheel_ros.effects.drafted import continued
from smallwheel_ros.fitting.parameters import EffectPart, FreeParameter, Prior, with_values
from smallwheel_ros.learn.grammar import Driver, Term

Array = NDArray[np.float64]
Link = Literal["exponential", "linear"]

CONSTANT = Term(())
SOUGHT = "sought"  # id of the law as an effect during the search
LEAST_FACTOR = 0.05  # of a linear link: a factor on a stiffness or a depth keeps its sign
_WIDE = 3.0  # prior deviation of ln factor: twenty times either way
_FAR = 1e3  # bounds of a strength, in prior deviations: so far away that they do not matter


@dataclass(frozen=True)
class Place:
    """One place in the model where a law can act.

    Attributes
    ----------
    name
        Its name; several places may have one stage.
    stage
        The quantity that is changed: k, n, D, sinkage z ("z", or "z without resistance" if the compaction
        resistance keeps the unchanged sinkage), or resistance R.
    method, returned, more
        In Python: the signature of the effect's method there; what it returns, with `{change}` in place of
        the change; further lines of the class.
    added
        Whether the change is added; else it is a factor.
    carrier
        Symbol, in formulas that are shown, of the quantity that the change of R multiplies; empty if the
        change is added as a force.
    unit
        SI unit of a strength.
    nats
        Nats by which a law at this place is longer to describe, as the rarer explanation.
    """

    name: str
    stage: str
    method: str
    returned: str
    more: str = ""
    added: bool = False
    carrier: str = ""
    unit: str = "1"
    nats: float = 0.0

    @property
    def links(self) -> tuple[Link, ...]:
        """Ways to form the change from the sum s of the terms: factor exp(s) or 1 + s; one if s is added."""
        return ("exponential",) if self.added else ("exponential", "linear")


def _resistance(name: str, python: str, carrier: str, unit: str) -> Place:
    method = "added_resistance(self, state, conditions)"
    return Place(f"R/{name}", "R", method, f"{python} * ({{change}})", "", True, carrier, unit)


_SINKAGE = "sinkage(self, sinkage, conditions)"
_RESISTANCE_STAYS = """
    def compaction_sinkage(self, sinkage, conditions):
        return sinkage
"""
_COMPACTION = (
    "state.width * state.modulus * state.sinkage ** (state.exponent + 1.0) / (state.exponent + 1.0)"
)
PLACES = (
    Place("k", "k", "modulus_factor(self, conditions)", "{change}"),
    Place("z", "z", _SINKAGE, "sinkage * {change}"),
    Place("z/length", "z", _SINKAGE,
          f"np.maximum(sinkage + {{change}}, {LEAST_FACTOR} * sinkage)", added=True, unit="m"),
    Place("z without resistance", "z without resistance", _SINKAGE, "sinkage * {change}",
          _RESISTANCE_STAYS, nats=1.0),
    Place("n", "n", "exponent_shift(self, conditions)", "{change}", added=True, nats=2.0),
    Place("D", "D", "wheel_diameter(self, diameter, conditions)", "diameter * {change}", nats=2.0),
    _resistance("force", "1.0", "", "N"),
    _resistance("load", "state.load", "W", "1"),
    _resistance("width sinkage^2", "state.width * state.sinkage**2", "b z^2", "N/m^3"),
    _resistance("width sinkage", "state.width * state.sinkage", "b z", "N/m^2"),
    _resistance("compaction", _COMPACTION, "Rc", "1"),
)  # fmt: skip


def places_for(channels: Sequence[str]) -> tuple[Place, ...]:
    """The places that measurements of these channels can tell from each other."""
    if "resistance" not in channels:
        return tuple(p for p in PLACES if p.stage in ("k", "z", "n", "D"))
    if "sinkage" not in channels:
        return tuple(p for p in PLACES if p.stage != "z without resistance")
    return PLACES


@dataclass(frozen=True)
class LearntLaw:
    """A correction of the model that is learnt: a sum of terms, each times a strength, at one place.

    Attributes
    ----------
    place
        Where in the model it acts.
    link
        How the sum s becomes a factor: "exponential" for exp(s), "linear" for 1 + s. It does not matter where
        the place adds the sum.
    terms
        One or two terms of the grammar.
    """

    place: Place
    link: Link
    terms: tuple[Term, ...]

    @property
    def key(self) -> tuple[Any, ...]:
        """Identifies the law regardless of its constants."""
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
    def columns(self) -> frozenset[str]:
        """Settings from which its drivers are computed."""
        return frozenset(c for d in self.by_name.values() for c in d.columns)

    @property
    def weight(self) -> float:
        """Sum of its drivers' weights, at least 1."""
        return max(1.0, sum(d.weight for d in self.by_name.values()))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of its numbers: strengths a1, a2, then the free constants of shape, c1 for the first term."""
        strengths = [f"a{i}" for i in range(1, len(self.terms) + 1)]
        constants = [f"c{i}" for i, t in enumerate(self.terms, 1) if t.free]
        return (*strengths, *constants)

    def change(self, numbers: Mapping[str, Any], values: Callable[[Driver], Array]) -> Any:
        """Compute the correction for given values of the drivers: a factor, or the sum if the place adds it.

        Parameters
        ----------
        numbers
            Strengths and constants by name (`names`), SI units; numbers, or arrays that broadcast.
        values
            Returns the values of a driver minus its reference, SI; the result has their shape.
        """
        eta: Any = 0.0
        for i, term in enumerate(self.terms, 1):
            eta = eta + numbers[f"a{i}"] * term.of(values, numbers.get(f"c{i}"))
        if self.place.added:
            return eta
        if self.link == "exponential":
            return np.exp(eta)
        return np.maximum(1.0 + eta, LEAST_FACTOR)

    @cached_property
    def python(self) -> str:
        """Python of its methods, to stand in the class of an effect that has its numbers as fields."""
        variables: dict[str, str] = {}
        for name, driver in self.by_name.items():
            taken = driver.variable in variables.values()  # two columns may read alike
            variables[name] = driver.variable + (f"_{len(variables) + 1}" if taken else "")
        lines = [f"{variables[name]} = {d.python}" for name, d in self.by_name.items()]
        eta = " + ".join(
            f"self.a{i} * {term.python(f'self.c{i}', variables)}"
            for i, term in enumerate(self.terms, 1)
        )
        change = eta
        if not self.place.added:
            linear = f"np.maximum(1.0 + {eta}, {LEAST_FACTOR})"
            change = f"np.exp({eta})" if self.link == "exponential" else linear
        lines.append(f"return {self.place.returned.format(change=change)}")
        body = "".join(f"        {line}\n" for line in lines)
        return f"    def {self.place.method}:\n{body}{self.place.more}"

    def formula(self, numbers: Mapping[str, float]) -> str:
        """The law as a formula to be shown, as "z = z0 exp(0.4 tanh(slip/0.215))". numbers: by name."""
        said = ""
        for i, term in enumerate(self.terms, 1):
            value, text = numbers[f"a{i}"], term.text(numbers.get(f"c{i}"))
            sign = (" + " if value >= 0 else " - ") if said else ("" if value >= 0 else "-")
            said += f"{sign}{abs(value):.3g}{f' {text}' if text else ''}"
        place, name = self.place, self.place.stage[0]
        if place.added:
            if place.carrier:
                said = f"({said})" if len(self.terms) > 1 else said
                said = f"{said} {place.carrier}"
            return f"{name} = {name}0 {_after(said)}"
        kept = ", the resistance stays" if place.more else ""
        change = f"exp({said})" if self.link == "exponential" else f"(1 {_after(said)})"
        return f"{name} = {name}0 {change}{kept}"

    def effect(self, numbers: Mapping[str, Any]) -> Effect:
        """The law as an effect of a model. numbers: by name, each a number or an array of shape (rows,)."""
        fields = "".join(f"    {name}: float = 0.0\n" for name in self.names)
        kind = _class_of(f'class Sought(Effect):\n    id = "{SOUGHT}"\n{fields}\n{self.python}')
        return with_values(kind(), numbers)


def _after(total: str) -> str:
    """The sum with its sign set apart, to follow another term: "- 2 x" for "-2 x", "+ 2 x" for "2 x"."""
    return f"- {total[1:]}" if total.startswith("-") else f"+ {total}"


@lru_cache(maxsize=4096)  # the folds try the same laws
def _class_of(python: str) -> type[Effect]:
    known: dict[str, Any] = {
        "np": np, "Effect": Effect, "continued": continued, "__name__": __name__
    }  # fmt: skip
    exec(python, known)
    made: type[Effect] = dataclass(frozen=True)(known["Sought"])
    return made


def part_for(law: LearntLaw, numbers: Mapping[str, float], size: Sequence[float]) -> EffectPart:
    """Make the part of a model by which a law is fitted, with all its strengths and constants free.

    Parameters
    ----------
    law
        The law to fit.
    numbers
        Starting values of `law.names`, SI units; those beyond their bounds are clipped.
    size
        Usual magnitude of each term's strength, SI; the strength's prior has mean 0 and three times this
        magnitude as standard deviation.
    """
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
    return EffectPart(SOUGHT, tuple(free), partial(with_values, law.effect(start)))
