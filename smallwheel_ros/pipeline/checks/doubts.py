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

# Of an odometry made of the wheels: its places are of use all the same.
SHOWS_NO_SLIP = "odometry/speed"


@dataclass(frozen=True)
class Doubted:
    """The set of doubted streams over time: each set holds after its stamp and up to the next one.

    Attributes
    ----------
    stamps
        Beginning of each set but the first, ns.
    streams
        The sets; the first one holds up to the first stamp.
    """

    stamps: tuple[int, ...] = ()
    streams: tuple[frozenset[str], ...] = (frozenset(),)

    def at(self, stream: str, stamps: Integers) -> Flags:
        """At which stamps a stream is doubted.

        Parameters
        ----------
        stream
            The stream.
        stamps
            Shape (rows,), ns.

        Returns
        -------
        ndarray
            Shape (rows,), bool.
        """
        flags = [stream in streams for streams in self.streams]
        if not any(flags):
            return np.zeros(stamps.shape, dtype=bool)
        return np.array(flags)[np.searchsorted(self.stamps, stamps, side="left")]

    def set_at(self, stamp: int) -> frozenset[str]:
        """The streams that are doubted at a stamp."""
        return self.streams[bisect_left(self.stamps, stamp)]

    def believed(self, stream: str, stamps: Integers, values: Array) -> Array:
        """Rows of a stream, with NaN where it is doubted.

        Parameters
        ----------
        stream
            The stream.
        stamps
            Shape (rows,), ns.
        values
            Shape (rows, width).
        """
        doubted = self.at(stream, stamps)
        return np.where(doubted[:, None], np.nan, values) if doubted.any() else values


NO_DOUBT = Doubted()


class Doubts:
    """The doubts that the checks have recorded.

    Attributes
    ----------
    now
        The streams doubted at the newest stamp.
    began
        Stamps at which a new doubt began, ns.
    """

    def __init__(self) -> None:
        self.now = NO_DOUBT
        self.began: list[int] = []

    def hold(self, stamp: int, streams: Set[str]) -> None:
        """Doubt these streams and no others after a stamp.

        Parameters
        ----------
        stamp
            ns.
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
        """Drop doubts that were over before a stamp (ns)."""
        old = sum(stamp < before for stamp in self.now.stamps)
        self.now = Doubted(self.now.stamps[old:], self.now.streams[old:])
        self.began = [stamp for stamp in self.began if stamp >= before]
