# SPDX-License-Identifier: Apache-2.0
"""Whole drives through the pipeline: what is answered, when, how rightly, and what lacks or comes late.

Tests `pipeline.py` and `refused.py`.
"""

from __future__ import annotations

import math
from dataclasses import fields, replace

import numpy as np
import pytest
from rows_of_drives import SECOND, START, Row, give, rover_of, rows_of, run

from smallwheel_ros.onboard.parameters import settings_from
from smallwheel_ros.pipeline.mobility.status import Status
from smallwheel_ros.pipeline.pipeline import Pipeline
from smallwheel_ros.pipeline.tables import Estimates, Readings
from smallwheel_ros.simulate import Drive, DriveSettings, simulate_drive
from smallwheel_ros.simulate.vehicle import EPOCH

EVERY = {"mobility.rate": 0.0}
ONE = {"wheels": ["w"], "w.diameter": 0.25, "w.width": 0.1}


@pytest.fixture(scope="module")
def drive() -> Drive:
    return simulate_drive(DriveSettings(seed=7, distance=8.0, wheels="two_sizes", terrain="single"))


@pytest.fixture(scope="module")
def rows(drive: Drive) -> list[Row]:
    return rows_of(drive)


@pytest.fixture(scope="module")
def whole(drive: Drive, rows: list[Row]) -> tuple[Pipeline, Readings, Estimates]:
    pipeline = Pipeline(rover_of(drive, **EVERY).onboard)
    return pipeline, *driven(pipeline, rows)


def driven(pipeline: Pipeline, rows: list[Row], block: int = 500) -> tuple[Readings, Estimates]:
    """Rows and estimates, with a turn each so many rows."""
    turns = []
    for begin in range(0, len(rows), block):
        give(pipeline.streams, rows[begin : begin + block])
        turns += list(pipeline.turns())
    turns += list(pipeline.turns(last=True))
    estimates = Estimates.joined([turn.estimates for turn in turns])
    return Readings.joined([turn.readings for turn in turns]), estimates


def same(one: Estimates, other: Estimates, **tolerances: float) -> None:
    """Whatever is said of the same instants, but for the numbers of versions."""
    assert len(one) == len(other)
    for field in fields(one):
        if field.name not in ("law", "strength"):
            a, b = getattr(one, field.name), getattr(other, field.name)
            np.testing.assert_allclose(
                a, b, **({"rtol": 1e-9, "atol": 1e-9} | tolerances), err_msg=field.name
            )


def test_each_sinkage_is_answered_once_in_order(
    drive: Drive, whole: tuple[Pipeline, Readings, Estimates]
) -> None:
    _, _, made = whole
    for number, wheel in enumerate(drive.rover.wheels):
        stamps = made.stamp[made.wheel == number]
        assert stamps.tolist() == drive.rows[f"{wheel.name}/sinkage"][0].tolist()
    assert (np.diff(made.stamp) >= 0).all()


def test_no_number_is_infinite_and_what_is_told_is_known(
    whole: tuple[Pipeline, Readings, Estimates],
) -> None:
    _, _, made = whole
    for field in fields(made):
        assert not np.isinf(getattr(made, field.name).astype(float)).any(), field.name
    late = (made.distance > 2.0) & np.isfinite(made.slip)
    assert late.mean() > 0.5
    for name in ("sinkage", "drawbar_pull", "margin", "energy", "rolling_resistance_coefficient"):
        for column in (name, f"{name}_std"):
            assert np.isfinite(getattr(made, column)[late]).mean() > 0.95, column


