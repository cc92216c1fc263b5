# SPDX-License-Identifier: Apache-2.0
"""Which topic of a bag is which input of the node, by the node's parameters and remaps."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from smallwheel_ros.bags import BagTopic
from smallwheel_ros.bags.storage import Key
from smallwheel_ros.onboard.feed import Topic
from smallwheel_ros.onboard.onboard import Onboard
from smallwheel_ros.onboard.parameters import NODE_NAME
from smallwheel_ros.onboard.settings import ODOMETRY, VELOCITY
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
    topics: Sequence[Topic], remaps: Mapping[str, str], description_topic: str = ""
) -> tuple[Input, ...]:
    """Say by which topic each stream of the estimate comes.

    description_topic: of the robot description, which is no stream, but may be remapped too.

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
        names = resolved(topic.name), in_bag(topic.name, remaps)
        for stream, detail in topic.streams.items():
            inputs.append(Input(stream, *names, topic.type, detail.removeprefix(", ")))
    return tuple(inputs)


def missing_inputs(
    inputs: Sequence[Input], topics: Sequence[BagTopic], unusable: Mapping[Key, str] | None = None
) -> list[Input]:
    """Return the inputs that the bag lacks, or has in another type.

    unusable: topics and types of which the bag's definition cannot be used, and why.
    """
    found = []
    for item in inputs:
        types = [t.type for t in topics if t.name == item.topic and t.message_count]
        why = (unusable or {}).get((item.topic, item.type), "")
        if not types:
            why = "not in the bag"
        elif item.type not in types:
            why = f"the bag has it as {', '.join(types)}"
        if why:
            found.append(replace(item, lacking=why))
    return found


def check_enough(onboard: Onboard, missing: Sequence[Input], hint: str) -> None:
    """Raise ReplayError unless at least one wheel has what an estimate needs.

    hint: what to do about it, in words.
    """
    lost = {entry.stream for entry in missing}
    for wheel in onboard.settings.wheels:
        if not {f"{wheel.name}/load", f"{wheel.name}/sinkage"} & lost:
            return
    lines = "".join(f"\n  {entry}" for entry in missing)
    raise ReplayError(
        f"nothing can be estimated: no wheel has load and sinkage in this bag. Missing:{lines}\n"
        f"{hint}"
    )
