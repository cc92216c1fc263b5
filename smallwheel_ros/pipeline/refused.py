# SPDX-License-Identifier: Apache-2.0
"""Counts of messages that could not be used, and why, in words."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from typing import NamedTuple

# Rows before anything is reported of a stream; share of refused messages from which on it is.
_ENOUGH, _MANY = 20, 0.2


class Refusal(NamedTuple):
    """A problem with messages of a stream, most often that they could not be used.

    Attributes
    ----------
    stream
        Stream or topic of the messages.
    reason
        Key under which the problem is counted, such as 'not_readable'.
    text
        Explanation for people.
    """

    stream: str
    reason: str
    text: str


class ProblemLog:
    """Counts problems since the start, by stream and reason, with an explanation of each.

    Attributes
    ----------
    counts
        Number of messages with each problem, by (stream, reason). The caller's own counter, not a copy:
        others may add to it.
    words
        Explanation of the newest occurrence, by (stream, reason), the newest last; not a copy either.
    """

    def __init__(self, counts: Counter[tuple[str, str]], words: dict[tuple[str, str], str]) -> None:
        self.counts, self.words = counts, words
        self._told: Counter[tuple[str, str]] = Counter()
        self._used: set[tuple[str, str]] = set()

    def add(
        self, stream: str, reason: str, text: str, times: int = 1, *, unused: bool = True
    ) -> None:
        """Count a problem with a stream or a topic.

        Parameters
        ----------
        stream
            Stream or topic.
        reason
            Key under which the problem is counted.
        text
            Explanation for people; it replaces that of earlier messages.
        times
            Number of messages with the problem.
        unused
            Whether these messages were left out. If False they do not count as refused (`refused`).
        """
        self.counts[stream, reason] += times
        self.words.pop((stream, reason), None)  # the newest is the last
        self.words[stream, reason] = text
        if not unused:
            self._used.add((stream, reason))

    def take(self) -> list[Refusal]:
        """Return the problems counted since the last call, each stream and reason once, as last explained."""
        new = [key for key, count in self.counts.items() if count != self._told[key]]
        self._told = self.counts.copy()
        return [Refusal(*key, self.words[key]) for key in new]

    def refused(self, stream: str) -> int:
        """Number of messages of a stream that were not used."""
        return sum(count for key, count in self.counts.items() if self._refuses(stream, key))

    def _refuses(self, stream: str, key: tuple[str, str]) -> bool:
        """Whether messages of a stream were left out for the problem with this key."""
        return key[0] == stream and key not in self._used and key[1] not in _USED

    def findings(self, received: Iterable[tuple[str, int]]) -> tuple[str, ...]:
        """Describe in words each stream of which over a fifth of the messages were refused.

        Parameters
        ----------
        received
            Name of each stream, and the number of rows it has received; one with fewer than 20 rows is
            ignored.
        """
        found = []
        for name, rows in received:
            refused = self.refused(name)
            count = rows + sum(self.counts[name, reason] for reason in NO_ROW)
            if rows >= _ENOUGH and refused > _MANY * count:
                newest = [text for key, text in self.words.items() if self._refuses(name, key)][-1]
                found.append(
                    f"{name}: {refused / count:.0%} of the messages are refused (newest: {newest})"
                )
        return tuple(found)


# Reasons of messages that did not become a row of their stream.
NO_ROW = ("no_value", "not_readable", "velocity_unit", "steering_unit")
# Reasons for which a message is counted but used all the same.
_USED = frozenset(["no_orientation", "load_not_positive", "time_jump", "in_steps"])
