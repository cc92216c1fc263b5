# SPDX-License-Identifier: Apache-2.0
"""Which topic of a bag is which input of the node, and which ones may be those that it lacks."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from smallwheel_ros.bags import BagReader, BagTopic
from smallwheel_ros.bags.storage import Key
from smallwheel_ros.init import from_bag
from smallwheel_ros.init.from_bag import JOINTS, joint_names
from smallwheel_ros.init.rover import best_match, only_or_best_match
from smallwheel_ros.onboard.feed import Topic
from smallwheel_ros.onboard.onboard import Onboard
from smallwheel_ros.onboard.parameters import NODE_NAME
from smallwheel_ros.onboard.settings import ODOMETRY, VELOCITY
from smallwheel_ros.onboard.streams import SECOND
from smallwheel_ros.replay.spec import ReplayError

_NAME = re.compile(r"[~/A-Za-z_][\w/~]*")


@dataclass(frozen=True)
class Input:
    """A topic that the node listens to, for one stream of the estimate (`Onboard.streams`).

    name: as the node knows it. topic: after remaps. detail: which part of the message, in words.
    lacking: why the bag does not give it, in words; empty where it does.
    """

    stream: str
    name: str
    topic: str
    type: str
    detail: str = ""
    lacking: str = ""

    def __str__(self) -> str:
        """Say what is missing, of which type, and why."""
        detail = f", {self.detail}" if self.detail else ""
        return f"{self.topic} ({self.type}{detail}): {self.lacking}"

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


def in_bag(name: str, remaps: Mapping[str, str]) -> str:
    """Return the bag's name of a topic that the node knows by `name`."""
    return remaps.get(resolved(name), resolved(name))


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
    topics: Sequence[Topic],
    there: Sequence[BagTopic],
    remaps: Mapping[str, str],
    description_topic: str = "",
    unusable: Mapping[Key, str] | None = None,
) -> tuple[Input, ...]:
    """Say by which topic each stream of the estimate comes, and why not where it does not.

    there: the bag's topics. description_topic: of the robot description, which is no stream, but may be
    remapped too. unusable: topics and types of which the bag's definition cannot be used, and why.

    Raises
    ------
    ReplayError
        If a remap names no input of the node.
    """
    known = {resolved(name) for name in (*(t.name for t in topics), description_topic) if name}
    for name in remaps:
        if name not in known:
            raise ReplayError(
                f"remap of {name}: the node has no such input; it has {', '.join(sorted(known))}"
            )
    inputs = []
    for topic in topics:
        name = in_bag(topic.name, remaps)
        types = [found.type for found in there if found.name == name and found.message_count]
        lacking = (unusable or {}).get((name, topic.type), "")
        if not types:
            lacking = "not in the bag"
        elif topic.type not in types:
            lacking = f"the bag has it as {', '.join(types)}"
        for stream, detail in topic.streams.items():
            words = detail.removeprefix(", ")
            inputs.append(Input(stream, resolved(topic.name), name, topic.type, words, lacking))
    return tuple(inputs)


def check_enough(onboard: Onboard, inputs: Sequence[Input], hint: Callable[[], str]) -> None:
    """Raise ReplayError unless at least one wheel has what an estimate needs.

    hint: what to do about it, in words.
    """
    missing = [item for item in inputs if item.lacking]
    lost = {item.stream for item in missing}
    for wheel in onboard.settings.wheels:
        if not {f"{wheel.name}/load", f"{wheel.name}/sinkage"} & lost:
            return
    lines = "".join(f"\n  {entry}" for entry in missing)
    raise ReplayError(
        f"nothing can be estimated: no wheel has load and sinkage in this bag. Missing:{lines}\n"
        f"{hint()}"
    )


_ROLES = {
    from_bag.WRENCH: "a wheel's load",
    from_bag.SINKAGE: "a wheel's sinkage",
    from_bag.RANGE: "a wheel's sinkage by range",
    from_bag.ODOMETRY: "odom",
    from_bag.TWIST: "velocity",
    JOINTS: "joint_states",
}


def proposals(reader: BagReader, inputs: Sequence[Input]) -> list[dict[str, str]]:
    """Say which of the bag's topics, or joints, may be the inputs that it lacks under their names.

    Of each the `input`, what was `found`, and what to `add` to the command or the parameter file.
    """
    lost = [item for item in inputs if item.lacking]
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
            name = only_or_best_match(item.name, free)
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
        "missing": [str(item) for item in inputs if item.lacking],
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
