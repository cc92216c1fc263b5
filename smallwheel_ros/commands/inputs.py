"""What the bench's commands read before they begin: measurements, a model, effects of one's own."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click

from smallwheel_ros.diagnosis.settings import SETTINGS
from smallwheel_ros.effects.registry import Registry, default_registry, load_effects
from smallwheel_ros.errors import SmallwheelError
from smallwheel_ros.fitting import Base
from smallwheel_ros.fitting.files import base_of
from smallwheel_ros.measurements.columns import TEXTS
from smallwheel_ros.measurements.table import Measurements, read_measurements
from smallwheel_ros.model_file import read_model
from smallwheel_ros.physics.soil import nearest

_Command = TypeVar("_Command", bound=Callable[..., Any])


class ColumnError(SmallwheelError):
    """An effect of a column that the table does not have as a free one."""


def data_options(command: _Command) -> _Command:
    """Add the argument DATA and the options --model, --effects, --diameter and --width."""
    path = click.Path(path_type=Path)
    for add in (
        click.option("--width", type=float, help="Wheel width [m] for all rows."),
        click.option("--diameter", type=float, help="Wheel diameter [m] for all rows."),
        click.option("--effects", "own", type=path, metavar="FILE",
                     help="A Python file with effects of your own. It is run: name only files that "
                     "you trust."),
        click.option("--model", "model_file", type=path, metavar="FILE",
                     help="Start from this model file; its soil is refitted within its "
                     "covariance."),
        click.argument("data", type=path),
    ):  # fmt: skip
        command = add(command)
    return command


def read_inputs(
    data: Path,
    model_file: Path | None,
    own: Path | None,
    diameter: float | None,
    width: float | None,
) -> tuple[Measurements, Base, Registry]:
    """The table, with its warnings on standard error; what a diagnosis starts from; all effects."""
    user = None if own is None else load_effects(own)
    registry = default_registry()
    if user is not None:
        registry = registry.with_families(user, str(own))
    measurements = read_measurements(data, diameter=diameter, width=width)
    warn(measurements)
    base = Base() if model_file is None else base_of(read_model(model_file, user), measurements)
    return measurements, base, registry


def warn(measurements: Measurements) -> None:
    """Say the table's warnings on standard error."""
    for warning in measurements.warnings:
        click.echo(f"warning: {warning}", err=True)


def check_column(effect: str, measurements: Measurements, registry: Registry) -> None:
    """Say why the NAME of `covariate:NAME` is no free column of the table, and what to do.

    Any other effect passes. Raises ColumnError.
    """
    kind, _, name = effect.partition(":")
    conditions = measurements.conditions
    free = [column for column in conditions.covariates if column not in SETTINGS]
    if kind != "covariate" or not name or name in free:
        return
    if name in ("load", "diameter", "width", *conditions.covariates):
        follow = [
            family
            for family, forms in registry.families.items()
            if any(name in form.drivers for form in forms)
        ]
        known = f" ({', '.join(follow)})" if follow else ""
        why = (
            f"'{name}' is a known setting, and those have effects of their own{known}: add one of "
            f"them; `smallwheel fit --effects {effect}` fits a free law of it all the same"
        )
    elif name in measurements.channels:
        why = f"'{name}' is what was measured, no setting"
    elif name in measurements.labels or name in TEXTS:
        why = f"'{name}' is text, expected a column of numbers"
    elif free:
        why = f"the table has no column '{name}' of numbers: {nearest(name, free)}"
    else:
        why = f"the table has no column '{name}' of numbers, nor any but the known settings"
    raise ColumnError(f"effect '{effect}' cannot be added: {why}")


def without_ids(text: str, registry: Registry) -> tuple[str, ...]:
    """The ids of --without. Raises EffectError for one that does not exist."""
    names = tuple(name.strip() for name in text.split(",") if name.strip())
    for name in names:
        if name != "unknown":
            registry.family(name)
    return names


def limits(given: tuple[str, ...], measurements: Measurements) -> dict[str, list[float]]:
    """Levels by setting of --can NAME=A..B or NAME=A,B,C. Raises ColumnError where one is neither."""
    found = {}
    known = ("load", "diameter", "width", *measurements.conditions.covariates)
    for text in given:
        name, _, levels = text.partition("=")
        name = name.strip()
        if name not in known:
            raise ColumnError(f"--can {text}: the table has no setting '{name}': "
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
            raise ColumnError(
                f"--can {text}: found '{levels}', expected numbers as in {name}=0..0.6 or "
                f"{name}=20,40,60 (SI units)"
            )
        found[name] = values
    return found
