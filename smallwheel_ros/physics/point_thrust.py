# SPDX-License-Identifier: Apache-2.0
"""Thrust of one wheel at one instant in plain floats, with its slopes: see `traction.thrust`."""

from __future__ import annotations

import math
from typing import NamedTuple


class PointThrust(NamedTuple):
    """Thrust (N), and its slopes by what it depends on.

    limit: what the soil holds at any slip, N. by_load: 1. by_length, by_slip: N/m, N. by_cohesion,
    by_friction: by c (N/Pa) and phi (N/rad). by_log_shear: by ln kappa, N.
    """

    value: float
    limit: float
    by_load: float
    by_length: float
    by_slip: float
    by_cohesion: float
    by_friction: float
    by_log_shear: float


def point_contact_length(sinkage: float, diameter: float) -> tuple[float, float]:
    """Length (m) of the contact's arc, and its slope by the sinkage (m, over 0, to the axle)."""
    depth = min(2.0 * sinkage / diameter, 1.0)  # over the radius
    return 0.5 * diameter * math.acos(1.0 - depth), 1.0 / math.sqrt(depth * (2.0 - depth))


def point_thrust(
    load: float,
    slip: float,
    length: float,
    width: float,
    cohesion: float,
    friction_angle: float,
    shear_displacement: float,
) -> PointThrust:
    """Thrust in the integrated form of Janosi and Hanamoto 1961, as `traction.thrust`.

    load: N. slip: -1 .. 1. length, width: of the contact, m. friction_angle: rad.
    shear_displacement: kappa, m. Linear in the cohesion (Pa), so that goes on below 0.
    """
    tangent = math.tan(friction_angle)
    limit = width * length * cohesion + load * tangent
    by_x = length / shear_displacement
    x = abs(slip) * by_x
    if x > 1e-4:
        rising = -math.expm1(-x)
        share = 1.0 - rising / x
        share_slope = (rising / x - (1.0 - rising)) / x
    else:
        share, share_slope = x / 2.0 - x**2 / 6.0, 0.5 - x / 3.0
    sign = math.copysign(1.0, slip)
    return PointThrust(
        sign * limit * share,
        limit,
        sign * tangent * share,
        sign * (width * cohesion * share + limit * share_slope * abs(slip) / shear_displacement),
        limit * share_slope * by_x,  # even in slip: no sign
        sign * width * length * share,
        sign * load * (1.0 + tangent**2) * share,
        -sign * limit * share_slope * x,
    )
