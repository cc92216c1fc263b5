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
from functools import lru_cache
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.estimator.beside import wheel_of
from smallwheel_ros.estimator.bounded_exponent import (
    exponent_and_slope,
    exponent_of,
    exponent_slope,
)
from smallwheel_ros.estimator.iterated_update import Belief, Four, Point
from smallwheel_ros.estimator.law_covariance import Row
from smallwheel_ros.estimator.point_sinkage import point_pressure, point_sinkage
from smallwheel_ros.estimator.sinkage_observation import Reading
from smallwheel_ros.physics.soil import REFERENCE_DIAMETER, REFERENCE_SINKAGE

Array = NDArray[np.float64]

LOG_REFERENCE_SINKAGE = math.log(REFERENCE_SINKAGE)
_STEP = 1e-3  # of q
_FIRST_GRID, _GRID = 20, 100  # of ln z_ref and of q


class Pressure(NamedTuple):
    """ln of the pressure at the reference sinkage under the coordinates' diameter, with slopes.

    by_exponent: by n, the first coordinate held.
    """

    value: float
    by_first: float
    by_exponent: float


class Coordinates(Protocol):
    """What the first number of the state is; the others are q (see `bounded_exponent`) and m.

    diameter_log: ln of the diameter at which it holds, over the reference diameter.
    """

    diameter_log: float

    def point(self, reading: Reading, x: Four, belief: Belief) -> Point:
        """Give what is shown at (first, q, m, spot), with slopes by each of the four numbers.

        Raises ArithmeticError or ValueError where nothing is.
        """


class Direct:
    """The first number is ln of the pressure at the reference sinkage and diameter."""

    diameter_log = 0.0

    def point(self, reading: Reading, x: Four, belief: Belief) -> Point:
        """See `Coordinates`."""
        first, q, m, spot = x
        n, by_q = exponent_and_slope(q)
        share = _slope_share(belief, x, n, by_q)
        scale = math.sqrt(share)
        across = reading.observe.diameter_log
        shown = reading.observe(first + scale * spot + across * m, n)
        by = shown.by_pressure
        return Point(
            shown.value,
            (by, shown.by_exponent * by_q, by * across, by * scale),
            reading.noise + shown.by_load**2 * share * reading.load_noise,
            shown.sunk_to_axle,
        )


class OfReference:
    """The first number is ln of the sinkage (m) of a plain rolling wheel.

    load: N. diameter, width: m.
    """

    def __init__(self, load: float, diameter: float, width: float) -> None:
        self.wheel = load, diameter, width
        self.diameter_log = math.log(diameter / REFERENCE_DIAMETER)
        self.loading = wheel_of(load, diameter, width)

    def point(self, reading: Reading, x: Four, belief: Belief) -> Point:
        """See `Coordinates`.

        A spot shifts ln z_ref, by -spot/(n + 1/2): it must not turn the direction of n either.
        """
        first, q, m, spot = x
        n, by_q = exponent_and_slope(q)
        share = _slope_share(belief, x, n, by_q)
        by_spot = -math.sqrt(share) / (n + 0.5)
        log_z = first + by_spot * spot
        observe = reading.observe
        across = observe.diameter_log - self.diameter_log
        shown = observe.beside(self.loading, log_z, n, across * m)
        if shown is None:
            pressure = self.pressure(log_z, n)
            shown = observe(pressure.value + across * m, n)
            value, by_pressure, by_exponent, by_load, sunk, _ = shown
            by_first = by_pressure * pressure.by_first
            by_exponent += by_pressure * pressure.by_exponent
        else:
            value, by_pressure, by_exponent, by_load, sunk, by_first = shown
        return Point(
            value,
            (by_first, by_exponent * by_q, by_pressure * across, by_first * by_spot),
            reading.noise + by_load * by_load * share * reading.load_noise,
            sunk,
        )

    def pressure(self, log_sinkage: float, exponent: float) -> Pressure:
        """Give the pressure. Raises ArithmeticError or ValueError where there is none."""
        log_modulus, by_first, by_exponent = point_pressure(*self.wheel, log_sinkage, exponent)
        return Pressure(
            log_modulus + exponent * LOG_REFERENCE_SINKAGE,
            by_first,
            by_exponent + LOG_REFERENCE_SINKAGE,
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

    def to_direct(self, soil: Row) -> tuple[Row, Row]:
        """Turn (ln z_ref, q, m) into (ln pressure, q, m), with the slopes of ln pressure."""
        first, q, m = soil
        n, by_q = exponent_and_slope(q)
        p = self.pressure(first, n)
        slopes = p.by_first, p.by_exponent * by_q, -self.diameter_log
        return (p.value - self.diameter_log * m, q, m), slopes

    def bend(self, soil: Row) -> float:
        """Second derivative of ln pressure by q near (ln z_ref, q, m), for its variance."""
        first, q, _ = soil
        return _bend(self.wheel, round(first * _FIRST_GRID), round(q * _GRID))


@lru_cache(maxsize=256)
def _bend(wheel: tuple[float, float, float], first: int, q: int) -> float:
    """See `OfReference.bend`, at a place of the grid: it is a correction, and changes slowly."""
    coordinates = OfReference(*wheel)
    up, down = (
        coordinates.pressure(first / _FIRST_GRID, exponent_of(at)).by_exponent * exponent_slope(at)
        for at in (q / _GRID + _STEP, q / _GRID - _STEP)
    )
    return (up - down) / (2.0 * _STEP)


def _slope_share(belief: Belief, x: Four, n: float, by_q: float) -> float:
    """Mean of 1/(n + 1/2)^2 over its value at the mean n: what an uncertain n adds.

    The spot and the load cell's noise change ln z by their 1/(n + 1/2)-fold. Without this, one load,
    which leaves n open, would make the innovations seem too large. n, by_q: at x.
    """
    if x is not belief.mean:
        n, by_q = exponent_and_slope(belief.mean[1])
    return 1.0 + 3.0 * belief.rows[1][1] * (by_q / (n + 0.5)) ** 2
