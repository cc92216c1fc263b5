# SPDX-License-Identifier: Apache-2.0
"""The pipeline with a method for each kind of reading, for tests that give numbers and no messages."""

from __future__ import annotations

from smallwheel_ros.onboard.onboard import Onboard
from smallwheel_ros.onboard.result import Result
from smallwheel_ros.onboard.streams import Motion


class Given(Onboard):
    """`Onboard`, given its readings one by one; stamps and `now` in ns, the rest in SI units."""

    def on_load(
        self, wheel: str, stamp: int, load: float, *, now: int | None = None
    ) -> list[Result]:
        return self.add(stamp, [(f"{wheel}/load", (load,))], now)

    def on_wheel_speed(
        self, wheel: str, stamp: int, speed: float, *, now: int | None = None
    ) -> list[Result]:
        return self.add(stamp, [(f"{wheel}/wheel_speed", (speed,))], now)

    def on_sinkage(
        self, wheel: str, stamp: int, value: float, variance: float = 0.0, *, now: int | None = None
    ) -> list[Result]:
        return self.add(stamp, [(f"{wheel}/sinkage", (value, variance))], now)

    def on_odometry(
        self,
        stamp: int,
        x: float,
        y: float,
        speed: float,
        yaw_rate: float = 0.0,
        yaw: float | None = None,
        *,
        pitch: float = 0.0,
        variances: tuple[float, float] = (0.0, 0.0),
        now: int | None = None,
    ) -> list[Result]:
        motion = Motion.of(x, y, speed, yaw_rate, yaw, pitch, variances)
        return self.add(stamp, [("odom", motion)], now)
