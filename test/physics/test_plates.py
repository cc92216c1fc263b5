# SPDX-License-Identifier: Apache-2.0
"""Laws of size against what their authors print, and shear over displacement.

Tests `shear.py`.
"""

from __future__ import annotations

import numpy as np
import pytest

from smallwheel_ros.physics.conditions import PLATE, Conditions
from smallwheel_ros.physics.plates import (
    LAWS,
    equivalent_diameter,
    plate_area,
    smaller_dimension,
)
from smallwheel_ros.physics.shear import peaked_share, rising_share, shear_strength

SIZES = np.array([0.05, 0.1, 0.2])


def plates() -> Conditions:
    return Conditions(np.full(3, 50.0), SIZES, np.full(3, np.nan), contact=np.full(3, PLATE))


def test_each_law_presses_as_its_formula_says() -> None:
    """Pressure from the published constants, at the sinkage that the law gives for the load."""
    log_pressure, n, reference = np.log(2e4), 0.8, 0.1
    for law in LAWS:
        s = 0.3
        b = law.size(plates())
        z = law.sinkage(plates(), reference, log_pressure, n, s)
        one, two, *three = law.constants(law.modulus(log_pressure, n), reference, n, s)
        if law.id == "meirion_griffith_spenko":
            pressure = one * z**two * b ** three[0]
        elif law.id == "bekker":
            pressure = (one / b + two) * z**n
        else:
            pressure = (one + two * b) * (z / b) ** n
        np.testing.assert_allclose(pressure, 50.0 / plate_area(SIZES), rtol=1e-9, err_msg=law.id)


def test_the_size_of_a_plate() -> None:
    np.testing.assert_allclose(smaller_dimension(plates()), 0.5 * SIZES)
    assert plate_area(equivalent_diameter(0.1, 0.3)) == pytest.approx(0.03)


def test_shear_rises_to_its_strength_and_a_peak_falls_from_it() -> None:
    np.testing.assert_allclose(shear_strength([0.0, 1e4], 500.0, 0.5), [500.0, 5500.0])
    np.testing.assert_allclose(rising_share([0.0, 0.01, 1.0], 0.01), [0.0, 1 - np.exp(-1), 1.0])
    j = np.linspace(0.0, 0.5, 2001)
    share = peaked_share(j, 0.01, 0.6)
    assert share[0] == 0.0
    assert share[-1] == pytest.approx(0.6)
    assert share.max() == pytest.approx(1.0, abs=0.01)
    assert j[np.argmax(share)] == pytest.approx(0.01, abs=0.003)
