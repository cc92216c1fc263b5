# SPDX-License-Identifier: Apache-2.0
"""The rows of one stream, and its values at any instant, interpolated or held for a limited time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from smallwheel_ros.common.stamps import NEVER, SECOND
from smallwheel_ros.pipeline.tables import Array, Integers

_ROOM = 64  # rows of a stream at first
_PERIODS = 8  # times between the newest messages, of which the second longest is a stream's period
_HOLDS = (
    1.25  # periods over which a slow stream's values are held: one message may be late by a quarter
)
_WIDEST = 3 * SECOND // 2  # over more nothing is interpolated, and slip over it says nothing


@dataclass(frozen=True)
class StampRules:
    """Rules for the stamps of messages; all times in ns.

    Attributes
    ----------
    silence
        Time after which a stream that sends nothing is no longer waited for.
    reorder
        Time by which a stream that was silent may come late, against the newest stamp of all streams.
    gap
        Shortest time for which a value is held after its stamp.
    jump
        Time by which stamps have to go back to count as a jump of time, rather than as late.
    future, age
        Times by which a stamp may be ahead of the clock, and older than the clock.
    """

    silence: int = SECOND
    reorder: int = SECOND // 5
    gap: int = SECOND // 5
    jump: int = SECOND
    future: int = SECOND // 2
    age: int = 5 * SECOND

    @property
    def widest(self) -> int:
        """Longest time (ns) for which values of a slow stream are held."""
        return max(self.gap, _WIDEST)


_NO_STAMPS: Integers = np.empty(0, dtype=np.int64)


class Sampled:
    """Rows in the order of their stamps, to be read at instants.

    Attributes
    ----------
    stamps
        ns, shape (rows,).
    values
        Shape (rows, width).
    ends
        Stamps (ns) of messages that were refused but show that something has changed: no earlier value is
        held past them.
    """

    stamps: Integers
    values: Array
    ends: Integers

    def between(self, after: int, until: int) -> tuple[Integers, Array]:
        """Rows with stamps in (after, until], without interpolation.

        Parameters
        ----------
        after, until
            ns.

        Returns
        -------
        stamps, values : ndarray
            Shape (rows,), ns, and (rows, width).
        """
        stamps = self.stamps
        rows = slice(*np.searchsorted(stamps, [after, until], side="right").tolist())
        return stamps[rows], self.values[rows]

    def after(self, stamp: int) -> tuple[Integers, Array]:
        """Stamps (rows,) and values (rows, width) of the rows later than a stamp (ns)."""
        first = int(np.searchsorted(self.stamps, stamp, side="right"))
        return self.stamps[first:], self.values[first:]

    def periods(self, stamps: Integers) -> Integers:
        """Period of a stream at each of its stamps: the second longest of the last 8 times between messages.

        One missing message thus does not make a stream slow.

        Parameters
        ----------
        stamps
            Stamps of the messages, rising, shape (rows,), ns.

        Returns
        -------
        ndarray
            Shape (rows,), ns; 0 for the first two.
        """
        between = np.concatenate([np.zeros(_PERIODS), np.diff(stamps)]).astype(np.int64)
        windows = np.lib.stride_tricks.sliding_window_view(between, _PERIODS)
        return np.partition(windows, -2, axis=1)[: stamps.size, -2]

    def gaps(self, stamps: Integers, rules: StampRules) -> Integers:
        """Time for which each value is held: 1.25 periods of the stream, within the bounds of the rules.

        Parameters
        ----------
        stamps
            Stamps of successive rows, rising, shape (rows,), ns.
        rules
            Shortest (`gap`) and longest (`widest`) time.

        Returns
        -------
        ndarray
            Shape (rows,), ns.
        """
        if stamps.size < 2 or _HOLDS * int((stamps[1:] - stamps[:-1]).max()) <= rules.gap:
            return np.full(stamps.size, rules.gap)
        held = (_HOLDS * self.periods(stamps)).astype(np.int64)
        return np.clip(held, rules.gap, rules.widest)

    def hold(self, rules: StampRules) -> int:
        """Time (ns) for which the newest value is held."""
        newest = self.stamps[-1 - _PERIODS :]
        return int(self.gaps(newest, rules)[-1]) if newest.size else rules.gap

    def at(self, instants: Integers, rules: StampRules) -> Array:
        """Values at instants: linear between two rows that are near, else that of the one that is near.

        Near means at most the time of `gaps` before or after the instant.

        Parameters
        ----------
        instants
            Shape (instants,), ns, in any order.
        rules
            Shortest (`gap`) and longest (`widest`) time for which a value is held.

        Returns
        -------
        ndarray
            Shape (instants, width); NaN where no row is near.
        """
        if not self.stamps.size or not instants.size:
            return np.full((instants.size, self.values.shape[1]), np.nan)
        after = self.stamps.searchsorted(instants)
        first = max(int(after.min()) - 1 - _PERIODS, 0)  # no row depends on what is before it
        part = slice(first, int(after.max()) + 1)
        stamps, values = self.stamps[part], self.values[part]
        after -= first
        later = np.minimum(after, stamps.size - 1)
        end = stamps[later]
        exact = end == instants
        if exact.all():
            return np.asarray(values[later])
        before = np.maximum(after - 1, 0)
        start = stamps[before]
        gap = self.gaps(stamps, rules)[before]
        from_start, to_end = instants - start, end - instants
        holds = (from_start >= 0) & (from_start <= gap)
        if self.ends.size:
            ended = np.searchsorted(self.ends, start, "right")
            holds &= np.searchsorted(self.ends, instants, "right") == ended
        comes = (to_end >= 0) & (to_end <= gap)
        # Between two rows where both are near; else both are the one that is.
        low = values[np.where(holds & ~exact, before, later)]
        high = values[np.where(comes, later, before)]
        share = from_start / np.maximum(end - start, 1)
        found: Array = low + share[:, None] * (high - low)
        found[~(holds | comes)] = np.nan
        return found

    def last(self, instants: Integers) -> tuple[Integers, Array]:
        """Stamp and values of the newest row at or before each instant; NEVER and NaN before the first."""
        row = np.searchsorted(self.stamps, instants, side="right")
        stamps = np.append(np.int64(NEVER), self.stamps)
        values = np.vstack([np.full((1, self.values.shape[1]), np.nan), self.values])
        return stamps[row], values[row]


@dataclass(frozen=True)
class Samples(Sampled):
    """Snapshot of a stream's rows, which stays the same while the stream grows; fields as in `Sampled`."""

    stamps: Integers
    values: Array
    ends: Integers = field(default_factory=_NO_STAMPS.copy)


