# SPDX-License-Identifier: Apache-2.0
"""Drives for `twist.py`: rows of streams as the pipeline has them, and the true speed at each stamp of rims.

Real ones: a Warthog on grass and on sand. Their truth is a smoother's over lidar poses, gyro and
accelerometer, no wheels; its own variance is told. Simulated ones: slip that comes and goes as the imu can
see it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.signal import lfilter

from rates.real_drives import real_drive
from smallwheel_ros.common.stamps import SECOND
from smallwheel_ros.onboard.declared import TwistSettings
from smallwheel_ros.onboard.parameters import settings_from
from smallwheel_ros.onboard.settings import IMU, ODOMETRY, OnboardSettings, VelocitySource
from smallwheel_ros.pipeline.tables import Array, Integers
from smallwheel_ros.pipeline.twist.twist import Rows
from smallwheel_ros.simulate.world import GRAVITY

_PLACES = [up / "shared" / "data" / "real_drives" for up in Path(__file__).resolve().parents]
REAL = next((place for place in _PLACES if place.is_dir()), _PLACES[1])
_RIM_RATE, _IMU_RATE, _SHAKES = 20.0, 100.0, 0.3  # Hz, Hz, m/s^2: of what is simulated
WHEELS = ("front_left", "front_right", "rear_left", "rear_right")


@dataclass(frozen=True)
class Drive:
    """Rows of streams, and what holds at each stamp of the rims (ns), NaN where it is not known.

    rims: m/s, their mean. yaw_rate: rad/s, of the gyro. truth: (N, 2) m/s, ahead and left; truth_var: of the
    first. piece: number of the piece between gaps.
    """

    name: str
    vehicle: OnboardSettings
    settings: TwistSettings
    rows: Rows
    stamp: Integers
    rims: Array
    yaw_rate: Array
    truth: Array
    truth_var: Array
    piece: Integers

    @property
    def time(self) -> Array:
        return (self.stamp - self.stamp[0]) / SECOND


def vehicle(
    diameter: float, track: float, base: float, velocity: VelocitySource = "none"
) -> OnboardSettings:
    """Four wheels that do not steer."""
    given: dict[str, Any] = {"wheels": list(WHEELS), "imu_topic": "imu/data"}
    for wheel in WHEELS:
        given |= {
            f"{wheel}.diameter": diameter,
            f"{wheel}.width": 0.1,
            f"{wheel}.lateral_position": (0.5 if "left" in wheel else -0.5) * track,
            f"{wheel}.longitudinal_position": (0.5 if "front" in wheel else -0.5) * base,
        }
    return replace(settings_from(given).onboard, velocity=velocity)


def simulated(seed: int, slip: float = 0.2, seconds: float = 240.0, speed: float = 1.0) -> Drive:
    """Skid steering, random commands; slip takes another value every 1 to 5 s, half of it a side's own.

    It is no vehicle of `simulate`: what is asked is whether an imu can tell slips of a known size and
    duration, so that these are drawn, where that vehicle's come of soil. Its wheels do not slide sideways
    either, and its tick of 0.04 s is no imu's.

    slip: deviation of those values. The accelerometer's readings are off by 0.3 m/s^2 each; it is mounted
    0.2 m off the middle and 0.1 m/s^2 off zero; the ground rolls by 2 degrees, told to 0.3.
    """
    rng = np.random.default_rng([46, seed])
    dt, track, diameter, chi = 0.01, 0.6, 0.3, 1.6
    t = np.arange(0.0, seconds, dt)

    def steps(low: float, high: float, draw: Callable[[int], Array], slow: float) -> Array:
        """Values held for a while each, one after the other, smoothed over `slow` seconds."""
        ends = np.cumsum(rng.uniform(low, high, int(seconds / low) + 2))
        values = draw(ends.size + 1)
        out = values[np.searchsorted(ends, t)]
        keep = np.exp(-dt / slow)
        smooth: Array = lfilter([1.0 - keep], [1.0, -keep], out)
        return smooth

    ahead = steps(
        3.0, 8.0, lambda n: speed * rng.uniform(-0.3, 1.0, n) * (rng.random(n) > 0.15), 0.4
    )
    turn = steps(3.0, 8.0, lambda n: 0.5 * rng.normal(0.0, 1.0, n) * (rng.random(n) > 0.4), 0.4)
    ahead[t < 3.0] = turn[t < 3.0] = 0.0
    half = chi * track / 2.0
    left, right = ahead - half * turn, ahead + half * turn
    slips = [steps(1.0, 5.0, lambda n: rng.normal(0.0, slip, n), 0.3) for _ in range(4)]
    slips[:2] = [np.sqrt(0.5) * (own + slips[3]) for own in slips[:2]]
    over = [
        rim - np.abs(rim) * np.clip(s, -0.9, 0.9)
        for rim, s in zip((left, right), slips, strict=False)
    ]
    vx, w = (over[0] + over[1]) / 2.0, (over[1] - over[0]) / (2.0 * half)
    vy = 0.3 * slips[2] * np.abs(vx) * np.tanh(3.0 * w)
    up = np.column_stack(
        [steps(4.0, 9.0, lambda n: rng.normal(0.0, 0.035, n), 1.5) for _ in range(2)]
    )
    fx = np.gradient(vx, dt) - w * vy - 0.2 * w * w + GRAVITY * up[:, 0] + 0.1
    fy = np.gradient(vy, dt) + w * vx + GRAVITY * up[:, 1] - 0.1
    start = 1_000 * SECOND
    of_imu = np.arange(0, t.size, round(1.0 / (_IMU_RATE * dt)))
    of_rims = np.arange(3, t.size, round(1.0 / (_RIM_RATE * dt)))
    noise = rng.normal(0.0, _SHAKES, (of_imu.size, 2))
    told = up[of_imu] + rng.normal(0.0, 0.005, (of_imu.size, 2))
    level = np.sqrt(1.0 - (told**2).sum(axis=1))
    imu = np.column_stack(
        [
            w[of_imu] + rng.normal(0.0, 0.01, of_imu.size),
            fx[of_imu] + noise[:, 0],
            fy[of_imu] + noise[:, 1],
            np.full(of_imu.size, GRAVITY),
            told,
            level,
            np.zeros(of_imu.size),
        ]
    )
    stamps = start + np.round(t * SECOND).astype(np.int64)
    rows = {IMU: (stamps[of_imu], imu)}
    for wheel in WHEELS:
        rim = (left if "left" in wheel else right)[of_rims]
        turned = (rim + rng.normal(0.0, 0.01, rim.size)) / (diameter / 2.0)
        rows[f"{wheel}/wheel_speed"] = stamps[of_rims], turned[:, None]
    return Drive(
        f"simulated {seed}, slip {slip:g}", vehicle(diameter, track, 0.5), TwistSettings(), rows,
        stamps[of_rims], ((left + right) / 2.0)[of_rims], w[of_rims],
        np.column_stack([vx, vy])[of_rims], np.zeros(of_rims.size), np.zeros(of_rims.size, dtype=np.int64),
    )  # fmt: skip


def real(name: str, rim_delay: float = 0.2) -> Drive:
    """A Warthog's drive. rim_delay: s, lag of the rims against the accelerometer (SOURCE.md)."""
    raw = real_drive(REAL, name)
    odometry, poses = raw.rows.pop(ODOMETRY)  # its speed is derived from its poses
    stamps, imu = raw.rows[IMU]
    front = np.column_stack([raw.rows[f"{wheel}/wheel_speed"][1] for wheel in WHEELS[:2]])
    of_rims = raw.rows[f"{WHEELS[0]}/wheel_speed"][0]
    if not np.array_equal(of_rims, stamps):
        raise ValueError(
            f"{name}: rims and imu do not come at the same stamps, which this file takes for granted"
        )
    t, of_poses = ((one - stamps[0]) / SECOND for one in (stamps, odometry))
    places = np.column_stack([poses[:, 2:4], np.arctan2(poses[:, 5], poses[:, 4])])
    truth, variance, piece = _smoothed(t, imu, of_poses, places)
    return Drive(
        name, replace(raw.settings, velocity="none"), TwistSettings(rim_delay=rim_delay), raw.rows, stamps,
        0.3 * front.mean(axis=1), imu[:, 0], truth, variance, piece,
    )  # fmt: skip


