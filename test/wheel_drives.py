# SPDX-License-Identifier: Apache-2.0
"""A wheel rolled over dry sand by a contact integral that is not the estimator's: its readings."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.estimator.soil_estimator import SinkageMeasurement, SoilEstimator
from smallwheel_ros.physics.soil import soil
from smallwheel_ros.simulate.truth import static_sinkage

Array = NDArray[np.float64]

READING = SinkageMeasurement(
    time=1.0,
    wheel="left",
    sinkage=0.012,
    variance=1e-6,
    load=60.0,
    load_variance=1.0,
    diameter=0.2,
    width=0.1,
    distance=5.0,
)
SAND = soil("dry_sand")
N = 0.55  # of the ground here; dry sand has another
STEP = 0.026  # m from reading to reading: 8 of them make a segment of 0.2 m
NOISE = 5e-4  # m, of one reading of sinkage


def smooth(rng: np.random.Generator, count: int, std: float, length: float = 0.2) -> Array:
    """A stationary random process along the way, with this standard deviation (Ornstein-Uhlenbeck)."""
    keep, values = math.exp(-STEP / length), std * rng.standard_normal(count)
    for i in range(1, count):
        values[i] = keep * values[i - 1] + math.sqrt(1.0 - keep * keep) * values[i]
    return values


def rolled(
    loads: Array,
    seed: int,
    *,
    load_noise: float = 0.012,
    factor: float = 0.6,
    noise: float = NOISE,
    one: SinkageMeasurement = READING,
    start: float = 0.0,
) -> list[SinkageMeasurement]:
    """Readings of a wheel under these loads (N), one every `STEP`.

    load_noise: share. factor: on the modulus of dry sand. start: distance (m) of the first one.
    """
    rng = np.random.default_rng([seed, 31])
    count = loads.size
    modulus = (
        factor
        * SAND.k
        * one.diameter**SAND.m
        * 0.01 ** (SAND.n - N)
        * np.exp(smooth(rng, count, 0.06))
    )
    full = np.ones(count)
    z = static_sinkage(
        lambda depth: modulus[:, None] * depth**N, loads, one.diameter * full, one.width * full
    )
    shown = z + noise * rng.standard_normal(count)
    weighed = loads * np.exp(load_noise * rng.standard_normal(count))
    return [
        replace(
            one,
            time=one.time + 0.1 * i,
            distance=start + STEP * i,
            load=float(weighed[i]),
            load_variance=float((load_noise * weighed[i]) ** 2),
            sinkage=float(shown[i]),
            variance=noise**2,
        )
        for i in range(count)
    ]


def varied(count: int, seed: int = 0, amplitude: float = 0.35) -> Array:
    """Loads (N) as on uneven ground."""
    rng = np.random.default_rng([seed, 9])
    way = STEP * np.arange(count)
    waves = sum(
        np.sin(2.0 * np.pi * way / length + rng.uniform(0.0, 6.28)) for length in (2.3, 1.1)
    )
    return 60.0 * np.exp(amplitude * waves)


def follow(estimator: SoilEstimator, readings: Iterable[SinkageMeasurement]) -> SoilEstimator:
    """Give an estimator all readings."""
    for reading in readings:
        estimator.update(reading)
    return estimator
