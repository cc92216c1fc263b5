# SPDX-License-Identifier: Apache-2.0
"""`fit`: soil and effects calibrated on measurements."""

from dataclasses import replace
from typing import TYPE_CHECKING, Any

from smallwheel_ros.api.read import read_test
from smallwheel_ros.arguments import Geometry, refuse_given
from smallwheel_ros.common.errors import ArgumentError
from smallwheel_ros.measurements.given import Tests
from smallwheel_ros.model.given import AnyModel, Effects, effects_of, model_of

if TYPE_CHECKING:
    from smallwheel_ros.fitting import FitResult, Problem
    from smallwheel_ros.lab.lab import LabFit
    from smallwheel_ros.measurements.measurements import Measurements, ShearTests


def fit(
    data: Tests,
    effects: Effects = (),
    model: AnyModel | None = None,
    *,
    geometry: Geometry | None = None,
) -> "FitResult | LabFit":
    """Calibrate soil and effects on measurements; with plates or shear tests, all tests of a lab.

    Plates of several sizes are also fitted by the laws of Bekker and Reece. Shear tests give cohesion,
    friction angle and shear modulus; alone they make a model only where `model` is given.

    Parameters
    ----------
    data : path, DataFrame, what `sw.read` returned, or several
        One table, or several of one lab: plates, pressed and rolling wheels, shear tests.
    effects : str, Effect (with numbers to start from), class of effects, or several, optional
        Effects to fit with the soil, by id (slip_sinkage,bulldozing) or id/form; a name that ends in .py is
        a file with effects of your own, which is run.
    model : Model, Soil, result with a model, name or path, optional
        Start from this model; soils and effects are refitted within its covariance, or freely where it
        states none.
    geometry : {'contact_integral', 'closed_form'}, optional
        Rule by which load follows from sinkage. Without it: the model's, or the contact integral.

    Returns
    -------
    FitResult or LabFit
        FitResult for a table of rolling wheels: the model, each parameter with its standard deviation, and
        the held-out errors (m, N or N m by channel). LabFit if there are other tests.

    Raises
    ------
    ArgumentError, FittingError, MeasurementsError
        If the measurements cannot be used; `model` and `geometry` are given; or `effects` or `geometry` with
        shear tests alone.

    Examples
    --------
    >>> import smallwheel_ros as sw
    >>> fitted = sw.fit("rig.csv", effects="slip_sinkage")
    >>> fitted.model.effects[0].id
    'slip_sinkage'
    >>> k = fitted["k"]
    >>> bool(0.0 < k.std < k.value), k.unit
    (True, 'Pa/m^(n+m)')
    >>> again = sw.fit("rig.csv", model=sw.Model("dry_sand") + sw.effects.slip_sinkage)
    >>> sorted(again.held_out)
    ['resistance', 'sinkage']
    """
    from smallwheel_ros.fitting import Base, Problem
    from smallwheel_ros.fitting.parameters import part_of
    from smallwheel_ros.fitting.problem import base_of
    from smallwheel_ros.lab.agreement import agreements
    from smallwheel_ros.lab.lab import fit_lab
    from smallwheel_ros.measurements.measurements import joined, joined_shear

    tests, tables = _tests_of(data)
    measurements = joined(tables) if tables else None
    known = None if model is None else model_of(model)
    if known is not None and geometry is not None:
        raise ArgumentError(
            "model and geometry: found both, expected one: a model has its geometry"
        )
    if measurements is None:
        refuse_given(
            {"effects": effects, "geometry": geometry},
            "with shear tests alone, to which it is not fitted: add tests of plates or wheels, or leave it "
            "out",
        )
        return fit_lab(None, joined_shear(tests), known=known)
    base = Base(geometry=geometry or "contact_integral")
    if known is not None:
        base = base_of(known, measurements, free=True)
    parts = [part_of(effect) for effect in effects_of(effects, measurements.conditions)]
    base = replace(base, parts=(*base.parts, *parts))
    if tests or not measurements.conditions.rolling.all():
        lab = fit_lab(measurements, joined_shear(tests) if tests else None, base, known)
        return replace(lab, notes=(*lab.notes, *_advice(Problem.of(measurements, base))))
    problem = Problem.of(measurements, base)
    errors, found = problem.held_out(), problem.result()
    said = [a.sentence() for a in agreements(measurements, base) if not a.agrees]
    rmse = {} if errors is None else errors.rmse()
    return replace(found, held_out=rmse, notes=(*found.notes, *said, *_advice(problem)))


def _advice(problem: "Problem") -> list[str]:
    """Sentences on a stuck gauge, on runs that look like clerical errors, and on runs that differ much."""
    import numpy as np

    from smallwheel_ros.diagnosis.bad_runs import BadRun, bad_runs, most_bad, stuck
    from smallwheel_ros.fitting.result import runs_differ, unusual
    from smallwheel_ros.measurements.display import number, words

    fitter = problem.fitter
    differ = runs_differ(unusual(fitter, fitter.true_scatter(problem.fit)))
    left, table = problem.judged, problem.points.measurements
    bad: list[BadRun] = []
    most = most_bad(left.points.run_count)
    while (more := bad_runs(left.fitter, left.fit)) and len(bad) + len(more) <= most:
        bad += more
        left = left.without(np.concatenate([one.rows for one in more]))
    said = [still] if (still := stuck(problem.points)) else []
    if differ:
        said.append("`smallwheel diagnose` looks for what is missing where runs differ so much")
    return said + [
        f"run {one.name} ({table.place} {', '.join(map(str, table.line[one.rows][:5]))}) lies far off and is "
        f"in the fit: its {words(one.channel)} is {number(one.deviations, 2)} {one.against}. Look it up in "
        "the protocol, and delete it if it is wrong; `smallwheel diagnose` leaves it out"
        for one in bad
    ]


def _tests_of(data: Tests) -> "tuple[list[ShearTests], list[Measurements]]":
    """Read the tests of a lab: shear tests, and tables of load and sinkage."""
    from smallwheel_ros.measurements.measurements import Measurements, ShearTests

    given: list[Any] = list(data) if isinstance(data, (list, tuple)) else [data]
    if not given:
        raise ArgumentError("data: found an empty list, expected measurements")
    found = [read_test(one) for one in given]
    tests = [one for one in found if isinstance(one, ShearTests)]
    return tests, [one for one in found if isinstance(one, Measurements)]
