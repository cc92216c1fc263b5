# SPDX-License-Identifier: Apache-2.0
"""The bank of filters, where measurements do not tell its members apart."""

from __future__ import annotations

import numpy as np
import pytest

from smallwheel_ros.onboard.prior import EstimatorSettings, SoilPrior
from smallwheel_ros.physics.soil import soil
from smallwheel_ros.physics.wheel import Wheel
from smallwheel_ros.pipeline.soil.filter import SoilFilter
from smallwheel_ros.pipeline.soil.model import ZERO, M
from smallwheel_ros.pipeline.soil.stretches import Stretches
from smallwheel_ros.pipeline.tables import Array
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


# Two sizes in tracks of their own, as on a rover with wheels of 0.3 m ahead and of 0.19 m behind.
SIZES = (
    Wheel("front left", 0.30, 0.11, lateral_position=0.33, longitudinal_position=0.4),
    Wheel("front right", 0.30, 0.11, lateral_position=-0.33, longitudinal_position=0.4),
    Wheel("rear left", 0.19, 0.09, lateral_position=0.5, longitudinal_position=-0.4),
    Wheel("rear right", 0.19, 0.09, lateral_position=-0.5, longitudinal_position=-0.4),
)


def m_of(zeros: Array, seed: int) -> tuple[float, float]:
    """Error of m and its stated deviation after 25 m, for the zeros (m) of the four sensors."""
    rng = np.random.default_rng(seed)
    prior, count = SoilPrior.from_soil(soil("dry_sand")), 480
    law = SoilFilter(prior, EstimatorSettings(), (), SIZES, (70.0, 0.30, 0.11))
    wheel = np.arange(count) % 4
    diameter, width = (
        np.array([getattr(w, a) for w in SIZES])[wheel] for a in ("diameter", "width")
    )
    m, n = 0.4, 0.8
    modulus = 30e3 / 0.01**n * (diameter / 0.25) ** m
    load = np.exp(rng.normal(np.log(70.0), 0.25, count))
    depth = static_sinkage(
        lambda z: np.asarray(modulus[:, None] * z**n),
        load * np.exp(0.06 * rng.standard_normal(count)),
        diameter,
        width,
    )
    columns = dict.fromkeys(Stretches.__dataclass_fields__, np.zeros(count)) | {
        "wheel": wheel,
        "sinkage": depth + zeros[wheel] + 5e-4 * rng.standard_normal(count),
        "variance": np.full(count, 2.5e-7),
        "load": load,
        "slip": np.full(count, 0.05),
        "speed": np.full(count, 0.3),
        "distance": 0.2 * (np.arange(count) // 4),
        "place": 0.2 * (np.arange(count) // 4),
        "onward": np.ones(count, dtype=bool),
        "count": np.full(count, 6),
    }
    rows = Stretches(**columns)  # type: ignore[arg-type]
    for first in range(0, count, 4):
        law.absorb(rows.take(slice(first, first + 4)))
    return float(law.mean[M] - m), float(np.sqrt(law.covariance[M, M]))


def test_zeros_of_single_sensors_are_not_taken_for_m() -> None:
    """Zeros that differ by 2 mm, nearly three times the prior: m is no further off than stated."""
    drawn = 2e-3 * np.random.default_rng(5).standard_normal((12, 4))
    found = [m_of(zeros, seed) for seed, zeros in enumerate(drawn)]
    off = np.array([error / deviation for error, deviation in found])
    print("m, deviations off:", np.round(off, 1))
    assert np.abs(off).max() < 3.0
    # The mean of 12 squares of normal errors is over 2.2 once in a hundred times.
    assert np.mean(off**2) < 2.2


def test_m_is_determined_where_sensors_agree() -> None:
    """Half of the prior's deviation is left where wheels of one size agree, more where they do not."""
    half = 0.5 * SoilPrior.from_soil(soil("dry_sand")).m_std
    _, agree = m_of(np.zeros(4), 1)
    _, differ = m_of(np.array([3e-3, -3e-3, -3e-3, 3e-3]), 1)
    assert agree < half < differ
