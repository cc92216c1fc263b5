# SPDX-License-Identifier: Apache-2.0
"""A wheel rolled over dry sand by a contact integral that is not the estimator's: its readings."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.estimator.soil_estimator import Reading, SoilEstimator
from smallwheel_ros.physics.soil import soil
from smallwheel_ros.physics.wheel import Quantity, Wheel
from smallwheel_ros.simulate.truth import static_sinkage

Array = NDArray[np.float64]

_WHEEL = {"wheel": "name", "diameter": "diameter", "width": "width", "contact": "contact"}
_NUMBERS = ("load", "sinkage", "slip")  # given without a deviation, they keep theirs


def changed(one: Reading, **changes: Any) -> Reading:
    """A reading with other values, as people say them.

    wheel: its name; diameter, width, contact: of it. time: s. load, sinkage, slip: N, m, 1; load_std: N.
    A distance is that of the wheel, too, where no path is given.
    """
    of_wheel = {name: changes.pop(key) for key, name in _WHEEL.items() if key in changes}
    changes["wheel"] = replace(one.wheel, **of_wheel)
    if "time" in changes:
        time = changes.pop("time")
        changes["stamp"] = round(1e9 * time) if math.isfinite(1e9 * time) else time
    if "distance" in changes:
        changes.setdefault("path", changes["distance"])
    for name in _NUMBERS:
        if isinstance(changes.get(name), float):
            before = getattr(one, name) or Quantity(0.0, 0.0)
            changes[name] = Quantity(changes[name], before.standard_deviation)
    if "load_std" in changes:
        load = changes.get("load", one.load)
        changes["load"] = Quantity(load.value, changes.pop("load_std"))
    return one._replace(**changes)


READING = Reading(
    wheel=Wheel("left", 0.2, 0.1),
    stamp=1_000_000_000,
    load=Quantity(60.0, 1.0),
    slip=None,
    sinkage=Quantity(0.012, 1e-3),
    speed=None,
    distance=5.0,
    path=5.0,
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
    one: Reading = READING,
    start: float = 0.0,
) -> list[Reading]:
    """Readings of a wheel under these loads (N), one every `STEP`.

    load_noise: share. factor: on the modulus of dry sand. start: distance (m) of the first one.
    """
    rng = np.random.default_rng([seed, 31])
    count = loads.size
    modulus = (
        factor
        * SAND.k
        * one.wheel.diameter**SAND.m
        * 0.01 ** (SAND.n - N)
        * np.exp(smooth(rng, count, 0.06))
    )
    full = np.ones(count)
    z = static_sinkage(
        lambda depth: modulus[:, None] * depth**N,
        loads,
        one.wheel.diameter * full,
        one.wheel.width * full,
    )
    shown = z + noise * rng.standard_normal(count)
    weighed = loads * np.exp(load_noise * rng.standard_normal(count))
    return [
        changed(
            one,
            time=one.time + 0.1 * i,
            distance=start + STEP * i,
            load=Quantity(float(weighed[i]), float(load_noise * weighed[i])),
            sinkage=Quantity(float(shown[i]), noise),
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


def follow(estimator: SoilEstimator, readings: Iterable[Reading]) -> SoilEstimator:
    """Give an estimator all readings."""
    for reading in readings:
        estimator.update(reading)
    return estimator
