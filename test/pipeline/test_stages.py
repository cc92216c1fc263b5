# SPDX-License-Identifier: Apache-2.0
"""The contract of `check_stage.py`, kept by each stage alone."""

from __future__ import annotations

from dataclasses import replace
from functools import cache, partial

import numpy as np
import pytest
from check_stage import (
    STAGES,
    assert_numbers,
    believed_of,
    check_cuts,
    check_numbers,
    halves,
    last_of,
    one_wheel,
    streams_of,
    with_zeros,
    without,
)
from hypothesis import given, settings
from hypothesis import strategies as st
from rows_of_drives import START, drive, rover, static_rover

from smallwheel_ros.common.stamps import SECOND
from smallwheel_ros.onboard.settings import IMU, ODOMETRY, OnboardSettings
from smallwheel_ros.pipeline.checks.believed import BelievedRows, RawRows
from smallwheel_ros.pipeline.checks.doubts import Doubted
from smallwheel_ros.pipeline.checks.sensor_checks import SensorChecks

MIDDLE = START + 5 * SECOND
SPEED = "fl/wheel_speed"
# Columns of tables that are derived of a stream; all others stay as they are where it is doubted.
DERIVED = {
    ODOMETRY: {"vehicle_speed", "speed", "slip", "slip_std", "x", "y", "heading", "gained"},
    IMU: {"slope", "across", "vertical"},
    SPEED: {"rim_speed", "rim_std", "slip", "slip_std"},
    "fl/load": {"load", "load_std"},
    "fl/sinkage": {"sinkage"},
}


def vehicle(**parameters: object) -> OnboardSettings:
    return rover(**{"twist.publish": True, **parameters}).onboard


@cache
def believed() -> BelievedRows:
    """What is believed of a drive that stops, turns and starts again."""
    rows = drive(
        10.0,
        speed=lambda t: np.where((t > 1.0) & ((t < 6.0) | (t > 7.0)), 0.4, 0.0),
        turn=lambda t: 0.2 * np.sin(t),
        oriented=True,
    )
    own = vehicle()
    return believed_of(streams_of(rows, own), own)


# Drives that all stages are shown: each once.
lacking = cache(lambda stream, column: without(believed(), stream, column))
zeros_of = cache(
    lambda kinds: with_zeros(believed(), [one for one in believed().streams if one.endswith(kinds)])
)


@cache
def doubted_from_the_middle(stream: str) -> BelievedRows:
    """The drive with a stream that is doubted from its middle on."""
    return replace(believed(), doubted=Doubted((MIDDLE,), (frozenset(), frozenset({stream}))))


@pytest.mark.parametrize("name", STAGES)
@settings(max_examples=4)
@given(cuts=st.lists(st.floats(0.0, 10.0), min_size=1, max_size=6))
def test_cuts_do_not_matter(name: str, cuts: list[float]) -> None:
    done = believed().done
    ends = [START + round(cut * SECOND) for cut in cuts]
    check_cuts(STAGES[name], believed(), [end for end in ends if end < done])


# Ten columns of odometry and imu through whole chains take seconds each: two chains of them are fast tests.
LONG_CHAINS = [name for name in STAGES if name in ("steps", "strengths", "vehicle", "twist")]


@pytest.mark.parametrize(
    ("stream", "name"),
    [
        pytest.param(
            stream,
            name,
            marks=pytest.mark.slow if stream in (ODOMETRY, IMU) and name in LONG_CHAINS else (),
        )
        for stream in (ODOMETRY, IMU, SPEED, "fl/load", "fl/sinkage")
        for name in STAGES
    ],
)
def test_what_is_not_known_is_not_a_number_and_no_error(name: str, stream: str) -> None:
    for column in range(believed().streams[stream].values.shape[1]):
        check_numbers(STAGES[name], partial(lacking, stream, column))


