# SPDX-License-Identifier: Apache-2.0
"""The commands on a table of measurements: outputs, progress, and the functions of those names."""

from __future__ import annotations

import os
import signal
import sys
import threading
import webbrowser
from pathlib import Path
from typing import Any

import click

from smallwheel_ros import api
from smallwheel_ros.arguments import registry_of
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
    finish(result, json_file, [], html, plots, "pictures.comparison:all_figures")


@command(api.diagnose)
@JSON
@HTML
@PLOTS
@click.option("--apply", is_flag=True, help="Add what the verdict names; needs -o.")
@click.option("-o", "--output", type=PATH, help="With --apply: model file to write.")
def diagnose(
    given: Given,
    how: How,
    json_file: str | None,
    html: Path | None,
    plots: Path | None,
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
    finish(result, json_file, written, html, plots, "pictures.diagnosis:figures")


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
    finish(result, json_file, written, html, plots, "pictures.fit:learnt_figures")


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
@click.option("--pairs/--no-pairs", default=True, show_default=True,
              help="Whether pairs of effects can be set in the page: they take most of the time, with "
              "many runs long.")  # fmt: skip
@JSON
def report(given: Given, how: How, output: Path, pairs: bool, json_file: str | None) -> None:
    """Write one self-contained HTML page on the measurements in DATA.

    Effects to set and unset, the data, models side by side, where the model fails, which effect is
    missing, the held-out error step by step, what this data cannot tell, what to measure next.
    """
    from smallwheel_ros.explore.data import explored_page
    from smallwheel_ros.explore.session import ExploreError, Session

    check_outputs(given, [output, json_file])
    given["data"] = read_table(given["data"], how)
    model, own = given["model"], given["effects"]
    models = [] if model is None else [model]
    with progress_bar("fitting", unit="fit") as progress:
        comparison = api.compare(given["data"], models, effects=own, progress=progress)
    with progress_bar("diagnosing", _STEPS) as progress:
        diagnosis = api.diagnose(**given, progress=progress)
    try:
        session = Session(diagnosis, registry_of(own))
    except ExploreError:
        session = None  # all is of one run: there are no effects to set and unset
    with progress_bar("fitting", unit="fit") as progress:
        page = explored_page(diagnosis, session, comparison, progress, pairs)
    page.save(output)
    found = {"comparison": comparison.to_dict(), "diagnosis": diagnosis.to_dict()}
    tell({"schema": 1, **found}, f"written: {output}", json_file)


@command(api.diagnose, "data", "model", "effects", "without")
@click.option("--port", type=click.IntRange(0, 65535), default=0,
              help="Port of the page; any that is free if not given.")  # fmt: skip
@click.option("--no-browser", is_flag=True, help="Only print the address.")
def explore(given: Given, how: How, port: int, no_browser: bool) -> None:
    """Open a page on the measurements in DATA, for this machine only; Ctrl-C ends it.

    The data is diagnosed once. Then set and unset effects: the page shows the model's parameters, its
    held-out error beside that of a true model, and what is left over a setting. Each effect and each pair
    is fitted while you look, any other choice when you make it.
    """
    from smallwheel_ros.explore import ExploreServer, Session

    given["data"] = read_table(given["data"], how)
    start = api.start_of(**given)
    with progress_bar("diagnosing", _STEPS) as progress:
        session = Session.of(*start, progress)
    for names in session.steps():
        session.view(names)
    with ExploreServer(session, port) as server:
        # A shell starts what runs in the background deaf to Ctrl-C.
        signal.signal(signal.SIGINT, signal.default_int_handler)
        try:
            click.echo(server.url)
            click.echo("Ctrl-C ends it.", err=True)
            threading.Thread(target=server.fit_beforehand, daemon=True).start()
            if not no_browser and _has_screen():
                threading.Thread(target=webbrowser.open, args=[server.url], daemon=True).start()
            server.serve_forever()
        except KeyboardInterrupt:
            click.echo("ended", err=True)


def _has_screen() -> bool:
    """Without a screen a browser in the terminal would be opened: not what is wanted."""
    graphic = any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY"))
    return graphic or not sys.platform.startswith("linux")


@click.command()
@click.argument("folder", type=PATH)
@click.option("-o", "--output", type=PATH, metavar="FILE",
              help="Write the errors as a table (CSV).")  # fmt: skip
@JSON
def benchmark(folder: Path, output: Path | None, json_file: str | None) -> None:
    """Hold laws of sinkage, pull and torque against the measured data sets in FOLDER.

    A data set is a folder with its licence (a file LICENSE) and its tables. One size of plate, level of
    slip or run after the other is left out; Bernstein-Goriatchkin, Bekker, Reece and Meirion-Griffith &
    Spenko are fitted to the rest, the last also with the contact integral and with the effects that a
    diagnosis of the rest names. Beside them are the mean of the rest, and the law of Wong and Reece where
    pull or torque was measured; these and the contact integral predict pull and torque, too. What is
    printed, of each table as soon as it is done, is the error on what was left out, and where our law
    loses.
    """
    from tqdm import tqdm

    from smallwheel_ros.benchmark.benchmark import TaskErrors
    from smallwheel_ros.benchmark.benchmark import benchmark as laws_on_data

    def done(errors: TaskErrors) -> None:
        if json_file != "-":
            with tqdm.external_write_mode():
                click.echo(f"{errors.text()}\n")

    check_targets([output, json_file])
    with progress_bar("benchmark", unit="fit") as progress:
        result = laws_on_data(folder, progress, done)
    written = [] if output is None else [result.save(output)]
    show(result, json_file, written, result.ending())
