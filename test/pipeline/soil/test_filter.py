# SPDX-License-Identifier: Apache-2.0
"""The bank of filters, where measurements do not tell its members apart."""

from __future__ import annotations

import numpy as np
import pytest

from smallwheel_ros.onboard.prior import EstimatorSettings, SoilPrior
from smallwheel_ros.physics.soil import soil
from smallwheel_ros.physics.wheel import Wheel
from smallwheel_ros.pipeline.soil.filter import SoilFilter
from smallwheel_ros.pipeline.soil.model import ZERO
from smallwheel_ros.pipeline.soil.stretches import Stretches
from smallwheel_ros.simulate.truth import static_sinkage

WHEELS = (Wheel("left", 0.25, 0.1), Wheel("right", 0.25, 0.1))
REFERENCE = (60.0, 0.25, 0.1)


@pytest.mark.parametrize(("factor", "scatter"), [(0.6, 0.03), (1.5, 0.03), (1.0, 0.15)])
def test_one_load_does_not_show_the_zero(factor: float, scatter: float) -> None:
    """Even ground and uneven, firmer and softer than it was named: what one load shows goes to the soil.

    How even the ground is says nothing of the sensors' zero.
    """
    rng = np.random.default_rng(3)
    prior, count = SoilPrior.from_soil(soil("dry_sand")), 240
    settings = EstimatorSettings(soil_scatter=0.3, loads_measured=False)
    law = SoilFilter(prior, settings, (), WHEELS, REFERENCE)
    modulus, n = factor * np.exp(prior.log_modulus(0.25)), prior.n
    load = np.exp(rng.normal(np.log(60.0), 0.03, count))
    depth = static_sinkage(
        lambda z: np.asarray(modulus * z**n),
        load * np.exp(scatter * rng.standard_normal(count)),
        np.full(count, 0.25),
        np.full(count, 0.1),
    )
    columns = dict.fromkeys(Stretches.__dataclass_fields__, np.zeros(count)) | {
        "wheel": np.arange(count) % 2,
        "sinkage": depth + 2.5e-4 * rng.standard_normal(count),
        "variance": np.full(count, 6e-8),
        "load": load,
        "slip": np.full(count, 0.05),
        "speed": np.full(count, 0.3),
        "distance": 0.1 * np.arange(count),
        "place": 0.1 * np.arange(count),
        "onward": np.ones(count, dtype=bool),
        "count": np.full(count, 6),
    }
    rows = Stretches(**columns)  # type: ignore[arg-type]
    for first in range(0, count, 2):
        law.absorb(rows.take(slice(first, first + 2)))
    assert abs(law.mean[ZERO]) < 1e-3
    # And that is not known: the zero may still be off by most of what it might be before.
    assert law.covariance[ZERO, ZERO] > (0.5 * settings.sinkage_zero_std) ** 2
