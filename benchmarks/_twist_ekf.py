# SPDX-License-Identifier: Apache-2.0
"""An EKF in the plane that takes twist, gyro and fixes as ekf_node of robot_localization documents it.

By filterpy. State x, y, yaw, vx, vy, yaw rate, ax, ay; the omnidirectional model of its documentation; each
fused variable is a measurement with the variance of its message, one under 1e-9 is 1e-9; a rejection
threshold is a Mahalanobis distance beyond which a message is left out. Process noise a second: its own
ekf.yaml takes a vehicle to change its speed by 0.16 m/s in a second (0.025), and the filter then lags behind
a twist that is told with an honest variance: here 1 m/s. Of x, y and yaw next to nothing, so that the
covariance is what the twist tells.
"""

from __future__ import annotations

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter
from numpy.typing import NDArray

Array = NDArray[np.float64]
X, Y, YAW, VX, VY, TURN, AX, AY = range(8)
OF_TWIST = {0: VX, 1: VY, 5: TURN}  # twist0_config: by place in the message's covariance
_NOISE = np.diag([1e-4, 1e-4, 1e-4, 1.0, 1.0, 1.0, 0.01, 0.01])
_LEAST = 1e-9


class Ekf:
    """It begins at a pose at rest."""

    def __init__(self, pose: Array) -> None:
        self.filter = ExtendedKalmanFilter(8, 1)
        self.filter.x = np.array([*pose, 0.0, 0.0, 0.0, 0.0, 0.0])
        self.filter.P = np.diag([1e-2] * 3 + [1.0] * 3 + [1e-2] * 2)
        self.rejected = 0

    @property
    def x(self) -> Array:
        """The state, (8,)."""
        return np.asarray(self.filter.x)

    @property
    def P(self) -> Array:
        """Its covariance, (8, 8)."""
        return np.asarray(self.filter.P)

    def predict(self, dt: float) -> None:
        """On by dt seconds."""
        x = self.filter.x
        c, s = np.cos(x[YAW]), np.sin(x[YAW])
        a, b = x[VX] * dt + 0.5 * x[AX] * dt * dt, x[VY] * dt + 0.5 * x[AY] * dt * dt
        F = np.eye(8)
        F[X, [VX, VY, AX, AY]] = c * dt, -s * dt, 0.5 * c * dt * dt, -0.5 * s * dt * dt
        F[Y, [VX, VY, AX, AY]] = s * dt, c * dt, 0.5 * s * dt * dt, 0.5 * c * dt * dt
        F[X, YAW], F[Y, YAW] = -s * a - c * b, c * a - s * b
        F[YAW, TURN] = F[VX, AX] = F[VY, AY] = dt
        x = x + np.array(
            [c * a - s * b, s * a + c * b, x[TURN] * dt, x[AX] * dt, x[AY] * dt, 0.0, 0.0, 0.0]
        )
        self.filter.x = x
        self.filter.P = F @ self.filter.P @ F.T + _NOISE * dt

    def fuse(
        self, values: Array, variances: Array, places: list[int], threshold: float = np.inf
    ) -> None:
        """One message: values of state variables and their variances."""
        H = np.eye(8)[places]
        R = np.diag(np.maximum(np.abs(variances), _LEAST))
        e = values - H @ self.filter.x
        if float(e @ np.linalg.solve(H @ self.filter.P @ H.T + R, e)) > threshold**2:
            self.rejected += 1
            return
        self.filter.dim_z = len(places)
        self.filter._I = np.eye(8)
        self.filter.update(values, lambda _: H, lambda x: H @ x, R=R)

    def twist(
        self, linear: Array, angular: Array, covariance: Array, threshold: float = np.inf
    ) -> None:
        """A geometry_msgs/TwistWithCovariance: (3,), (3,), (36,)."""
        told = np.array([*linear, *angular])
        if not np.isfinite(told).all() or not np.isfinite(covariance).all():
            raise ValueError("a message that is not finite would make every estimate NaN")
        axes = list(OF_TWIST)
        self.fuse(
            told[axes], covariance.reshape(6, 6)[axes, axes], list(OF_TWIST.values()), threshold
        )
