# SPDX-License-Identifier: Apache-2.0
"""What the bench's commands have in common: options, the table, progress, and how a result is shown."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, cast

import click

from smallwheel_ros import api
from smallwheel_ros.common.errors import SmallwheelError

# `--help` of a command needs none of what the command computes with.
if TYPE_CHECKING:
    from smallwheel_ros.measurements.shear import ShearTests
    from smallwheel_ros.measurements.table import Measurements

_Command = TypeVar("_Command", bound=Callable[..., Any])
_PATH = click.Path(path_type=Path)
_STEPS = 5  # that a diagnosis tells of

DATA = click.argument("data", type=_PATH)
HTML = click.option("--html", type=_PATH, metavar="FILE", help="Write a self-contained report.")
OWN = click.option("--effects", "own", type=_PATH, metavar="FILE",
                   help="A Python file with effects of your own. It is run: name only files that "
                   "you trust.")  # fmt: skip
WITHOUT = click.option("--without", default="", metavar="ID,ID",
                       help="Effects that do not compete, by id; `unknown` for curves without a "
                       "name.")  # fmt: skip
MODEL = click.option("--model", "model_file", type=_PATH, metavar="FILE",
                     help="Start from this model file; its soil is refitted within its "
                     "covariance.")  # fmt: skip

CAN = click.option("--can", "levels", multiple=True, metavar="NAME=A..B|A,B,C",
                   help="What you can set, for the measurements to make next: slip=0..0.6, "
                   "load=20,40,60 (SI units, angles in rad). May be given several times.")  # fmt: skip


class BenchError(SmallwheelError):
    """Options that do not go together, or do not fit the table."""


def table_options(command: _Command) -> _Command:
    """Add the options that say how a table is read; the command gets them as `how`."""

    @functools.wraps(command)
    def wrapped(
        *args: Any,
        diameter: float | None,
        width: float | None,
        mapping: tuple[str, ...],
        sheet: str | None,
        contact: str | None,
        compliance: float | None,
        **options: Any,
    ) -> Any:
        how = {"diameter": diameter, "width": width, "map": _headers(mapping), "sheet": sheet}
        how |= {"contact": contact, "compliance": compliance}
        return command(*args, how=how, **options)

    for add in (
        click.option("--sheet", metavar="NAME", help="Sheet of a workbook, by name or number."),
        click.option("--map", "mapping", multiple=True, metavar="NAME=HEADER",
                     help="Which column is what, where its header does not say it: load=F3, or "
                     "with a unit 'load [kN]=F3'. May be given several times."),
        click.option("--compliance", type=float, metavar="M/N",
                     help="By how much the machine gives way [m/N]: times the load it is taken off "
                     "each measured sinkage; 1 mm under 500 N is 2e-6."),
        click.option("--contact", type=click.Choice(["rolling", "pressed", "plate"]),
                     help="What meets the soil in all rows, where the table does not say."),
        click.option("--width", type=float, help="Wheel width [m] for all rows."),
        click.option("--diameter", type=float, help="Wheel diameter [m] for all rows."),
    ):  # fmt: skip
        wrapped = add(wrapped)
    return cast(_Command, wrapped)


def _headers(mapping: tuple[str, ...]) -> dict[str, str]:
    """Header by our name, of each --map NAME=HEADER. Raises BenchError."""
    found: dict[str, str] = {}
    for text in mapping:
        name, equals, header = (part.strip() for part in text.partition("="))
        if not (name and equals and header):
            raise BenchError(f"--map {text}: expected NAME=HEADER, as in --map load=Fz")
        if name in found:
            raise BenchError(f"--map {text}: '{name}' is given twice")
        found[name] = header
    return found


def read_table(data: Path, how: Mapping[str, Any]) -> Measurements:
    """The table; what was made of it, and its warnings, on standard error. how: as `table_options`."""
    measurements = api.read(data, **how)
    _say(measurements.understood, measurements.warnings)
    return measurements


def read_test(data: Path, how: Mapping[str, Any]) -> Measurements | ShearTests:
    """A table of any test of a lab, as `read_table`."""
    test = api.read_test(data, **how)
    _say(test.understood, getattr(test, "warnings", ()))
    return test


def _say(understood: Sequence[str], warnings: Sequence[str]) -> None:
    for line in understood:
        click.echo(f"understood: {line}", err=True)
    for warning in warnings:
        click.echo(f"warning: {warning}", err=True)


@contextmanager
def progress_of_fits() -> Iterator[Callable[[int, int], None]]:
    """A bar of fits that are done, on a terminal."""
    from tqdm import tqdm

    with tqdm(desc="fitting", unit="fit", disable=None, leave=False) as bar:

        def progress(done: int, needed: int) -> None:
            bar.total = needed
            bar.update(done - bar.n)

        yield progress


@contextmanager
def progress_of_steps(what: str) -> Iterator[Callable[[str], None]]:
    """A bar of the steps of a diagnosis, on a terminal."""
    from tqdm import tqdm

    with tqdm(total=_STEPS, desc=what, disable=None, leave=False) as bar:

        def progress(step: str) -> None:
            bar.set_description(step)
            bar.update()

        yield progress


def names_of(text: str) -> list[str]:
    """The names of a list with commas."""
    return [name.strip() for name in text.split(",") if name.strip()]


def levels_of(given: tuple[str, ...], measurements: Measurements) -> dict[str, list[float]]:
    """Levels by setting of --can NAME=A..B or NAME=A,B,C. Raises BenchError where one is neither."""
    from smallwheel_ros.common.errors import nearest

    found = {}
    known = ("load", "diameter", "width", *measurements.conditions.covariates)
    for text in given:
        name, _, levels = text.partition("=")
        name = name.strip()
        if name not in known:
            raise BenchError(f"--can {text}: the table has no setting '{name}': "
                             f"{nearest(name, list(known))}")  # fmt: skip
        low, dots, high = levels.partition("..")
        try:
            if dots:
                first, last = float(low), float(high)
                values = [first, 0.5 * (first + last), last]
            else:
                values = [float(v) for v in levels.split(",")]
        except ValueError:
            values = [float("nan")]
        if not all(math.isfinite(v) for v in values) or (dots and values[0] > values[-1]):
            raise BenchError(
                f"--can {text}: found '{levels}', expected numbers as in {name}=0..0.6 or "
                f"{name}=20,40,60 (SI units)"
            )
        found[name] = values
    return found
