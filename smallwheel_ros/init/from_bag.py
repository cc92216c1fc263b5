# SPDX-License-Identifier: Apache-2.0
"""A rover's parameters out of a bag, and the command `smallwheel init`, which writes them into a file.

Which topic is what, and what the bag's robot description says.
"""

from __future__ import annotations

from collections import defaultdict
from contextlib import suppress
from pathlib import Path
from typing import Any

import click

from smallwheel_ros.bags import BagError, BagReader
from smallwheel_ros.common.console import JSON, tell
from smallwheel_ros.common.files import check_targets, write_bytes
from smallwheel_ros.common.parameter import Value
from smallwheel_ros.init.rover import (
    FILL_IN,
    InitError,
    Rover,
    best_match,
    joint_values,
    only_or_best_match,
    rover_of_description,
    rover_of_wheels,
    wheel_joints,
    wheels_named_by,
)
from smallwheel_ros.onboard.robot_description import DESCRIPTION_TYPE, fill_silent

WRENCH = "geometry_msgs/msg/WrenchStamped"
SINKAGE = "smallwheel_ros/msg/WheelSinkage"
RANGE = "sensor_msgs/msg/Range"
ODOMETRY = "nav_msgs/msg/Odometry"
JOINTS = "sensor_msgs/msg/JointState"
TWIST = "geometry_msgs/msg/TwistStamped"
IMU = "sensor_msgs/msg/Imu"


def rover_of_bag(path: Path) -> Rover:
    """The rover of a recorded drive. Raises BagError, InitError where there is nothing of a wheel."""
    with BagReader(path) as reader:
        return _Finder(reader).rover()


class _Finder:
    """Looks through the topics of an open bag."""

    def __init__(self, reader: BagReader) -> None:
        self._reader = reader
        self._notes: list[str] = []
        self._remaps: dict[str, str] = {}
        self._topics: defaultdict[str, list[str]] = defaultdict(list)  # names, by type
        for topic in reader.topics:
            if topic.message_count and topic.readable:
                self._topics[topic.type].append(topic.name)

    def rover(self) -> Rover:
        """What the bag tells."""
        joints_topic = self._one("joint_states", JOINTS)
        self._one("odom", ODOMETRY)
        joints = [] if joints_topic is None else joint_names(self._reader, joints_topic)
        description = self._description()
        values = self._wheels(joints, description)
        if description is not None:
            filled = fill_silent(description, values)
            values |= filled.values
            self._notes += filled.lacking
        # What may help, and only people know: whether the wheels make it, how it is mounted.
        measured = [topic for topic in self._topics[TWIST] if "cmd" not in topic]
        offers = {"imu_topic": self._topics[IMU], "velocity_topic": measured}
        return Rover(
            str(self._reader.path),
            values,
            self._remaps,
            self._notes,
            described=description is not None,
            offers={name: topics[0] for name, topics in offers.items() if topics},
        )

    def _one(self, name: str, kind: str) -> str | None:
        """The topic of an input that there is once; it is remapped where it has another name."""
        topics = self._topics[kind]
        if f"/{name}" in topics:
            return f"/{name}"
        found = only_or_best_match(name, topics)
        if found is not None:
            self._remaps[name] = found
            note = f"assumed: {found} is {name}, the only one like it of its type"
        elif topics:
            note = f"which of {', '.join(topics)} is {name} is not clear: say --remap {name}:=TOPIC"
        else:
            note = f"no topic of type {kind}: without {name} there is no slip and no thrust"
        self._notes.append(note)
        return found

    def _wheels(self, joints: list[str], description: str | None) -> dict[str, Value]:
        """Wheels by the topics of loads and sinkages, or by the joints of the description."""
        loads, sinkages = (wheels_named_by(self._topics[kind]) for kind in (WRENCH, SINKAGE))
        ranges = {} if sinkages else wheels_named_by(self._topics[RANGE])
        depths = sinkages or ranges
        turned = {} if description is None else wheel_joints(description)
        wheels = list(loads or depths or turned)
        if not wheels:
            raise InitError(
                f"{self._reader.path}: no topic of a wheel's load ({WRENCH}) or sinkage ({SINKAGE}, {RANGE}),"
                " and no robot description with wheels: `smallwheel init --wheels N` makes a file to fill in"
            )
        values: dict[str, Value] = {"wheels": wheels}
        for wheel in wheels:
            load = loads.get(wheel)
            if load is not None and load != f"/{wheel}/load":
                values[f"{wheel}.load_topic"] = load
            depth = depths.get(wheel) or best_match(wheel, "sinkage", depths.values())
            if depth is None:
                values[f"{wheel}.sinkage_topic"] = ""
                self._notes.append(f"no topic of the sinkage of {wheel}: it is only predicted")
            elif ranges or depth != f"/{wheel}/sinkage":
                values[f"{wheel}.sinkage_topic"] = depth
            if ranges:
                values[f"{wheel}.sinkage_source"] = "Range"
            joint = turned.get(wheel) or best_match(wheel, "joint", joints)
            if joint is not None:
                values |= joint_values({wheel: joint})
            elif joints:
                self._notes.append(
                    f"which joint turns {wheel} is not clear: there is {', '.join(joints)}"
                )
        if not loads:
            values["load.source"] = "static"
            self._notes.append(f"no topic of type {WRENCH}: the mass is split over the wheels")
        return values

    def _description(self) -> str | None:
        """The text of the bag's robot description, if there is one."""
        named = [topic for topic in self._topics[DESCRIPTION_TYPE] if "robot_description" in topic]
        message = _first(self._reader, named[0]) if named else None
        if message is None:
            return None
        if named[0] != "/robot_description":
            self._remaps["robot_description"] = named[0]
        self._notes.append(f"sizes and places of wheels from {named[0]}")
        return str(message.data)


