"""The estimator's speed: one update against a bare filterpy one, and six wheels against real time.

The bare update is filterpy's ExtendedKalmanFilter of the same size with a measurement function and
a Jacobian that return constants: what any filter on filterpy costs at least. Both are timed in
turns, so that a busy machine slows both.
"""

from __future__ import annotations

import math
import time

import filterpy
import numpy as np
from filterpy.kalman import ExtendedKalmanFilter

from smallwheel_ros.estimator.soil_estimator import SinkageMeasurement, SoilEstimator, SoilPrior
from smallwheel_ros.physics.soil import soil

ROUNDS, UPDATES = 15, 400
RATE = 100.0  # Hz


def measurements(wheels: int, steps: int) -> list[SinkageMeasurement]:
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
                SinkageMeasurement(
                    i / RATE + 1e-4 * j,
                    f"wheel {j}",
                    z * math.exp(0.07 * rng.standard_normal()),
                    (0.05 * z) ** 2,
                    load * math.exp(0.015 * rng.standard_normal()),
                    (0.015 * load) ** 2,
                    diameter,
                    width,
                    0.5 * i / RATE,
                )
            )
    return found


def update_ratio(wheels: int) -> tuple[float, float, float]:
    """Median times (us) of one update and of a bare one, and the median ratio."""
    given = iter(measurements(wheels, (ROUNDS * UPDATES + 2000) // wheels + 1))
    estimator = SoilEstimator(SoilPrior.from_soil(soil("dry_sand")))
    for _ in range(1500):  # past the opening
        estimator.update(next(given))
    size = 3 + wheels
    bare = ExtendedKalmanFilter(dim_x=size, dim_z=1)
    bare.x, bare.P = np.zeros(size), np.eye(size)
    bare.R = np.array([[1.0]])
    jacobian, value, z = np.full((1, size), 0.01), np.zeros(1), np.zeros(1)
    rows = []
    for _ in range(ROUNDS):
        batch = [next(given) for _ in range(UPDATES)]
        start = time.perf_counter()
        for one in batch:
            estimator.update(one)
        middle = time.perf_counter()
        for _ in range(UPDATES):
            bare.update(z, lambda _: jacobian, lambda _: value)
        rows.append((middle - start, time.perf_counter() - middle))
    times = np.array(rows) / UPDATES * 1e6
    return (*np.median(times, axis=0), float(np.median(times[:, 0] / times[:, 1])))


def real_time(wheels: int, seconds: float) -> float:
    """How many seconds of measurements are worked off in one second, the start included."""
    given = measurements(wheels, int(seconds * RATE))
    estimator = SoilEstimator(SoilPrior.from_soil(soil("dry_sand")))
    start = time.process_time()
    for one in given:
        estimator.update(one)
    return seconds / (time.process_time() - start)


def main() -> None:
    print(f"filterpy {filterpy.__version__}, median of {ROUNDS} rounds of {UPDATES} updates")
    for wheels in (4, 6):
        ours, bare, ratio = update_ratio(wheels)
        print(
            f"{wheels} wheels: update {ours:.1f} us, bare filterpy update {bare:.1f} us, "
            f"ratio {ratio:.2f} (target 2.5)"
        )
    print(f"6 wheels at {RATE:g} Hz: {real_time(6, 60.0):.1f} x real time on one core (target 15)")


if __name__ == "__main__":
    main()
