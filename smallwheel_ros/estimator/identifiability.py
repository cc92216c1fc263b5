"""What the measurements so far have determined of a soil, and what they cannot."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.estimator.bounded_exponent import exponent_and_slope
from smallwheel_ros.estimator.law_covariance import LawCovariance, Row, modulus_row
from smallwheel_ros.estimator.missing_effect import MissingEffect
from smallwheel_ros.estimator.strength_estimate import StrengthEstimate
from smallwheel_ros.physics.soil import REFERENCE_DIAMETER, REFERENCE_SINKAGE

Array = NDArray[np.float64]

DETERMINED = 0.5  # posterior over prior standard deviation
_SAME_DIAMETER = 1.05  # largest over smallest
_SAME_LOAD = 1.3


@dataclass(frozen=True)
class Identifiable:
    """True: the data has cut the standard deviation to half of the prior's or less.

    At half, three quarters of what is known comes from the data. False: the value is essentially
    the prior's. The modulus is judged at the reference diameter.
    """

    k: bool
    n: bool
    m: bool
    effective_modulus: bool
    reference_pressure: bool


@dataclass(frozen=True)
class Direction:
    """A combination of soil parameters, and how much of its prior deviation is left.

    log_pressure, n, m: weights, each in prior standard deviations, of unit length together.
    remaining: posterior over prior standard deviation, 0 (known) to 1 (open).
    """

    log_pressure: float
    n: float
    m: float
    remaining: float


@dataclass(frozen=True)
class Variety:
    """Smallest and largest diameter (m) and load per width (N/m) of the accepted measurements."""

    diameters: tuple[float, float] | None = None
    loadings: tuple[float, float] | None = None

    def with_wheel(self, diameter: float, loading: float) -> Variety:
        """Widen by one measurement."""
        if self.diameters is None or self.loadings is None:
            return Variety((diameter, diameter), (loading, loading))
        (d_low, d_high), (l_low, l_high) = self.diameters, self.loadings
        if d_low <= diameter <= d_high and l_low <= loading <= l_high:
            return self
        return Variety(
            (min(d_low, diameter), max(d_high, diameter)),
            (min(l_low, loading), max(l_high, loading)),
        )


@dataclass(frozen=True)
class Counts:
    """What became of the measurements so far.

    Attributes
    ----------
    accepted, outliers
        Measurements that updated the estimate, and those that did not fit it.
    refused
        Measurements that could not be used, by reason.
    soil_changes
        How often a run of surprises was taken for another soil.
    distance
        Travel (m) of the newest measurement.
    """

    accepted: int
    outliers: int
    refused: Mapping[str, int]
    soil_changes: int
    distance: float


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
    accepted, outliers, refused, soil_changes, distance
        As in `Counts`.
    remaining
        Posterior over prior standard deviation of k, n, m, effective_modulus, reference_pressure.
    prior
        `log_covariance` as it was before the first measurement.
    missing_effect
        The alarm that the model misses an effect, None while there is none.
    strength
        What drawbar pull says of the soil's strength; None where none was measured on this soil.
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
    remaining: Mapping[str, float] = field(default_factory=dict)
    prior: LawCovariance | None = None
    missing_effect: MissingEffect | None = None
    strength: StrengthEstimate | None = None

    @cached_property
    def directions(self) -> tuple[Direction, ...]:
        """The three independent combinations of parameters, the best determined first."""
        if self.prior is None:
            return ()
        return _directions(self.prior.array(), self.log_covariance)

    @property
    def verdicts(self) -> dict[str, str]:
        """For each parameter in words whether the data has determined it, and how far."""
        found = {}
        for name, left in self.remaining.items():
            known = "determined" if getattr(self.identifiable, name) else "not determined"
            found[name] = f"{known}: {100.0 * left:.0f} % of the prior's standard deviation is left"
        return found

    @property
    def strength_status(self) -> tuple[str, ...]:
        """In words, what is not determined of the soil's strength and why; empty: everything is."""
        if self.strength is None:
            return ("thrust is not determined: no drawbar pull was measured",)
        return self.strength.status

    def effective_modulus(self, diameter: float | None = None) -> tuple[float, float]:
        """K = k D^m (Pa/m^n) and its standard deviation, for a wheel diameter (m).

        Without a diameter, for the reference diameter. The deviation is linearised.
        """
        d = self.reference_diameter if diameter is None else diameter
        row = modulus_row(self.reference_sinkage, self.reference_diameter, d)
        log_modulus = self.log_reference_pressure + row[1] * self.n + row[2] * self.m
        modulus = math.exp(log_modulus)
        return modulus, modulus * LawCovariance.of(self.log_covariance).deviation(row)


