# SPDX-License-Identifier: Apache-2.0
"""What could not be used, in words, and whether what was used is as the filter expects it."""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from smallwheel_ros.pipeline.soil.stretches import Stretches

from .tables import Array

_ENOUGH, _MANY = 20, 0.2  # messages before anything is reported of a stream; share that is refused
_RECENT, _ENOUGH_STRETCHES = 100, 30  # stretches; before anything is reported
_TOO_SURE, _TOO_MODEST = 2.0, 0.15  # mean of squared normalised innovations; 1 is right
_LARGEST = 25.0  # a border shows some that are huge until it is found


class Refusal(NamedTuple):
    """Something that could not be used: of which stream, a key to count by, and in words."""

    stream: str
    reason: str
    text: str


class ProblemLog:
    """Counts since the start, by stream and reason, and the words of what is new.

    counts: all. words: an example of each. used: reasons that let the message be used all the same.
    """

    def __init__(self, counts: Counter[tuple[str, str]], words: dict[tuple[str, str], str]) -> None:
        self.counts, self.words = counts, words
        self._told: Counter[tuple[str, str]] = Counter()
        self._used: set[tuple[str, str]] = set()

    def add(
        self, stream: str, reason: str, text: str, times: int = 1, *, unused: bool = True
    ) -> None:
        """Count something of a stream or a topic."""
        self.counts[stream, reason] += times
        self.words[stream, reason] = text
        if not unused:
            self._used.add((stream, reason))

    def take(self) -> list[Refusal]:
        """Give what is new since the last call: each stream and reason once, with its newest words."""
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
        """Streams of which much is refused, in words."""
        found = []
        for name, count in received:
            refused = self.refused(name)
            if count >= _ENOUGH and refused > _MANY * count:
                newest = [text for key, text in self.words.items() if key[0] == name][-1]
                found.append(
                    f"{name}: {refused / count:.0%} of the messages are refused (newest: {newest})"
                )
        return tuple(found)


# Reasons of streams that keep the message.
_USED = frozenset(["no_orientation", "load_not_positive", "time_jump"])


class FilterHealth:
    """The newest 100 stretches: squared innovation over its variance, and readings left out of their means.

    A filter whose model and noise are right has a mean of 1.
    """

    def __init__(self) -> None:
        self._squares: deque[float] = deque(maxlen=_RECENT)
        self._readings: deque[tuple[int, int]] = deque(maxlen=_RECENT)

    def add(self, rows: Stretches, squares: Array) -> None:
        """Take stretches; squares: of their innovations, NaN where the law is not settled."""
        self._readings.extend(zip(rows.count.tolist(), rows.dropped.tolist(), strict=True))
        self._squares.extend(np.minimum(squares[np.isfinite(squares)], _LARGEST).tolist())

    def forget(self) -> None:
        """Another soil was found, which is what did not fit lately."""
        self._squares.clear()
        self._readings.clear()

    @property
    def count(self) -> int:
        """How many readings this is about."""
        return sum(map(sum, self._readings))

    @property
    def mean_square(self) -> float | None:
        """Mean of the squared normalised innovations; None where there is none."""
        return sum(self._squares) / len(self._squares) if self._squares else None

    @property
    def outlier_share(self) -> float:
        """Share of readings that were left out, 0 .. 1."""
        return sum(dropped for _, dropped in self._readings) / max(self.count, 1)

    @property
    def concern(self) -> str:
        """What is wrong, in words; empty where nothing is."""
        mean = self.mean_square
        if len(self._readings) >= _ENOUGH_STRETCHES and self.outlier_share > _MANY:
            return (
                f"{self.outlier_share:.0%} of the newest {self.count} sinkages do not fit: a sensor,"
                " or physics that the model lacks"
            )
        if mean is None or len(self._squares) < _ENOUGH_STRETCHES or not math.isfinite(mean):
            return ""
        if mean > _TOO_SURE:
            return (
                f"innovations are larger than they should be (mean square {mean:.1f}, expected 1):"
                " noise parameters too small, or physics that the model lacks"
            )
        if mean < _TOO_MODEST and len(self._squares) == self._squares.maxlen:
            return (
                f"innovations are smaller than they should be (mean square {mean:.2f}, expected 1):"
                " noise parameters too large, standard deviations too"
            )
        return ""
