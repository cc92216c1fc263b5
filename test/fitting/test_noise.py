# SPDX-License-Identifier: Apache-2.0
"""The regression of a table's values on its settings, and the deviation of its power of the load."""

from __future__ import annotations

import numpy as np
import pytest

from smallwheel_ros.fitting.noise import NoiseLine
from smallwheel_ros.physics.conditions import Conditions

# Load varies between soils far more than within one, so only what varies within tells its power.
WITHIN = np.linspace(0.9, 1.1, 8)
LOAD = np.concatenate([40.0 * WITHIN, 150.0 * WITHIN])
TWO_SOILS = Conditions.of(LOAD, 0.2, 0.1, soil=np.repeat(["loam", "sand"], 8))


@pytest.mark.parametrize("firmer", [1.0, 0.3])
def test_the_power_of_the_load_is_as_sure_as_its_spread(firmer: float) -> None:
    """Over 400 draws; before, the deviation was a tenth of the spread, and good gauges were called stuck."""
    rng = np.random.default_rng(4)
    size = 1e-4 * LOAD**0.8 * np.repeat([1.0, firmer], 8)
    found = []
    for _ in range(400):
        drawn = size * np.exp(0.1 * rng.standard_normal(LOAD.size)), np.arange(16), TWO_SOILS
        found.append(NoiseLine.through(*drawn).power_of_load(*drawn))
    power, deviation = np.array(found).T
    spread = float(power.std())
    assert abs(power.mean() - 0.8) < 4.0 * spread / 20.0
    assert float(np.sqrt(np.mean(deviation**2))) == pytest.approx(spread, rel=0.15)
    assert np.mean(power + 2.0 * deviation < 0.2) < 0.03
