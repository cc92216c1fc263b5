# SPDX-License-Identifier: Apache-2.0
"""Sensor readings of a world's vehicle from the truth: stamps (ns since 1970) and values, by stream.

Columns are those of the library's streams, SI units. `odom` has speed, yaw rate, x, y, cosine and sine of
the yaw, variances of the first two (0: not stated), pitch and roll, and, for a rover that steers, the
speed to the left. `imu` has yaw rate, specific force (ahead, left, up), the direction of up (likewise; NaN
where there is no orientation) and pitch rate. `WHEEL/sinkage` has sinkage and its variance; `WHEEL/load`,
`WHEEL/drawbar_pull`, `WHEEL/wheel_speed`, `WHEEL/steering` and `WHEEL/torque` have one column each.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from smallwheel_ros.simulate.truth import Array
from smallwheel_ros.simulate.vehicle import TICK, Truth, stamps_of
from smallwheel_ros.simulate.world import SimulatedRover, World

Integers = NDArray[np.int64]
Rows = dict[str, tuple[Integers, Array]]  # by stream: stamps (rows,) and values (rows, columns)
_ANGLE = 3e-3  # rad, of a potentiometer on a steering axis
# Standard deviation of a driven vehicle's shaking, m/s^2, and the time over which it is correlated, s.
_SHAKES, _SHAKEN = 1.2, 0.05


def lasting(normal: Callable[[int], Array], count: int, keep: float) -> Array:
    """Draw correlated errors of standard deviation 1, by a first-order autoregression.

    Parameters
    ----------
    normal
        Function that draws a number of independent standard normal numbers, shape (its argument,).
    count
        Number of errors.
    keep
        Correlation of each error with the next, 0 to 1.

    Returns
    -------
    ndarray
        Errors, shape (count,).
    """
    shocks = math.sqrt(1.0 - keep**2) * normal(count)
    shocks[:1] = normal(min(count, 1))
    return np.asarray(lfilter([1.0], [1.0, -keep], shocks))


class MeasuredRows:
    """Makes the sensor readings of a drive.

    Parameters
    ----------
    world
        The world, with its sensors.
    rover
        The rover that drove.
    truth
        True values over time.
    rng
        Random number generator for all errors.

    Attributes
    ----------
    outliers
        By wheel, once `rows` was called: which of its sinkages are gross errors, shape (rows,).
    """

    def __init__(
        self, world: World, rover: SimulatedRover, truth: Truth, rng: np.random.Generator
    ) -> None:
        self.world, self.rover, self.truth, self.rng = world, rover, truth, rng
        self.sensors = world.sensors
        self.outliers: dict[str, NDArray[np.bool_]] = {}
        self.end = float(truth.time[-1])
        self.half = np.array([0.5 * w.diameter for w in rover.wheels])

    def normal(self, size: int | tuple[int, ...] | None = None) -> Any:
        """Normal random numbers of standard deviation `noise_factor`: one, or of shape `size`."""
        return self.sensors.noise_factor * self.rng.standard_normal(size)

    def rows(self) -> Rows:
        """Stamps and values of every stream that the vehicle has, by name; call it once."""
        found: Rows = {}
        for j, wheel in enumerate(self.rover.wheels):
            if self.sensors.load:
                found[f"{wheel.name}/load"] = self._load(j)
            if self.sensors.sinkage:
                found[f"{wheel.name}/sinkage"] = self._sinkage(j)
            if self.sensors.pull:
                time = self._times(self.sensors.load_rate)
                shown = self.truth.at(time, self.truth.pull[:, j]) + 0.6 * self.normal(time.size)
                found[f"{wheel.name}/drawbar_pull"] = _stamped(time, shown)
        found |= self._joints()
        found["odom"] = self._odometry()
        if self.sensors.imu:
            found["imu"] = self._imu()
        return found

    def _times(self, rate: float) -> Array:
        return np.asarray((np.arange(int(self.end * rate) - 1) + self.rng.uniform()) / rate)

    def _lasting(self, count: int, keep: float) -> Array:
        return lasting(self.normal, count, keep)

    def _load(self, j: int) -> tuple[Integers, Array]:
        sensors, time = self.sensors, self._times(self.sensors.load_rate)
        scale = sensors.load_scale[j] if sensors.load_scale else 1.0
        true = scale * self.truth.at(time, self.truth.load[:, j])
        shown = true * (1.0 + sensors.load_noise * self.normal(time.size))
        shown = shown + 0.4 * self.normal(time.size) + sensors.tare
        return _stamped(time, np.maximum(shown, 0.1))

    def _sinkage(self, j: int) -> tuple[Integers, Array]:
        sensors, wheel = self.sensors, self.rover.wheels[j]
        time = self._times(sensors.sinkage_rate)
        true = self.truth.at(time - sensors.delay, self.truth.sinkage[:, j])
        length = np.sqrt(np.maximum(true, 1e-6) * wheel.diameter)
        rise = sensors.rebound * self.truth.at(time, self.truth.load[:, j]) / (wheel.width * length)
        shown = sensors.gain * (true - rise) + sensors.zero
        shown = shown - sensors.pitch_error * self.truth.at(time, self.truth.climb)
        shown = shown + sensors.zero_drift * time / self.end
        per_reading = self.world.speed / sensors.sinkage_rate
        shown = shown + sensors.rough * self._lasting(time.size, math.exp(-per_reading / 0.05))
        keep = math.exp(-1.0 / sensors.sinkage_rate)
        shown = shown + sensors.correlated * self._lasting(time.size, keep)
        shown = shown + np.hypot(sensors.sinkage_noise, 0.03 * true) * self.normal(time.size)
        wild = self.rng.uniform(size=time.size) < sensors.outliers
        gross = true * self.rng.uniform(2.0, 5.0, time.size) + self.rng.uniform(
            0.0, 0.02, time.size
        )
        shown = np.where(wild, gross, shown)
        self.outliers[wheel.name] = wild
        if sensors.step:
            shown = sensors.step * np.round(shown / sensors.step)
        told = np.hypot(sensors.sinkage_noise, sensors.sinkage_told * shown)
        # With its noise switched off an instrument still does not claim to be perfect.
        variance = (max(sensors.noise_factor, 0.1) * told) ** 2
        return _stamped(time, np.column_stack([shown, variance]))

    def _joints(self) -> Rows:
        """Streams of wheel speeds (encoders of finite step, slightly wrong radii), steering and torques."""
        sensors, time = self.sensors, self._times(self.sensors.joint_rate)
        radius = self.half * (1.0 + 0.007 * (self.normal() + self.normal(self.half.size)))
        step = 2.0 * np.pi / self.rng.choice(sensors.encoder_steps)
        turned = np.cumsum(self.truth.rim, axis=0) * TICK
        angle = np.floor(self.truth.at(time, turned) / radius / step) * step
        speed = np.diff(angle, axis=0, prepend=angle[:1]) * sensors.joint_rate
        speed = speed * (1.0 + 0.004 * self.normal(speed.shape))
        self.shown_rims = time, speed * self.half
        found = {
            f"{w.name}/wheel_speed": _stamped(time, speed[:, j])
            for j, w in enumerate(self.rover.wheels)
        }
        for j, wheel in enumerate(self.rover.wheels):
            if wheel.steered:
                angle = self.truth.at(time, self.truth.steering[:, j])
                shown = angle + _ANGLE * self.normal(time.size)
                found[f"{wheel.name}/steering"] = _stamped(time, shown)
        if sensors.torque:
            turns = np.abs(self.truth.at(time, self.truth.rim)) > 1e-3
            torque = self.truth.at(time, self.truth.torque) + sensors.friction * turns
            torque = torque * (1.0 + sensors.torque_scale * self.normal(self.half.size))
            torque = torque + 0.03 * self.normal(torque.shape)
            if sensors.current:  # no current at standstill, and no sign
                torque = np.where(turns, np.abs(torque), 0.0)
            found |= {
                f"{w.name}/torque": _stamped(time, torque[:, j])
                for j, w in enumerate(self.rover.wheels)
            }
        return found

    def _own(self, time: Array, rate: float) -> tuple[Array, float]:
        """Speed (m/s) of an odometry from images or lidar at these times, and the deviation of its noise.

        It is late, has an error of scale, and part of its noise is correlated in time. rate: Hz.
        """
        sensors, truth = self.sensors, self.truth
        smooth = self.rng.uniform(*sensors.lag)
        true = truth.speed
        if smooth > TICK:
            true = np.asarray(
                lfilter([TICK / smooth], [1.0, TICK / smooth - 1.0], true), np.float64
            )
        deviation, alike = self.rng.uniform(*sensors.noise), sensors.alike[0]
        keep = math.exp(-1.0 / rate / alike) if alike else 0.0
        part = self.rng.uniform(0.2, 0.8) if alike else 1.0
        noise = part * self.normal(time.size)
        noise = noise + math.sqrt(1.0 - part**2) * self._lasting(time.size, keep)
        scale = 1.0 + sensors.scale * self.normal()
        return scale * self.truth.at(time - self.lag, true) + deviation * noise, deviation

    def _of_wheels(self, time: Array, filtered: bool) -> Array:
        """Speed (m/s) of an odometry from the joints, (times,): the rims' mean, or filtered with an imu."""
        when, rims = self.shown_rims
        shown = rims.mean(axis=1)
        if not filtered:
            return np.asarray(np.interp(time, when, shown))
        # Half of the filters use accelerations, half assume a constant speed.
        felt: Array = np.zeros(when.size)
        if self.rng.uniform() < 0.5:
            felt = self.truth.at(when, self.truth.acceleration) + 0.05 * self.normal()
            felt = felt + 0.1 * self.normal(when.size)
        speed, gain = np.zeros(when.size), self.rng.uniform(0.15, 0.5)
        for i in range(1, when.size):
            expected = speed[i - 1] + felt[i] * (when[i] - when[i - 1])
            speed[i] = expected + gain * (shown[i] - expected)
        return np.asarray(np.interp(time, when, speed))

    def _turned_by_wheels(self, time: Array) -> Array:
        when, rims = self.shown_rims
        y = np.array([w.y for w in self.rover.wheels])
        rate = (rims[:, y < 0].mean(axis=1) - rims[:, y > 0].mean(axis=1)) / (
            y[y > 0].mean() - y[y < 0].mean()
        )
        return np.asarray(np.interp(time, when, rate))

    def _odometry(self) -> tuple[Integers, Array]:
        sensors, truth = self.sensors, self.truth
        rate = float(self.rng.choice(sensors.odometry_rate))
        self.lag = self.rng.uniform(*sensors.lag)
        time = self._times(rate)
        turning = self.truth.at(time - self.lag, truth.rate)
        if sensors.odometry in ("own", "pose"):
            speed, deviation = self._own(time, rate)
        elif sensors.odometry == "half":
            speed, deviation = self._own(time, rate)
            speed = 0.5 * (speed + self._of_wheels(time, filtered=True))
        else:
            speed, deviation = self._of_wheels(time, sensors.odometry == "filter"), 0.01
        if sensors.odometry == "wheels":
            turning = self._turned_by_wheels(time)
            yaw = np.cumsum(turning) / rate
        else:
            turning = turning + 0.005 * self.normal(time.size)
            yaw = self.truth.at(time - self.lag, truth.yaw) + 2e-3 * self.normal(time.size)
        aside = None
        if self.rover.steers:
            crab = self.truth.at(time - self.lag, truth.crab)
            aside = speed * np.sin(crab) - self.rover.pivot * turning
            aside = aside + deviation * self.normal(time.size)
            speed = speed * np.cos(crab)
        x, y = (np.cumsum(speed * part(yaw)) / rate for part in (np.cos, np.sin))
        if aside is not None:
            x = x - np.cumsum(aside * np.sin(yaw)) / rate
            y = y + np.cumsum(aside * np.cos(yaw)) / rate
        nothing: Array = np.zeros(time.size)
        pitch = nothing
        if sensors.pitch:
            pitch = -self.truth.at(time, truth.climb) + 2e-3 * self.normal(time.size)
        spread = (
            nothing + (sensors.told * deviation) ** 2,
            nothing + (0.005 * bool(sensors.told)) ** 2,
        )
        if sensors.odometry == "pose":
            speed, turning, spread = nothing, nothing, (nothing, nothing)
            aside = None if aside is None else nothing
        columns = [speed, turning, x, y, np.cos(yaw), np.sin(yaw), *spread, pitch, nothing]
        columns += [] if aside is None else [aside]
        return _stamped(time, np.stack(columns, axis=1))

    def _imu(self) -> tuple[Integers, Array]:
        truth, time = self.truth, self._times(self.sensors.imu_rate)
        drives = self.sensors.imu == "driven"
        off = math.radians(0.3) * self.normal(2)
        climb, roll = truth.at(time, truth.climb), truth.at(time, truth.roll)
        moves = np.abs(truth.at(time, truth.speed)) > 0.02
        shakes = _SHAKES * moves if drives else np.zeros(time.size)
        felt = truth.felt(time, off)
        if truth.crab.any():
            crab = truth.at(time, truth.crab)
            ahead, left = felt[:, 0].copy(), felt[:, 1].copy()
            felt[:, 0] = np.cos(crab) * ahead - np.sin(crab) * left
            felt[:, 1] = np.sin(crab) * ahead + np.cos(crab) * left
        keep = math.exp(-1.0 / self.sensors.imu_rate / _SHAKEN)
        lasting = np.stack([self._lasting(time.size, keep) for _ in range(3)], axis=1)
        felt = felt + shakes[:, None] * lasting + 0.1 * self.normal((time.size, 3))
        turn = truth.at(time, truth.rate) + 5e-3 * self.normal(time.size)
        noise = math.radians(0.2) * self.normal((2, time.size))
        shown, side = climb + off[0] + noise[0], roll + off[1] + noise[1]
        up = [np.sin(shown), np.cos(shown) * np.sin(side), np.cos(shown) * np.cos(side)]
        if drives:
            up = [np.full(time.size, np.nan)] * 3
        pitch_rate = np.zeros(time.size)  # not measured
        return _stamped(time, np.column_stack([turn, felt, *up, pitch_rate]))


def _stamped(time: Array, values: Array) -> tuple[Integers, Array]:
    return stamps_of(time), np.reshape(values, (time.size, -1)).astype(float)
