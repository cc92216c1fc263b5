# SPDX-License-Identifier: Apache-2.0
"""Steered vehicles in the plane: kinematics alone, for the bias of slip; no forces, no soil.

Wheels are points that are carried along in the world; how fast each goes, and which way, comes from the
differences of its places in time. No formula of the library is used.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from smallwheel_ros.onboard.parameters import settings_from
from smallwheel_ros.onboard.settings import NodeSettings
from smallwheel_ros.pipeline.pipeline import Pipeline
from smallwheel_ros.pipeline.tables import Estimates, Readings

EPOCH, RATE, TICK = 1_750_000_000 * 10**9, 50, 1e-3
ROVER = {  # as an open-source rover has them: place, and whether a joint steers it
    "front_left": (0.31, 0.24, True), "front_right": (0.31, -0.24, True),
    "middle_left": (0.0, 0.27, False), "middle_right": (0.0, -0.27, False),
    "rear_left": (-0.29, 0.24, True), "rear_right": (-0.29, -0.24, True),
}  # fmt: skip
SIX_OF_SIX = {name: (x, y, True) for name, (x, y, _) in ROVER.items()}
CAR = {
    "front_left": (0.36, 0.2, True), "front_right": (0.36, -0.2, True),
    "rear_left": (0.0, 0.2, False), "rear_right": (0.0, -0.2, False),
}  # fmt: skip
FOUR = {name: (x - 0.18, y, True) for name, (x, y, _) in CAR.items()}
DIAMETER = 0.2
Way = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]]


def bend(radius: float, speed: float = 0.3) -> Way:
    return lambda t: (speed * _begins(t), 0.0 * t, speed / radius * _begins(t))


def crab(angle: float, speed: float = 0.3) -> Way:
    return lambda t: (
        speed * math.cos(angle) * _begins(t), speed * math.sin(angle) * _begins(t), 0.0 * t,
    )  # fmt: skip


def spot(rate: float = 0.5) -> Way:
    return lambda t: (0.0 * t, 0.0 * t, rate * _begins(t))


def weave(radius: float = 1.2, speed: float = 0.3, period: float = 8.0) -> Way:
    return lambda t: (
        speed * _begins(t), 0.0 * t,
        speed / radius * _begins(t) * np.sin(2.0 * math.pi * t / period),
    )  # fmt: skip


def _begins(t: np.ndarray) -> np.ndarray:
    return np.clip((t - 2.0) / 1.0, 0.0, 1.0)


@dataclass(frozen=True)
class SteeredDrive:
    """Rows by stream, the settings, and true slip of each wheel at the stamps (times, wheels)."""

    settings: NodeSettings
    rows: Mapping[str, tuple[np.ndarray, np.ndarray]]
    stamps: np.ndarray
    slip: np.ndarray
    angle: np.ndarray
    slip_angle: np.ndarray
    path: np.ndarray

    def run(
        self, span: int = 5 * 10**9, kind: type[Pipeline] = Pipeline
    ) -> tuple[Pipeline, Readings, Estimates]:
        """Through a pipeline, in blocks of some seconds. kind: `FirstStages` for readings alone."""
        pipeline = kind(self.settings.onboard)
        readings, estimates = [], []
        turns = []
        for begin in range(int(self.stamps[0]), int(self.stamps[-1]) + 1, span):
            parts, order = {}, []
            for name, (stamps, values) in self.rows.items():
                inside = (stamps >= begin) & (stamps < begin + span)
                if inside.any():
                    parts[name] = stamps[inside], values[inside]
                    order.append(stamps[inside])
            arrived = np.sort(np.concatenate(order), kind="stable")
            number = {name: np.searchsorted(arrived, one[0]) for name, one in parts.items()}
            pipeline.streams.add_rows({n: (*one, number[n]) for n, one in parts.items()})
            turns += pipeline.turns()
        turns += pipeline.turns(last=True)
        for turn in turns:
            readings.append(turn.readings)
            estimates.append(turn.estimates)
        return pipeline, Readings.joined(readings), Estimates.joined(estimates)

    def error(self, readings: Readings, since: float = 5.0) -> np.ndarray:
        """Slip less the true one of each wheel, after some seconds; (wheels, times)."""
        found = []
        for number in range(self.slip.shape[1]):
            mine = (readings.wheel == number) & (readings.stamp > self.stamps[0] + since * 1e9)
            true = np.interp(readings.stamp[mine], self.stamps, self.slip[:, number])
            found.append(readings.slip[mine] - true)
        return np.array(found)


def steered_drive(
    way: Way,
    wheels: Mapping[str, tuple[float, float, bool]] = ROVER,
    *,
    seconds: float = 40.0,
    seed: int = 0,
    slip: float = 0.10,
    spread: float = 0.06,
    odometry: str = "own",
    arm: float = 0.0,
    given: bool = True,
    wrong: tuple[str, ...] = (),
    linear_y: bool = True,
    noise: float = 0.0,
    parameters: Mapping[str, object] | None = None,
) -> SteeredDrive:
    """A drive along a way (speed ahead, aside, yaw rate by time).

    Slips differ by wheel and slowly by time. odometry: `own` exact but for `noise` (m/s), `pose` places
    alone, `wheels` the motion that fits all rims as vectors, `rims` along their headings alone, `axle` of
    those that are not steered.
    given: whether the parameters name the steering joints. wrong: wheels whose sign is given wrong.
    """
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, seconds, TICK)
    vx, vy, w = way(t)
    yaw = np.concatenate([[0.0], np.cumsum(w[:-1] * TICK)])
    x = np.concatenate([[0.0], np.cumsum((vx * np.cos(yaw) - vy * np.sin(yaw))[:-1] * TICK)])
    y = np.concatenate([[0.0], np.cumsum((vx * np.sin(yaw) + vy * np.cos(yaw))[:-1] * TICK)])
    every = round(1.0 / RATE / TICK)
    at = slice(None, None, every)
    stamps = EPOCH + np.round(t[at] * 1e9).astype(np.int64)
    names = list(wheels)
    rows: dict[str, tuple[np.ndarray, np.ndarray]] = {}
    rims, slips, angles, asides = [], [], [], []
    for name in names:
        px, py, steers = wheels[name]
        off = math.copysign(arm, py) if steers else 0.0
        axis_x = x + np.cos(yaw) * px - np.sin(yaw) * (py - off)
        axis_y = y + np.sin(yaw) * px + np.cos(yaw) * (py - off)
        angle = np.zeros(t.size)
        if steers:
            went = np.unwrap(np.arctan2(np.gradient(axis_y, t), np.gradient(axis_x, t)))
            moves = np.hypot(np.gradient(axis_y, t), np.gradient(axis_x, t)) > 1e-4
            angle = went - yaw
            first = int(np.argmax(moves)) + 2
            angle[:first] = angle[first]
            # Wheels turn by less than a quarter, and run backward instead.
            angle = angle - math.pi * np.round(angle[first] / math.pi)
        world = yaw + angle
        wheel_x, wheel_y = axis_x - off * np.sin(world), axis_y + off * np.cos(world)
        gone_x, gone_y = np.gradient(wheel_x, t), np.gradient(wheel_y, t)
        along = gone_x * np.cos(world) + gone_y * np.sin(world)
        aside = gone_y * np.cos(world) - gone_x * np.sin(world)
        own = slip + spread * rng.uniform(-1.0, 1.0) * np.sin(0.3 * t + rng.uniform(0.0, 6.0))
        rim = along / (1.0 - own)
        turned = rim[at] / (0.5 * DIAMETER) * (1.0 + 0.002 * rng.standard_normal(stamps.size))
        rows[f"{name}/wheel_speed"] = stamps, turned[:, None]
        if steers and given:
            sign = -1.0 if name in wrong else 1.0
            shown = sign * (angle[at] + 0.002 * rng.standard_normal(stamps.size))
            rows[f"{name}/steering"] = stamps, shown[:, None]
        rims.append(rim[at])
        slips.append(own[at])
        angles.append(angle[at])
        asides.append(np.arctan2(aside, np.abs(along))[at])
    speed, left, turn = vx[at], vy[at], w[at]
    if odometry == "wheels":
        speed, left, turn = _of_wheels(np.array(rims), np.array(angles), wheels)
    if odometry == "rims":
        speed, left, turn = _by_rims_alone(np.array(rims), np.array(angles), wheels)
    if odometry == "axle":
        speed = np.mean(
            [rim for rim, n in zip(rims, names, strict=True) if not wheels[n][2]], axis=0
        )
    if odometry in ("own", "pose"):
        speed = speed + noise * rng.standard_normal(speed.size)
    px, py, heading = x[at], y[at], yaw[at]
    if odometry in ("wheels", "rims", "axle"):
        heading = np.cumsum(turn) / RATE
        px = np.cumsum(speed * np.cos(heading) - left * np.sin(heading)) / RATE
        py = np.cumsum(speed * np.sin(heading) + left * np.cos(heading)) / RATE
    nothing = np.zeros(stamps.size)
    if odometry == "pose":
        speed = left = turn = nothing
    if not linear_y:
        left = nothing
    columns = [speed, turn, px, py, np.cos(heading), np.sin(heading), *[nothing] * 4]
    steered = given and any(steers for _, _, steers in wheels.values())
    columns += [left] if steered else []
    rows["odom"] = stamps, np.column_stack(columns)
    gravity = np.full(stamps.size, 9.80665)
    gyro = w[at] + 1e-4 * rng.standard_normal(stamps.size)
    felt = np.gradient(vx[at], 1.0 / RATE)
    rows["imu"] = (
        stamps,
        np.column_stack([gyro, felt, nothing, gravity, nothing, nothing, nothing + 1.0, nothing]),
    )
    values: dict[str, object] = {
        "wheels": names, "vehicle.mass": 12.0, "load.source": "static", "imu_topic": "imu",
        "all_wheels.diameter": DIAMETER, "all_wheels.width": 0.08, "all_wheels.sinkage_topic": "",
    }  # fmt: skip
    for name, (ahead, side, steers) in wheels.items():
        values[f"{name}.longitudinal_position"] = ahead
        values[f"{name}.lateral_position"] = side
        if steers and given:
            values[f"{name}.steering_joint"] = f"{name}_steering"
            values[f"{name}.steering_arm"] = math.copysign(arm, side)
    settings = settings_from(values | dict(parameters or {}))
    distance = np.cumsum(np.hypot(vx, vy))[at] * TICK
    return SteeredDrive(
        settings, rows, stamps, np.array(slips).T, np.array(angles).T, np.array(asides).T, distance
    )


def _of_wheels(
    rims: np.ndarray, angles: np.ndarray, wheels: Mapping[str, tuple[float, float, bool]]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What most drivers do: each wheel a velocity along its heading, and the motion that fits them all."""
    ahead, left = rims * np.cos(angles), rims * np.sin(angles)
    px = np.array([one[0] for one in wheels.values()])[:, None]
    py = np.array([one[1] for one in wheels.values()])[:, None]
    mean = [each.mean(axis=0) for each in (ahead, left)]
    cx, cy = px - px.mean(), py - py.mean()
    turn = (cx * (left - mean[1]) - cy * (ahead - mean[0])).sum(axis=0) / (cx**2 + cy**2).sum()
    return mean[0] + turn * py.mean(), mean[1] - turn * px.mean(), turn


def _by_rims_alone(
    rims: np.ndarray, angles: np.ndarray, wheels: Mapping[str, tuple[float, float, bool]]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The motion by which rims along their headings are off least, time by time."""
    places = np.array([one[:2] for one in wheels.values()])
    found = []
    for rim, angle in zip(rims.T, angles.T, strict=True):
        ahead = np.column_stack([np.cos(angle), np.sin(angle)])
        lever = places[:, 0] * ahead[:, 1] - places[:, 1] * ahead[:, 0]
        found.append(np.linalg.lstsq(np.column_stack([ahead, lever]), rim, rcond=1e-3)[0])
    return tuple(np.array(found).T)  # type: ignore[return-value]
