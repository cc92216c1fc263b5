# SPDX-License-Identifier: Apache-2.0
"""A fitted law, and which of those that a search found is drafted."""

from __future__ import annotations

from dataclasses import dataclass

from smallwheel_ros.fitting.constants import TIE
from smallwheel_ros.fitting.fit import Fit
from smallwheel_ros.learn.law import SOUGHT, Law


@dataclass(frozen=True)
class Candidate:
    """A fitted law. cost: nats of its description. score: these and those of its errors."""

    law: Law
    fit: Fit
    cost: float
    score: float

    @property
    def length(self) -> float:
        """Nats of its formula, wherever it acts, but for what all have in common."""
        return self.cost - self.law.place.nats

    @property
    def numbers(self) -> dict[str, float]:
        """Its strengths and constants."""
        places = self.fit.vector.places(SOUGHT)
        return {self.fit.vector.free[j].field: float(self.fit.theta[j]) for j in places}


@dataclass(frozen=True)
class Found:
    """The base and the laws, the best first. base_score: of the base by the same yardstick."""

    base: Fit
    base_score: float
    laws: tuple[Candidate, ...]

    @property
    def gain(self) -> float:
        """Nats by which the best law shortens the description."""
        return self.base_score - self.laws[0].score if self.laws else 0.0

    @property
    def tied(self) -> tuple[Candidate, ...]:
        """Laws that do as well as the best."""
        return tuple(c for c in self.laws if c.score < self.laws[0].score + TIE)

    @property
    def draft(self) -> Candidate | None:
        """Of the tied laws one of fewest drivers, of these the shortest formula; None where none gains.

        Its place does not count: how rare a place is has been counted in the score that ties them.
        """
        if self.gain <= 0.0:
            return None
        return min(self.tied, key=lambda c: (c.law.weight, round(c.length, 6), c.score))
