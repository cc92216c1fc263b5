# SPDX-License-Identifier: Apache-2.0
"""The warning: hazard and its gates, what is said and when, and that cuts of the blocks change nothing.

Tests `judgement.py`.
"""

from __future__ import annotations

from dataclasses import replace
from importlib import import_module
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from raw_drives import NAMES, START, real_folder, settings

from smallwheel_ros.common.stamps import NEVER
from smallwheel_ros.onboard.declared import REFERENCE_SLIP
from smallwheel_ros.onboard.settings import ODOMETRY
from smallwheel_ros.pipeline.checks.believed import RawRows
from smallwheel_ros.pipeline.checks.sensor_checks import SensorChecks
from smallwheel_ros.pipeline.intake.layout import rules_of, widths_of
from smallwheel_ros.pipeline.intake.streams import Streams
from smallwheel_ros.pipeline.rows.align import Align
from smallwheel_ros.pipeline.rows.motion import MotionState, motion
from smallwheel_ros.pipeline.tables import Readings, unknown
from smallwheel_ros.pipeline.warning.hazard import Instants, Warned, Warnings, level_at, risk_of
from smallwheel_ros.pipeline.warning.margin import AnyGround

Array = NDArray[np.float64]
WHEELS = settings().wheels
SIDE = np.array([wheel.lateral_position for wheel in WHEELS])


