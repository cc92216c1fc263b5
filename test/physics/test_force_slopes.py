# SPDX-License-Identifier: Apache-2.0
"""Forces in arrays with their slopes, against the law by many nodes and against differences."""

from __future__ import annotations

import numpy as np
import pytest

from smallwheel_ros.physics.force_slopes import sloped_forces
from smallwheel_ros.physics.stresses import ShearLaw, point_forces, wheel_forces

RNG = np.random.default_rng(3)
ROWS = 400
LOAD, DIAMETER, WIDTH = (
    RNG.uniform(5, 300, ROWS),
    RNG.uniform(0.1, 0.5, ROWS),
    RNG.uniform(0.05, 0.2, ROWS),
)
SINKAGE, EXPONENT = RNG.uniform(0.01, 0.2, ROWS) * DIAMETER, RNG.uniform(0.4, 1.8, ROWS)
COHESION, FRICTION = RNG.uniform(0, 600, ROWS), RNG.uniform(0.35, 0.75, ROWS)
LOG_SHEAR, ROLLING = np.log(RNG.uniform(0.004, 0.03, ROWS)), RNG.uniform(0, 2, ROWS)
GRIP = RNG.uniform(0.6, 1.2, ROWS)
SLIPS = {"driven": RNG.uniform(0.01, 0.95, ROWS), "skidding": RNG.uniform(-0.95, -0.01, ROWS)}


def at(state: np.ndarray) -> np.ndarray:
    c, phi, shear, rolls, slip = state
    made = sloped_forces(LOAD, SINKAGE, DIAMETER, WIDTH, slip, EXPONENT, c, phi, shear, rolls, GRIP)
    return made.values


@pytest.mark.parametrize(
    ("way", "mean", "most"), [("driven", 3e-4, 4e-3), ("skidding", 7e-3, 0.06)]
)
def test_the_law_by_many_nodes(way: str, mean: float, most: float) -> None:
    slip = SLIPS[way]
    found = at(np.array([COHESION, FRICTION, LOG_SHEAR, ROLLING, slip]))
    shear = ShearLaw(COHESION, FRICTION, np.exp(LOG_SHEAR), ROLLING, GRIP)
    exact = wheel_forces(LOAD, SINKAGE, DIAMETER, WIDTH, slip, EXPONENT, shear)
    rim = exact.torque / (0.5 * DIAMETER)
    off = np.abs(found - [exact.thrust, exact.thrust - exact.resistance, rim]) / LOAD
    assert off.mean() < mean
    assert off.max() < most


@pytest.mark.parametrize("way", SLIPS)
def test_slopes_are_those_of_the_values(way: str) -> None:
    state = np.array([COHESION, FRICTION, LOG_SHEAR, ROLLING, SLIPS[way]])
    c, phi, shear, rolls, slip = state
    made = sloped_forces(LOAD, SINKAGE, DIAMETER, WIDTH, slip, EXPONENT, c, phi, shear, rolls, GRIP)
    for place, step in enumerate((0.1, 1e-6, 1e-6, 1e-6, 1e-6)):
        more = np.zeros((5, 1))
        more[place] = step
        numeric = (at(state + more) - at(state - more)) / (2.0 * step)
        scale = np.abs(numeric) + np.abs(made.values[0]) + 1e-3 * LOAD
        assert (np.abs(made.slopes[:, place] - numeric) < 2e-3 * scale).mean() > 0.99, place


@pytest.mark.parametrize("way", SLIPS)
def test_one_wheel_after_the_other_says_nearly_the_same(way: str) -> None:
    """`point_forces` has other nodes: they differ by the error of few nodes alone."""
    slip = SLIPS[way]
    found = at(np.array([COHESION, FRICTION, LOG_SHEAR, ROLLING, slip]))
    columns = (
        LOAD,
        SINKAGE,
        DIAMETER,
        WIDTH,
        slip,
        EXPONENT,
        COHESION,
        FRICTION,
        LOG_SHEAR,
        ROLLING,
        GRIP,
    )
    single = np.array([point_forces(*row)[:3] for row in np.transpose(columns).tolist()]).T
    expected = np.array([single[0], single[0] - single[1], single[2] / (0.5 * DIAMETER)])
    assert np.abs(found - expected).mean() < 0.01 * LOAD.mean()


def test_beyond_all_bounds_it_is_finite() -> None:
    slip = np.array([-5.0, -1.0, -0.99, 0.0, 0.99, 1.0, 7.0])
    full = np.ones(slip.size)
    made = sloped_forces(
        50 * full, 0.4 * full, 0.25 * full, 0.1 * full, slip, full, -900 * full, 0.6 * full, -4 * full,
        full, full,
    )  # fmt: skip
    assert np.isfinite(made.values).all()
    assert np.isfinite(made.slopes).all()
    np.testing.assert_array_equal(made.values[:, 0], made.values[:, 1])  # a slip beyond 1 is 1
    np.testing.assert_array_equal(made.slopes[:, 4, -1], 0.0)
