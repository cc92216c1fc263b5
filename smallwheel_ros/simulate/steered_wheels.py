# SPDX-License-Identifier: Apache-2.0
"""Steered wheels: which way they point, and how far each travels when the vehicle moves.

Every wheel is turned square to the point that the vehicle turns about. A bend changes slowly; a
wheel that has to turn far is turned while the vehicle stands.
"""

from __future__ import annotations

import math

import numpy as np

from smallwheel_ros.simulate.truth import Array
from smallwheel_ros.simulate.world import SimulatedRover

_BEND_RATE = 0.25  # 1/m in a second, by which a bend changes
_RATE = 0.8  # rad/s, of a steering motor
_FAR = 0.1  # rad: what is further off is turned at rest


class SteeredWheels:
    """Angles of a rover's wheels (rad, positive to the left), and the vehicle's course `crab` (rad)."""

    def __init__(self, rover: SimulatedRover) -> None:
        self.x, self.y = (np.array([getattr(w, axis) for w in rover.wheels]) for axis in "xy")
        self.free = np.array([wheel.steered for wheel in rover.wheels])
        self.pivot = rover.pivot
        self.angle: Array = np.zeros(self.x.size)
        self.bend = self.crab = 0.0

    def bent(self, rim: float, turning: float, tick: float) -> float:
        """Limit the rate of turning in a tick, as the curvature of the path cannot change at once.

        Parameters
        ----------
        rim
            Commanded speed of the rims, m/s; at 0 the rate is not limited.
        turning
            Commanded rate of turning, rad/s.
        tick
            Length of the tick, s.

        Returns
        -------
        float
            Rate of turning that is reached, rad/s.
        """
        if not rim:
            return turning
        wish, most = turning / rim, _BEND_RATE * tick
        self.bend += min(max(wish - self.bend, -most), most)
        return self.bend * rim

    def turn_to(self, rim: float, turning: float, crab: float, tick: float) -> bool:
        """Turn the wheels by one tick towards the angles that a speed and a rate of turning need.

        Parameters
        ----------
        rim
            Speed of the rims, m/s.
        turning
            Rate of turning, rad/s.
        crab
            Course of the vehicle from its heading, rad.
        tick
            Length of the tick, s.

        Returns
        -------
        bool
            Whether the wheels stand near enough to their angles for the rover to drive.
        """
        self.crab = crab
        if not rim and not turning:
            return True
        across = self.velocities(rim, turning)
        wish = np.arctan2(across[1], across[0])
        wish = np.where(self.free, wish - math.pi * np.round(wish / math.pi), 0.0)
        off = wish - self.angle
        ready = bool(np.abs(off).max() <= _FAR)
        self.angle = self.angle + (off if ready else np.clip(off, -_RATE * tick, _RATE * tick))
        return ready

    def velocities(self, speed: float, rate: float) -> Array:
        """Velocities of the wheels' places, ahead and to the left.

        Parameters
        ----------
        speed
            Speed along the course, m/s.
        rate
            Rate of turning, rad/s.

        Returns
        -------
        ndarray
            Shape (2, wheels), m/s.
        """
        ahead = speed * math.cos(self.crab) - rate * self.y
        return np.stack([ahead, speed * math.sin(self.crab) + rate * (self.x - self.pivot)])

    @property
    def share(self) -> Array:
        """Distance that each wheel travels along its heading for a metre of the vehicle along its course."""
        return np.asarray(np.cos(self.angle - self.crab))

    @property
    def lever(self) -> Array:
        """Distance that each wheel travels along its heading while the vehicle turns by a radian, m."""
        ahead, left = np.cos(self.angle), np.sin(self.angle)
        return np.asarray((self.x - self.pivot) * left - self.y * ahead)
