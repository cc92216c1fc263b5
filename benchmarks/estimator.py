# SPDX-License-Identifier: Apache-2.0
"""The estimator's speed: how many times faster than real time six wheels at 100 Hz are worked off."""

from __future__ import annotations

import math
import time

import numpy as np

from smallwheel_ros.estimator.soil_estimator import Reading, SoilEstimator, SoilPrior
from smallwheel_ros.physics.soil import soil
from smallwheel_ros.physics.wheel import Quantity, Wheel

RATE = 100.0  # Hz


def measurements(wheels: int, steps: int) -> list[Reading]:
    """Wheels of two sizes on one soil, loads that vary, noise of sinkage and load."""
    rng = np.random.default_rng(1)
    sand = soil("dry_sand")
    sizes = [(0.25, 0.10) if j % 2 else (0.35, 0.12) for j in range(wheels)]
    estimator = SoilEstimator(SoilPrior.from_soil(sand))  # for its prediction only
    found = []
    for i in range(steps):
        for j, (diameter, width) in enumerate(sizes):
            load = 55.0 * math.exp(0.3 * math.sin(0.02 * i + j))
            z = estimator.predict(load, diameter, width).sinkage
            found.append(
                Reading(
                    Wheel(f"wheel {j}", diameter, width),
                    round(1e9 * (i / RATE + 1e-4 * j)),
                    Quantity(load * math.exp(0.015 * rng.standard_normal()), 0.015 * load),
                    None,
                    Quantity(z * math.exp(0.07 * rng.standard_normal()), 0.05 * z),
                    None,
                    0.5 * i / RATE,
                    0.5 * i / RATE,
                )
            )
    return found


def real_time(wheels: int, seconds: float) -> float:
    """How many seconds of measurements are worked off in one second, the start included."""
    given = measurements(wheels, int(seconds * RATE))
    estimator = SoilEstimator(SoilPrior.from_soil(soil("dry_sand")))
    start = time.process_time()
    for one in given:
        estimator.update(one)
    return seconds / (time.process_time() - start)


def main() -> None:
    """Print the figure for four and six wheels at 0.5 m/s."""
    for wheels in (4, 6):
        figure = real_time(wheels, 60.0)
        print(f"{wheels} wheels at {RATE:g} Hz: {figure:.1f} x real time on one core")


if __name__ == "__main__":
    main()
