"""Joints that turn the other way: a mirrored axis, or the wrong joint."""

from __future__ import annotations

from dataclasses import dataclass

from smallwheel_ros.onboard.instant import Instant

_PATH = 0.5  # m of the wheel's own path on which it turned against its travel throughout
_RATIO = 0.3  # of rim speed over speed: less may be a wheel that is locked


@dataclass
class _Track:
    last: float
    against: float = 0.0


class JointWatch:
    """Follows how far each wheel has travelled while it turned against its travel."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self._tracks: dict[str, _Track] = {}

    def is_mirrored(self, instant: Instant) -> bool:
        """Take an instant; return whether its wheel's joint turns the other way."""
        track = self._tracks.setdefault(instant.wheel.name, _Track(instant.path))
        step = max(instant.path - track.last, 0.0)
        track.last = instant.path
        speed, rim = instant.speed, instant.rim_speed
        if instant.slip is not None and speed is not None and rim is not None:
            against = rim * speed < -_RATIO * speed * speed
            track.against = track.against + step if against else 0.0
        return track.against >= _PATH

    @property
    def findings(self) -> tuple[str, ...]:
        """In words, with what to check."""
        return tuple(
            f"wheel '{name}': its joint has turned against the travel for {track.against:.1f} m: the "
            f"axis is mirrored, or it is another joint (parameters {name}.joint_sign, {name}.joint)"
            for name, track in self._tracks.items()
            if track.against >= _PATH
        )
