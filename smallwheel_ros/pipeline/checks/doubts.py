# SPDX-License-Identifier: Apache-2.0
"""Which streams are doubted, and from which stamp on; every stage reads raw rows through this.

Checks record a doubt at a fixed stamp, and it holds for the rows after that. What follows from a row thus
depends on its stamp and not on where blocks are cut. Since nothing is assembled from doubted rows, a doubt
reaches everything that is derived from them.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Set
from dataclasses import dataclass

import numpy as np

from smallwheel_ros.pipeline.tables import Array, Flags, Integers

# Doubted instead of the odometry when that is computed from the wheels: its positions stay in use.
SHOWS_NO_SLIP = "odometry/speed"


@dataclass(frozen=True)
class Doubted:
    """Which streams are doubted over time.

    Attributes
    ----------
    stamps
        Stamps at which the set of doubted streams changes, rising, ns.
    streams
        The sets, one more than there are stamps. streams[i] holds in (stamps[i - 1], stamps[i]]; the first
        has no beginning, the last no end.
    """

    stamps: tuple[int, ...] = ()
    streams: tuple[frozenset[str], ...] = (frozenset(),)

    def at(self, stream: str, stamps: Integers) -> Flags:
        """Tell at which stamps a stream is doubted.

        Parameters
        ----------
        stream
            Name of the stream, such as `<wheel>/load`.
        stamps
            Shape (rows,), ns.

        Returns
        -------
        ndarray
            Shape (rows,), bool: True where it is doubted.
        """
        flags = [stream in streams for streams in self.streams]
        if not any(flags):
            return np.zeros(stamps.shape, dtype=bool)
        return np.array(flags)[np.searchsorted(self.stamps, stamps, side="left")]

    def set_at(self, stamp: int) -> frozenset[str]:
        """The streams that are doubted at a stamp."""
        return self.streams[bisect_left(self.stamps, stamp)]

    def believed(self, stream: str, stamps: Integers, values: Array) -> Array:
        """Replace the values of a stream by NaN where it is doubted.

        Parameters
        ----------
        stream
            Name of the stream.
        stamps
            Shape (rows,), ns.
        values
            Shape (rows, width).

        Returns
        -------
        ndarray
            Shape (rows, width); the values themselves if none is doubted.
        """
        doubted = self.at(stream, stamps)
        return np.where(doubted[:, None], np.nan, values) if doubted.any() else values


NO_DOUBT = Doubted()


class Doubts:
    """Record of the doubts of one vehicle, to which the checks add.

    Attributes
    ----------
    now
        The doubts recorded so far; it is replaced, never changed.
    began
        Stamps at which a stream became doubted that was not doubted before, ns.
    """

    def __init__(self) -> None:
        self.now = NO_DOUBT
        self.began: list[int] = []

    def hold(self, stamp: int, streams: Set[str]) -> None:
        """Doubt these streams, and no others, at all stamps later than this one.

        Parameters
        ----------
        stamp
            ns, not before that of an earlier call.
        streams
            Names of the streams.
        """
        before, now = self.now.streams[-1], frozenset(streams)
        if now == before:
            return
        self.now = Doubted((*self.now.stamps, stamp), (*self.now.streams, now))
        if now - before:
            self.began.append(stamp)

    def forget(self, before: int) -> None:
        """Drop everything that holds only before a stamp (ns), to free memory."""
        old = sum(stamp < before for stamp in self.now.stamps)
        self.now = Doubted(self.now.stamps[old:], self.now.streams[old:])
        self.began = [stamp for stamp in self.began if stamp >= before]
