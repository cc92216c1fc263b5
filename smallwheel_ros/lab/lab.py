"""All tests of a lab together: from plates, wheels and shear tests to one model.

The model is fitted to every row of load and sinkage (`fitting`); plates of several sizes are put under
Bekker's and Reece's laws too (`plate_laws`), kinds of test that disagree are said (`agreement`), and the
strength comes from shear tests (`shear`, `strength`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from smallwheel_ros.fitting.files import base_of
from smallwheel_ros.fitting.fit import Fit, Fitter
from smallwheel_ros.fitting.levels import fit_points
from smallwheel_ros.fitting.points import FittingError
from smallwheel_ros.fitting.prior import STRENGTH_PARAMETERS
from smallwheel_ros.fitting.problem import Base, Problem
from smallwheel_ros.fitting.result import FitResult, result_of
from smallwheel_ros.lab.agreement import Agreement, agreements
from smallwheel_ros.lab.plate_laws import PlateLaws, plate_laws
from smallwheel_ros.lab.shear import ShearFit, fit_shear
from smallwheel_ros.lab.strength import Strength, StrengthError, strength_of, with_strength
from smallwheel_ros.measurements.shear import ShearTests
from smallwheel_ros.measurements.table import Measurements
from smallwheel_ros.model_file import CalibratedModel

_NO_MODEL = (
    "shear tests tell cohesion, friction angle and shear modulus, and a model needs k and n too: give "
    "the plates' or wheels' table beside it, or a model file (--model)"
)


@dataclass(frozen=True)
class LabFit:
    """What the tests say.

    model: as it is written to a file. fit: of load and sinkage, None where only shear was tested;
    held_out: its held-out error (rmse) by channel, m or N. laws: one for each soil whose plates have
    several sizes. strengths: of each soil that was sheared.
    """

    model: CalibratedModel
    fit: FitResult | None
    held_out: Mapping[str, float]
    laws: tuple[PlateLaws, ...]
    agreements: tuple[Agreement, ...]
    shear: tuple[ShearFit, ...]
    strengths: tuple[Strength, ...]
    notes: tuple[str, ...]


def fit_lab(
    measurements: Measurements | None,
    tests: ShearTests | None = None,
    base: Base | None = None,
    known: CalibratedModel | None = None,
) -> LabFit:
    """Fit a model to the tests of a lab.

    measurements: plates, pressed and rolling wheels. tests: shear. base: the model to fit, where not the
    plain one; known: a model file to start from instead, whose soils are refitted within their
    covariance and whose strength stays where no shear test says otherwise.

    Raises FittingError or StrengthError where the tests are not enough for a model.
    """
    shear = () if tests is None else fit_shear(tests)
    strengths = tuple(strength_of(fit) for fit in shear)
    fit: FitResult | None = None
    held_out: dict[str, float] = {}
    laws: tuple[PlateLaws, ...] = ()
    agree: tuple[Agreement, ...] = ()
    notes: list[str] = []
    if measurements is not None:
        start = base or (Base() if known is None else base_of(known, measurements))
        problem = Problem.of(measurements, start)
        fitter, own = fit_points(problem.points, problem.vector)
        errors = problem.held_out()
        held_out = {} if errors is None else errors.rmse()
        fit = replace(result_of(fitter, own, problem.outliers), held_out=held_out)
        laws, notes = _laws(measurements, problem, fitter, own)
        agree = agreements(measurements, start)
        model = _keep_strength(fit.model, known)
    elif known is None:
        raise StrengthError(f"{tests.source if tests else ''}: {_NO_MODEL}")
    else:
        model = known
    if tests is not None:
        model = with_strength(model, strengths, tests)
    return LabFit(model, fit, held_out, laws, agree, shear, strengths, tuple(notes))


def _laws(
    measurements: Measurements, problem: Problem, fitter: Fitter, fit: Fit
) -> tuple[tuple[PlateLaws, ...], list[str]]:
    """The laws of size in each soil that plates were pressed into; else why there are none."""
    plates = measurements.conditions.plate
    found: list[PlateLaws] = []
    notes: list[str] = []
    for name in dict.fromkeys(measurements.soil[plates].tolist()):
        here = plates & (measurements.soil == name)
        own_fitter, own = fitter, fit
        try:
            if not here.all() or problem.base != Base():
                alone = Problem.of(measurements.take(here))
                own_fitter, own = fit_points(alone.points, alone.vector)
            found.append(plate_laws(own_fitter, own, name or "soil"))
        except FittingError as error:
            notes.append(str(error))
    return tuple(found), notes


def _keep_strength(model: CalibratedModel, known: CalibratedModel | None) -> CalibratedModel:
    """The model with the deviations of the strength that it took over from another."""
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
        size = len(names)
        joined = np.zeros((size + len(at), size + len(at)))
        joined[:size, :size] = covariance
        joined[size:, size:] = known.covariance[np.ix_(at, at)]
        names, covariance = (*names, *own), joined
    return CalibratedModel(model.model, names, covariance, model.provenance)
