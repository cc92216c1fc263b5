# SPDX-License-Identifier: Apache-2.0
"""Feeds messages of all topics, many at once, into the streams of a pipeline; for bags and for the node."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from smallwheel_ros.common.stamps import SECOND
from smallwheel_ros.onboard.idle_publisher import IDLE
from smallwheel_ros.onboard.joint_motion import BY_POSITIONS
from smallwheel_ros.pipeline.intake.decoder import Decoder
from smallwheel_ros.pipeline.intake.inputs import Topic
from smallwheel_ros.pipeline.pipeline import Pipeline
from smallwheel_ros.pipeline.tables import Array, Integers

Message = tuple[
    str, bytes, int
]  # name of the topic, serialised message, time of the clock (ns), 0 without a clock


def feed(
    pipeline: Pipeline,
    topics: Mapping[str, Topic],
    decoders: Mapping[str, Decoder],
    chunk: Sequence[Message],
) -> None:
    """Decode messages, and append their numbers to the pipeline's streams in the order of arrival.

    Messages and values that cannot be used are counted in the pipeline's problems.

    Parameters
    ----------
    pipeline
        Pipeline to whose streams the numbers are appended.
    topics
        Input topics by name, with the streams in their messages.
    decoders
        Decoder of each topic's messages, by the name of the topic.
    chunk
        Messages in the order of arrival: name of the topic, bytes (CDR), and the time of the clock (ns), 0
        without a clock.
    """
    by_topic: dict[str, list[int]] = {}
    for i, (name, _, _) in enumerate(chunk):
        by_topic.setdefault(name, []).append(i)
    streams = pipeline.streams
    parts: dict[str, list[tuple[Integers, Array, Integers]]] = {}
    for name, numbers in by_topic.items():
        order, topic = np.array(numbers), topics[name]
        bad = decoders[name].problems.copy()
        groups = decoders[name].columns([chunk[i][1] for i in numbers])
        for text, times in (decoders[name].problems - bad).items():
            streams.note(topic.streams[0], "not_readable", f"topic {name}: {text}", times)
        for index, layout, fields in groups:
            seconds, rest = (fields[f"header.stamp.{part}"][:, 0] for part in ("sec", "nanosec"))
            stamps = (seconds * SECOND + rest).astype(np.int64)  # whole numbers all the time
            joints = layout.strings.get("name", [])
            with np.errstate(all="ignore"):  # 1e308 has no square; Streams refuse it in words
                read = topic.read(fields, joints)
            for stream in topic.streams:
                if stream in read:
                    parts.setdefault(stream, []).append((stamps, read[stream], order[index]))
                    continue
                joint = topic.joints.get(stream)
                if streams.all[stream].received and joint not in joints:
                    continue  # of another publisher: each may publish some of the joints
                there = ", ".join(joints) or "no joint"
                text = f"topic {name} has no value of its joint; it has {there}"
                times = joints.count(str(joint))
                if times > 1:
                    text = (
                        f"topic {name} names joint {joint} {times} times in one message, so its value is not"
                        " known: give each joint a name of its own"
                    )
                elif joint in joints:
                    of = {"wheel_speed": "velocity or position", "steering": "position"}
                    what = of.get(stream.rpartition("/")[2], "effort")
                    text = f"topic {name} names joint {joint} without {what}"
                    again = f"{text}: is there more than one publisher?"
                    text = again if streams.all[stream].received else text
                streams.note(stream, "no_value", text, index.size)
    rows: dict[str, tuple[Integers, Array, Integers]] = {}
    for stream, groups_of in parts.items():
        if len(groups_of) == 1:  # in order already
            rows[stream] = groups_of[0]
            continue
        stamps, values, order = (np.concatenate(column) for column in zip(*groups_of, strict=True))
        sort = np.argsort(order, kind="stable")
        rows[stream] = stamps[sort], values[sort], order[sort]
    refused = _by_their_joints(pipeline, rows)
    _steered(pipeline, rows)
    streams.add_rows(rows, np.array([now for _, _, now in chunk], dtype=np.int64))
    for stream, ended in refused.items():
        if ended.size:
            streams.all[stream].end(ended)


def _by_their_joints(
    pipeline: Pipeline, rows: dict[str, tuple[Integers, Array, Integers]]
) -> dict[str, Integers]:
    """Replace rows of wheels' joints by rows of wheel speeds, in place; report once how they are computed.

    Returns by stream the stamps of messages that show that its speed is no longer known: their velocity
    is in another unit, or 0 while their position moves.
    """
    ended: dict[str, Integers] = {}
    for stream in [name for name in rows if name.endswith("/wheel_speed")]:
        stamps, values, order = rows.pop(stream)
        joint = pipeline.joints[stream]
        idle = pipeline.idle[stream].idle(stamps, values[:, 0], values[:, 1])
        if idle.any():
            pipeline.note(stream, "no_value", IDLE, int(idle.sum()))
            stamps, values, order = stamps[~idle], values[~idle], order[~idle]
        unit = pipeline.units[stream]
        stamps, values, free, refused = unit.take(stamps, values, pipeline.streams.rules.reorder)
        order = order[free]
        if refused.size:
            text = (
                unit.wrong or "its velocity disagrees with how its position changes: not yet used"
            )
            pipeline.note(stream, "velocity_unit", text, refused.size)
        before, left_out = joint.by_positions, joint.left_out
        found, speeds, index = joint.take(stamps, values[:, 0], values[:, 1], values[:, 2] > 0.0)
        if joint.by_positions and not before:
            pipeline.note(stream, "by_positions", BY_POSITIONS, unused=False)
        if times := joint.left_out - left_out:
            text = "its joint has no velocity any more: is there more than one publisher?"
            pipeline.note(stream, "no_value", text, times)
        ended[stream] = np.concatenate([refused, np.array(joint.unknown, dtype=np.int64)])
        if found.size:
            rows[stream] = found, speeds[:, None], order[index]
    return ended


def _steered(pipeline: Pipeline, rows: dict[str, tuple[Integers, Array, Integers]]) -> None:
    """Remove rows that cannot be steering angles, in place; count them, and angles that come in steps."""
    for stream in [name for name in rows if name.endswith("/steering")]:
        stamps, values, order = rows.pop(stream)
        steering = pipeline.steering[stream]
        usable = steering.usable(stamps, values[:, 0])
        if times := int((~usable).sum()):
            pipeline.note(stream, "steering_unit", steering.wrong, times)
        if steering.new_steps:
            pipeline.note(stream, "in_steps", steering.odd, steering.new_steps, unused=False)
        if usable.any():
            rows[stream] = stamps[usable], values[usable], order[usable]
