# SPDX-License-Identifier: Apache-2.0
"""Slip of a wheel from its speeds, one at a time and in columns: its definition, and how sure it is.

Tests `wheel.py`.
"""

from __future__ import annotations

import numpy as np
import pytest

from smallwheel_ros.physics.wheel import Quantity, wheel_slip
from smallwheel_ros.pipeline.rows.slip import slip_of

STANDSTILL = 0.01


def slip(speed: float, rim: float, speed_std: float = 0.01, rim_std: float = 0.005) -> float:
    """By both ways, which agree; NaN where it stands."""
    made = wheel_slip(Quantity(speed, speed_std), Quantity(rim, rim_std), STANDSTILL)
    columns = (np.array([value]) for value in (speed, speed_std, rim, rim_std))
    value, std, stands = slip_of(*columns, STANDSTILL)
    assert stands.tolist() == [made is None]
    if made is None:
        assert np.isnan(value).all()
        return np.nan
    assert value == pytest.approx(made.value)
    assert std == pytest.approx(min(made.standard_deviation, 1.0))
    return made.value


@pytest.mark.parametrize(
    ("speed", "rim", "expected"),
    [
        (0.4, 0.5, 0.2),  # driven: 1 - v/(r omega)
        (0.5, 0.4, -0.2),  # skidding: r omega/v - 1
        (0.5, 0.5, 0.0),
        (-0.4, -0.5, 0.2),  # the same backwards
        (-0.5, -0.4, -0.2),
        (0.0, 0.5, 1.0),
        (0.5, 0.0, -1.0),
        (-0.1, 0.5, 1.0),  # rolls back while it drives forward
        (0.5, -0.1, -1.0),
    ],
)
def test_definition(speed: float, rim: float, expected: float) -> None:
    assert slip(speed, rim) == pytest.approx(expected)


def test_standing_is_unknown() -> None:
    assert np.isnan(slip(0.004, -0.009, 0.0, 0.0))
    for speed in (0.019, 0.021, -0.039):  # that may well be none
        assert np.isnan(slip(speed, 0.0, rim_std=0.0))
    assert slip(0.05, 0.0) == -1.0


@pytest.mark.parametrize(("speed", "rim"), [(0.4, 0.5), (0.5, 0.4), (-0.4, -0.5)])
def test_deviation_is_that_of_samples(speed: float, rim: float) -> None:
    made = wheel_slip(Quantity(speed, 0.01), Quantity(rim, 0.005), STANDSTILL)
    assert made is not None
    rng = np.random.default_rng(3)
    v, r = rng.normal(speed, 0.01, 20_000), rng.normal(rim, 0.005, 20_000)
    drawn = 1 - v / r if abs(rim) >= abs(speed) else r / v - 1
    assert made.standard_deviation == pytest.approx(np.std(drawn), rel=0.03)
