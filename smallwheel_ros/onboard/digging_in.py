"""The alarm that a wheel digs itself in: slip up, sinkage up, speed over ground down.

What is up and down is told by ordinary driving: the wheel's sinkage and speed while its slip was
small. All three have to hold at once, for some time; slip alone is a slippery patch, sinkage alone
a softer soil, and a low speed alone a driver who takes it easy.
"""

from __future__ import annotations

from smallwheel_ros.onboard.instant import Instant
from smallwheel_ros.onboard.settings import DiggingInRules
from smallwheel_ros.onboard.streams import nanoseconds

_ORDINARY_SLIP = 0.3  # up to here driving is ordinary
_MEMORY = 20  # measurements over which ordinary driving is averaged
_NO_DOUBT = 0.8  # slip that needs no ordinary speed to compare with


class DiggingInAlarm:
    """The alarm of one wheel; feed it every instant of that wheel in the order of time."""

    def __init__(self, rules: DiggingInRules) -> None:
        self.rules = rules
        self.reset()

    def reset(self) -> None:
        """Forget what ordinary driving is like; no alarm."""
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
