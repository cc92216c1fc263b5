# SPDX-License-Identifier: Apache-2.0
"""Soils: the library, their domains, and the numbers that data determines."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from smallwheel_ros.physics.soil import (
    REFERENCE_DIAMETER,
    REFERENCE_SINKAGE,
    SOILS,
    Soil,
    SoilError,
    bekker_modulus,
    effective_modulus,
    k_from_reference,
    soil,
)

# k in kN/m^(n+m+2), n, m: Tables 6, 2 and 4 of Meirion-Griffith and Spenko 2011
TABLES = {
    "dry_sand": (1604, 0.80, 0.39),
    "calcium_silicate": (17, 0.48, 0.0),
    "moist_earth": (79, 0.88, -0.49),
    "dry_sand_bekker": (1783, 0.75, 0.0),
    "wong_sandy_loam": (1515, 0.7, 0.0),
    "wong_heavy_clay": (1556, 0.13, 0.0),
    "wong_snow": (197, 1.6, 0.0),
    "wong_dry_sand": (1528, 1.1, 0.0),
}


def test_the_library_is_as_printed() -> None:
    assert {s.name: (s.k / 1e3, s.n, s.m) for s in SOILS.values()} == TABLES
    assert all(s.source for s in SOILS.values())
    # Table 5 prints 27.2 deg for the sand for which Table 2 prints 27.5
    assert np.degrees(soil("dry_sand").friction_angle) == pytest.approx(27.2)
    assert np.degrees(soil("dry_sand_bekker").friction_angle) == pytest.approx(27.5)


@given(k=st.floats(1e2, 1e9), n=st.floats(0.05, 2.9), m=st.floats(-2, 2), d=st.floats(0.03, 1.0))
def test_reference_pressure_is_the_pressure_there(k: float, n: float, m: float, d: float) -> None:
    made = Soil("any", k, n, m)
    pressure = effective_modulus(k, m, REFERENCE_DIAMETER) * REFERENCE_SINKAGE**n
    assert made.log_reference_pressure == pytest.approx(np.log(pressure), abs=1e-9)
    again = k_from_reference(made.log_reference_pressure, n, m)
    assert again == pytest.approx(k, rel=1e-12)


def test_moduli() -> None:
    assert effective_modulus(1000.0, 0.5, 0.25) == 500.0
    assert bekker_modulus(20.0, 100.0, [0.1, 0.2]).tolist() == [300.0, 200.0]


@pytest.mark.parametrize(
    ("numbers", "message"),
    [
        ({"k": 0.0}, "soil 'mud': k is 0.0, expected a pressure over 0"),
        ({"k": float("nan")}, "k is nan"),
        ({"n": 3.0}, "n is 3.0, expected a number between 0 and 3"),
        ({"n": 0.0}, "n is 0.0"),
        ({"m": -3.1}, "m is -3.1, expected a number between -3 and 3"),
        ({"cohesion": -1.0}, "cohesion is -1.0, expected 0 Pa or more"),
        ({"friction_angle": 30.0}, "friction_angle is 30.0, expected an angle .* rad"),
        ({"shear_displacement": 0.0}, "shear_displacement is 0.0, expected a length"),
    ],
)
def test_soils_outside_their_domain(numbers: dict[str, float], message: str) -> None:
    with pytest.raises(SoilError, match=message):
        Soil("mud", **({"k": 1e5, "n": 1.0} | numbers))


def test_an_unknown_soil_is_answered_with_the_nearest() -> None:
    with pytest.raises(
        SoilError, match=r"no soil 'drysand': did you mean 'dry_sand'.*Expected one of cal"
    ):
        soil("drysand")
