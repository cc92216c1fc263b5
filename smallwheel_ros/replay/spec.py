# SPDX-License-Identifier: Apache-2.0
"""The specification of a replay: bag, options, the node's parameters, and which topic is which input."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from smallwheel_ros.arguments import Copy
from smallwheel_ros.bags import BagReader, Key
from smallwheel_ros.common.errors import SmallwheelError
from smallwheel_ros.common.files import write_bytes
from smallwheel_ros.common.node_parameter import Value
from smallwheel_ros.common.release import __version__
from smallwheel_ros.init.from_bag import rover_of_bag
from smallwheel_ros.init.rover import InitError
from smallwheel_ros.onboard.parameters import (
    NODE_NAME,
    ParametersError,
    idle_remaps,
    read_parameters,
    settings_from,
    unknown_parameters,
    wheel_names,
)
from smallwheel_ros.onboard.robot_description import (
    DESCRIPTION_TYPE,
    fill_silent,
    needs_description,
    silent_parameters,
)
from smallwheel_ros.onboard.settings import NodeSettings
from smallwheel_ros.pipeline.intake.inputs import Topic

_HASHED = 1 << 20  # bytes
_CONFIG = "rover.yaml"
_TOPIC_NAME = re.compile(r"[~/A-Za-z_][\w/~]*")


class ReplayError(SmallwheelError):
    """No estimate is possible from a bag, options contradict each other, or output cannot be written."""


@dataclass(frozen=True)
class ReplaySpec:
    """What to replay and how; plain values, so that it can be sent to another process or machine.

    Attributes
    ----------
    bag
        A rosbag2 folder, a .mcap or .db3 file, or a ROS 1 .bag.
    config
        The node's parameter file.
    folder
        Folder for the results.
    remaps
        Full names of topics in the bag, by the node's full names.
    clock
        Whether stamps are compared with the recorded /clock or, if there is none, with recording times;
        otherwise only with each other.
    copy
        Topics that are copied into the new bag: `all`, those that are `used`, or `none`.
    rate
        Largest number of estimates of each wheel in a second, Hz, in place of the parameter mobility.rate; 0:
        one for each measured sinkage. None: the parameter's.
    notes
        Remarks for the user, which the result repeats.
    soil_file
        File of a saved soil to start from, and to save the soil to at the end; None: none.
    """

    bag: Path
    config: Path
    folder: Path
    remaps: Mapping[str, str] = field(default_factory=dict)
    clock: bool = True
    copy: Copy = "all"
    rate: float | None = None
    notes: tuple[str, ...] = ()
    soil_file: Path | None = None

    @property
    def name(self) -> str:
        """The bag's name without folder and suffix."""
        bag = self.bag.resolve()
        return bag.name if bag.is_dir() else bag.stem

    def in_bag(self, name: str) -> str:
        """Return the full name in the bag of the topic that the node calls `name`."""
        return self.remaps.get(resolved(name), resolved(name))

    def fingerprint(self) -> str:
        """Return a SHA-256 of bag, parameters, options and this package's version, to recognise a replay.

        The bag is identified by the names, sizes, times of change and first megabytes of its files. Raises
        OSError if the bag or the parameter file cannot be read.
        """
        digest = hashlib.sha256(__version__.encode())
        files = self.bag.iterdir() if self.bag.is_dir() else [self.bag]
        for file in sorted(file for file in files if file.is_file()):
            state = file.stat()
            digest.update(f"{file.name} {state.st_size} {state.st_mtime_ns}".encode())
            with file.open("rb") as stream:
                digest.update(stream.read(_HASHED))
        digest.update(self.config.read_bytes())
        options: Any = (
            sorted(self.remaps.items()),
            self.clock,
            self.copy,
            self.rate,
            self.soil_file,
        )
        digest.update(repr(options).encode())
        return digest.hexdigest()


def resolved(name: str) -> str:
    """Return a topic's full name, resolved as ROS does for the node in the root namespace."""
    if name.startswith("~"):
        return f"/{NODE_NAME}/{name[1:].lstrip('/')}"
    return name if name.startswith("/") else f"/{name}"


