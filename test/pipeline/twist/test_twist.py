# SPDX-License-Identifier: Apache-2.0
"""The twist of rims and imu: blocks may be cut anywhere, doubt widens, bad input never gets out.

Tests `filter.py`.
"""

from __future__ import annotations

from dataclasses import fields, replace
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rates._twist_drives import Drive, simulated, vehicle
from smallwheel_ros.common.stamps import SECOND
from smallwheel_ros.onboard.declared import TwistSettings
from smallwheel_ros.pipeline.twist.twist import (
    Rows,
    TwistError,
    Twists,
    TwistState,
    messages,
    twist,
)

IMU = "imu"
LEFT, RIGHT = (
    [f"{end}_{side}/wheel_speed" for end in ("front", "rear")] for side in ("left", "right")
)
SHORT = simulated(3, slip=0.3, seconds=12.0)
LONG = [simulated(seed, slip=0.4, seconds=100.0, speed=2.0) for seed in range(3)]


def run(drive: Drive, rows: Rows | None = None, **changes: object) -> Twists:
    state = TwistState(drive.vehicle, replace(drive.settings, **changes))  # type: ignore[arg-type]
    return twist(state, drive.rows if rows is None else rows)


@cache
def clean_run(number: int) -> Twists:
    return run(LONG[number])


def part(rows: Rows, low: int, high: int) -> Rows:
    """Rows stamped behind low, up to high."""
    keep = {name: (t > low) & (t <= high) for name, (t, _) in rows.items()}
    return {name: (t[keep[name]], v[keep[name]]) for name, (t, v) in rows.items()}


def changed(rows: Rows, name: str, values: np.ndarray) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    return {**rows, name: (rows[name][0], values)}


def doubted(rows: Rows, names: list[str], which: np.ndarray | slice = slice(None)) -> Rows:
    """Rows of these streams unknown, as checks give what they doubt."""
    found = dict(rows)
    for name in names:
        values = rows[name][1].astype(float)
        values[which] = np.nan
        found[name] = rows[name][0], values
    return found


def assert_sound(rows: Twists) -> None:
    for column in fields(rows):
        assert np.isfinite(getattr(rows, column.name)).all(), column.name
    for name in ("vx_var", "vy_var", "yaw_var"):
        assert (getattr(rows, name) > 0.0).all(), name


@settings(max_examples=20)
@given(
    cuts=st.lists(st.integers(0, 12 * 10**9), max_size=12),
    delay=st.sampled_from([0.0, 0.03, 0.2]),
    lost=st.booleans(),
)
def test_blocks_may_be_cut_anywhere(cuts: list[int], delay: float, lost: bool) -> None:
    rows = SHORT.rows
    if lost:  # a gap of all, an imu that is gone for a while, an orientation that comes and goes
        rows = {
            n: (
                t[(t - t[0]) % (5 * SECOND) < 3.7 * SECOND],
                v[(t - t[0]) % (5 * SECOND) < 3.7 * SECOND],
            )
            for n, (t, v) in rows.items()
        }
        imu = rows[IMU][1].copy()
        imu[200:260, 0], imu[300:350, 1], imu[400:500, 4:] = np.nan, np.nan, np.nan
        rows = changed(rows, IMU, imu)
    whole = run(SHORT, rows, rim_delay=delay)
    state = TwistState(SHORT.vehicle, replace(SHORT.settings, rim_delay=delay))
    first = min(int(t[0]) for t, _ in rows.values())
    ends = sorted({first - 1, *(first + cut for cut in cuts), first + 60 * SECOND})
    parts = [twist(state, part(rows, a, b)) for a, b in pairwise(ends)]
    cut = Twists.joined(parts)
    assert len(whole) > 100
    for column in fields(whole):
        np.testing.assert_allclose(
            getattr(cut, column.name), getattr(whole, column.name), rtol=1e-9, atol=1e-9
        )


def test_one_row_a_stamp_of_the_rims() -> None:
    found = run(SHORT)
    np.testing.assert_array_equal(found.stamp, SHORT.stamp)
    assert_sound(found)


