# SPDX-License-Identifier: Apache-2.0
"""What goes into the traction filter and comes out of it: a wheel on its soil, means of a step, forces."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.physics.wheel import Quantity

Array = NDArray[np.float64]


class RollingContact(NamedTuple):
    """A wheel that rolls: load on the soil (N), sinkage, diameter, width (m), and the soil's exponent n.

    other: resistance (N) of the model's effects. thrust_factor: of the effects on thrust, 1 without. own:
    what is the wheel's own, by place and load: variances and covariance of sinkage and ln load (zz, zw, ww).
    """

    load: float
    sinkage: float
    diameter: float
    width: float
    exponent: float
    other: float = 0.0
    thrust_factor: float = 1.0
    own: tuple[float, float, float] = (0.0, 0.0, 0.0)


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


class Force(NamedTuple):
    """A force (N), its slopes by the state, shape (size,), and by slip, ln load and sinkage."""

    value: float
    row: Array
    by_slip: float
    by_log_load: float
    by_sinkage: float

    def own(self, contact: RollingContact) -> float:
        """Variance (N^2) by what is the wheel's own."""
        zz, zw, ww = contact.own
        a, b = self.by_sinkage, self.by_log_load
        return max(a * a * zz + 2.0 * a * b * zw + b * b * ww, 0.0)


class Forces(NamedTuple):
    """Of a wheel: its thrust, its pull, and the torque that is shown, as a force at the rim."""

    thrust: Force
    pull: Force
    rim: Force


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
