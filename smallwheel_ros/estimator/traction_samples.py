# SPDX-License-Identifier: Apache-2.0
"""What goes into the traction filter and comes out of it: a wheel on its soil, means of a step, forces."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.physics.wheel import Quantity

Array = NDArray[np.float64]


class RollingContact(NamedTuple):
    """A wheel that rolls: load (N), sinkage, diameter, width (m), and its motion resistance (N).

    resistance: with the deviation that all wheels share, by the law. thrust_factor: of the model's effects on
    thrust, 1 without. own: what is the wheel's own, by place and load: variances and covariances of sinkage,
    resistance and ln load (zz, zr, zw, rr, rw, ww).
    """

    load: float
    sinkage: float
    diameter: float
    width: float
    resistance: Quantity
    thrust_factor: float = 1.0
    own: tuple[float, ...] = (0.0,) * 6

    @property
    def arm(self) -> float:
        """Lever (m) of the thrust where shear stress is the same along the arc."""
        entry = math.acos(max(1.0 - 2.0 * self.sinkage / self.diameter, 0.0))
        return 0.5 * self.diameter * (entry / math.sin(entry) if entry > 1e-6 else 1.0)


class WheelStep(NamedTuple):
    """Means of one wheel over a step; torque (N m) and pull (N) None where not measured.

    doubt: standard deviation of the slip by what this wheel alone may be wrong by.
    """

    order: int
    contact: RollingContact
    slip: float
    torque: float | None = None
    pull: Quantity | None = None
    doubt: float = 0.0


class Thrust(NamedTuple):
    """Thrust (N), its slopes by the state, shape (size,), and by slip, ln load and sinkage."""

    value: float
    row: Array
    by_slip: float
    by_log_load: float
    by_sinkage: float

    def own(self, contact: RollingContact, resisted: bool = True) -> float:
        """Variance (N^2) by what is the wheel's own. resisted: of thrust less resistance."""
        zz, zr, zw, rr, rw, ww = contact.own
        a, b, c = self.by_sinkage, -1.0 if resisted else 0.0, self.by_log_load
        found = a * a * zz + b * b * rr + c * c * ww + 2.0 * (a * b * zr + a * c * zw + b * c * rw)
        return max(found, 0.0)


class Torque(NamedTuple):
    """A torque of this moment, as a force at the rim: innovation (N) and its variance (N^2).

    shared, own: covariance of the innovation with the state, shape (size,), and with the thrust's
    noise about that of the state (N^2).
    """

    innovation: float
    variance: float
    shared: Array
    own: float

    def corrected(self, value: float, variance: float, row: Array) -> tuple[float, float]:
        """Correct thrust or pull (N) and variance by it; row: slopes by the state."""
        common = float(row @ self.shared) + self.own
        gain = common / self.variance
        return value + gain * self.innovation, max(variance - gain * common, 0.0)
