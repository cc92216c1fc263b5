# SPDX-License-Identifier: Apache-2.0
"""Says why a bag has no usable topic of a type: no topic, no message, no definition, or another robot's."""

from __future__ import annotations

from smallwheel_ros.bags import BagReader

_TF = "tf2_msgs/msg/TFMessage"


def absent(reader: BagReader, kind: str, namespace: str | None = None) -> str:
    """Words for a message on why a bag has no usable topic of a type, such as "no topic of type ...".

    They begin a sentence; the caller appends the consequence.

    Parameters
    ----------
    reader
        A bag without such a topic.
    kind
        The type, such as ``"nav_msgs/msg/Odometry"``.
    namespace
        Namespace of the robot that the user chose; None for any.
    """
    there = [topic for topic in reader.topics if topic.type == kind]
    if not there:
        return f"no topic of type {kind}"
    names = ", ".join(topic.name for topic in there)
    if not any(topic.message_count for topic in there):
        return f"no message of {names} ({kind})"
    if not any(topic.message_count and topic.readable for topic in there):
        return f"no definition of {names} ({kind}) that can be read"
    return f"no topic of type {kind} in the namespace {str(namespace).strip('/')}, but {names}"


def of_transforms(reader: BagReader) -> str:
    """Words, to be appended, on transforms not being read as poses; empty if the bag has no transforms."""
    names = [topic.name for topic in reader.topics if topic.type == _TF and topic.message_count]
    if not names:
        return ""
    return f"; {names[0]} may tell the pose, but is not read as one: publish it as odometry"
