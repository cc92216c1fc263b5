# SPDX-License-Identifier: Apache-2.0
"""The state of the traction filter and what is believed of it before anything was measured.

State x, with the standard deviations of its prior:

    c, phi, ln K      cohesion, friction angle, shear deformation modulus      as configured; of
                      ln K as well what forms of the shear curve differ by     0.3
    rho               motion resistance that the law does not give, over load  0.02
    d                 error of the measured slips, common to all wheels        0.025 in each step
    d_1 .. d_W        error of each wheel's slip: its radius                   0.01
    eta               share of its rolling displacement by which a wheel shears soil  1, about 0.5
    t_1 .. t_W        ln of the scale of each wheel's torque                   0.1
    b                 zero of the imu, as a force forward per mass           1.5 degrees of g
    f                 friction of the drives at the rim, over load             0.01, about 0.005
    g_0 .. g_N        ln of the grip, in cells of 0.1 m of the ground from under the first wheel to
                      under the last one                                       0.25
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.estimator.strength_estimate import FORM_SHEAR
from smallwheel_ros.physics.wheel import Strength

Array = NDArray[np.float64]

COHESION, FRICTION, SHEAR, OTHER, SLIP, ROLLING, LOSS, LEVEL, WHEELS = range(9)
STRENGTH = 4  # numbers of the state that belong to the soil
GRIP_STD, SLIP_STD = 0.25, 0.025
_OTHER_STD = 0.02
# Motors' torque constants are listed to 10 %, gears' efficiency is known to a tenth at best; bearings,
# seals and gears take up to two hundredths of the load.
_TORQUE_SCALE_STD, _DRIVE_FRICTION, _DRIVE_FRICTION_STD = 0.1, 0.005, 0.01
LEVEL_STD = 0.257  # m/s^2: 1.5 degrees of slope, an imu that nobody has levelled
_RADIUS_STD = 0.01  # a tread, a tyre: hundredths of the radius
_ROLLING, _ROLLING_STD = 1.0, 0.5
# Where a strength is still one: thrust is linear in the cohesion, which may go below 0 a little.
_LOW = {COHESION: -300.0, FRICTION: 0.1, SHEAR: math.log(2e-3)}
_HIGH = {COHESION: 6000.0, FRICTION: 1.0, SHEAR: math.log(0.1)}
_MOST = 2.0  # of all others: a factor of 7 in grip or torque
# A strength that is configured as exact has to stay one that a filter can hold.
_LEAST_STD = (1.0, 1e-4, 1e-3)  # Pa, rad, ln K


def prior(strength: Strength, wheels: int, cells: int) -> tuple[Array, Array]:
    """Means and standard deviations; wheels, cells: how many."""
    shear = min(max(strength.shear_displacement.value, 2e-3), 0.1)
    deviations = (
        strength.cohesion.standard_deviation,
        strength.friction_angle.standard_deviation,
        math.hypot(strength.shear_displacement.standard_deviation / shear, FORM_SHEAR),
    )
    # Of rho, d, eta, f and b, in the order of the state.
    rest = (_OTHER_STD, SLIP_STD, _ROLLING_STD, _DRIVE_FRICTION_STD, LEVEL_STD)
    of_wheels = [_RADIUS_STD] * wheels + [_TORQUE_SCALE_STD] * wheels + [GRIP_STD] * cells
    spread = np.array([*np.maximum(deviations, _LEAST_STD), *rest, *of_wheels])
    mean = np.zeros(len(spread))
    mean[[COHESION, FRICTION]] = strength.cohesion.value, strength.friction_angle.value
    mean[[SHEAR, ROLLING, LOSS]] = math.log(shear), _ROLLING, _DRIVE_FRICTION
    return mean, spread


def bounded(x: Array) -> Array:
    """Return the nearest state in which a soil has a strength."""
    inside = x.copy()
    inside[OTHER:] = np.clip(x[OTHER:], -_MOST, _MOST)
    for place, low in _LOW.items():
        inside[place] = min(max(x[place], low), _HIGH[place])
    return inside
