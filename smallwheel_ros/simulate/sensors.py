# SPDX-License-Identifier: Apache-2.0
"""What the sensors of a rover make of the truth: rates, phases, delays, noise, gaps, outliers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.simulate.contact import Array
from smallwheel_ros.simulate.ride import WheelTruth
from smallwheel_ros.simulate.rover import GRAVITY, STANDS, Rover

Nanoseconds = NDArray[np.int64]

# 2025-06-12 09:30:00 UTC: drives start at one fixed instant, so that a seed gives the same bytes.
EPOCH = 1_749_720_600 * 10**9

_RATES = {"load": 50.0, "sinkage": 10.0, "odometry": 30.0, "joints": 50.0, "imu": 50.0}
# Shortest and typical further delay between measurement and recording (s).
_DELAYS = {
    "load": (0.002, 0.002),
    "sinkage": (0.055, 0.015),
    "odometry": (0.015, 0.005),
    "joints": (0.002, 0.001),
    "imu": (0.002, 0.001),
}
_JITTER = {"load": 0.0003, "sinkage": 0.002, "odometry": 0.001, "joints": 0.0003, "imu": 0.0003}
_GAP = 1.5  # s


@dataclass(frozen=True)
class Readings:
    """When something was measured, and when it was recorded: ns since the epoch."""

    stamp: Nanoseconds
    log_time: Nanoseconds


@dataclass(frozen=True)
class LoadReadings(Readings):
    """Of one wheel, in its frame: `normal` positive when the soil pushes the wheel up, N.

    `pull` is what the soil pushes the wheel forward with, thrust less resistance, N.
    """

    normal: Array
    pull: Array


@dataclass(frozen=True)
class SinkageReadings(Readings):
    """Of one wheel; sinkage in m, positive down, variance in m^2; `outlier` marks gross errors."""

    sinkage: Array
    variance: Array
    outlier: NDArray[np.bool_]


@dataclass(frozen=True)
class OdometryReadings(Readings):
    """Of a source other than the wheels (visual and inertial): pose in odom, twist in base."""

    x: Array
    y: Array
    z: Array
    roll: Array
    pitch: Array
    yaw: Array
    forward_speed: Array
    yaw_rate: Array


@dataclass(frozen=True)
class JointReadings(Readings):
    """All wheels at once, shape (times, wheels): rad, rad/s and N m, positive forward."""

    position: Array
    velocity: Array
    effort: Array


@dataclass(frozen=True)
class ImuReadings(Readings):
    """In base_link: angles of REP 103 (rad), and what is felt (m/s^2), shape (times, 3)."""

    roll: Array
    pitch: Array
    yaw: Array
    yaw_rate: Array
    acceleration: Array


class Sensors:
    """Reads a truth; each kind of reading has a random stream of its own, by the drive's seed.

    noise, outliers, dropouts: as the settings of a drive have them.
    """

    def __init__(
        self,
        truth: WheelTruth,
        rover: Rover,
        seed: int,
        *,
        noise: float,
        outliers: float,
        dropouts: float,
    ) -> None:
        self.truth, self.rover, self._seed = truth, rover, seed
        self.noise, self.outliers, self.dropouts = noise, outliers, dropouts

    def _stream(self, *purpose: int) -> np.random.Generator:
        return np.random.default_rng([self._seed, *purpose])

    def _times(self, kind: str, rng: np.random.Generator) -> tuple[Array, Nanoseconds, Nanoseconds]:
        end = self.truth.travel.time[-1]
        rate = _RATES[kind]
        count = int(end * rate) - 1
        time: Array = (np.arange(count, dtype=np.float64) + rng.uniform(0.0, 1.0)) / rate
        time = np.clip(time + rng.normal(0.0, _JITTER[kind], count), 0.0, end)
        shortest, more = _DELAYS[kind]
        recorded = time + shortest + rng.exponential(more, count)
        # One topic's messages arrive in their order.
        recorded = np.maximum.accumulate(recorded)
        return time, _stamp(time), _stamp(recorded)

    def _at(self, time: Array, values: Array) -> Array:
        return np.interp(time, self.truth.travel.time, values)

    def load(self, wheel: int) -> LoadReadings:
        """Read the force sensor of a wheel: noise 0.4 N and 1.2 % (1 sigma)."""
        rng = self._stream(1, wheel)
        time, stamp, log_time = self._times("load", rng)
        true = self._at(time, self.truth.load[:, wheel])
        spread = self.noise * np.hypot(0.4, 0.012 * true)
        # An unloaded sensor can show a little less than nothing; this one clips, as many do.
        normal = np.maximum(true + rng.normal(0.0, 1.0, time.size) * spread, 0.1)
        pull = self._at(time, self.truth.drawbar_pull[:, wheel])
        pull = pull + rng.normal(0.0, 1.0, time.size) * self.noise * 0.6
        keep = self._stream(2, wheel).uniform(size=time.size) >= self.dropouts
        return LoadReadings(stamp[keep], log_time[keep], normal[keep], pull[keep])

    def sinkage(self, wheel: int) -> SinkageReadings:
        """Read the sinkage of a wheel: noise 0.5 mm and 3 % (1 sigma), below 0 too."""
        rng = self._stream(3, wheel)
        time, stamp, log_time = self._times("sinkage", rng)
        true = self._at(time, self.truth.sinkage[:, wheel])
        spread = self.noise * np.hypot(0.5e-3, 0.03 * true)
        read = true + rng.normal(0.0, 1.0, time.size) * spread
        wild = self._stream(4, wheel)
        outlier = wild.uniform(size=time.size) < self.outliers
        # Wrong matches of the camera: several times too deep, or somewhere on the rut's rim.
        gross = np.where(
            wild.uniform(size=time.size) < 0.5,
            true * wild.uniform(2.5, 5.0, time.size),
            true + wild.uniform(0.015, 0.040, time.size),
        )
        read = np.where(outlier, gross, read)
        gaps = self._stream(5, wheel)
        keep = gaps.uniform(size=time.size) >= self.dropouts
        start = gaps.uniform(0.3, 0.9) * self.truth.travel.time[-1]
        if wheel == 1 and self.dropouts > 0:
            keep &= (time < start) | (time > start + _GAP)
        # With its noise switched off an instrument still does not claim to be perfect.
        variance = np.hypot(0.5e-3, 0.03 * read) ** 2 * max(self.noise, 0.1) ** 2
        return SinkageReadings(
            stamp[keep], log_time[keep], read[keep], variance[keep], outlier[keep]
        )

    def odometry(self) -> OdometryReadings:
        """Read the odometry: 8 mm/s (1 sigma) while moving, less when standing; the pose drifts."""
        rng = self._stream(6)
        trip = self.truth.travel
        time, stamp, log_time = self._times("odometry", rng)
        speed = self._at(time, trip.speed)
        still = np.where(speed > 1e-3, 1.0, 0.4) * self.noise
        rate = self._at(time, trip.speed * trip.curvature)
        drift = np.cumsum(rng.normal(0.0, 2e-4, (2, time.size)) * still, axis=1)
        angles = rng.normal(0.0, 2e-3, (3, time.size)) * self.noise
        height = np.concatenate([[0.0], np.cumsum(np.diff(trip.way) * np.sin(trip.climb[1:]))])
        return OdometryReadings(
            stamp,
            log_time,
            x=self._at(time, trip.x) + drift[0],
            y=self._at(time, trip.y) + drift[1],
            z=self._at(time, height),
            # REP 103: positive about x lifts the left side, positive about y lowers the nose.
            roll=self._at(time, trip.roll) + angles[0],
            pitch=-self._at(time, trip.climb) + angles[1],
            yaw=self._at(time, trip.heading) + angles[2],
            forward_speed=speed + rng.normal(0.0, 0.008, time.size) * still,
            yaw_rate=rate + rng.normal(0.0, 0.005, time.size) * still,
        )

    def joints(self) -> JointReadings:
        """Read the wheel encoders: 0.4 % and 0.01 rad/s (1 sigma); and what the motors say.

        Their torque is 3 % off in scale, another for each motor; it holds 0.05 N m of friction.
        """
        rng = self._stream(7)
        time, stamp, log_time = self._times("joints", rng)
        radius = np.array([wheel.diameter / 2 for wheel in self.rover.wheels])
        omega = self.truth.rim / radius
        steps = np.diff(self.truth.travel.time, prepend=self.truth.travel.time[0])
        turned = np.cumsum(omega * steps[:, None], axis=0)
        wheels = range(len(self.rover.wheels))
        velocity = np.stack([self._at(time, omega[:, j]) for j in wheels], axis=1)
        spread = self.noise * np.hypot(0.01 * (velocity > 1e-3), 0.004 * velocity)
        return JointReadings(
            stamp,
            log_time,
            position=np.stack([self._at(time, turned[:, j]) for j in wheels], axis=1),
            velocity=velocity + rng.normal(0.0, 1.0, velocity.shape) * spread,
            effort=self._effort(time),
        )

    def _effort(self, time: Array) -> Array:
        """Read the torque of the motors, shape (times, wheels), N m."""
        rng, count = self._stream(8), len(self.rover.wheels)
        scale = 1.0 + self.noise * rng.normal(0.0, 0.03, count)
        true = np.stack([self._at(time, self.truth.torque[:, j]) for j in range(count)], axis=1)
        turns = self._at(time, self.truth.rim[:, 0]) > STANDS
        friction = 0.05 * self.noise * turns[:, None]
        noise = self.noise * rng.normal(0.0, 0.03, true.shape)
        return np.asarray((true + friction) * scale + noise)

    def imu(self) -> ImuReadings:
        """Read the imu: angles 0.3 degrees off all the time and 0.2 more (1 sigma), 0.1 m/s^2."""
        rng, trip = self._stream(9), self.truth.travel
        time, stamp, log_time = self._times("imu", rng)
        off = np.radians(0.3) * rng.normal(0.0, 1.0, (3, 1))
        wrong = self.noise * (off + np.radians(0.2) * rng.normal(0.0, 1.0, (3, time.size)))
        climb, roll = self._at(time, trip.climb), self._at(time, trip.roll)
        rate = self._at(time, trip.speed * trip.curvature)
        turning = self._at(time, trip.speed) * rate
        felt = np.stack(
            [
                GRAVITY * np.sin(climb) + self._at(time, trip.acceleration),
                GRAVITY * np.cos(climb) * np.sin(roll) + turning,
                GRAVITY * np.cos(climb) * np.cos(roll),
            ],
            axis=1,
        )
        return ImuReadings(
            stamp,
            log_time,
            # REP 103: positive about x lifts the left side, positive about y lowers the nose.
            roll=roll + wrong[0],
            pitch=-climb + wrong[1],
            yaw=self._at(time, trip.heading) + wrong[2],
            yaw_rate=rate + self.noise * rng.normal(0.0, 0.003, time.size),
            acceleration=felt + self.noise * rng.normal(0.0, 0.1, felt.shape),
        )


def _stamp(time: Array) -> Nanoseconds:
    return EPOCH + np.round(time * 1e9).astype(np.int64)
