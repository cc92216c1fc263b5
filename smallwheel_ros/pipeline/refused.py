# SPDX-License-Identifier: Apache-2.0
"""Counts of messages that could not be used, and why, in words."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from typing import NamedTuple

_ENOUGH, _MANY = 20, 0.2  # messages before anything is reported of a stream; share that is refused


class Refusal(NamedTuple):
    """A message that could not be used.

    Attributes
    ----------
    stream
        Stream or topic that it belongs to.
    reason
        Key by which it is counted.
    text
        Explanation for people.
    """

    stream: str
    reason: str
    text: str


class ProblemLog:
    """Counts problems by stream and reason since the start, and keeps an explanation of each new one.

    Attributes
    ----------
    counts
        How often each has occurred, by stream and reason.
    words
        An example of each, in words.
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
            Key by which it is counted.
        text
            Explanation for people.
        times
            How many messages had it.
        unused
            Whether these messages were left out.
        """
        self.counts[stream, reason] += times
        self.words[stream, reason] = text
        if not unused:
            self._used.add((stream, reason))

    def take(self) -> list[Refusal]:
        """New problems since the last call: each stream and reason once, with its newest explanation."""
        new = [key for key, count in self.counts.items() if count != self._told[key]]
        self._told = self.counts.copy()
        return [Refusal(*key, self.words[key]) for key in new]

    def refused(self, stream: str) -> int:
        """How many messages of a stream were not used."""
        return sum(
            count
            for key, count in self.counts.items()
            if key[0] == stream and key not in self._used and key[1] not in _USED
        )

    def findings(self, received: Iterable[tuple[str, int]]) -> tuple[str, ...]:
        """Report streams of which many rows are refused, by the number of rows `received` for each."""
        found = []
        for name, rows in received:
            refused = self.refused(name)
            count = rows + sum(self.counts[name, reason] for reason in NO_ROW)
            if rows >= _ENOUGH and refused > _MANY * count:
                newest = [text for key, text in self.words.items() if key[0] == name][-1]
                found.append(
                    f"{name}: {refused / count:.0%} of the messages are refused (newest: {newest})"
                )
        return tuple(found)


# Of messages that gave the stream no row.
NO_ROW = ("no_value", "not_readable", "velocity_unit", "steering_unit")
# Reasons of streams that keep the message.
_USED = frozenset(["no_orientation", "load_not_positive", "time_jump", "in_steps"])
