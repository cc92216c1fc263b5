# SPDX-License-Identifier: Apache-2.0
"""What the bench's commands have in common: tables, files, progress, and how a result is shown."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from smallwheel_ros import api
from smallwheel_ros.arguments import RangeError, typed
from smallwheel_ros.commands.from_signature import PATH, BenchError, understand
from smallwheel_ros.common.console import show
from smallwheel_ros.common.errors import nearest
from smallwheel_ros.common.files import check_folder_target, check_targets
from smallwheel_ros.measurements.columns import unit_of

# `--help` of a command needs none of what the command computes with.
if TYPE_CHECKING:
    from smallwheel_ros.common.results import Result
    from smallwheel_ros.measurements.table import Measurements, ShearTests

_Test = TypeVar("_Test", bound="Measurements | ShearTests")
HTML = click.option("--html", type=PATH, metavar="FILE", help="Write a self-contained report.")
PLOTS = click.option("--plots", type=PATH, metavar="DIR",
                     help="Write pictures (PNG) into this folder.")  # fmt: skip


def read_table(data: Path, how: Mapping[str, Any]) -> Measurements:
    """The table; what was made of it, and its warnings, on standard error. how: as for `api.read`."""
    return _said(api.read(data, **how))


def read_test(data: Path, how: Mapping[str, Any]) -> Measurements | ShearTests:
    """A table of any test of a lab, as `read_table`."""
    return _said(api.read_test(data, **how))


def _said(test: _Test) -> _Test:
    for line in test.understood:
        understand(line)
    for warning in getattr(test, "warnings", ()):
        click.echo(f"warning: {warning}", err=True)
    return test


def check_outputs(
    given: Mapping[str, Any],
    files: Sequence[str | Path | None],
    model_file: Path | None = None,
    plots: Path | None = None,
) -> None:
    """Refuse outputs that cannot be written, or would destroy what is read, before a long computation.

    given: arguments, of which files are read. model_file: to be written; it may replace the one that
    is read. plots: a folder. Raises OutputError.
    """
    inputs: list[str | Path] = []
    for name, value in given.items():
        several = value if isinstance(value, (list, tuple)) else [value]
        inputs += [
            one
            for one in several
            if name != "model" and (isinstance(one, Path) or str(one).endswith(".py"))
        ]
    check_targets([*files, model_file], inputs)
    check_targets(files, [given.get("model")])
    check_folder_target(plots)


@contextmanager
def progress_bar(
    what: str, total: int | None = None, unit: str = "it"
) -> Iterator[Callable[..., None]]:
    """A bar on a terminal, to be told a step in words, how many are done and of how many, or all three."""
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


def levels_of(given: Sequence[str], measurements: Measurements) -> dict[str, list[float]]:
    """Levels by setting of --can NAME=A..B or NAME=A,B,C. Raises BenchError where one is neither."""
    found = {}
    known = ("load", "diameter", "width", *measurements.conditions.covariates)
    for text in given:
        name, _, levels = text.partition("=")
        name = name.strip()
        if name not in known:
            raise BenchError(f"--can {text}: the table has no setting '{name}': "
                             f"{nearest(name, list(known))}")  # fmt: skip
        unit = measurements.units.get(name, unit_of(name)) or None
        try:
            read = typed(name, levels, unit)
        except RangeError as error:
            raise BenchError(
                f"--can {text}: found '{levels}', expected numbers as in {name}=0..0.6 or "
                f"{name}=20,40,60 (SI units, or with a unit behind): {error}"
            ) from None
        understand(read.said)
        found[name] = [float(v) for v in read.values]
    return found


def finish(
    result: Result,
    json_file: str | None,
    written: Sequence[Path],
    html: Path | None,
    plots: Path | None,
    text: str | None = None,
) -> None:
    """Write report and pictures where they are asked for, then show the result.

    written: files that are there already. text: what is printed; the result's own if not given.
    """
    written = list(written)
    if html is not None:
        written.append(result.save(html))
    if plots is not None:
        written += result.write_pictures(plots)
    show(result, json_file, written, text)
