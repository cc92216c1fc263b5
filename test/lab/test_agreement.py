# SPDX-License-Identifier: Apache-2.0
"""Two beliefs about one soil are compared by the pressure at one depth, worked out by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from smallwheel_ros.fitting.parameters import ParameterPrior
from smallwheel_ros.lab.agreement import Belief, compare_beliefs
from smallwheel_ros.physics.soil import Soil

NONE = np.zeros(0)


def belief(words: str, k: float, n: float, m: float, spread: float, *depths: float) -> Belief:
    """Only ln of the reference pressure is uncertain."""
    covariance = np.diag([spread**2, 0.0, 0.0])
    known = ParameterPrior(Soil("sand", k, n, m), covariance)
    sizes = np.full(len(depths), 0.3) if depths else NONE
    return Belief(words, known, sizes, np.array(depths))


def test_the_ratio_is_that_of_the_pressures_where_both_have_been() -> None:
    first = belief("plates", 1.0e6, 0.9, 0.3, 0.05, 0.005, 0.040)
    second = belief("rolling wheels", 0.6e6, 0.8, 0.4, 0.12, 0.010, 0.090)
    found = compare_beliefs("sand", first, second)
    depth = math.sqrt(0.010 * 0.040)  # the middle of what both reached, on a scale of ratios
    a, b = 1.0e6 * depth**0.9 * 0.3**0.3, 0.6e6 * depth**0.8 * 0.3**0.4
    assert (found.depth, found.diameter) == pytest.approx((depth, 0.3))
    assert found.pressures == pytest.approx((a, b))
    assert found.ratio == pytest.approx(b / a)
    width = math.exp(1.96 * math.hypot(0.05, 0.12))
    assert (found.low, found.high) == pytest.approx((b / a / width, b / a * width))


def test_a_model_without_depths_is_compared_at_those_of_the_wheels() -> None:
    found = compare_beliefs(
        "sand",
        belief("the model's soil", 1e6, 0.9, 0.3, 0.1),
        belief("plates", 1e6, 0.9, 0.3, 0.1, 0.01, 0.04),
    )
    assert found.depth == pytest.approx(0.02)
    assert found.ratio == pytest.approx(1.0)
    assert found.agrees


@pytest.mark.parametrize(
    ("factor", "agrees"), [(0.75, False), (0.85, True), (1.15, True), (1.35, False)]
)
def test_they_agree_where_the_interval_has_one_in_it(factor: float, agrees: bool) -> None:
    """The interval of 0.1 and nothing is a factor of exp(0.196) = 1.217 either way."""
    first = belief("plates", 1e6, 0.9, 0.3, 0.1, 0.02)
    found = compare_beliefs("sand", first, belief("wheels", factor * 1e6, 0.9, 0.3, 0.0, 0.02))
    assert found.agrees is agrees
    assert found.to_dict()["agrees"] is agrees
    assert found.to_dict()["interval"] == [found.low, found.high]
