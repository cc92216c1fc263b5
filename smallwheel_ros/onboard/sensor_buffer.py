"""What the sensors said lately of a vehicle, and what of it belongs to one instant of a wheel."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from smallwheel_ros.estimator.traction import GRAVITY
from smallwheel_ros.onboard.instant import Instant, Motion, drives_forward
from smallwheel_ros.onboard.settings import IMU, ODOMETRY, VELOCITY, OnboardSettings
from smallwheel_ros.onboard.sources import VelocitySource
from smallwheel_ros.onboard.streams import SECOND, Series, StampFault, Travel, nanoseconds
from smallwheel_ros.physics.conditions import PRESSED, ROLLING
from smallwheel_ros.physics.wheel import Quantity, wheel_slip

_GAINING = nanoseconds(0.4)  # over which the vehicle's acceleration is taken


class Stream(Series):
    """The recent values of what comes by one name, `<wheel>/load`, `odom`, ...

    order: number of the wheel. predicts: numbers of the wheels without sinkage sensor that this
    gives their instants.
    """

    def __init__(self, name: str, horizon: int, order: int = -1) -> None:
        super().__init__(horizon)
        self.name, self.order = name, order
        self.kind = name.rpartition("/")[2]
        self.predicts: list[int] = []


class WheelState:
    """A wheel with its streams, and how far it has come.

    needed: streams that its instants are put together from. timing: the stream that gives them.
    path: travelled so far, m. answered: stamp of the newest instant (ns). deepest: sinkage so far, m.
    """

    def __init__(
        self, settings: OnboardSettings, order: int, odometry: Stream, velocity: Stream, imu: Stream
    ) -> None:
        self.wheel = wheel = settings.wheels[order]
        self.streams = [
            Stream(f"{wheel.name}/{kind}", odometry.horizon, order)
            for kind in ("load", "sinkage", "drawbar_pull", "wheel_speed", "torque")
        ]
        self.load, self.sinkage, self.drawbar_pull, self.wheel_speed, self.torque = self.streams
        self.static_load = settings.static_loads.get(wheel.name)
        self.needed = [] if self.static_load is not None else [self.load]
        if wheel.name in settings.with_drawbar_pull:
            self.needed.append(self.drawbar_pull)
        if wheel.contact == ROLLING:
            self.needed += [odometry, self.wheel_speed]
            if settings.velocity is VelocitySource.TOPIC:
                self.needed.append(velocity)
            if settings.with_imu:
                self.needed.append(imu)
            if wheel.name in settings.with_torque:
                self.needed.append(self.torque)
        self.timing = self.sinkage
        if wheel.name in settings.without_sinkage:
            self.timing = self.load if self.static_load is None else odometry
            self.timing.predicts.append(order)
        self.path = self.deepest = 0.0
        self.answered = 0


class _Vehicle(NamedTuple):
    """The vehicle at a stamp (ns); None where not known.

    middle: speed (m/s), yaw rate (rad/s) and variance of the speed by the velocity sensor.
    specific_force: see `Instant`, positive forward. paths: of the vehicle, then of the wheels, m.
    """

    stamp: int
    motion: Motion | None
    middle: tuple[float, float, float] | None
    specific_force: float | None
    paths: Sequence[float]


class SensorBuffer:
    """Recent values of all streams of a vehicle; wheels go by their number.

    Parameters
    ----------
    before
        What was kept before: paths and answers go on from there.

    Attributes
    ----------
    streams
        By name.
    wheels
        In the order of the settings.
    distance
        Path of the vehicle so far, m.
    """

    def __init__(self, settings: OnboardSettings, before: SensorBuffer | None = None) -> None:
        self.settings = settings
        timing = settings.timing
        self._gap = nanoseconds(timing.maximum_gap)
        longest_wait = max(timing.reorder_time, timing.silent_after)
        horizon = nanoseconds(longest_wait + timing.maximum_gap + timing.jump_tolerance)
        odometry, velocity, imu = (Stream(name, horizon) for name in (ODOMETRY, VELOCITY, IMU))
        self._odometry, self._velocity, self._imu = odometry, velocity, imu
        self._pitches: bool = before is not None and before._pitches
        self._velocity_turns: bool = before is not None and before._velocity_turns
        order = range(len(settings.wheels))
        self.wheels = [WheelState(settings, i, odometry, velocity, imu) for i in order]
        self.distance: float = 0.0
        if before is not None:
            self.distance = before.distance
            for state, old in zip(self.wheels, before.wheels, strict=True):
                state.path, state.answered = old.path, old.answered
        streams = [stream for state in self.wheels for stream in state.streams]
        self.streams = {stream.name: stream for stream in (odometry, velocity, imu, *streams)}
        # Paths come from the same source as slip: the vehicle's, then those of the wheels.
        by_topic = settings.velocity is VelocitySource.TOPIC
        self._travel_source = velocity if by_topic else odometry
        lateral = (0.0, *(wheel.lateral_position for wheel in settings.wheels))
        self._start = (self.distance, *(state.path for state in self.wheels))
        self._travel = Travel(horizon, self._gap, settings.standstill_speed, lateral, self._start)
        self._pressed_path = 0.0
        self._vehicle: _Vehicle | None = None  # at the instant that was asked for last

    def add(self, stream: Stream, stamp: int, values: Sequence[float]) -> StampFault | None:
        """Keep values, and the travel that they show; a fault says why they were not kept."""
        if stream is self._velocity:
            # A yaw rate of exactly 0 in every message so far is none: then odometry's is used.
            speed, yaw_rate, variance = values
            self._velocity_turns = self._velocity_turns or yaw_rate != 0.0
            values = (speed, yaw_rate if self._velocity_turns else math.nan, variance)
        fault = stream.add(stamp, tuple(values))
        if stream is self._odometry:
            # An odometry of the plane has a pitch of exactly 0 in every message: it measures none.
            self._pitches = self._pitches or Motion(*values).pitch != 0.0
        if fault is None and stream is self._travel_source:
            if stream is self._velocity:
                values = self._middle(values, self._motion(stamp))[:2]
            self._travel.move(stamp, *values[:4])
        self._vehicle = None
        return fault

    def instant(self, order: int, stamp: int, measured: Sequence[float]) -> Instant:
        """Put together what belongs to a wheel's instant; call it in the order of stamps.

        measured: its sinkage (m) and variance (m^2, not known where it is not over 0), if any.
        """
        state, noise, gap = self.wheels[order], self.settings.noise, self._gap
        vehicle = self._vehicle
        if vehicle is None or vehicle.stamp != stamp:
            vehicle = self._vehicle = self._at(stamp)
        motion = vehicle.motion
        load, pull = state.load.at(stamp, gap), state.drawbar_pull.at(stamp, gap)
        torque = state.torque.at(stamp, gap)
        carried = state.static_load
        if load is not None:
            carried = Quantity(load[0], math.hypot(noise.load, noise.load_relative * load[0]))
        speed, rim, slip = None, None, None
        if state.wheel.contact == ROLLING:
            speed, rim, slip = self._moves(state, vehicle)
        forward = drives_forward(speed, rim)
        sinkage = None
        if measured:
            value, variance = measured
            known = math.isfinite(variance) and variance > 0
            deviation = math.sqrt(variance) if known else self.settings.estimator.sinkage_std
            sinkage = Quantity(value, deviation)
        self._advance(state, order, vehicle, sinkage)
        return Instant(
            state.wheel,
            stamp,
            carried,
            slip,
            sinkage,
            speed,
            self.distance,
            state.path,
            None if motion is None else motion.place(state.wheel),
            state.static_load is not None,
            None if motion is None else (motion.x, motion.y),
            None if pull is None else Quantity(pull[0], noise.drawbar_pull),
            0.0 if motion is None else motion.pitch,
            rim,
            _signed(vehicle.specific_force, forward),
            _signed(None if torque is None else torque[0], forward),
            forward,
        )

    def _at(self, stamp: int) -> _Vehicle:
        """What all wheels have in common at an instant."""
        motion, velocity = self._motion(stamp), self._velocity.at(stamp, self._gap)
        middle: tuple[float, float, float] | None = None
        if self.settings.velocity is VelocitySource.TOPIC:
            middle = None if velocity is None else self._middle(velocity, motion)
            series = self._velocity
        else:
            series = self._odometry
        force = self._specific_force(stamp, motion, series)
        return _Vehicle(stamp, motion, middle, force, self._travel.at(stamp) or self._start)

    def _specific_force(self, stamp: int, motion: Motion | None, speeds: Stream) -> float | None:
        """What the wheels pull per mass, m/s^2, positive forward: of slope, and of gaining speed."""
        measured = self._imu.at(stamp, self._gap)
        if measured is not None and math.isnan(measured[0]):
            return measured[1]  # an accelerometer feels both
        slope: float | None = None if measured is None else measured[0]
        if not self.settings.with_imu and motion is not None and self._pitches:
            slope = -GRAVITY * math.sin(motion.pitch)
        if slope is None:
            return None
        now, before = speeds.at(stamp, self._gap), speeds.at(stamp - _GAINING, self._gap)
        if now is None or before is None:
            return None
        return slope + (now[0] - before[0]) / (_GAINING / SECOND)

    def _motion(self, stamp: int) -> Motion | None:
        values = self._odometry.at(stamp, self._gap)
        return None if values is None else Motion(*values)

    def _middle(
        self, velocity: Sequence[float], motion: Motion | None
    ) -> tuple[float, float, float]:
        """Speed of the vehicle's middle, yaw rate, and variance of the speed, by the velocity sensor.

        A sensor that is beside the middle moves with v_x = v - omega y.
        """
        speed, yaw_rate, variance = velocity
        if math.isnan(yaw_rate):
            yaw_rate = 0.0 if motion is None else motion.yaw_rate
        return speed + yaw_rate * self.settings.velocity_lateral_position, yaw_rate, variance

    def _moves(
        self, state: WheelState, vehicle: _Vehicle
    ) -> tuple[float | None, float | None, Quantity | None]:
        """Speed of a wheel's place over ground, of its rim, and its slip; None where not known."""
        wheel, noise, source = state.wheel, self.settings.noise, self.settings.velocity
        lateral, motion = wheel.lateral_position, vehicle.motion
        if source is VelocitySource.TOPIC:
            if vehicle.middle is None:
                return None, None, None
            middle, yaw_rate, variance = vehicle.middle
        elif motion is None:
            return None, None, None
        else:
            middle, yaw_rate = motion.speed, motion.yaw_rate
            variance = motion.speed_variance + motion.yaw_rate_variance * lateral**2
        speed = middle - yaw_rate * lateral
        turning = state.wheel_speed.at(vehicle.stamp, self._gap)
        if turning is None or source is VelocitySource.NONE:
            return speed, None, None
        rim = turning[0] * wheel.diameter / 2
        slip = wheel_slip(
            Quantity(speed, math.sqrt(variance) if variance > 0.0 else noise.speed),
            Quantity(rim, noise.wheel_speed_relative * abs(rim)),
            self.settings.standstill_speed,
        )
        return speed, rim, slip

    def _advance(
        self, state: WheelState, order: int, vehicle: _Vehicle, sinkage: Quantity | None
    ) -> None:
        """Paths so far (m), which never fall."""
        if sinkage is not None and state.wheel.contact == PRESSED:
            # A pressed wheel meets new soil by going deeper than it has been.
            self._pressed_path += max(0.0, sinkage.value - state.deepest)
            state.deepest = max(state.deepest, sinkage.value)
        self.distance = max(self.distance, vehicle.paths[0] + self._pressed_path)
        state.path = max(state.path, vehicle.paths[1 + order] + self._pressed_path)
        state.answered = vehicle.stamp


def _signed(value: float | None, forward: bool) -> float | None:
    """What is positive forward, as positive the way the wheel drives."""
    return value if forward or value is None else -value
