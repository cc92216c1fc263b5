"""Soils: the parameters of the pressure-sinkage law P = k z^n D^m and of the soil's strength."""

from __future__ import annotations

import difflib
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from smallwheel_ros.errors import SmallwheelError

Array = NDArray[np.float64]

# Pressure at these is what data determines well: k itself is the pressure at one metre of sinkage
# under a wheel of one metre, an extrapolation whose error is tied to n and m.
REFERENCE_SINKAGE = 0.010  # m
REFERENCE_DIAMETER = 0.200  # m


class SoilError(SmallwheelError):
    """A soil that does not exist, or a soil parameter outside its domain."""


@dataclass(frozen=True)
class Soil:
    """One soil under the law P = k z^n D^m (Meirion-Griffith and Spenko 2011, eq. 9).

    k: Pa/m^(n+m), > 0. n: 1, in (0, 3). m: 1. cohesion: Pa. friction_angle: rad.
    shear_displacement: the deformation modulus kappa of eq. 2, m. m = 0 gives the law of Bernstein and
    Goriatchkin (eq. 8). `source` says where the numbers come from.
    """

    name: str
    k: float
    n: float
    m: float = 0.0
    cohesion: float = 0.0
    friction_angle: float = np.radians(30.0)
    shear_displacement: float = 0.015
    source: str = ""

    def __post_init__(self) -> None:
        rules = (
            ("k", self.k, self.k > 0, "a pressure over 0 Pa/m^(n+m)"),
            ("n", self.n, 0 < self.n < 3, "a number between 0 and 3"),
            ("m", self.m, abs(self.m) <= 3, "a number between -3 and 3"),
            ("cohesion", self.cohesion, self.cohesion >= 0, "0 Pa or more"),
            (
                "friction_angle",
                self.friction_angle,
                0 <= self.friction_angle < np.pi / 2,
                "an angle from 0 to under pi/2 rad",
            ),
            (
                "shear_displacement",
                self.shear_displacement,
                self.shear_displacement > 0,
                "a length over 0 m",
            ),
        )
        for parameter, value, good, expected in rules:
            if not (np.isfinite(value) and good):
                raise SoilError(
                    f"soil '{self.name}': {parameter} is {value!r}, expected {expected}"
                )

    @property
    def log_reference_pressure(self) -> float:
        """ln of the pressure (Pa) at the reference sinkage and diameter."""
        return float(
            np.log(self.k)
            + self.n * np.log(REFERENCE_SINKAGE)
            + self.m * np.log(REFERENCE_DIAMETER)
        )

    def with_parameters(self, log_reference_pressure: float, n: float, m: float) -> Soil:
        """The same soil with another pressure-sinkage law."""
        return replace(
            self, k=float(k_from_reference(log_reference_pressure, n, m)), n=float(n), m=float(m)
        )


def k_from_reference(log_reference_pressure: ArrayLike, n: ArrayLike, m: ArrayLike) -> Array:
    """k (Pa/m^(n+m)) from ln of the pressure at the reference sinkage and diameter."""
    return np.asarray(
        np.exp(
            np.asarray(log_reference_pressure)
            - np.asarray(n) * np.log(REFERENCE_SINKAGE)
            - np.asarray(m) * np.log(REFERENCE_DIAMETER)
        )
    )


def effective_modulus(k: ArrayLike, m: ArrayLike, diameter: ArrayLike) -> Array:
    """K = k D^m, Pa/m^n: the soil's modulus as a wheel of this diameter (m) meets it (eq. 9)."""
    return np.asarray(np.asarray(k) * np.asarray(diameter, dtype=float) ** np.asarray(m))


def bekker_modulus(kc: ArrayLike, kphi: ArrayLike, width: ArrayLike) -> Array:
    """Bekker's modulus kc/b + kphi, Pa/m^n (Bekker 1956; eq. 5). kc: Pa/m^(n-1), kphi: Pa/m^n, b: m."""
    return np.asarray(np.asarray(kc) / np.asarray(width) + np.asarray(kphi))


def nearest(name: str, known: list[str]) -> str:
    """A clause that lists what exists, the nearest match first: for error messages."""
    close = difflib.get_close_matches(name, known, n=1, cutoff=0.5)
    hint = f"did you mean '{close[0]}'? " if close else ""
    return f"{hint}There is: {', '.join(sorted(known))}"


_PAPER = "Meirion-Griffith and Spenko 2011"
_KILO = 1000.0  # the tables print kN

SOILS: dict[str, Soil] = {
    soil.name: soil
    for soil in (
        Soil("dry_sand", 1604 * _KILO, 0.80, 0.39, source=f"{_PAPER}, Table 6"),
        Soil("calcium_silicate", 17 * _KILO, 0.48, 0.0, source=f"{_PAPER}, Table 6"),
        Soil("moist_earth", 79 * _KILO, 0.88, -0.49, source=f"{_PAPER}, Table 6"),
        Soil("dry_sand_bekker", 1783 * _KILO, 0.75, source=f"{_PAPER}, Table 2"),
        Soil("wong_sandy_loam", 1515 * _KILO, 0.7, source=f"{_PAPER}, Table 4 (Wong)"),
        Soil("wong_heavy_clay", 1556 * _KILO, 0.13, source=f"{_PAPER}, Table 4 (Wong)"),
        Soil("wong_snow", 197 * _KILO, 1.6, source=f"{_PAPER}, Table 4 (Wong)"),
        Soil("wong_dry_sand", 1528 * _KILO, 1.1, source=f"{_PAPER}, Table 4 (Wong)"),
    )
}


def soil(name: str) -> Soil:
    """The soil of that name from the library. Raises SoilError that lists what exists."""
    try:
        return SOILS[name]
    except KeyError:
        raise SoilError(f"no soil '{name}': {nearest(name, list(SOILS))}") from None