def read_remaps(given: Iterable[str]) -> dict[str, str]:
    """Read remaps as ROS writes them, ``odom:=/rover/odom``: the node's name, then the bag's.

    Returns full names in the bag, by the node's full names. Raises ReplayError if one is not of that form,
    or a name is remapped twice.
    """
    remaps: dict[str, str] = {}
    for text in given:
        old, sign, new = text.partition(":=")
        if not (sign and _TOPIC_NAME.fullmatch(old) and _TOPIC_NAME.fullmatch(new)):
            raise ReplayError(
                f"remap {text!r}: expected NAME:=TOPIC, first the node's name, then the bag's:"
                " odom:=/rover/odom"
            )
        if resolved(old) in remaps:
            raise ReplayError(f"remap {text!r}: {old} is remapped twice")
        remaps[resolved(old)] = resolved(new)
    return remaps


# --- Parameters


def with_assumed_config(like: ReplaySpec) -> ReplaySpec:
    """Write a parameter file from the bag into the folder; return the specification with that file.

    Raises BagError if the bag cannot be read, and InitError if the bag does not contain enough, or the folder
    has another rover.yaml.
    """
    rover = rover_of_bag(like.bag)
    if rover.missing:
        raise InitError(
            f"{like.bag}: no parameter file was given, and the bag does not give "
            f"{', '.join(rover.missing)}: `smallwheel init {like.bag} -o {_CONFIG}` writes one; fill in "
            f"what is marked, and give it with --config {_CONFIG}"
        )
    path, text = like.folder / _CONFIG, rover.parameter_file()
    if path.exists() and path.read_text(encoding="utf-8", errors="replace") != text:
        raise InitError(
            f"{path} differs from what the bag gives: give it with --config, or remove it"
        )
    like.folder.mkdir(parents=True, exist_ok=True)
    write_bytes(path, text.encode())
    said = (
        f"no parameter file was given: {path} was written from the bag ({', '.join(rover.wheels)})"
    )
    return replace(like, config=path, notes=(said, *rover.notes))


def check_parameters(spec: ReplaySpec) -> list[str]:
    """Check the parameter file as far as that is possible without the bag.

    Returns sentences about unknown parameters. Raises ParametersError if the file cannot be read, or a
    parameter is wrong, or is missing and cannot come from a bag.
    """
    values = read_parameters(spec.config)
    if not (_description_topic(values) and needs_description(values)):
        settings_from(values)
    return unknown_parameters(values, wheel_names(values.get("wheels")))


def read_settings(spec: ReplaySpec, reader: BagReader) -> tuple[NodeSettings, list[str]]:
    """Read the parameter file, and missing parameters from the bag's robot description.

    Parameters
    ----------
    spec
        Specification of the replay.
    reader
        Open reader of its bag.

    Returns
    -------
    settings, notes : NodeSettings, list of str
        Settings of the node, and sentences on unknown parameters, on values from the robot description, and
        on remaps without effect.

    Raises
    ------
    ParametersError
        If the file cannot be read, or a parameter is missing or wrong.
    """
    values = read_parameters(spec.config)
    notes: list[str] = []
    described: Mapping[str, Value] = {}
    unknown = unknown_parameters(values, wheel_names(values.get("wheels")))
    topic = _description_topic(values)
    if topic and silent_parameters(values):
        described, notes = _described(spec.in_bag(topic), reader, values)
    if spec.rate is not None:
        values = {**values, "mobility.rate": float(spec.rate)}
    try:
        settings = settings_from(values, described)
    except ParametersError as error:
        raise ParametersError("; ".join([str(error), *notes])) from None
    notes += [why for name, why in idle_remaps(settings).items() if resolved(name) in spec.remaps]
    return settings, unknown + notes


def _description_topic(values: Mapping[str, object]) -> str:
    topic = values.get("robot_description_topic", "robot_description")
    return topic if isinstance(topic, str) else ""  # another type is found when all is checked


def _described(
    topic: str, reader: BagReader, values: Mapping[str, object]
) -> tuple[Mapping[str, Value], list[str]]:
    """Return missing parameters that the bag's first robot description gives, and notes about it."""
    if (topic, DESCRIPTION_TYPE) not in {t[:2] for t in reader.topics if t.message_count}:
        needed = needs_description(values)
        return {}, [f"no robot description: {topic} is not in the bag"] if needed else []
    try:
        texts = (m.message.data for m in reader.messages({topic}) if m.type == DESCRIPTION_TYPE)
        filled = fill_silent(next(texts, ""), values)
    except SmallwheelError as error:
        return {}, [f"robot description {topic}: {error}"]
    return filled.values, [f"from the bag's {topic}: {filled.text}", *filled.lacking]


