# SPDX-License-Identifier: Apache-2.0
"""What is watched of each wheel, joint and filter beside the estimate, and said in words."""

from __future__ import annotations

from collections import deque

from smallwheel_ros.estimator.soil_estimator import Outcome, UpdateResult
from smallwheel_ros.onboard.instant import Instant
from smallwheel_ros.onboard.settings import DiggingInRules
from smallwheel_ros.onboard.streams import nanoseconds

_AGAINST = 0.5  # m of the wheel's own path on which it turned against its travel throughout
_RATIO = 0.3  # of rim speed over speed: less may be a wheel that is locked
_ORDINARY_SLIP = 0.3  # up to here driving is ordinary
_MEMORY = 20  # measurements over which ordinary driving is averaged
_NO_DOUBT = 0.8  # slip that needs no ordinary speed to compare with
_RECENT = 200
_TOO_SURE, _TOO_MODEST = 2.0, 0.3  # mean of squared normalised innovations; 1 is right
_MANY_OUTLIERS = 0.2
_ENOUGH = 30  # updates before anything is said


class JointWatch:
    """Joints that turn the other way: a mirrored axis, or the wrong joint.

    Follows how far each wheel has travelled while it turned against its travel.
    """

    def __init__(self) -> None:
        self._last: dict[str, float] = {}  # path of each wheel, m
        self._against: dict[str, float] = {}  # and of that against its travel, without a break

    def is_mirrored(self, instant: Instant) -> bool:
        """Take an instant; return whether its wheel's joint turns the other way."""
        name, speed, rim = instant.wheel.name, instant.speed, instant.rim_speed
        against = self._against.get(name, 0.0)
        if instant.slip is not None and speed is not None and rim is not None:
            step = max(instant.path - self._last.get(name, instant.path), 0.0)
            against = against + step if rim * speed < -_RATIO * speed * speed else 0.0
        self._last[name], self._against[name] = instant.path, against
        return against >= _AGAINST

    @property
    def findings(self) -> tuple[str, ...]:
        """In words, with what to check."""
        return tuple(
            f"wheel '{name}': its joint has turned against the travel for {path:.1f} m: the axis is"
            f" mirrored, or it is another joint (parameters {name}.joint_sign, {name}.joint)"
            for name, path in self._against.items()
            if path >= _AGAINST
        )


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
