"""What the sensors said lately of a vehicle, and what of it belongs to one instant of a wheel."""

from __future__ import annotations

import math

from smallwheel_ros.onboard.instant import Instant
from smallwheel_ros.onboard.settings import OnboardSettings, VelocitySource
from smallwheel_ros.onboard.streams import Motion, PathSeries, Series, StampFault, nanoseconds
from smallwheel_ros.physics.conditions import PRESSED, ROLLING
from smallwheel_ros.physics.wheel import Quantity, wheel_slip


class Memory:
    """Recent loads, wheel speeds, odometry and velocity; wheels go by their number.

    Attributes
    ----------
    loads, pulls, speeds, sinkages
        One series for each wheel; of the sinkages only the stamps.
    odometry, velocity
        Of the vehicle; velocity is that of a sensor of its own: speed of its place, yaw rate (NaN
        where it does not measure that), and variance of the speed.
    needed
        For each wheel the series that its measurements are put together from.
    timing
        For each wheel the series that gives it its instants.
    distance
        Path of the vehicle so far, m.
    paths
        Path of each wheel so far, m: turning on the spot counts.

    Parameters
    ----------
    before
        What was kept before: paths go on from there.
    """

    def __init__(self, settings: OnboardSettings, before: Memory | None = None) -> None:
        self.settings = settings
        timing = settings.timing
        self._gap = nanoseconds(timing.maximum_gap)
        longest_wait = max(timing.reorder_time, timing.silent_after)
        horizon = nanoseconds(longest_wait + timing.maximum_gap + timing.jump_tolerance)
        wheels = settings.wheels
        self.loads = [Series(horizon) for _ in wheels]
        self.pulls = [Series(horizon) for _ in wheels]
        self.speeds = [Series(horizon) for _ in wheels]
        self.sinkages = [Series(horizon) for _ in wheels]
        self.odometry = Series(horizon)
        self.velocity = Series(horizon)
        # Paths come from the same source as slip: the vehicle's, then those of the wheels.
        self._travel = [
            PathSeries(horizon, self._gap, settings.standstill_speed) for _ in (None, *wheels)
        ]
        self._static = [settings.static_loads.get(wheel.name) for wheel in wheels]
        self.distance: float = 0.0 if before is None else before.distance
        self.paths: list[float] = [0.0] * len(wheels) if before is None else list(before.paths)
        self._start = [self.distance, *self.paths]
        self._deepest = [0.0] * len(wheels)
        self._pressed_path = 0.0
        self.needed = tuple(self._needed(order) for order in range(len(wheels)))
        self.timing = tuple(self._timed_by(order) for order in range(len(wheels)))

    def _needed(self, order: int) -> tuple[Series, ...]:
        series = [] if self._static[order] is not None else [self.loads[order]]
        if self.settings.wheels[order].name in self.settings.with_drawbar_pull:
            series.append(self.pulls[order])
        if self.settings.wheels[order].contact == ROLLING:
            series += [self.odometry, self.speeds[order]]
            if self.settings.velocity is VelocitySource.TOPIC:
                series.append(self.velocity)
        return tuple(series)

    def _timed_by(self, order: int) -> Series:
        if self.settings.wheels[order].name not in self.settings.without_sinkage:
            return self.sinkages[order]
        return self.odometry if self._static[order] is not None else self.loads[order]

    def add_odometry(self, stamp: int, motion: Motion) -> StampFault | None:
        """Keep an odometry; a fault says why it was not kept."""
        fault = self.odometry.add(stamp, motion)
        if fault is None and self.settings.velocity is not VelocitySource.TOPIC:
            self._travelled(stamp, motion.speed, motion.yaw_rate, motion.x, motion.y)
        return fault

    def add_velocity(
        self, stamp: int, speed: float, yaw_rate: float, variance: float
    ) -> StampFault | None:
        """Keep a measured velocity; yaw_rate NaN: not measured. A fault says why it was not kept."""
        fault = self.velocity.add(stamp, (speed, yaw_rate, variance))
        if fault is None:
            middle, turning, _ = self._velocity(speed, yaw_rate, variance, self._motion_at(stamp))
            self._travelled(stamp, middle, turning)
        return fault

    def _travelled(
        self, stamp: int, speed: float, yaw_rate: float, x: float = math.nan, y: float = math.nan
    ) -> None:
        self._travel[0].add(stamp, speed, x, y)
        for path, wheel in zip(self._travel[1:], self.settings.wheels, strict=True):
            path.add(stamp, speed - yaw_rate * wheel.lateral_position, x, y)

    def _motion_at(self, stamp: int) -> Motion | None:
        values = self.odometry.at(stamp, self._gap)
        return None if values is None else Motion(*values)

    def _velocity(
        self, speed: float, yaw_rate: float, variance: float, motion: Motion | None
    ) -> tuple[float, float, float]:
        """Speed of the vehicle's middle, yaw rate, and variance of the speed.

        A sensor that is beside the middle moves with v_x = v - omega y.
        """
        if math.isnan(yaw_rate):
            yaw_rate = 0.0 if motion is None else motion.yaw_rate
        return speed + yaw_rate * self.settings.velocity_lateral_position, yaw_rate, variance

    def instant(self, order: int, stamp: int, measured: float | None, variance: float) -> Instant:
        """Put together what belongs to a wheel's instant; call it in the order of stamps."""
        wheel, noise = self.settings.wheels[order], self.settings.noise
        load = self._static[order]
        loads = self.loads[order].at(stamp, self._gap)
        if loads is not None:
            load = Quantity(loads[0], math.hypot(noise.load, noise.load_relative * loads[0]))
        motion = self._motion_at(stamp)
        speed, rim, slip = self._moves(order, stamp, motion)
        sinkage: Quantity | None = None
        if measured is not None:
            known = math.isfinite(variance) and variance > 0
            deviation = math.sqrt(variance) if known else self.settings.estimator.sinkage_std
            sinkage = Quantity(measured, deviation)
        pull = self.pulls[order].at(stamp, self._gap)
        self._advance(order, stamp, sinkage)
        return Instant(
            wheel,
            stamp,
            load,
            slip,
            sinkage,
            speed,
            self.distance,
            self.paths[order],
            None if motion is None else self._place(order, motion),
            self._static[order] is not None,
            None if motion is None else (motion.x, motion.y),
            None if pull is None else Quantity(pull[0], noise.drawbar_pull),
            0.0 if motion is None else motion.pitch,
            rim,
        )

    def _moves(
        self, order: int, stamp: int, motion: Motion | None
    ) -> tuple[float | None, float | None, Quantity | None]:
        """Speed of a wheel's place over ground, of its rim, and its slip; None where not known."""
        wheel, noise = self.settings.wheels[order], self.settings.noise
        if wheel.contact != ROLLING:
            return None, None, None
        if self.settings.velocity is VelocitySource.TOPIC:
            measured = self.velocity.at(stamp, self._gap)
            if measured is None:
                return None, None, None
            middle, yaw_rate, variance = self._velocity(
                measured[0], measured[1], measured[2], motion
            )
        elif motion is None:
            return None, None, None
        else:
            middle, yaw_rate = motion.speed, motion.yaw_rate
            variance = motion.speed_variance
            variance += motion.yaw_rate_variance * wheel.lateral_position**2
        speed = middle - yaw_rate * wheel.lateral_position
        turning = self.speeds[order].at(stamp, self._gap)
        if turning is None or self.settings.velocity is VelocitySource.NONE:
            return speed, None, None
        rim = turning[0] * wheel.diameter / 2
        slip = wheel_slip(
            Quantity(speed, math.sqrt(variance) if variance > 0.0 else noise.speed),
            Quantity(rim, noise.wheel_speed_relative * abs(rim)),
            self.settings.standstill_speed,
        )
        return speed, rim, slip

    def _place(self, order: int, motion: Motion) -> tuple[float, float] | None:
        yaw = motion.yaw
        if yaw is None:
            return None
        ahead = self.settings.wheels[order].longitudinal_position
        left = self.settings.wheels[order].lateral_position
        cosine, sine = math.cos(yaw), math.sin(yaw)
        return motion.x + cosine * ahead - sine * left, motion.y + sine * ahead + cosine * left

    def _advance(self, order: int, stamp: int, sinkage: Quantity | None) -> None:
        """Paths so far (m), which never fall."""
        if sinkage is not None and self.settings.wheels[order].contact == PRESSED:
            # A pressed wheel meets new soil by going deeper than it has been.
            self._pressed_path += max(0.0, sinkage.value - self._deepest[order])
            self._deepest[order] = max(self._deepest[order], sinkage.value)
        vehicle, own = (
            self._start[i] + self._travel[i].at(stamp) + self._pressed_path for i in (0, order + 1)
        )
        self.distance = max(self.distance, vehicle)
        self.paths[order] = max(self.paths[order], own)
