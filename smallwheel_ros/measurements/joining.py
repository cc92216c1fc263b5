# SPDX-License-Identifier: Apache-2.0
"""Several tables of one lab as one."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from smallwheel_ros.measurements.shear import ShearTests
from smallwheel_ros.measurements.table import Measurements
from smallwheel_ros.physics.conditions import Array, Conditions


def joined(tables: Sequence[Measurements]) -> Measurements:
    """The rows of several tables of one lab (a file for each plate, one for the wheel), in order.

    A covariate that a table lacks is left out where that table has rolling wheels, and unknown in its
    other rows. Runs of one name in two files are different runs.
    """
    if len(tables) == 1:
        return tables[0]

    def column(of: Callable[[Measurements], Array | None]) -> Array:
        pairs = [(len(table), of(table)) for table in tables]
        return np.concatenate([np.full(n, np.nan) if c is None else c for n, c in pairs])

    def all_columns(of: Callable[[Measurements], Mapping[str, Array]]) -> dict[str, Array]:
        names = dict.fromkeys(name for table in tables for name in of(table))
        return {name: column(lambda t, name=name: of(t).get(name)) for name in names}  # type: ignore[misc]

    covariates, notes = all_columns(lambda t: t.conditions.covariates), _notes(tables)
    for name in list(covariates):
        lacking = [t for t in tables if name not in t.conditions.covariates]
        if any(t.conditions.rolling.any() for t in lacking):
            notes.append(f"column '{name}' is left out: {lacking[0].source} does not have it")
            del covariates[name]
    # The soil of a table that names none has the name that a fit gives it.
    named = any(t.conditions.soil is not None for t in tables)
    soils = [np.full(len(t), "soil") if t.conditions.soil is None else t.soil for t in tables]
    return replace(
        tables[0],
        **_joined_rows(tables),
        conditions=Conditions(
            column(lambda t: t.conditions.load),
            column(lambda t: t.conditions.diameter),
            column(lambda t: t.conditions.width),
            np.concatenate([t.conditions.contact for t in tables]),
            np.concatenate(soils) if named else None,
            covariates,
        ),
        channels=all_columns(lambda t: t.channels),
        wheel=np.concatenate([t.wheel for t in tables]),
        declared_std=all_columns(lambda t: t.declared_std),
        labels={},
        units={name: unit for table in tables for name, unit in table.units.items()},
        runs_given=all(t.runs_given for t in tables),
        wheels_given=all(t.wheels_given for t in tables),
        warnings=tuple(w for t in tables for w in t.warnings),
        notes=tuple(dict.fromkeys(notes)),
    )


def joined_shear(tables: Sequence[ShearTests]) -> ShearTests:
    """The rows of several tables of shear tests, in order."""
    if len(tables) == 1:
        return tables[0]
    names = ("normal_stress", "shear_stress", "displacement", "soil")
    found = {name: np.concatenate([getattr(t, name) for t in tables]) for name in names}
    return replace(tables[0], **_joined_rows(tables), **found, notes=tuple(_notes(tables)))


def _notes(tables: Sequence[Measurements | ShearTests]) -> list[str]:
    return [note for table in tables for note in table.notes]


def _joined_rows(tables: Sequence[Measurements | ShearTests]) -> dict[str, Any]:
    """Which rows they are: run, line, source; runs of one name in several tables told apart."""
    names = [name for table in tables for name in set(table.run.tolist())]
    run = [table.run for table in tables]
    if len(set(names)) < len(names):
        stems = [Path(table.source).stem for table in tables]
        stems = stems if len(set(stems)) == len(stems) else [str(i + 1) for i in range(len(stems))]
        run = [np.char.add(f"{stem} ", part) for stem, part in zip(stems, run, strict=True)]
    return {
        "run": np.concatenate(run),
        "line": np.concatenate([table.line for table in tables]),
        "source": ", ".join(table.source for table in tables),
        "sha256": hashlib.sha256(" ".join(t.sha256 for t in tables).encode()).hexdigest(),
    }
