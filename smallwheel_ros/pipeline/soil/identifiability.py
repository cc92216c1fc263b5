# SPDX-License-Identifier: Apache-2.0
"""The soil's estimate as reported: its parameters, which of them are determined, and why others are not."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .limits import StateBelief
from .missing_effect import MissingEffect
from .model import N_RANGE

Array = NDArray[np.float64]

DETERMINED = 0.5  # largest ratio of posterior to prior standard deviation of a determined parameter
_SAME_DIAMETER = 1.05  # largest over smallest diameter up to which diameters count as one
_SAME_LOAD = 1.3  # largest over smallest load per width up to which load hardly varies
# Distance of n from an end of its range, in standard deviations, within which it counts as at the end: of an
# n that is determined, and of one that is not.
_AT_BOUND, _ON_BOUND = 2.0, 0.5


class Identifiable(NamedTuple):
    """Which parameters the data has determined: their standard deviation is at most half of the prior's.

    At half, three quarters of the information is from the data. False means that the value is
    essentially the prior's, or that everything is in doubt: an effect is missing in the model, which
    bends the parameters, or the newest sinkages contradict the law.

    Attributes
    ----------
    k, n, m
        The constants of p = k z^n D^m.
    effective_modulus
        k D^m at the estimate's reference diameter.
    reference_pressure
        Pressure at the estimate's reference sinkage and diameter.
    """

    k: bool
    n: bool
    m: bool
    effective_modulus: bool
    reference_pressure: bool


@dataclass(frozen=True)
class Variety:
    """Ranges of wheels and loads over the accepted measurements.

    Attributes
    ----------
    diameters
        Smallest and largest diameter, m; None before the first measurement.
    loadings
        Smallest and largest load over width, N/m; None before the first measurement.
    """

    diameters: tuple[float, float] | None = None
    loadings: tuple[float, float] | None = None

    def with_wheel(self, diameter: float, loading: float) -> Variety:
        """Return the ranges widened to include one measurement.

        Parameters
        ----------
        diameter
            Diameter of the wheel, m.
        loading
            Load over width, N/m.
        """
        if self.diameters is None or self.loadings is None:
            return Variety((diameter, diameter), (loading, loading))
        (d_low, d_high), (l_low, l_high) = self.diameters, self.loadings
        if d_low <= diameter <= d_high and l_low <= loading <= l_high:
            return self
        return Variety(
            (min(d_low, diameter), max(d_high, diameter)),
            (min(l_low, loading), max(l_high, loading)),
        )


@dataclass(frozen=True, eq=False)
class SoilEstimate:
    """The present estimate of the soil under the wheels; every number is finite.

    Attributes
    ----------
    k, n, m
        Constants of the law p = k z^n D^m; k in Pa/m^(n+m).
    log_pressure
        ln of the pressure (Pa) at `reference_sinkage` under a wheel of `reference_diameter`.
    log_covariance
        Covariance of (log_pressure, n, m), shape (3, 3). Use it for computations, rather than `covariance`.
    prior_covariance
        `log_covariance` before the first measurement, shape (3, 3).
    reference_sinkage, reference_diameter
        Sinkage and wheel diameter at which `log_pressure` is stated, m.
    variety
        Ranges of diameter and load over the accepted measurements.
    accepted, outliers
        Number of readings of sinkage that were used, and of those left out since they did not fit the others
        of their 0.2 m of path.
    soil_changes
        Number of borders to another soil that were found.
    distance
        Path of the vehicle at the newest measurement, m.
    missing_effect
        The alarm that the model lacks an effect; None while there is none.
    settled
        Whether enough was measured for the stated deviations to hold; before, nothing counts as determined.
    doubt
        Why nothing counts as determined at present, in words; empty without such a reason.
    state
        The filter's state, with estimated errors of sensors and ground; None before any measurement.
    """

    k: float
    n: float
    m: float
    log_pressure: float
    log_covariance: Array
    prior_covariance: Array
    reference_sinkage: float
    reference_diameter: float
    variety: Variety
    accepted: int
    outliers: int
    soil_changes: int
    distance: float
    missing_effect: MissingEffect | None = None
    settled: bool = True
    doubt: str = ""
    state: StateBelief | None = None

    @cached_property
    def covariance(self) -> Array:
        """Covariance of (k, n, m), shape (3, 3), linearised at the estimate; k in Pa/m^(n+m)."""
        slopes = np.eye(3)
        slopes[0] = self.k * self._log_modulus_row(1.0)
        return seen_as(slopes, self.log_covariance)

    @property
    def reference_pressure(self) -> float:
        """Pressure at `reference_sinkage` under a wheel of `reference_diameter`, Pa."""
        return math.exp(self.log_pressure)

    @property
    def reference_pressure_std(self) -> float:
        """Standard deviation of `reference_pressure`, Pa."""
        return self.reference_pressure * math.sqrt(self.log_covariance[0, 0])

    @cached_property
    def remaining(self) -> Mapping[str, float]:
        """Ratio of posterior to prior standard deviation, 1, of each parameter in `Identifiable`, by name.

        Those of k, the modulus and the pressure are of their logarithms.
        """
        rows = self._rows
        after, before = (
            np.einsum("ij,jk,ik->i", rows, covariance, rows)
            for covariance in (self.log_covariance, self.prior_covariance)
        )
        left = np.sqrt(np.maximum(after, 0.0) / before)
        return dict(zip(Identifiable._fields, left.tolist(), strict=True))

    @property
    def _rows(self) -> Array:
        """Slopes of (ln k, n, m, ln effective modulus, ln pressure) by (ln pressure, n, m), (5, 3)."""
        of_k, of_modulus = map(self._log_modulus_row, (1.0, self.reference_diameter))
        return np.array([of_k, [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], of_modulus, [1.0, 0.0, 0.0]])

    @cached_property
    def in_doubt(self) -> str:
        """Why nothing counts as determined, whatever the deviations, in words; empty without a reason.

        A missing effect, n at an end of its range, or `doubt`.
        """
        if self.missing_effect is not None:
            return self._misses
        std = math.sqrt(max(self.log_covariance[1, 1], 0.0))
        near = std * (_AT_BOUND if self.remaining["n"] <= DETERMINED else _ON_BOUND)
        if self.settled and not N_RANGE[0] + near <= self.n <= N_RANGE[1] - near:
            return (
                f"n is at the end of its range ({N_RANGE[0]:g} to {N_RANGE[1]:g}): this is no soil of the law"
                " p = k z^n D^m, or a sensor's zero is off by more than its prior says"
            )
        return self.doubt

    @cached_property
    def identifiable(self) -> Identifiable:
        """Which parameters the data has determined; none while the estimate is unsettled or in doubt."""
        sound = self.settled and not self.in_doubt
        known = {name: sound and left <= DETERMINED for name, left in self.remaining.items()}
        return Identifiable(**known)

    @property
    def status(self) -> tuple[str, ...]:
        """Sentences that say what is not determined, and why; empty if everything is."""
        if self.in_doubt and self.accepted:
            return (f"nothing is determined: {self.in_doubt}",)
        limits = dict.fromkeys(Identifiable._fields, "")
        if self.state is not None and self.settled:
            limits = dict(zip(limits, self.state.limits(self._rows), strict=True))
        return _in_words(self.identifiable, self.variety, self.accepted, limits)

    @property
    def remarks(self) -> tuple[str, ...]:
        """Further findings about the soil, in words: how much sinkage grows with slip, if it surely does."""
        shown = "" if self.state is None else self.state.slip_sinkage
        return (shown,) if shown else ()

    @property
    def verdicts(self) -> dict[str, str]:
        """Whether each parameter is determined, with its ratio of deviations (%), in words, by name."""
        found, but = {}, self.in_doubt and f" ({self.in_doubt})"
        for name, left in self.remaining.items():
            known = "determined" if getattr(self.identifiable, name) else f"not determined{but}"
            found[name] = f"{known}: {100.0 * left:.0f} % of the prior's standard deviation is left"
        return found

    @property
    def _misses(self) -> str:
        missing = self.missing_effect
        return "" if missing is None else f"the model misses an effect, {missing.effect}"

    def effective_modulus(self, diameter: float | None = None) -> tuple[float, float]:
        """Compute K = k D^m, and its standard deviation to first order.

        Parameters
        ----------
        diameter
            Wheel diameter, m; None: the reference diameter.

        Returns
        -------
        modulus, deviation : float
            Pa/m^n.
        """
        row = self._log_modulus_row(self.reference_diameter if diameter is None else diameter)
        modulus = math.exp(row @ (self.log_pressure, self.n, self.m))
        variance = float(row @ self.log_covariance @ row)
        return modulus, modulus * math.sqrt(max(variance, 0.0))

    def _log_modulus_row(self, diameter: float) -> Array:
        """Weights of (log_pressure, n, m) in ln(k D^m) for a diameter (m), (3,)."""
        across = math.log(diameter / self.reference_diameter)
        return np.array([1.0, -math.log(self.reference_sinkage), across])


def seen_as(slopes: Array, covariance: Array) -> Array:
    """Compute the covariance of linear functions of x, exactly symmetric.

    Parameters
    ----------
    slopes
        Derivatives of the functions with respect to x, shape (functions, size).
    covariance
        Covariance of x, shape (size, size).

    Returns
    -------
    ndarray
        Shape (functions, functions).
    """
    whole = slopes @ covariance @ slopes.T
    found: Array = 0.5 * (whole + whole.T)
    return found


def before_driving(diameters: Iterable[float]) -> tuple[str, ...]:
    """Say which parameters wheels cannot determine wherever they drive.

    Parameters
    ----------
    diameters
        Diameters of the wheels whose sinkage is measured, m.

    Returns
    -------
    tuple of str
        One sentence if all diameters are the same within 5 %; empty otherwise, or without any wheel.
    """
    sizes = sorted(diameters)
    if not sizes or sizes[-1] > _SAME_DIAMETER * sizes[0]:
        return ()
    return (
        f"all wheels have one diameter ({sizes[0]:.3g} m): m stays what the prior says, and k with "
        "it; the effective modulus k D^m of these wheels can be determined. A wheel of another "
        "diameter would determine m",
    )


def _in_words(
    identifiable: Identifiable, variety: Variety, accepted: int, limits: Mapping[str, str]
) -> tuple[str, ...]:
    """Say what is not determined, and why.

    accepted: number of readings used. limits: what limits each parameter of `Identifiable`, in words, by
    name; empty where it is the amount of data.
    """
    if variety.diameters is None or variety.loadings is None:
        return ("no measurement yet: soil and uncertainty are the prior's",)
    (d_low, d_high), (l_low, l_high) = variety.diameters, variety.loadings
    reasons = {name: limit or f"{accepted} measurements so far" for name, limit in limits.items()}
    if l_high <= _SAME_LOAD * l_low:
        reasons["n"] = f"load hardly varied ({l_low:.3g} to {l_high:.3g} N per m of width)"
    if d_high <= _SAME_DIAMETER * d_low:
        reasons["m"] = f"all wheels have one diameter ({d_low:.3g} m)"
    words = [
        f"{name.replace('_', ' ')} not determined: {reasons[name]}"
        for name in ("reference_pressure", "n", "m")
        if not getattr(identifiable, name)
    ]
    if not identifiable.k:
        words.append("k not determined: it needs n and m; use effective modulus or pressure")
    if not identifiable.effective_modulus:
        words.append("effective modulus not determined: it needs n; use the reference pressure")
    return tuple(words)
