"""The newest measurements while n is uncertain, and what to hold fast in linearising them.

While n is as uncertain as the prior, a filter that linearises each measurement at another soil
takes the small differences between their slopes for information that is not there: it becomes sure
of a wrong n, and stays so for long. Two remedies, until n is known:

- The direction in (ln pressure, n) in which a measurement tells nothing is computed at one soil,
  the anchor (first-estimates Jacobian; Huang, Mourikis and Roumeliotis 2008). Under one load it is
  then one direction, however often that load is measured, and n stays as uncertain as it is.
- Where the soil turns out to be another than assumed, and at growing intervals, the filter runs
  over the measurements again, all linearised at the newest soil (Gauss-Newton on all of them; the
  iterated smoother of Bell 1994). A full record gives up its older half: they stay in the filter
  as they are linearised then.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.bounded_exponent import exponent_of
from smallwheel_ros.sinkage_observation import Reading

Array = NDArray[np.float64]

_ALIKE = 0.05  # predicted sinkages that differ by less are one record
_ONE_SPOT = 0.1  # of the scatter length
_MOST = 100  # records
_GROWTH = 1.25  # of the readings from one running to the next
_ANOTHER = np.array([0.5, 0.1, 0.1])  # ln pressure, n, m
_NARROW = 0.07  # standard deviation of n: slopes no longer change with the soil


@dataclass
class Record:
    """One reading, or the weighted mean of several alike at one spot.

    travelled: m since the record before. count: readings in it.
    """

    travelled: float
    spot: int
    reading: Reading
    count: int = 1

    def merge(self, measured: float, noise: float, load_noise: float) -> None:
        """Take in another measurement, brought to the conditions of this one."""
        old = self.reading
        self.count += 1
        weight = old.noise / (old.noise + noise)
        self.reading = old._replace(
            measured=old.measured + weight * (measured - old.measured),
            noise=old.noise * (1.0 - weight),
            load_noise=(1.0 - weight) ** 2 * old.load_noise + weight**2 * load_noise,
        )


class Opening:
    """Collects the records, and says when to run over them again.

    travelled: m since the last record. anchor: a soil, as the deviation of the filter's first three
    components; None before the first record.
    """

    def __init__(self, scatter_length: float) -> None:
        self._one_spot = _ONE_SPOT * scatter_length
        self.records: list[Record] = []
        self.travelled = 0.0
        self.going_on = True
        self.anchor: Array | None = None
        self._odometer = 0.0
        self._last: dict[int, tuple[Record, float]] = {}
        self._readings = 0
        self._due = 2

    def travel(self, distance: float) -> None:
        """Note a travel (m)."""
        self.travelled += distance
        self._odometer += distance

    def add(self, reading: Reading, sinkage: float, s: float, q: float, spot: int) -> bool:
        """Keep a reading that the filter has used; True when the records are due.

        sinkage: of the reading's wheel at (s, q), where it was linearised.
        """
        self._readings += 1
        last, where = self._last.get(spot, (None, 0.0))
        there = math.inf
        if last is not None and self._odometer - where <= self._one_spot:
            there = last.reading.observe(s, exponent_of(q)).sinkage
        if last is not None and abs(there - sinkage) <= _ALIKE * abs(sinkage):
            moved = reading.measured + there - sinkage
            last.merge(moved, reading.noise, reading.load_noise)
        else:
            record = Record(self.travelled, spot, reading)
            self.travelled = 0.0
            self.records.append(record)
            self._last[spot] = record, self._odometer
        if self._readings < self._due and not self.full:
            return False
        self._due = int(_GROWTH * self._readings) + 1
        return True

    @property
    def full(self) -> bool:
        """Whether the older half has to go."""
        return len(self.records) >= _MOST

    def drop(self, count: int) -> None:
        """Give up the oldest records."""
        del self.records[:count]
        self._readings = sum(record.count for record in self.records)
        self._due = int(_GROWTH * self._readings) + 1

    def hold(self, soil: Array) -> Array:
        """Give the anchor, moved to this soil if it is quite another.

        Not for a little: an anchor that follows the soil's drift makes the drift seem to tell n.
        """
        if self.anchor is None or bool(np.any(np.abs(soil - self.anchor) > _ANOTHER)):
            self.anchor = soil
        return self.anchor

    def judge(self, exponent_deviation: float) -> None:
        """End once n is known."""
        if exponent_deviation < _NARROW:
            self.end()

    def end(self) -> None:
        """Keep no more records."""
        self.going_on = False
        self.anchor = None
        self.records.clear()
        self._last.clear()
