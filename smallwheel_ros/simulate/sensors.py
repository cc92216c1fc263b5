# SPDX-License-Identifier: Apache-2.0
"""What the sensors of a rover make of the truth, and the rosbag2 bag that it would have recorded.

Rates, phases, delays, noise, gaps, outliers; then as messages.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from smallwheel_ros.bags import BagWriter, Message, Storage, header
from smallwheel_ros.simulate.terrain import GRAVITY, STANDS, Rover
from smallwheel_ros.simulate.truth import Array

if TYPE_CHECKING:
    from smallwheel_ros.simulate.drive import Drive, DriveSettings, WheelTruth

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


class Readings(SimpleNamespace):
    """Readings of one sensor: arrays, the first axis of each is time.

    stamp, log_time: when it was measured, and when recorded, ns since the epoch. Then, of

    - a wheel's load, in its frame: `normal` (N), positive when the soil pushes the wheel up; `pull` (N),
      what the soil pushes it forward with, thrust less resistance;
    - a wheel's sinkage: `sinkage` (m), positive down; `variance` (m^2); `outlier` marks gross errors;
    - odometry of a source other than the wheels (visual and inertial): `x`, `y`, `z` (m) and `roll`,
      `pitch`, `yaw` (rad) in odom, `forward_speed` (m/s) and `yaw_rate` (rad/s) in the base;
    - joints, shape (times, wheels), positive forward: `position` (rad), `velocity` (rad/s), `effort` (N m);
    - the imu, in base_link: `roll`, `pitch`, `yaw` of REP 103 (rad), `yaw_rate` (rad/s), and
      `acceleration`, what is felt (m/s^2), shape (times, 3).
    """


@dataclass(frozen=True)
class Sensors:
    """Reads a truth; each kind of reading has a random stream of its own, by the drive's seed."""

    truth: WheelTruth
    rover: Rover
    settings: DriveSettings

    def _stream(self, *purpose: int) -> np.random.Generator:
        return np.random.default_rng([self.settings.seed, *purpose])

    def _times(self, kind: str, rng: np.random.Generator) -> tuple[Array, Readings]:
        """When a sensor measures (s), and readings with nothing but their stamps."""
        end = self.truth.travel.time[-1]
        rate = _RATES[kind]
        count = int(end * rate) - 1
        time: Array = (np.arange(count, dtype=np.float64) + rng.uniform(0.0, 1.0)) / rate
        time = np.clip(time + rng.normal(0.0, _JITTER[kind], count), 0.0, end)
        shortest, more = _DELAYS[kind]
        recorded = time + shortest + rng.exponential(more, count)
        # One topic's messages arrive in their order.
        recorded = np.maximum.accumulate(recorded)
        return time, Readings(stamp=_stamp(time), log_time=_stamp(recorded))

    def _at(self, time: Array, values: Array) -> Array:
        """Values of the truth at other times; of wheels, shape (times, wheels), each by itself."""
        if values.ndim == 1:
            return np.interp(time, self.truth.travel.time, values)
        return np.stack([self._at(time, of_wheel) for of_wheel in values.T], axis=1)

    def load(self, wheel: int) -> Readings:
        """Read the force sensor of a wheel: noise 0.4 N and 1.2 % (1 sigma)."""
        rng, noise = self._stream(1, wheel), self.settings.noise
        time, found = self._times("load", rng)
        true = self._at(time, self.truth.load[:, wheel])
        spread = noise * np.hypot(0.4, 0.012 * true)
        # An unloaded sensor can show a little less than nothing; this one clips, as many do.
        found.normal = np.maximum(true + rng.normal(0.0, 1.0, time.size) * spread, 0.1)
        pull = self._at(time, self.truth.drawbar_pull[:, wheel])
        found.pull = pull + rng.normal(0.0, 1.0, time.size) * noise * 0.6
        keep = self._stream(2, wheel).uniform(size=time.size) >= self.settings.dropouts
        return _kept(found, keep)

    def sinkage(self, wheel: int) -> Readings:
        """Read the sinkage of a wheel: noise 0.5 mm and 3 % (1 sigma), below 0 too."""
        rng, noise = self._stream(3, wheel), self.settings.noise
        time, found = self._times("sinkage", rng)
        true = self._at(time, self.truth.sinkage[:, wheel])
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
        start = gaps.uniform(0.3, 0.9) * self.truth.travel.time[-1]
        if wheel == 1 and self.settings.dropouts > 0:
            keep &= (time < start) | (time > start + _GAP)
        # With its noise switched off an instrument still does not claim to be perfect.
        found.variance = np.hypot(0.5e-3, 0.03 * found.sinkage) ** 2 * max(noise, 0.1) ** 2
        return _kept(found, keep)

    def odometry(self) -> Readings:
        """Read the odometry: 8 mm/s (1 sigma) while moving, less when standing; the pose drifts."""
        rng, noise, trip = self._stream(6), self.settings.noise, self.truth.travel
        time, found = self._times("odometry", rng)
        speed = self._at(time, trip.speed)
        still = np.where(speed > 1e-3, 1.0, 0.4) * noise
        rate = self._at(time, trip.speed * trip.curvature)
        drift = np.cumsum(rng.normal(0.0, 2e-4, (2, time.size)) * still, axis=1)
        angles = rng.normal(0.0, 2e-3, (3, time.size)) * noise
        height = np.concatenate([[0.0], np.cumsum(np.diff(trip.way) * np.sin(trip.climb[1:]))])
        found.x = self._at(time, trip.x) + drift[0]
        found.y = self._at(time, trip.y) + drift[1]
        found.z = self._at(time, height)
        # REP 103: positive about x lifts the left side, positive about y lowers the nose.
        found.roll = self._at(time, trip.roll) + angles[0]
        found.pitch = -self._at(time, trip.climb) + angles[1]
        found.yaw = self._at(time, trip.heading) + angles[2]
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
        steps = np.diff(self.truth.travel.time, prepend=self.truth.travel.time[0])
        found.position = self._at(time, np.cumsum(omega * steps[:, None], axis=0))
        velocity = self._at(time, omega)
        spread = noise * np.hypot(0.01 * (velocity > 1e-3), 0.004 * velocity)
        found.velocity = velocity + rng.normal(0.0, 1.0, velocity.shape) * spread
        rng = self._stream(8)
        scale = 1.0 + noise * rng.normal(0.0, 0.03, len(self.rover.wheels))
        torque = self._at(time, self.truth.torque)
        turns = self._at(time, self.truth.rim[:, 0]) > STANDS
        friction = 0.05 * noise * turns[:, None]
        found.effort = (torque + friction) * scale + noise * rng.normal(0.0, 0.03, torque.shape)
        return found

    def imu(self) -> Readings:
        """Read the imu: angles 0.3 degrees off all the time and 0.2 more (1 sigma), 0.1 m/s^2."""
        rng, noise, trip = self._stream(9), self.settings.noise, self.truth.travel
        time, found = self._times("imu", rng)
        off = np.radians(0.3) * rng.normal(0.0, 1.0, (3, 1))
        wrong = noise * (off + np.radians(0.2) * rng.normal(0.0, 1.0, (3, time.size)))
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
        # REP 103, as above.
        found.roll = roll + wrong[0]
        found.pitch = -climb + wrong[1]
        found.yaw = self._at(time, trip.heading) + wrong[2]
        found.yaw_rate = rate + noise * rng.normal(0.0, 0.003, time.size)
        found.acceleration = felt + noise * rng.normal(0.0, 0.1, felt.shape)
        return found


