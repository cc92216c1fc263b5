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
# The one method of each stage, and what it returns.
_METHODS = {
    "k": ("modulus_factor(self, conditions)", "{change}"),
    "z": ("sinkage(self, sinkage, conditions)", "sinkage * {change}"),
    "n": ("exponent_shift(self, conditions)", "{change}"),
    "D": ("wheel_diameter(self, diameter, conditions)", "diameter * {change}"),
    "R": ("added_resistance(self, state, conditions)", "{carrier} * ({change})"),
}
# What an added strength multiplies: as Python, for people, and its unit.
_CARRIERS = {
    "": ("", "", "1"),
    "length": ("", "", "m"),
    "force": ("1.0", "", "N"),
    "load": ("state.load", "W", "1"),
    "width sinkage^2": ("state.width * state.sinkage**2", "b z^2", "N/m^3"),
    "width sinkage": ("state.width * state.sinkage", "b z", "N/m^2"),
    "compaction": (
        "state.width * state.modulus * state.sinkage ** (state.exponent + 1.0)"
        " / (state.exponent + 1.0)",
        "Rc", "1",
    ),
}  # fmt: skip


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
        unit = _strength_unit(law, term) if strength else _driver(term).source.unit
        found.append(Number(free.field, value, std, unit, bounds, strength))
    return found


def _driver(term: Term) -> Driver:
    """The driver whose shape has the free constant."""
    return next(driver for driver, shape in term.factors if shape.constant == "free")


def _strength_unit(law: Law, term: Term) -> str:
    units = [_CARRIERS[law.place.carrier][2]]
    for driver, shape in term.factors:
        if driver.source.unit not in ("", "1") and shape.power:
            units.append(f"({driver.source.unit})^{-shape.power:g}")
    return " ".join(u for u in units if u != "1") or "1"


def formula(law: Law, numbers: Mapping[str, float]) -> str:
    """The law for people, with its numbers."""
    said = ""
    for i, term in enumerate(law.terms, 1):
        value = numbers[f"a{i}"]
        shape = _term_text(term, numbers.get(f"c{i}"))
        sign = (" + " if value >= 0 else " - ") if said else ("" if value >= 0 else "-")
        said += f"{sign}{abs(value):.3g}{f' {shape}' if shape else ''}"
    name = law.place.stage[0]
    if law.place.shifts:
        carrier = _CARRIERS[law.place.carrier][1]
        if carrier:
            said = f"({said}) {carrier}" if len(law.terms) > 1 else f"{said} {carrier}"
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


HEAD = """from dataclasses import dataclass

import numpy as np

from smallwheel_ros.effects import parameter
from smallwheel_ros.effects.drafted import Drafted, continued
"""


def file_text(classes: list[str]) -> str:
    """The file with these laws."""
    about = '"""Drafted by `smallwheel learn`: learnt from data, not published."""'
    return "\n\n".join([f"{about}\n\n{HEAD}", *classes])


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
    method, returned = _METHODS[law.place.stage.split()[0]]
    lines: list[str] = []
    variables: dict[str, str] = {}
    for term in law.terms:
        for driver, _ in term.factors:
            if driver.name not in variables:
                variable = driver.source.variable
                if variable in variables.values():
                    variable = f"{variable}_{len(variables) + 1}"  # two columns may read alike
                variables[driver.name] = variable
                less = f" - {driver.reference!r}" if driver.reference else ""
                lines.append(f"        {variable} = {driver.source.code}{less}")
    eta = " + ".join(_term_code(i, term, variables) for i, term in enumerate(law.terms, 1))
    change = eta
    if not law.place.shifts:
        linear = f"np.maximum(1.0 + {eta}, {LEAST_FACTOR})"
        change = f"np.exp({eta})" if law.link == "exponential" else linear
    elif law.place.carrier == "length":
        returned = f"np.maximum(sinkage + {{change}}, {LEAST_FACTOR} * sinkage)"
    carrier = _CARRIERS[law.place.carrier][0]
    lines.append(f"        return {returned.format(change=change, carrier=carrier)}")
    needs = sorted(law.columns - {"load", "width", "diameter"})
    columns = sorted(law.columns)
    valid = [f"{_quoted(c)}: {_range(measurements, c)!r}" for c in columns]
    others = (
        f"{tied - 1} other formulas fit as well" if tied != 2 else "1 other formula fits as well"
    )
    value = {n.name: n.value for n in numbers}
    data = f"{Path(measurements.source).name}, " if measurements.source else ""
    head = [
        "@dataclass(frozen=True)",
        f"class {''.join(part.title() for part in name.split('_'))}(Drafted):",
        f'    id = "{name}"',
        '    form = "drafted"',
        f"    version = {VERSION}",
        f"    summary = {_quoted(summary)}",
        f"    formula = {_quoted(formula(law, value))}",
        f"    source = {_quoted(f'smallwheel learn, {data}{settings} settings; {others}')}",
        f"    learnt_from = {_quoted(measurements.sha256)}",
        f"    needs = {_tuple(needs)}",
        f"    drivers = {_tuple(columns)}",
        f"    valid = {{{', '.join(valid)}}}",
    ]
    fields = [_field(n, law) for n in numbers]
    body = [f"    def {method}:", *lines]
    if law.place.stage == "z without resistance":
        body += [
            "",
            "    def compaction_sinkage(self, sinkage, conditions):",
            "        return sinkage",
        ]
    return "\n".join([*head, *fields, "", *body, ""])


def _term_code(i: int, term: Term, variables: Mapping[str, str]) -> str:
    parts = [f"self.a{i}"]
    for driver, shape in term.factors:
        held = f"self.c{i}" if shape.constant == "free" else repr(driver.middle)
        code = re.sub(r"\bc\b", held, shape.code)
        parts.append(
            f"continued(lambda u: {code}, {variables[driver.name]}, {driver.low!r}, {driver.high!r})"
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
