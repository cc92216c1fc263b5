# SPDX-License-Identifier: Apache-2.0
"""The rovers that the drives are made with, and how their weight rests on the wheels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from smallwheel_ros.simulate.contact import Array

GRAVITY = 9.81


@dataclass(frozen=True)
class RoverWheel:
    """One wheel: size and place in base_link (x forward, y left), metres."""

    name: str
    diameter: float
    width: float
    x: float
    y: float


@dataclass(frozen=True)
class Rover:
    """Wheels on a rigid frame. Mass in kg; centre of gravity in m, its height above the ground."""

    wheels: tuple[RoverWheel, ...]
    mass: float = 24.0
    gravity_x: float = 0.02
    gravity_y: float = -0.01
    gravity_height: float = 0.33


def _corners(
    front: tuple[float, float], rear: tuple[float, float], rear_track: float = 0.28
) -> tuple[RoverWheel, ...]:
    return tuple(
        RoverWheel(f"{end}_{side}", *size, x, sign * y)
        for end, x, y, size in (("front", 0.35, 0.28, front), ("rear", -0.35, rear_track, rear))
        for side, sign in (("left", 1.0), ("right", -1.0))
    )


ROVERS: dict[str, Rover] = {
    "four": Rover(_corners((0.25, 0.10), (0.25, 0.10))),
    # The rear wheels run beside the front wheels' ruts: what ruts do is not taken for wheel size.
    "two_sizes": Rover(_corners((0.25, 0.10), (0.40, 0.12), rear_track=0.42)),
}


def wheel_loads(
    rover: Rover, climb: Array, roll: Array, acceleration: Array, twist: Array
) -> Array:
    """Load on each wheel (N), shape (times, wheels).

    Parameters
    ----------
    climb
        Slope in the direction of travel (rad), positive uphill, shape (times,) as the others.
    roll
        Slope across (rad), positive when the left side is higher.
    acceleration
        Forward, m/s^2.
    twist
        Share of a wheel's load that uneven ground moves from one diagonal to the other.
    """
    x = np.array([wheel.x for wheel in rover.wheels])
    y = np.array([wheel.y for wheel in rover.wheels])
    normal = rover.mass * GRAVITY * np.cos(climb) * np.cos(roll)
    # The line of the resultant force meets the ground here; loads vary linearly over the wheels.
    inertia = acceleration / GRAVITY
    centre_x = rover.gravity_x - rover.gravity_height * (np.tan(climb) + inertia)
    centre_y = rover.gravity_y - rover.gravity_height * np.tan(roll)
    share = 1.0 + np.outer(centre_x, x) / np.mean(x**2) + np.outer(centre_y, y) / np.mean(y**2)
    share = share + np.outer(twist, np.sign(x * y))
    loads: Array = normal[:, None] / len(x) * np.maximum(share, 0.05)
    return loads
