# SPDX-License-Identifier: Apache-2.0
"""Slip of wheels from their speeds: its definition, what stands, and how sure it is."""

from __future__ import annotations

import numpy as np
import pytest

from smallwheel_ros.pipeline.rows.slip import slip_of

STANDSTILL = 0.01


def slip_and_std(
    speed: float, rim: float, speed_std: float = 0.01, rim_std: float = 0.005
) -> tuple[float, float]:
    """Of one wheel; NaN where it stands."""
    columns = (np.array([value]) for value in (speed, speed_std, rim, rim_std))
    value, std, stands = slip_of(*columns, STANDSTILL)
    assert stands.tolist() == [bool(np.isnan(value[0]))] == [bool(np.isnan(std[0]))]
    return float(value[0]), float(std[0])


def slip(speed: float, rim: float, speed_std: float = 0.01, rim_std: float = 0.005) -> float:
    return slip_and_std(speed, rim, speed_std, rim_std)[0]


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
    _, std = slip_and_std(speed, rim)
    rng = np.random.default_rng(3)
    v, r = rng.normal(speed, 0.01, 20_000), rng.normal(rim, 0.005, 20_000)
    drawn = 1 - v / r if abs(rim) >= abs(speed) else r / v - 1
    assert std == pytest.approx(np.std(drawn), rel=0.03)
