"""Which topic of a bag is which input of the node, by the node's parameters and remaps."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from smallwheel_ros.bags import BagTopic
from smallwheel_ros.onboard.feed import Topic
from smallwheel_ros.onboard.onboard import Onboard
from smallwheel_ros.onboard.parameters import NODE_NAME
from smallwheel_ros.onboard.settings import ODOMETRY, VELOCITY
from smallwheel_ros.replay.spec import ReplayError

LOAD = "geometry_msgs/msg/WrenchStamped"
SINKAGE = "smallwheel_ros/msg/WheelSinkage"
RANGE = "sensor_msgs/msg/Range"
ODOMETRY_TYPE = "nav_msgs/msg/Odometry"
VELOCITY_TYPE = "geometry_msgs/msg/TwistStamped"
JOINTS = "sensor_msgs/msg/JointState"
CLOCK = "/clock"
_NAME = re.compile(r"[~/A-Za-z_][\w/~]*")


@dataclass(frozen=True)
class Input:
    """A topic that the node listens to, for one stream of the estimate (`Onboard.streams`).

    name: as the node knows it. topic: after remaps. detail: which part of the message, in words.
    """

    stream: str
    name: str
    topic: str
    type: str
    detail: str = ""

    @property
    def kind(self) -> str:
        """What it measures: load, sinkage, wheel_speed, odom or velocity."""
        return self.stream.partition("/")[2] or self.stream

    @property
    def wheel(self) -> str:
        """The wheel's name; empty for what is the vehicle's."""
        return "" if self.stream in (ODOMETRY, VELOCITY) else self.stream.partition("/")[0]


def resolved(name: str) -> str:
    """Return a topic's full name, as ROS does for the node in the root namespace."""
    if name.startswith("~"):
        return f"/{NODE_NAME}/{name[1:].lstrip('/')}"
    return name if name.startswith("/") else f"/{name}"


def read_remaps(given: Iterable[str]) -> dict[str, str]:
    """Read remaps as ROS writes them, ``odom:=/rover/odom``: the node's name, then the bag's.

    Raises
    ------
    ReplayError
        If one is not of that form, or a name is remapped twice.
    """
    remaps: dict[str, str] = {}
    for text in given:
        old, sign, new = text.partition(":=")
        if not (sign and _NAME.fullmatch(old) and _NAME.fullmatch(new)):
            raise ReplayError(
                f"remap {text!r}: expected NAME:=TOPIC, first the node's name, then the bag's:"
                " odom:=/rover/odom"
            )
        if resolved(old) in remaps:
            raise ReplayError(f"remap {text!r}: {old} is remapped twice")
        remaps[resolved(old)] = resolved(new)
    return remaps


def inputs_of(
    topics: Sequence[Topic], remaps: Mapping[str, str], description_topic: str = ""
) -> tuple[Input, ...]:
    """Say by which topic each stream of the estimate comes.

    description_topic: of the robot description, which is no stream, but may be remapped too.

    Raises
    ------
    ReplayError
        If a remap names no input of the node.
    """
    inputs = []
    for topic in topics:
        name = resolved(topic.name)
        for stream, detail in topic.streams.items():
            place = remaps.get(name, name)
            inputs.append(Input(stream, name, place, topic.type, detail.removeprefix(", ")))
    known = {item.name for item in inputs}
    if description_topic:
        known.add(resolved(description_topic))
    for name in remaps:
        if name not in known:
            raise ReplayError(
                f"remap of {name}: the node has no such input; it has {', '.join(sorted(known))}"
            )
    return tuple(inputs)


@dataclass(frozen=True)
class Missing:
    """An input that the bag does not have, and why."""

    input: Input
    why: str

    def __str__(self) -> str:
        """Say what is missing, of which type."""
        detail = f", {self.input.detail}" if self.input.detail else ""
        return f"{self.input.topic} ({self.input.type}{detail}): {self.why}"


def missing_inputs(
    inputs: Sequence[Input],
    topics: Sequence[BagTopic],
    unusable: Mapping[tuple[str, str], str] | None = None,
) -> list[Missing]:
    """Say of each input whether the bag lacks it, or has it in another type.

    unusable: topics and types of which the bag's definition cannot be used, and why.
    """
    types: dict[str, list[str]] = {}
    for topic in topics:
        if topic.message_count:
            types.setdefault(topic.name, []).append(topic.type)
    found = []
    for item in inputs:
        there = types.get(item.topic)
        why = (unusable or {}).get((item.topic, item.type), "")
        if there is None:
            why = "not in the bag"
        elif item.type not in there:
            why = f"the bag has it as {', '.join(there)}"
        if why:
            found.append(Missing(item, why))
    return found


def check_enough(onboard: Onboard, missing: Sequence[Missing], hint: str) -> None:
    """Raise ReplayError unless at least one wheel has what an estimate needs.

    hint: what to do about it, in words.
    """
    lost = {entry.input.stream for entry in missing}
    for wheel in onboard.settings.wheels:
        needed = {f"{wheel.name}/load", f"{wheel.name}/sinkage"} & set(onboard.streams)
        if not needed & lost:
            return
    lines = "".join(f"\n  {entry}" for entry in missing)
    raise ReplayError(
        f"nothing can be estimated: no wheel has load and sinkage in this bag. Missing:{lines}\n"
        f"{hint}"
    )
