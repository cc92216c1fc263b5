# SPDX-License-Identifier: Apache-2.0
"""The functions of `import smallwheel_ros as sw`; the commands of the same names print what they return.

Wherever data is asked for, a path, a DataFrame of pandas or what `read` returned will do; wherever a
model is, a `Model`, a model file's path, a soil of the library or its name, or a result that has a model.
The options of the commands, their texts and the table in docs/python.md are made of the signatures
and docstrings here (`commands.from_signature`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace as changed
from os import PathLike
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Literal, cast

from smallwheel_ros.arguments import (
    ArgumentError,
    check_setting,
    contenders_of,
    effects_of,
    ids_of,
    kind,
    levels_of,
    model_of,
    registry_of,
)

# A function imports what it needs when it is called: a model in a notebook needs no search for effects.
if TYPE_CHECKING:
    from smallwheel_ros.arguments import (
        AnyEffect,
        AnyModel,
        Data,
        Effects,
        Headers,
        Ids,
        Levels,
        Models,
        OwnEffects,
        Setting,
        Sheets,
        Tests,
    )
    from smallwheel_ros.compare.comparison import Comparison
    from smallwheel_ros.diagnosis.apply import Added
    from smallwheel_ros.diagnosis.pipeline import Diagnosis
    from smallwheel_ros.effects.registry import Registry
    from smallwheel_ros.fitting import Base, FitResult, Problem
    from smallwheel_ros.lab.lab import LabFit
    from smallwheel_ros.learn.learning import Learnt
    from smallwheel_ros.measurements.table import Measurements, ShearTests
    from smallwheel_ros.prediction.prediction import PredictionTable
    from smallwheel_ros.replay.result import Replayed
    from smallwheel_ros.replay.spec import Copy


def read(
    data: Data,
    map: Headers | None = None,
    *,
    sheet: Sheets | None = None,
    diameter: float | None = None,
    width: float | None = None,
    contact: Literal["rolling", "pressed", "plate"] | None = None,
    compliance: float | None = None,
) -> Measurements:
    """Read a table of measurements: a file, or a DataFrame of pandas.

    Parameters
    ----------
    data
        CSV, Parquet or a spreadsheet, as docs/data.md says, or a DataFrame with such headers.
    map : by name, as ``{"load": "F3", "width [cm]": "b"}``
        Which column is what, where its header does not say it.
    sheet : or several, as ``["dry", "wet"]``
        Sheet of a workbook, by name or number; several of the same columns become one table.
    diameter
        Wheel diameter [m] for all rows.
    width
        Wheel width [m] for all rows.
    contact
        What meets the soil in all rows, where the table does not say.
    compliance
        By how much the machine gives way [m/N]: times the load it is taken off each measured sinkage; 1 mm
        under 500 N is 2e-6.

    Raises
    ------
    MeasurementsError
        That names file, row, column, what was found and what was expected.

    Examples
    --------
    >>> import smallwheel_ros as sw
    >>> data = sw.read("rig.csv")
    >>> data.channels.keys()
    dict_keys(['sinkage', 'resistance'])
    """
    from smallwheel_ros.measurements.table import Measurements
    from smallwheel_ros.measurements.wheels import read_measurements

    if isinstance(data, Measurements):
        return data
    return read_measurements(
        _source(data),
        diameter=diameter,
        width=width,
        contact=contact,
        compliance=compliance,
        map=map,
        sheet=sheet,
    )


def read_test(data: Data | ShearTests, **how: Any) -> Measurements | ShearTests:
    """Read a table of any test of a lab, shear tests too. how: as in ``read``."""
    from smallwheel_ros.measurements.table import Measurements, ShearTests
    from smallwheel_ros.measurements.wheels import read_tests

    if isinstance(data, (Measurements, ShearTests)):
        return data
    return read_tests(_source(data), **how)


def _source(data: Any) -> Any:
    """A file's path or a DataFrame. Raises ArgumentError for anything else."""
    if not (isinstance(data, (str, PathLike)) or hasattr(data, "columns")):
        raise ArgumentError(
            f"data: found {kind(data)}, expected a file, a DataFrame or what sw.read returned"
        )
    return Path(data) if isinstance(data, (str, PathLike)) else data


