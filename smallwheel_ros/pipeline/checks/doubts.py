# SPDX-License-Identifier: Apache-2.0
"""Which streams are not believed, and from which stamp on: what every stage reads raw rows through.

Checks put it down at fixed stamps, for rows after these. So what follows from a row depends on its stamp, not
on where blocks are cut; and since nothing is assembled but of what is believed here, a doubt reaches all
that is derived.
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
    """Sets of streams that are not believed, each after a stamp (ns) and up to the next.

    stamps: of all but the first set, which is that of the time before them.
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
    """What checks put down of doubted streams.

    now: as of the newest stamp. began: stamps from which on a stream is doubted that was not before.
    """

    def __init__(self) -> None:
        self.now = NO_DOUBT
        self.began: list[int] = []

    def hold(self, stamp: int, streams: Set[str]) -> None:
        """From now on, after a stamp, doubt these streams and no others.

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
        """Keep what holds after a stamp (ns)."""
        old = sum(stamp < before for stamp in self.now.stamps)
        self.now = Doubted(self.now.stamps[old:], self.now.streams[old:])
        self.began = [stamp for stamp in self.began if stamp >= before]
