# SPDX-License-Identifier: Apache-2.0
"""Several tables of one lab as one: a file for each plate, one for the wheel."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.measurements.shear import ShearTests
from smallwheel_ros.measurements.table import Measurements
from smallwheel_ros.physics.conditions import Array, Conditions

Texts = NDArray[np.str_]


def joined(tables: Sequence[Measurements]) -> Measurements:
    """The rows of several tables, in order.

    A covariate that a table lacks is left out where that table has rolling wheels, and unknown in its
    other rows. Runs of one name in two files are different runs.
    """
    if len(tables) == 1:
        return tables[0]
    names = dict.fromkeys(name for table in tables for name in table.conditions.covariates)
    covariates, notes = {}, [note for table in tables for note in table.notes]
    for name in names:
        lacking = [t for t in tables if name not in t.conditions.covariates]
        if any(t.conditions.rolling.any() for t in lacking):
            notes.append(f"column '{name}' is left out: {lacking[0].source} does not have it")
            continue
        covariates[name] = _columns(
            [_or_blank(t, t.conditions.covariates.get(name)) for t in tables]
        )
    conditions = Conditions(
        _columns([t.conditions.load for t in tables]),
        _columns([t.conditions.diameter for t in tables]),
        _columns([t.conditions.width for t in tables]),
        _texts([t.conditions.contact for t in tables]),
        _soils(tables),
        covariates,
    )
    channels = dict.fromkeys(name for table in tables for name in table.channels)
    declared = dict.fromkeys(name for table in tables for name in table.declared_std)
    return replace(
        tables[0],
        conditions=conditions,
        channels={n: _columns([_or_blank(t, t.channels.get(n)) for t in tables]) for n in channels},
        run=_runs([t.run for t in tables], [t.source for t in tables]),
        wheel=_texts([t.wheel for t in tables]),
        line=np.concatenate([t.line for t in tables]),
        declared_std={
            n: _columns([_or_blank(t, t.declared_std.get(n)) for t in tables]) for n in declared
        },
        labels={},
        units={name: unit for table in tables for name, unit in table.units.items()},
        runs_given=all(t.runs_given for t in tables),
        wheels_given=all(t.wheels_given for t in tables),
        warnings=tuple(w for t in tables for w in t.warnings),
        notes=tuple(dict.fromkeys(notes)),
        source=", ".join(t.source for t in tables),
        sha256=_digest([t.sha256 for t in tables]),
    )


def joined_shear(tables: Sequence[ShearTests]) -> ShearTests:
    """The rows of several tables of shear tests, in order."""
    if len(tables) == 1:
        return tables[0]
    return replace(
        tables[0],
        normal_stress=_columns([t.normal_stress for t in tables]),
        shear_stress=_columns([t.shear_stress for t in tables]),
        displacement=_columns([t.displacement for t in tables]),
        run=_runs([t.run for t in tables], [t.source for t in tables]),
        soil=_texts([t.soil for t in tables]),
        line=np.concatenate([t.line for t in tables]),
        notes=tuple(note for t in tables for note in t.notes),
        source=", ".join(t.source for t in tables),
        sha256=_digest([t.sha256 for t in tables]),
    )


def _columns(parts: Sequence[Array]) -> Array:
    return np.asarray(np.concatenate(parts), dtype=float)


def _texts(parts: Sequence[Texts]) -> Texts:
    return np.asarray(np.concatenate(parts), dtype=np.str_)


def _or_blank(table: Measurements, column: Array | None) -> Array:
    return np.full(len(table), np.nan) if column is None else column


def _soils(tables: Sequence[Measurements]) -> Texts | None:
    named = [table.conditions.soil for table in tables]
    if all(names is None for names in named):
        return None
    # The soil of a table that names none has the name that a fit gives it.
    pairs = zip(tables, named, strict=True)
    return _texts([np.full(len(t), "soil") if names is None else names for t, names in pairs])


def _runs(parts: Sequence[Texts], sources: Sequence[str]) -> Texts:
    sets = [set(part.tolist()) for part in parts]
    shared = set[str]().union(
        *(a & b for i, a in enumerate(sets) for b in sets[:i])
    )  # fmt: skip
    if not shared:
        return _texts(parts)
    stems = [Path(source).stem for source in sources]
    stems = stems if len(set(stems)) == len(stems) else [str(i + 1) for i in range(len(stems))]
    return _texts([np.char.add(f"{stem} ", part) for stem, part in zip(stems, parts, strict=True)])


def _digest(digests: Sequence[str]) -> str:
    return hashlib.sha256(" ".join(digests).encode()).hexdigest()
