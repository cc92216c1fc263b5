# SPDX-License-Identifier: Apache-2.0
"""The commands on a table of measurements: the functions of those names, and what they write."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import click

from smallwheel_ros.api.add import add as add_effect
from smallwheel_ros.api.compare import compare as compare_models
from smallwheel_ros.api.diagnose import diagnose as diagnose_data
from smallwheel_ros.api.fit import fit as fit_tests
from smallwheel_ros.api.learn import learn as learn_law
from smallwheel_ros.commands.command import (
    CommandError,
    command,
    options_of,
    taken,
    with_table,
    with_what_was_typed,
)
from smallwheel_ros.commands.outputs import (
    HTML,
    JSON,
    PLOTS,
    Options,
    check_outputs,
    finish,
    output,
    progress_bar,
)
from smallwheel_ros.commands.typed import RememberedCommand
from smallwheel_ros.common.console import tell

if TYPE_CHECKING:
    from smallwheel_ros.diagnosis.pipeline import Diagnosis

_FITTING: Options = {"what": "fitting", "unit": "fit"}
_DIAGNOSING: Options = {"what": "diagnosing", "total": 5}  # steps of a diagnosis

fit = command(
    fit_tests,
    output("Model file to write.", "model_file"),
    JSON,
    words="-o writes a model file for the other commands and the node.",
)


def _tables_shown(asked: Options) -> Options:
    """The argument `done` of `compare`: a function that prints each table of a folder once it is judged."""
    from tqdm import tqdm

    from smallwheel_ros.views.law_table import table_text

    def done(table: Any) -> None:
        if asked["json_file"] != "-":
            with tqdm.external_write_mode():
                click.echo(f"{table_text(table)}\n")

    return {"done": done}


def _compared(result: Any, asked: Options) -> None:
    from smallwheel_ros.compare.data_sets import Benchmark
    from smallwheel_ros.views.law_table import ending

    finish(result, asked, ending(result) if isinstance(result, Benchmark) else None)


compare = command(
    compare_models,
    output("Write the errors as a table (CSV)."),
    JSON,
    PLOTS,
    HTML,
    words="A model file is compared as well.\n\n"
    "Of a folder each table is printed as soon as it is done. --law enters a law of your own: a class of "
    "about ten lines (docs/benchmark.md).",
    heard=_tables_shown,
    finish=_compared,
    bar=_FITTING,
)


def _check_apply(asked: Options) -> None:
    if asked["apply"] != (asked["model_file"] is not None):
        raise CommandError("--apply and -o FILE go together: one without the other does nothing")


def _going_on(result: Diagnosis, applied: bool = False) -> Diagnosis:
    """The diagnosis with the commands to go on with. applied: whether a model file has the named effects."""
    following = {"learn": with_what_was_typed(learn_law, "-o", "law.py")}
    if not applied:
        following["apply"] = with_what_was_typed(diagnose_data, "--apply", "-o", "MODEL.yaml")
    return replace(result, following=following)


def _diagnosed(result: Diagnosis, asked: Options) -> None:
    result = _going_on(result, applied=asked["model_file"] is not None)
    if asked["model_file"] is not None and len(result.steps) < 2:
        gone = "" if result.steps else f"; {asked['model_file']} was not written"
        said = f"nothing was named, so nothing was added{gone}"
        if result.steps and (count := len(result.model.rivals)):
            said += (
                f"; the file has the {count} models that this data cannot tell apart, and `predict` gives "
                "the number of their mean, with what they differ by in its deviation"
            )
        click.echo(said, err=True)
        asked["model_file"] = asked["model_file"] if result.steps else None
    text = None
    if asked["full"]:
        from smallwheel_ros.views.diagnosis import page

        text = page(result, pictures=False).text()
    finish(result, asked, text)


diagnose = command(
    diagnose_data,
    JSON,
    HTML,
    PLOTS,
    click.option("--full", is_flag=True, help="Print everything on the page, not only the answer."),
    click.option("--apply", is_flag=True, help="Add what the verdict names; needs -o."),
    output("With --apply: model file to write.", "model_file"),
    words="With --apply the named effects are added to the model, step by step; -o writes it.",
    begin=_check_apply,
    finish=_diagnosed,
    bar=_DIAGNOSING,
)


def _check_law_file(asked: Options) -> None:
    if asked["output"] is not None and asked["output"].suffix != ".py":
        raise CommandError(f"-o {asked['output']}: expected a Python file, *.py")


def _learnt(result: Any, asked: Options) -> None:
    if asked["output"] is not None and result.source is None:
        click.echo(f"no law was drafted: {asked['output']} was not written", err=True)
        asked["output"] = None
    elif asked["output"] is not None:
        result.document["file"] = str(asked["output"])
    finish(result, asked)


learn = command(
    learn_law,
    output("Effect file (*.py) to write, for the verdict `law` only."),
    JSON,
    PLOTS,
    HTML,
    words="-o writes the law as a file for --effects of the other commands.",
    begin=_check_law_file,
    finish=_learnt,
    bar={"what": "learning"},
)

add = command(
    add_effect,
    output("Model file to write.", "model_file", required=True),
    JSON,
    words="-o may name the model file itself.",
)


@click.command(cls=RememberedCommand)
@options_of(diagnose_data, "data", "model", "effects")
@output("HTML file to write.", required=True)
@JSON
def report(**options: Any) -> None:
    """Write one self-contained HTML page on the measurements in DATA.

    Effects to set and unset, the data, models side by side, where the model fails, which effect is
    missing, the held-out error step by step, what this data cannot tell, what to measure next.
    """
    from smallwheel_ros.views.effects import models_block
    from smallwheel_ros.views.report import page

    given = taken(diagnose_data, options)
    check_outputs(given, options)
    given = with_table(diagnose_data, given)
    own = {name: value for name, value in given.items() if name == "effects"}
    models = [given["model"]] if "model" in given else []
    with progress_bar(**_FITTING) as progress:
        comparison = compare_models(given["data"], models, **own, progress=progress)
    with progress_bar(**_DIAGNOSING) as progress:
        diagnosis = _going_on(diagnose_data(**given, progress=progress))
    with progress_bar(**_FITTING) as progress:
        choices = models_block(diagnosis, every=True, progress=progress)
    page(diagnosis, comparison, choices).write(options["output"])
    found = {"comparison": comparison.to_dict(), "diagnosis": diagnosis.to_dict()}
    tell({"schema": 1, **found}, f"written: {options['output']}", options["json_file"])
