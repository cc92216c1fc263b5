# SPDX-License-Identifier: Apache-2.0
"""What is watched of each wheel and of the filter beside the estimate, and said in words."""

from __future__ import annotations

from collections import deque

from smallwheel_ros.estimator.law_model import LARGEST
from smallwheel_ros.estimator.soil_estimator import Outcome, UpdateResult
from smallwheel_ros.onboard.instant import Instant
from smallwheel_ros.onboard.settings import DiggingInRules
from smallwheel_ros.onboard.streams import nanoseconds

_ORDINARY_SLIP = 0.3  # up to here driving is ordinary
_MEMORY = 20  # measurements over which ordinary driving is averaged
_NO_DOUBT = 0.8  # slip that needs no ordinary speed to compare with
_RECENT = 200
_TOO_SURE, _TOO_MODEST = 2.0, 0.15  # mean of squared normalised innovations; 1 is right
_MANY_OUTLIERS = 0.2
_ENOUGH = 30  # updates before anything is said


class DiggingInAlarm:
    """The alarm that a wheel digs itself in: slip up, sinkage up, speed over ground down.

    What is up and down is told by ordinary driving: the wheel's sinkage and speed while its slip was
    small. All three have to hold at once, for some time; slip alone is a slippery patch, sinkage alone
    a softer soil, and a low speed alone a driver who takes it easy.

    Of one wheel; feed it every instant of that wheel in the order of time.
    """

    def __init__(self, rules: DiggingInRules) -> None:
        self.rules = rules
        self.on = False
        self._sinkage: float | None = None
        self._speed: float | None = None
        self._since: int | None = None

    def update(self, instant: Instant) -> bool:
        """Take an instant; return whether the wheel digs itself in.

        An instant without slip, speed or measured sinkage changes nothing: a wheel that was stopped
        while it dug in still stands in its hole.
        """
        if instant.slip is None or instant.sinkage is None or instant.speed is None:
            return self.on
        slip, sinkage, speed = instant.slip.value, instant.sinkage.value, abs(instant.speed)
        if slip <= _ORDINARY_SLIP:
            self._sinkage = _averaged(self._sinkage, sinkage)
            self._speed = _averaged(self._speed, speed)
            self._since, self.on = None, False
            return False
        if self._sinkage is None:
            self._sinkage = sinkage
        if not self._digs(slip, sinkage, instant.sinkage.standard_deviation, speed):
            self._since = None
            # Between ordinary driving and digging an alarm stays as it is.
            return self.on
        if self._since is None:
            self._since = instant.stamp
        self.on |= instant.stamp - self._since >= nanoseconds(self.rules.time)
        return self.on

    def _digs(self, slip: float, sinkage: float, noise: float, speed: float) -> bool:
        assert self._sinkage is not None
        rise = max(self.rules.sinkage_rise * self._sinkage, 2.0 * noise)
        slow = slip >= _NO_DOUBT
        if self._speed is not None:
            slow = speed <= (1.0 - self.rules.speed_drop) * self._speed
        return slip >= self.rules.slip and slow and sinkage >= self._sinkage + rise


def _averaged(mean: float | None, value: float) -> float:
    return value if mean is None else mean + (value - mean) / _MEMORY


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
        if len(self._refused) >= _ENOUGH and refused > _MANY_OUTLIERS:
            return (
                f"{refused:.0%} of the newest {len(self._refused)} sinkages are refused, so the soil is"
                " hardly measured: see the sensors"
            )
        if self.count >= _ENOUGH and self.outlier_share > _MANY_OUTLIERS:
            return (
                f"{self.outlier_share:.0%} of the newest {self.count} sinkages do not fit: a sensor,"
                " or physics that the model lacks"
            )
        if mean is None or len(self._squares) < _ENOUGH:
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