# --- Inputs


@dataclass(frozen=True)
class Input:
    """A topic that the node listens to, for one stream of numbers of its estimator (`Pipeline.streams`).

    Attributes
    ----------
    stream
        Name of the stream, such as `front_left/load`.
    topic, type
        Name of the topic in the bag, after remaps, and type of its messages.
    detail
        The part of the message that is used, in words; empty if all of it is.
    lacking
        Why the bag does not provide it, in words; empty if it does.
    """

    stream: str
    topic: str
    type: str
    detail: str = ""
    lacking: str = ""

    def __str__(self) -> str:
        """Say what is missing, of which type, and why."""
        detail = f", {self.detail}" if self.detail else ""
        return f"{self.topic} ({self.type}{detail}): {self.lacking}"


def inputs_of(
    spec: ReplaySpec,
    topics: Sequence[Topic],
    settings: NodeSettings,
    reader: BagReader,
    unusable: Mapping[Key, str],
) -> tuple[Input, ...]:
    """List the inputs of the node's estimator, with the reason for each that the bag lacks.

    Parameters
    ----------
    spec
        Specification of the replay.
    topics
        The node's input topics.
    settings
        The node's settings.
    reader
        Open reader of the bag.
    unusable
        By topic and type, why the bag's message definition cannot be used.

    Returns
    -------
    tuple of Input
        One for each stream of each topic.

    Raises
    ------
    ReplayError
        If a remap names no input of the node.
    """
    # The robot description is no stream, but may be remapped too.
    names = [*(topic.name for topic in topics), settings.robot_description_topic]
    known = {resolved(name) for name in names if name}
    idle = {resolved(name) for name in idle_remaps(settings)}
    for name in spec.remaps:
        if name not in known | idle:
            raise ReplayError(
                f"remap of {name}: the node has no such input; it has {', '.join(sorted(known))}"
            )
    inputs = []
    for topic in topics:
        name = spec.in_bag(topic.name)
        types = [t.type for t in reader.topics if t.name == name and t.message_count]
        lacking = unusable.get((name, topic.type), "")
        if not types:
            lacking = "not in the bag"
        elif topic.type not in types:
            lacking = f"the bag has it as {', '.join(types)}"
        for stream in topic.streams:
            inputs.append(Input(stream, name, topic.type, _detail(stream, settings), lacking))
    return tuple(inputs)


def _detail(stream: str, settings: NodeSettings) -> str:
    """The part of its message that a stream of a wheel uses, in words; empty where it uses all of it."""
    wheel, _, what = stream.rpartition("/")
    own = settings.inputs.get(wheel)
    if own is None:
        return ""
    by_joint = settings.load.source == "joint_states"
    return {
        "wheel_speed": f"joint {own.joint}",
        "torque": f"effort of joint {own.joint}",
        "steering": f"joint {own.steering_joint}",
        "drawbar_pull": "force.x",
        "load": f"effort of joint {own.load_joint}" if by_joint else "",
    }.get(what, "")


def check_enough(wheels: Iterable[str], inputs: Sequence[Input], reader: BagReader) -> None:
    """Check that for at least one wheel neither the input of its load nor that of its sinkage is lacking.

    Parameters
    ----------
    wheels
        Names of the wheels.
    inputs
        All inputs, as `inputs_of` lists them.
    reader
        Open reader of the bag, for the topics that the error proposes.

    Raises
    ------
    ReplayError
        If there is no such wheel; the message lists what is missing and what to do.
    """
    missing = [item for item in inputs if item.lacking]
    lost = {item.stream for item in missing}
    if any(not {f"{wheel}/load", f"{wheel}/sinkage"} & lost for wheel in wheels):
        return
    lines = "".join(f"\n  {entry}" for entry in missing)
    kinds = {item.type for item in missing}
    there = [f"{topic.name} ({topic.type})" for topic in reader.topics if topic.type in kinds]
    raise ReplayError(
        f"nothing can be estimated: no wheel has load and sinkage in this bag. Missing:{lines}\nOf these"
        f" types the bag has {', '.join(there) or 'no topic'}; --remap NAME:=TOPIC says which is"
        " which, and `smallwheel init` looks for them by itself"
    )