class Stream(Sampled):
    """Rows of one stream in the order of their stamps, to which rows are added at the end.

    Parameters
    ----------
    name
        Name of the stream, such as `<wheel>/load` or `odom`.
    width
        Number of values in a row.

    Attributes
    ----------
    kind
        Last part of the name, such as `load`.
    newest
        The newest stamp that was kept, ns; NEVER without any.
    received
        Number of messages received, also of those that were not kept.
    """

    def __init__(self, name: str, width: int) -> None:
        self.name, self.width = name, width
        self.kind = name.rpartition("/")[2]
        self._stamps: Integers = np.empty(_ROOM, dtype=np.int64)
        self._values: Array = np.empty((_ROOM, width))
        self._begin = self._end = 0  # of what is kept, in the room that there is
        self.ends = _NO_STAMPS
        self.newest = NEVER
        self.received = 0

    def append(self, stamp: int, values: Sequence[float]) -> None:
        """Add one row.

        Parameters
        ----------
        stamp
            ns, later than that of the newest row.
        values
            One value for each column (`width` of them), SI units.
        """
        self.extend(np.array([stamp]), np.array([values]))

    def extend(self, stamps: Integers, values: Array) -> None:
        """Add rows.

        Parameters
        ----------
        stamps
            Rising, and all later than that of the newest row, shape (rows,), ns.
        values
            Shape (rows, width), SI units.
        """
        if not stamps.size:
            return
        begin, end = self._end, self._end + stamps.size
        if end > self._stamps.size:
            begin, end = self._move(stamps.size)
        self._stamps[begin:end], self._values[begin:end] = stamps, values
        self._end = end
        self.newest = int(stamps[-1])

    def end(self, stamps: Integers) -> None:
        """Mark stamps of refused messages: no value from before one is held past it.

        Parameters
        ----------
        stamps
            Stamps of the messages, shape (messages,), ns.
        """
        ends = np.union1d(self.ends, stamps)
        # The first after each row.
        self.ends = ends[np.unique(np.searchsorted(self.stamps, ends), return_index=True)[1]]

    def _move(self, more: int) -> tuple[int, int]:
        """Move the kept rows to new arrays with room for `more` rows, so that old views stay valid.

        Returns the places (begin, end) of the rows to be added.
        """
        stamps, values = self.stamps, self.values
        kept = stamps.size
        room = max(2 * (kept + more), _ROOM)
        self._stamps, self._values = np.empty(room, dtype=np.int64), np.empty((room, self.width))
        self._stamps[:kept], self._values[:kept] = stamps, values
        self._begin = 0
        return kept, kept + more

    @property
    def stamps(self) -> Integers:  # type: ignore[override]
        """The stamps (ns), as a view that does not change while the stream grows."""
        return self._stamps[self._begin : self._end]

    @property
    def values(self) -> Array:  # type: ignore[override]
        """The values, shape (rows, width), as a view that does not change while the stream grows."""
        return self._values[self._begin : self._end]

    def forget(self, before: int) -> None:
        """Drop rows before a stamp (ns), except the last few, which values and the period there depend on."""
        kept = int(np.searchsorted(self.stamps, before)) - 1 - _PERIODS
        self._begin += max(kept, 0)
        if self.ends.size and kept > 0:
            self.ends = self.ends[self.ends >= self._stamps[self._begin]]

    def clear(self) -> None:
        """Drop all rows; keep the counts."""
        self._begin, self.ends = self._end, _NO_STAMPS
        self.newest = NEVER

    @property
    def samples(self) -> Samples:
        """Snapshot of the rows that are kept now."""
        return Samples(self.stamps, self.values, self.ends)
