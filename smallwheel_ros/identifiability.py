"""What the measurements so far have determined of a soil, and what they cannot."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Identifiable:
    """True: the data has cut the standard deviation to half of the prior's or less.

    At half, three quarters of what is known comes from the data. False: the value is essentially
    the prior's.
    """

    k: bool
    n: bool
    m: bool
    effective_modulus: bool
    reference_pressure: bool


@dataclass(frozen=True)
class SoilEstimate:
    """The soil under the wheels as it is believed now; every number is finite, SI units.

    Attributes
    ----------
    k, n, m
        The law p = k z^n D^m; k in Pa/m^(n+m).
    covariance
        Of (k, n, m), shape (3, 3), linearised at the estimate.
    log_reference_pressure
        ln of the pressure (Pa) at `reference_sinkage` under a wheel of `reference_diameter`.
    log_covariance
        Of (log_reference_pressure, n, m), shape (3, 3): the one to compute with.
    reference_pressure, reference_pressure_std
        Pa.
    identifiable
        What the data has determined.
    status
        In words, what is not determined and why; empty when everything is determined.
    accepted, outliers
        Measurements that updated the estimate, and those that did not fit it.
    refused
        Measurements that could not be used, by reason.
    soil_changes
        How often a run of surprises was taken for another soil.
    distance
        Travel (m) of the newest measurement.
    """

    k: float
    n: float
    m: float
    covariance: Array
    log_reference_pressure: float
    log_covariance: Array
    reference_pressure: float
    reference_pressure_std: float
    reference_sinkage: float
    reference_diameter: float
    identifiable: Identifiable
    status: tuple[str, ...]
    accepted: int
    outliers: int
    refused: Mapping[str, int]
    soil_changes: int
    distance: float

    def effective_modulus(self, diameter: float | None = None) -> tuple[float, float]:
        """K = k D^m (Pa/m^n) and its standard deviation, for a wheel diameter (m).

        Without a diameter, for the reference diameter.
        """
        raise NotImplementedError
