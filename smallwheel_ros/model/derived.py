# SPDX-License-Identifier: Apache-2.0
"""Numbers of a soil that follow from its parameters, with their deviations.

    std(f)^2 = g' C g,   g = df/dtheta          (the delta method, to first order)

K is here the shear deformation modulus. A fit works with ln p_ref and ln K (`fitting.parameters`), people
with k and K. A parameter that is not in the covariance is treated as exactly known: with one wheel diameter m
is held, and k's deviation is that of k at this m.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.physics.soil import REFERENCE_DIAMETER, REFERENCE_SINKAGE, Soil

Array = NDArray[np.float64]


@dataclass(frozen=True)
class DerivedNumber:
    """A number of a soil that follows from its fitted parameters.

    Attributes
    ----------
    name, value, unit
        Its name (a field of `Soil`), and its value in `unit`.
    std
        Its standard deviation, in its unit; None if unknown.
    follows
        Names of the parameters from which it is computed.
    """

    name: str
    value: float
    std: float | None
    unit: str
    follows: tuple[str, ...]


def derived_numbers(
    soil: Soil, names: Sequence[str], covariance: Array
) -> tuple[DerivedNumber, ...]:
    """Compute k and the shear deformation modulus, each with its standard deviation to first order.

    Parameters
    ----------
    soil
        The soil as fitted.
    names
        Names of the covariance's parameters, as `SOIL.n`; those of other soils may be among them.
    covariance
        Covariance of these parameters, shape (names, names), in the product of their units.

    Returns
    -------
    tuple of DerivedNumber
        `k` (Pa/m^(n+m)) and `shear_displacement` (m), in this order. The deviation is None where the
        covariance lacks the soil's `log_reference_pressure` or `log_shear_displacement`, respectively.
    """
    # ln k = ln p_ref - n ln z_ref - m ln D_ref
    of_k = {
        "log_reference_pressure": soil.k,
        "n": -soil.k * float(np.log(REFERENCE_SINKAGE)),
        "m": -soil.k * float(np.log(REFERENCE_DIAMETER)),
    }
    modulus = soil.shear_displacement
    of_modulus = {"log_shear_displacement": modulus}
    return tuple(
        DerivedNumber(name, value, _deviation(soil, slopes, names, covariance), unit, (*slopes,))
        for name, value, unit, slopes in (
            ("k", soil.k, "Pa/m^(n+m)", of_k),
            ("shear_displacement", modulus, "m", of_modulus),
        )
    )


def _deviation(
    soil: Soil, slopes: Mapping[str, float], names: Sequence[str], covariance: Array
) -> float | None:
    """Standard deviation, to first order, of a number that follows from the soil's parameters.

    slopes: its derivative with respect to each parameter, by name. None where the covariance lacks the first
    of these parameters; any other that it lacks is taken as exactly known.
    """
    known = [name for name in slopes if f"{soil.name}.{name}" in names]
    if next(iter(slopes)) not in known:
        return None
    at = [names.index(f"{soil.name}.{name}") for name in known]
    g = np.array([slopes[name] for name in known])
    return float(np.sqrt(g @ covariance[np.ix_(at, at)] @ g))