def _stamp(time: Array) -> NDArray[np.int64]:
    return EPOCH + np.round(time * 1e9).astype(np.int64)


def _kept(readings: Readings, keep: NDArray[np.bool_]) -> Readings:
    return Readings(**{name: values[keep] for name, values in vars(readings).items()})


# --- The bag


class _Recorded(NamedTuple):
    log_time: int
    topic: str
    kind: str
    message: Message


def write_drive_bag(drive: Drive, path: Path | str, *, storage: Storage = "mcap") -> int:
    """Write the drive's readings as a bag in a new folder; return the number of messages.

    Topics: ``/<wheel>/load`` (geometry_msgs/WrenchStamped, 50 Hz: force.z positive when the soil
    pushes the wheel up, force.x what it pushes the wheel forward with), ``/<wheel>/sinkage``
    (smallwheel_ros/WheelSinkage, 10 Hz), ``/odom`` (nav_msgs/Odometry, 30 Hz, not from the wheels),
    ``/joint_states`` (sensor_msgs/JointState, 50 Hz, joints named ``<wheel>_joint``, effort in N m at
    the wheel) and ``/imu`` (sensor_msgs/Imu, 50 Hz, in base_link). Messages are recorded some
    milliseconds after the instant in their header.

    The folder appears when the bag is complete. A progress bar is shown on a terminal.

    Raises
    ------
    BagError
        If the folder exists, its parent does not, or it cannot be written.
    """
    with BagWriter(path, storage=storage) as writer:
        # Header stamps and log times do not depend on the order of topics here; ties do.
        messages = sorted(_messages(drive), key=lambda m: (m.log_time, m.topic))
        for m in tqdm(messages, "writing the bag", unit=" messages", disable=None, leave=False):
            writer.write(m.topic, m.kind, m.log_time, m.message)
    return len(messages)


