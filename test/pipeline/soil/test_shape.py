# SPDX-License-Identifier: Apache-2.0
"""The test of shape: ground with a hard layer is no power of depth, whatever k, n and m."""

from __future__ import annotations

import numpy as np
import pytest
from world_drives import table_of

from smallwheel_ros.onboard.prior import EstimatorSettings, SoilPrior
from smallwheel_ros.physics.soil import soil
from smallwheel_ros.physics.wheel import Wheel
from smallwheel_ros.pipeline.soil.borders import Soils
from smallwheel_ros.pipeline.soil.filter import SoilFilter
from smallwheel_ros.pipeline.soil.local_law import sinkages
from smallwheel_ros.pipeline.soil.shape import shape_doubt
from smallwheel_ros.pipeline.soil.stretches import Stretches
from smallwheel_ros.pipeline.tables import Array
from smallwheel_ros.simulate.truth import static_sinkage

WHEELS = (Wheel("left", 0.3, 0.11), Wheel("right", 0.3, 0.11))
LAYER = 0.009  # m
PRIOR = SoilPrior.from_soil(soil("dry_sand"))


def stretches_over(hard: float, seed: int, count: int) -> tuple[Stretches, Array]:
    """Stretches on a soil that below `LAYER` is so many times as stiff, and the true sinkages, m."""
    rng = np.random.default_rng(seed)
    n, modulus = rng.uniform(0.7, 1.1), 0.0
    modulus = 30e3 / 0.01**n

    def pressure(depth: Array) -> Array:
        beyond = np.maximum(depth - LAYER, 0.0)
        return np.asarray(modulus * (depth**n + hard * LAYER**n * beyond / LAYER))

    load = np.exp(rng.normal(np.log(75.0), 0.35, count))
    diameter, width = np.full(count, 0.3), np.full(count, 0.11)
    depth = static_sinkage(
        pressure, load * np.exp(0.05 * rng.standard_normal(count)), diameter, width
    )
    shown = depth + 4e-4 * rng.standard_normal(count) + 5e-4
    zeros = dict.fromkeys(Stretches.__dataclass_fields__, np.zeros(count))
    way = 0.1 * np.arange(count)
    rows = Stretches(**zeros | {
        "wheel": np.arange(count) % 2, "sinkage": shown, "variance": np.full(count, 1e-8), "load": load,
        "slip": np.full(count, 0.05), "speed": np.full(count, 0.4), "distance": way, "place": way,
        "onward": np.ones(count, dtype=bool), "count": np.full(count, 6), "low": shown, "high": 1.1 * shown,
        "dropped": np.zeros(count, dtype=int), "end": (2.5e9 * way).astype(np.int64),
    })  # type: ignore[arg-type]  # fmt: skip
    return rows, depth


def driven(hard: float, seed: int, count: int = 240, *, doubted: bool = False) -> str:
    """What the test says in the end of such stretches."""
    rows, _ = stretches_over(hard, seed, count)
    law = SoilFilter(PRIOR, EstimatorSettings(), (), WHEELS, (75.0, 0.3, 0.11))
    for first in range(0, count, 2):
        law.absorb(rows.take(slice(first, first + 2)))
    return shape_doubt(rows, law, doubted)


@pytest.mark.parametrize("seed", [1, 2])
def test_a_hard_layer_is_no_power_of_depth(seed: int) -> None:
    assert "harder below" in driven(8.0, seed)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_soil_of_the_law_is_one(seed: int) -> None:
    assert driven(0.0, seed) == ""


def test_a_doubt_stays_while_evidence_is_left() -> None:
    assert driven(1.0, 1) == ""
    assert "harder below" in driven(1.0, 1, doubted=True)


def test_of_few_stretches_nothing_is_said() -> None:
    assert driven(8.0, 1, count=50) == ""


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_over_a_hard_layer_sinkages_are_no_better_known_than_the_zero(seed: int) -> None:
    """A sinkage that hardly grows with load looks like a zero of 3 mm: the law knows no zero there."""
    rows, depth = stretches_over(20.0, seed, 400)
    soils = Soils(PRIOR, EstimatorSettings(), (), WHEELS)
    read = table_of(
        stamp=rows.end, wheel=rows.wheel, distance=rows.distance, onward=rows.onward, load=rows.load
    )
    soils.take(rows, read)
    assert "harder below" in soils.versions.newest.doubt
    newest = np.full(40, soils.versions.count - 1)
    value, variance = sinkages(soils.versions, rows.take(slice(-40, None)), newest)
    off = (value - depth[-40:]) / np.sqrt(variance)
    print("deviations off:", np.round(off.mean(), 1))
    assert np.mean(np.abs(off) < 1.96) >= 0.9
