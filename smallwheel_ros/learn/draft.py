# SPDX-License-Identifier: Apache-2.0
"""A law in words, as a formula, and as the Python file that is its effect."""

from __future__ import annotations

import json
import keyword
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.effects.drafted import VERSION
from smallwheel_ros.fitting.fit import Fitter
from smallwheel_ros.fitting.result import posterior_covariance
from smallwheel_ros.learn.drivers import Driver, identifier
from smallwheel_ros.learn.grammar import Term
from smallwheel_ros.learn.law import LEAST_FACTOR, SOUGHT, Law
from smallwheel_ros.learn.search import Candidate
from smallwheel_ros.measurements.table import Measurements

Array = NDArray[np.float64]

_AROUND = 8.0  # deviations: bounds of a number in a file
_AT_LEAST = 0.05  # of the number, in place of a deviation that is smaller
# The one method of each stage.
_METHODS = {
    "k": "modulus_factor(self, conditions)",
    "z": "sinkage(self, sinkage, conditions)",
    "n": "exponent_shift(self, conditions)",
    "D": "wheel_diameter(self, diameter, conditions)",
    "R": "added_resistance(self, state, conditions)",
}


@dataclass(frozen=True)
class Number:
    """One number of a law, as its file has it. std: None where it is not known."""

    name: str
    value: float
    std: float | None
    unit: str
    bounds: tuple[float, float]
    strength: bool


def numbers_of(fitter: Fitter, candidate: Candidate) -> list[Number]:
    """A law's numbers with their deviations. fitter: the one that fitted it."""
    fit, law = candidate.fit, candidate.law
    covariance = posterior_covariance(fitter, fit)
    found = []
    for j in fit.vector.places(SOUGHT):
        free, value = fit.vector.free[j], float(fit.theta[j])
        term = law.terms[int(free.field[1]) - 1]
        std = None if fit.at_bound[j] else float(np.sqrt(covariance[j, j]))
        strength = free.field.startswith("a")
        around = _AROUND * max(std or abs(value), _AT_LEAST * abs(value))
        if strength:
            bounds = (min(value - around, 0.0), max(value + around, 0.0))
        else:
            bounds = (min(term.bounds[0], value), max(term.bounds[1], value))
        unit = _strength_unit(law, term) if strength else _driver(term).unit
        found.append(Number(free.field, value, std, unit, bounds, strength))
    return found


def _driver(term: Term) -> Driver:
    """The driver whose shape has the free constant."""
    return next(driver for driver, shape in term.factors if shape.constant == "free")


def _strength_unit(law: Law, term: Term) -> str:
    units = [law.place.carrier.unit] if law.place.carrier else []
    for driver, shape in term.factors:
        if driver.unit not in ("", "1") and shape.power:
            units.append(f"({driver.unit})^{-shape.power:g}")
    return " ".join(u for u in units if u != "1") or "1"


def formula(law: Law, numbers: Mapping[str, float]) -> str:
    """The law for people, with its numbers."""
    said = ""
    for i, term in enumerate(law.terms, 1):
        value = numbers[f"a{i}"]
        shape = _term_text(term, numbers.get(f"c{i}"))
        sign = (" + " if value >= 0 else " - ") if said else ("" if value >= 0 else "-")
        said += f"{sign}{abs(value):.3g}{f' {shape}' if shape else ''}"
    name, carrier = law.place.stage[0], law.place.carrier
    if carrier is not None:
        if carrier.text:
            said = f"({said}) {carrier.text}" if len(law.terms) > 1 else f"{said} {carrier.text}"
        return f"{name} = {name}0 {_after(said)}"
    kept = ", the resistance stays" if law.place.stage == "z without resistance" else ""
    change = f"exp({said})" if law.link == "exponential" else f"(1 {_after(said)})"
    return f"{name} = {name}0 {change}{kept}"


def _after(sum_: str) -> str:
    """A sum with the sign that joins it to what stands before it."""
    return f"- {sum_[1:]}" if sum_.startswith("-") else f"+ {sum_}"


def _term_text(term: Term, constant: float | None) -> str:
    parts = []
    for driver, shape in term.factors:
        c = constant if shape.constant == "free" else driver.middle
        if shape.moved and driver.reference:
            # (x - reference) - c reads better as x - (reference + c)
            text = shape.text.format(u=driver.name, c=f"{driver.reference + (c or 0.0):.4g}")
        else:
            text = shape.text.format(u=driver.text, c=f"{c:.3g}")
        parts.append(text)
    return " ".join(parts).replace("- -", "+ ")


def file_name_problem(name: str) -> str:
    """Say why a name cannot be an effect's id, "" where it can."""
    if re.fullmatch(r"[a-z][a-z0-9_]*", name) and not keyword.iskeyword(name):
        return ""
    return f"'{name}' is no id: expected small letters, digits and _, like slip_law"


