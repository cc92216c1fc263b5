# SPDX-License-Identifier: Apache-2.0
"""Soils: the parameters of the pressure-sinkage law P = k z^n D^m and of the soil's strength."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from smallwheel_ros.common.errors import SmallwheelError, nearest
from smallwheel_ros.physics.wheel import (
    PRESSURE_PEAK,
    RIM_FRICTION,
    ROLLING_SHARE,
    Quantity,
    Strength,
)

Array = NDArray[np.float64]

# Pressure at these is what data determines well: k itself is the pressure at one metre of sinkage
# under a wheel of one metre, an extrapolation whose error is tied to n and m.
REFERENCE_SINKAGE = 0.010  # m
REFERENCE_DIAMETER = 0.200  # m
# Numbers of a soil, in the order of a model file.
SOIL_NUMBERS = (
    "k", "n", "m", "cohesion", "friction_angle", "shear_displacement", "rolling_share", "rim_friction",
    "pressure_peak",
)  # fmt: skip


class SoilError(SmallwheelError):
    """A soil that does not exist, or a soil parameter outside its domain."""


@dataclass(frozen=True)
class Soil:
    """One soil under the law p = k z^n D^m (Meirion-Griffith and Spenko 2011, eq. 9).

    Attributes
    ----------
    name
        Name of the soil.
    k
        Pressure at 1 m of sinkage under a wheel of 1 m, Pa/m^(n+m), above 0.
    n
        Exponent of sinkage, between 0 and 3.
    m
        Exponent of the wheel's diameter, -3 to 3; 0 gives the law of Bernstein and Goriatchkin (eq. 8).
    cohesion
        Pa, 0 or more.
    friction_angle
        rad, from 0 to below pi/2.
    shear_displacement
        Shear deformation modulus kappa of eq. 2, m, above 0.
    source
        Publication or file that the numbers are from.
    rolling_share
        eta of `stresses`, 0 to 5: share of the displacement by rolling alone that shears the soil.
    rim_friction
        mu of `stresses`, above 0, at most 2: friction of a driven bare rim on the soil, over the soil's own.
    pressure_peak
        c2 of `stresses`, 0 to 0.9: angle of the largest pressure at slip 1, as a share of the entry angle.
        The defaults of these three are medians over rigs.

    Raises
    ------
    SoilError
        If a number is not finite or outside its range.
    """

    name: str
    k: float
    n: float
    m: float = 0.0
    cohesion: float = 0.0
    friction_angle: float = np.radians(30.0)
    shear_displacement: float = 0.015
    source: str = ""
    rolling_share: float = ROLLING_SHARE.value
    rim_friction: float = RIM_FRICTION.value
    pressure_peak: float = PRESSURE_PEAK.value

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
            ("rolling_share", self.rolling_share, 0 <= self.rolling_share <= 5, "0 to 5"),
            ("rim_friction", self.rim_friction, 0 < self.rim_friction <= 2, "over 0 to 2"),
            ("pressure_peak", self.pressure_peak, 0 <= self.pressure_peak <= 0.9, "0 to 0.9"),
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


def k_from_reference(log_reference_pressure: ArrayLike, n: ArrayLike, m: ArrayLike) -> Array:
    """k (Pa/m^(n+m)) from the pressure at the reference sinkage (10 mm) and diameter (0.2 m).

    Parameters
    ----------
    log_reference_pressure
        ln of that pressure in Pa.
    n, m
        Exponents of sinkage and diameter, 1.
    """
    return np.asarray(
        np.exp(
            np.asarray(log_reference_pressure)
            - np.asarray(n) * np.log(REFERENCE_SINKAGE)
            - np.asarray(m) * np.log(REFERENCE_DIAMETER)
        )
    )


def effective_modulus(k: ArrayLike, m: ArrayLike, diameter: ArrayLike) -> Array:
    """K = k D^m, Pa/m^n: the soil's modulus under a wheel of this diameter (eq. 9).

    Parameters
    ----------
    k
        Modulus of the law p = k z^n D^m, Pa/m^(n+m).
    m
        Exponent of the diameter, 1.
    diameter
        Diameter D of the wheel, m.
    """
    return np.asarray(np.asarray(k) * np.asarray(diameter, dtype=float) ** np.asarray(m))


def bekker_modulus(kc: ArrayLike, kphi: ArrayLike, width: ArrayLike) -> Array:
    """Bekker's modulus kc/b + kphi, Pa/m^n (Bekker 1956; eq. 5).

    Parameters
    ----------
    kc, kphi
        Bekker's cohesive modulus, Pa/m^(n-1), and frictional modulus, Pa/m^n.
    width
        b, the smaller side of the contact, m.
    """
    return np.asarray(np.asarray(kc) / np.asarray(width) + np.asarray(kphi))


# Of cohesion, Pa: dry sand has 200 to 2300 in the pulls of nine rigs, 1040 in Wong (2008), 2050 in the paper.
_COHESION_STD = 700.0
_COHESION_SHARE = 0.3  # of larger ones: loams and earth in the published tables
_FRICTION_STD = (
    0.1  # rad: dry sands and loams in the published tables have 27 to 34 degrees, rigs 21 to 31
)
_SHEAR_SHARE = 0.4  # Wong (2008) gives 10 to 25 mm for sand


def usual_strength(soil: Soil) -> Strength:
    """Strength to expect of a soil of the same kind as `soil` under a wheel of any rig.

    Its values are those of `soil`; its standard deviations are the spread of published values among soils
    of one kind and among rigs.
    """
    return Strength(
        Quantity(soil.cohesion, math.hypot(_COHESION_STD, _COHESION_SHARE * soil.cohesion)),
        Quantity(soil.friction_angle, _FRICTION_STD),
        Quantity(soil.shear_displacement, _SHEAR_SHARE * soil.shear_displacement),
        ROLLING_SHARE._replace(value=soil.rolling_share),
        RIM_FRICTION._replace(value=soil.rim_friction),
        PRESSURE_PEAK._replace(value=soil.pressure_peak),
    )


_PAPER = "Meirion-Griffith and Spenko 2011"
_WONG = f"{_PAPER}, Table 4 (Wong 2008)"
_TABLES_6_5 = f"{_PAPER}, Table 6; strength Table 5"


def _tabled(name: str, k: float, n: float, m: float, source: str, *, c: float, phi: float) -> Soil:
    """A soil as tables print it: k in kN/m^(n+m+2), c in kPa, phi in degrees."""
    return Soil(name, 1e3 * k, n, m, 1e3 * c, float(np.radians(phi)), source=source)


# kappa is in none of these tables: 15 mm is the default, from the 10 to 25 mm that Wong 2008 gives
# for sand. Where Tables 2 and 5 print another phi for the same dry sand, each soil keeps its own.
SOILS: dict[str, Soil] = {
    soil.name: soil
    for soil in (
        _tabled("dry_sand", 1604, 0.80, 0.39, _TABLES_6_5, c=2.05, phi=27.2),
        _tabled("calcium_silicate", 17, 0.48, 0.0, _TABLES_6_5, c=3.08, phi=32.2),
        _tabled("moist_earth", 79, 0.88, -0.49, _TABLES_6_5, c=3.13, phi=34.0),
        _tabled("dry_sand_bekker", 1783, 0.75, 0.0, f"{_PAPER}, Table 2", c=2.05, phi=27.5),
        _tabled(
            "wong_sandy_loam", 1515, 0.7, 0.0, f"{_WONG}; strength unverified", c=1.72, phi=29.0
        ),
        _tabled(
            "wong_heavy_clay", 1556, 0.13, 0.0, f"{_WONG}; strength unverified", c=68.95, phi=34.0
        ),
        _tabled("wong_snow", 197, 1.6, 0.0, f"{_WONG}; strength unverified", c=1.03, phi=19.7),
        _tabled("wong_dry_sand", 1528, 1.1, 0.0, _WONG, c=1.04, phi=28.0),
    )
}


class SoilLibrary(Mapping[str, Soil]):
    """The soils of the library: `soil("dry_sand")`, `soil["dry_sand"]`, `soil.dry_sand`, `list(soil)`.

    An unknown name raises SoilError, which lists the names that exist.
    """

    def __call__(self, name: str) -> Soil:
        """The soil of that name."""
        try:
            return SOILS[name]
        except (KeyError, TypeError):
            raise SoilError(f"no soil '{name}': {nearest(str(name), list(SOILS))}") from None

    def __getitem__(self, name: str) -> Soil:
        return self(name)

    def __getattr__(self, name: str) -> Soil:
        if name in SOILS:
            return SOILS[name]
        raise AttributeError(f"no soil '{name}': {nearest(name, list(SOILS))}")

    def __dir__(self) -> list[str]:
        return [*super().__dir__(), *SOILS]

    def __contains__(self, name: object) -> bool:
        return name in SOILS

    def __iter__(self) -> Iterator[str]:
        return iter(SOILS)

    def __len__(self) -> int:
        return len(SOILS)

    def __repr__(self) -> str:
        return f"<soils: {', '.join(SOILS)}>"


soil = SoilLibrary()
