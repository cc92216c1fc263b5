"""What the bench's commands read before they begin: measurements, a model, effects of one's own."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click

from smallwheel_ros.diagnosis.apply import base_of
from smallwheel_ros.diagnosis.workbench import Base
from smallwheel_ros.effects.registry import Registry, default_registry, load_effects
from smallwheel_ros.measurements.table import Measurements, read_measurements
from smallwheel_ros.model_file import read_model

_Command = TypeVar("_Command", bound=Callable[..., Any])


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
