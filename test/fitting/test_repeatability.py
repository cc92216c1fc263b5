# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from smallwheel_ros.measurements.from_file import read_measurements
from smallwheel_ros.measurements.measurements import Measurements
from smallwheel_ros.measurements.settings import repeatability
from smallwheel_ros.physics.conditions import Conditions

SHARED = Path(os.environ.get("SMALLWHEEL_SHARED", Path(__file__).parents[3] / "shared"))
RIG = SHARED / "data" / "cmu_wheel_rig"


def table(
    sinkage: np.ndarray, run: np.ndarray, *, load: np.ndarray | float = 60.0, **more: object
) -> Measurements:
    rows = sinkage.size
    return Measurements(
        Conditions.of(np.broadcast_to(load, rows), 0.2, 0.1),
        {"sinkage": sinkage},
        run.astype(np.str_),
        np.full(rows, "wheel"),
        np.arange(2, rows + 2),
        **more,  # type: ignore[arg-type]
    )


def test_repeats_give_the_noise_whatever_the_runs_differ_by() -> None:
    rng = np.random.default_rng(1)
    run = np.repeat(np.arange(200), 4)
    level = np.repeat(rng.uniform(0.005, 0.05, 200), 4)
    found = repeatability(table(level + rng.normal(0, 5e-4, run.size), run))
    assert found["sinkage"] == pytest.approx(5e-4, rel=0.1)


def test_rows_that_differ_in_load_are_no_repeats() -> None:
    run = np.repeat(["a", "b"], 10)
    load = np.tile(np.linspace(1.0, 100.0, 10), 2)
    assert repeatability(table(load * 1e-4, run, load=load)) == {}


def test_without_run_names_rows_of_equal_settings_are_repeats() -> None:
    rng = np.random.default_rng(2)
    load = np.repeat([20.0, 40.0, 60.0], 50)
    z = load * 1e-4 + rng.normal(0, 1e-4, load.size)
    found = repeatability(table(z, np.arange(load.size), load=load, runs_given=False))
    assert found["sinkage"] == pytest.approx(1e-4, rel=0.2)


@pytest.mark.skipif(not RIG.is_dir(), reason=f"the rig's measurements are not at {RIG}")
def test_the_rigs_repeat_trials_differ_by_two_thirds_of_a_millimetre() -> None:
    data = read_measurements(RIG / "rolling_smooth_wheel.csv")
    straight = repeatability(data.take(data.conditions["slip_angle"] == 0))["sinkage"]
    # Eight of nine runs: in one the load varies by 17 %, which is another setting.
    assert straight == pytest.approx(0.685e-3, abs=0.005e-3)
    assert "sinkage" not in repeatability(read_measurements(RIG / "indentation.csv"))
