# SPDX-License-Identifier: Apache-2.0
"""Steered wheels: their angles, and the distance that each travels when the vehicle moves.

Every wheel is turned at right angles to the line to the point about which the vehicle turns. The curvature
of the path changes slowly; a wheel that has to turn by a large angle is turned while the vehicle stands.
"""

from __future__ import annotations

import math

import numpy as np

from smallwheel_ros.simulate.truth import Array
from smallwheel_ros.simulate.world import SimulatedRover

_BEND_RATE = 0.25  # 1/m per second: fastest change of the path's curvature
_RATE = 0.8  # rad/s: speed of a steering motor
_FAR = 0.1  # rad: a wheel further from its wanted angle is turned while the vehicle stands


class SteeredWheels:
    """The steering of a rover over time.

    Parameters
    ----------
    rover
        The rover; its wheels begin straight ahead.

    Attributes
    ----------
    angle
        Angle of each wheel from straight ahead, rad, positive to the left, shape (wheels,).
    bend
        Curvature of the path, 1/m, positive to the left.
    crab
        Angle of the vehicle's course to the left of its heading, rad.
    """

    def __init__(self, rover: SimulatedRover) -> None:
        self.x, self.y = (np.array([getattr(w, axis) for w in rover.wheels]) for axis in "xy")
        self.free = np.array([wheel.steered for wheel in rover.wheels])
        self.pivot = rover.pivot
        self.angle: Array = np.zeros(self.x.size)
        self.bend = self.crab = 0.0

    def bent(self, rim: float, turning: float, tick: float) -> float:
        """Change the path's curvature towards the commanded one, no faster than 0.25 1/m per second.

        Parameters
        ----------
        rim
            Commanded speed of the rims, m/s, negative backward; at 0 the rate of turning is not limited.
        turning
            Commanded rate of turning, rad/s, positive to the left.
        tick
            Length of the time step, s.

        Returns
        -------
        float
            Rate of turning that is reached in this step, rad/s.
        """
        if not rim:
            return turning
        wish, most = turning / rim, _BEND_RATE * tick
        self.bend += min(max(wish - self.bend, -most), most)
        return self.bend * rim

    def turn_to(self, rim: float, turning: float, crab: float, tick: float) -> bool:
        """Turn the wheels for one time step towards the angles that a motion of the vehicle needs.

        Where no wheel is off by more than 0.1 rad all take their angles at once, else at 0.8 rad/s at most.

        Parameters
        ----------
        rim
            Speed of the rims, m/s.
        turning
            Rate of turning, rad/s, positive to the left. Without speed and turning the wheels stay.
        crab
            Angle of the vehicle's course to the left of its heading, rad, which is kept.
        tick
            Length of the time step, s.

        Returns
        -------
        bool
            Whether the wheels have their angles, so that the rover may drive.
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
        """Velocities of the points where the wheels are mounted.

        Parameters
        ----------
        speed
            Speed along the course `crab`, m/s.
        rate
            Rate of turning, rad/s, positive to the left.

        Returns
        -------
        ndarray
            Components ahead and to the left in base_link, shape (2, wheels), m/s.
        """
        ahead = speed * math.cos(self.crab) - rate * self.y
        return np.stack([ahead, speed * math.sin(self.crab) + rate * (self.x - self.pivot)])

    @property
    def share(self) -> Array:
        """Travel of each wheel along its heading per metre of the vehicle along its course, (wheels,)."""
        return np.asarray(np.cos(self.angle - self.crab))

    @property
    def lever(self) -> Array:
        """Travel (m) of each wheel along its heading per radian of turning to the left, shape (wheels,)."""
        ahead, left = np.cos(self.angle), np.sin(self.angle)
        return np.asarray((self.x - self.pivot) * left - self.y * ahead)