def test_it_finds_what_is_true(drive: Drive, whole: tuple[Pipeline, Readings, Estimates]) -> None:
    pipeline, rows, made = whole
    soil, true = pipeline.soil, drive.stretches[0].soil
    log_pressure = math.log(true.k * 0.01**true.n * 0.2**true.m)
    deviation = math.sqrt(soil.log_covariance[0, 0])
    assert abs(soil.log_pressure - log_pressure) < 3 * deviation
    assert deviation < 0.21  # of it 0.05 (n + 1/2) is the scale of the sinkage sensors
    assert abs(soil.n - true.n) < 3 * math.sqrt(soil.covariance[1, 1])
    assert abs(soil.m - true.m) < 3 * math.sqrt(soil.covariance[2, 2])
    assert 7.75 < soil.distance < 8.1  # the last of its stretches of 0.25 m may be open
    late = made.take(slice(len(made) // 2, None))
    error = (late.sinkage_measured - late.sinkage)[late.status != Status.REJECTED]
    assert np.sqrt(np.nanmean(error**2)) < 0.0012
    truth = drive.truth
    time = (rows.stamp - EPOCH) / SECOND
    moves = np.interp(time, truth.time, truth.speed) >= 0.2
    slips = [np.interp(time, truth.time, of_wheel) for of_wheel in np.nan_to_num(truth.slip).T]
    true_slip = np.array(slips)[rows.wheel, np.arange(len(rows))]
    # 8 mm/s of noise at 0.2 m/s and more, and slip that changes between messages
    assert (np.abs(rows.slip - true_slip)[moves] < 0.2).all()
    assert moves.sum() > 100


def test_a_wheel_that_stands_has_no_slip_and_says_so(
    whole: tuple[Pipeline, Readings, Estimates],
) -> None:
    _, _, made = whole
    first = made.take(slice(0, 4))
    assert np.isnan(first.slip).all()
    assert (first.status == Status.SLIP_UNKNOWN).all()
    assert np.isnan(first.drawbar_pull).all()
    assert np.isfinite(first.sinkage).all()


@pytest.mark.parametrize("burst", [pytest.param(0.0, marks=pytest.mark.slow), 0.8])
def test_order_of_arrival_does_not_matter(
    drive: Drive, whole: tuple[Pipeline, Readings, Estimates], burst: float
) -> None:
    """Streams late by up to 0.1 s, or loads by 0.8 s, as from a queue that is served too seldom."""
    rng = np.random.default_rng(3)
    delays: dict[str, float] = {}

    def late(name: str) -> float:
        if burst:
            return burst if name.endswith("load") else 0.0
        return delays.setdefault(name, rng.uniform(0.0, 0.1))

    moved = rows_of(drive, late)
    assert [row[1] for row in moved] != [row[1] for row in rows_of(drive)]
    pipeline = Pipeline(rover_of(drive, **EVERY).onboard)
    _, made = driven(pipeline, moved, 50)
    same(made, whole[2])


def test_a_looping_bag_starts_over(drive: Drive, rows: list[Row]) -> None:
    pipeline = Pipeline(rover_of(drive).onboard)
    plain = [(*row[:3], None) for row in rows]
    turns = []
    for _ in range(2):
        for begin in range(0, len(plain), 500):
            give(pipeline.streams, plain[begin : begin + 500])
            turns += list(pipeline.turns())
    turns += list(pipeline.turns(last=True))
    assert pipeline.time_jumps == 1
    begin, again = (i for i, turn in enumerate(turns) if turn.starts_over)
    assert begin == 0
    first, second = (
        Estimates.joined([turn.estimates for turn in part])
        for part in (turns[:again], turns[again:])
    )
    # Without a clock the first message back is not believed.
    assert 0 <= len(first) - len(second) <= 8
    both = first.stamp[-1], first.margin[-1], first.sinkage[-1]
    assert (second.stamp[-1], second.margin[-1], second.sinkage[-1]) == pytest.approx(
        both, rel=0.02
    )
    (text,) = [p.text for p in pipeline.take_problems() if p.reason == "time_jump"]
    assert "time went back by" in text


def test_soils_of_a_time_that_is_over_are_told(drive: Drive, rows: list[Row]) -> None:
    pipeline = Pipeline(rover_of(drive, **EVERY).onboard)
    give(pipeline.streams, rows)
    give(
        pipeline.streams, rows[: len(rows) // 8]
    )  # the loop begins anew before a turn is asked for
    accepted = []
    for turn in pipeline.turns(last=True):
        accepted.append([pipeline.soil_at(v).accepted for v in np.unique(turn.version).tolist()])
    over, again = accepted
    assert over == sorted(over)
    assert len(over) > len(again)
    assert over[-1] > 4 * pipeline.soil.accepted


def test_a_load_that_drops_out_is_named_and_survived(drive: Drive, rows: list[Row]) -> None:
    start = rows[0][1] + 4 * SECOND
    kept = [
        row
        for row in rows
        if row[0] != "front_left/load" or not start < row[1] < start + 3 * SECOND
    ]
    pipeline = Pipeline(rover_of(drive, **EVERY).onboard)
    _, made = driven(pipeline, kept)
    assert len(made) == sum(
        len(of[0]) for name, of in drive.rows.items() if name.endswith("/sinkage")
    )
    missing = made.status == Status.LOAD_MISSING
    assert missing.sum() > 20
    assert (made.wheel[missing] == 0).all()
    for name in ("load", "sinkage", "compaction_resistance", "drawbar_pull"):
        assert np.isnan(getattr(made, name)[missing]).all(), name
    assert np.isfinite(made.margin).all()


def test_a_wheel_without_sinkage_sensor_is_predicted(drive: Drive, rows: list[Row]) -> None:
    settings = rover_of(drive, **{"rear_left.sinkage_topic": ""})
    pipeline = Pipeline(settings.onboard)
    assert "rear_left/sinkage" not in pipeline.streams.all
    _, made = driven(pipeline, [row for row in rows if row[0] != "rear_left/sinkage"])
    mine = made.take(made.wheel == 2)
    assert len(mine) == pytest.approx(10 * (rows[-1][1] - rows[0][1]) / SECOND, rel=0.2)
    assert np.isnan(mine.sinkage_measured).all()
    assert np.isfinite(mine.sinkage[5:]).all()
    half, true = mine.take(slice(len(mine) // 2, None)), drive.truth
    expected = np.interp((half.stamp - EPOCH) / SECOND, true.time, true.sinkage[:, 2])
    # 6 % scatter of k along the track, on 6 mm
    assert np.sqrt(np.mean((half.sinkage - expected) ** 2)) < 0.1 * np.mean(expected)


def test_estimates_at_a_rate_say_what_those_of_every_reading_do(
    drive: Drive, rows: list[Row], whole: tuple[Pipeline, Readings, Estimates]
) -> None:
    _, some = driven(Pipeline(rover_of(drive, **{"mobility.rate": 2.0}).onboard), rows)
    _, _, every = whole
    at = {key: i for i, key in enumerate(zip(every.stamp, every.wheel, strict=True))}
    chosen = [at[key] for key in zip(some.stamp, some.wheel, strict=True)]
    same(some, replace(every.take(np.array(chosen)), rejected=some.rejected), rtol=1e-6)
    for number in range(4):
        stamps = some.stamp[some.wheel == number] / SECOND
        assert np.diff(stamps).min() >= 0.25  # half a period of slack
        assert len(stamps) == pytest.approx(2.0 * np.ptp(stamps), abs=3)


def test_a_sensor_of_the_rate_itself_loses_none_by_its_jitter() -> None:
    pressed = settings_from(ONE | {"w.contact": "pressed", "mobility.rate": 10.0})
    rng = np.random.default_rng(5)
    rows: list[Row] = []
    for i in range(1, 200):
        stamp = START + round((0.1 * i + rng.uniform(-0.02, 0.02)) * SECOND)
        rows += [("w/load", stamp, (5.0 * i,), None), ("w/sinkage", stamp, (1e-4 * i, 1e-8), None)]
    _, made = run(pressed, rows)
    assert made is not None
    assert len(made) == 199


def test_a_pressed_wheel_needs_neither_odometry_nor_wheel_speed() -> None:
    pressed = settings_from({**ONE, "w.contact": "pressed", **EVERY})
    assert pressed.onboard.streams == ("w/load", "w/sinkage")
    rows: list[Row] = []
    for i in range(1, 300):
        stamp, depth = START + i * SECOND // 20, 0.0003 * i
        rows += [("w/load", stamp, (200.0 * depth / 0.01,), None)]
        rows += [("w/sinkage", stamp, (depth, 1e-8), None)]
    pipeline = Pipeline(pressed.onboard)
    found, made = run(pressed, rows, pipeline=pipeline)
    assert made is not None
    assert len(made) == 299
    assert pipeline.soil.accepted > 10
    # new soil is met by going deeper: that is the travel
    assert found.distance[-1] == pytest.approx(0.0003 * 299)
    assert np.isnan(made.slip).all()
    assert (made.status != Status.SLIP_UNKNOWN).all()
    assert (made.compaction_resistance == 0.0).all()


def test_a_wheel_that_turns_on_the_spot_travels_and_the_vehicle_does_not() -> None:
    """R5."""
    turning = settings_from({**ONE, "w.lateral_position": 0.3, **EVERY})
    rng = np.random.default_rng(1)
    rows: list[Row] = []
    for i in range(600):
        stamp = START + i * SECOND // 50
        noise, turned = 1e-3 * math.sin(i), 0.8 * i / 50
        pose = noise, 0.0, math.cos(turned), math.sin(turned)
        rows += [("odom", stamp, (noise, 0.8, *pose, 0.0, 0.0, 0.0, 0.0), None)]
        rows += [("w/wheel_speed", stamp, (-0.24 / 0.125,), None), ("w/load", stamp, (60.0,), None)]
        shown = 0.01 + 5e-4 * float(rng.standard_normal())
        rows += [("w/sinkage", stamp, (shown, 0.0), None)]
    pipeline = Pipeline(turning.onboard)
    found, _ = run(turning, rows, pipeline=pipeline)
    assert found.distance[-1] == 0.0
    assert found.path[-1] == pytest.approx(0.24 * 12.0, rel=0.05)
    assert pipeline.soil.accepted > 4 * 40  # of 13 stretches of 0.2 m at most eight wait
    assert found.slip[-1] == pytest.approx(0.0, abs=0.01)


def test_odometry_that_was_away_for_long_does_not_stop_the_path() -> None:
    rows: list[Row] = []
    for i in range(400):
        away = 10 * SECOND if i >= 200 else 0
        stamp, x = START + i * SECOND // 20 + away, 0.02 * i + (4.0 if away else 0.0)
        rows += [("odom", stamp, (0.4, 0.0, x, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0), stamp)]
        turning = 0.4 * (1.0 + 0.1 * math.sin(0.07 * i)) / 0.9 / 0.125
        rows += [("w/wheel_speed", stamp, (turning,), stamp), ("w/load", stamp, (60.0,), stamp)]
        rows += [("w/sinkage", stamp, (0.01 + 1e-5 * (i % 7), 1e-6), stamp)]
    found, _ = run(settings_from(ONE), rows)
    assert found.distance[-1] == pytest.approx(12.0, rel=0.03)


def test_too_heavy_a_load_is_sunk_to_the_axle() -> None:
    vehicle = settings_from({**ONE, **EVERY})
    rows: list[Row] = []
    for i in range(60):
        stamp, speed = START + i * SECOND // 20, 0.4 + 0.03 * math.sin(0.3 * i)
        rows += [("odom", stamp, (0.4, 0.0, 0.02 * i, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0), stamp)]
        rows += [
            ("w/wheel_speed", stamp, (speed / 0.125,), stamp),
            ("w/load", stamp, (1e7,), stamp),
        ]
        rows += [("w/sinkage", stamp, (0.125, 0.0), stamp)]  # that of the axle
    _, made = run(vehicle, rows)
    assert (made.status[20:] == Status.SUNK_TO_AXLE).all()  # before, the soil is any
    for name in ("sinkage", "compaction_resistance", "drawbar_pull"):
        assert np.isnan(getattr(made, name)).all(), name


@pytest.mark.parametrize("variance", [0.0, -1.0, math.nan, math.inf])
def test_a_variance_that_is_not_known_is_the_parameters(variance: float) -> None:
    vehicle = settings_from({**ONE, "noise.sinkage": 0.0023})
    rows = [("w/load", START, (60.0,), None), ("w/sinkage", START, (0.01, variance), None)]
    found, _ = run(vehicle, rows)
    assert found.sinkage_std.tolist() == [0.0023]


def test_readings_below_zero_are_used() -> None:
    """On firm ground half of them are; that a sensor's zero is far off is for the checks."""
    vehicle = settings_from({**ONE, **EVERY})
    pipeline = Pipeline(vehicle.onboard)
    rows: list[Row] = []
    for i in range(400):
        stamp, speed = START + i * SECOND // 20, 0.4 + 0.03 * math.sin(0.3 * i)
        rows += [("odom", stamp, (0.36, 0.0, 0.018 * i, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0), stamp)]
        rows += [
            ("w/wheel_speed", stamp, (speed / 0.125,), stamp),
            ("w/load", stamp, (60.0,), stamp),
        ]
        rows += [("w/sinkage", stamp, (3e-4 + 1e-3 * math.sin(i), 0.0), stamp)]
    _, made = run(vehicle, rows, pipeline=pipeline)
    assert (made.sinkage_measured < 0.0).mean() > 0.3
    assert pipeline.accepted > 200
    assert pipeline.rejected < 10
    assert (made.sinkage[200:] > 0.0).all()