def _smoothed(t: Array, imu: Array, of_poses: Array, poses: Array) -> tuple[Array, Array, Integers]:
    """Velocity ahead and left, variance of the first, number of the piece: forward and back over each piece.

    Poses come late by a lag at which their yaw follows the gyro best, single ones off by 0.09 s (SOURCE.md).
    """
    piece = np.cumsum(np.diff(t, prepend=t[0]) > 0.5)
    turned = np.concatenate([[0.0], np.cumsum(imu[1:, 0] * np.minimum(np.diff(t), 0.06))])
    pose_piece = piece[np.minimum(np.searchsorted(t, of_poses), t.size - 1)]
    yaw = poses[:, 2]

    def missed(lag: float) -> float:
        by = np.interp(of_poses - lag, t, turned)
        same = pose_piece[4:] == pose_piece[:-4]
        off = (yaw - by)[4:] - (yaw - by)[:-4]
        off = (off + np.pi) % (2.0 * np.pi) - np.pi
        return float(np.mean(np.minimum(np.abs(off[same]), 0.3)))

    lag = min(np.arange(0.3, 0.9, 0.05), key=missed)
    at = of_poses - lag
    truth, variance = np.full((t.size, 2), np.nan), np.full(t.size, np.nan)
    for number in np.unique(piece):
        rows = np.flatnonzero(piece == number)
        inside = (at >= t[rows[0]]) & (at <= t[rows[-1]]) & (pose_piece == number)
        if rows.size < 40 or inside.sum() < 5:
            continue
        off = np.unwrap(yaw[inside] - np.interp(at[inside], t, turned))
        off = np.array([np.median(off[max(i - 3, 0) : i + 4]) for i in range(off.size)])
        heading = turned[rows] + np.interp(t[rows], at[inside], off)
        truth[rows], variance[rows] = _back_and_forth(
            t[rows], heading, imu[rows, 1:3], at[inside], poses[inside, :2]
        )
    return truth, variance, piece


