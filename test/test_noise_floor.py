from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from smallwheel_ros.measurements.noise_floor import noise_floor
from smallwheel_ros.measurements.table import Measurements, read_measurements
from smallwheel_ros.physics.conditions import Conditions

SHARED = Path(os.environ.get("SMALLWHEEL_SHARED", Path(__file__).parents[2] / "shared"))
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
    floor = noise_floor(table(level + rng.normal(0, 5e-4, run.size), run))["sinkage"]
    assert floor.source == "repeats"
    assert floor.freedom == 600
    assert floor.value == pytest.approx(5e-4, rel=0.1)
    assert floor.std == pytest.approx(5e-4 / np.sqrt(1200), rel=0.1)


def test_rows_that_differ_in_load_are_no_repeats() -> None:
    run = np.repeat(["a", "b"], 10)
    load = np.tile(np.linspace(1.0, 100.0, 10), 2)
    floor = noise_floor(table(load * 1e-4, run, load=load))["sinkage"]
    assert floor.value is None
    assert "no setting was repeated" in floor.reason


def test_without_run_names_rows_of_equal_settings_are_repeats() -> None:
    rng = np.random.default_rng(2)
    load = np.repeat([20.0, 40.0, 60.0], 50)
    z = load * 1e-4 + rng.normal(0, 1e-4, load.size)
    floor = noise_floor(table(z, np.arange(load.size), load=load, runs_given=False))["sinkage"]
    assert floor.value == pytest.approx(1e-4, rel=0.2)


def test_declared_deviations_stand_in_where_nothing_was_repeated() -> None:
    declared = {"sinkage": np.array([3e-4, np.nan, 4e-4])}
    data = table(np.array([0.01, 0.02, 0.03]), np.arange(3), declared_std=declared)
    floor = noise_floor(data)["sinkage"]
    assert floor.source == "declared"
    assert floor.value == pytest.approx(np.sqrt((9 + 16) / 2) * 1e-4)
    assert floor.std is None


@pytest.mark.skipif(not RIG.is_dir(), reason=f"the rig's measurements are not at {RIG}")
def test_the_rigs_repeat_trials_differ_by_two_thirds_of_a_millimetre() -> None:
    data = read_measurements(RIG / "rolling_smooth_wheel.csv")
    straight = noise_floor(data.take(data.conditions["slip_angle"] == 0))["sinkage"]
    # Eight of nine runs: in one the load varies by 17 %, which is another setting.
    assert straight.freedom == 16
    assert straight.value == pytest.approx(0.685e-3, abs=0.005e-3)
    indentation = noise_floor(read_measurements(RIG / "indentation.csv"))["sinkage"]
    assert indentation.value is None
