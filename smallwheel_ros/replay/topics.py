"""What is in a bag, and which of its topics may be which input of the node."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from difflib import SequenceMatcher
from pathlib import Path
from typing import Any

from smallwheel_ros.bag_files import BagError, BagTopic
from smallwheel_ros.bags import BagReader
from smallwheel_ros.onboard.streams import SECOND
from smallwheel_ros.replay.inputs import Input, missing_inputs

_JOINTS = "sensor_msgs/msg/JointState"
_ROLES = {
    "geometry_msgs/msg/WrenchStamped": "a wheel's load",
    "smallwheel_ros/msg/WheelSinkage": "a wheel's sinkage",
    "sensor_msgs/msg/Range": "a wheel's sinkage by range",
    "nav_msgs/msg/Odometry": "odom",
    "geometry_msgs/msg/TwistStamped": "velocity",
    _JOINTS: "joint_states",
}
_SHORT = {
    "f": ("front",), "r": ("rear", "right"), "l": ("left",), "b": ("rear",), "m": ("middle",),
    "fl": ("front", "left"), "fr": ("front", "right"), "lf": ("front", "left"),
    "rf": ("front", "right"), "rl": ("rear", "left"), "rr": ("rear", "right"),
    "bl": ("rear", "left"), "br": ("rear", "right"), "lr": ("rear", "left"),
    "ml": ("middle", "left"), "mr": ("middle", "right"), "back": ("rear",), "hind": ("rear",),
    "mid": ("middle",), "centre": ("middle",), "center": ("middle",),
}  # fmt: skip
_KNOWN = {"front", "rear", "left", "right", "middle"}
_FAIR = 0.5


@dataclass(frozen=True)
class Proposal:
    """A topic, or for wheel speeds a joint, that may be an input which the bag lacks."""

    input: Input
    found: str

    @property
    def option(self) -> str:
        """What to add to the command, or to the parameter file."""
        if self.input.kind == "wheel_speed" and not self.found.startswith("/"):
            return f"{self.input.wheel}.joint: {self.found}   (in the parameter file)"
        return f"--remap {self.input.name}:={self.found}"


def _words(name: str) -> set[str]:
    """Words of a name; short forms of places are spelled out."""
    found: set[str] = set()
    for word in re.findall(r"[a-z]+|\d+", re.sub(r"([a-z])([A-Z])", r"\1_\2", name).lower()):
        found.update(_SHORT.get(word, (word,)))
    return found


def _likeness(wheel: str, kind: str, name: str) -> float:
    """How much a topic's or joint's name looks like that of a wheel's input; 0 to 1."""
    wanted, there = _words(wheel), _words(name)
    places, others = wanted & _KNOWN, there & _KNOWN
    if others - places and places - others:
        return 0.0  # the place of another wheel
    share = len(wanted & there) / max(len(wanted), 1)
    letters = SequenceMatcher(None, f"{wheel}/{kind}", name.strip("/")).ratio()
    return 0.7 * share + 0.3 * letters


def _best(wheel: str, kind: str, names: Iterable[str]) -> str | None:
    scored = sorted(((_likeness(wheel, kind, name), name) for name in names), reverse=True)
    if not scored or scored[0][0] < _FAIR:
        return None
    if len(scored) > 1 and scored[1][0] == scored[0][0]:
        return None  # nothing tells the two apart
    return scored[0][1]


def proposals(reader: BagReader, inputs: Sequence[Input]) -> list[Proposal]:
    """Say which of the bag's topics may be the inputs that it lacks under their names."""
    lost = [entry.input for entry in missing_inputs(inputs, reader.topics)]
    taken = {item.topic for item in inputs if item not in lost}
    found: dict[str, Proposal] = {}  # by the node's name: all wheels share the joint states
    for item in lost:
        free = [
            t.name
            for t in reader.topics
            if t.type == item.type and t.message_count and t.name not in taken
        ]
        if item.wheel and item.type != _JOINTS:
            name = _best(item.wheel, item.kind, free)
        else:
            name = free[0] if len(free) == 1 else _best(item.name, "", free)
        if name is not None:
            found.setdefault(item.name, Proposal(item, name))
    turning = [item for item in inputs if item.kind == "wheel_speed"]
    topics = {item.topic for item in turning if item not in lost}
    topics |= {p.found for p in found.values() if p.input.type == _JOINTS}
    joints = [name for topic in sorted(topics) for name in _joint_names(reader, topic)]
    more = []
    for item in turning:
        if joints and item.detail.removeprefix("joint ") not in joints:
            name = _best(item.wheel, "joint", joints)
            if name is not None:
                more.append(Proposal(item, name))
    return [*found.values(), *more]


def _joint_names(reader: BagReader, topic: str) -> list[str]:
    """Return the joints in the first message of a topic of JointState."""
    with suppress(BagError):  # damaged, or defined otherwise than here
        for message in reader.messages({topic}):
            return [str(name) for name in getattr(message.message, "name", [])]
    return []


def proposal_text(reader: BagReader, inputs: Sequence[Input], bag: Path) -> str:
    """Say what to do about inputs that a bag lacks."""
    lines = [proposal.option for proposal in proposals(reader, inputs)]
    if lines:
        return "These may be them:\n  " + "\n  ".join(lines)
    return f"`smallwheel replay {bag} --topics` lists what is in the bag; use --remap NAME:=TOPIC"


def topics_document(
    reader: BagReader, inputs: Sequence[Input], offered: Sequence[Proposal]
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
        "proposals": [
            {"input": p.input.stream, "found": p.found, "add": p.option} for p in offered
        ],
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
