# SPDX-License-Identifier: Apache-2.0
"""Exact zeros, and drives as a simulator has them, without noise: nothing is infinite, or divided by 0.

Every spread that the pipeline learns is 0 there, and so is what it is divided by where nobody took care.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from rows_of_drives import PLACES, START, Row, give, rover, static_rover

from smallwheel_ros.common.stamps import SECOND
from smallwheel_ros.onboard.settings import IMU, ODOMETRY, NodeSettings
from smallwheel_ros.pipeline.pipeline import Pipeline, Turn

SECONDS, PIECE = 9.0, 3.0  # of a drive, and of a piece with one speed
SPEEDS = st.sampled_from([0.0, 0.0, 0.3, -0.3, 1.0])


@st.composite
def drives(draw: Any) -> tuple[NodeSettings, list[Row]]:
    """Pieces in which speed and turn are constant; each wheel may slip, stand or spin, exactly."""
    soil = draw(st.booleans())
    oriented, of_wheels, posed = (draw(st.booleans()) for _ in range(3))
    pieces = [(draw(SPEEDS), draw(st.sampled_from([0.0, 0.0, 0.3]))) for _ in range(3)]
    rims = [[draw(st.sampled_from([1.0, 1.0, 0.0, 1.25, 10.0])) for _ in PLACES] for _ in pieces]
    silent = draw(st.sampled_from(["", "", IMU, ODOMETRY, "fl/wheel_speed"]))
    rows: list[Row] = []
    x = y = heading = 0.0

    def add(name: str, at: int, *values: float) -> None:
        if name == silent:
            values = tuple(0.0 for _ in values)
        rows.append((name, at, values, at))

    for k in range(round(SECONDS * 20)):
        piece = int(k / 20 / PIECE)
        (v, w), stamp = pieces[piece], START + k * SECOND // 20
        x, y = x + v * np.cos(heading) / 20, y + v * np.sin(heading) / 20
        heading += w / 20
        for factor, (name, (_, left)) in zip(rims[piece], PLACES.items(), strict=True):
            add(f"{name}/wheel_speed", stamp, factor * (v - w * left) / 0.125)
            if soil:
                add(f"{name}/load", stamp, 60.0)
                add(f"{name}/sinkage", stamp, 0.01, 0.0)
        speed = (0.0, 0.0) if posed else (rims[piece][0] * v if of_wheels else v, w)
        pose = x, y, float(np.cos(heading)), float(np.sin(heading))
        add(ODOMETRY, stamp, *speed, *pose, 0.0, 0.0, 0.0, 0.0)
        up = (0.0, 0.0, 1.0) if oriented else (np.nan, np.nan, np.nan)
        add(IMU, stamp, w, 0.0, v * w, 9.80665, *up, 0.0)
    of = rover if soil else static_rover
    return of(**{"twist.publish": True}), rows


def assert_finite(turn: Turn) -> None:
    for table in (turn.readings, turn.estimates, turn.vehicle, turn.warned, turn.twists):
        for name, column in {} if table is None else vars(table).items():
            values = np.asarray(column)
            assert values.dtype.kind not in "fc" or not np.isinf(values).any(), name


@settings(max_examples=12, deadline=None)
@given(drive=drives())
def test_nothing_is_divided_by_a_spread_that_is_zero(drive: tuple[NodeSettings, list[Row]]) -> None:
    vehicle, rows = drive
    pipeline = Pipeline(vehicle.onboard)
    give(pipeline.streams, rows)
    with np.errstate(divide="raise", over="raise"):
        turns = list(pipeline.turns(last=True))
    for turn in turns:
        assert_finite(turn)
    assert sum(len(turn.readings) for turn in turns) > 100
