# SPDX-License-Identifier: Apache-2.0
"""What is said of refused messages: the newest refusal, and nothing that is no refusal."""

from __future__ import annotations

from collections import Counter

from rows_of_drives import START, rover

from smallwheel_ros.pipeline.pipeline import Pipeline
from smallwheel_ros.pipeline.refused import ProblemLog


def test_the_newest_refusal_is_named_whatever_came_first() -> None:
    log = ProblemLog(Counter(), {})
    log.add("imu", "not_finite", "a number is not finite at 1 s")
    log.add("imu", "late", "a message is late")
    log.add("imu", "not_finite", "a number is not finite at 12 s", 50)
    log.add("imu", "no_orientation", "no orientation: slope unknown")  # no refusal
    log.add("imu", "in_steps", "comes in steps", unused=False)
    log.add("odom", "late", "of another stream")
    (found,) = log.findings([("imu", 100)])
    assert "newest: a number is not finite at 12 s" in found


def test_so_it_is_of_messages_in_their_order() -> None:
    pipeline, nan = Pipeline(rover().onboard), float("nan")
    for i in range(30):
        pipeline.streams.add("fl/load", START + i * 50_000_000, (50.0 if i % 3 else nan,))
    pipeline.streams.add("fl/load", START, (50.0,))  # out of order
    (found,) = pipeline.findings
    assert "from all others" in found
    for i in range(30, 60):
        pipeline.streams.add("fl/load", START + i * 50_000_000, (50.0 if i % 3 else nan,))
    (found,) = pipeline.findings
    assert "from all others" not in found
