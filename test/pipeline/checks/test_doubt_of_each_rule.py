# SPDX-License-Identifier: Apache-2.0
"""Each rule of the table: what it doubts, and what becomes of all that is derived of that.

From the stamp of a doubt on, each column of `Aligned` that is derived of a doubted stream is unknown, or made
of what is left; nothing changes before it, nor in other columns; and where rows are cut does not matter.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest
from raw_drives import NAMES, START, Rows, drive, settings
from test_rules import FAULTS, LEFT

from smallwheel_ros.common.stamps import NEVER, SECOND
from smallwheel_ros.onboard.settings import IMU, ODOMETRY
from smallwheel_ros.physics.wheel import GRAVITY
from smallwheel_ros.pipeline.checks.believed import BelievedRows, RawRows
from smallwheel_ros.pipeline.checks.doubts import NO_DOUBT, SHOWS_NO_SLIP
from smallwheel_ros.pipeline.checks.rules import RULES, Finding
from smallwheel_ros.pipeline.checks.sensor_checks import SensorChecks
from smallwheel_ros.pipeline.intake.layout import rules_of, widths_of
from smallwheel_ros.pipeline.intake.streams import Streams
from smallwheel_ros.pipeline.rows.align import Align
from smallwheel_ros.pipeline.rows.motion import MotionState, motion
from smallwheel_ros.pipeline.tables import Aligned, Array, Flags
from smallwheel_ros.pipeline.warning.judgement import Judgement
from smallwheel_ros.pipeline.warning.margin import unknown_ground

RIGHT = "front_right/wheel_speed"
NOTHING: frozenset[str] = frozenset()
# What is not believed any more once a fault is named. Of those with nothing the fault is reported, and what
# is derived of the sensor is right, or no less sure than before: a zero, a radius, a place, stamps.
DOUBTS = {
    "encoder 0": {LEFT}, "encoder holds": {LEFT}, "mirrored": {LEFT},
    "rpm": {f"{name}/wheel_speed" for name in NAMES},
    "m/s at the rim": {f"{name}/wheel_speed" for name in NAMES},
    "joints interchanged": {LEFT, RIGHT}, "radius": NOTHING, "all radii": NOTHING,
    "odometry repeats": {ODOMETRY}, "of wheels": {SHOWS_NO_SLIP}, "no twist": NOTHING, "late": NOTHING,
    "twist of the map": {ODOMETRY},
    "jumps": NOTHING, "gyro": {IMU}, "imu frozen": {IMU}, "tilt": NOTHING, "z down": NOTHING,
    "imu in g": NOTHING, "gravity taken out": NOTHING,
    "kg": {f"{name}/load" for name in NAMES}, "load frozen": {"front_left/load"},
    "load dead": {"front_left/load"}, "sinkage frozen": {"front_left/sinkage"},
    "loads swapped": {f"front_{side}/{kind}" for side in ("left", "right") for kind in ("load", "sinkage")},
    "mm": {"front_left/sinkage"}, "above ground": {"front_left/sinkage"},
}  # fmt: skip
# Columns that are unknown where a stream is doubted; the others are as they were.
UNKNOWN = {
    ODOMETRY: {"vehicle_speed", "speed", "slip", "slip_std", "x", "y", "heading", "gained"},
    IMU: {"slope", "across", "vertical"},
    SHOWS_NO_SLIP: {"slip", "slip_std"},
    "wheel_speed": {"rim_speed", "rim_std", "slip", "slip_std"},
    "load": {"load", "load_std"},
    "sinkage": {"sinkage"},
}
# What else may change: made of several streams, or of what is left.
MADE_ANEW = {
    ODOMETRY: {"speed_std", "stands", "forward", "pushed", "yaw_rate", "pitch", "slope"},
    IMU: {"yaw_rate", "speed", "speed_std", "slip", "slip_std", "pushed", "stands", "forward"},
    SHOWS_NO_SLIP: set(),
    "wheel_speed": {"speed_std", "stands", "forward"},
    "load": set(),
    "sinkage": set(),
}
BEGINS = 30.0  # s, when those faults begin that are not there from the start


@dataclass(frozen=True)
class Checked:
    """Rows after the checks: with what is doubted, without any doubt; findings."""

    rows: Aligned
    undoubted: Aligned
    believed: BelievedRows
    findings: list[Finding]


def faulty(name: str) -> Rows:
    rows = copy.deepcopy(_good())
    FAULTS[name][2](rows)
    return rows


@cache
def _good() -> Rows:
    return drive()


@cache
def without_fault() -> Aligned:
    return checked(_good()).rows


def checked(rows: Rows, ends: tuple[float, ...] = ()) -> Checked:
    """Through checks and align; ends: s, where blocks are cut."""
    onboard = settings()
    streams = Streams(widths_of(onboard), rules_of(onboard))
    checks, align, other = SensorChecks(onboard), Align(onboard), Align(onboard)
    last = max(int(stamps[-1]) for stamps, _ in rows.values())
    parts, plain, findings = [], [], []
    before = -(1 << 62)
    for until in [*(START + round(end * SECOND) for end in ends), last]:
        ahead = until + SECOND  # of what is asked for up to there, messages after it have come, too
        for stream, (stamps, values) in rows.items():
            new = (stamps > before) & (stamps <= ahead)
            streams.all[stream].extend(stamps[new], values[new])
        believed = checks.take(RawRows(streams.kept(NEVER), until))
        findings += checks.findings
        parts.append(align.take(believed))
        plain.append(other.take(replace(believed, doubted=NO_DOUBT)))
        before = ahead
    joined, undoubted = (
        Aligned.joined([p for p in each if p is not None]) for each in (parts, plain)
    )
    return Checked(joined, undoubted, believed, findings)


@cache
def whole(name: str) -> Checked:
    return checked(faulty(name))


def of_wheels(rows: Aligned, stream: str) -> Flags:
    """Rows of the wheel that a stream is of; all of a stream of the vehicle."""
    wheel = stream.split("/")[0]
    known = wheel in NAMES
    return rows.wheel == NAMES.index(wheel) if known else np.ones(len(rows), dtype=bool)


def kind(stream: str) -> str:
    return stream if stream in UNKNOWN else stream.split("/")[1]


def test_every_rule_and_every_fault_is_here() -> None:
    assert set(DOUBTS) == set(FAULTS)
    # These wheels are not steered: that rule's faults are in test_steering_sign.py.
    assert {rule.name for rule in RULES} - {"steering"} == {FAULTS[name][0] for name in DOUBTS}


@pytest.mark.parametrize("name", FAULTS)
def test_a_rule_doubts_the_streams_at_fault_and_no_other(name: str) -> None:
    doubted = whole(name).believed.doubted
    assert frozenset().union(*doubted.streams) == DOUBTS[name]
    named = min(finding.stamp for finding in whole(name).findings)
    assert all(stamp > named for stamp in doubted.stamps)


@pytest.mark.parametrize("name", FAULTS)
def test_before_its_stamp_nothing_changes(name: str) -> None:
    found = whole(name)
    stamps = found.believed.doubted.stamps
    early = found.rows.stamp <= (stamps[0] if stamps else found.rows.stamp[-1])
    assert early.any()
    for column, values in vars(found.rows).items():
        np.testing.assert_array_equal(
            values[early], vars(found.undoubted)[column][early], err_msg=column
        )


@pytest.mark.parametrize("name", [name for name, streams in DOUBTS.items() if streams])
def test_from_its_stamp_on_what_is_derived_is_unknown_and_the_rest_as_it_was(name: str) -> None:
    found = whole(name)
    rows, plain, doubted = found.rows, found.undoubted, found.believed.doubted
    changed: dict[str, Flags] = {column: np.zeros(len(rows), dtype=bool) for column in vars(rows)}
    for stream in DOUBTS[name]:
        # An odometry of wheels shows no slip by what has been learnt of it, which no doubt takes back.
        at = doubted.at(stream, rows.stamp)
        assert at.any()
        own = at & of_wheels(rows, stream)
        for column in UNKNOWN[kind(stream)]:
            assert np.isnan(vars(rows)[column][own]).all() or kind(stream) == IMU, column
            changed[column] |= own
        vehicle = at if kind(stream) in (ODOMETRY, IMU, "wheel_speed") else own
        for column in MADE_ANEW[kind(stream)]:
            changed[column] |= vehicle
        if (
            kind(stream) == "wheel_speed"
        ):  # what the rims of all change by is in each one's deviation
            changed["slip_std"] |= at
    for column, values in vars(rows).items():
        same = ~changed[column]
        np.testing.assert_array_equal(values[same], vars(plain)[column][same], err_msg=column)


@pytest.mark.parametrize("name", sorted(set(FAULTS) - {"radius", "all radii", "jumps"}))
def test_slip_that_is_known_once_a_fault_is_named_is_right(name: str) -> None:
    """Radii are reported, and in the slip of all to come; so are places that jumped, in nothing of slip."""
    found, good = whole(name), without_fault().take(slice(len(whole(name).rows)))
    named = min(finding.stamp for finding in found.findings) + 2 * SECOND
    rows = found.rows
    np.testing.assert_array_equal(rows.wheel, good.wheel)
    late = (rows.stamp > named) & np.isfinite(rows.slip + good.slip)
    if DOUBTS[name] & {ODOMETRY, SHOWS_NO_SLIP}:
        frozen = found.believed.doubted.at(next(iter(DOUBTS[name])), rows.stamp)
        assert np.isnan(rows.slip[frozen]).all()
        late &= ~frozen
    off = np.abs(rows.slip - good.slip)[late]
    within = off <= 3.0 * np.hypot(rows.slip_std, good.slip_std)[late] + 0.01
    assert within.sum() >= 0.97 * late.sum()


def test_an_imu_that_looks_down_is_turned_over_not_doubted() -> None:
    rows = whole("z down").rows
    assert np.nanmedian(rows.vertical) == pytest.approx(GRAVITY, abs=0.1)


@pytest.mark.parametrize("name", FAULTS)
def test_where_rows_are_cut_does_not_matter(name: str) -> None:
    """Cut evenly, twice within a span, just after a fault began, and near the end."""
    ends = sorted({3.0, 3.1, 31.9, 34.0, 66.6, *np.arange(2.5, 88.0, 5.3).tolist()})
    one, other = whole(name), checked(faulty(name), tuple(ends))
    assert other.findings == one.findings
    for column, values in vars(one.rows).items():
        np.testing.assert_allclose(
            vars(other.rows)[column], values, rtol=1e-9, atol=1e-12, equal_nan=True, err_msg=column
        )


def margins(name: str) -> tuple[Array, Array, int]:
    """Stamps, margins of any ground, and the stamp from which on nothing counts that was learnt."""
    found, onboard = whole(name), settings()
    believed = replace(found.believed, since=START - SECOND)
    rows = motion(MotionState.of(onboard), found.rows, onboard)
    judged = Judgement(onboard).take(rows, believed)
    return rows.stamp, judged.margin, (*believed.anew, int(rows.stamp[-1]))[0]


def test_what_a_wrong_imu_taught_of_the_ground_is_dropped_and_load_cells_taught_nothing() -> None:
    prior = unknown_ground(settings().reference_slip)[0]
    stamps, margin, anew = margins("gyro")
    before, after = margin[stamps <= anew], margin[stamps > anew + 2 * SECOND]
    assert np.abs(before - prior).max() > 0.01
    np.testing.assert_allclose(after, prior)
    stamps, margin, anew = margins("load dead")
    late = stamps > anew + SECOND
    assert late.any()
    np.testing.assert_array_equal(margin, margins("load frozen")[1][: margin.size])
    assert np.abs(margin[late] - prior).max() > 0.01
