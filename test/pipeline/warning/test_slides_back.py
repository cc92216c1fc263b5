# SPDX-License-Identifier: Apache-2.0
"""A rover whose drive begins by sliding back down a slope; an odometry that looks back. Tests `hazard.py`."""

from __future__ import annotations

import math

import numpy as np
import pytest
from rows_of_drives import PLACES, START, G, Row, static_rover

from smallwheel_ros.common.stamps import SECOND
from smallwheel_ros.pipeline.pipeline import Pipeline

BEGINS = 2.0  # s, at which the wheels start


def backward(
    share: float,
    *,
    rise: float = 0.0,
    slides: bool | None = None,
    oriented: bool = True,
    late: float = 0.0,
    seed: int = 0,
) -> list[Row]:
    """Rims that drive ahead at 0.4 m/s from `BEGINS` on, and an odometry that shows -share of it.

    rise: sine of the slope, nose up, as the imu shows it. slides: whether the vehicle does, which the imu
    feels, or goes ahead, and the odometry looks back; None: it slides where there is a slope. oriented:
    whether the imu tells it by an orientation. late: s, of the odometry.
    """
    random = np.random.default_rng(seed)
    rows: list[Row] = []

    def rim(t: np.ndarray) -> np.ndarray:
        return 0.4 * np.clip((t - BEGINS) / 0.5, 0.0, 1.0)

    def add(name: str, t: np.ndarray, *values: np.ndarray) -> None:
        for i, at in enumerate(t):
            stamp = START + round(float(at) * 1e9)
            rows.append((name, stamp, tuple(float(value[i]) for value in values), stamp))

    for k, name in enumerate(PLACES):
        t = np.arange(0.001 * k, 12.0, 0.02)
        add(f"{name}/wheel_speed", t, rim(t) / 0.125)
    t = np.arange(0.01, 12.0, 0.05)
    v = -share * rim(t - late)
    x, zero = np.cumsum(v) * 0.05, np.zeros(t.size)
    twist = v + 0.01 * random.standard_normal(t.size), 0.005 * random.standard_normal(t.size)
    add("odom", t, *twist, x, zero, 1.0 + zero, zero, zero, zero, zero, zero)
    t = np.arange(0.007, 12.0, 0.02)
    level, zero = math.sqrt(1.0 - rise**2), np.zeros(t.size)
    way = 1.0 if (rise != 0.0 if slides is None else slides) else -1.0
    felt = G * rise + way * np.gradient(-share * rim(t), t) + 0.1 * random.standard_normal(t.size)
    up = (rise, 0.0, level) if oriented else (np.nan, np.nan, np.nan)
    add("imu", t, zero, felt, zero, G * level + zero, *(one + zero for one in (*up, 0.0)))
    return sorted(rows, key=lambda row: row[1])


def warned(rows: list[Row], *, imu: bool = True, block: float = 0.4) -> tuple[float, set[str]]:
    """When (s after the start) a level is first published, or inf; what is found of the sensors."""
    pipeline = Pipeline(static_rover(**({} if imu else {"imu_topic": ""})).onboard)
    first, found, ends = math.inf, set[str](), START + round(block * SECOND)
    for name, stamp, values, now in rows:
        if name not in pipeline.streams.all:
            continue
        pipeline.streams.add(name, stamp, values, now)
        if stamp < ends and stamp < rows[-1][1]:
            continue
        ends += round(block * SECOND)
        for turn in pipeline.turns():
            found |= {finding.rule for finding in turn.findings}
            if turn.warned is not None and (turn.warned.level > 0).any():
                at = turn.warned.stamp[np.argmax(turn.warned.level > 0)]
                first = min(first, (int(at) - START) / SECOND - BEGINS)
    return first, found


@pytest.mark.parametrize("share", [0.3, 0.6, 1.0, 1.6])
@pytest.mark.parametrize("oriented", [True, False])
def test_who_slides_back_down_a_slope_at_the_start_is_warned(share: float, oriented: bool) -> None:
    first, found = warned(backward(share, rise=0.25, oriented=oriented))
    assert first <= 3.0
    assert "mirrored" not in found, "a good odometry is accused"


def test_where_nothing_tells_the_slope_a_slide_is_told_by_its_speed() -> None:
    assert warned(backward(0.4), imu=False)[0] <= 3.0
    assert warned(backward(2.0), imu=False)[0] <= 3.0


@pytest.mark.parametrize("imu", [True, False])
@pytest.mark.parametrize("share", [1.0, 0.85])
@pytest.mark.parametrize("late", [0.0, 0.3])
def test_what_looks_back_on_the_level_warns_of_nothing(
    share: float, late: float, imu: bool
) -> None:
    first, found = warned(backward(share, late=late), imu=imu)
    assert first == math.inf
    assert "mirrored" in found


@pytest.mark.parametrize("rise", [0.15, -0.15])
def test_a_slide_is_felt_by_an_imu_that_is_mounted_with_a_tilt(rise: float) -> None:
    first, found = warned(backward(0.6, rise=rise, slides=True))
    assert first <= 4.0
    assert "mirrored" not in found, "a good odometry is accused"


def test_what_looks_back_up_a_slope_or_beside_a_tilted_imu_is_named_and_warns_of_nothing() -> None:
    rows = backward(1.0, rise=0.15, slides=False)
    longer = [(n, s, v, w) for n, s, v, w in rows]
    end = rows[-1][1] - START
    for k in (1, 2):  # it goes on at the same speed
        for name, stamp, values, _ in rows:
            if stamp - START > 6 * SECOND:
                later = stamp + k * (end - 6 * SECOND)
                if name == "odom":
                    values = (*values[:2], values[2] - 0.4 * k * (end / SECOND - 6.0), *values[3:])
                longer.append((name, later, values, later))
    first, found = warned(sorted(longer, key=lambda row: row[1]))
    assert first == math.inf
    assert "mirrored" in found


def test_a_late_odometry_after_each_change_of_way_is_no_slide() -> None:
    rows = backward(-1.0, late=0.4)
    ways = []
    for name, stamp, values, now in rows:
        seconds = (stamp - START) / SECOND - (0.4 if name == "odom" else 0.0)
        way = -1.0 if int(seconds / 3.0) % 2 and seconds > 3.0 else 1.0
        if name == "odom":
            values = (way * values[0], values[1], 0.0, *values[3:])
        elif name != "imu":
            values = (way * values[0],)
        ways.append((name, stamp, values, now))
    assert warned(ways, imu=False)[0] == math.inf