def rows_of(
    rim: Any, speed: Any, slope: Any = 0.0, seconds: float = 20.0, one_by_one: bool = False
) -> Readings:
    """Rows at 20 Hz of all wheels; functions of time (s), or numbers. slope: m/s^2."""
    time = np.repeat(np.arange(0.0, seconds, 0.05), 4)
    wheel = np.tile(np.arange(4), time.size // 4)
    time = time + (0.007 * wheel if one_by_one else 0.0)

    def of(value: Any) -> Array:
        return (
            np.array([value(t) for t in time])
            if callable(value)
            else np.full(time.size, float(value))
        )

    n, no = time.size, np.zeros(time.size, dtype=bool)
    known = {
        "stamp": START + np.round(time * 1e9).astype(np.int64), "wheel": wheel, "rim_speed": of(rim),
        "speed": of(speed), "vehicle_speed": of(speed), "slope": of(slope),
        "gained": np.zeros(n), "pushed": of(slope),
    }  # fmt: skip
    flags = dict.fromkeys(("stands", "forward", "onward", "due"), no)
    names = [name for name in Readings.__dataclass_fields__ if name not in {**known, **flags}]
    return Readings(**known, **flags, **{name: unknown(n) for name in names})


def warned(
    rows: Readings, imu: Any = None, stage: Warnings | None = None
) -> tuple[Instants, Warned]:
    speeds = np.unique(rows.stamp)
    made = (stage or Warnings(WHEELS, imu is not None)).take(
        rows, speeds, imu, int(rows.stamp[-1]) + 200_000_000
    )
    assert made is not None
    return made


def slips_in(t: float) -> float:
    """Rolls at 0.5 m/s for 8 s, then loses speed to nothing within 6 s."""
    return 0.5 * float(np.clip(1.0 - (t - 8.0) / 6.0, 0.02, 1.0))


def test_a_vehicle_that_rolls_is_told_nothing() -> None:
    _, said = warned(rows_of(0.52, 0.5))
    assert not said.level.any()
    assert np.nanmax(said.slip) == pytest.approx(1 - 0.5 / 0.52, abs=1e-6)


@pytest.mark.parametrize("one_by_one", [False, True])
def test_a_vehicle_that_gets_stuck_is_told_before_it_stands(one_by_one: bool) -> None:
    _, said = warned(rows_of(0.52, slips_in, one_by_one=one_by_one))
    time = (said.stamp - START) / 1e9
    first, second = (float(time[said.level >= one][0]) for one in (1, 2))
    assert 9.0 < first < 11.5
    assert first < second < 12.5
    assert said.told.max() == 2


def test_half_of_a_slope_counts_as_pull_that_will_be_asked_for() -> None:
    level, steep = (warned(rows_of(0.60, 0.48, slope=slope))[1] for slope in (0.0, 9.80665 * 0.12))
    assert not level.level.any()
    assert steep.hazard[100] == pytest.approx(level.hazard[100] + 0.12, abs=1e-6)
    down = warned(rows_of(0.60, 0.48, slope=-9.80665 * 0.12))[1]
    assert down.hazard[100] == pytest.approx(level.hazard[100], abs=1e-9)


def test_a_slope_that_grows_is_warned_of_at_an_even_speed_of_the_vehicle() -> None:
    """Rims that turn ever faster keep the speed, until slip and slope are more than the ground gives."""

    def rim(t: float) -> float:
        return 0.4 / (1.0 - 0.1 - 0.06 * max(t - 5.0, 0.0)) if t < 11.0 else 0.4 / 0.54

    def slope(t: float) -> float:
        return 9.80665 * 0.02 * min(max(t - 5.0, 0.0), 6.0)

    _, said = warned(rows_of(rim, 0.4, slope=slope, seconds=14.0))
    time = (said.stamp - START) / 1e9
    first, second = (float(time[said.level >= one][0]) for one in (1, 2))
    assert 6.0 < first < second < 11.0
    assert said.slip[said.level >= 2][0] < 0.46  # before slip alone is enough


def test_a_level_goes_on_until_the_hazard_is_well_under_it() -> None:
    """Slip that grows to 0.4 and then stays, or wanders about the level, is one warning."""

    def speed(t: float) -> float:
        return 0.55 - 0.19 * min(max(t - 5.0, 0.0) / 3.0, 1.0) + 0.012 * float(np.sin(3.0 * t))

    _, said = warned(rows_of(0.60, speed, seconds=20.0))
    assert np.sum(np.diff((said.level > 0).astype(int)) == 1) == 1
    assert (said.level[-50:] == 1).all()
    _, gone = warned(rows_of(0.60, lambda t: speed(min(t, max(24.0 - t, 0.0))), seconds=20.0))
    assert gone.level.any()
    assert not gone.level[-5:].any()


def test_slip_that_is_surely_high_is_of_the_first_level_by_itself() -> None:
    """Ground that gives way at once takes away no speed before: the hazard stays under its level."""

    def gives_way(t: float) -> float:
        return 0.57 if t < 5.0 else 0.39

    def shaken(t: float) -> float:
        return gives_way(t) + (0.15 if round(20.0 * t) % 2 else -0.15)

    steady, noisy = (warned(rows_of(0.60, speed))[1] for speed in (gives_way, shaken))
    late = steady.stamp > START + 10 * 10**9
    assert np.nanmax(steady.hazard[late]) < 0.4
    assert (steady.level[late] == 1).all()
    assert not noisy.level[late].any()  # the same slip, less sure


@pytest.mark.parametrize(("spread", "told"), [(0.02, True), (0.3, False)])
def test_nothing_is_said_where_slip_may_be_none(spread: float, told: bool) -> None:
    rows = rows_of(0.52, slips_in)
    rows = replace(rows, speed_std=np.full(len(rows), spread))
    _, said = warned(rows)
    time = (said.stamp - START) / 1e9
    assert said.level[time < 12.0].any() == told
    assert not np.nanmax(np.abs(said.slip), initial=0.0) > 1.0


def test_a_steady_climb_is_no_warning() -> None:
    """As near to what the ground gives as it may be: it gets on."""
    _, said = warned(rows_of(0.60, 0.40, slope=9.80665 * 0.12, seconds=30.0))
    rolls = rows_of(
        0.60, lambda t: 0.55 - 0.15 * min(t / 10.0, 1.0), slope=9.80665 * 0.12, seconds=30.0
    )
    _, slowly = warned(rolls)
    assert not said.level.any()
    assert not slowly.level.any()
    assert slowly.hazard[-20] > 0.4


def test_backwards_is_as_forwards() -> None:
    ahead = warned(rows_of(0.52, slips_in))[1]
    back = warned(rows_of(-0.52, lambda t: -slips_in(t)))[1]
    assert np.array_equal(ahead.level, back.level)


@pytest.mark.parametrize("rate", [0.01, 0.02, 0.04])
def test_slip_that_grows_slowly_is_warned_of_at_both_levels(rate: float) -> None:
    """Ground that gives way over 20 or 40 s: no growth that a climb would not have, too."""

    def speed(t: float) -> float:
        return 0.5 * (1.0 - 0.1 - rate * max(t - 2.0, 0.0))

    _, said = warned(rows_of(0.5, speed, seconds=2.0 + 0.6 / rate))
    first, second = (float(said.slip[said.level >= one][0]) for one in (1, 2))
    assert first == pytest.approx(0.40, abs=0.02)
    assert second == pytest.approx(0.50, abs=0.02)
    assert (said.level[-20:] == 2).all()


def test_a_start_in_place_is_warned_of_once_it_is_more_than_a_start() -> None:
    """Who stands in ground that does not carry it slips by 0.8 from the first turn of its wheels on."""

    def rim(t: float) -> float:
        return 0.0 if t < 5.0 else min(0.5 * (t - 5.0), 0.5)

    _, said = warned(rows_of(rim, lambda t: 0.2 * rim(t), seconds=12.0))
    time = (said.stamp - START) / 1e9
    assert not said.level[time < 7.0].any()
    assert (said.level[time > 9.0] == 2).all()


def test_an_odometry_that_is_late_is_no_start_in_place() -> None:
    """By 0.9 s: all the slip that it shows is over before a start counts as one."""

    def rim(t: float) -> float:
        return 0.5 * min(max(t - 5.0, 0.0), 1.0)

    _, said = warned(rows_of(rim, lambda t: 0.98 * rim(t - 0.9), seconds=12.0))
    assert not said.level.any()


def test_turning_on_the_spot_and_standing_are_not_judged() -> None:
    rows = rows_of(0.5, 0.1)
    turning = replace(rows, rim_speed=np.where(rows.wheel % 2 == 0, -0.5, 0.5))
    assert np.isnan(warned(turning)[1].hazard).all()
    assert np.isnan(warned(rows_of(0.1, 0.1))[1].hazard).all()


def test_what_gains_speed_is_not_getting_stuck() -> None:
    rolls_then_starts = rows_of(
        0.8, lambda t: 0.78 if t < 4 else min(0.4 + 0.15 * (t - 4), 0.78), seconds=8
    )
    _, said = warned(rolls_then_starts)
    time = (said.stamp - START) / 1e9
    assert not said.level[(time > 5.3) & (time < 6.0)].any()


def test_slip_that_is_not_known_is_no_warning() -> None:
    rows = rows_of(0.52, slips_in)
    made, said = warned(replace(rows, speed=unknown(len(rows))))
    assert np.isnan(said.hazard).all()
    assert len(made) == len(said)


@hypothesis_settings(max_examples=15)
@given(st.lists(st.floats(0.0, 20.0), max_size=10))
def test_warnings_do_not_depend_on_where_blocks_are_cut(edges: list[float]) -> None:
    rows = rows_of(1.04, lambda t: 2 * slips_in(t) + 0.02 * np.sin(37.0 * t), one_by_one=True)
    stamps = START + np.arange(0, 20_000_000_000, 20_000_000)
    values = np.full((stamps.size, 9), np.nan)  # no orientation
    values[:, 1:4] = np.stack(
        [np.sin(np.arange(stamps.size)), 0.0 * stamps, 9.8 + 0.0 * stamps], axis=1
    )
    whole = warned(rows, (stamps, values))
    stage, parts, before = Warnings(WHEELS, True), [], -(1 << 62)
    ends = START + np.sort(np.round(np.array(edges) * 1e9)).astype(np.int64)
    for until in [*ends.tolist(), int(rows.stamp[-1]) + 200_000_000]:
        mine = (rows.stamp > before) & (rows.stamp <= until)
        block = rows.take(mine) if mine.any() else None
        speeds = np.unique(rows.stamp[mine])
        felt = (stamps > before) & (stamps <= until)
        imu = (stamps[felt], values[felt]) if felt.any() else None
        made = stage.take(block, speeds, imu, until)
        parts += [made] if made is not None else []
        before = until
    said = Warned.joined([part[1] for part in parts])
    assert np.isfinite(said.hazard).any()
    for name in ("stamp", "hazard", "slip", "level", "told"):
        assert np.array_equal(getattr(said, name), getattr(whole[1], name), equal_nan=True)


def test_it_is_said_again_while_it_holds_and_not_at_each_instant() -> None:
    _, said = warned(rows_of(0.6, lambda t: 0.55 if t < 3 else 0.36, seconds=16.0))
    time = (said.stamp - START) / 1e9
    told = time[said.told > 0]
    assert (said.level[time > 5] == 1).all()
    assert np.allclose(np.diff(told), 5.0, atol=0.11)
    assert 2 <= told.size <= 4


def test_wheels_dig_in_while_the_second_level_is_exceeded() -> None:
    _, said = warned(rows_of(0.52, slips_in))
    digs = level_at(said.stamp, said.level, said.stamp) == 2
    assert np.array_equal(digs, said.level == 2)
    assert not level_at(said.stamp, said.level, said.stamp[:1] - 1)[0]


def test_risk_is_a_half_at_least_over_the_first_level_and_unknown_where_it_is() -> None:
    risk = risk_of(np.array([0.1, 0.1, 0.9, np.nan, np.nan]), np.array([0, 1, 2, 1, 0]))
    assert np.array_equal(risk, [0.1, 0.5, 0.9, 0.5, np.nan], equal_nan=True)


def test_names_are_those_of_the_vehicle() -> None:
    assert tuple(wheel.name for wheel in WHEELS) == NAMES
    assert SIDE[0] > 0.0 > SIDE[1]


@pytest.mark.parametrize(
    ("name", "at_most", "risk_at_most"),
    [("warthog_grass", 0, 0.05), ("pathfinder_flat", 0, 0.05), ("warthog_sand1", 6, 1.0)],
)
def test_on_real_ground_on_which_no_vehicle_got_stuck(
    name: str, at_most: int, risk_at_most: float
) -> None:
    """Sand: new commands each 6 s, violent spins."""
    drive = import_module("rates.real_drives").real_drive(real_folder(), name)
    onboard = drive.settings
    streams = Streams(widths_of(onboard), rules_of(onboard))
    for stream in streams.all.values():
        stream.extend(*drive.rows[stream.name])
        streams.latest = max(streams.latest, stream.newest)
    believed = SensorChecks(onboard).take(RawRows(streams.kept(NEVER), streams.latest))
    aligned = Align(onboard).take(believed)
    assert aligned is not None
    rows = motion(MotionState.of(onboard), aligned, onboard)
    stage = Warnings(onboard.wheels, True)
    made = stage.take(rows, drive.rows[ODOMETRY][0], believed.new_imu(), streams.latest)
    assert made is not None
    assert (made[1].told > 0).sum() <= at_most
    margins = AnyGround(stage.side, REFERENCE_SLIP).take(made[0])
    assert margins is not None
    assert np.nanmean(margins.risk) < risk_at_most
    # The bands hold what grass, floor and sand give at a slip of 0.3 to 0.6: 0.25 to 0.95.
    assert margins.low[-1] < 0.25
    assert margins.high[-1] > 0.95