def default_name(law: Law) -> str:
    """`learnt_slip`: an id made of what the law follows."""
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
    summary = {summary}
    formula = {formula}
    source = {source}
    learnt_from = {learnt_from}
    needs = {needs}
    drivers = {drivers}
    valid = {{{valid}}}
{fields}

    def {method}:
{variables}        return {returned}
"""
_RESISTANCE_STAYS = """
    def compaction_sinkage(self, sinkage, conditions):
        return sinkage
"""


def file_text(classes: list[str]) -> str:
    """The file with these laws."""
    return "\n\n".join([_HEAD, *classes])


def class_text(
    law: Law,
    numbers: list[Number],
    name: str,
    measurements: Measurements,
    settings: int,
    tied: int,
    summary: str,
) -> str:
    """The Python class of a law. Numbers have all their digits: what reads it predicts the same."""
    variables: dict[Driver, str] = {}
    for driver in law.by_name.values():
        taken = driver.variable in variables.values()  # two columns may read alike
        variables[driver] = driver.variable + (f"_{len(variables) + 1}" if taken else "")
    lines = [
        f"        {variable} = {driver.code}"
        + (f" - {driver.reference!r}\n" if driver.reference else "\n")
        for driver, variable in variables.items()
    ]
    columns = sorted(law.columns)
    others = "1 other formula fits" if tied == 2 else f"{tied - 1} other formulas fit"
    data = f"{Path(measurements.source).name}, " if measurements.source else ""
    text = _CLASS.format(
        title="".join(part.title() for part in name.split("_")),
        name=name,
        version=VERSION,
        summary=_quoted(summary),
        formula=_quoted(formula(law, {n.name: n.value for n in numbers})),
        source=_quoted(f"smallwheel learn, {data}{settings} settings; {others} as well"),
        learnt_from=_quoted(measurements.sha256),
        needs=_tuple([c for c in columns if c not in ("load", "width", "diameter")]),
        drivers=_tuple(columns),
        valid=", ".join(f"{_quoted(c)}: {_range(measurements, c)!r}" for c in columns),
        fields="\n".join(_field(n, law) for n in numbers),
        method=_METHODS[law.place.stage[0]],
        variables="".join(lines),
        returned=_returned(law, variables),
    )
    return text + (_RESISTANCE_STAYS if law.place.stage == "z without resistance" else "")


def _returned(law: Law, variables: Mapping[Driver, str]) -> str:
    """What the law's method returns, as Python."""
    eta = " + ".join(_term_code(i, term, variables) for i, term in enumerate(law.terms, 1))
    stage, carrier = law.place.stage[0], law.place.carrier
    if carrier is not None:
        added = {
            "n": eta,
            "z": f"np.maximum(sinkage + {eta}, {LEAST_FACTOR} * sinkage)",
            "R": f"{carrier.code} * ({eta})",
        }
        return added[stage]
    linear = f"np.maximum(1.0 + {eta}, {LEAST_FACTOR})"
    changed = {"k": "", "z": "sinkage * ", "D": "diameter * "}[stage]
    return changed + (f"np.exp({eta})" if law.link == "exponential" else linear)


def _term_code(i: int, term: Term, variables: Mapping[Driver, str]) -> str:
    parts = [f"self.a{i}"]
    for driver, shape in term.factors:
        held = f"self.c{i}" if shape.constant == "free" else repr(driver.middle)
        code = re.sub(r"\bc\b", held, shape.code)
        parts.append(
            f"continued(lambda u: {code}, {variables[driver]}, {driver.low!r}, {driver.high!r})"
        )
    return " * ".join(parts) if len(parts) > 1 else f"{parts[0]} * np.ones(len(conditions))"


def _field(number: Number, law: Law) -> str:
    term = law.terms[int(number.name[1]) - 1]
    what = "strength" if number.strength else f"shape over {_driver(term).name}"
    std = "" if number.std is None else f", std {number.std:.2g}"
    low, high = number.bounds
    neutral = "" if number.strength else ", neutral=None"
    return (
        f"    {number.name}: float = parameter({number.value!r}, ({low!r}, {high!r}), "
        f"{_quoted(what + std)}, unit={_quoted(number.unit)}{neutral})"
    )


def _range(measurements: Measurements, column: str) -> tuple[float, float]:
    values: Any = measurements.conditions[column]
    values = values[np.isfinite(values)]
    return float(values.min()), float(values.max())


def _tuple(names: list[str]) -> str:
    inside = ", ".join(_quoted(n) for n in names)
    return f"({inside},)" if names else "()"


def _quoted(text: str) -> str:
    """A Python literal of any text: names of columns and files may have any character."""
    return json.dumps(text)
