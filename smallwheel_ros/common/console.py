# SPDX-License-Identifier: Apache-2.0
"""Output of a command's result: its text, and its JSON if requested."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from smallwheel_ros.common.result import Result

JSON = click.option("--json", "json_file", metavar="FILE",
                    help="Write the result as JSON, - for standard output.")  # fmt: skip


def show(
    result: Result, json_file: str | None, written: Sequence[Path] = (), text: str | None = None
) -> None:
    """Write a result's JSON; print its text and the files written, unless the JSON is printed.

    Parameters
    ----------
    result
        The result of a command.
    json_file
        File for the JSON; - is standard output, None means none.
    written
        Files already written, to be listed below the text.
    text
        Text to print in place of the result's own, such as the rest of it if part was printed before.

    Raises
    ------
    OutputError
        If the JSON cannot be written.
    """
    tell(result.to_dict(), str(result) if text is None else text, json_file, written)


def tell(
    document: Mapping[str, Any], text: str, json_file: str | None, written: Sequence[Path] = ()
) -> None:
    """Write a document as JSON; print a text and the files written, unless the JSON is printed.

    Parameters
    ----------
    document
        Plain values, or arrays of them.
    text
        Text for people.
    json_file
        File for the JSON; - is standard output, None means none.
    written
        Files already written, to be listed below the text.

    Raises
    ------
    OutputError
        If the JSON cannot be written.
    """
    from smallwheel_ros.common.tables import write_json

    if json_file is not None:
        write_json(json_file, document)
    if json_file != "-":
        click.echo("\n".join([text, *(f"written: {path}" for path in written)]))
