# SPDX-License-Identifier: Apache-2.0
"""The commands on a table of measurements: outputs, progress, and the functions of those names."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from smallwheel_ros import api
from smallwheel_ros.commands.from_signature import PATH, BenchError, command
from smallwheel_ros.commands.inputs import (
    HTML,
    PLOTS,
    check_outputs,
    finish,
    levels_of,
    progress_bar,
    read_table,
    read_test,
)
from smallwheel_ros.common.console import JSON, show, tell
from smallwheel_ros.common.files import check_targets

Given = dict[str, Any]  # arguments of the function, by its names
How = dict[str, Any]  # arguments of `read`
_STEPS = 5  # that a diagnosis tells of


@command(api.fit)
@click.option("-o", "--output", type=PATH, metavar="FILE", help="Model file to write.")
@JSON
def fit(given: Given, how: How, output: Path | None, json_file: str | None) -> None:
    """What was found is printed. With -o it is a model file too, for the other commands and the node."""
    check_outputs(given, [json_file], output)
    given["data"] = [read_test(path, how) for path in given["data"]]
    result = api.fit(**given)
    show(result, json_file, [] if output is None else [result.model.save(output)])


@command(api.compare, models={"names": ("--model",)})
@JSON
@PLOTS
@HTML
def compare(
    given: Given, how: How, json_file: str | None, plots: Path | None, html: Path | None
) -> None:
    """A model file is compared beside these."""
    check_outputs(given, [html, json_file], plots=plots)
    given["data"] = read_table(given["data"], how)
    with progress_bar("fitting", unit="fit") as progress:
        result = api.compare(**given, progress=progress)
    finish(result, json_file, [], html, plots)


@command(api.diagnose)
@JSON
@HTML
@PLOTS
@click.option("--full", is_flag=True, help="Print all that the page has, not the answer alone.")
@click.option("--apply", is_flag=True, help="Add what the verdict names; needs -o.")
@click.option("-o", "--output", type=PATH, help="With --apply: model file to write.")
def diagnose(
    given: Given,
    how: How,
    json_file: str | None,
    html: Path | None,
    plots: Path | None,
    full: bool,
    apply: bool,
    output: Path | None,
) -> None:
    """With --apply what the verdict names is added to the model, step by step, and -o is the result."""
    if apply != (output is not None):
        raise BenchError("--apply and -o FILE go together: one without the other does nothing")
    check_outputs(given, [json_file, html], output, plots)
    measurements = read_table(given["data"], how)
    given |= {"data": measurements, "can": levels_of(given["can"], measurements)}
    with progress_bar("diagnosing", _STEPS) as progress:
        result = api.diagnose(**given, progress=progress)
    written: list[Path] = []
    if output is not None:
        if len(result.steps) < 2:
            gone = "" if result.steps else f"; {output} was not written"
            click.echo(f"nothing was named, so nothing was added{gone}", err=True)
        if result.steps:
            written.append(result.model.save(output))
    text = None
    if full:
        from smallwheel_ros.views.diagnosis import page

        text = page(result, pictures=False).text()
    finish(result, json_file, written, html, plots, text)


@command(
    api.learn,
    name={"metavar": "ID"},
    most={"type": click.IntRange(1, 5)},
)
@click.option("-o", "--output", type=PATH, metavar="FILE",
              help="Effect file (*.py) to write, for the verdict `law` only.")  # fmt: skip
@JSON
@PLOTS
@HTML
def learn(
    given: Given,
    how: How,
    output: Path | None,
    json_file: str | None,
    plots: Path | None,
    html: Path | None,
) -> None:
    """With -o the law is a file that --effects of the other commands takes."""
    if output is not None and output.suffix != ".py":
        raise BenchError(f"-o {output}: expected a Python file, *.py")
    check_outputs(given, [json_file, html, output], plots=plots)
    measurements = read_table(given["data"], how)
    given |= {"data": measurements, "can": levels_of(given["can"], measurements)}
    with progress_bar("learning") as progress:
        result = api.learn(**given, progress=progress)
    written: list[Path] = []
    if output is not None and result.source is not None:
        result.document["file"] = str(output)
        written.append(result.save(output))
    elif output is not None:
        click.echo(f"no law was drafted: {output} was not written", err=True)
    finish(result, json_file, written, html, plots)


@command(
    api.add,
    model={"required": True},
    data={"required": True},
    seed=None,
)
@click.option("-o", "--output", required=True, type=PATH, help="Model file to write.")
@JSON
def add(given: Given, how: How, output: Path, json_file: str | None) -> None:
    """-o may name the model file itself."""
    check_outputs(given, [json_file], output)
    given["data"] = read_table(given["data"], how)
    result = api.add(**given)
    result.model.save(output)
    show(result, json_file, [output])


@command(api.diagnose, "data", "model", "effects")
@click.option("-o", "--output", required=True, type=PATH, metavar="FILE",
              help="HTML file to write.")  # fmt: skip
@JSON
def report(given: Given, how: How, output: Path, json_file: str | None) -> None:
    """Write one self-contained HTML page on the measurements in DATA.

    Effects to set and unset, the data, models side by side, where the model fails, which effect is
    missing, the held-out error step by step, what this data cannot tell, what to measure next.
    """
    from smallwheel_ros.views.effects import models_block
    from smallwheel_ros.views.page import write_page
    from smallwheel_ros.views.report import page

    check_outputs(given, [output, json_file])
    given["data"] = read_table(given["data"], how)
    models = [] if given["model"] is None else [given["model"]]
    with progress_bar("fitting", unit="fit") as progress:
        comparison = api.compare(given["data"], models, effects=given["effects"], progress=progress)
    with progress_bar("diagnosing", _STEPS) as progress:
        diagnosis = api.diagnose(**given, progress=progress)
    with progress_bar("fitting", unit="fit") as progress:
        choices = models_block(diagnosis, every=True, progress=progress)
    write_page(page(diagnosis, comparison, choices), output)
    found = {"comparison": comparison.to_dict(), "diagnosis": diagnosis.to_dict()}
    tell({"schema": 1, **found}, f"written: {output}", json_file)


@click.command()
@click.argument("folder", type=PATH)
@click.option("--law", type=PATH, metavar="FILE",
              help="Python file with laws of your own, which is run.")  # fmt: skip
@click.option("-o", "--output", type=PATH, metavar="FILE",
              help="Write the errors as a table (CSV).")  # fmt: skip
@JSON
@HTML
def benchmark(
    folder: Path, law: Path | None, output: Path | None, json_file: str | None, html: Path | None
) -> None:
    """Hold laws of sinkage, pull and torque against the measured data sets in FOLDER.

    A data set is a folder with its licence (a file LICENSE) and its tables. One size of plate, level of
    slip, wheel, run or soil after the other is left out, and every law is fitted to the rest: the mean of
    the rest, Bernstein-Goriatchkin, Bekker, Reece, Meirion-Griffith & Spenko, Wong and Reece where pull or
    torque was measured, the contact integral, and ours: that with the effects which a diagnosis of the rest
    names. What is printed, of each table as soon as it is done, is the error on what was left out, and
    whether ours wins, loses, or cannot be told from each other law.

    --law enters a law of your own: a class of about ten lines (docs/benchmark.md).
    """
    from tqdm import tqdm

    from smallwheel_ros.benchmark.benchmark import benchmark as laws_on_data
    from smallwheel_ros.benchmark.table import LawTable
    from smallwheel_ros.views.benchmark import ending, table_text

    def done(table: LawTable) -> None:
        if json_file != "-":
            with tqdm.external_write_mode():
                click.echo(f"{table_text(table)}\n")

    check_targets([output, json_file, html], [law])
    with progress_bar("benchmark", unit="fit") as progress:
        result = laws_on_data(folder, progress, done, law)
    written = [result.save(path) for path in (output, html) if path is not None]
    show(result, json_file, written, ending(result))
