# SPDX-License-Identifier: Apache-2.0
"""Laws of how size changes the pressure at one depth, for plates, and for wheels by the closed form.

The laws share one form, with p_ref the pressure at a reference sinkage z_ref under a plate of the
reference size, and one number s for the influence of size (rho: size over reference size):

    p = p_ref (z / z_ref)^n g(rho)

    Meirion-Griffith & Spenko  p = k z^n D^m                            g = rho^s, s = m, size D
    Bernstein and Goriatchkin  p = k z^n                                g = 1: no influence of size
    Bekker                     p = (kc/b + kphi) z^n                    g = 1 - s + s / rho, size b
    Reece                      p = (c kc' + gamma b kphi') (z / b)^n    g = (1 - s + s rho) rho^-n, size b

b is the smaller side of a rectangular plate and the radius of a round one (Bekker 1969; Wong 2008,
chapter 2). Without the soil's cohesion c and unit weight gamma Reece's law has the two lumped constants
c kc' (Pa) and gamma kphi' (Pa/m) (Reece 1965; Wong 2008, chapter 2).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from smallwheel_ros.physics.conditions import Conditions
from smallwheel_ros.physics.sinkage import closed_form, plate_sinkage
from smallwheel_ros.physics.soil import REFERENCE_SINKAGE

Array = NDArray[np.float64]

_LEAST_FACTOR = 0.02  # least g: on its way a fit may try values of s that make g 0 or negative


def plate_area(diameter: ArrayLike) -> Array:
    """Area (m2) of a round plate, or of a rectangular one of that equivalent diameter (m)."""
    return np.asarray(np.pi / 4.0 * np.asarray(diameter, dtype=float) ** 2)


def equivalent_diameter(width: ArrayLike, length: ArrayLike) -> Array:
    """Diameter (m) of the round plate of the same area as a rectangular one.

    D = sqrt(4 w l / pi): the equivalent radius of a rectangular footing under vertical load
    (Richart, Hall and Woods 1970, Vibrations of Soils and Foundations, chapter 7).

    Parameters
    ----------
    width, length
        Sides of the plate, m.
    """
    area = np.asarray(width, dtype=float) * np.asarray(length, dtype=float)
    return np.asarray(np.sqrt(4.0 / np.pi * area))


def smaller_dimension(conditions: Conditions) -> Array:
    """Bekker's b (m): the smaller side of a rectangular plate, the radius of a round one.

    A plate has a width only where it is rectangular; b of a wheel is its width.
    """
    rectangular = np.nan_to_num(conditions.width) > 0.0
    return np.where(conditions.plate & ~rectangular, 0.5 * conditions.diameter, conditions.width)


class Constant(NamedTuple):
    """A constant of a published law: its name and its SI unit, with the exponents n and m as letters."""

    name: str
    unit: str


class PlateLaw(NamedTuple):
    """A law of how a plate's or wheel's size changes the pressure, p = p_ref (z / z_ref)^n g.

    Attributes
    ----------
    id, name, formula, source
        Id in code, and for people the name, the formula and the publication.
    names
        Names and units of the published constants.
    size
        Function of the conditions that returns the size that counts, D or b of each row, m, shape (rows,).
    factor
        Function g(rho, n, s) that returns the pressure over that at the reference size; rho is the size over
        the reference size, s a number for the influence of size.
    constants
        Function of (K, reference size in m, n, s) that returns the published constants in the order of
        `names`, SI units; K = p_ref / z_ref^n, Pa/m^n.
    tied_to_n
        Ratio s / n at which size has no influence near the reference size.
    """

    id: Literal["meirion_griffith_spenko", "bekker", "reece", "bernstein_goriatchkin"]
    name: str
    formula: str
    source: str
    names: tuple[Constant, ...]
    size: Callable[[Conditions], Array]
    factor: Callable[[Array, Array | float, Array | float], Array]
    constants: Callable[[float, float, float, float], tuple[float, ...]]
    tied_to_n: float = 0.0

    def modulus(self, log_pressure: float, n: float) -> float:
        """K = p_ref / z_ref^n (Pa/m^n), the modulus under a plate of the reference size.

        Parameters
        ----------
        log_pressure
            ln of the pressure p_ref (Pa) at the reference sinkage z_ref, 10 mm.
        n
            Exponent of sinkage, 1.
        """
        return float(np.exp(log_pressure - n * np.log(REFERENCE_SINKAGE)))

    def moduli(
        self, conditions: Conditions, reference: float, log_pressure: float, n: float, s: float
    ) -> Array:
        """K = p / z^n (Pa/m^n) under each plate or wheel, shape (rows,).

        The factor g of the size is at least 0.02, so that K stays positive whatever s is.

        Parameters
        ----------
        conditions
            Plates and wheels.
        reference
            Size of the plate to which the pressure refers, m.
        log_pressure
            ln of the pressure (Pa) under a plate of the reference size at the reference sinkage, 10 mm.
        n
            Exponent of sinkage, 1.
        s
            Number s for the influence of size in the law's g, 1; for Meirion-Griffith and Spenko's it is m.
        """
        g = np.maximum(self.factor(self.size(conditions) / reference, n, s), _LEAST_FACTOR)
        return np.asarray(self.modulus(log_pressure, n) * g)

    def sinkage(
        self, conditions: Conditions, reference: float, log_pressure: float, n: float, s: float
    ) -> Array:
        """Sinkage (m) of each plate or wheel under its load, shape (rows,).

        A wheel's sinkage is that of the closed form (Meirion-Griffith and Spenko 2011, eq. 7) with the K of
        its size.

        Parameters
        ----------
        conditions
            Plates and wheels, with their loads.
        reference
            Size of the plate to which the pressure refers, m.
        log_pressure
            ln of the pressure (Pa) under a plate of the reference size at the reference sinkage, 10 mm.
        n
            Exponent of sinkage, 1.
        s
            Number s for the influence of size in the law's g, 1; for Meirion-Griffith and Spenko's it is m.
        """
        modulus = self.moduli(conditions, reference, log_pressure, n, s)
        plate = conditions.plate
        found = np.empty(len(conditions))
        found[plate] = plate_sinkage(
            conditions.load[plate], conditions.diameter[plate], modulus[plate], n
        )
        wheel = conditions.take(~plate)
        if len(wheel):
            found[~plate] = closed_form(
                wheel.load, wheel.diameter, wheel.width, modulus[~plate], n, 0.0
            ).sinkage
        return found


LAWS: tuple[PlateLaw, ...] = (
    PlateLaw(
        "meirion_griffith_spenko",
        "Meirion-Griffith & Spenko",
        "p = k z^n D^m",
        "Meirion-Griffith and Spenko 2011, eq. 9",
        (Constant("k", "Pa/m^(n+m)"), Constant("n", "1"), Constant("m", "1")),
        lambda conditions: conditions.diameter,
        lambda rho, n, s: np.asarray(rho**s),
        lambda modulus, size, n, s: (modulus * size**-s, n, s),
    ),
    PlateLaw(
        "bekker",
        "Bekker",
        "p = (kc/b + kphi) z^n",
        "Bekker 1969; Wong 2008, chapter 2",
        (Constant("kc", "Pa/m^(n-1)"), Constant("kphi", "Pa/m^n"), Constant("n", "1")),
        smaller_dimension,
        lambda rho, n, s: np.asarray(1.0 - s + s / rho),
        lambda modulus, size, n, s: (modulus * s * size, modulus * (1.0 - s), n),
    ),
    PlateLaw(
        "reece",
        "Reece",
        "p = (c kc' + gamma kphi' b) (z/b)^n",
        "Reece 1965; Wong 2008, chapter 2",
        (Constant("c kc'", "Pa"), Constant("gamma kphi'", "Pa/m"), Constant("n", "1")),
        smaller_dimension,
        lambda rho, n, s: np.asarray((1.0 - s + s * rho) * rho ** -np.asarray(n)),
        lambda modulus, size, n, s: (
            modulus * (1.0 - s) * size**n,
            modulus * s * size ** (n - 1.0),
            n,
        ),
        tied_to_n=1.0,
    ),
)

BERNSTEIN_GORIATCHKIN = PlateLaw(
    "bernstein_goriatchkin",
    "Bernstein-Goriatchkin",
    "p = k z^n",
    "Bernstein 1913; Meirion-Griffith and Spenko 2011, eq. 8",
    (Constant("k", "Pa/m^n"), Constant("n", "1")),
    lambda conditions: conditions.diameter,
    lambda rho, n, s: np.ones_like(rho),
    lambda modulus, size, n, s: (modulus, n),
)
