"""What the sensors said lately of a vehicle, and what of it belongs to one instant of a wheel."""

from __future__ import annotations

import math

from smallwheel_ros.onboard.instant import Instant
from smallwheel_ros.onboard.settings import OnboardSettings, VelocitySource
from smallwheel_ros.onboard.streams import Motion, Odometer, Series, nanoseconds
from smallwheel_ros.physics.conditions import PRESSED, ROLLING
from smallwheel_ros.physics.wheel import Quantity, wheel_slip


class Memory:
    """Recent loads, wheel speeds, odometry and velocity; wheels go by their number.

    Attributes
    ----------
    loads, pulls, speeds, sinkages
        One series for each wheel; of the sinkages only the stamps.
    odometer, velocity
        Of the vehicle; velocity is that of a sensor of its own: speed and yaw rate.
    needed
        For each wheel the series that its measurements are put together from.
    timing
        For each wheel the series that gives it its instants.
    distance
        Way so far, m.

    Parameters
    ----------
    distance
        Way before anything that is kept here, m.
    """

    def __init__(self, settings: OnboardSettings, distance: float = 0.0) -> None:
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
        self.odometer = Odometer(horizon, self._gap, settings.standstill_speed)
        self.velocity = Series(horizon)
        self._static = [settings.static_loads.get(wheel.name) for wheel in wheels]
        self.distance = self._before = distance
        self._deepest = [0.0] * len(self.settings.wheels)
        self._pressed_way = 0.0
        self.needed = tuple(self._needed(order) for order in range(len(wheels)))
        self.timing = tuple(self._timed_by(order) for order in range(len(wheels)))

    def _needed(self, order: int) -> tuple[Series, ...]:
        series = [] if self._static[order] is not None else [self.loads[order]]
        if self.settings.wheels[order].name in self.settings.with_drawbar_pull:
            series.append(self.pulls[order])
        if self.settings.wheels[order].contact == ROLLING:
            series += [self.odometer.series, self.speeds[order]]
            if self.settings.velocity is VelocitySource.TOPIC:
                series.append(self.velocity)
        return tuple(series)

    def _timed_by(self, order: int) -> Series:
        if self.settings.wheels[order].name not in self.settings.without_sinkage:
            return self.sinkages[order]
        return self.odometer.series if self._static[order] is not None else self.loads[order]

    def instant(self, order: int, stamp: int, measured: float | None, variance: float) -> Instant:
        """Put together what belongs to a wheel's instant; call it in the order of stamps."""
        wheel, noise = self.settings.wheels[order], self.settings.noise
        load = self._static[order]
        loads = self.loads[order].at(stamp, self._gap)
        if loads is not None:
            load = Quantity(loads[0], math.hypot(noise.load, noise.load_relative * loads[0]))
        motion = self.odometer.at(stamp, self._gap)
        speed, slip = self._motion(order, stamp, motion)
        sinkage: Quantity | None = None
        if measured is not None:
            known = math.isfinite(variance) and variance > 0
            deviation = math.sqrt(variance) if known else self.settings.estimator.sinkage_std
            sinkage = Quantity(measured, deviation)
        pull = self.pulls[order].at(stamp, self._gap)
        return Instant(
            wheel,
            stamp,
            load,
            slip,
            sinkage,
            speed,
            self._travelled(order, stamp, sinkage),
            None if motion is None else self._place(order, motion),
            self._static[order] is not None,
            None if motion is None else (motion.x, motion.y),
            None if pull is None else Quantity(pull[0], noise.drawbar_pull),
        )

    def _motion(
        self, order: int, stamp: int, motion: Motion | None
    ) -> tuple[float | None, Quantity | None]:
        """Speed of a wheel's place over ground, and its slip; None where not known."""
        wheel, noise = self.settings.wheels[order], self.settings.noise
        if wheel.contact != ROLLING:
            return None, None
        found: tuple[float, ...] | None = None if motion is None else motion[2:4]
        if self.settings.velocity is VelocitySource.TOPIC:
            found = self.velocity.at(stamp, self._gap)
        if found is None:
            return None, None
        speed = found[0] - found[1] * wheel.lateral_position
        turning = self.speeds[order].at(stamp, self._gap)
        if turning is None or self.settings.velocity is VelocitySource.NONE:
            return speed, None
        rim = turning[0] * wheel.diameter / 2
        slip = wheel_slip(
            Quantity(speed, noise.speed),
            Quantity(rim, noise.wheel_speed_relative * abs(rim)),
            self.settings.standstill_speed,
        )
        return speed, slip

    def _place(self, order: int, motion: Motion) -> tuple[float, float] | None:
        yaw = motion.yaw
        if yaw is None:
            return None
        ahead = self.settings.wheels[order].longitudinal_position
        left = self.settings.wheels[order].lateral_position
        cosine, sine = math.cos(yaw), math.sin(yaw)
        return motion.x + cosine * ahead - sine * left, motion.y + sine * ahead + cosine * left

    def _travelled(self, order: int, stamp: int, sinkage: Quantity | None) -> float:
        """Way so far (m), which never falls: soil that is new to the wheels."""
        if sinkage is not None and self.settings.wheels[order].contact == PRESSED:
            # A pressed wheel meets new soil by going deeper than it has been.
            self._pressed_way += max(0.0, sinkage.value - self._deepest[order])
            self._deepest[order] = max(self._deepest[order], sinkage.value)
        way = self._before + self.odometer.way(stamp) + self._pressed_way
        self.distance = max(self.distance, way)
        return self.distance