def test_both_sides_doubted_nothing_is_told_and_one_widens() -> None:
    state = TwistState(SHORT.vehicle, SHORT.settings)
    assert len(twist(state, doubted(SHORT.rows, LEFT + RIGHT))) == 0
    clean = run(SHORT)
    for side in (LEFT, RIGHT):
        one = run(SHORT, doubted(SHORT.rows, side))
        assert_sound(one)
        assert len(one) == len(clean)
        assert np.mean(one.vx_var) > np.mean(clean.vx_var)
        assert np.mean(one.yaw_var) > 3.0 * np.mean(clean.yaw_var)


def test_doubt_by_row_leaves_out_these_rows() -> None:
    stamps = SHORT.rows[LEFT[0]][0]
    doubt = (np.arange(stamps.size) >= 100) & (
        np.arange(stamps.size) < 140
    )  # 2 s: longer than held
    found = run(SHORT, doubted(SHORT.rows, LEFT + RIGHT, doubt))
    held = found.stamp[(found.stamp >= stamps[100]) & (found.stamp < stamps[140])]
    assert held.size <= 4  # of before, within maximum_gap
    assert (found.stamp >= stamps[140]).sum() == stamps.size - 140


def test_a_doubted_wheel_leaves_the_other_one_of_its_side() -> None:
    wrong = changed(SHORT.rows, LEFT[0], 5.0 + SHORT.rows[LEFT[0]][1])
    found = run(SHORT, doubted(wrong, LEFT[:1]))
    assert np.abs(found.vx - run(SHORT).vx).max() < 0.05


@pytest.mark.parametrize("name", [LEFT[0], IMU])
@pytest.mark.parametrize("value", [np.nan, np.inf, -1e300, 1e8])
def test_nothing_that_is_no_number_of_a_vehicle_comes_out(name: str, value: float) -> None:
    values = SHORT.rows[name][1].copy()
    values[30:80] = value
    values[120::7] = value
    found = run(SHORT, changed(SHORT.rows, name, values))
    assert_sound(found)
    assert np.abs(found.vx).max() < 3.0
    assert_sound(run(SHORT, changed(SHORT.rows, name, np.full_like(values, value))))


@settings(max_examples=30)
@given(st.integers(0, 10**6))
def test_noise_of_any_size_gives_numbers(seed: int) -> None:
    rng = np.random.default_rng(seed)
    rows = {}
    for name, (stamps, values) in SHORT.rows.items():
        chosen = np.sort(rng.choice(stamps.size, 60, replace=False))
        wild = rng.normal(size=(60, values.shape[1])) * 10.0 ** rng.uniform(-3, 6, (60, 1))
        wild[rng.random(60) < 0.1] = np.nan
        rows[name] = stamps[chosen], wild
    assert_sound(run(SHORT, rows))


def test_late_rows_are_left_out() -> None:
    stamps = SHORT.rows[LEFT[0]][0]
    order = np.arange(stamps.size)
    order[50], order[51] = 51, 50
    late = {**SHORT.rows, **{n: (stamps[order], SHORT.rows[n][1][order]) for n in LEFT + RIGHT}}
    found = run(SHORT, late)
    assert_sound(found)
    assert (np.diff(found.stamp) > 0).all()
    assert len(found) == stamps.size - 1


def test_without_an_imu_rims_are_told_more_widely() -> None:
    only = {name: SHORT.rows[name] for name in LEFT + RIGHT}
    found, clean = run(SHORT, only), run(SHORT)
    assert_sound(found)
    assert np.mean(found.vx_var) > np.mean(clean.vx_var)
    assert np.mean(found.yaw_var) > np.mean(clean.yaw_var)


