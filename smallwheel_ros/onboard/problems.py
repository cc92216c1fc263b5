# SPDX-License-Identifier: Apache-2.0
"""What could not be used: counted by stream and reason, and put in words, with the unit that explains it.

And whether what was used is as the filter expects it.
"""

from __future__ import annotations

import math
from collections import Counter, defaultdict, deque
from dataclasses import dataclass, field
from statistics import median
from typing import NamedTuple

from smallwheel_ros.estimator.law_model import LARGEST
from smallwheel_ros.estimator.reading import Outcome, UpdateResult

_KEPT = 1000
_MEMORY = 50  # messages of a stream over which the share of the refused is averaged
_ENOUGH = 20  # messages before anything is said of it
_MANY = 0.2
_RATIOS = 20
_NEARLY = 3.0  # a factor within which a unit explains how far values are off what was expected

# What a number in this unit is over the same in SI units.
_UNITS = {
    "load": {"kg": 1.0 / 9.80665, "kN": 1e-3, "lbf": 0.224809, "mN": 1e3},
    "sinkage": {"mm": 1e3, "cm": 1e2, "inches": 39.3701, "um": 1e6},
    "speed": {"mm/s": 1e3, "cm/s": 1e2, "km/h": 3.6},
    "wheel_speed": {"degrees/s": 57.2958, "rpm": 9.5493, "turns/s": 0.159155},
}


class Problem(NamedTuple):
    """Something that could not be used: of which stream, a key to count by, and in words."""

    stream: str
    reason: str
    text: str


@dataclass
class _Stream:
    """How much of a stream is refused lately, what of it in words, and by how much it was off."""

    messages: int = 0
    refused: float = 0.0
    text: str = ""
    log_ratios: deque[float] = field(default_factory=lambda: deque(maxlen=_RATIOS))

    def take(self, refused: bool) -> None:
        """Count a message."""
        self.messages += 1
        self.refused += (float(refused) - self.refused) / min(self.messages, _MEMORY)


class ProblemLog:
    """Counts since the start (`counts`, by stream and reason), and the words of what is new.

    rejected: measured sinkages that were refused, for whatever reason; whoever starts
    the soil over sets it to 0.
    """

    def __init__(self) -> None:
        self.rejected = 0
        self.counts: Counter[tuple[str, str]] = Counter()
        self._new: deque[Problem] = deque(maxlen=_KEPT)
        self._streams: defaultdict[str, _Stream] = defaultdict(_Stream)

    def good(self, stream: str) -> None:
        """Note a message that was used."""
        self._streams[stream].take(False)

    def add(
        self,
        stream: str,
        reason: str,
        text: str,
        *,
        unused: bool = True,
        outlier: bool = False,
        ratio: float | None = None,
    ) -> None:
        """Note a problem; the words of all but the newest 1000 are forgotten.

        unused: the message was not used because of it. outlier: it might be good, and only did not fit: on
        another soil many do not. ratio: what it shows, over what was expected.
        """
        self.counts[stream, reason] += 1
        self.rejected += unused and not outlier and stream.endswith("/sinkage")
        self._new.append(Problem(stream, reason, text))
        if not unused or outlier:
            return
        of_stream = self._streams[stream]
        of_stream.take(True)
        of_stream.text = text
        if ratio is not None and 0.0 < ratio < math.inf:
            of_stream.log_ratios.append(math.log(ratio))

    def take(self) -> list[Problem]:
        """Give what is new since the last call."""
        taken = list(self._new)
        self._new.clear()
        return taken

    @property
    def findings(self) -> tuple[str, ...]:
        """Streams of which much is refused, in words, with the unit that would explain it."""
        found = []
        for name, stream in self._streams.items():
            if stream.messages < _ENOUGH or stream.refused <= _MANY:
                continue
            words = f"{name}: {stream.refused:.0%} of the newest messages are refused"
            if stream.log_ratios:
                ratio = math.exp(median(stream.log_ratios))
                unit = unit_of(ratio, name.rpartition("/")[2], _NEARLY)
                times, guess = (ratio, "") if unit is None else (unit[0], f": in {unit[1]}?")
                words += f", as if values were {times:.4g} times too large{guess}"
            found.append(f"{words} (newest: {stream.text})")
        return tuple(found)


def unit_of(ratio: float, quantity: str, factor: float = 1.05) -> tuple[float, str] | None:
    """What a unit is over that of SI, and its name, where it explains a ratio within a factor.

    quantity: as streams are called.
    """
    units = _UNITS.get(quantity, {})
    if not units or not ratio > 0.0:
        return None
    name, value = min(units.items(), key=lambda unit: abs(math.log(ratio / unit[1])))
    return (value, name) if abs(math.log(ratio / value)) <= math.log(factor) else None


# ---- whether the filter fits

_RECENT = 200
_TOO_SURE, _TOO_MODEST = 2.0, 0.15  # mean of squared normalised innovations; 1 is right
_MANY_OUTLIERS = 0.2
_ENOUGH_UPDATES = 30  # before anything is said


class FilterHealth:
    """The newest 200 updates: squared innovation over its variance, how many were outliers or refused.

    A filter whose model and noise are right has a mean of 1. Readings on one stretch have the ground's part
    of the innovation in common, and a wheel that stands shows one and the same: squares are of the first
    reading on each stretch, the newest 100 of them.
    """

    def __init__(self) -> None:
        self._squares: deque[float] = deque(maxlen=_RECENT // 2)
        self._outliers: deque[bool] = deque(maxlen=_RECENT)
        self._refused: deque[bool] = deque(maxlen=_RECENT)

    def add(self, update: UpdateResult, elsewhere: bool = True) -> None:
        """Take what became of a measurement. elsewhere: its wheel has come to another stretch."""
        self._refused.append(update.outcome is Outcome.REFUSED)
        if update.outcome is Outcome.REFUSED or update.normalised_innovation_squared is None:
            return
        outlier = update.outcome is Outcome.OUTLIER
        self._outliers.append(outlier)
        if elsewhere and not outlier:
            # A border shows some that are huge until it is found: they count as in the filter.
            self._squares.append(min(update.normalised_innovation_squared, LARGEST))

    def forget(self) -> None:
        """Another soil was found, which is what did not fit lately."""
        self._squares.clear()
        self._outliers.clear()

    @property
    def count(self) -> int:
        """How many updates this is about."""
        return len(self._outliers)

    @property
    def mean_square(self) -> float | None:
        """Mean of the squared normalised innovations of those used; None where there is none."""
        return sum(self._squares) / len(self._squares) if self._squares else None

    @property
    def outlier_share(self) -> float:
        """Share of outliers, 0 .. 1."""
        return sum(self._outliers) / len(self._outliers) if self._outliers else 0.0

    @property
    def concern(self) -> str:
        """What is wrong, in words; empty where nothing is."""
        mean, refused = self.mean_square, sum(self._refused) / max(len(self._refused), 1)
        if len(self._refused) >= _ENOUGH_UPDATES and refused > _MANY_OUTLIERS:
            return (
                f"{refused:.0%} of the newest {len(self._refused)} sinkages are refused, so the soil is"
                " hardly measured: see the sensors"
            )
        if self.count >= _ENOUGH_UPDATES and self.outlier_share > _MANY_OUTLIERS:
            return (
                f"{self.outlier_share:.0%} of the newest {self.count} sinkages do not fit: a sensor,"
                " or physics that the model lacks"
            )
        if mean is None or len(self._squares) < _ENOUGH_UPDATES:
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
