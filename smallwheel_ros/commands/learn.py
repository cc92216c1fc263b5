"""`smallwheel learn`: a thin shell over `smallwheel_ros.learn`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click
from tqdm import tqdm

from smallwheel_ros import api
from smallwheel_ros.commands.inputs import (
    DATA,
    MODEL,
    OWN,
    levels_of,
    names_of,
    read_table,
    table_options,
)
from smallwheel_ros.learn import Learnt, learn, learnt_text
from smallwheel_ros.output import check_folder_target, check_targets, write_bytes
from smallwheel_ros.tables import write_json


@click.command("learn", short_help="Learn a law that no known effect explains, into a file.")
@DATA
@MODEL
@OWN
@table_options
@click.option("--without", "out", default="", metavar="ID,ID",
              help="Effects that are taken out of the model, and that the law is not held "
              "against.")  # fmt: skip
@click.option("-o", "--output", type=click.Path(path_type=Path), metavar="FILE",
              help="Effect file (Python) to write, for the verdict `law` only.")  # fmt: skip
@click.option("--name", metavar="ID", help="Id of the law; made of what it follows if not given.")
@click.option("--most", type=click.IntRange(1, 5), default=1, show_default=True,
              help="Laws to learn, one after the other.")  # fmt: skip
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True,
              help="Of permutations and folds.")  # fmt: skip
@click.option("--can", "levels", multiple=True, metavar="NAME=A..B|A,B,C",
              help="What you can set, for the measurements to make next: slip=0..0.6 (SI units, "
              "angles in rad). May be given several times.")  # fmt: skip
@click.option("--json", "json_file", metavar="FILE",
              help="Write the result as JSON, - for standard output.")  # fmt: skip
@click.option("--plots", type=click.Path(path_type=Path), metavar="DIR",
              help="Write the picture (PNG) into this folder.")  # fmt: skip
@click.option("--html", type=click.Path(path_type=Path), help="Write a self-contained page.")
def learn_command(
    data: Path,
    model_file: Path | None,
    own: Path | None,
    how: Mapping[str, Any],
    out: str,
    output: Path | None,
    name: str | None,
    most: int,
    seed: int,
    levels: tuple[str, ...],
    json_file: str | None,
    plots: Path | None,
    html: Path | None,
) -> None:
    """Learn which law a model of the measurements in DATA lacks, where no known effect explains it.

    The program searches some 20,000 formulas inside the model. It drafts a law only where chance
    would not gain as much, and where the law also predicts settings that the search never saw.
    Nothing could be learnt is a normal answer.
    """
    check_targets([json_file, html, output], [data, own, model_file])
    check_folder_target(plots)
    table = read_table(data, how)
    can = levels_of(levels, table)
    measurements, base, registry, withheld = api.start_of(table, model_file, own, names_of(out))
    with tqdm(desc="learning", disable=None, leave=False) as bar:

        def progress(step: str, done: int, total: int) -> None:
            bar.set_description(step)
            bar.total = total or None
            bar.update(done - bar.n)

        result = learn(
            measurements,
            base,
            registry=registry,
            without=withheld,
            name=name,
            most=most,
            seed=seed,
            limits=can,
            progress=progress,
        )
    written = _write(result, output, html, plots)
    if json_file is not None:
        write_json(json_file, result.document)
    if json_file != "-":
        click.echo(learnt_text(result.document))
        if written:
            click.echo(f"written: {', '.join(str(path) for path in written)}")


def _write(
    result: Learnt, output: Path | None, html: Path | None, plots: Path | None
) -> list[Path]:
    written: list[Path] = []
    if output is not None and result.source is not None:
        write_bytes(output, result.source.encode())
        result.document["file"] = str(output)
        written.append(output)
    elif output is not None:
        click.echo(f"no law was drafted: {output} was not written", err=True)
    if html is not None or plots is not None:
        from smallwheel_ros.report.learn_report import learn_page, write_picture
        from smallwheel_ros.report.page import write_page

        if plots is not None:
            written += write_picture(result, plots)
        if html is not None:
            write_page(html, learn_page(result))
            written.append(html)
    return written