@pytest.mark.parametrize("name", STAGES)
@pytest.mark.parametrize(
    "kinds", ["wheel_speed", "odom", "imu", "load", "sinkage", "l/wheel_speed", ""]
)
def test_exact_zeros_divide_nothing(name: str, kinds: str) -> None:
    check_numbers(STAGES[name], partial(zeros_of, kinds))


@pytest.mark.parametrize("name", [name for name in STAGES if name != "twist"])
def test_one_wheel_is_a_vehicle(name: str) -> None:
    own = one_wheel()
    rows = [row for row in drive(6.0) if row[0] in own.streams]
    found = STAGES[name].whole(believed_of(streams_of(rows, own), own))
    assert found is not None
    assert_numbers(found)


@pytest.mark.parametrize("stream", DERIVED)
def test_a_doubt_reaches_what_is_derived_from_its_stamp_on_and_nothing_before(stream: str) -> None:
    doubted = doubted_from_the_middle(stream)
    good, found = (STAGES["align"].whole(one) for one in (believed(), doubted))
    assert good is not None
    assert found is not None
    (before, after), (now_before, now_after) = (
        halves(table, MIDDLE, rows) for table, rows in ((good, believed()), (found, doubted))
    )
    for column in before:
        np.testing.assert_array_equal(now_before[column], before[column], err_msg=column)
    own = (
        now_after["wheel"] == 0
        if stream.startswith("fl/")
        else np.ones(now_after["wheel"].size, bool)
    )
    for column in DERIVED[stream]:
        known = np.isfinite(after[column][own])
        assert known.any(), column
        assert np.isnan(now_after[column][own][known]).all(), column
        # What the rims of all change by is in each one's deviation.
        few = 0.1 if column == "slip_std" else 0.0
        np.testing.assert_allclose(
            now_after[column][~own], after[column][~own], rtol=few, atol=few, err_msg=column
        )


@pytest.mark.parametrize("stage", STAGES)
@pytest.mark.parametrize("stream", [ODOMETRY, IMU, SPEED, "fl/load", "fl/sinkage"])
def test_before_a_doubt_no_stage_knows_of_it(stage: str, stream: str) -> None:
    """Of a drive in which a stream is doubted midway, all up to there is as without the doubt."""
    doubted = doubted_from_the_middle(stream)
    good, found = (STAGES[stage].whole(one) for one in (believed(), doubted))
    assert good is not None
    assert found is not None
    (before, _), (now_before, _) = (
        halves(table, MIDDLE, rows) for table, rows in ((good, believed()), (found, doubted))
    )
    assert next(iter(before.values())).size
    for column, values in before.items():
        np.testing.assert_array_equal(now_before[column], values, err_msg=column)


@settings(max_examples=5, deadline=None)
@given(cuts=st.lists(st.floats(0.0, 10.0), max_size=6))
def test_checks_learn_the_same_wherever_rows_are_cut(cuts: list[float]) -> None:
    """Their tables: what is learnt of the speed, which doubts there are, what is reported."""
    streams, own = believed().streams, believed().settings
    last = last_of(dict(streams))
    checks, findings = SensorChecks(own), []
    for end in sorted({*(START + round(cut * SECOND) for cut in cuts), last}):
        found = checks.take(RawRows(streams, min(end, last)))
        findings += checks.findings
    whole = SensorChecks(own)
    asked = whole.take(RawRows(streams, last))
    assert findings == list(whole.findings)
    assert found.doubted.streams[-1] == asked.doubted.streams[-1]
    np.testing.assert_array_equal(found.trusted.values[-1], asked.trusted.values[-1])


def test_checks_of_nothing_believe_nothing() -> None:
    own = static_rover().onboard
    empty = {
        name: rows.__class__(rows.stamps[:0], rows.values[:0])
        for name, rows in believed().streams.items()
    }
    streams = {name: empty[name] for name in own.streams}
    found = SensorChecks(own).take(RawRows(streams, START))
    assert STAGES["align"].whole(found) is None
    assert np.isnan(found.speeds(np.array([START]))).all()
