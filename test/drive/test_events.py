# SPDX-License-Identifier: Apache-2.0
"""What happens on a drive: what becomes an event, at which time and place, and what is only counted."""

from __future__ import annotations

import numpy as np

from smallwheel_ros.drive.events import DriveEvents, newest_of
from smallwheel_ros.onboard.parameters import settings_from
from smallwheel_ros.pipeline.pipeline import Pipeline

SECOND = 1_000_000_000
ROVER: dict[str, object] = {"wheels": ["front", "rear"]} | {
    f"{wheel}.{name}": value
    for wheel in ("front", "rear")
    for name, value in (("diameter", 0.25), ("width", 0.1), ("sinkage_topic", ""))
}


def drive(pipeline: Pipeline, first: int, last: int) -> None:
    """Give what comes at 20 Hz, between two numbers of instants."""
    for i in range(first, last):
        stamp = SECOND * i // 20
        pipeline.streams.add("odom", stamp, (0.3, 0.0, 0.015 * i, *[0.0] * 2, 1.0, *[0.0] * 4))
        for wheel in ("front", "rear"):
            pipeline.streams.add(f"{wheel}/wheel_speed", stamp, (2.6,))
            pipeline.streams.add(f"{wheel}/load", stamp, (40.0,))


def test_a_jump_of_time_is_an_event_and_a_bad_number_is_an_example() -> None:
    pipeline = Pipeline(settings_from(ROVER).onboard)
    events = DriveEvents(pipeline, 0)
    drive(pipeline, 100, 200)
    pipeline.streams.add("front/load", 10 * SECOND, (float("nan"),))
    events.take_problems(10 * SECOND)
    assert events.events == []
    (about,) = events.examples
    assert about[0] == "front/load"
    assert events.examples[about][1] == 10.0  # s since the beginning
    drive(pipeline, 0, 3)  # a bag that is played once more
    events.take_problems(11 * SECOND)
    assert [(event.kind, event.time) for event in events.events] == [("time_jump", 11.0)]
    events.take_problems(12 * SECOND)
    assert len(events.events) == 1  # what is not new is not noted again


def test_the_way_is_that_of_the_wheel_that_came_farthest() -> None:
    pipeline = Pipeline(settings_from(ROVER).onboard)
    events = DriveEvents(pipeline, 0)
    drive(pipeline, 0, 400)
    farthest = 0.0
    for turn in pipeline.turns():
        events.take(turn)
        if len(turn.readings):
            farthest = max(farthest, float(turn.readings.distance.max()))
    assert events.travel == farthest > 5.0
    assert events.soil_changes == 0


def test_the_newest_row_of_each_wheel_is_kept() -> None:
    pipeline = Pipeline(settings_from(ROVER).onboard)
    drive(pipeline, 0, 200)
    tables = [turn.estimates for turn in pipeline.turns() if len(turn.estimates)]
    drive(pipeline, 200, 400)
    tables += [turn.estimates for turn in pipeline.turns() if len(turn.estimates)]
    newest = tables[0]
    for table in tables[1:]:
        newest = newest_of(newest, table)
    assert sorted(newest.wheel.tolist()) == [0, 1]
    for wheel in (0, 1):
        stamps = np.concatenate([table.stamp[table.wheel == wheel] for table in tables])
        assert newest.stamp[newest.wheel == wheel] == stamps.max()
