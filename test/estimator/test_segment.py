# SPDX-License-Identifier: Apache-2.0
"""Readings of a wheel on one stretch of its path become one measurement."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pytest
from wheel_drives import READING, STEP, changed, rolled, varied

from smallwheel_ros.estimator.reading import Reading
from smallwheel_ros.estimator.stretches import Position, Segment, WheelTrack


def collector(sinkage_std: float = 0.001, load_std: float = 0.02) -> WheelTrack:
    return WheelTrack(0.2, sinkage_std, load_std, (Position(ahead=0.3), Position(ahead=-0.3)))


def segments(readings: Sequence[Reading], made: WheelTrack | None = None) -> list[Segment]:
    made = made or collector()
    return [found for one in readings if (found := made.add(one)) is not None]


def constant(count: int, **changes: object) -> list[Reading]:
    one = changed(READING, **changes)
    return [changed(one, time=0.1 * i, distance=STEP * i) for i in range(count)]


def test_a_stretch_closes_with_the_first_reading_behind_it() -> None:
    readings = [changed(one, slip=0.1, speed=0.26, pitch=0.05) for one in constant(17)]
    first, second = segments(readings)
    assert (first.count, second.count) == (8, 8)
    assert (first.sinkage, first.slip, first.speed) == pytest.approx((0.012, 0.1, 0.26))
    assert first.pitch == pytest.approx(0.05)
    assert first.distance == pytest.approx(STEP * 7)
    assert first.place == pytest.approx(0.3 + STEP * 3.5)  # the wheel is ahead of the middle
    assert segments(constant(8)) == []


def test_what_is_not_known_of_some_readings_is_the_mean_of_the_others() -> None:
    readings = constant(9)
    readings[3] = changed(readings[3], slip=0.2)
    readings[4] = changed(readings[4], slip=0.4)
    (found,) = segments(readings)
    assert found.slip == pytest.approx(0.3)
    assert found.speed is None


def test_it_is_the_wheels_own_path_that_counts() -> None:
    turning = [changed(one, distance=5.0, path=STEP * i) for i, one in enumerate(constant(17))]
    assert len(segments(turning)) == 2
    standing = [changed(one, path=7.0) for one in constant(200)]
    assert segments(standing) == []


def test_an_outlier_is_dropped_from_the_mean() -> None:
    readings = rolled(varied(200), 1)
    readings[100] = changed(readings[100], sinkage=0.06)
    clean, dirty = (segments(r) for r in (rolled(varied(200), 1), readings))
    assert sum(s.dropped for s in dirty) == sum(s.dropped for s in clean) + 1
    off = [abs(a.sinkage - b.sinkage) for a, b in zip(clean, dirty, strict=True)]
    assert max(off) < 3e-4


@pytest.mark.parametrize("noise", [1e-4, 5e-4, 2e-3])
def test_noise_is_learnt_under_a_trend(noise: float) -> None:
    """Sinkage that rises by 10 mm over a stretch is no noise of the sensor; nor is a wild reading."""
    rng = np.random.default_rng(1)
    readings = [
        changed(
            one,
            sinkage=0.01 + 0.0012 * (i % 8) + noise * float(rng.standard_normal())
            if i % 50
            else 0.09,
        )
        for i, one in enumerate(constant(2000))
    ]
    made = collector()
    segments(readings, made)
    assert math.sqrt(made.reading_variance) == pytest.approx(noise, rel=0.4)


def test_noise_of_loads_does_not_dilute_their_spread() -> None:
    """Regression calibration: mean and variance come out right, whatever was told of the noise."""
    loads = varied(4000, amplitude=0.1)
    for told in (0.05, 0.1):
        found = segments(rolled(loads, 1, load_noise=0.1), collector(load_std=told))[40:]
        shown = np.log([s.load for s in found])
        true = np.log(loads)[: 500 * 8].reshape(500, 8).mean(axis=1)[40 : 40 + len(found)]
        # Slope of the truth by what is given to the filter: 1 where nothing is diluted.
        assert np.polyfit(shown, true, 1)[0] == pytest.approx(1.0, abs=0.1)
        error = float(np.std(shown - true))
        assert math.sqrt(np.mean([s.log_load_variance for s in found])) == pytest.approx(
            error, rel=0.3
        )


def test_a_load_cell_without_variation_is_its_mean() -> None:
    found = segments(rolled(np.full(2000, 60.0), 1, load_noise=0.05))
    assert np.std(np.log([s.load for s in found[50:]])) < 0.01
    assert found[-1].load == pytest.approx(60.0, rel=0.02)


def test_how_fast_the_load_changes_is_told() -> None:
    readings = [changed(one, load=60.0 * math.exp(0.3 * one.time)) for one in constant(9)]
    (found,) = segments(readings)
    assert found.load_rate == pytest.approx(0.3)
    assert segments(constant(9))[0].load_rate == pytest.approx(0.0, abs=1e-9)


def test_a_stretch_knows_what_was_shown_and_the_steps_of_its_sensor() -> None:
    readings = constant(17)
    readings[4] = changed(readings[4], sinkage=0.0121)
    readings[6] = changed(readings[6], sinkage=0.0123)
    first, second = segments(readings)
    assert first.shown == (0.012, 0.0123)
    assert second.shown == (0.012, 0.012)
    assert (first.step, second.step) == pytest.approx((1e-4, 1e-4))


def test_an_hour_of_standing_does_not_fill_the_memory() -> None:
    made = collector()
    for i in range(36_000):
        made.add(changed(READING, time=0.1 * i, path=3.0, sinkage=0.012 + 1e-4 * (i % 7)))
    assert len(made._readings) <= 256
    found = made.add(changed(READING, time=1e4, path=3.3))
    assert found is not None
    assert found.sinkage == pytest.approx(0.0123, abs=1e-4)
