"""Where and how fast the vehicle was at an instant, from what the estimate is given."""

from __future__ import annotations

from typing import Any

from smallwheel_ros.onboard.feed import stamp_of
from smallwheel_ros.onboard.settings import OnboardSettings, VelocitySource
from smallwheel_ros.onboard.streams import Series, nanoseconds
from smallwheel_ros.physics.wheel import Wheel
from smallwheel_ros.replay.inputs import ODOMETRY_TYPE
from smallwheel_ros.replay.rows import Place


class Track:
    """Recent odometry and velocity: position, speed and yaw rate by stamp."""

    def __init__(self, settings: OnboardSettings) -> None:
        timing = settings.timing
        self._gap = nanoseconds(timing.maximum_gap)
        wait = max(timing.reorder_time, timing.silent_after) + timing.jump_tolerance
        self._own_velocity = settings.velocity is VelocitySource.TOPIC
        self._places, self._speeds = (Series(self._gap + nanoseconds(wait)) for _ in range(2))

    def add(self, kind: str, message: Any) -> None:
        """Take a message of odometry or velocity that the estimate has not refused."""
        stamp = stamp_of(message)
        twist = message.twist
        if kind == ODOMETRY_TYPE:
            twist, place = twist.twist, message.pose.pose.position
            self._places.add(stamp, (place.x, place.y))
        if self._own_velocity != (kind == ODOMETRY_TYPE):
            self._speeds.add(stamp, (twist.linear.x, twist.angular.z))

    def at(self, stamp: int, wheel: Wheel) -> Place:
        """Return the vehicle's position and the speed of a wheel's place at an instant (ns)."""
        place = self._places.at(stamp, self._gap)
        motion = self._speeds.at(stamp, self._gap)
        return Place(
            None if place is None else place[0],
            None if place is None else place[1],
            None if motion is None else motion[0] - motion[1] * wheel.lateral_position,
        )

    def clear(self) -> None:
        """Forget everything: time went back."""
        self._places.clear()
        self._speeds.clear()
