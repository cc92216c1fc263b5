# SPDX-License-Identifier: Apache-2.0
"""What the robot believes of the strength before it drives: the file's numbers, as wide as a field is."""

from __future__ import annotations

import numpy as np
import pytest

from smallwheel_ros.model.model import CalibratedModel, Model
from smallwheel_ros.onboard.strength import any_strength, strength_of
from smallwheel_ros.physics.soil import soil, usual_strength


def fitted(*names: str, covariance: np.ndarray) -> CalibratedModel:
    return CalibratedModel(
        Model("moist_earth"), tuple(f"moist_earth.{n}" for n in names), covariance
    )


def test_what_was_not_measured_is_as_wide_as_at_the_bench() -> None:
    earth = soil("moist_earth")
    found, measured = strength_of(CalibratedModel(Model(earth)), earth)
    usual = usual_strength(earth)
    assert not measured
    assert found.cohesion == usual.cohesion
    assert found.friction_angle == usual.friction_angle
    # At the bench lugs are a column; on board a rim may have them, and then mu is 1.
    assert found.rim_friction.value == usual.rim_friction.value
    assert found.rim_friction.value + found.rim_friction.standard_deviation > 1.0


def test_what_was_measured_has_its_covariance_and_what_the_field_adds() -> None:
    earth = soil("moist_earth")
    covariance = np.array([[50.0**2, -0.8 * 50.0 * 0.01], [-0.8 * 50.0 * 0.01, 0.01**2]])
    found, measured = strength_of(
        fitted("cohesion", "friction_angle", covariance=covariance), earth
    )
    assert measured
    assert found.cohesion.standard_deviation == pytest.approx(np.hypot(50.0, 0.3 * earth.cohesion))
    angle = found.friction_angle.standard_deviation
    assert angle == pytest.approx(np.hypot(0.01, 0.1 * earth.friction_angle))
    # What the field adds goes with nothing: the covariance is that of the fit.
    assert found.correlation is not None
    together = found.correlation[0, 1] * found.cohesion.standard_deviation * angle
    assert together == pytest.approx(covariance[0, 1])
    assert np.linalg.eigvalsh(found.correlation).min() > 0.0


def test_a_strength_that_is_known_exactly_is_no_division_by_zero() -> None:
    found, measured = strength_of(
        fitted("friction_angle", covariance=np.zeros((1, 1))), soil("moist_earth")
    )
    assert measured
    assert np.isfinite(found.correlation).all()


def test_where_nobody_names_a_soil_it_is_any_sand() -> None:
    found = any_strength()
    assert 0.4 < found.friction_angle.value < 0.7
    assert found.cohesion.standard_deviation >= found.cohesion.value
