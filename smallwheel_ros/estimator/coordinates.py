"""In which numbers the filter knows the soil: the sinkage of a reference wheel, n, and m.

A filter that is linearised anew for each measurement gains, from the differences between its own
linearisations, knowledge that no measurement gave: with one load it becomes sure of n. The cure is
a state in which the measurements are nearly straight lines of fixed direction. From p = k z^n D^m
the contact integral gives, for shallow sinkage,

    ln z = ln z_ref + [ln(W / b sqrt(D)) - ln(W_ref / b_ref sqrt(D_ref)) - m ln(D / D_ref)] / (n + 1/2)

where z_ref is the sinkage of a reference wheel: the wheel and load that were measured first. Under
that load the measurement is ln z_ref itself, and says nothing of n, however the soil drifts and the
estimate moves; at another load n enters in proportion to the difference, and m at another diameter.

The prior stays what it is, in ln of the pressure at a fixed sinkage, n and m (`Direct`): that is
what is known of a soil before the wheels are. Only from the first measurement on the filter works
in `OfReference`.
"""

from __future__ import annotations

import math
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.estimator.bounded_exponent import exponent_of, exponent_slope
from smallwheel_ros.estimator.point_sinkage import point_pressure, point_sinkage
from smallwheel_ros.physics.soil import REFERENCE_DIAMETER, REFERENCE_SINKAGE

Array = NDArray[np.float64]

LOG_REFERENCE_SINKAGE = math.log(REFERENCE_SINKAGE)
_STEP = 1e-3  # of q


class Pressure(NamedTuple):
    """ln of the pressure at the reference sinkage under the coordinates' diameter, with slopes.

    by_exponent: by n, the first coordinate held. by_spot: by the deviation of ln k at a spot.
    """

    value: float
    by_first: float
    by_exponent: float
    by_spot: float


class Coordinates(Protocol):
    """What the first number of the state is; the others are q (see `bounded_exponent`) and m.

    diameter_log: ln of the diameter at which it holds, over the reference diameter.
    """

    diameter_log: float

    def pressure(self, first: float, exponent: float, spot: float) -> Pressure:
        """Give the pressure. Raises ArithmeticError or ValueError where there is none."""


class Direct:
    """The first number is ln of the pressure at the reference sinkage and diameter."""

    diameter_log = 0.0

    def pressure(self, first: float, exponent: float, spot: float) -> Pressure:
        """See `Coordinates`."""
        return Pressure(first + spot, 1.0, 0.0, 1.0)


class OfReference:
    """The first number is ln of the sinkage (m) of a plain rolling wheel.

    load: N. diameter, width: m.
    """

    def __init__(self, load: float, diameter: float, width: float) -> None:
        self.wheel = load, diameter, width
        self.diameter_log = math.log(diameter / REFERENCE_DIAMETER)

    def pressure(self, first: float, exponent: float, spot: float) -> Pressure:
        """See `Coordinates`.

        A spot shifts ln z_ref, by -spot/(n + 1/2): it must not turn the direction of n either.
        """
        by_spot = -1.0 / (exponent + 0.5)
        log_modulus, by_first, by_exponent = point_pressure(
            *self.wheel, first + by_spot * spot, exponent
        )
        return Pressure(
            log_modulus + exponent * LOG_REFERENCE_SINKAGE,
            by_first,
            by_exponent + LOG_REFERENCE_SINKAGE,
            by_first * by_spot,
        )

    def from_direct(self, soil: Array) -> tuple[Array, Array]:
        """Turn (ln pressure, q, m) into (ln z_ref, q, m), with the Jacobian (3, 3).

        Raises ArithmeticError or ValueError where the wheel has no sinkage.
        """
        pressure, q, m = soil.tolist()
        n = exponent_of(q)
        log_modulus = pressure + self.diameter_log * m - n * LOG_REFERENCE_SINKAGE
        log_z, slope_load, slope_exponent, _ = point_sinkage(*self.wheel, log_modulus, n)
        jacobian = np.eye(3)
        jacobian[0] = (
            -slope_load,
            (slope_exponent + slope_load * LOG_REFERENCE_SINKAGE) * exponent_slope(q),
            -slope_load * self.diameter_log,
        )
        return np.array([log_z, q, m]), jacobian

    def to_direct(self, soil: Array) -> tuple[Array, Array]:
        """Turn (ln z_ref, q, m) into (ln pressure, q, m), with the Jacobian (3, 3)."""
        first, q, m = soil.tolist()
        p = self.pressure(first, exponent_of(q), 0.0)
        jacobian = np.eye(3)
        jacobian[0] = p.by_first, p.by_exponent * exponent_slope(q), -self.diameter_log
        return np.array([p.value - self.diameter_log * m, q, m]), jacobian

    def bend(self, soil: Array) -> float:
        """Second derivative of ln pressure by q at (ln z_ref, q, m), for its variance."""
        first, q, _ = soil.tolist()
        up, down = (
            self.pressure(first, exponent_of(at), 0.0).by_exponent * exponent_slope(at)
            for at in (q + _STEP, q - _STEP)
        )
        return (up - down) / (2.0 * _STEP)
