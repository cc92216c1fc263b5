# SPDX-License-Identifier: Apache-2.0
"""Results do not depend on where a list of messages is cut, nor on how rows are given.

Tests `tables.py` and `versions.py`.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rows_of_drives import (
    SECOND,
    Row,
    assert_same,
    drive,
    give,
    rover,
    run,
    static_rover,
    streams_of,
)

from smallwheel_ros.onboard.settings import NodeSettings
from smallwheel_ros.pipeline.tables import Estimates, Readings


def _messy(rows: list[Row], seed: int) -> list[Row]:
    """Rows late, twice, far, of the future, NaN, huge; a stream that falls silent, and comes again."""
    random = np.random.default_rng(seed)
    start = rows[0][1]
    rows = [
        row
        for row in rows
        if not (row[0] == "odom" and 4.0 < (row[1] - start) / SECOND < 6.5)
        and not (row[0] == "fl/load" and 8.0 < (row[1] - start) / SECOND < 9.0)
    ]
    for i in random.choice(len(rows), 60, replace=False).tolist():
        name, stamp, values, now = rows[i]
        kind = int(random.integers(6))
        if kind == 0:
            stamp -= int(random.integers(SECOND))
        elif kind == 1:
            stamp += int(random.integers(400_000_000))
        elif kind == 2:
            stamp -= 100 * SECOND
        elif kind == 3:
            stamp += 100 * SECOND
        else:
            values = (float("nan") if kind == 4 else 1e300, *values[1:])
        rows[i] = name, stamp, values, now
    order = np.arange(len(rows)) + 20.0 * random.random(len(rows))
    return [rows[i] for i in np.argsort(order)]


def _in_millimetres(rows: list[Row]) -> list[Row]:
    """One sinkage sensor shows millimetres: it is found out, and the soil begins anew."""
    return [
        (name, stamp, (1e3 * values[0], *values[1:]) if name == "fl/sinkage" else values, now)
        for name, stamp, values, now in rows
    ]


def _again(rows: list[Row]) -> list[Row]:
    """The drive, and then once more from its beginning: time goes back."""
    return rows + rows


_TURNS = {"turn": lambda t: np.where((t > 5.0) & (t < 9.0), 0.3, 0.0)}
DRIVES = {
    "plain": lambda: (rover(), drive(**_TURNS)),
    "pose": lambda: (rover(), drive(twist=False, odometry_rate=4.0, **_TURNS)),
    "slow": lambda: (static_rover(), drive(30.0, odometry_rate=1.3, soil=False, **_TURNS)),
    "wheels": lambda: (static_rover(), drive(of_wheels=True, soil=False, **_TURNS)),
    "late": lambda: (static_rover(), drive(40.0, late=0.5, soil=False, turn=np.sin)),
    "down": lambda: (static_rover(), drive(imu_down=True, soil=False, **_TURNS)),
    "messy": lambda: (rover(), _messy(drive(**_TURNS), 1)),
    "millimetres": lambda: (rover(), _in_millimetres(drive(**_TURNS))),
    "again": lambda: (rover(), _again(drive(8.0, **_TURNS))),
}


@cache
def _whole(name: str) -> tuple[NodeSettings, list[Row], Readings, Estimates]:
    vehicle, rows = DRIVES[name]()
    if name in ("messy", "again"):  # judged by each other alone, or by a clock that goes back, too
        rows = [(*row[:3], None if name == "messy" else row[3]) for row in rows]
    return vehicle, rows, *run(vehicle, rows)


@pytest.mark.parametrize("tries", [2, pytest.param(8, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", DRIVES)
def test_cuts_do_not_matter(name: str, tries: int) -> None:
    vehicle, rows, readings, estimates = _whole(name)
    assert len(readings) > 100

    @settings(max_examples=tries, deadline=None, database=None, derandomize=True)
    @given(
        cuts=st.lists(st.integers(1, len(rows) - 1), min_size=1, max_size=40),
        together=st.booleans(),
        span=st.none() | st.integers(SECOND // 100, SECOND),
    )
    def check(cuts: list[int], together: bool, span: int | None) -> None:
        found, made = run(vehicle, rows, cuts, together=together, span=span)
        assert_same(readings, found)
        assert_same(estimates, made)

    check()


@pytest.mark.parametrize("name", ["plain", "messy", "again"])
@pytest.mark.parametrize("many", [7, 300])
def test_many_rows_at_once_are_the_same_as_one_by_one(name: str, many: int) -> None:
    vehicle, rows, _, _ = _whole(name)
    one, all_ = streams_of(vehicle), streams_of(vehicle)
    give(one, rows)
    for begin in range(0, len(rows), many):
        give(all_, rows[begin : begin + many], together=True)
    assert one.problems == all_.problems
    assert (one.latest, one.oldest, one.watermark) == (all_.latest, all_.oldest, all_.watermark)
    for name_, stream in one.all.items():
        assert stream.received == all_.all[name_].received
        np.testing.assert_array_equal(stream.stamps, all_.all[name_].stamps)
        np.testing.assert_array_equal(stream.values, all_.all[name_].values)
