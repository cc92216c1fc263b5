# SPDX-License-Identifier: Apache-2.0
"""Thrust by published forms that treat the contact as a whole.

The model's own law of pull and torque is the balance of stresses along the contact (`stresses`).
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

# stress_integral: the balance of `stresses`, the default. wong_reece: the same, but with the pressure that k
# gives at each depth, and a peak that moves with slip. integrated, exponential: `thrust` below.
ThrustForm = Literal["stress_integral", "integrated", "exponential", "wong_reece"]


def contact_length(sinkage: ArrayLike, diameter: ArrayLike) -> Array:
    """Length (m) of the contact's arc, l = r theta0 with cos(theta0) = 1 - z/r.

    Parameters
    ----------
    sinkage, diameter
        Sinkage z and diameter 2 r of the wheel, m; z is clipped to the range from 0 to r.
    """
    radius = 0.5 * np.asarray(diameter, dtype=float)
    return np.asarray(radius * np.arccos(1.0 - np.clip(np.asarray(sinkage) / radius, 0.0, 1.0)))


def thrust(
    load: ArrayLike,
    slip: ArrayLike,
    sinkage: ArrayLike,
    diameter: ArrayLike,
    width: ArrayLike,
    cohesion: ArrayLike,
    friction_angle: ArrayLike,
    shear_displacement: ArrayLike,
    form: Literal["integrated", "exponential"] = "integrated",
) -> Array:
    """Thrust (N) of the soil on a wheel at a slip; negative where the wheel skids.

    Equations 1 and 2 are those of Meirion-Griffith and Spenko (2011).

    H0 = b l c + W tan(phi)                                     (eq. 1; Bekker 1956)
    exponential: H = H0 (1 - exp(-i l / kappa))                 (eq. 2)
    integrated:  H = H0 [1 - kappa/(i l) (1 - exp(-i l/kappa))] (Janosi and Hanamoto 1961)
    The second averages the first over the contact of length l (`contact_length`), along which the shear
    displacement grows to i l.

    Parameters
    ----------
    load
        Normal load W, N.
    slip
        Slip i, -1 to 1.
    sinkage, diameter, width
        Sinkage z, diameter D and width b of the wheel, m.
    cohesion
        Cohesion c of the soil, Pa.
    friction_angle
        Angle of internal friction phi of the soil, rad.
    shear_displacement
        Shear deformation modulus kappa, m.
    form
        Which of the two formulas.
    """
    length = contact_length(sinkage, diameter)
    limit = np.asarray(width) * length * np.asarray(cohesion) + np.asarray(load) * np.tan(
        friction_angle
    )
    i = np.asarray(slip, dtype=float)
    x = np.abs(i) * length / np.asarray(shear_displacement)
    if form == "exponential":
        share = -np.expm1(-x)
    else:
        # 1 - (1 - e^-x)/x loses its digits for small x, where it is x/2 - x^2/6
        safe = np.where(x > 1e-4, x, 1.0)
        share = np.where(x > 1e-4, 1.0 + np.expm1(-safe) / safe, x / 2.0 - x**2 / 6.0)
    return np.asarray(np.sign(i) * limit * share)
