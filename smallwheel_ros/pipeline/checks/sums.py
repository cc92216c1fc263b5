# SPDX-License-Identifier: Apache-2.0
"""Running quantities that the rules of `checks` keep from span to span; a span is 2 s of stamps (`window`).

All are bounded: nothing grows with the drive.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
from scipy.special import erf, ndtri

from smallwheel_ros.pipeline.tables import Array, Flags

MOST_PIECES = 400  # that are kept: what a tyre or a zero was long ago does not count
# Share of the sizes that the quantile takes in: an error combines three readings, so one bad reading in nine
# spoils a third of the errors.
WITHIN = 0.8
_OF_NORMAL = float(
    ndtri(0.5 + 0.5 * WITHIN)
)  # deviations within which so many are, of normal errors
_EDGES = np.geomspace(1e-4, 1e2, 77)  # of the bins, a fifth apart
MOST_SPANS = 300  # medians of spans that are kept: ten minutes


@dataclass(frozen=True)
class Said:
    """A fault that a rule reports at the end of a span of 2 s.

    Attributes
    ----------
    subject
        The wheel or the source at fault.
    value
        Value of the rule's statistic, in its unit.
    text
        What is wrong and what to do, in words.
    doubts
        Streams that are not to be used.
    since
        Stamp at which the fault began, s; NaN: it has been there from the beginning of the drive.
    places
        Whether the positions in these streams stay in use, so that only their speeds are doubted.
    taught
        Whether the soil must be learnt anew, because it was learnt from these streams while they were wrong.
    """

    subject: str
    value: float
    text: str
    doubts: tuple[str, ...] = ()
    since: float = np.nan
    places: bool = False
    taught: bool = False


class Run:
    """Sum of an amount over consecutive rows that are all flagged, in the unit of the amount.

    Attributes
    ----------
    now
        The sum at the last row; 0 if that is not flagged.
    most
        The largest sum within the last span.
    began
        Stamp of the first row in `most`, s; NaN if `most` is 0.
    """

    def __init__(self) -> None:
        self.now = self.most = 0.0
        self.began = self._since = np.nan  # the latter: of the sum in progress

    def extend(self, flag: Flags, amount: Array, time: Array) -> None:
        """Continue with the rows of a span.

        Parameters
        ----------
        flag
            Mask of the rows that count, shape (rows,); any other row ends the sum.
        amount
            Amount to be summed, 0 or more, shape (rows,).
        time
            Stamps of the rows, shape (rows,), s.
        """
        if not flag.size:
            self.most, self.began = self.now, self._since if self.now > 0.0 else np.nan
            return
        total = self.now + np.cumsum(np.where(flag, amount, 0.0))
        base = np.maximum.accumulate(np.where(flag, 0.0, total))
        running = np.where(flag, total - base, 0.0)
        first = np.maximum.accumulate(np.where(flag, 0, np.arange(1, flag.size + 1)))
        before = time[0] if np.isnan(self._since) else self._since
        since = np.where(first > 0, time[np.minimum(first, flag.size - 1)], before)
        peak = int(np.argmax(running))
        self.most, self.now = float(running[peak]), float(running[-1])
        self.began = float(since[peak]) if self.most > 0.0 else np.nan
        self._since = float(since[-1]) if flag[-1] else np.nan


class Pieces:
    """Sums of columns over pieces of path; a row belongs to the piece in which it ends.

    A piece in which no row ends, because one spans it from end to end, is left out. The newest `MOST_PIECES`
    pieces are kept.

    Parameters
    ----------
    metres
        Length of a piece, m.
    columns
        Number of columns.
    """

    def __init__(self, metres: float, columns: int) -> None:
        self.metres, self._way = metres, 0.0
        self._open, self._begun = np.zeros(columns), False
        self._rows: deque[Array] = deque(maxlen=MOST_PIECES)

    def extend(self, way: Array, columns: Array) -> None:
        """Continue with rows.

        Parameters
        ----------
        way
            Path that each row adds, 0 or more, shape (rows,), m.
        columns
            Amounts to be summed, shape (rows, columns), any units.
        """
        if not way.size:
            return
        total = self._way + np.cumsum(way)
        piece = (total / self.metres).astype(int)
        count = int(piece[-1])
        sums = np.zeros((count + 1, columns.shape[1]))
        np.add.at(sums, piece, columns)
        sums[0] += self._open
        begun = np.bincount(piece[way > 0.0], minlength=count + 1) > 0
        begun[0] |= self._begun
        self._open, self._begun = sums[count], bool(begun[count])
        self._way = float(total[-1]) - count * self.metres
        self._rows.extend(sums[:count][begun[:count]])

    def __len__(self) -> int:
        return len(self._rows)

    @property
    def rows(self) -> Array:
        """Sums over the pieces that are complete, (pieces, columns)."""
        return np.array(self._rows).reshape(len(self._rows), -1)


class RunningAgreement:
    """Correlation about 0 of two rates, weighted by time.

    Parameters
    ----------
    least
        Integral of the second rate's magnitude up to which the correlation counts as 0, in the unit of that
        rate times s.
    """

    def __init__(self, least: float) -> None:
        self.least = least
        self._sums = np.zeros(5)

    def extend(self, a: Array, b: Array, dt: Array) -> None:
        """Add rows to the sums; those where a rate is NaN are skipped.

        Parameters
        ----------
        a, b
            The two rates, shape (rows,), any units.
        dt
            Time for which each row counts, shape (rows,), s.
        """
        good = np.isfinite(a) & np.isfinite(b)
        a, b, dt = a[good], b[good], dt[good]
        self._sums += [(a * b) @ dt, (a * a) @ dt, (b * b) @ dt, np.abs(a) @ dt, np.abs(b) @ dt]

    @property
    def value(self) -> float:
        """The correlation, -1 to 1; 0 before the second rate has added up to `least`."""
        both, first, second, way, turned = self._sums
        return float(both / np.sqrt(first * second)) if turned > self.least and way > 0.0 else 0.0


class RunningDeviation:
    """Standard deviation of errors at each row, from the quantile `WITHIN` of their sizes.

    Errors of odometries have heavier tails than normal ones: the few worst would dominate a mean of squares.
    Sizes are counted in bins, each 1.2 times as large as the one before, so that the result at a row depends
    on all rows up to it, and not on where blocks are cut.

    Parameters
    ----------
    count
        Number of errors that have the same weight as the deviation assumed beforehand.
    """

    def __init__(self, count: float) -> None:
        """Begin without any error; see the class."""
        self._prior = count
        self._counts = np.zeros(_EDGES.size + 1)

    def take(self, good: Flags, sizes: Array, before: Array) -> Array:
        """Standard deviation at each row, from the errors up to it.

        Parameters
        ----------
        good
            Mask of the rows that count, shape (rows,).
        sizes
            Absolute errors, shape (rows,), any unit.
        before
            Deviation that is assumed as long as there are no errors, shape (rows,), above 0, same unit.

        Returns
        -------
        ndarray
            Shape (rows,), same unit.
        """
        rows = np.zeros((sizes.size, _EDGES.size + 1))
        chosen = np.flatnonzero(good)
        rows[chosen, np.searchsorted(_EDGES, sizes[chosen])] = 1.0
        total = np.cumsum(np.concatenate([self._counts[None], rows]), axis=0)[1:]
        self._counts = total[-1] if len(total) else self._counts
        within = np.cumsum(total, axis=1)[:, :-1]
        within = within + self._prior * erf(_EDGES / (np.sqrt(2.0) * before[:, None]))
        asked = WITHIN * (self._prior + total.sum(axis=1))
        upper = np.clip((within < asked[:, None]).sum(axis=1), 1, _EDGES.size - 1)
        row = np.arange(sizes.size)
        low, high = within[row, upper - 1], within[row, upper]
        share = np.clip((asked - low) / np.maximum(high - low, 1e-12), 0.0, 1.0)
        size = _EDGES[upper - 1] * (_EDGES[upper] / _EDGES[upper - 1]) ** share
        return np.asarray(size / _OF_NORMAL)


class Medians:
    """Median of each column over a drive, as the median of medians of spans.

    Parameters
    ----------
    most
        Number of the newest spans that are kept.
    """

    def __init__(self, most: int = MOST_SPANS) -> None:
        self._rows: deque[Array] = deque(maxlen=most)

    def extend(self, values: Array) -> None:
        """Add the rows of a span, (rows, columns); those with any NaN are left out."""
        good = values[np.isfinite(values).all(axis=1)]
        if len(good):
            self._rows.append(np.median(good, axis=0))

    def __len__(self) -> int:
        return len(self._rows)

    @property
    def value(self) -> Array:
        """The median of each column, (columns,); at least one span must have been added."""
        return np.asarray(np.median(np.array(self._rows), axis=0))


def robust(values: Array) -> tuple[float, float]:
    """Median of values, and their standard deviation estimated as 1.4826 times the median distance to it."""
    middle = float(np.median(values))
    return middle, 1.4826 * float(np.median(np.abs(values - middle)))
