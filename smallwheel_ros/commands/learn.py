# SPDX-License-Identifier: Apache-2.0
"""`smallwheel learn`: options, and the function of that name."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click
from tqdm import tqdm

from smallwheel_ros import api
from smallwheel_ros.commands.inputs import (
    CAN,
    DATA,
    HTML,
    MODEL,
    OWN,
    BenchError,
    levels_of,
    names_of,
    read_table,
    table_options,
)
from smallwheel_ros.common.console import JSON, show
from smallwheel_ros.common.files import check_folder_target, check_targets
from smallwheel_ros.learn.learning import Learnt

_PATH = click.Path(path_type=Path)


@click.command("learn", short_help="Learn a law that no known effect explains, into a file.")
@DATA
@MODEL
@OWN
@click.option("--without", "out", default="", metavar="ID,ID",
              help="Effects that are taken out of the model, and that the law is not held "
              "against.")  # fmt: skip
@click.option("-o", "--output", type=_PATH, metavar="FILE",
              help="Effect file (*.py) to write, for the verdict `law` only.")  # fmt: skip
@click.option("--name", metavar="ID", help="Id of the law; made of what it follows if not given.")
@click.option("--most", type=click.IntRange(1, 5), default=1, show_default=True,
              help="Laws to learn, one after the other.")  # fmt: skip
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True,
              help="Of permutations and folds.")  # fmt: skip
@CAN
@JSON
@click.option("--plots", type=_PATH, metavar="DIR",
              help="Write the picture (PNG) into this folder.")  # fmt: skip
@HTML
@table_options
def learn_command(
    data: Path,
    model_file: Path | None,
    own: Path | None,
    out: str,
    output: Path | None,
    name: str | None,
    most: int,
    seed: int,
    levels: tuple[str, ...],
    json_file: str | None,
    plots: Path | None,
    html: Path | None,
    how: dict[str, Any],
) -> None:
    """Learn which law a model of the measurements in DATA lacks, where no known effect explains it.

    The program searches some 40,000 formulas inside the model. It drafts a law only where chance
    would not gain as much, and where the law also predicts settings that the search never saw.
    Nothing could be learnt is a normal answer.
    """
    if output is not None and output.suffix != ".py":
        raise BenchError(f"-o {output}: expected a Python file, *.py")
    check_targets([json_file, html, output], [data, own, model_file])
    check_folder_target(plots)
    measurements = read_table(data, how)
    can = levels_of(levels, measurements)
    with tqdm(desc="learning", disable=None, leave=False) as bar:

        def progress(step: str, done: int, total: int) -> None:
            bar.set_description(step)
            bar.total = total or None
            bar.update(done - bar.n)

        result = api.learn(
            measurements,
            model_file,
            effects=own,
            without=names_of(out),
            name=name,
            most=most,
            can=can,
            seed=seed,
            progress=progress,
        )
    show(result, json_file, _write(result, output, html, plots))


def _write(
    result: Learnt, output: Path | None, html: Path | None, plots: Path | None
) -> list[Path]:
    written: list[Path] = []
    if output is not None and result.source is not None:
        result.document["file"] = str(output)
        written.append(result.save(output))
    elif output is not None:
        click.echo(f"no law was drafted: {output} was not written", err=True)
    if html is not None:
        written.append(result.save(html))
    if plots is not None:
        from smallwheel_ros.pictures.fit import learnt_figures
        from smallwheel_ros.pictures.house import write_figures

        written += write_figures(learnt_figures(result), plots)
    return written