def test_standing_is_told_to_a_few_centimetres_a_second() -> None:
    stamps = 1_000 * SECOND + np.arange(0, 30 * SECOND, SECOND // 20)
    rng = np.random.default_rng(0)
    imu = np.full((stamps.size, 8), np.nan)
    imu[:, :4] = rng.normal([0.0, 0.2, 0.0, 9.8], [0.005, 0.05, 0.05, 0.05], (stamps.size, 4))
    rows: Rows = {
        IMU: (stamps, imu),
        **{n: (stamps, np.zeros((stamps.size, 1))) for n in LEFT + RIGHT},
    }
    found = run(SHORT, rows)
    late = found.take(slice(200, None))
    assert np.abs(late.vx).max() < 0.03
    assert 0.005 < np.sqrt(late.vx_var).mean() < 0.06
    assert np.abs(late.yaw).max() == 0.0


@pytest.mark.parametrize("fault", ["gyro of the wrong sign", "imu late", "rims in steps"])
def test_a_fault_widens_and_never_narrows(fault: str) -> None:
    for number, drive in enumerate(LONG[:2]):
        rows = dict(drive.rows)
        stamps, imu = rows[IMU]
        if fault == "gyro of the wrong sign":
            rows[IMU] = stamps, imu * np.array([-1.0, *[1.0] * 7])
        elif fault == "imu late":
            rows[IMU] = stamps + SECOND // 2, imu
        else:
            for name in LEFT + RIGHT:
                rows[name] = rows[name][0], 2.0 * np.round(rows[name][1] / 2.0)  # 0.3 m/s
        clean, wrong = clean_run(number), run(drive, rows)
        assert_sound(wrong)
        both = np.isin(wrong.stamp, clean.stamp)
        assert np.mean(wrong.vx_var[both]) > np.mean(clean.vx_var)
        if fault == "gyro of the wrong sign":
            assert np.mean(wrong.yaw_var) > 4.0 * np.mean(clean.yaw_var)
        assert np.mean(wrong.yaw_var) > 0.99 * np.mean(clean.yaw_var)


def test_slip_that_the_imu_sees_is_told_as_large_as_it_is() -> None:
    nees = []
    for number, drive in enumerate(LONG):
        found = clean_run(number)
        nees.append(np.mean((found.vx - drive.truth[:, 0]) ** 2 / found.vx_var))
        assert np.mean((found.vx - drive.truth[:, 0]) ** 2 < 4.0 * found.vx_var) > 0.9
    assert 0.5 < np.mean(nees) < 2.0


@pytest.mark.parametrize("speed", [0.7, 2.0])
def test_firm_ground_is_told_as_firm_as_it_is_at_any_speed(speed: float) -> None:
    nees = []
    for seed in (1, 2):
        drive = simulated(seed, slip=0.05, seconds=150.0, speed=speed)
        found = run(drive).take(drive.time > 30.0)
        off = found.vx - drive.truth[drive.time > 30.0, 0]
        nees.append(np.mean(off**2 / found.vx_var))
        assert np.mean(off**2 < 4.0 * found.vx_var) > 0.9
    assert 0.3 < np.mean(nees) < 2.0


def test_slip_falls_on_firm_ground_and_stays_on_loose() -> None:
    drives = [simulated(1, slip=slip, seconds=150.0, speed=2.0) for slip in (0.02, 0.6)]
    firm, loose = (run(drive).slip[-1] for drive in drives)
    assert firm < 0.05 < 0.4 < loose


def test_speed_over_ground_narrows_and_corrects() -> None:
    drive = LONG[0]
    odometry = np.zeros((drive.stamp.size, 10))
    odometry[:, 0], odometry[:, 6] = drive.truth[:, 0], 0.05**2
    rows = {**drive.rows, "odom": (drive.stamp, odometry)}
    other = replace(drive, vehicle=vehicle(0.3, 0.6, 0.5, "odometry"))
    found, blind = run(other, rows), clean_run(0)
    wrong, before = (np.mean((each.vx - drive.truth[:, 0]) ** 2) for each in (found, blind))
    assert wrong < 0.5 * before
    rows["odom"] = drive.stamp, np.full_like(odometry, np.nan)
    without = twist(TwistState(other.vehicle, other.settings), rows)
    np.testing.assert_allclose(without.vx, blind.vx)


def with_speed(drive: Drive, until: float) -> tuple[Drive, Rows]:
    """The drive whose rims all turn a fifth too fast, with a speed over ground up to a time, s."""
    rows = {
        name: (stamps, values / 0.8) if name.endswith("/wheel_speed") else (stamps, values)
        for name, (stamps, values) in drive.rows.items()
    }
    pick = np.flatnonzero(drive.time < until)[::4]
    count = pick.size
    columns = [drive.truth[pick, 0], np.zeros(count), np.full(count, 0.05)]
    rows["velocity"] = drive.stamp[pick], np.column_stack(columns)
    return replace(drive, vehicle=replace(drive.vehicle, velocity="topic")), rows


def test_steady_slip_that_a_speed_over_ground_has_taught_is_used_without_it() -> None:
    drive = simulated(5, slip=0.05, seconds=120.0)
    taught = run(*with_speed(drive, 60.0))
    untaught = run(*with_speed(drive, 0.0))
    late = (drive.time > 70.0) & (np.abs(drive.truth[:, 0]) > 0.2)
    true = drive.truth[late, 0]
    too_fast = [np.sum(one.vx[late] * true) / np.sum(true**2) - 1.0 for one in (untaught, taught)]
    assert too_fast[0] > 0.2  # no imu sees it
    assert abs(too_fast[1]) < 0.5 * too_fast[0]  # a minute has taught most of it
    off = (taught.vx[late] - true) ** 2 / taught.vx_var[late]
    assert (off < 4.0).mean() > 0.9


def test_the_message_is_wider_by_what_errors_last() -> None:
    found = run(SHORT)
    linear, angular, covariance = messages(found, SHORT.settings)
    shape = covariance.reshape(-1, 6, 6)
    np.testing.assert_array_equal(linear[:, 0], found.vx)
    np.testing.assert_array_equal(linear[:, 1:], 0.0)
    np.testing.assert_array_equal(angular[:, 2], found.yaw)
    np.testing.assert_allclose(
        shape[50:, 0, 0] / found.vx_var[50:], 16.0, rtol=0.01
    )  # 20 Hz, 0.4 s
    np.testing.assert_array_equal(shape[:, [2, 3, 4], [2, 3, 4]], 1e6)
    plain = messages(found, TwistSettings(correlation_time=0.0))[2].reshape(-1, 6, 6)
    np.testing.assert_array_equal(plain[:, 0, 0], found.vx_var)
    assert np.isfinite(covariance).all()


def test_rims_that_come_late_are_carried_on() -> None:
    drive = LONG[0]
    late = {n: (t if n == IMU else t + SECOND // 5, v) for n, (t, v) in drive.rows.items()}
    truth = np.interp((drive.stamp + SECOND // 5) / 1e9, drive.stamp / 1e9, drive.truth[:, 0])
    errors = [np.mean((run(drive, late, rim_delay=d).vx - truth) ** 2) for d in (0.0, 0.2)]
    assert errors[1] < errors[0]


def test_a_vehicle_without_two_sides_is_refused() -> None:
    wheels = tuple(replace(w, lateral_position=0.0) for w in SHORT.vehicle.wheels)
    with pytest.raises(TwistError, match="lateral_position"):
        TwistState(replace(SHORT.vehicle, wheels=wheels), TwistSettings())


def test_a_block_without_rims_has_no_rows_and_keeps_the_imu() -> None:
    state = TwistState(SHORT.vehicle, SHORT.settings)
    assert len(twist(state, {})) == 0
    assert len(twist(state, {IMU: SHORT.rows[IMU]})) == 0
    assert sum(stamps.nbytes for stamps, _ in state.tail.values()) < 10_000  # of 1.2 s, not of all


@pytest.mark.parametrize("apart", [1_000, 12_000_000])
def test_wheels_may_have_stamps_of_their_own(apart: int) -> None:
    rows = dict(SHORT.rows)
    for i, name in enumerate(LEFT + RIGHT):
        rows[name] = rows[name][0] + i * apart, rows[name][1]
    found, together = run(SHORT, rows), run(SHORT)
    assert_sound(found)
    assert len(found) == 4 * len(together)
    truth = np.interp(found.stamp / 1e9, SHORT.stamp / 1e9, SHORT.truth[:, 0])
    wrong, before = (
        np.sqrt(np.mean((each - true) ** 2))
        for each, true in ((found.vx, truth), (together.vx, SHORT.truth[:, 0]))
    )
    assert wrong < 1.2 * before
    np.testing.assert_allclose(found.vx_var.mean(), together.vx_var.mean(), rtol=0.3)


def test_a_side_at_rest_tells_nothing_of_its_slip() -> None:
    """One side starts first, all others are exactly 0: nothing is divided by."""
    rows = {name: (stamps.copy(), values.copy()) for name, (stamps, values) in SHORT.rows.items()}
    for name, (_, values) in rows.items():
        values[:] = 2.0 if name in LEFT else 0.0
    found = twist(TwistState(SHORT.vehicle, SHORT.settings), rows)
    assert len(found) > 10
    assert all(np.isfinite(column).all() for column in vars(found).values())
