# SPDX-License-Identifier: Apache-2.0
"""Is the estimator as sure as it may be? Over many soils drawn about the prior, with known sensors.

Errors may be smaller than stated, since faults are allowed for that the data does not show; they may
not be larger.
"""

from __future__ import annotations

import multiprocessing
from concurrent.futures import ProcessPoolExecutor

import numpy as np
import pytest
from scipy.stats import chi2
from world_drives import driven_world

from smallwheel_ros.pipeline.soil.borders import Soils
from smallwheel_ros.pipeline.soil.local_law import law_of
from smallwheel_ros.pipeline.soil.stretches import StretchState, stretches

KINDS = ("zero known", "zero known, equal", "one track", "scatter 15 %")


def band(drives: int, confidence: float) -> float:
    """What the average of so many of these is not over so often, were errors normal as stated."""
    return float(chi2.ppf(confidence, 3 * drives) / (3 * drives))


def error(task: tuple[str, int]) -> float:
    """How far off the law is at the end of a drive of 12 m, given as world and seed.

    The normalised error squared of (ln pressure, n, m) over its expectation.
    """
    found = driven_world("soil", task[0], "half", task[1])
    settings = found.settings
    soils = Soils(settings.prior, settings.estimator, (), settings.wheels)
    closed, _ = stretches(StretchState.of(settings), found.rows, settings)
    assert closed is not None
    soils.take(closed, found.rows)
    mean, covariance = law_of(soils.versions.newest)
    true = found.drive.ground.soil
    off = mean - np.array([true.pressure, true.n, true.m])
    return float(off @ np.linalg.solve(covariance, off)) / 3.0


def test_a_few_drives_are_not_further_off_than_they_say() -> None:
    assert np.mean([error(("zero known", seed)) for seed in (20, 21)]) < band(2, 0.999)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_errors_are_not_larger_than_the_filter_says(kind: str) -> None:
    drives = 60
    tasks = [(kind, seed) for seed in range(100, 100 + drives)]
    # Forked: pytest loads a test's module by its path, so that a process of its own cannot import it.
    with ProcessPoolExecutor(mp_context=multiprocessing.get_context("fork")) as pool:
        found = list(pool.map(error, tasks, chunksize=5))
    average = float(np.mean(found))
    print(f"{kind}: NEES/3 {average:.3f}")
    assert average < band(drives, 0.975)
