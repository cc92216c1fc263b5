# SPDX-License-Identifier: Apache-2.0
"""Is the estimator as sure as it may be? Over many soils drawn from the prior, with known sensors.

Errors may be smaller than stated, since faults are allowed for that the data does not show; they may
not be larger.
"""

from __future__ import annotations

import multiprocessing
from concurrent.futures import ProcessPoolExecutor

import numpy as np
import pytest
from scipy.stats import chi2

from benchmarks.robot_scores import error_and_held

KINDS = ("zero known", "zero known, equal", "one track", "scatter 15 %")


def band(drives: int, confidence: float) -> float:
    """What the average of so many of these is not over so often, were errors normal as stated."""
    return float(chi2.ppf(confidence, 3 * drives) / (3 * drives))


def test_a_few_drives_are_not_further_off_than_they_say() -> None:
    found = [error_and_held(("zero known", seed)) for seed in range(20, 24)]
    assert np.mean([one for one, _ in found]) < band(4, 0.999)
    assert np.mean([held for _, held in found]) > 0.9


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_errors_are_not_larger_than_the_filter_says(kind: str) -> None:
    drives = 60
    tasks = [(kind, seed) for seed in range(100, 100 + drives)]
    with ProcessPoolExecutor(mp_context=multiprocessing.get_context("spawn")) as pool:
        found = list(pool.map(error_and_held, tasks, chunksize=5))
    average = float(np.mean([one for one, _ in found]))
    print(f"{kind}: NEES/3 {average:.3f}, held {np.mean([h for _, h in found]):.3f}")
    assert average < band(drives, 0.975)
