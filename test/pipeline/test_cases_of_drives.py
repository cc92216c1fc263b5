# SPDX-License-Identifier: Apache-2.0
"""Two drives that went wrong once: a gyro of the wrong sign, and a side that starts before the other."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from rows_of_drives import START, Row, give

from smallwheel_ros.common.stamps import SECOND
from smallwheel_ros.onboard.parameters import settings_from
from smallwheel_ros.onboard.settings import IMU, ODOMETRY, NodeSettings
from smallwheel_ros.pipeline.pipeline import Pipeline
from smallwheel_ros.pipeline.tables import Readings

RADIUS, HALF, SLIP = 0.3, 0.54, 0.1  # m, m, of every rim
NAMES = ("front_left", "front_right", "rear_left", "rear_right")


def skid_steered(**parameters: object) -> NodeSettings:
    """A vehicle of 280 kg whose wheels are measured by encoders alone."""
    given: dict[str, object] = {"wheels": list(NAMES), "vehicle.mass": 280.0, "imu_topic": "imu"}
    given |= {"load.source": "static"}
    for name in NAMES:
        given |= {f"{name}.diameter": 2 * RADIUS, f"{name}.width": 0.2, f"{name}.sinkage_topic": ""}
        given[f"{name}.lateral_position"] = HALF if name.endswith("left") else -HALF
        given[f"{name}.longitudinal_position"] = 0.5 if name.startswith("front") else -0.5
    return settings_from(given | parameters)


def in_arcs(sign: float) -> list[Row]:
    """Every rim slips by 0.1; odometry and wheels are right, the gyro has the sign given."""
    rng, rows = np.random.default_rng(1), []
    x = y = yaw = 0.0
    for k in range(1800):
        t, stamp = k * 0.05, START + k * SECOND // 20
        v, w = (1.0 + 0.2 * np.sin(t / 7), 0.5 * np.sin(t / 5)) if t > 3.0 else (0.0, 0.0)
        x, y, yaw = x + v * np.cos(yaw) * 0.05, y + v * np.sin(yaw) * 0.05, yaw + w * 0.05
        sides = [
            (v + side * HALF * w) / (1.0 - SLIP) / RADIUS * (1 + 0.002 * rng.normal())
            for side in (-1.0, 1.0)
        ]
        for i, name in enumerate(NAMES):
            rows.append((f"{name}/wheel_speed", stamp, (float(sides[i % 2]),), stamp))
        felt = 0.05 * rng.normal(size=3) + (0.0, v * w, 9.81)
        gyro = sign * w + 0.003 * rng.normal()
        rows.append((IMU, stamp, (gyro, *felt.tolist(), *[np.nan] * 4), stamp))
        if k % 2 == 0:
            twist = v + 0.01 * rng.normal(), w + 0.005 * rng.normal()
            pose = x, y, float(np.cos(yaw)), float(np.sin(yaw))
            rows.append((ODOMETRY, stamp, (*twist, *pose, 0.0, 0.0, 0.0, 0.0), stamp))
    return rows


@cache
def slips(sign: float) -> tuple[Readings, int, list[str]]:
    """Readings, the stamp at which the gyro is doubted, and what was found."""
    pipeline = Pipeline(skid_steered().onboard)
    give(pipeline.streams, in_arcs(sign))
    turns = list(pipeline.turns(last=True))
    found = [finding.text for turn in turns for finding in turn.findings]
    began = [stamp for stamp in pipeline.checks.doubts.began if stamp]
    rows = Readings.joined([turn.readings for turn in turns])
    return rows, (*began, int(rows.stamp[0]))[0], found


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_slip_is_right_whatever_the_sign_of_the_gyro(sign: float) -> None:
    rows, doubted, found = slips(sign)
    assert any("turns the other way" in text for text in found) == (sign < 0.0)
    late = (rows.stamp > doubted) & (rows.stamp > START + 5 * SECOND) & np.isfinite(rows.slip)
    assert late.sum() > 0.5 * len(rows)
    off = np.abs(rows.slip - SLIP)[late]
    assert (off < 1.96 * rows.slip_std[late]).mean() > 0.9
    assert np.sqrt(np.mean(off**2)) < 0.02


def test_a_side_that_starts_before_the_other_has_a_twist() -> None:
    """Encoders and an imu without noise: the side at rest tells nothing of its slip."""
    pipeline = Pipeline(skid_steered(velocity_source="none", **{"twist.publish": True}).onboard)
    rows: list[Row] = []
    for k in range(200):
        t, stamp = k * 0.05, START + k * SECOND // 20
        left, right = 2.0 * (t >= 3.0), 2.0 * (t >= 4.0)
        for i, name in enumerate(NAMES):
            rows.append((f"{name}/wheel_speed", stamp, (right if i % 2 else left,), stamp))
        rows.append((IMU, stamp, (0.0, 0.0, 0.0, 9.81, *[np.nan] * 4), stamp))
    give(pipeline.streams, [row for row in rows if row[0] in pipeline.streams.all])
    with np.errstate(divide="raise"):
        turns = list(pipeline.turns(last=True))
    twists = [turn.twists for turn in turns if turn.twists is not None]
    assert sum(len(one) for one in twists) > 100
    for one in twists:
        for name, column in vars(one).items():
            assert np.isfinite(np.asarray(column, dtype=float)).all(), name
