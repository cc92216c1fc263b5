# SPDX-License-Identifier: Apache-2.0
"""Which messages are believed, what is said of others, and that nothing else is lost with them.

Tests `buffer.py`, `layout.py` and `plausible.py`.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from rows_of_drives import SECOND, START, Row, drive, give, rover, run, streams_of

from smallwheel_ros.pipeline.intake.streams import Streams
from smallwheel_ros.pipeline.pipeline import Pipeline

ODOM = (0.3, 0.0, 1.0, 2.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0)
IMU = (0.0, 0.1, 0.0, 9.8, *[math.nan] * 4)


def _heard() -> Streams:
    """Streams that have heard 2 s of a drive with a clock."""
    streams = streams_of(rover())
    give(streams, drive(2.0))
    assert not streams.problems
    return streams


@pytest.mark.parametrize(
    ("name", "after", "values", "now_after", "reason", "words"),
    [
        ("odom", 0.1, (math.nan, *ODOM[1:]), 0.1, "not_finite", "speed is nan"),
        ("odom", 0.1, (1e300, *ODOM[1:]), 0.1, "not_plausible", "speed is 1e"),
        ("odom", 0.1, (0.3, math.nan, *ODOM[2:]), 0.1, "not_finite", "yaw rate"),
        ("odom", 0.1, (0.3, 0.0, 1e300, *ODOM[3:]), 0.1, "not_plausible", "x is"),
        ("odom", 0.1, (11.0, *ODOM[1:]), 0.1, "not_plausible", "expected at most 10"),
        ("imu", 0.1, (0.0, 1e300, *IMU[2:]), 0.1, "not_plausible", "feels"),
        ("imu", 0.1, (0.0, *[math.nan] * 7), 0.1, "not_finite", "feels nan"),
        ("imu", 0.1, (math.inf, *IMU[1:]), 0.1, "not_finite", "feels inf"),
        ("fl/load", 0.1, (math.inf,), 0.1, "not_finite", "load is inf"),
        ("fl/sinkage", 0.1, (math.nan, 0.0), 0.1, "not_finite", "sinkage is nan"),
        ("fl/wheel_speed", 0.1, (-1e12,), 0.1, "not_plausible", "wheel_speed"),
        ("odom", 0.1, ODOM, -1.0, "stamp_in_future", "clocks synchronised"),
        ("odom", 0.1, ODOM, 6.0, "stamp_too_old", "use_sim_time"),
        ("odom", -0.5, ODOM, 0.1, "out_of_order", "those of one topic have to come in order"),
        ("odom", -1.5, ODOM, 0.1, "out_of_order", "s before that of the message before"),
        ("odom", -1e10, ODOM, 0.0, "stamp_zero", "must stamp"),
    ],
)
def test_a_message_that_is_refused_is_counted_and_said(
    name: str,
    after: float,
    values: tuple[float, ...],
    now_after: float,
    reason: str,
    words: str,
) -> None:
    streams = _heard()
    latest, watermark = streams.latest, streams.watermark
    newest = streams.all[name].newest
    streams.add(name, latest + round(after * SECOND), values, latest + round(now_after * SECOND))
    assert streams.problems == {(name, reason): 1}
    assert words in streams.words[name, reason]
    assert (streams.latest, streams.watermark) == (latest, watermark)
    assert streams.all[name].newest == newest


def test_a_topic_that_was_silent_comes_too_late_by_its_parameter() -> None:
    streams = _heard()
    newest = streams.all["imu"].newest
    for _ in range(40):  # 4 s of the odometry alone
        streams.add("odom", streams.latest + SECOND // 10, ODOM)
    streams.add("imu", newest + 33 * SECOND // 10, IMU)
    assert streams.problems == {("imu", "late"): 1}
    assert "timing.reorder_time" in streams.words["imu", "late"]


def test_the_same_stamp_twice_is_said_to_be_two_publishers() -> None:
    streams = _heard()
    newest = streams.all["odom"].newest
    streams.add("odom", newest, ODOM, newest)
    assert "more than one publisher" in streams.words["odom", "duplicate"]


@pytest.mark.parametrize("clock", [True, False])
@pytest.mark.parametrize("off", [-3.0, -1000.0, 1000.0])
def test_a_clock_that_is_wild_among_good_ones_resets_nothing(clock: bool, off: float) -> None:
    rows = [
        (name, stamp + round(off * SECOND) * (name == "fl/load"), values, now if clock else None)
        for name, stamp, values, now in drive(8.0)
    ]
    if not clock:  # it begins later, so that the others' time is known
        rows = [row for i, row in enumerate(rows) if row[0] != "fl/load" or i > 100]
    pipeline = Pipeline(rover().onboard)
    readings, _ = run(rover(), rows, range(0, len(rows), 200), pipeline=pipeline)
    assert pipeline.time_jumps == 0
    good = [row for row in rows if row[0] != "fl/load"]
    for name in {row[0] for row in good}:
        assert not any(stream == name for stream, _ in pipeline.streams.problems)
    others = readings.wheel != 0
    assert np.isfinite(readings.load[others]).mean() > 0.97
    assert np.isnan(readings.load[~others]).all()


@pytest.mark.parametrize("clock", [True, False])
def test_time_that_goes_back_begins_anew_and_nothing_of_before_is_lost(clock: bool) -> None:
    once = [(*row[:3], row[3] if clock else None) for row in drive(6.0)]
    pipeline = Pipeline(rover().onboard)
    first, _ = run(rover(), once)
    both, _ = run(rover(), [*once, *once], [len(once) + 3000], pipeline=pipeline)
    assert pipeline.time_jumps == 1
    assert len(both) >= 2 * len(first) - 4  # without a clock the first message back is not believed
    np.testing.assert_allclose(both.path[: len(first)], first.path)
    assert abs(both.path[len(first)]) < 1e-9
    reasons = {reason for _, reason in pipeline.streams.problems}
    assert "time_jump" in reasons
    assert any("starts over" in text for text in pipeline.streams.words.values())


def test_one_message_far_from_all_others_is_dropped() -> None:
    rows: list[Row] = [(*row[:3], None) for row in drive(4.0)]
    wild = [*rows]
    for i in (900, 1200):
        wild.insert(i, ("odom", START - 1000 * SECOND, ODOM, None))
    # One message of several joints is several rows of one stamp: they do not agree with each other.
    for name in ("fl", "fr", "rl"):
        wild.insert(1000, (f"{name}/wheel_speed", START + 1000 * SECOND, (1.0,), None))
    pipeline = Pipeline(rover().onboard)
    found, _ = run(rover(), wild, pipeline=pipeline)
    usual, _ = run(rover(), rows)
    assert pipeline.time_jumps == 0
    assert len(found) == len(usual)
    assert pipeline.streams.problems["odom", "far"] == 2


def test_a_silent_stream_is_not_waited_for() -> None:
    rows = drive(6.0)
    rows = [row for row in rows if row[0] != "fl/load" or row[1] < START + 2 * SECOND]
    streams = streams_of(rover())
    give(streams, rows)
    assert (streams.latest - streams.watermark) / SECOND == pytest.approx(0.4, abs=1e-9)


def test_a_slow_stream_is_interpolated_and_a_gap_in_a_quick_one_is_not() -> None:
    streams = streams_of(rover())
    for k in range(20):
        streams.add("odom", START + k * SECOND, (0.1 * k, *ODOM[1:]), None)
    for k in range(200):
        if not 100 <= k < 150:
            streams.add("fl/load", START + k * SECOND // 10, (50.0,), None)
    rules = streams.rules
    between = np.array([START + 12 * SECOND + SECOND // 2])
    assert streams.all["odom"].at(between, rules)[0, 0] == pytest.approx(1.25)
    assert np.isnan(streams.all["fl/load"].at(between, rules)).all()


def test_no_value_is_held_over_a_message_that_ended_it() -> None:
    streams = streams_of(rover())
    rim, tenth = streams.all["fl/wheel_speed"], SECOND // 10
    for k in (0, 1, 6, 7):
        streams.add("fl/wheel_speed", START + k * tenth, (float(k),), None)
    before = rim.at(START + np.array([15, 25]) * tenth // 10, streams.rules)[:, 0]
    assert before.tolist() == [1.0, 1.0]
    rim.end(START + np.array([2, 3, 4]) * tenth)
    assert rim.ends.tolist() == [START + 2 * tenth]  # the first is enough
    for samples in (rim, rim.samples):
        found = samples.at(START + np.array([5, 15, 25, 55, 65]) * tenth // 10, streams.rules)[:, 0]
        np.testing.assert_array_equal(found, [0.5, 1.0, np.nan, 6.0, 6.5])
    rim.clear()
    assert not rim.ends.size


def test_memory_is_bounded_parked_and_without_any_row() -> None:
    vehicle = rover()
    pipeline = Pipeline(vehicle.onboard)
    rows = [row for row in drive(4.0, speed=lambda t: 0.0 * t) if "sinkage" not in row[0]]
    sizes = []
    for k in range(20):
        later = [(n, s + k * 4 * SECOND, v, None) for n, s, v, _ in rows]
        for begin in range(0, len(later), 50):
            give(pipeline.streams, later[begin : begin + 50])
            assert not any(len(turn.readings) for turn in pipeline.turns())
        sizes.append(sum(stream.stamps.size for stream in pipeline.streams.all.values()))
    assert sizes[-1] <= 1.02 * sizes[4]
    ground = pipeline.checks.ground
    assert ground.moves.stamps.size < 1000
    assert ground.felt.stamps.size < 1000
