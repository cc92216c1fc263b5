# SPDX-License-Identifier: Apache-2.0
"""How a command shows a result: its text, and its JSON if requested."""

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
    """Write the result's JSON; print its text and what was written, unless JSON is printed.

    Parameters
    ----------
    result
        The result of a command.
    json_file
        File for the JSON; - is standard output, None means none.
    written
        Files already written, to be listed.
    text
        Text still to be printed, if part of it was printed before; the result's own text if not given.
    """
    tell(result.to_dict(), str(result) if text is None else text, json_file, written)


def tell(
    document: Mapping[str, Any], text: str, json_file: str | None, written: Sequence[Path] = ()
) -> None:
    """Write a document as JSON; print the text and what was written, unless JSON is printed.

    Parameters
    ----------
    document
        Plain values.
    text
        Text for people.
    json_file, written
        See `show`.
    """
    from smallwheel_ros.common.tables import write_json

    if json_file is not None:
        write_json(json_file, document)
    if json_file != "-":
        click.echo("\n".join([text, *(f"written: {path}" for path in written)]))
