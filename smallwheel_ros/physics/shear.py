# SPDX-License-Identifier: Apache-2.0
"""Shear of soil: stress over displacement at one normal stress, and strength over normal stress."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def shear_strength(normal_stress: ArrayLike, cohesion: ArrayLike, friction: ArrayLike) -> Array:
    """Shear strength tau_max = c + sigma tan(phi), Pa (Mohr and Coulomb).

    Parameters
    ----------
    normal_stress
        Normal stress sigma, Pa.
    cohesion
        Cohesion c, Pa.
    friction
        tan(phi) of the angle of internal friction phi, not the angle itself.
    """
    return np.asarray(np.asarray(cohesion) + np.asarray(normal_stress) * np.asarray(friction))


def rising_share(displacement: ArrayLike, modulus: float) -> Array:
    """Share of the shear strength that soil has reached at a shear displacement, without a peak.

    tau / tau_max = 1 - exp(-j / K) (Janosi and Hanamoto 1961).

    Parameters
    ----------
    displacement
        Shear displacement j >= 0, m.
    modulus
        Shear deformation modulus K, m.

    Returns
    -------
    array of the displacement's shape
        0 to 1.
    """
    return np.asarray(-np.expm1(-np.asarray(displacement, dtype=float) / modulus))


def peaked_share(displacement: ArrayLike, modulus: float, residual: float) -> Array:
    """Shear stress over peak strength of a soil whose strength peaks and falls to a residual one.

    tau / tau_max = K_r {1 + [1 / (K_r (1 - 1/e)) - 1] exp(1 - j / K_w)} [1 - exp(-j / K_w)]
    (Wong and Preston-Thomas 1983; Wong 2008, chapter 2).

    Parameters
    ----------
    displacement
        Shear displacement j >= 0, m.
    modulus
        K_w, about the displacement at which the strength peaks, m.
    residual
        K_r, residual over peak strength; above 0, at most 1.

    Returns
    -------
    array of the displacement's shape
    """
    x = np.asarray(displacement, dtype=float) / modulus
    hump = 1.0 / (residual * (1.0 - np.exp(-1.0))) - 1.0
    return np.asarray(residual * (1.0 + hump * np.exp(1.0 - x)) * -np.expm1(-x))
