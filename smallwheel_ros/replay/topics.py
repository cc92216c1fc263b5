# SPDX-License-Identifier: Apache-2.0
"""What is in a bag, and which of its topics may be which input of the node."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from smallwheel_ros.bag_files import BagTopic
from smallwheel_ros.bags import BagReader
from smallwheel_ros.init.from_bag import (
    JOINTS,
    ODOMETRY,
    RANGE,
    SINKAGE,
    TWIST,
    WRENCH,
    joint_names,
)
from smallwheel_ros.init.names import best_match
from smallwheel_ros.onboard.streams import SECOND
from smallwheel_ros.replay.inputs import Input, missing_inputs

_ROLES = {
    WRENCH: "a wheel's load",
    SINKAGE: "a wheel's sinkage",
    RANGE: "a wheel's sinkage by range",
    ODOMETRY: "odom",
    TWIST: "velocity",
    JOINTS: "joint_states",
}


def proposals(reader: BagReader, inputs: Sequence[Input]) -> list[dict[str, str]]:
    """Say which of the bag's topics, or joints, may be the inputs that it lacks under their names.

    Of each the `input`, what was `found`, and what to `add` to the command or the parameter file.
    """
    names = [item.name for item in missing_inputs(inputs, reader.topics)]
    lost = [item for item in inputs if item.name in names]
    taken = {item.topic for item in inputs if item not in lost}
    found: dict[str, dict[str, str]] = {}  # by the node's name: all wheels share the joint states
    for item in lost:
        free = [
            t.name
            for t in reader.topics
            if t.type == item.type and t.message_count and t.name not in taken
        ]
        if item.wheel and item.type != JOINTS:
            name = best_match(item.wheel, item.kind, free)
        else:
            name = free[0] if len(free) == 1 else best_match(item.name, "", free)
        if name is not None and item.name not in found:
            option = f"--remap {item.name}:={name}"
            found[item.name] = {"input": item.stream, "found": name, "add": option}
    turning = [item for item in inputs if item.kind == "wheel_speed"]
    topics = {i.topic for i in turning if i not in lost}
    topics |= {found[i.name]["found"] for i in turning if i.name in found}
    joints = [name for topic in sorted(topics) for name in joint_names(reader, topic)]
    more = []
    for item in turning:
        if joints and item.detail.removeprefix("joint ") not in joints:
            name = best_match(item.wheel, "joint", joints)
            if name is not None:
                option = f"{item.wheel}.joint: {name}   (in the parameter file)"
                more.append({"input": item.stream, "found": name, "add": option})
    return [*found.values(), *more]


def proposal_text(reader: BagReader, inputs: Sequence[Input], bag: Path) -> str:
    """Say what to do about inputs that a bag lacks."""
    lines = [proposal["add"] for proposal in proposals(reader, inputs)]
    if lines:
        return "These may be them:\n  " + "\n  ".join(lines)
    return f"`smallwheel replay {bag} --topics` lists what is in the bag; use --remap NAME:=TOPIC"


def topics_document(
    reader: BagReader, inputs: Sequence[Input], offered: Sequence[dict[str, str]]
) -> dict[str, Any]:
    """Return topics, their use and the proposals as plain values."""
    used: dict[tuple[str, str], list[str]] = {}
    for item in inputs:
        used.setdefault((item.topic, item.type), []).append(item.stream)
    duration = ((reader.end_time or 0) - (reader.start_time or 0)) / SECOND
    return {
        "bag": str(reader.path),
        "damage": reader.damage,
        "duration": duration,
        "messages": reader.message_count,
        "topics": [_topic(topic, duration, used) for topic in reader.topics],
        "missing": [str(entry) for entry in missing_inputs(inputs, reader.topics)],
        "proposals": list(offered),
    }


def _topic(
    topic: BagTopic, duration: float, used: dict[tuple[str, str], list[str]]
) -> dict[str, Any]:
    streams = used.get((topic.name, topic.type), [])
    role = ", ".join(streams) if streams else _ROLES.get(topic.type, "")
    if not streams and role:
        role = f"may be {role}"
    return {
        "name": topic.name,
        "type": topic.type,
        "messages": topic.message_count,
        "rate": topic.message_count / duration if duration > 0 else None,
        "readable": topic.readable,
        "role": role if topic.readable else "its type is not known here",
    }
