"""Joints that turn the other way: a mirrored axis, or the wrong joint."""

from __future__ import annotations

from smallwheel_ros.onboard.instant import Instant

_PATH = 0.5  # m of the wheel's own path on which it turned against its travel throughout
_RATIO = 0.3  # of rim speed over speed: less may be a wheel that is locked


class JointWatch:
    """Follows how far each wheel has travelled while it turned against its travel."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
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
        return against >= _PATH

    @property
    def findings(self) -> tuple[str, ...]:
        """In words, with what to check."""
        return tuple(
            f"wheel '{name}': its joint has turned against the travel for {path:.1f} m: the axis is"
            f" mirrored, or it is another joint (parameters {name}.joint_sign, {name}.joint)"
            for name, path in self._against.items()
            if path >= _PATH
        )
