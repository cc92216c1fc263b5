# SPDX-License-Identifier: Apache-2.0
"""Motion of a rigid vehicle with steered wheels, from the speeds of its rims.

A wheel at (x, y) that points d to the left and rolls with its rim's speed u without slip:

    u = vx cos d + vy sin d + w (x sin d - y cos d)       along its heading
    0 = vy cos d - vx sin d + w (x cos d + y sin d)       across it

The rigid motion (vx, vy, w) is the least-squares solution of both equations over all wheels (Muir
and Neuman 1987, "Kinematic modeling of wheeled mobile robots"), with the lower ones at half the
weight. Rims alone do not determine the sideways speed of wheels that all point nearly the same way:
slips that differ by 0.06 gave an error of half of the speed.
"""

from __future__ import annotations

import numpy as np

from smallwheel_ros.physics.wheel import Wheel
from smallwheel_ros.pipeline.tables import Array

# Weight of sideways speeds: errors of rims (slips differ by 0.06) over those of directions (slip angles of
# 0.1 rad).
ACROSS = 0.5


def places_of(
    wheels: tuple[Wheel, ...], angle: Array, arm: Array | None = None
) -> tuple[Array, Array]:
    """Compute the positions of wheels in the base frame at given steering angles.

    Parameters
    ----------
    wheels
        The wheels, with their positions when they point straight ahead.
    angle
        Steering angles, positive to the left, shape (wheels, instants), rad.
    arm
        Distance of each wheel's middle to the left of its steering axis, shape (wheels,), m; None: 0.

    Returns
    -------
    x, y : ndarray
        Shape (wheels, instants), m, ahead and to the left of the base frame.
    """
    x, y = (
        np.array([getattr(wheel, name) for wheel in wheels])[:, None] + 0.0 * angle
        for name in ("longitudinal_position", "lateral_position")
    )
    if arm is None or not arm.any():
        return x, y
    off = arm[:, None]
    return x - off * np.sin(angle), y - off * (1.0 - np.cos(angle))


def rows_along(x: Array, y: Array, angle: Array) -> Array:
    """Coefficients of the rigid motion (vx, vy, w) in a wheel's speed along its heading.

    Parameters
    ----------
    x, y
        Position of the wheel, m; shapes that broadcast with that of `angle`.
    angle
        Its steering angle, positive to the left, rad.

    Returns
    -------
    ndarray
        Shape (..., 3): factors of vx (1), of vy (1) and of the yaw rate w (m).
    """
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.stack([cosine, sine, x * sine - y * cosine], axis=-1)


def rows_across(x: Array, y: Array, angle: Array) -> Array:
    """Coefficients of the rigid motion (vx, vy, w) in a wheel's speed to the left of its heading.

    Parameters
    ----------
    x, y
        Position of the wheel, m; shapes that broadcast with that of `angle`.
    angle
        Its steering angle, positive to the left, rad.

    Returns
    -------
    ndarray
        Shape (..., 3): factors of vx (1), of vy (1) and of the yaw rate w (m).
    """
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.stack([-sine, cosine, x * cosine + y * sine], axis=-1)


def rigid_motion(rims: Array, x: Array, y: Array, angle: Array) -> Array:
    """Fit the motion of the vehicle as a rigid body to the speeds of its rims, by least squares.

    Parameters
    ----------
    rims
        Speeds of the rims, shape (wheels, instants), m/s; a wheel whose rim or angle is NaN does not count.
    x, y, angle
        Position (m) and steering angle (rad) of each wheel, of the same shape.

    Returns
    -------
    ndarray
        Shape (3, instants): vx, vy (m/s) and yaw rate w (rad/s); NaN where fewer than two wheels are known.
    """
    known = np.isfinite(rims) & np.isfinite(angle)
    rows = rows_along(x, y, angle), ACROSS * rows_across(x, y, angle)
    rows_ = np.concatenate([np.where(known[..., None], one, 0.0) for one in rows])
    speeds = np.where(known, rims, 0.0)
    normal = np.einsum("wti,wtj->tij", rows_, rows_)
    shown = np.einsum("wti,wt->ti", rows_[: len(rims)], speeds)
    enough = known.sum(axis=0) >= 2
    normal[~enough] = np.eye(3)
    found = np.linalg.solve(normal, shown[..., None])[..., 0].T
    return np.asarray(np.where(enough, found, np.nan))
