# SPDX-License-Identifier: Apache-2.0
"""Serialised messages into streams: one by one or together is the same, and what is no message is counted."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from rows_of_drives import assert_same
from topic_messages import Fed, joints, odometry, sinkage, step, wrench

from smallwheel_ros.bags import typestore
from smallwheel_ros.drive.feed import Message, feed
from smallwheel_ros.pipeline.intake.decoder import Decoder
from smallwheel_ros.pipeline.tables import Readings, none_of

JOINT = {"front.joint": "front_joint"}


def messages(count: int) -> list[tuple[str, Any]]:
    """Rolling at 0.3 m/s with a slip of 0.1: of each topic by its last word."""
    found: list[tuple[str, Any]] = []
    for i in range(count):
        stamp = step(i)
        found += [
            ("odom", odometry(stamp, 0.006 * i, 0.3)),
            ("joint_states", joints(stamp, [0.3 / 0.9 / 0.125], [0.0], ["front_joint"])),
            ("load", wrench(stamp, 60.0)),
            ("sinkage", sinkage(stamp, 0.012)),
        ]
    return found


def fed(given: list[tuple[str, Any]], size: int) -> tuple[Fed, Readings]:
    """A pipeline after these messages, in chunks of that many, and its readings."""
    one = Fed(**JOINT)
    names = {name.rpartition("/")[2]: name for name in one.topics}
    decoders = {name: Decoder(typestore(), topic.type) for name, topic in one.topics.items()}
    recorded: list[Message] = []
    for word, message in given:
        raw = message
        if not isinstance(message, bytes):
            raw = bytes(typestore().serialize_cdr(message, one.topics[names[word]].type))
        recorded.append((names[word], raw, 0))
    for i in range(0, len(recorded), size):
        feed(one.pipeline, one.topics, decoders, recorded[i : i + size])
    turns = list(one.turns(last=True))
    return one, Readings.joined([none_of(Readings), *(turn.readings for turn in turns)])


@pytest.mark.parametrize("size", [7, 1000])
def test_chunks_change_nothing(size: int) -> None:
    (_, alone), (_, together) = fed(messages(150), 1), fed(messages(150), size)
    assert len(alone) > 100
    assert np.nanmedian(alone.slip) == pytest.approx(0.1, abs=0.01)
    assert_same(alone, together)


def test_what_is_no_message_is_counted_and_the_rest_goes_on() -> None:
    one, rows = fed([*messages(60), ("odom", b"no message"), *messages(150)[240:]], 50)
    assert len(rows) > 100
    assert one.counts[("odom", "not_readable")] == 1


def test_joint_states_without_the_joint_are_said() -> None:
    other = joints(step(0), [1.0], [0.0], ["arm"])
    one, _ = fed([("joint_states", other)] * 3, 2)
    assert one.counts[("front/wheel_speed", "no_value")] == 3


def test_a_joint_that_a_message_names_twice_has_no_value_and_others_have() -> None:
    def twice(i: int) -> Any:
        speeds = [0.3 / 0.9 / 0.125, 7.0]
        return joints(step(i), speeds, [0.0, 0.0], ["front_joint", "front_joint"])

    good = messages(150)
    mixed = [
        (word, twice(i // 4) if word == "joint_states" and i < 200 else message)
        for i, (word, message) in enumerate(good)
    ]
    one, rows = fed(mixed, 50)
    assert one.counts[("front/wheel_speed", "no_value")] == 50
    assert one.pipeline.streams.words["front/wheel_speed", "no_value"] == (
        "topic joint_states names joint front_joint 2 times in one message, so its value is not known: give"
        " each joint a name of its own"
    )
    assert np.nanmedian(rows.slip) == pytest.approx(0.1, abs=0.01)  # of the others
