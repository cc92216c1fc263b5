# SPDX-License-Identifier: Apache-2.0
"""How sure and how late slip is by wheel speeds and odometry alone, and odometry that shows none."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from random_examples import examples

from smallwheel_ros.estimator.reading import SECOND, Reading
from smallwheel_ros.onboard.motion_watch import OdometryWatch
from smallwheel_ros.physics.conditions import PRESSED
from smallwheel_ros.physics.wheel import Quantity, Wheel, wheel_slip

Array = NDArray[np.float64]

WHEELS = tuple(Wheel(name, 0.25, 0.1) for name in ("a", "b", "c", "d"))
RATE = 10.0  # Hz
STANDSTILL = 0.01


def commanded(seconds: float, stops: bool = False) -> Array:
    """Speed of the rims, m/s: it varies by a tenth; stops: twice in each ten seconds it ramps from 0."""
    time = np.arange(int(seconds * RATE)) / RATE
    speed = 0.4 * (1.0 + 0.1 * np.sin(0.5 * time))
    return np.minimum(speed, 0.6 * np.maximum(np.mod(time, 5.0) - 1.0, 0.0)) if stops else speed


def driven(watch: OdometryWatch, rims: Array, speeds: Array, noise: float = 0.002) -> list[Reading]:
    """Give the watch what wheels and odometry show; encoders have noise (m/s)."""
    rng = np.random.default_rng(5)
    found = []
    for i, (rim, shown) in enumerate(zip(rims, speeds, strict=True)):
        for wheel in WHEELS:
            turning = float(rim) + (noise * float(rng.standard_normal()) if rim else 0.0)
            over, around = Quantity(float(shown), 0.01), Quantity(turning, 0.01 * abs(turning))
            slip = wheel_slip(over, around, STANDSTILL)
            one = Reading(
                wheel, 10**9 + int(i * SECOND / RATE), None, slip, None, over.value, 0.0, 0.0,
                rim_speed=turning, speed_std=0.01, rim_std=around.standard_deviation,
                stands=slip is None,
            )  # fmt: skip
            found.append(watch.add(one))
    return found


def patches(count: int) -> Array:
    """Slip of 0.05 to 0.2 in patches of a second or two."""
    rng = np.random.default_rng(3)
    values = rng.uniform(0.05, 0.2, count // 15 + 1)
    return np.repeat(values, 15)[:count]


@pytest.mark.parametrize("noise", [0.01, 0.04])
def test_noise_is_learnt_whatever_the_messages_say(noise: float) -> None:
    rims = commanded(60.0)
    slip = patches(rims.size)
    errors = noise * np.random.default_rng(1).standard_normal(rims.size)
    watch = OdometryWatch(WHEELS, STANDSTILL)
    readings = driven(watch, rims, rims * (1.0 - slip) + errors)[-1200:]
    true = np.repeat(slip, len(WHEELS))[-1200:]
    known = [(one.slip, i) for one, i in zip(readings, true, strict=True) if one.slip is not None]
    inside = [abs(s.value - i) < 1.96 * s.standard_deviation for s, i in known]
    assert len(known) == 1200
    assert 0.90 < np.mean(inside) < 0.995
    assert watch.shows_slip
    assert watch.findings == ()


def test_a_late_odometry_does_not_slip_where_speed_changes() -> None:
    rims = commanded(80.0, stops=True)
    late = 3  # readings of 0.1 s
    speeds = np.concatenate([np.zeros(late), rims[:-late]]) * 0.95
    watch = OdometryWatch(WHEELS, STANDSTILL)
    readings = driven(watch, rims, speeds)
    assert watch.late.value == pytest.approx(0.3, abs=0.06)
    newest = [one.slip for one in readings[-1200:] if one.slip is not None]
    inside = [abs(slip.value - 0.05) < 1.96 * slip.standard_deviation for slip in newest]
    assert np.mean(inside) > 0.93
    plain = [1.0 - v / r for r, v in zip(rims[-300:], speeds[-300:], strict=True) if r > 0.05]
    assert np.mean(np.abs(np.subtract(plain, 0.05)) < 0.1) < 0.9  # as it is without


class TestShowsSlip:
    @pytest.mark.parametrize("stops", [False, True])
    @pytest.mark.parametrize("scale", [1.0, 0.98])
    def test_an_odometry_of_the_wheels_is_found_out(self, stops: bool, scale: float) -> None:
        rims = commanded(60.0, stops)
        watch = OdometryWatch(WHEELS, STANDSTILL)
        last = driven(watch, rims, scale * rims)[-1]
        assert not watch.shows_slip
        assert last.slip is None
        assert last.rim_speed is None
        (words,) = watch.findings
        assert words.startswith("odometry shows no slip: over the last metres it has agreed")

    def test_one_that_is_filtered_too(self) -> None:
        rims = commanded(60.0)
        filtered, speed = [], 0.4
        for rim in rims:
            speed += 0.3 * (rim - speed)
            filtered.append(speed)
        watch = OdometryWatch(WHEELS, STANDSTILL)
        driven(watch, rims, np.array(filtered))
        assert not watch.shows_slip

    def test_slip_ends_it(self) -> None:
        rims = commanded(60.0)
        speeds = np.where(np.arange(rims.size) < 400, rims, 0.85 * rims)
        watch = OdometryWatch(WHEELS, STANDSTILL)
        readings = driven(watch, rims, speeds)
        known = [one.slip is not None for one in readings]
        assert not known[1590]
        assert all(known[-600:])
        assert watch.findings == ()

    def test_on_a_firm_floor_a_camera_is_not_taken_for_wheels(self) -> None:
        taken = 0
        for seed in range(20):
            rims = commanded(40.0)
            errors = 0.01 * np.random.default_rng(seed).standard_normal(rims.size)
            watch = OdometryWatch(WHEELS, STANDSTILL)
            driven(watch, rims, 1.005 * rims + errors)
            taken += not watch.shows_slip
        assert taken <= 2

    def test_a_steady_slip_is_one(self) -> None:
        rims = commanded(60.0)
        watch = OdometryWatch(WHEELS, STANDSTILL)
        driven(watch, rims, 0.9 * rims)
        assert watch.shows_slip


def test_a_pressed_wheel_is_left_alone() -> None:
    wheel = Wheel("plate", 0.25, 0.1, contact=PRESSED)
    one = Reading(wheel, 10**9, None, None, None, None, 0.0, 0.0)
    assert OdometryWatch((wheel,), STANDSTILL).add(one) is one


@settings(max_examples=examples(30), deadline=None)
@given(
    rims=st.lists(st.floats(-1e8, 1e8), min_size=8, max_size=40),
    speeds=st.lists(st.floats(-50.0, 50.0), min_size=8, max_size=40),
)
def test_no_speed_of_a_rim_is_too_wild(rims: list[float], speeds: list[float]) -> None:
    """Over some metres at 1e8 m/s slip and delay are one and the same to sixteen digits."""
    rows = min(len(rims), len(speeds))
    watch = OdometryWatch(WHEELS, STANDSTILL)
    for one in driven(watch, np.array(rims[:rows]), np.array(speeds[:rows])):
        assert one.slip is None or np.isfinite(one.slip).all()
    assert 0.0 <= watch.late.value <= 0.5
    assert np.isfinite(watch.late.standard_deviation)
    assert all("nan" not in words for words in watch.findings)
