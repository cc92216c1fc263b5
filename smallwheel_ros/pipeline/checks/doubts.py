# SPDX-License-Identifier: Apache-2.0
"""Which streams are not believed, and from which stamp on: what every stage reads raw rows through.

Checks put it down at fixed stamps, for rows after these. So what is made of a row depends on its stamp, not
on where blocks are cut; and since nothing is assembled but of what is believed here, a doubt reaches all
that is derived.
"""

from __future__ import annotations

from collections.abc import Set

import numpy as np

from smallwheel_ros.pipeline.intake.buffer import NEVER
from smallwheel_ros.pipeline.tables import Array, Flags, Integers

# Of an odometry made of the wheels: its places are of use all the same.
SHOWS_NO_SLIP = "odometry/speed"


class Doubts:
    """Sets of streams, each from a stamp (ns) on.

    began: stamps from which on a stream is doubted that was not before.
    """

    def __init__(self) -> None:
        self._stamps: list[int] = [NEVER]
        self._streams: list[frozenset[str]] = [frozenset()]
        self.began: list[tuple[int, frozenset[str]]] = []

    def hold(self, stamp: int, streams: Set[str]) -> None:
        """Behind a stamp these streams are doubted, and no others."""
        before, now = self._streams[-1], frozenset(streams)
        if now == before:
            return
        self._stamps.append(stamp)
        self._streams.append(now)
        if now - before:
            self.began.append((stamp, now - before))

    def forget(self, before: int) -> None:
        """Keep what holds behind a stamp (ns)."""
        while len(self._stamps) > 1 and self._stamps[1] < before:
            del self._stamps[0], self._streams[0]
        self.began = [one for one in self.began if one[0] >= before]

    def at(self, stream: str, stamps: Integers) -> Flags:
        """At which of some stamps a stream is doubted."""
        flags = np.array([stream in streams for streams in self._streams])
        if not flags.any():
            return np.zeros(stamps.shape, dtype=bool)
        return np.asarray(flags[np.searchsorted(self._stamps[1:], stamps, side="left")])

    def believed(self, stream: str, stamps: Integers, values: Array) -> Array:
        """Rows of a stream, NaN where it is doubted."""
        doubted = self.at(stream, stamps)
        return np.where(doubted[:, None], np.nan, values) if doubted.any() else values
