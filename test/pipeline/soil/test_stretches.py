# SPDX-License-Identifier: Apache-2.0
"""Rows of a wheel on one stretch of its path become one measurement."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from world_drives import table_of

from smallwheel_ros.onboard.prior import EstimatorSettings, SoilPrior
from smallwheel_ros.onboard.settings import OnboardSettings
from smallwheel_ros.physics.soil import soil, usual_strength
from smallwheel_ros.physics.wheel import Wheel
from smallwheel_ros.pipeline.soil.stretches import Stretches, StretchState, stretches
from smallwheel_ros.pipeline.tables import Array, Readings, unknown

STEP = 0.026  # m of path between two readings: eight in a stretch of 0.2 m
WHEEL = Wheel("left", 0.2, 0.1, longitudinal_position=0.3)
BASE = soil("dry_sand")
SETTINGS = OnboardSettings(
    (WHEEL,), SoilPrior.from_soil(BASE), usual_strength(BASE), estimator=EstimatorSettings()
)


def rows(count: int, **columns: Array | float) -> Readings:
    """Rows of a wheel that rolls on, each column a number or one for each row."""
    index = np.arange(count)
    given = {
        "stamp": 100_000_000 * index, "wheel": np.zeros(count, dtype=int), "sinkage": 0.012, "load": 60.0,
        "load_std": 1.2, "slip": unknown(count), "speed": unknown(count), "pitch": 0.0, "passes": 0.0,
        "pass_doubt": 0.0, "pass_number": np.nan, "distance": STEP * index, "path": STEP * index,
        "onward": np.ones(count, dtype=bool),
    } | columns  # fmt: skip
    full = {name: np.full(count, v) if np.ndim(v) == 0 else v for name, v in given.items()}
    return table_of(**full)


def closed(table: Readings, state: StretchState | None = None) -> Stretches:
    found, _ = stretches(state or StretchState.of(SETTINGS), table, SETTINGS)
    assert found is not None
    return found


def test_a_stretch_closes_with_the_first_row_behind_it() -> None:
    found = closed(rows(17, slip=0.1, speed=0.26, pitch=0.05))
    assert found.count.tolist() == [8, 8]
    for name, value in {"sinkage": 0.012, "slip": 0.1, "speed": 0.26, "pitch": 0.05}.items():
        np.testing.assert_allclose(getattr(found, name), value)
    assert found.distance[0] == pytest.approx(STEP * 7)
    assert found.place[0] == pytest.approx(0.3 + STEP * 3.5)  # the wheel is ahead of the middle
    assert found.end[0] == 800_000_000
    assert stretches(StretchState.of(SETTINGS), rows(8), SETTINGS)[0] is None


def test_what_is_not_known_of_some_rows_is_the_mean_of_the_others() -> None:
    slip = unknown(9)
    slip[3:5] = 0.2, 0.4
    found = closed(rows(9, slip=slip))
    assert found.slip[0] == pytest.approx(0.3)
    assert np.isnan(found.speed[0])


def test_it_is_the_wheels_own_path_that_counts() -> None:
    assert len(closed(rows(17, distance=5.0))) == 2
    standing = stretches(StretchState.of(SETTINGS), rows(200, path=7.0), SETTINGS)
    assert standing[0] is None


def test_where_the_vehicle_turns_back_a_stretch_ends() -> None:
    onward = np.arange(20) < 6
    found = closed(rows(20, onward=onward, distance=STEP * (6 - np.abs(np.arange(20) - 6))))
    assert found.count[0] == 6
    assert found.onward.tolist() == [True, False]
    assert found.place[1] < found.place[0]  # the same wheel is behind the middle now


def test_an_outlier_is_dropped_from_the_mean() -> None:
    rng = np.random.default_rng(1)
    sinkage = 0.012 + 5e-4 * rng.standard_normal(200)
    clean = closed(rows(200, sinkage=sinkage))
    wild = np.where(np.arange(200) == 100, 0.06, sinkage)
    dirty = closed(rows(200, sinkage=wild))
    assert dirty.dropped.sum() == clean.dropped.sum() + 1
    assert np.abs(dirty.sinkage - clean.sinkage).max() < 3e-4


@pytest.mark.parametrize("noise", [1e-4, 5e-4, 2e-3])
def test_noise_is_learnt_under_a_trend(noise: float) -> None:
    """Sinkage that rises by 10 mm over a stretch is no noise of the sensor; nor is a wild reading."""
    rng, index = np.random.default_rng(1), np.arange(2000)
    sinkage = 0.01 + 0.0012 * (index % 8) + noise * rng.standard_normal(2000)
    state = StretchState.of(SETTINGS)
    closed(rows(2000, sinkage=np.where(index % 50, sinkage, 0.09)), state)
    assert math.sqrt(state.wheels[0].reading_variance) == pytest.approx(noise, rel=0.4)


def test_noise_of_loads_does_not_dilute_their_spread() -> None:
    """Regression calibration: mean and variance come out right."""
    rng = np.random.default_rng(3)
    true = np.log(60.0) + 0.1 * np.sin(0.011 * np.arange(4000)) * 1.4
    found = closed(rows(4000, load=np.exp(true + 0.1 * rng.standard_normal(4000))))
    means = true[: 8 * len(found)].reshape(-1, 8).mean(axis=1)[40:]
    shown = np.log(found.load)[40:]
    # Slope of the truth by what is given to the filter: 1 where nothing is diluted.
    assert np.polyfit(shown, means, 1)[0] == pytest.approx(1.0, abs=0.1)
    stated = math.sqrt(float(found.load_variance[40:].mean()))
    assert stated == pytest.approx(float(np.std(shown - means)), rel=0.3)


def test_a_load_cell_without_variation_is_its_mean() -> None:
    rng = np.random.default_rng(1)
    found = closed(rows(2000, load=60.0 * np.exp(0.05 * rng.standard_normal(2000))))
    assert np.std(np.log(found.load[50:])) < 0.01
    assert found.load[-1] == pytest.approx(60.0, rel=0.02)


def test_how_fast_the_load_changes_is_told() -> None:
    assert closed(rows(9, load=60.0 * np.exp(0.03 * np.arange(9)))).load_rate[0] == pytest.approx(
        0.3
    )
    assert closed(rows(9)).load_rate[0] == pytest.approx(0.0, abs=1e-9)


def test_a_stretch_knows_what_was_shown_and_the_steps_of_its_sensor() -> None:
    sinkage = np.full(17, 0.012)
    sinkage[4], sinkage[6] = 0.0121, 0.0123
    found = closed(rows(17, sinkage=sinkage))
    np.testing.assert_allclose([found.low, found.high], [[0.012, 0.012], [0.0123, 0.012]])
    np.testing.assert_allclose(found.step, 1e-4)


def test_an_hour_of_standing_does_not_fill_the_memory() -> None:
    state = StretchState.of(SETTINGS)
    closed(rows(9), state)
    for k in range(60):
        parked = rows(600, path=3.0, distance=3.0)
        stretches(state, replace(parked, stamp=parked.stamp + (k + 1) * 60_000_000_000), SETTINGS)
        assert state.wheels[0].open is not None
        assert len(state.wheels[0].open) < 10
