# SPDX-License-Identifier: Apache-2.0
"""A law as a Python file that defines it as an effect."""

from __future__ import annotations

import keyword
import re
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.effects.drafted import VERSION
from smallwheel_ros.fitting.fit import Fitter
from smallwheel_ros.fitting.posterior import posterior_covariance
from smallwheel_ros.learn.grammar import SIZES, Driver, Term, identifier
from smallwheel_ros.learn.law import SOUGHT, LearntLaw
from smallwheel_ros.learn.search import LawCandidate
from smallwheel_ros.measurements.measurements import Measurements

Array = NDArray[np.float64]

_AROUND = 8.0  # standard deviations: bounds of a number in a file
_AT_LEAST = 0.05  # of the number: a smaller deviation is replaced by this for its bounds


@dataclass(frozen=True)
class Number:
    """One number of a law, as in its file: a strength or a constant of shape.

    Attributes
    ----------
    name
        a1, a2 for strengths, c1, c2 for constants of shape.
    value
        Fitted value, in `unit`.
    std
        Its standard deviation; None if the fit ended at a bound.
    unit
        SI unit; "1" for a pure number.
    bounds
        Lowest and highest value that a later fit may give it.
    """

    name: str
    value: float
    std: float | None
    unit: str
    bounds: tuple[float, float]

    @property
    def strength(self) -> bool:
        """Whether it is a strength; else it is a constant of shape."""
        return self.name.startswith("a")


def numbers_of(fitter: Fitter, candidate: LawCandidate) -> list[Number]:
    """Return the fitted numbers of a law with their standard deviations: strengths, then constants of shape.

    Parameters
    ----------
    fitter
        Fitter that fitted the law.
    candidate
        The law and its fit.
    """
    fit, law = candidate.fit, candidate.law
    covariance = posterior_covariance(fitter, fit, fitter.true_scatter(fit))
    found = []
    for j in fit.vector.places(SOUGHT):
        name, value = fit.vector.free[j].field, float(fit.theta[j])
        term = law.terms[int(name[1]) - 1]
        std = None if fit.at_bound[j] else float(np.sqrt(covariance[j, j]))
        if name.startswith("a"):
            around = _AROUND * max(std or abs(value), _AT_LEAST * abs(value))
            bounds = (min(value - around, 0.0), max(value + around, 0.0))
            powers = [(d.unit, shape.power) for d, shape in term.factors if d.unit not in ("", "1")]
            units = [law.place.unit, *(f"({unit})^{-power:g}" for unit, power in powers if power)]
            unit = " ".join(u for u in units if u != "1") or "1"
        else:
            bounds = (min(term.bounds[0], value), max(term.bounds[1], value))
            unit = _driver(term).unit
        found.append(Number(name, value, std, unit, bounds))
    return found


def _driver(term: Term) -> Driver:
    """The driver whose shape has the free constant."""
    return next(driver for driver, shape in term.factors if shape.constant == "free")


def name_problem(name: str, taken: Collection[str]) -> str:
    """Words on why a name cannot be a new effect's id; empty if it can.

    Parameters
    ----------
    name
        The proposed id.
    taken
        Ids of effects that exist.
    """
    if not re.fullmatch(r"[a-z][a-z0-9_]*", name) or keyword.iskeyword(name):
        return f"'{name}' is no id: expected small letters, digits and _, like slip_law"
    return f"'{name}' is the id of an effect that exists already" if name in taken else ""


def default_name(law: LearntLaw) -> str:
    """An id that names what the law depends on: `learnt_slip`."""
    followed = "_".join(identifier(c) for c in sorted(law.columns)) or law.place.stage.lower()
    return f"learnt_{followed}"


_HEAD = '''"""Drafted by `smallwheel learn`: learnt from data, not published."""

from dataclasses import dataclass

import numpy as np

from smallwheel_ros.effects import parameter
from smallwheel_ros.effects.drafted import Drafted, continued
'''
_CLASS = """@dataclass(frozen=True)
class {title}(Drafted):
    id = "{name}"
    form = "drafted"
    version = {version}
    summary = {summary!r}
    formula = {formula!r}
    source = {source!r}
    learnt_from = {learnt_from!r}
    needs = {needs!r}
    drivers = {drivers!r}
    valid = {valid!r}
{fields}

{methods}"""


def file_text(classes: list[str]) -> str:
    """Text of the Python file that defines these classes, each as `class_text` returns it."""
    return "\n\n".join([_HEAD, *classes])


def class_text(
    law: LearntLaw,
    numbers: list[Number],
    name: str,
    measurements: Measurements,
    settings: int,
    tied: int,
    summary: str,
) -> str:
    """Text of the Python class that defines a law as an effect.

    Numbers have all their digits, so that predictions stay the same. Texts are written by their repr: names
    of columns and files may have any character.

    Parameters
    ----------
    law, numbers
        The law, and its numbers as returned by `numbers_of`.
    name
        Id of the effect, from which the name of the class is made.
    measurements
        The table that it was learnt from.
    settings
        Number of settings in the table.
    tied
        Number of formulas that fit equally well, this one included.
    summary
        What the effect does, in a sentence.
    """
    columns = sorted(law.columns)
    others = {1: "no other formula fits", 2: "1 other formula fits"}.get(
        tied, f"{tied - 1} other formulas fit"
    )
    data = f"{Path(measurements.source).name}, " if measurements.source else ""
    return _CLASS.format(
        title="".join(part.title() for part in name.split("_")),
        name=name,
        version=VERSION,
        summary=summary,
        formula=law.formula({n.name: n.value for n in numbers}),
        source=f"smallwheel learn, {data}{settings} settings; {others} as well",
        learnt_from=measurements.sha256,
        needs=tuple(c for c in columns if c not in SIZES),
        drivers=tuple(columns),
        valid={c: _range(measurements.conditions[c]) for c in columns},
        fields="\n".join(_field(n, law) for n in numbers),
        methods=law.python,
    )


def _field(number: Number, law: LearntLaw) -> str:
    term = law.terms[int(number.name[1]) - 1]
    what = "strength" if number.strength else f"shape over {_driver(term).name}"
    std = "" if number.std is None else f", std {number.std:.2g}"
    low, high = number.bounds
    neutral = "" if number.strength else ", neutral=None"
    return (
        f"    {number.name}: float = parameter({number.value!r}, ({low!r}, {high!r}), "
        f"{what + std!r}, unit={number.unit!r}{neutral})"
    )


def _range(values: Array) -> tuple[float, float]:
    known = values[np.isfinite(values)]
    return float(known.min()), float(known.max())
