# SPDX-License-Identifier: Apache-2.0
"""Outputs of the commands of the bench: checks before the work, progress, and files."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from smallwheel_ros.common.console import JSON, show
from smallwheel_ros.common.files import check_folder_target, check_targets

# `--help` of a command needs none of what the command computes with.
if TYPE_CHECKING:
    from smallwheel_ros.common.result import Result

Options = dict[str, Any]  # of a command beside those of its function, by name
Finish = Callable[[Any, Options], object]
Decorator = Callable[[Callable[..., Any]], Callable[..., Any]]

PATH = click.Path(path_type=Path)
HTML = click.option("--html", type=PATH, metavar="FILE", help="Write a self-contained report.")
PLOTS = click.option("--plots", type=PATH, metavar="DIR",
                     help="Write pictures (PNG) into this folder.")  # fmt: skip

__all__ = ["HTML", "JSON", "PATH", "PLOTS", "check_outputs", "finish", "output", "progress_bar"]


def output(text: str, name: str = "output", required: bool = False) -> Decorator:
    """Declare the option -o.

    Parameters
    ----------
    text
        Help of the option.
    name
        Name of the parameter; `model_file` may be the model file that is read.
    required
        Whether it has to be given.
    """
    return click.option(
        "-o", "--output", name, type=PATH, required=required, metavar="FILE", help=text
    )


def check_outputs(given: Mapping[str, Any], asked: Mapping[str, Any]) -> None:
    """Refuse outputs that cannot be written, or would destroy what is read, before a long computation.

    Parameters
    ----------
    given
        Arguments, among them the files that are read.
    asked
        Options, among them the files that are written.

    Raises
    ------
    OutputError
        If a target cannot be written, or is read as well.
    """
    inputs: list[str | Path] = []
    for name, value in given.items():
        several = value if isinstance(value, (list, tuple)) else [value]
        inputs += [
            one
            for one in several
            if name != "model" and (isinstance(one, Path) or str(one).endswith(".py"))
        ]
    files = [asked.get(name) for name in ("output", "html", "plot", "json_file")]
    check_targets([*files, asked.get("model_file")], inputs)
    check_targets(files, [given.get("model")])
    check_folder_target(asked.get("plots"))


@contextmanager
def progress_bar(
    what: str, total: int | None = None, unit: str = "it"
) -> Iterator[Callable[..., None]]:
    """Show a progress bar, if standard error is a terminal.

    Parameters
    ----------
    what
        Words before the bar.
    total
        Total number of steps; None if not known yet.
    unit
        Name of a step.

    Yields
    ------
    callable
        Called with a step's name, with the number done and the total, or with all three.
    """
    from tqdm import tqdm

    with tqdm(total=total, desc=what, unit=unit, disable=None, leave=False) as bar:

        def tell(*told: Any) -> None:
            done = bar.n + 1
            if isinstance(told[0], str):
                bar.set_description(told[0])
            if len(told) > 1:
                done, bar.total = told[-2], told[-1] or None
            bar.update(done - bar.n)

        yield tell


def finish(
    result: Result, asked: Options, text: str | None = None, written: Sequence[Path] = ()
) -> None:
    """Write the files that the options ask for, then show the result.

    Parameters
    ----------
    result
        The result.
    asked
        Options html, plots, output, json_file; model_file is the file for the result's model.
    text
        What is printed; the result's own text if not given.
    written
        Files that are written already.
    """
    written = list(written)
    if (path := asked.get("model_file")) is not None:
        written.append(result.model.save(path))  # type: ignore[attr-defined]  # of a fit and its like
    for name in ("output", "html"):
        if (path := asked.get(name)) is not None:
            written.append(result.save(path))
    if (folder := asked.get("plots")) is not None:
        written += result.write_pictures(folder)
    show(result, asked["json_file"], written, text)