def joint_names(reader: BagReader, topic: str) -> list[str]:
    """Return the joints in the first message of a topic of JointState."""
    return [str(name) for name in getattr(_first(reader, topic), "name", [])]


def _first(reader: BagReader, topic: str) -> Any | None:
    """The first message of a topic, None where it has none that can be read."""
    with suppress(BagError):  # damaged, or defined otherwise than here
        return next((message.message for message in reader.messages({topic})), None)
    return None


# --- The command

_PATH = click.Path(path_type=Path)


@click.command()
@click.argument("source", required=False, type=_PATH, metavar="[BAG|URDF]")
@click.option("--urdf", type=_PATH, metavar="FILE",
              help="A robot description: sizes, places and joints.")  # fmt: skip
@click.option("--wheels", type=int, metavar="N", help="Without either: so many wheels.")
@click.option("-o", "--output", required=True, type=_PATH, metavar="ROVER.yaml",
              help="Parameter file to write.")  # fmt: skip
@click.option("--force", is_flag=True, help="Replace a file that is there.")
@JSON
def init(
    source: Path | None,
    urdf: Path | None,
    wheels: int | None,
    output: Path,
    force: bool,
    json_file: str | None,
) -> None:
    """Write a parameter file for the node and for `smallwheel replay`.

    From a recorded drive: wheels by their topics, joints, and sizes where the bag has the robot's
    description. What nobody can find out is marked FILL_IN. Nothing that is there is replaced.
    """
    if source is not None and source.suffix.lower() in (".urdf", ".xml"):
        if urdf is not None:
            raise click.UsageError("two robot descriptions: give one")
        source, urdf = None, source
    if [source, urdf, wheels].count(None) != 2:
        raise click.UsageError("give one of: a BAG, a URDF (--urdf FILE), or --wheels N")
    check_targets([output, json_file], [source, urdf])
    if output.exists() and not force:
        raise InitError(f"{output}: is there already: give another name, or --force to replace it")
    if source is not None:
        rover = rover_of_bag(source)
    elif urdf is not None:
        rover = rover_of_description(urdf)
    else:
        rover = rover_of_wheels(wheels or 0)
    write_bytes(output, rover.parameter_file().encode())
    tell(rover.to_dict(), rover.text(), json_file, [output])
    if rover.missing and json_file != "-":
        click.echo(f"look for {FILL_IN} in {output}")
