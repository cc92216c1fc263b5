# SPDX-License-Identifier: Apache-2.0
"""Forces in arrays with their slopes: the law's own values, and slopes against differences."""

from __future__ import annotations

import numpy as np
import pytest

from smallwheel_ros.physics.force_slopes import WheelRows, forces_of, sloped_forces
from smallwheel_ros.physics.stresses import ShearLaw, wheel_forces

RNG = np.random.default_rng(3)
ROWS = 400
DIAMETER = RNG.uniform(0.1, 0.5, ROWS)
SLIPS = {"driven": RNG.uniform(0.01, 0.95, ROWS), "skidding": RNG.uniform(-0.95, -0.01, ROWS)}
ROWS_OF = WheelRows(
    load=RNG.uniform(5, 300, ROWS),
    sinkage=RNG.uniform(0.01, 0.2, ROWS) * DIAMETER,
    diameter=DIAMETER,
    width=RNG.uniform(0.05, 0.2, ROWS),
    slip=SLIPS["driven"],
    exponent=RNG.uniform(0.4, 1.8, ROWS),
    cohesion=RNG.uniform(0, 600, ROWS),
    friction_angle=RNG.uniform(0.35, 0.75, ROWS),
    log_shear=np.log(RNG.uniform(0.004, 0.03, ROWS)),
    rolling_share=RNG.uniform(0, 2, ROWS),
    rim_friction=RNG.uniform(0.6, 1.0, ROWS),
    peak=RNG.uniform(0.0, 0.3, ROWS),
    grip=np.ones(ROWS),
)
SLOPES = ("cohesion", "friction_angle", "log_shear", "rolling_share", "rim_friction", "slip")


@pytest.mark.parametrize("layered", [False, True])
@pytest.mark.parametrize("way", SLIPS)
def test_it_is_the_law_of_the_bench(way: str, layered: bool) -> None:
    w = ROWS_OF._replace(slip=SLIPS[way])

    def factor(depth: np.ndarray) -> np.ndarray:
        return 1.0 + 20.0 * depth

    more = factor if layered else None
    found = sloped_forces(w, more).values
    shear = ShearLaw(
        w.cohesion, w.friction_angle, np.exp(w.log_shear), w.rolling_share, w.rim_friction
    )
    exact = wheel_forces(
        w.load, w.sinkage, w.diameter, w.width, w.slip, w.exponent, shear,
        peak=w.peak * np.maximum(w.slip, 0.0), factor=more,
    )  # fmt: skip
    rim = exact.torque / (0.5 * w.diameter)
    expected = [exact.thrust, exact.thrust - exact.resistance, rim]
    np.testing.assert_allclose(found, expected, atol=1e-9)
    np.testing.assert_allclose(forces_of(w, more), found, rtol=1e-12)


@pytest.mark.parametrize("way", SLIPS)
def test_slopes_are_those_of_the_values(way: str) -> None:
    w = ROWS_OF._replace(slip=SLIPS[way])
    made = sloped_forces(w)
    for place, name in enumerate(SLOPES):
        step = 0.1 if name == "cohesion" else 1e-6
        above, below = (
            sloped_forces(w._replace(**{name: getattr(w, name) + way * step})).values
            for way in (1.0, -1.0)
        )
        numeric = (above - below) / (2.0 * step)
        scale = np.abs(numeric) + np.abs(made.values[0]) + 1e-3 * w.load
        assert (np.abs(made.slopes[:, place] - numeric) < 2e-3 * scale).mean() > 0.99, name


def test_beyond_all_bounds_it_is_finite() -> None:
    slip = np.array([-5.0, -1.0, -0.99, 0.0, 0.99, 1.0, 7.0])
    full = np.ones(slip.size)
    made = sloped_forces(
        WheelRows(
            50 * full, 0.4 * full, 0.25 * full, 0.1 * full, slip, full, -900 * full, 0.6 * full, -4 * full,
            full, full, 0.1 * full, full,
        )
    )  # fmt: skip
    assert np.isfinite(made.values).all()
    assert np.isfinite(made.slopes).all()
    np.testing.assert_array_equal(made.values[:, 0], made.values[:, 1])  # a slip beyond 1 is 1
    np.testing.assert_array_equal(made.slopes[:, -1, -1], 0.0)
