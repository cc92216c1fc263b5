# SPDX-License-Identifier: Apache-2.0
"""`predict`: what a model says of a wheel on a soil."""

from dataclasses import replace
from os import PathLike
from typing import TYPE_CHECKING

from smallwheel_ros.api.read import conditions_of
from smallwheel_ros.arguments import (
    Flag,
    Headers,
    OtherSetting,
    Setting,
    Sheets,
    SoilName,
    refuse_given,
)
from smallwheel_ros.common.errors import ArgumentError
from smallwheel_ros.measurements.given import Settings
from smallwheel_ros.measurements.typed import check_setting, levels_of, weighed
from smallwheel_ros.model.given import AnyModel, OwnEffects, model_of, registry_of

if TYPE_CHECKING:
    from smallwheel_ros.model.model import CalibratedModel
    from smallwheel_ros.prediction.prediction import PredictionTable


def predict(
    model: AnyModel | None = None,
    *,
    load: Setting | None = None,
    diameter: Setting | None = None,
    width: Setting | None = None,
    slip: Setting | None = None,
    data: Settings | None = None,
    map: Headers | None = None,
    sheet: Sheets | None = None,
    soil: SoilName | None = None,
    closed_form: Flag = False,
    effects: OwnEffects | None = None,
    **others: OtherSetting,
) -> "PredictionTable":
    """Predict sinkage, resistance and drawbar pull of a wheel on a soil.

    Ranges make a table of every combination of the settings; `data` has the settings row by row. Each
    quantity comes with two standard deviations: `_std` is that of the law's value, `_run_std` that of a row
    measured in a new run.

    Parameters
    ----------
    model : Model, Soil, result with a model, name or path, optional
        The model; a soil stands for the contact integral on it, without effects.
    load : number, several, or text
        Normal load [N]: a number, 20:140:10, or 20,60; or with a unit: 5kgf; 5kg is a mass, which weighs
        less where `gravity` is set lower.
    diameter : number, several, or text
        Wheel diameter [m], or with a unit: '17 cm'.
    width : number, several, or text
        Wheel width [m].
    slip : number, several, or text, optional
        Slip, -1 to 1, or as 30%; without it there is no thrust.
    data : path, DataFrame, or what `sw.read` returned, optional
        A table of settings instead: each row is predicted. Quantities that the table has measured stand
        beside the predictions, as `measured_sinkage`, `measured_sinkage_std` and so on. diameter and width
        then hold for all rows.
    map : dict, as ``{"load": "F3"}``, optional
        Quantity of a column of `data` whose header does not name it.
    sheet : str, int, or several, optional
        Sheet of `data`, where it is a workbook.
    soil : str, optional
        Which soil of a model that has several; without a model, one of the library.
    closed_form : bool, optional
        Use the closed form of Meirion-Griffith and Spenko (2011, eq. 10) instead of the contact integral, on
        a soil of the library.
    effects : path, or what `sw.effects.load` returned, optional
        A Python file with effects of your own. It is run: name only files that you trust.
    others : number, several, or text, as ``speed=0.1``
        A further column that an effect needs, in SI or with a unit.

    Returns
    -------
    PredictionTable
        One row for each combination of the settings, or each row of `data`, SI units.

    Raises
    ------
    ArgumentError, PredictionError, SoilError
        If a setting is missing or not plausible, or the model or the soil cannot be used.

    Examples
    --------
    >>> import smallwheel_ros as sw
    >>> table = sw.predict("dry_sand", load=[40, 80], diameter=0.2, width=0.1, slip=0.2)
    >>> [f"{1e3 * row['sinkage']:.1f} mm" for row in table.rows()]
    ['6.7 mm', '11.5 mm']
    """
    from smallwheel_ros.prediction.prediction import predict_rows, predict_table

    typed = {"load": load, "diameter": diameter, "width": width, "slip": slip} | others
    given = {name: value for name, value in typed.items() if value is not None}
    if data is not None:
        sizes = {n: given.pop(n) for n in ("diameter", "width") if n in given}
        if given:
            raise ArgumentError(
                f"data and {next(iter(given))}: found both, expected one: a table has its settings"
            )
        rows = conditions_of(data, map=map, sheet=sheet, **sizes)
        one = rows.conditions.soil is None or soil is not None
        return predict_rows(_on_soil(model, soil, closed_form, effects, one), rows)
    refuse_given({"map": map, "sheet": sheet}, "without data: give the table it is about")
    lacking = [name for name in ("load", "diameter", "width") if name not in given]
    if lacking:
        raise ArgumentError(
            f"{', '.join(lacking)}: found nothing, expected a value (or data, a table of settings)"
        )
    for name in others:
        check_setting(name)
    levels = weighed({name: levels_of(name, value) for name, value in given.items()})
    on_soil = _on_soil(model, soil, closed_form, effects)
    table = predict_table(on_soil, {name: level.values for name, level in levels.items()})
    said = [level.said for level in levels.values() if level.said]
    return replace(table, notes=(*said, *table.notes))


def _on_soil(
    model: AnyModel | None,
    soil: str | None,
    closed_form: bool,
    effects: OwnEffects | None,
    one: bool = True,
) -> "CalibratedModel":
    """Return the model on the one soil that is meant, or, unless `one`, on all soils that the rows may name.

    Raises ArgumentError, PredictionError, SoilError.
    """
    from smallwheel_ros.model.model import Model
    from smallwheel_ros.prediction.prediction import on_one_soil

    if model is not None and closed_form:
        raise ArgumentError("closed_form goes with a soil of the library: a model has its geometry")
    if model is not None:
        name = str(model) if isinstance(model, (str, PathLike)) else "the model"
        known = model_of(model, registry_of(effects))
        return on_one_soil(known, soil, name) if one else known
    if soil is None:
        raise ArgumentError("found no soil and no model: give a soil (--soil) or a model (--model)")
    return model_of(Model(soil, "closed_form" if closed_form else "contact_integral"))
