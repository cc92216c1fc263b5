# SPDX-License-Identifier: Apache-2.0
"""The soil's estimate in the terms of the field; what the data determines of it, and what it cannot."""

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

DETERMINED = 0.5  # posterior over prior standard deviation, at most
_SAME_DIAMETER = 1.05  # largest over smallest
_SAME_LOAD = 1.3
# Deviations of n from an end of its range within which it is the range that speaks: of an n that is known,
# and of one that is not.
_AT_BOUND, _ON_BOUND = 2.0, 0.5


class Identifiable(NamedTuple):
    """Which parameters the data has determined: their standard deviation is at most half of the prior's.

    At half, three quarters of the information is from the data. False means that the value is
    essentially the prior's, or that everything is in doubt: an effect is missing in the model, which
    bends the parameters, or the newest sinkages contradict the law. The modulus is judged at the
    reference diameter.
    """

    k: bool
    n: bool
    m: bool
    effective_modulus: bool
    reference_pressure: bool


@dataclass(frozen=True)
class Variety:
    """Ranges of diameter (m) and of load per width (N/m) over the accepted measurements."""

    diameters: tuple[float, float] | None = None
    loadings: tuple[float, float] | None = None

    def with_wheel(self, diameter: float, loading: float) -> Variety:
        """Ranges widened by one measurement.

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
    """The present estimate of the soil under the wheels; every number is finite, SI units.

    Attributes
    ----------
    k, n, m
        The law p = k z^n D^m; k in Pa/m^(n+m).
    log_pressure
        ln of the pressure (Pa) at `reference_sinkage` under a wheel of `reference_diameter`.
    log_covariance
        Covariance of (log_pressure, n, m), shape (3, 3): the one to compute with.
    prior_covariance
        `log_covariance` as it was before the first measurement.
    reference_sinkage, reference_diameter
        m.
    variety
        Ranges of diameter and load over the accepted measurements.
    accepted, outliers
        Number of measurements that updated the estimate, and of those that did not fit it.
    soil_changes
        How many borders to another soil were found.
    distance
        Travel (m) of the newest measurement.
    missing_effect
        The alarm that the model misses an effect, None while there is none.
    settled
        Whether enough was measured for the stated deviations to hold; before, nothing counts as determined.
    doubt
        Why nothing counts as determined at present, in words; empty without such a reason.
    state
        Estimated errors of sensors and ground; None before the first stretch of path.
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
        """Covariance of (k, n, m), shape (3, 3), linearised at the estimate."""
        slopes = np.eye(3)
        slopes[0] = self.k * self._log_modulus_row(1.0)
        return seen_as(slopes, self.log_covariance)

    @property
    def reference_pressure(self) -> float:
        """Pa, at `reference_sinkage` under a wheel of `reference_diameter`."""
        return math.exp(self.log_pressure)

    @property
    def reference_pressure_std(self) -> float:
        """Pa."""
        return self.reference_pressure * math.sqrt(self.log_covariance[0, 0])

    @cached_property
    def remaining(self) -> Mapping[str, float]:
        """Ratio of posterior to prior standard deviation of what `Identifiable` judges, by name."""
        rows = self._rows
        after, before = (
            np.einsum("ij,jk,ik->i", rows, covariance, rows)
            for covariance in (self.log_covariance, self.prior_covariance)
        )
        left = np.sqrt(np.maximum(after, 0.0) / before)
        return dict(zip(Identifiable._fields, left.tolist(), strict=True))

    @property
    def _rows(self) -> Array:
        """Slopes of ln k, n, m, ln modulus, ln pressure by (ln pressure, n, m); (5, 3)."""
        of_k, of_modulus = map(self._log_modulus_row, (1.0, self.reference_diameter))
        return np.array([of_k, [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], of_modulus, [1.0, 0.0, 0.0]])

    @cached_property
    def in_doubt(self) -> str:
        """Why nothing counts as determined although the deviations are small; empty without such a reason."""
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
        """What the data has determined."""
        sound = self.settled and not self.in_doubt
        known = {name: sound and left <= DETERMINED for name, left in self.remaining.items()}
        return Identifiable(**known)

    @property
    def status(self) -> tuple[str, ...]:
        """Say what is not determined, and why; empty where everything is."""
        if self.in_doubt and self.accepted:
            return (f"nothing is determined: {self.in_doubt}",)
        limits = dict.fromkeys(Identifiable._fields, "")
        if self.state is not None and self.settled:
            limits = dict(zip(limits, self.state.limits(self._rows), strict=True))
        return _in_words(self.identifiable, self.variety, self.accepted, limits)

    @property
    def remarks(self) -> tuple[str, ...]:
        """Further findings about soil and sensors, in words."""
        shown = "" if self.state is None else self.state.slip_sinkage
        return (shown,) if shown else ()

    @property
    def verdicts(self) -> dict[str, str]:
        """For each parameter, whether the data has determined it, and how far."""
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
        """K = k D^m and its standard deviation (Pa/m^n) for a wheel diameter (m), or the reference diameter.

        The deviation is linearised.
        """
        row = self._log_modulus_row(self.reference_diameter if diameter is None else diameter)
        modulus = math.exp(row @ (self.log_pressure, self.n, self.m))
        variance = float(row @ self.log_covariance @ row)
        return modulus, modulus * math.sqrt(max(variance, 0.0))

    def _log_modulus_row(self, diameter: float) -> Array:
        """Weights of (log_pressure, n, m) in ln(k D^m) of a diameter (m)."""
        across = math.log(diameter / self.reference_diameter)
        return np.array([1.0, -math.log(self.reference_sinkage), across])


def seen_as(slopes: Array, covariance: Array) -> Array:
    """Compute the covariance of slopes @ x, exactly symmetric.

    Parameters
    ----------
    slopes
        Shape (rows, size).
    covariance
        Covariance of x, shape (size, size).

    Returns
    -------
    ndarray
        Shape (rows, rows).
    """
    whole = slopes @ covariance @ slopes.T
    found: Array = 0.5 * (whole + whole.T)
    return found


def before_driving(diameters: Iterable[float]) -> tuple[str, ...]:
    """Say what these wheels (diameters in m) cannot determine, wherever they drive."""
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

    limits: by name, what limits a parameter; empty where only the amount of data does.
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
