# SPDX-License-Identifier: Apache-2.0
"""Sensors without noise show a truth that was written by hand, but for the one fault that they are given.

Tests `sensors.py`.
"""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np
import pytest

from smallwheel_ros.simulate.sensors import MeasuredRows, Rows, lasting
from smallwheel_ros.simulate.vehicle import EPOCH, TICK, Truth
from smallwheel_ros.simulate.world import GRAVITY, ROVERS, Sensors, World

TIME = np.arange(0.0, 30.0, TICK)
SPEED = 0.3 + 0.1 * np.sin(0.5 * TIME)
SLIP = 0.2
CLIMB = 0.1 * np.sin(0.3 * TIME)


def truth() -> Truth:
    """A vehicle that speeds up and down on waves, straight on, with a slip of 0.2 and four unlike loads."""
    wheels = np.ones((TIME.size, 4))
    known: dict[str, Any] = {
        "time": TIME, "speed": SPEED, "path": np.cumsum(SPEED) * TICK, "climb": CLIMB,
        "place": np.cumsum(SPEED) * TICK,
        "rim": wheels * (SPEED / (1.0 - SLIP))[:, None], "slip": SLIP * wheels,
        "sinkage": wheels * (0.010 + 0.004 * np.sin(0.7 * TIME))[:, None],
        "load": wheels * np.array([50.0, 55.0, 60.0, 65.0]),
        "thrust": 12.0 * wheels, "resistance": 4.0 * wheels, "torque": 2.0 * wheels,
    }  # fmt: skip
    rest = {f.name: np.zeros(TIME.size) for f in fields(Truth) if f.name not in known}
    return Truth(**known | rest | {"stuck": None})


TRUTH = truth()


def shown(**sensors: Any) -> Rows:
    settings = {
        "noise_factor": 0.0,
        "lag": (0.0, 0.0),
        "noise": (0.0, 0.0),
        "encoder_steps": (10**7,),
    }
    world = World("by hand", speed=0.3, sensors=Sensors(**settings | sensors))
    return MeasuredRows(world, ROVERS["four"], TRUTH, np.random.default_rng(1)).rows()


def at(rows: Rows, stream: str) -> tuple[np.ndarray, np.ndarray]:
    """Seconds and values of a stream."""
    stamps, values = rows[stream]
    return (stamps - EPOCH) / 1e9, values


def test_each_stream_comes_at_its_rate_from_the_begin_to_the_end() -> None:
    rows = shown(torque=True, pull=True, imu="level", load_rate=25.0, sinkage_rate=5.0)
    rates = {
        "load": 25.0,
        "sinkage": 5.0,
        "drawbar_pull": 25.0,
        "wheel_speed": 20.0,
        "torque": 20.0,
    }
    for name, rate in rates.items():
        for wheel in ROVERS["four"].wheels:
            time, _ = at(rows, f"{wheel.name}/{name}")
            assert np.diff(time) == pytest.approx(1.0 / rate, abs=1e-6)
            assert 0.0 <= time[0] < 1.0 / rate
            assert TIME[-1] - 3.0 / rate <= time[-1] <= TIME[-1]
    assert {"odom", "imu"} < set(rows)
    none = shown(load=False, sinkage=False, imu="")
    assert sorted(none) == sorted(
        ["odom", *(f"{w.name}/wheel_speed" for w in ROVERS["four"].wheels)]
    )


def test_without_a_fault_each_shows_what_is_true() -> None:
    rows = shown(torque=True, pull=True, friction=0.0)
    for j, wheel in enumerate(ROVERS["four"].wheels):
        assert at(rows, f"{wheel.name}/load")[1] == pytest.approx(50.0 + 5.0 * j)
        time, values = at(rows, f"{wheel.name}/sinkage")
        assert values[:, 0] == pytest.approx(np.interp(time, TIME, TRUTH.sinkage[:, j]))
        # No instrument claims to be perfect: a tenth of its noise.
        assert values[:, 1] == pytest.approx((0.1 * 5e-4) ** 2)
        assert at(rows, f"{wheel.name}/drawbar_pull")[1] == pytest.approx(8.0)
        assert at(rows, f"{wheel.name}/torque")[1] == pytest.approx(2.0)
        time, values = at(rows, f"{wheel.name}/wheel_speed")
        rim = np.interp(time, TIME, SPEED) / (1.0 - SLIP)
        assert 0.125 * values[1:, 0] == pytest.approx(rim[1:], abs=0.006)  # of the step before
    time, values = at(rows, "odom")
    assert values[:, 0] == pytest.approx(np.interp(time, TIME, SPEED))
    assert values[:, 2] == pytest.approx(np.interp(time, TIME, TRUTH.path), abs=0.03)
    assert not values[:, [1, 3, 5, 6, 8, 9]].any()
    assert values[:, 7] == pytest.approx(0.005**2)
    time, values = at(rows, "imu")
    climb = np.interp(time, TIME, CLIMB)
    assert values[:, 4:7] == pytest.approx(
        np.stack([np.sin(climb), 0.0 * climb, np.cos(climb)], axis=1)
    )
    gained = np.interp(time, TIME, np.gradient(SPEED, TIME))
    assert values[:, 1] == pytest.approx(GRAVITY * np.sin(climb) + gained)
    assert values[:, 3] == pytest.approx(GRAVITY * np.cos(climb))


