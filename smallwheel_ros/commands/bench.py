# SPDX-License-Identifier: Apache-2.0
"""`smallwheel fit`, `compare`, `diagnose` and `add`: options, and the functions of those names."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from smallwheel_ros import api
from smallwheel_ros.commands.inputs import (
    CAN,
    DATA,
    HTML,
    MODEL,
    OWN,
    WITHOUT,
    BenchError,
    levels_of,
    names_of,
    progress_of_fits,
    progress_of_steps,
    read_table,
    read_test,
    table_options,
)
from smallwheel_ros.common.console import JSON, show
from smallwheel_ros.common.files import check_folder_target, check_targets

if TYPE_CHECKING:
    from smallwheel_ros.model.model import Geometry

_PATH = click.Path(path_type=Path)
_PLOTS = click.option("--plots", type=_PATH, metavar="DIR",
                      help="Write pictures (PNG) into this folder.")  # fmt: skip


@click.command("fit", short_help="Calibrate soil and effects on measurements.")
@click.argument("data", type=_PATH, nargs=-1, required=True)
@click.option("-o", "--output", required=True, type=_PATH, help="Model file to write.")
@click.option("--effects", "names", default="", metavar="A,B",
              help="Effects to fit with the soil, by id (slip_sinkage,bulldozing) or id/form; a "
              "name that ends in .py is a file with effects of your own, which is run.")  # fmt: skip
@click.option("--geometry", type=click.Choice(["contact_integral", "closed_form"]),
              help="How load and sinkage belong together; contact_integral where there is no "
              "model.")  # fmt: skip
@MODEL
@table_options
@JSON
def fit(
    data: tuple[Path, ...],
    output: Path,
    names: str,
    geometry: Geometry | None,
    model_file: Path | None,
    how: dict[str, Any],
    json_file: str | None,
) -> None:
    """Calibrate soil and effects on the measurements in DATA and write a model file.

    DATA is one table, or several of one lab: plates, pressed and rolling wheels, shear tests. Plates of
    several sizes are put under the laws of Bekker and Reece too; shear tests give cohesion, friction
    angle and shear modulus.
    """
    given = names_of(names)
    check_targets([output, json_file], [*data, *(n for n in given if n.endswith(".py"))])
    tables = [read_test(path, how) for path in data]
    result = api.fit(tables, given, model_file, geometry=geometry)
    result.model.save(output)
    show(result, json_file, [output])


@click.command("compare", short_help="Models against measurements, side by side.")
@DATA
@click.option("--model", "models", multiple=True, type=_PATH,
              help="A model file to compare too; may be given several times.")  # fmt: skip
@OWN
@table_options
@JSON
@_PLOTS
@HTML
def compare(
    data: Path,
    models: tuple[Path, ...],
    own: Path | None,
    how: dict[str, Any],
    json_file: str | None,
    plots: Path | None,
    html: Path | None,
) -> None:
    """Compare models with the measurements in DATA.

    The closed forms of Bekker and of Meirion-Griffith & Spenko, the contact integral and, where pull or
    torque was measured, the law of Wong and Reece are fitted to the data, and judged on runs that were
    held out of the fit, beside a constant, the mean of the other runs. A model file stands as it is. Errors
    are given for each channel, soil, wheel and range of conditions, beside what rows of one run
    differ by. How much less error a true model would leave is what `smallwheel diagnose` works out.
    """
    check_targets([html, json_file], [data, *models, own])
    check_folder_target(plots)
    measurements = read_table(data, how)
    with progress_of_fits() as progress:
        result = api.compare(measurements, models, effects=own, progress=progress)
    written: list[Path] = []
    if html is not None:
        written.append(result.save(html))
    if plots is not None:
        from smallwheel_ros.pictures.comparison import all_figures
        from smallwheel_ros.pictures.house import write_figures

        written += write_figures(all_figures(result), plots)
    show(result, json_file, written)


@click.command("diagnose", short_help="Find which physical effect a model is missing.")
@DATA
@MODEL
@JSON
@HTML
@_PLOTS
@click.option("--apply", is_flag=True, help="Add what the verdict names; needs -o.")
@click.option("-o", "--output", type=_PATH, help="With --apply: model file to write.")
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True,
              help="Of the simulations behind the p-values.")  # fmt: skip
@WITHOUT
@CAN
@OWN
@table_options
def diagnose(
    data: Path,
    model_file: Path | None,
    json_file: str | None,
    html: Path | None,
    plots: Path | None,
    apply: bool,
    output: Path | None,
    seed: int,
    without: str,
    levels: tuple[str, ...],
    own: Path | None,
    how: dict[str, Any],
) -> None:
    """Say which physical effect a model of the measurements in DATA is missing.

    Or that none is, that none known explains it, that several cannot be told apart, or that the
    data is too small; where the model fails, what the data cannot show, and what to measure next.
    """
    if apply != (output is not None):
        raise BenchError("--apply and -o FILE go together: one without the other does nothing")
    check_targets([json_file, html, output], [data, own])
    check_targets([json_file, html], [model_file])  # -o may replace it
    check_folder_target(plots)
    measurements = read_table(data, how)
    can = levels_of(levels, measurements)
    with progress_of_steps("diagnosing") as progress:
        result = api.diagnose(
            measurements,
            model_file,
            effects=own,
            without=names_of(without),
            can=can,
            seed=seed,
            progress=progress,
        )
    written: list[Path] = []
    if output is not None:
        if len(result.steps) < 2:
            gone = "" if result.steps else f"; {output} was not written"
            click.echo(f"nothing was named, so nothing was added{gone}", err=True)
        if result.steps:
            written.append(result.model.save(output))
    if html is not None:
        written.append(result.save(html))
    if plots is not None:
        from smallwheel_ros.pictures.diagnosis import figures
        from smallwheel_ros.pictures.house import write_figures

        written += write_figures(figures(result), plots)
    show(result, json_file, written)


@click.command("add", short_help="Add one effect to a model file, see whether the error falls.")
@click.argument("effect")
@click.option("--model", "model_file", required=True, type=_PATH, help="Model file to add it to.")
@click.option("--data", required=True, type=_PATH, help="Measurements.")
@click.option("-o", "--output", required=True, type=_PATH, help="Model file to write.")
@JSON
@WITHOUT
@OWN
@table_options
def add(
    effect: str,
    model_file: Path,
    data: Path,
    output: Path,
    json_file: str | None,
    without: str,
    own: Path | None,
    how: dict[str, Any],
) -> None:
    """Add EFFECT to a model, fit it with the soil, and print the held-out error before and after."""
    check_targets([output, json_file], [data, own])
    check_targets([json_file], [model_file])  # -o may replace it
    measurements = read_table(data, how)
    out = names_of(without)
    result = api.add(effect, model_file, measurements, effects=own, without=out)
    result.model.save(output)
    show(result, json_file, [output])
