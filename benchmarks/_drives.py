# SPDX-License-Identifier: Apache-2.0
"""Simulated drives as the estimator gets them: benchmarks and tests share it."""

from __future__ import annotations

import math

import numpy as np

from smallwheel_ros.estimator.reading import Reading
from smallwheel_ros.physics.wheel import Quantity, Wheel
from smallwheel_ros.simulate import Drive
from smallwheel_ros.simulate.sensors import EPOCH


def measurements(drive: Drive) -> list[Reading]:
    """Everything as measured, noise included, put together by time and in its order.

    Slip comes from wheel speed and odometry, as on a robot; below 0.05 m/s it is not known.
    """
    odometry, joints = drive.odometry, drive.joints
    t_odometry, t_joints = ((s.stamp - EPOCH) / 1e9 for s in (odometry, joints))
    speeds = np.where(np.abs(odometry.forward_speed) > 0.03, odometry.forward_speed, 0.0)
    way = np.concatenate([[0.0], np.cumsum(0.5 * (speeds[1:] + speeds[:-1]) * np.diff(t_odometry))])
    # Slip is a difference of two noisy numbers: a mean over a fifth of a second first.
    window = np.ones(7) / 7.0
    smooth_speed = np.convolve(odometry.forward_speed, window, mode="same")
    found = []
    for j, wheel in enumerate(drive.rover.wheels):
        sinkage, load = drive.sinkage[wheel.name], drive.load[wheel.name]
        time, t_load = ((s.stamp - EPOCH) / 1e9 for s in (sinkage, load))
        carried = np.interp(time, t_load, load.normal)
        speed = np.interp(time, t_odometry, smooth_speed)
        yaw = np.interp(time, t_odometry, np.convolve(odometry.yaw_rate, window, mode="same"))
        own = speed - wheel.y * yaw
        rim = np.interp(time, t_joints, joints.velocity[:, j]) * wheel.diameter / 2
        faster = np.maximum(np.abs(own), np.abs(rim))
        slip = np.where(faster > 0.05, (rim - own) / np.maximum(faster, 0.05), np.nan)
        at = np.maximum.accumulate(np.interp(time, t_odometry, way))
        rows = zip(time, sinkage.sinkage, sinkage.variance, carried, at, slip, own, strict=True)
        found += [
            Reading(
                Wheel(wheel.name, wheel.diameter, wheel.width),
                round(1e9 * t),
                Quantity(w, math.hypot(0.4, 0.012 * w)),
                None if np.isnan(s) else Quantity(float(np.clip(s, -1.0, 1.0)), 0.0),
                Quantity(z, math.sqrt(v)),
                abs(u),
                d,
                d,
            )
            for t, z, v, w, d, s, u in ((float(x) for x in row) for row in rows)
        ]
    return sorted(found, key=lambda one: (one.stamp, one.wheel.name))
