# SPDX-License-Identifier: Apache-2.0
"""Drives of the worlds of `rates` as the stages of the pipeline get them: tables of readings."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import lru_cache
from typing import Any

from rows_of_drives import FirstStages

from rates.drive_trial import turns_of, with_faults
from rates.drive_worlds import WORLDS, WorldDrive, make_drive
from smallwheel_ros.onboard.settings import OnboardSettings
from smallwheel_ros.pipeline.tables import Readings, unknown


def table_of(**columns: Any) -> Readings:
    """A table of these columns; of all others nothing is known, but that pushed is slope and gain."""
    none = unknown(len(columns["stamp"]))
    pushed = columns.get("slope", none) + columns.get("gained", none)
    columns = {"pushed": pushed} | columns
    return Readings(**({field.name: none for field in fields(Readings)} | columns))


@dataclass(frozen=True)
class Driven:
    """A drive, its vehicle, and the readings that the first stages make of its messages."""

    drive: WorldDrive
    settings: OnboardSettings
    rows: Readings


@lru_cache
def driven_world(subject: str, name: str, way: str, seed: int = 1) -> Driven:
    """A world's drive over another way."""
    drive = make_drive(replace(WORLDS[subject][name], way=way), seed)
    raw = with_faults(drive)
    turns = [turn for _, turns in turns_of(FirstStages(raw.settings), raw) for turn in turns]
    return Driven(drive, raw.settings, Readings.joined([turn.readings for turn in turns]))