def _remaining(
    prior: LawCovariance,
    posterior: LawCovariance,
    reference_sinkage: float,
    reference_diameter: float,
) -> dict[str, float]:
    """Compare two covariances: standard deviations, after over before."""
    of_k = modulus_row(reference_sinkage, reference_diameter, 1.0)
    of_modulus = modulus_row(reference_sinkage, reference_diameter, reference_diameter)
    return {
        "k": posterior.deviation(of_k) / prior.deviation(of_k),
        "n": math.sqrt(posterior.nn / prior.nn),
        "m": math.sqrt(posterior.mm / prior.mm),
        "effective_modulus": posterior.deviation(of_modulus) / prior.deviation(of_modulus),
        "reference_pressure": math.sqrt(posterior.pp / prior.pp),
    }


def _directions(prior: Array, posterior: Array) -> tuple[Direction, ...]:
    """Independent directions in parameters counted in prior deviations, best determined first."""
    scale = 1.0 / np.sqrt(np.diag(prior))
    shares, vectors = np.linalg.eigh(posterior * np.outer(scale, scale))
    return tuple(
        Direction(
            float(vector[0]), float(vector[1]), float(vector[2]), math.sqrt(max(float(share), 0.0))
        )
        for share, vector in zip(shares, vectors.T, strict=True)
    )


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


def in_words(identifiable: Identifiable, variety: Variety, accepted: int) -> tuple[str, ...]:
    """Say what is not determined, and why."""
    if variety.diameters is None or variety.loadings is None:
        return ("no measurement yet: soil and uncertainty are the prior's",)
    (d_low, d_high), (l_low, l_high) = variety.diameters, variety.loadings
    one_diameter, one_load = d_high <= _SAME_DIAMETER * d_low, l_high <= _SAME_LOAD * l_low
    so_far = f"{accepted} measurements so far do not suffice"
    words = []
    if not identifiable.reference_pressure:
        words.append(f"reference pressure not determined yet: {so_far}")
    if not identifiable.n:
        reason = f"load hardly varied ({l_low:.3g} to {l_high:.3g} N per m of width)"
        words.append(
            f"n not determined: {reason}" if one_load else f"n not determined yet: {so_far}"
        )
    if not identifiable.m:
        reason = f"all wheels have one diameter ({d_low:.3g} m)"
        words.append(
            f"m not determined: {reason}" if one_diameter else f"m not determined yet: {so_far}"
        )
    if not identifiable.k:
        words.append("k not determined: it needs n and m; go by effective modulus or pressure")
    if not identifiable.effective_modulus:
        words.append("effective modulus not determined: it needs n; go by the reference pressure")
    return tuple(words)


def soil_estimate(
    state: Row,
    covariance: LawCovariance,
    prior: LawCovariance,
    reference: tuple[float, float],
    variety: Variety,
    counts: Counts,
    missing_effect: MissingEffect | None = None,
    strength: StrengthEstimate | None = None,
) -> SoilEstimate:
    """Put the filter's state (ln pressure, q of n, m) into the terms of the field.

    state, covariance, prior: at the reference of `soil`. reference: sinkage and diameter (m) to report at.
    """
    pressure_log, q, m = state
    n, slope = exponent_and_slope(q)
    up, across = math.log(reference[0]), math.log(reference[1])
    deeper, larger = up - math.log(REFERENCE_SINKAGE), across - math.log(REFERENCE_DIAMETER)
    pressure_log += n * deeper + m * larger
    to_report = (1.0, slope * deeper, larger)
    now, before = (law.seen_as(to_report, slope) for law in (covariance, prior))
    k = math.exp(pressure_log - n * up - m * across)
    of_k = now.seen_as((k, -k * up, -k * across), 1.0)
    left = _remaining(before, now, *reference)
    identifiable = Identifiable(**{name: share <= DETERMINED for name, share in left.items()})
    pressure = math.exp(pressure_log)
    return SoilEstimate(
        k,
        n,
        m,
        of_k.array(),
        pressure_log,
        now.array(),
        pressure,
        pressure * math.sqrt(now.pp),
        *reference,
        identifiable,
        in_words(identifiable, variety, counts.accepted),
        counts.accepted,
        counts.outliers,
        counts.refused,
        counts.soil_changes,
        counts.distance,
        left,
        before,
        missing_effect,
        strength,
    )
