# SPDX-License-Identifier: Apache-2.0
"""Angle of a steered wheel, from the position of its joint, and whether it is plausible."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

# rad: modules that steer endlessly count on beyond half a turn; none is known to exceed a whole one.
_MOST = math.tau
_SURE = 5  # messages beyond it, after which it is no glitch, but another unit
# rad; ns: an angle that is constant for `_STANDS` and then differs by over `_STEP` comes in steps: no wheel
# turns so fast.
_STEP, _STANDS = 0.1, 250_000_000


@dataclass(frozen=True)
class SteeringReader:
    """Converts the position of a joint (rad) to the angle of a wheel, positive to the left.

    Attributes
    ----------
    sign
        1 if the joint's position increases to the left, else -1.
    zero
        Position of the joint at which the wheel points straight ahead, rad.
    linkage
        For an axle with one central angle, distance of the axle ahead of the line across the vehicle on
        which its turning centre lies, m; 0 if the wheel has a joint of its own.
    left
        Distance of the wheel to the left of the vehicle's middle, m; used with a linkage only.
    """

    sign: int
    zero: float
    linkage: float = 0.0
    left: float = 0.0

    def angle(self, position: Array) -> Array:
        """Angles (rad) of the wheel at positions (rad) of its joint, same shape.

        With a linkage tan d_i = L tan d / (L - y_i tan d), so that the axes of all wheels meet in one turning
        centre: d is the central angle, L `linkage`, y_i `left`.
        """
        central: Array = self.sign * (position - self.zero)
        if not self.linkage:
            return central
        length, side = abs(self.linkage), math.copysign(1.0, self.linkage)
        across, along = np.sin(central), np.cos(central)
        return np.asarray(np.arctan2(length * across, length * along - side * self.left * across))


class SteeringAngle:
    """Checks the steering angles of one wheel.

    Attributes
    ----------
    wrong
        Why some or all angles are not used, in words; empty as long as all are.
    odd
        What is odd about angles that are used, in words; empty if nothing is.
    new_steps
        Number of jumps of the angle in the messages of the last call.
    """

    def __init__(self) -> None:
        self.wrong = self.odd = ""
        self.new_steps = 0
        self._beyond = 0
        self._last, self._since = math.nan, 0  # rad; ns, since when it has been the same

    def usable(self, stamps: Integers, angles: Array) -> NDArray[np.bool_]:
        """Tell which further messages have a usable angle.

        Angles over a whole turn are not usable. At the fifth of them all are taken to be in degrees, and no
        further message is usable.

        Parameters
        ----------
        stamps
            Shape (messages,), ns.
        angles
            Shape (messages,), rad; NaN counts as usable.

        Returns
        -------
        ndarray
            Shape (messages,), bool.
        """
        beyond = np.abs(angles) > _MOST
        count = self._beyond + np.cumsum(beyond)
        if beyond.any():
            self._beyond = int(count[-1])
            largest = float(angles[beyond][-1])
            self.wrong = (
                f"its angle is {largest:g} rad, expected at most a turn from straight ahead"
                f" ({_MOST:.3g} rad): is it in degrees? (parameters <wheel>.steering_joint, steering_zero)"
            )
        self.new_steps = 0
        for stamp, angle in zip(stamps.tolist(), angles.tolist(), strict=True):
            if angle == self._last or math.isnan(angle):
                continue
            step = abs(angle - self._last)
            if step > _STEP and stamp - self._since >= _STANDS:
                self.new_steps += 1
                self.odd = (
                    f"its angle stands and then is {step:.2f} rad off: it comes in steps, so slip is unsure"
                    " while it changes"
                )
            self._last, self._since = angle, stamp
        return ~beyond & (count < _SURE)