def fit(
    data: Tests,
    effects: Effects = (),
    model: AnyModel | None = None,
    *,
    geometry: Literal["contact_integral", "closed_form"] | None = None,
) -> FitResult | LabFit:
    """Calibrate soil and effects on measurements; with plates or shear tests, all tests of a lab.

    Plates of several sizes are put under the laws of Bekker and Reece too; shear tests give cohesion,
    friction angle and shear modulus, also alone: then a model is made only where `model` is given.

    Parameters
    ----------
    data
        One table, or several of one lab: plates, pressed and rolling wheels, shear tests.
    effects : or classes, or effects with numbers to start from
        Effects to fit with the soil, by id (slip_sinkage,bulldozing) or id/form; a name that ends in
        .py is a file with effects of your own, which is run.
    model
        Start from this model; soils and effects are refitted within its covariance, freely where that says
        nothing of them.
    geometry
        How load and sinkage belong together; contact_integral where there is no model.

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
    from smallwheel_ros.measurements.table import joined, joined_shear

    tests, tables = _tests_of(data)
    measurements = joined(tables) if tables else None
    known = None if model is None else model_of(model)
    if known is not None and geometry is not None:
        raise ArgumentError(
            "model and geometry: found both, expected one: a model has its geometry"
        )
    if measurements is None:
        return fit_lab(None, joined_shear(tests), known=known)
    base = Base(geometry=geometry or "contact_integral")
    if known is not None:
        base = base_of(known, measurements, free=True)
    parts = [part_of(effect) for effect in effects_of(effects, measurements)]
    base = changed(base, parts=(*base.parts, *parts))
    if tests or not measurements.conditions.rolling.all():
        return fit_lab(measurements, joined_shear(tests) if tests else None, base, known)
    problem = Problem.of(measurements, base)
    errors, found = problem.held_out(), problem.result()
    said = [a.sentence() for a in agreements(measurements, base) if not a.agrees]
    rmse = {} if errors is None else errors.rmse()
    return changed(found, held_out=rmse, notes=(*found.notes, *said, *_far_off(problem)))


def _far_off(problem: Problem) -> list[str]:
    """One sentence for each run that `diagnose` would leave out as a slip of the pen."""
    import numpy as np

    from smallwheel_ros.diagnosis.misfit import BadRun, bad_runs, most_bad
    from smallwheel_ros.measurements.display import number, words

    left, table = problem.judged, problem.measurements
    bad: list[BadRun] = []
    most = most_bad(left.points.run_count)
    while (more := bad_runs(left.fitter, left.fit)) and len(bad) + len(more) <= most:
        bad += more
        left = left.without(np.concatenate([one.rows for one in more]))
    return [
        f"run {one.name} ({table.place} {', '.join(map(str, table.line[one.rows][:5]))}) lies far off and is "
        f"in the fit: its {words(one.channel)} is {number(one.deviations, 2)} {one.against}. Look it up in "
        "the protocol, and delete it if it is wrong; `smallwheel diagnose` leaves it out"
        for one in bad
    ]


def _tests_of(data: Tests) -> tuple[list[ShearTests], list[Measurements]]:
    """Shear tests, and tables of load and sinkage."""
    from smallwheel_ros.measurements.table import Measurements, ShearTests

    given: list[Any] = list(data) if isinstance(data, (list, tuple)) else [data]
    if not given:
        raise ArgumentError("data: found an empty list, expected measurements")
    found = [read_test(one) for one in given]
    tests = [one for one in found if isinstance(one, ShearTests)]
    return tests, [one for one in found if isinstance(one, Measurements)]


def compare(
    data: Data,
    models: Models = (),
    *,
    effects: OwnEffects | None = None,
    progress: Callable[[int, int], object] | None = None,
) -> Comparison:
    """Compare models with measurements.

    The closed forms of Bekker and of Meirion-Griffith & Spenko, the contact integral and, where pull or
    torque was measured, the law of Wong and Reece are fitted to the data, and judged on runs that were
    held out of the fit, beside a constant, the mean of the other runs, and a log-log regression. Errors
    are given for each channel, soil, wheel and range of conditions, beside what rows of one run differ
    by. How much less error a true model would leave is what `diagnose` works out.

    Parameters
    ----------
    data
        The measurements.
    models : one, several, or several by name
        A model to compare too, which stands as it is.
    effects : or what `sw.effects.load` made of it
        A Python file with effects of your own. It is run: name only files that you trust.
    progress
        Told how many of how many fits are done.

    Examples
    --------
    >>> import smallwheel_ros as sw
    >>> found = sw.compare("rig.csv", {"sand": "dry_sand"})
    >>> [model.contender.name for model in found.models]
    ['constant', 'log_log_regression', 'bekker', 'meirion_griffith_spenko', 'contact_integral', 'sand']
    """
    from smallwheel_ros.compare.comparison import compare as compare_models

    measurements, user = read(data), registry_of(effects)
    return compare_models(measurements, contenders_of(models, user), progress=progress or _unheard)


def diagnose(
    data: Data,
    model: AnyModel | None = None,
    *,
    effects: OwnEffects | None = None,
    without: Ids = (),
    can: Levels | None = None,
    seed: int = 0,
    progress: Callable[[str], None] | None = None,
) -> Diagnosis:
    """Say which physical effect a model of the measurements is missing.

    Or that none is, that none known explains it, that several cannot be told apart, or that the
    data is too small; where the model fails, what the data cannot show, and what to measure next.

    Parameters
    ----------
    data
        The measurements.
    model
        Start from this model; its soil is refitted within its covariance. If not given, the contact
        integral and nothing else.
    effects : or what `sw.effects.load` made of it
        A Python file with effects of your own. It is run: name only files that you trust.
    without
        Effects that do not compete, by id; `unknown` for curves without a name.
    can : by setting, as ``{"slip": [0, 0.3, 0.6]}``
        What you can set, for the measurements to make next (SI units, angles in rad).
    seed
        Of the simulations behind the p-values: the same seed gives the same result.
    progress
        Told each step in words.

    Examples
    --------
    >>> import smallwheel_ros as sw
    >>> found = sw.diagnose("rig.csv")
    >>> found.verdict, found.missing_effects
    ('missing_effect', ['slip_sinkage'])
    """
    from smallwheel_ros.diagnosis.pipeline import diagnose as diagnose_data

    measurements, base, known, out = start_of(data, model, effects, without)
    return diagnose_data(
        measurements,
        base,
        registry=known,
        seed=seed,
        without=out,
        limits=_limits(can),
        progress=progress or _unheard,
    )


def learn(
    data: Data,
    model: AnyModel | None = None,
    *,
    effects: OwnEffects | None = None,
    without: Ids = (),
    name: str | None = None,
    most: int = 1,
    can: Levels | None = None,
    seed: int = 0,
    progress: Callable[[str, int, int], None] | None = None,
) -> Learnt:
    """Learn which law a model of the measurements lacks, where no known effect explains it.

    The program searches some 40,000 formulas inside the model. It drafts a law only where chance
    would not gain as much, and where the law also predicts settings that the search never saw.
    Nothing could be learnt is a normal answer.

    Parameters
    ----------
    data
        The measurements.
    model
        Start from this model; its soil is refitted within its covariance. If not given, the contact
        integral and nothing else.
    effects : or what `sw.effects.load` made of it
        A Python file with effects of your own. It is run: name only files that you trust.
    without
        Effects that are taken out of the model, by id, and that the law is not held against.
    name
        Id of the law; made of what it follows if not given.
    most
        Laws to learn, one after the other.
    can : by setting, as ``{"slip": [0, 0.3, 0.6]}``
        What you can set, for the measurements to make next (SI units, angles in rad).
    seed
        Of permutations and folds: the same seed gives the same result, to the byte.
    progress
        Told each step in words, how many are done, and of how many (0: not known).

    Examples
    --------
    >>> import smallwheel_ros as sw
    >>> found = sw.learn("rig.csv")
    >>> found.verdict, found.law["drivers"]
    ('law', ['slip'])
    """
    from smallwheel_ros.learn.learning import learn as learn_law

    measurements, base, known, out = start_of(data, model, effects, without)
    return learn_law(
        measurements,
        base,
        registry=known,
        without=out,
        name=name,
        most=most,
        seed=seed,
        limits=_limits(can),
        progress=progress or _unheard,
    )


def add(
    effect: AnyEffect,
    model: AnyModel | None = None,
    data: Data | None = None,
    *,
    effects: OwnEffects | None = None,
    without: Ids = (),
    seed: int = 0,
) -> Added:
    """Add one effect to a model, fit it with the soil, and compare the held-out errors.

    Parameters
    ----------
    effect : or its class
        Its id, as in `slip_sinkage`; the form that fits best is taken.
    model : the contact integral and nothing else if not given
        The model to add it to.
    data
        Measurements, which a diagnosis is asked of, too: whether the effect is recommended.
    effects : or what `sw.effects.load` made of it
        A Python file with effects of your own. It is run: name only files that you trust.
    without
        Effects that do not compete, by id; `unknown` for curves without a name.
    seed
        Of the simulations behind the p-values: the same seed gives the same result.

    Examples
    --------
    >>> import smallwheel_ros as sw
    >>> added = sw.add("slip_sinkage", data="rig.csv")
    >>> added.recommended
    True
    """
    from smallwheel_ros.diagnosis.apply import add_effect

    if data is None:
        raise ArgumentError("data: found nothing, expected the measurements to fit the effect to")
    wanted = effect if isinstance(effect, str) else getattr(effect, "id", None)
    if not isinstance(wanted, str):
        raise ArgumentError(f"effect: found {kind(effect)}, expected an effect's id or class")
    measurements, base, known, out = start_of(data, model, effects, without)
    return add_effect(wanted, base, measurements, registry=known, without=out, seed=seed)


def predict(
    model: AnyModel,
    *,
    load: Setting,
    diameter: Setting,
    width: Setting,
    slip: Setting | None = None,
    soil: str | None = None,
    effects: OwnEffects | None = None,
    **others: Setting,
) -> PredictionTable:
    """Predict sinkage, resistance and drawbar pull of a wheel on a soil.

    Ranges make a table of every combination of the settings.

    Parameters
    ----------
    model
        The model or soil.
    load : number, several, or text
        Normal load [N]: a number, 20:140:10, or 20,60; or with a unit: 5kgf.
    diameter : as the load
        Wheel diameter [m], or with a unit: '17 cm'.
    width : as the load
        Wheel width [m].
    slip : as the load
        Slip, -1 to 1, or as 30%; without it there is no thrust.
    soil
        Which soil of a model that has several.
    effects : or what `sw.effects.load` made of it
        A Python file with effects of your own. It is run: name only files that you trust.
    others : as ``speed=0.1``
        A further column that an effect needs, in SI or with a unit.

    Examples
    --------
    >>> import smallwheel_ros as sw
    >>> table = sw.predict("dry_sand", load=[40, 80], diameter=0.2, width=0.1, slip=0.2)
    >>> [f"{1e3 * row['sinkage']:.1f} mm" for row in table.rows()]
    ['6.7 mm', '11.5 mm']
    """
    from smallwheel_ros.prediction.prediction import on_one_soil, predict_table

    given = {"load": load, "diameter": diameter, "width": width}
    given |= {} if slip is None else {"slip": slip}
    for name in others:
        check_setting(name)
    levels = {name: levels_of(name, value) for name, value in (given | others).items()}
    name = "the model" if not isinstance(model, (str, PathLike)) else str(model)
    on_soil = on_one_soil(model_of(model, registry_of(effects)), soil, name)
    table = predict_table(on_soil, {name: level.values for name, level in levels.items()})
    said = [level.said for level in levels.values() if level.said]
    return changed(table, notes=(*said, *table.notes))


def replay(
    bag: str | PathLike[str],
    config: str | PathLike[str] | None = None,
    output: str | PathLike[str] | None = None,
    *,
    remaps: Mapping[str, str] | None = None,
    clock: bool = True,
    copy: Copy = "all",
    rate: float | None = None,
    soil_file: str | PathLike[str] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Replayed:
    """Give a recorded drive to the estimator that the node runs.

    Parameters
    ----------
    bag
        A rosbag2 folder, a .mcap or .db3 file, or a ROS 1 .bag.
    config
        The node's parameter file; if not given, what `smallwheel init` finds in the bag.
    output
        Folder for tables and bag; if not given, a temporary one that goes with the result. The report is
        what the result saves as .html.
    remaps
        By the node's name of an input, the bag's topic: ``{"odom": "/rover/odom"}``.
    clock
        Judge stamps by the times of recording; otherwise only by each other.
    copy
        Topics that go into the new bag beside the estimates: ``all``, ``used`` or ``none``.
    rate
        Estimates a second (Hz) of each wheel at most, in place of the parameter ``mobility.rate``; 0: one for
        each measured sinkage.
    soil_file
        A saved soil to go on from, if it is there; the soil is saved there at the end, as the node does.
    progress
        Told how many of how many messages are done.

    Examples
    --------
    >>> import smallwheel_ros as sw
    >>> drive = sw.replay("drive", config="rover.yaml", output="out")
    >>> drive.state
    'complete'
    """
    from smallwheel_ros.replay.replay import replay as replay_bag
    from smallwheel_ros.replay.spec import ReplaySpec, read_remaps, with_assumed_config

    place = TemporaryDirectory(prefix="smallwheel-") if output is None else None
    folder = Path(place.name if place is not None else cast(Any, output))
    spec = ReplaySpec(
        Path(bag),
        Path(config or ""),
        folder,
        read_remaps(f"{name}:={topic}" for name, topic in (remaps or {}).items()),
        clock,
        copy,
        rate,
        soil_file=None if soil_file is None else Path(soil_file),
    )
    if config is None:
        spec = with_assumed_config(spec)
    result = replay_bag(spec, progress=progress or _unheard)
    result.place = place
    return result


def start_of(
    data: Data,
    model: AnyModel | None = None,
    effects: OwnEffects | None = None,
    without: Ids = (),
) -> tuple[Measurements, Base, Registry, tuple[str, ...]]:
    """What a diagnosis starts from: table, model to fit, effects, and those that do not compete."""
    from smallwheel_ros.fitting import Base
    from smallwheel_ros.fitting.problem import base_of

    measurements, known = read(data), registry_of(effects)
    base = Base() if model is None else base_of(model_of(model, known), measurements)
    return measurements, base, known, ids_of(without, known)


def _limits(can: Levels | None) -> dict[str, list[float]]:
    """Levels by setting that can be set, as plain numbers."""
    return {name: list(map(float, levels)) for name, levels in (can or {}).items()}


def _unheard(*progress: object) -> None:
    """Nobody wants to know how far it is."""
