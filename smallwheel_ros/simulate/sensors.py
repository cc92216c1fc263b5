# SPDX-License-Identifier: Apache-2.0
"""What the sensors of a rover make of the truth: rates, phases, delays, noise, gaps, outliers."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from smallwheel_ros.simulate.drive_settings import DriveSettings
from smallwheel_ros.simulate.truth import Array
from smallwheel_ros.simulate.vehicle import TICK, Truth, stamps_of
from smallwheel_ros.simulate.world import Rover

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
_STANDS = 1e-3  # m/s, below which nothing moves


class Readings(SimpleNamespace):
    """Readings of one sensor: arrays, the first axis of each is time.

    stamp, log_time: when it was measured, and when recorded, ns since the epoch. Then, of

    - a wheel's load, in its frame: `normal` (N), positive when the soil pushes the wheel up; `pull` (N),
      what the soil pushes it forward with, thrust less resistance;
    - a wheel's sinkage: `sinkage` (m), positive down; `variance` (m^2); `outlier` marks gross errors;
    - odometry of a source other than the wheels (visual and inertial): `x`, `y`, `z` (m) and
      `orientation` in odom, `forward_speed` (m/s) and `yaw_rate` (rad/s) in the base;
    - joints, shape (times, wheels), positive forward: `position` (rad), `velocity` (rad/s), `effort` (N m);
    - the imu, in base_link: `orientation`, `yaw_rate` (rad/s), and `acceleration`, what is felt
      (m/s^2), shape (times, 3).

    An orientation is a quaternion, x, y, z, w, shape (times, 4).
    """


@dataclass(frozen=True)
class Sensors:
    """Reads a truth; each kind of reading has a random stream of its own, by the drive's seed."""

    truth: Truth
    rover: Rover
    settings: DriveSettings

    def _stream(self, *purpose: int) -> np.random.Generator:
        return np.random.default_rng([self.settings.seed, *purpose])

    def _times(self, kind: str, rng: np.random.Generator) -> tuple[Array, Readings]:
        """When a sensor measures (s), and readings with nothing but their stamps."""
        end = self.truth.time[-1]
        rate = _RATES[kind]
        count = int(end * rate) - 1
        time: Array = (np.arange(count, dtype=np.float64) + rng.uniform(0.0, 1.0)) / rate
        time = np.clip(time + rng.normal(0.0, _JITTER[kind], count), 0.0, end)
        shortest, more = _DELAYS[kind]
        recorded = time + shortest + rng.exponential(more, count)
        # One topic's messages arrive in their order.
        recorded = np.maximum.accumulate(recorded)
        return time, Readings(stamp=stamps_of(time), log_time=stamps_of(recorded))

    def _orientation(self, time: Array, wrong: Array) -> Array:
        """How the rover stands, with errors of roll, pitch and yaw (rad), shape (3, times).

        REP 103: positive about x lifts the left side, positive about y lowers the nose.
        """
        truth = self.truth
        angles = wrong + [self.truth.at(time, one) for one in (truth.roll, -truth.climb, truth.yaw)]
        turned: Array = Rotation.from_euler("xyz", angles.T).as_quat()
        return turned

    def load(self, wheel: int) -> Readings:
        """Read the force sensor of a wheel: noise 0.4 N and 1.2 % (1 sigma)."""
        rng, noise = self._stream(1, wheel), self.settings.noise
        time, found = self._times("load", rng)
        true = self.truth.at(time, self.truth.load[:, wheel])
        spread = noise * np.hypot(0.4, 0.012 * true)
        # An unloaded sensor can show a little less than nothing; this one clips, as many do.
        found.normal = np.maximum(true + rng.normal(0.0, 1.0, time.size) * spread, 0.1)
        pull = self.truth.at(time, self.truth.pull[:, wheel])
        found.pull = pull + rng.normal(0.0, 1.0, time.size) * noise * 0.6
        keep = self._stream(2, wheel).uniform(size=time.size) >= self.settings.dropouts
        return _kept(found, keep)

    def sinkage(self, wheel: int) -> Readings:
        """Read the sinkage of a wheel: noise 0.5 mm and 3 % (1 sigma), below 0 too."""
        rng, noise = self._stream(3, wheel), self.settings.noise
        time, found = self._times("sinkage", rng)
        true = self.truth.at(time, self.truth.sinkage[:, wheel])
        spread = noise * np.hypot(0.5e-3, 0.03 * true)
        read = true + rng.normal(0.0, 1.0, time.size) * spread
        wild = self._stream(4, wheel)
        found.outlier = wild.uniform(size=time.size) < self.settings.outliers
        # Wrong matches of the camera: several times too deep, or somewhere on the rut's rim.
        gross = np.where(
            wild.uniform(size=time.size) < 0.5,
            true * wild.uniform(2.5, 5.0, time.size),
            true + wild.uniform(0.015, 0.040, time.size),
        )
        found.sinkage = np.where(found.outlier, gross, read)
        gaps = self._stream(5, wheel)
        keep = gaps.uniform(size=time.size) >= self.settings.dropouts
        start = gaps.uniform(0.3, 0.9) * self.truth.time[-1]
        if wheel == 1 and self.settings.dropouts > 0:
            keep &= (time < start) | (time > start + _GAP)
        # With its noise switched off an instrument still does not claim to be perfect.
        found.variance = np.hypot(0.5e-3, 0.03 * found.sinkage) ** 2 * max(noise, 0.1) ** 2
        return _kept(found, keep)

    def odometry(self) -> Readings:
        """Read the odometry: 8 mm/s (1 sigma) while moving, less when standing; the pose drifts."""
        rng, noise, truth = self._stream(6), self.settings.noise, self.truth
        time, found = self._times("odometry", rng)
        speed = self.truth.at(time, truth.speed)
        still = np.where(speed > 1e-3, 1.0, 0.4) * noise
        rate = self.truth.at(time, truth.rate)
        drift = np.cumsum(rng.normal(0.0, 2e-4, (2, time.size)) * still, axis=1)
        angles = rng.normal(0.0, 2e-3, (3, time.size)) * noise
        x, y, height = truth.course
        found.x = self.truth.at(time, x) + drift[0]
        found.y = self.truth.at(time, y) + drift[1]
        found.z = self.truth.at(time, height)
        found.orientation = self._orientation(time, angles)
        found.forward_speed = speed + rng.normal(0.0, 0.008, time.size) * still
        found.yaw_rate = rate + rng.normal(0.0, 0.005, time.size) * still
        return found

    def joints(self) -> Readings:
        """Read the wheel encoders: 0.4 % and 0.01 rad/s (1 sigma); and what the motors say.

        Their torque is 3 % off in scale, another for each motor; it holds 0.05 N m of friction.
        """
        rng, noise = self._stream(7), self.settings.noise
        time, found = self._times("joints", rng)
        radius = np.array([wheel.diameter / 2 for wheel in self.rover.wheels])
        omega = self.truth.rim / radius
        found.position = self.truth.at(time, np.cumsum(omega * TICK, axis=0))
        velocity = self.truth.at(time, omega)
        spread = noise * np.hypot(0.01 * (velocity > 1e-3), 0.004 * velocity)
        found.velocity = velocity + rng.normal(0.0, 1.0, velocity.shape) * spread
        rng = self._stream(8)
        scale = 1.0 + noise * rng.normal(0.0, 0.03, len(self.rover.wheels))
        torque = self.truth.at(time, self.truth.torque)
        turns = np.abs(self.truth.at(time, self.truth.rim)) > _STANDS
        friction = 0.05 * noise * turns
        found.effort = (torque + friction) * scale + noise * rng.normal(0.0, 0.03, torque.shape)
        return found

    def imu(self) -> Readings:
        """Read the imu: angles 0.3 degrees off all the time and 0.2 more (1 sigma), 0.1 m/s^2."""
        rng, noise, truth = self._stream(9), self.settings.noise, self.truth
        time, found = self._times("imu", rng)
        off = np.radians(0.3) * rng.normal(0.0, 1.0, (3, 1))
        wrong = noise * (off + np.radians(0.2) * rng.normal(0.0, 1.0, (3, time.size)))
        felt = truth.felt(time)
        found.orientation = self._orientation(time, wrong)
        found.yaw_rate = truth.at(time, truth.rate) + noise * rng.normal(0.0, 0.003, time.size)
        found.acceleration = felt + noise * rng.normal(0.0, 0.1, felt.shape)
        return found


def _kept(readings: Readings, keep: NDArray[np.bool_]) -> Readings:
    return Readings(**{name: values[keep] for name, values in vars(readings).items()})