def _messages(drive: Drive) -> Iterator[_Recorded]:
    wrench, joint_state = "geometry_msgs/msg/WrenchStamped", "sensor_msgs/msg/JointState"
    for wheel in (wheel.name for wheel in drive.rover.wheels):
        yield from _topic(f"/{wheel}/load", wrench, wheel, drive.load[wheel], _load)
        kind = "smallwheel_ros/msg/WheelSinkage"
        yield from _topic(f"/{wheel}/sinkage", kind, wheel, drive.sinkage[wheel], _sinkage)
    yield from _topic("/odom", "nav_msgs/msg/Odometry", "odom", drive.odometry, _odometry)
    names = [f"{wheel.name}_joint" for wheel in drive.rover.wheels]

    def joints(of: Readings, i: int) -> dict[str, Any]:
        states = {"position": of.position[i], "velocity": of.velocity[i], "effort": of.effort[i]}
        return {"name": names, **states}

    yield from _topic("/joint_states", joint_state, "", drive.joints, joints)
    yield from _topic("/imu", "sensor_msgs/msg/Imu", "base_link", drive.imu, _imu)


def _topic(
    topic: str,
    kind: str,
    frame: str,
    readings: Readings,
    fields: Callable[[Readings, int], dict[str, Any]],
) -> Iterator[_Recorded]:
    """Give a topic's messages. fields: those of a reading's message, besides its header."""
    times = zip(readings.stamp.tolist(), readings.log_time.tolist(), strict=True)
    for i, (stamp, log_time) in enumerate(times):
        message = Message(header=header(stamp, frame), **fields(readings, i))
        yield _Recorded(log_time, topic, kind, message)


def _vector(x: float, y: float, z: float) -> Message:
    return Message(x=float(x), y=float(y), z=float(z))


def _orientation(of: Readings, i: int) -> Message:
    """Quaternion of REP 103's fixed-axis roll, pitch, yaw (rad)."""
    angles = (of.roll[i], of.pitch[i], of.yaw[i])
    (sr, cr), (sp, cp), (sy, cy) = ((np.sin(a / 2), np.cos(a / 2)) for a in angles)
    return Message(
        x=float(sr * cp * cy - cr * sp * sy),
        y=float(cr * sp * cy + sr * cp * sy),
        z=float(cr * cp * sy - sr * sp * cy),
        w=float(cr * cp * cy + sr * sp * sy),
    )


def _covariance(*deviations: float) -> Array:
    """Row-major, three of each standard deviation: 6x6 of positions (m) and angles (rad), or 3x3."""
    return np.diag(np.repeat(np.square(deviations), 3)).ravel()


_POSE, _TWIST = _covariance(0.02, 0.002), _covariance(0.008, 0.005)
_ANGLE, _RATE, _FELT = _covariance(6e-3), _covariance(3e-3), _covariance(0.1)


def _load(of: Readings, i: int) -> dict[str, Any]:
    force = _vector(of.pull[i], 0.0, of.normal[i])
    return {"wrench": Message(force=force, torque=_vector(0.0, 0.0, 0.0))}


def _sinkage(of: Readings, i: int) -> dict[str, Any]:
    return {"sinkage": float(of.sinkage[i]), "variance": float(of.variance[i])}


def _odometry(of: Readings, i: int) -> dict[str, Any]:
    position = _vector(of.x[i], of.y[i], of.z[i])
    speed, rate = _vector(of.forward_speed[i], 0.0, 0.0), _vector(0.0, 0.0, of.yaw_rate[i])
    pose = Message(position=position, orientation=_orientation(of, i))
    return {
        "child_frame_id": "base_link",
        "pose": Message(pose=pose, covariance=_POSE),
        "twist": Message(twist=Message(linear=speed, angular=rate), covariance=_TWIST),
    }


def _imu(of: Readings, i: int) -> dict[str, Any]:
    return {
        "orientation": _orientation(of, i),
        "orientation_covariance": _ANGLE,
        "angular_velocity": _vector(0.0, 0.0, of.yaw_rate[i]),
        "angular_velocity_covariance": _RATE,
        "linear_acceleration": _vector(*of.acceleration[i]),
        "linear_acceleration_covariance": _FELT,
    }
