# SPDX-License-Identifier: Apache-2.0
"""The zero of the imu, told from the ground by turns; what it and wheels that are not listed are worth."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest
from rows_of_drives import PLACES, G, Row, drive, rover, run

from smallwheel_ros.common.stamps import SECOND
from smallwheel_ros.physics.wheel import GRAVITY
from smallwheel_ros.pipeline.pipeline import Pipeline
from smallwheel_ros.pipeline.rows.level import Level
from smallwheel_ros.pipeline.soil.sensors import Weighing
from smallwheel_ros.pipeline.soil.stretches import Stretches
from smallwheel_ros.pipeline.strength.filter import LEVEL_STD, news
from smallwheel_ros.pipeline.strength.forces import LEVEL
from smallwheel_ros.pipeline.tables import Readings

ZERO = 0.05  # tangent, nose up
GROUND = 0.08  # tangent of the slope of the ground, east


def shown(turn: float, seconds: float = 30.0) -> Readings:
    """Rows of a vehicle at 0.3 m/s that turns (rad/s) on a slope, its imu mounted 3 degrees nose up."""
    t = np.arange(0.0, seconds, 0.05)
    heading = turn * t
    rng = np.random.default_rng(1)
    columns = {f.name: np.full(t.size, np.nan) for f in fields(Readings)}
    slope = GROUND * np.cos(heading) + ZERO + 0.002 * rng.standard_normal(t.size)
    columns |= {"slope": GRAVITY * slope, "across": -GRAVITY * GROUND * np.sin(heading)}
    columns |= {"stamp": (t * SECOND).astype(np.int64) + 10**18, "distance": 0.3 * t}
    return Readings(**(columns | {"heading": heading}))


def test_turns_tell_the_zero_and_the_straight_does_not() -> None:
    turned, straight = Level(), Level()
    turned.take(shown(0.2))
    straight.take(shown(0.0))
    last = np.array([10**18 + 30 * SECOND])
    value, deviation = turned.at(last)[0]
    assert abs(value - GRAVITY * ZERO) < 3.0 * deviation
    assert deviation < 0.7 * LEVEL_STD
    assert straight.at(last)[0, 1] > 0.9 * LEVEL_STD


@pytest.mark.parametrize("cuts", [(7,), (1, 2, 3, 250, 251), tuple(range(10, 600, 10))])
def test_where_blocks_are_cut_does_not_matter(cuts: tuple[int, ...]) -> None:
    rows = shown(0.2)
    whole, parts = Level(), Level()
    whole.take(rows)
    for part in np.split(np.arange(len(rows)), cuts):
        parts.take(rows.take(part))
    np.testing.assert_allclose(parts.at(rows.stamp), whole.at(rows.stamp), rtol=1e-12)
    whole.forget(int(rows.stamp[-1]))
    np.testing.assert_array_equal(whole.at(rows.stamp[-1:]), parts.at(rows.stamp[-1:]))


def test_what_is_not_known_tells_nothing() -> None:
    level, rows = Level(), shown(0.2)
    nothing = {name: np.full(len(rows), np.nan) for name in ("slope", "across", "heading")}
    level.take(Readings(**(vars(rows) | nothing)))
    assert level.at(rows.stamp[-1:]).tolist() == [[0.0, pytest.approx(LEVEL_STD, rel=0.01)]]


def test_news_are_the_rest() -> None:
    wider, value, precision = news((0.1, 0.2), (0.15, 0.1))
    assert wider == 0.0
    assert (0.1 / 0.04 + value) / (25.0 + precision) == pytest.approx(0.15)
    assert news((0.1, 0.1), (0.1, 0.2)) == (pytest.approx(0.03), 0.0, 0.0)


def mounted(rows: list[Row], zero: float) -> list[Row]:
    """The same drive with an imu that is mounted nose up by a tangent."""
    tilted = []
    for name, stamp, values, now in rows:
        if name == "imu":
            yaw, felt, *rest = values
            values = yaw, felt + zero * G, *rest
        tilted.append((name, stamp, values, now))
    return tilted


def test_the_strength_takes_the_zero_for_no_slope() -> None:
    vehicle = rover()
    rows = mounted(drive(40.0, turn=lambda t: 0.25 + 0.0 * t), ZERO)
    whole, cut = Pipeline(vehicle.onboard), Pipeline(vehicle.onboard)
    run(vehicle, rows, pipeline=whole)
    run(vehicle, rows, tuple(range(100, len(rows), 333)), pipeline=cut)
    believed = whole.strengths.now.kalman
    assert whole.strengths.steps > 20
    assert believed.x[LEVEL] == pytest.approx(G * ZERO, abs=3.0 * believed.P[LEVEL, LEVEL] ** 0.5)
    np.testing.assert_allclose(cut.strengths.now.kalman.x, believed.x, rtol=1e-9, atol=1e-9)


# ---- All loads against the mass


@pytest.mark.parametrize(
    ("ratio", "doubt", "share"),
    [(1.0, 0.02, 0.0), (1.0 / G, 0.02, 0.0), (0.7, 0.357, 0.3), (1.4, 0.336, 0.0)],
)
def test_a_unit_is_no_contradiction_and_what_is_missing_is_on_other_wheels(
    ratio: float, doubt: float, share: float
) -> None:
    weighing, found = Weighing(len(PLACES), 24.0), None
    for i in range(6):
        columns = {f.name: np.full(4, np.nan) for f in fields(Stretches)}
        columns |= {"wheel": np.arange(4), "load": np.full(4, 6.0 * 9.80665 * ratio)}
        columns |= {"pitch": np.zeros(4), "end": np.full(4, i + 1)}
        found = weighing.add(Stretches(**columns)) or found
    assert found is not None
    assert found.weight == pytest.approx(24.0 * 9.80665)
    assert found.weight_std / found.weight == pytest.approx(doubt, abs=0.002)
    np.testing.assert_allclose(weighing.unlisted(np.array([5, 6])), [0.0, share], atol=1e-12)