def _back_and_forth(
    t: Array, heading: Array, force: Array, at: Array, places: Array
) -> tuple[Array, Array]:
    """Smoother (Rauch, Tung and Striebel) of place, velocity and the accelerometer's zero: (N, 2), (N,)."""
    n = t.size
    rest = max(1.4826 * float(np.median(np.abs(np.diff(places, 2, axis=0)))) / np.sqrt(6.0), 0.01)
    noise = 2.0 * np.std(np.diff(force, axis=0)) / np.sqrt(2.0)
    x, P = np.zeros(6), np.diag([1.0, 1.0, 0.25, 0.25, 0.09, 0.09])
    x[:2] = places[0]
    means, variances = np.zeros((2, n, 6)), np.zeros((2, n, 6, 6))
    moves = np.zeros((n, 6, 6))
    H = np.eye(6)[:2]
    when = np.minimum(np.searchsorted(t, at), n - 1)
    for i in range(n):
        dt = t[i] - t[i - 1] if i else 0.0
        c, s = np.cos(heading[i]), np.sin(heading[i])
        R = np.array([[c, -s], [s, c]])
        F = np.eye(6)
        F[0, 2] = F[1, 3] = dt
        F[2:4, 4:] = -R * dt
        keep = np.exp(-dt / 10.0)
        F[4, 4] = F[5, 5] = keep
        x = F @ x
        x[2:4] += R @ force[i] * dt
        q = 0.1**2 * dt + (noise * dt) ** 2
        P = F @ P @ F.T + np.diag([0.0, 0.0, q, q, *[0.09 * (1.0 - keep * keep)] * 2])
        means[0, i], variances[0, i], moves[i] = x, P, F
        for k in np.flatnonzero(when == i):
            r = rest**2 + 0.09**2 * float(x[2:4] @ x[2:4])
            e = places[k] - x[:2]
            S = H @ P @ H.T + r * np.eye(2)
            z2 = float(e @ np.linalg.solve(S, e))
            S += (max(1.0, z2 / 6.0) - 1.0) * S  # what is far off counts less
            G = P @ H.T @ np.linalg.inv(S)
            x, P = x + G @ e, P - G @ H @ P
        means[1, i], variances[1, i] = x, P
    for i in range(n - 2, -1, -1):
        C = variances[1, i] @ moves[i + 1].T @ np.linalg.inv(variances[0, i + 1] + 1e-9 * np.eye(6))
        means[1, i] += C @ (means[1, i + 1] - means[0, i + 1])
        variances[1, i] += C @ (variances[1, i + 1] - variances[0, i + 1]) @ C.T
    c, s = np.cos(heading), np.sin(heading)
    v, V = means[1, :, 2:4], variances[1, :, 2:4, 2:4]
    ahead = np.column_stack([c, s])
    velocity = np.column_stack([(v * ahead).sum(axis=1), c * v[:, 1] - s * v[:, 0]])
    return velocity, np.maximum(np.einsum("ni,nij,nj->n", ahead, V, ahead), 0.0)
