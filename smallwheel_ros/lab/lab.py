# SPDX-License-Identifier: Apache-2.0
"""All tests of a lab together: from plates, wheels and shear tests to one model.

The model is fitted to every row of load and sinkage (`fitting`). Plates of several sizes are also fitted by
Bekker's and Reece's laws (`plate_laws`), disagreement between kinds of tests is reported
(`agreement`), and the strength comes from shear tests (`shear`, `strength`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.linalg import block_diag

from smallwheel_ros.common.result import Result, Writer
from smallwheel_ros.common.tables import plain
from smallwheel_ros.fitting.named import FittedParameter, WithParameters
from smallwheel_ros.fitting.parameters import STRENGTH_PARAMETERS
from smallwheel_ros.fitting.points import FittingError
from smallwheel_ros.fitting.problem import Base, Problem, base_of
from smallwheel_ros.fitting.result import FitResult
from smallwheel_ros.lab.agreement import Agreement, agreements
from smallwheel_ros.lab.plates import PlateLaws, laws_document, laws_text, plate_laws
from smallwheel_ros.lab.shear import ShearFit, fit_shear
from smallwheel_ros.lab.strength import (
    LabStrength,
    StrengthError,
    shear_document,
    shear_text,
    strength_of,
    with_strength,
)
from smallwheel_ros.measurements.display import sentence
from smallwheel_ros.measurements.measurements import Measurements, ShearTests
from smallwheel_ros.model.model import CalibratedModel

_NO_MODEL = (
    "shear tests give cohesion, friction angle and shear modulus, and a model needs k and n too: give "
    "the table of plates or wheels as well, or a model file or a soil of the library (--model)"
)


@dataclass(frozen=True, repr=False)
class LabFit(WithParameters, Result):
    """Result of a lab's tests. `fit["cohesion"]` or `fit.kc` is one parameter with its standard deviation.

    Attributes
    ----------
    made
        The model; None if only shear was tested and no model was given.
    fit
        Fit to load and sinkage; None if only shear was tested.
    laws
        Laws of size, for each soil whose plates have several sizes.
    agreements
        Comparisons of plates, pressed and rolling wheels on one soil.
    shear, strengths
        Fit of the shear tests, and the strength that follows, for each soil that was sheared.
    notes
        Sentences on what could not be fitted.
    source
        File of the shear tests; empty if there are none.
    """

    made: CalibratedModel | None
    fit: FitResult | None
    laws: tuple[PlateLaws, ...]
    agreements: tuple[Agreement, ...]
    shear: tuple[ShearFit, ...]
    strengths: tuple[LabStrength, ...]
    notes: tuple[str, ...]
    source: str = ""

    @property
    def model(self) -> CalibratedModel:
        """The calibrated model. Raises StrengthError if there is none, as from shear tests alone."""
        if self.made is None:
            raise StrengthError(f"{self.source}: {_NO_MODEL}")
        return self.made

    @property
    def held_out(self) -> Mapping[str, float]:
        """Held-out error (rms) of the fit to load and sinkage, by channel, SI; empty if there is none."""
        return {} if self.fit is None else self.fit.held_out

    @property
    def parameters(self) -> tuple[FittedParameter, ...]:
        """Parameters of load and sinkage, then those of the strength."""
        of_fit = () if self.fit is None else self.fit.parameters
        return (*of_fit, *(p for strength in self.strengths for p in strength.parameters))

    def named(self) -> Mapping[str, FittedParameter]:
        """Parameters by full name ("soil.name"): of the laws of plates, of the model, of the shear tests.

        If a name occurs more than once, the later of these is taken.
        """
        found = [c for laws in self.laws for law in laws.laws for c in law.constants]
        found += [] if self.fit is None else self.fit.named().values()
        sheared = [p for s in self.strengths for p in (*s.parameters, *s.derived)]
        if len(self.strengths) == 1 and self.fit is not None and len(self.fit.bare.soils) == 1:
            # One soil, whatever the tests call it: its strength is that of the shear tests.
            measured = {p.name for p in sheared}
            found = [p for p in found if p.name not in measured]
        return {p.full_name: p for p in (*found, *sheared)}

    def headline(self) -> str:
        """One line: the error of the fit to load and sinkage, and what else was tested."""
        said = [] if self.fit is None else [self.fit.headline()]
        if self.laws:
            said.append(f"plates of {len(self.laws[0].diameters)} sizes")
        if self.shear:
            said.append(f"{sum(len(fit.plain.runs) for fit in self.shear)} shear tests")
        return "; ".join(said)

    def text(self) -> str:
        """The text that `smallwheel fit` prints."""
        parts = [] if self.fit is None else [self.fit.text()]
        parts += [laws_text(laws) for laws in self.laws]
        parts += [sentence(agreement.sentence()) for agreement in self.agreements]
        parts += [shear_text(*pair) for pair in zip(self.shear, self.strengths, strict=True)]
        parts += [sentence(note) for note in self.notes]
        return "\n\n".join(parts)

    def to_dict(self) -> dict[str, Any]:
        """The document that `smallwheel fit --json` writes."""
        found = {"schema": 1} if self.fit is None else self.fit.to_dict()
        more = {
            "plate_laws": [laws_document(laws) for laws in self.laws],
            "agreements": [agreement.to_dict() for agreement in self.agreements],
            "shear": [
                shear_document(*pair) for pair in zip(self.shear, self.strengths, strict=True)
            ],
            "lab_notes": list(self.notes),
        }
        return found | dict(plain(more))

    def rows(self) -> list[dict[str, Any]]:
        """The parameters of the model, the constants of the laws of size, and the results of shear tests."""
        found = [] if self.fit is None else self.fit.rows()
        constants = [
            (law.law.name, c) for laws in self.laws for law in laws.laws for c in law.constants
        ]
        constants += [
            ("shear tests", p) for s in self.strengths for p in (*s.parameters, *s.derived)
        ]
        return found + [
            {"of": f"{p.owner}, {of}", "parameter": p.name, "value": p.value, "std": p.std,
             "unit": p.unit, "status": p.status}
            for of, p in constants
        ]  # fmt: skip

    def _writers(self) -> dict[str, Writer]:
        def write(path: Path) -> None:
            self.model.save(path)

        return dict.fromkeys((".yaml", ".yml"), write)


def fit_lab(
    measurements: Measurements | None,
    tests: ShearTests | None = None,
    base: Base | None = None,
    known: CalibratedModel | None = None,
    progress: Callable[[str], object] = lambda step: None,
) -> LabFit:
    """Fit a model to the tests of a lab.

    Parameters
    ----------
    measurements
        Plates, pressed and rolling wheels; None if there are none.
    tests
        Shear tests; None if there are none.
    base
        The model to fit; None: the one that follows from `known`, else the contact integral without effects.
    known
        A model to start from: its soils are refitted within their covariance, and its strength stays
        unless shear tests replace it.
    progress
        Called with each step in words.

    Raises
    ------
    FittingError, StrengthError
        If the tests determine nothing, or are of a soil that the model does not have.
    """
    progress("shear tests")
    shear = () if tests is None else fit_shear(tests)
    strengths = tuple(strength_of(fit) for fit in shear)
    fit: FitResult | None = None
    laws: tuple[PlateLaws, ...] = ()
    agree: tuple[Agreement, ...] = ()
    notes: list[str] = []
    if measurements is not None:
        progress("load and sinkage")
        start = base or (Base() if known is None else base_of(known, measurements))
        problem = Problem.of(measurements, start)
        errors = problem.held_out()
        held_out = {} if errors is None else errors.rmse()
        fit = replace(problem.result(), held_out=held_out)
        progress("laws of plates")
        laws, notes = _laws(measurements, problem)
        progress("plates against wheels")
        agree = agreements(measurements, start)
        model: CalibratedModel | None = _keep_strength(fit.model, known)
    else:
        model = known
    if model is None:
        notes.append(f"no model was made: {_NO_MODEL}")
    elif tests is not None:
        model = with_strength(model, strengths, tests)
    source = "" if tests is None else tests.source
    return LabFit(model, fit, laws, agree, shear, strengths, tuple(notes), source)


def _laws(measurements: Measurements, problem: Problem) -> tuple[tuple[PlateLaws, ...], list[str]]:
    """The laws of size in each soil that plates were pressed into, and notes on soils without them."""
    plates = measurements.conditions.plate
    found: list[PlateLaws] = []
    notes: list[str] = []
    for name in dict.fromkeys(measurements.soil[plates].tolist()):
        here = plates & (measurements.soil == name)
        try:
            whole = here.all() and problem.base == Base()
            alone = problem if whole else Problem.of(measurements.take(here))
            found.append(plate_laws(alone.fitter, alone.fit, name or "soil"))
        except FittingError as error:
            notes.append(str(error))
    return tuple(found), list(dict.fromkeys(notes))


def _keep_strength(model: CalibratedModel, known: CalibratedModel | None) -> CalibratedModel:
    """The model with the covariance of the strength that it took over from `known`."""
    if known is None:
        return model
    names, covariance = model.names, model.covariance
    soils = known.model.soils
    for soil in model.model.soils:
        source = soils[0].name if len(soils) == 1 else soil.name
        kept = [f"{source}.{p}" for p in STRENGTH_PARAMETERS if f"{source}.{p}" in known.names]
        own = [f"{soil.name}.{name.rpartition('.')[2]}" for name in kept]
        if not kept or any(name in names for name in own):
            continue
        at = [known.names.index(name) for name in kept]
        names, covariance = (*names, *own), block_diag(covariance, known.covariance[np.ix_(at, at)])
    return model.changed(names=names, covariance=covariance)
