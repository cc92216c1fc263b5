# SPDX-License-Identifier: Apache-2.0
"""Swept runs: curves of plates and pressed wheels, and time series; the rows of a run are no repeats.

Each is sampled at four densities from the same underlying runs: fewer rows are a selection of more.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from benchmarks._bench import Bench, correlated, designed, repeated, stream
from smallwheel_ros.simulate.rig import draw_design
from smallwheel_ros.simulate.truth import supported_load

Array = NDArray[np.float64]

DENSITIES = (3, 20, 100, 300)
_DENSEST = max(DENSITIES)
_DEVIATION = 0.06  # standard deviation of ln p along a curve
_SIZES = {"plate": (0.05, 0.10, 0.15), "pressed": (0.15, 0.25, 0.35)}  # diameter, m
_WIDTH = 0.08
_SHALLOWEST, _DEEPEST = 1e-3, 30e-3  # of a curve, m


def selected(rows: int) -> NDArray[np.intp]:
    """Which rows of the densest sampling a thinner one keeps: evenly spread, both ends."""
    return np.round(np.linspace(0, _DENSEST - 1, rows)).astype(np.intp)


def random_fourier(rng: np.random.Generator) -> Callable[[Array], Array]:
    """A smooth random function of unit variance, correlated over about 0.7."""
    count = 40
    frequency = rng.normal(0.0, 1.0 / 0.7, count)
    phase = rng.uniform(0.0, 2.0 * np.pi, count)

    def value(x: Array) -> Array:
        waves = np.cos(x[:, None] * frequency + phase)
        return np.asarray(np.sum(waves, axis=1) * np.sqrt(2.0 / count))

    return value


def ornstein_uhlenbeck(rng: np.random.Generator) -> Callable[[Array], Array]:
    """A rough random function of unit variance, correlated over 0.7."""
    start, step, count = np.log(_SHALLOWEST) - 0.1, 0.01, 400
    series = correlated(rng, count, 0.7 / step)
    return lambda x: np.interp(x, start + step * np.arange(count), series)


def curves(seed: int, part: int, contact: str, rows: int) -> pd.DataFrame:
    """Nine curves, three sizes three times, of p = k z^n D^m; even seeds rough, odd ones smooth."""
    soil = draw_design((), (), stream(seed, 0, 21)).soil
    deviation = random_fourier if seed % 2 else ornstein_uhlenbeck
    depth = np.linspace(_SHALLOWEST, _DEEPEST, _DENSEST)
    blocks = []
    for number, diameter in enumerate(np.repeat(_SIZES[contact], 3)):
        rng = stream(seed, part, 30, number)
        modulus = soil.k * diameter**soil.m * np.exp(rng.normal(0.0, 0.03))

        def law(z: Array, modulus: float = modulus) -> Array:
            return np.asarray(modulus * z**soil.n)

        if contact == "plate":
            width, load = diameter, np.pi / 4.0 * diameter**2 * law(depth)
        else:  # soil on both sides of the lowest point
            width, one = _WIDTH, np.ones(_DENSEST)
            load = 2.0 * supported_load(law, diameter * one, width * one, depth)
        load = load * np.exp(_DEVIATION * deviation(rng)(np.log(depth)))
        load = load * (1.0 + rng.normal(0.0, 0.005, _DENSEST))
        shown = depth + rng.normal(0.0, 0.03e-3, _DENSEST)
        keep = selected(rows)
        block = pd.DataFrame(
            {
                "run": f"curve_{number + 1}",
                "contact": contact,
                "diameter [mm]": 1e3 * diameter,
                "width [mm]": 1e3 * width,
                "load [N]": load[keep],
                "sinkage [mm]": 1e3 * shown[keep],
            }
        )
        blocks.append(block)
    return pd.concat(blocks, ignore_index=True)


def time_series(seed: int, part: int, hidden: tuple[str, ...], rows: int) -> pd.DataFrame:
    """Twenty runs, one setting each; the soil varies along the path, over a tenth of a run."""
    design, effects, runs = designed(seed, part, hidden, 20)
    at, number = repeated(runs, _DENSEST)
    rng = stream(seed, part, 31)
    along = [correlated(rng, _DENSEST, _DENSEST / 10) for _ in runs]
    scatter = np.exp(
        0.06 * np.concatenate(along) + np.repeat(rng.normal(0.0, 0.05, len(runs)), _DENSEST)
    )
    table = Bench(design.soil, effects, noise=0.02).table(at, number, scatter, rng)
    keep = (_DENSEST * np.arange(len(runs))[:, None] + selected(rows)).ravel()
    return table.iloc[keep].reset_index(drop=True)
