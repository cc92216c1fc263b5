"""How well the filter does, in numbers that somebody can watch over a drive."""

from __future__ import annotations

from collections import deque

from smallwheel_ros.estimator.soil_estimator import Outcome, UpdateResult

_RECENT = 200
_TOO_SURE, _TOO_MODEST = 2.0, 0.3  # mean of squared normalised innovations; 1 is right
_MANY_OUTLIERS = 0.2
_ENOUGH = 30  # updates before anything is said


class FilterHealth:
    """The newest 200 updates: squared innovation over its variance, and how many were outliers.

    A filter whose model and noise are right has a mean of 1; spot after spot of one soil, so that
    a few times the usual scatter of a mean of 200 is not yet a reason for concern.
    """

    def __init__(self) -> None:
        self._squares: deque[float] = deque(maxlen=_RECENT)
        self._outliers: deque[bool] = deque(maxlen=_RECENT)

    def add(self, update: UpdateResult) -> None:
        """Take what became of a measurement."""
        if update.outcome is Outcome.REFUSED or update.normalised_innovation_squared is None:
            return
        outlier = update.outcome is Outcome.OUTLIER
        self._outliers.append(outlier)
        if not outlier:
            self._squares.append(update.normalised_innovation_squared)

    def reset(self) -> None:
        """Forget everything."""
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
        mean = self.mean_square
        if self.count < _ENOUGH or mean is None:
            return ""
        if self.outlier_share > _MANY_OUTLIERS:
            return (
                f"{self.outlier_share:.0%} of the newest {self.count} sinkages do not fit: a sensor,"
                " or physics that the model lacks"
            )
        if mean > _TOO_SURE:
            return (
                f"innovations are larger than they should be (mean square {mean:.1f}, expected 1):"
                " noise parameters too small, or physics that the model lacks"
            )
        if mean < _TOO_MODEST:
            return (
                f"innovations are smaller than they should be (mean square {mean:.2f}, expected 1):"
                " noise parameters too large, standard deviations too"
            )
        return ""
