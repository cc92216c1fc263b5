# SPDX-License-Identifier: Apache-2.0
"""Drives of the worlds of `rates` as the stages of the pipeline get them: tables of readings."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from typing import Any

from rates.drive_trial import turns_of, with_faults
from rates.drive_worlds import WORLDS, WorldDrive, make_drive
from smallwheel_ros.onboard.settings import OnboardSettings
from smallwheel_ros.pipeline.checks.believed import RawRows
from smallwheel_ros.pipeline.checks.sensor_checks import SensorChecks
from smallwheel_ros.pipeline.intake.layout import rules_of, widths_of
from smallwheel_ros.pipeline.intake.streams import Streams
from smallwheel_ros.pipeline.rows.align import Align
from smallwheel_ros.pipeline.rows.motion import MotionState, motion
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


class FirstStages:
    """The pipeline up to the readings: most of its work comes after them."""

    def __init__(self, settings: OnboardSettings) -> None:
        self.settings = settings
        self.streams = Streams(widths_of(settings), rules_of(settings), lambda: None)
        self._checks, self._align = SensorChecks(settings), Align(settings)
        self._motion = MotionState.of(settings)

    def turns(self, *, last: bool = False) -> Iterator[Readings]:
        """The readings of what is complete."""
        until = self.streams.latest if last else self.streams.watermark
        self.streams.forget(self._checks.looks_back)
        raw = RawRows(self.streams.samples(), until, self.streams.silent_ones())
        aligned = self._align.take(self._checks.take(raw, last=last))
        if aligned is not None:
            yield motion(self._motion, aligned, self.settings)


@lru_cache
def driven_world(subject: str, name: str, way: str, seed: int = 1) -> Driven:
    """A world's drive over another way."""
    drive = make_drive(replace(WORLDS[subject][name], way=way), seed)
    raw = with_faults(drive)
    found = [rows for _, turns in turns_of(FirstStages(raw.settings), raw) for rows in turns]  # type: ignore[arg-type,misc]
    return Driven(drive, raw.settings, Readings.joined(found))  # type: ignore[arg-type]
