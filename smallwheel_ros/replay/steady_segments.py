"""From a drive to steady measurements: one row for each wheel and stretch of way.

Readings that a sensor takes one after the other are no independent evidence: they share the spot.
So each row is the median of a wheel's readings over a stretch of way no shorter than a turn of the
largest wheel, and the rows of one stretch are one run. Stretches in which load, slip or speed
changed are left out, since a row is to be one steady measurement. So are those of a turn after a
change of soil: some wheels are on the old one still. The soils are those between the changes that the
replay counts, so a drive has one more of them than its summary has changes. The pass number (see
`passes`) is that of the middle half of a stretch's readings. Where the drive tells it for most rows,
those without are left out, since a table of measurements has no blank one; else the column is.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from statistics import median
from typing import NamedTuple

import numpy as np

from smallwheel_ros.onboard.onboard import Result
from smallwheel_ros.physics.conditions import PRESSED
from smallwheel_ros.physics.wheel import Wheel
from smallwheel_ros.replay.passes import PassCounter

_MOST_ROWS = 2000
_FEWEST_READINGS = 3
# Quartile to quartile: slip as it is, load and speed as a share of their median. Sinkage goes with
# load to a power near 1, so a load that scatters by half makes the median sinkage wrong by 1 %.
_STEADY_SLIP, _STEADY_SHARE = 0.1, 0.5
_DEPTH = 0.5e-3  # m of new depth that make a stretch of a pressed wheel's way


class _Key(NamedTuple):
    soil: int
    stretch: int
    wheel: int


class _Row(NamedTuple):
    """Medians of one wheel over one stretch, and how well those of sinkage and pull are known."""

    load: float
    sinkage: float
    sinkage_std: float
    slip: float  # NaN for a pressed wheel
    speed: float
    pull: float  # NaN where it was not measured
    pull_std: float
    passes: float  # NaN where the pass number is not known or changed
    readings: int


# Load, sinkage, variance, slip, speed, drawbar pull, variance, pass number.
_Reading = tuple[float, float, float, float, float, float, float, float]


@dataclass
class _Open:
    """The readings of a stretch that still goes on."""

    key: _Key
    readings: list[_Reading] = field(default_factory=list)


class SteadySegments:
    """Takes results as they come, and gives the rows of a section 5 table at the end.

    pulls: whether there are columns of measured drawbar pull.
    """

    def __init__(self, wheels: Sequence[Wheel], pulls: bool = False) -> None:
        self._wheels, self._pulls = tuple(wheels), pulls
        self._order = {wheel.name: i for i, wheel in enumerate(wheels)}
        self._passes = PassCounter(wheels)
        self._turn = math.pi * max(wheel.diameter for wheel in wheels)
        self._scale = 1
        self._open: dict[int, _Open] = {}
        self._rows: dict[_Key, _Row] = {}
        self._soil = 1
        self._changing = False
        self._way = 0.0
        self.unsteady = 0
        self.at_changes = 0
        self.unusable = 0

    def add(self, result: Result, changing: bool) -> None:
        """Take one result; changing: the soil is taken to change just now (`DriveSummary.changing`)."""
        found, soil, speed = result.mobility, result.soil, result.instant.speed
        passes = self._passes.number(result)
        order = self._order[found.wheel]
        wheel = self._wheels[order]
        forgotten = soil.distance < self._way - 1e-9  # time went back
        if forgotten or (changing and not self._changing):
            self._next_soil()
        self._changing, self._way = changing, soil.distance
        if changing:
            self.at_changes += 1
            return
        pressed = wheel.contact == PRESSED
        moving = pressed or (found.slip is not None and speed is not None)
        if found.load is None or found.sinkage_measured is None or not moving:
            self.unusable += 1
            return
        length = _DEPTH if pressed else self._turn
        key = _Key(self._soil, int(soil.distance / (length * self._scale)), order)
        now = self._open.get(order)
        if now is None or now.key != key:
            self._close(order)
            now = self._open[order] = _Open(key)
        pull = result.instant.drawbar_pull
        now.readings.append(
            (
                found.load.value,
                found.sinkage_measured.value,
                found.sinkage_measured.standard_deviation**2,
                math.nan if found.slip is None else found.slip.value,
                math.nan if speed is None else abs(speed),
                math.nan if pull is None else pull.value,
                math.nan if pull is None else pull.standard_deviation**2,
                math.nan if passes is None else float(passes),
            )
        )

    def _next_soil(self) -> None:
        """Begin another soil; the stretches where it was not yet noticed belong to neither."""
        last = max((key.stretch for key in self._rows if key.soil == self._soil), default=None)
        for key in [k for k in self._rows if k.soil == self._soil and k.stretch == last]:
            del self._rows[key]
            self.unsteady += 1
        self.unsteady += len(self._open)
        self._open.clear()
        self._soil += 1

    def _close(self, order: int) -> None:
        block = self._open.pop(order, None)
        if block is None:
            return
        row = self._row(block.readings, self._wheels[order])
        if row is None:
            self.unsteady += 1
            return
        self._rows[block.key] = row
        while len(self._rows) > _MOST_ROWS:
            self._merge()

    def _row(self, readings: Sequence[_Reading], wheel: Wheel) -> _Row | None:
        pressed = wheel.contact == PRESSED
        if not pressed and len(readings) < _FEWEST_READINGS:
            return None
        columns = list(zip(*readings, strict=True))
        loads, sinkages, variances, slips, speeds, pulls, noises, passes = columns
        sinkage = quartiles(sinkages)[1]
        if sinkage > wheel.diameter / 2:
            return None
        (low, load, high), (stalled, slip, spun), (slow, speed, fast) = map(
            quartiles, (loads, slips, speeds)
        )
        if not pressed and (
            spun - stalled > _STEADY_SLIP
            or high - low > _STEADY_SHARE * load
            or fast - slow > _STEADY_SHARE * speed
        ):
            return None
        pull = quartiles(pulls)[1]
        deviation = _deviation([value - sinkage for value in sinkages], quartiles(variances)[1])
        pull_deviation = _deviation([value - pull for value in pulls], quartiles(noises)[1])
        fewest, _, most = quartiles([0.0 if math.isnan(number) else number for number in passes])
        number = most if most == fewest > 0 else math.nan
        return _Row(
            load, sinkage, deviation, slip, speed, pull, pull_deviation, number, len(readings)
        )

    def _merge(self) -> None:
        """Double the stretches' length, so that a long drive still is a table of some rows."""
        merged: dict[_Key, list[_Row]] = {}
        for key, row in self._rows.items():
            merged.setdefault(key._replace(stretch=key.stretch // 2), []).append(row)
        self._rows = {key: _mean(rows) for key, rows in merged.items()}
        self._scale *= 2

    def finish(self) -> None:
        """Close the last stretches: nothing more will come."""
        for order in list(self._open):
            self._close(order)

    def __len__(self) -> int:
        return len(self._rows)

    def table(self) -> Iterator[dict[str, str | float]]:
        """Give the rows by column."""
        rows = self._rows
        known = {key: row for key, row in rows.items() if math.isfinite(row.passes)}
        with_passes = 2 * len(known) > len(rows)
        for key, row in sorted((known if with_passes else rows).items()):
            wheel = self._wheels[key.wheel]
            pull = {
                "drawbar_pull [N]": _cell(row.pull),
                "drawbar_pull_std [N]": _cell(row.pull_std),
            }
            yield {
                "load [N]": row.load,
                "diameter [m]": wheel.diameter,
                "width [m]": wheel.width,
                "sinkage [m]": row.sinkage,
                "sinkage_std [m]": row.sinkage_std,
                **(pull if self._pulls else {}),
                "slip": _cell(row.slip),
                "speed [m/s]": _cell(row.speed),
                **({"pass_number": int(row.passes)} if with_passes else {}),
                "contact": wheel.contact,
                "soil": f"soil {key.soil}",
                "run": f"{key.soil}.{key.stretch}",
                "wheel": wheel.name,
            }


def _cell(value: float) -> str | float:
    return "" if math.isnan(value) else value


def quartiles(values: Sequence[float]) -> tuple[float, float, float]:
    """Return the 25th, 50th and 75th percentile; NaN where a value is."""
    low, middle, high = np.percentile(values, [25.0, 50.0, 75.0]).tolist()
    return low, middle, high


def _deviation(off: Sequence[float], variance: float) -> float:
    """Standard deviation of a median of readings.

    What they scatter (off: from it), and what their sensor declares: the larger one counts.
    """
    scatter = 1.4826 * median(map(abs, off))
    return max(scatter, math.sqrt(variance)) / math.sqrt(len(off))


def _mean(rows: Sequence[_Row]) -> _Row:
    """One row of several, weighted by their readings."""
    weight = np.array([row.readings for row in rows], dtype=float)
    values = np.array([row[:7] for row in rows])
    load, sinkage, _, slip, speed, pull, _ = np.average(values, axis=0, weights=weight).tolist()
    passes = rows[0].passes if len({row.passes for row in rows}) == 1 else math.nan
    deviation, pull_deviation = (
        np.sqrt(np.sum((weight[:, None] * values[:, [2, 6]]) ** 2, axis=0)) / weight.sum()
    ).tolist()
    count = int(weight.sum())
    return _Row(load, sinkage, deviation, slip, speed, pull, pull_deviation, passes, count)