@pytest.mark.parametrize(
    ("fault", "expected"),
    [
        ({"gain": 1.2}, lambda t, z: 1.2 * z),
        ({"zero": 0.002}, lambda t, z: z + 0.002),
        ({"zero_drift": 0.003}, lambda t, z: z + 0.003 * t / TIME[-1]),
        ({"delay": 0.5}, lambda t, z: np.interp(t - 0.5, TIME, TRUTH.sinkage[:, 0])),
        ({"step": 0.001}, lambda t, z: np.round(z, 3)),
        ({"pitch_error": 0.05}, lambda t, z: z - 0.05 * np.interp(t, TIME, CLIMB)),
        # 1e-7 m/Pa under 50 N on 100 mm times the chord.
        ({"rebound": 1e-7}, lambda t, z: z - 1e-7 * 50.0 / (0.1 * np.sqrt(0.25 * z))),
    ],
)  # fmt: skip
def test_a_fault_of_the_sinkage_is_as_large_as_it_is_given(
    fault: dict[str, float], expected: Any
) -> None:
    time, values = at(shown(**fault), "front_left/sinkage")
    true = np.interp(time, TIME, TRUTH.sinkage[:, 0])
    assert values[:, 0] == pytest.approx(expected(time, true), abs=1e-6)


def test_outliers_are_several_times_the_truth_and_marked() -> None:
    world = World("by hand", sensors=Sensors(noise_factor=0.0, outliers=0.3))
    made = MeasuredRows(world, ROVERS["four"], TRUTH, np.random.default_rng(1))
    time, values = at(made.rows(), "front_left/sinkage")
    true, wild = np.interp(time, TIME, TRUTH.sinkage[:, 0]), made.outliers["front_left"]
    assert wild.mean() == pytest.approx(0.3, abs=0.1)
    assert values[~wild, 0] == pytest.approx(true[~wild])
    assert (values[wild, 0] >= 2.0 * true[wild]).all()
    assert (values[wild, 0] <= 5.0 * true[wild] + 0.02).all()


def test_loads_have_their_scale_and_tare_and_torques_their_friction() -> None:
    rows = shown(load_scale=(1.1, 1.0, 1.0, 1.0), tare=3.0, torque=True, friction=0.5)
    assert at(rows, "front_left/load")[1] == pytest.approx(58.0)
    assert at(rows, "front_right/load")[1] == pytest.approx(58.0)
    assert at(shown(tare=-100.0), "front_left/load")[1] == pytest.approx(
        0.1
    )  # none pulls at its cell
    assert at(rows, "front_left/torque")[1] == pytest.approx(2.5)


def test_odometries_see_the_ground_the_wheels_or_half_of_both() -> None:
    rim = 1.0 / (1.0 - SLIP)
    for kind, factor in (("own", 1.0), ("wheels", rim), ("pose", 0.0)):
        time, values = at(shown(odometry=kind), "odom")
        assert values[5:, 0] == pytest.approx(
            factor * np.interp(time, TIME, SPEED)[5:], abs=0.01
        ), kind
    for kind, factor in (("half", 0.5 * (1.0 + rim)), ("filter", rim)):
        time, values = at(shown(odometry=kind), "odom")
        ratio = values[100:, 0] / np.interp(time, TIME, SPEED)[100:]
        assert np.median(ratio) == pytest.approx(factor, abs=0.03), kind
    assert at(shown(odometry="pose"), "odom")[1][-1, 2] == pytest.approx(TRUTH.path[-1], rel=0.01)
    time, values = at(shown(lag=(0.4, 0.4), noise=(0.02, 0.02), told=2.0, pitch=True), "odom")
    assert values[:, 6] == pytest.approx((2.0 * 0.02) ** 2)
    assert values[:, 8] == pytest.approx(-np.interp(time, TIME, CLIMB))
    smoothed = 0.3 + 0.1 * np.sin(0.5 * (time - 0.8))  # late by 0.4 s, and a mean over as much
    assert values[100:, 0] == pytest.approx(smoothed[100:], abs=0.006)


def test_a_driven_imu_tells_no_orientation_and_a_current_no_sign() -> None:
    assert np.isnan(at(shown(imu="driven"), "imu")[1][:, 4:7]).all()
    backward = Truth(**{f.name: getattr(TRUTH, f.name) for f in fields(Truth)} | {
        "torque": -TRUTH.torque, "rim": np.where(TIME[:, None] < 15.0, TRUTH.rim, 0.0)})  # fmt: skip
    sensors = Sensors(noise_factor=0.0, torque=True, current=True, friction=0.0)
    made = MeasuredRows(
        World("w", sensors=sensors), ROVERS["four"], backward, np.random.default_rng(1)
    )
    time, values = at(made.rows(), "front_left/torque")
    assert values[time < 14.9] == pytest.approx(2.0)
    assert not values[time > 15.1].any()


@pytest.mark.parametrize("keep", [0.0, 0.5, 0.95])
def test_errors_that_last_have_deviation_1_and_that_correlation(keep: float) -> None:
    rng = np.random.default_rng(3)
    made = lasting(rng.standard_normal, 40_000, keep)
    assert np.std(made) == pytest.approx(1.0, abs=0.05)
    assert np.corrcoef(made[1:], made[:-1])[0, 1] == pytest.approx(keep, abs=0.02)
    assert np.std([lasting(rng.standard_normal, 1, keep)[0] for _ in range(2000)]) == pytest.approx(
        1.0, abs=0.06
    )
    assert lasting(rng.standard_normal, 0, keep).size == 0
