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

Options = dict[str, Any]  # by name, the options of a command that its function does not take
Finish = Callable[[Any, Options], object]
Decorator = Callable[[Callable[..., Any]], Callable[..., Any]]

PATH = click.Path(path_type=Path)
HTML = click.option("--html", type=PATH, metavar="FILE", help="Write a self-contained report.")
PLOTS = click.option("--plots", type=PATH, metavar="DIR",
                     help="Write pictures (PNG) into this folder.")  # fmt: skip

__all__ = ["HTML", "JSON", "PATH", "PLOTS", "check_outputs", "finish", "output", "progress_bar"]


def output(text: str, name: str = "output", required: bool = False) -> Decorator:
    """Declare the option -o for a file to write.

    Parameters
    ----------
    text
        Help of the option.
    name
        Name under which the command gets it: `output`, or `model_file` for a model file, which may be the one
        that is read (`check_outputs`).
    required
        Whether it has to be given.

    Returns
    -------
    callable
        Decorator for the function of a click command.
    """
    return click.option(
        "-o", "--output", name, type=PATH, required=required, metavar="FILE", help=text
    )


def check_outputs(given: Mapping[str, Any], asked: Mapping[str, Any]) -> None:
    """Check before a long computation that outputs can be written and would not overwrite an input.

    Parameters
    ----------
    given
        Arguments of the function by name: paths among them, and texts ending in .py, are files that are read.
    asked
        Other options by name: output, html, plot, json_file, model_file and plots (a folder) are written.

    Raises
    ------
    OutputError
        If a file cannot be written, or is read as well; only model_file may be the model that is read.
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
        Function to report progress with: called with a step's name, with the number of steps done and their
        total, or with all three. With a name alone, one more step is done.
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
    """Write the files that the options ask for, then print the result.

    Parameters
    ----------
    result
        The result.
    asked
        Options by name: json_file (which may be None), and if given output and html (files whose suffix
        selects the kind), plots (a folder for pictures) and model_file (a file for the result's model).
    text
        Text to print in place of the result's own.
    written
        Files already written, to be listed with the others.
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
