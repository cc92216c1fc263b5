"""Measurements of each wheel as medians over short pieces of its way."""

from __future__ import annotations

import math
from array import array
from dataclasses import dataclass, field
from statistics import fmean, median
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.estimator.sinkage_measurement import SinkageMeasurement

Array = NDArray[np.float64]

_MOST_READINGS = 40  # in a piece: a wheel that stands fills one
_LEAST_SINKAGE = 2e-4  # m: the logarithm of less is noise
_MEDIAN_VARIANCE = 1.57  # of a median over that of a mean
_SCATTER = 0.04  # of ln sinkage from piece to piece, besides the instrument's noise


class _Piece(NamedTuple):
    distance: float
    log_sinkage: float
    variance: float  # of that, from the instrument
    load: float
    diameter: float
    width: float
    slip: float
    speed: float


_NUMBERS = len(_Piece._fields)


@dataclass
class _Open:
    """A piece of way that a wheel is on."""

    start: float
    rows: list[tuple[float, float, float, float, float]] = field(default_factory=list)


class Changes(NamedTuple):
    """All pieces, arrays of shape (pieces,), and the pairs of neighbours among them.

    log_sinkage: ln m. load N, diameter and width m; slip and speed NaN where not known. later,
    earlier: indices of each pair, shape (pairs,); deviation: of the change in ln sinkage, known up
    to a factor common to all.
    """

    log_sinkage: Array
    load: Array
    diameter: Array
    width: Array
    slip: Array
    speed: Array
    later: NDArray[np.intp]
    earlier: NDArray[np.intp]
    deviation: Array

    def of(self, column: Array) -> Array:
        """Changes of a column of the pieces, over their deviation; shape (pairs,)."""
        return (column[self.later] - column[self.earlier]) / self.deviation

    def where(self, usable: NDArray[np.bool_]) -> Changes:
        """Only some of the pairs, by a mask of shape (pairs,)."""
        later, earlier, deviation = self.later[usable], self.earlier[usable], self.deviation[usable]
        return self._replace(later=later, earlier=earlier, deviation=deviation)


def _mean(values: tuple[float, ...]) -> float:
    """Mean of those that are known, NaN without any."""
    known = [value for value in values if not math.isnan(value)]
    return fmean(known) if known else math.nan


class WayPieces:
    """Collects pieces of `length` (m), and keeps those of the last `window` (m)."""

    def __init__(self, length: float, window: float) -> None:
        self._length, self._window = length, window
        self._open: dict[str, _Open] = {}
        self._wheels: dict[str, tuple[float, float]] = {}
        self._done: dict[str, array[float]] = {}  # the numbers of its pieces, one after the other

    def add(self, given: SinkageMeasurement, load: float, variance: float) -> None:
        """Take a measurement. load: N, without its noise. variance: of the sinkage, m^2."""
        if given.sinkage < _LEAST_SINKAGE:
            return
        wheel, distance = given.wheel, given.distance
        piece = self._open.get(wheel)
        if piece is None or not 0.0 <= distance - piece.start < self._length:
            if piece is not None:
                self._close(wheel, piece)
            piece = self._open[wheel] = _Open(distance)
            self._wheels[wheel] = given.diameter, given.width
        if len(piece.rows) < _MOST_READINGS:
            slip, speed = given.slip, given.speed
            row = (
                given.sinkage,
                variance,
                load,
                math.nan if slip is None else slip,
                math.nan if speed is None else speed,
            )
            piece.rows.append(row)

    def _close(self, wheel: str, piece: _Open) -> None:
        columns = list(zip(*piece.rows, strict=True))
        z = median(columns[0])
        noise = fmean(columns[1]) / (z * z) * _MEDIAN_VARIANCE / len(piece.rows)
        diameter, width = self._wheels[wheel]
        done = self._done.setdefault(wheel, array("d"))
        done.extend(
            _Piece(
                piece.start,
                math.log(z),
                noise,
                fmean(columns[2]),
                diameter,
                width,
                _mean(columns[3]),
                _mean(columns[4]),
            )
        )
        while done[-_NUMBERS] - done[0] > self._window:
            del done[:_NUMBERS]

    def changes(self) -> Changes | None:
        """Give what is kept; None while there is nothing."""
        done = self._done.values()
        if not done:
            return None
        table = np.concatenate([np.array(pieces) for pieces in done]).reshape(-1, _NUMBERS).T.copy()
        distance, log_sinkage, variance, load, diameter, width, slip, speed = table
        wheel = np.repeat(np.arange(len(done)), [len(pieces) // _NUMBERS for pieces in done])
        # Over a gap the soil may be any other.
        near = np.diff(distance) < 3.0 * self._length
        earlier = np.flatnonzero(near & (wheel[1:] == wheel[:-1]))
        if not earlier.size:
            return None
        later = earlier + 1
        deviation = np.sqrt(variance[later] + variance[earlier] + _SCATTER**2)
        return Changes(log_sinkage, load, diameter, width, slip, speed, later, earlier, deviation)
