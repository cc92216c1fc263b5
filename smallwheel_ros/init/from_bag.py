# SPDX-License-Identifier: Apache-2.0
"""A rover's parameters out of a bag, and the command `smallwheel init`, which writes them into a file.

Which topic is what, and what the bag's robot description says.
"""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

import click

from smallwheel_ros.bags import BagError, BagReader
from smallwheel_ros.common.console import JSON, show
from smallwheel_ros.common.files import check_targets, write_bytes
from smallwheel_ros.common.parameter import Value
from smallwheel_ros.init.rover import (
    FILL_IN,
    OF_A_BAG,
    InitError,
    LeftOut,
    Rover,
    best_match,
    completed,
    only_or_best_match,
    rover_of_description,
    rover_of_wheels,
    wheel_joints,
    wheels_named_by,
    with_joints,
)
from smallwheel_ros.onboard.robot_description import DESCRIPTION_TYPE, RobotDescriptionError

WRENCH = "geometry_msgs/msg/WrenchStamped"
SINKAGE = "smallwheel_ros/msg/WheelSinkage"
RANGE = "sensor_msgs/msg/Range"
ODOMETRY = "nav_msgs/msg/Odometry"
JOINTS = "sensor_msgs/msg/JointState"
TWIST = "geometry_msgs/msg/TwistStamped"
IMU = "sensor_msgs/msg/Imu"


def rover_of_bag(path: Path) -> Rover:
    """The rover of a recorded drive. Raises BagError, InitError where there is nothing of a wheel."""
    with BagReader(path, salvage=True) as reader:
        return _Finder(reader, path).rover()


class _Finder:
    """Looks through the topics of an open bag."""

    def __init__(self, reader: BagReader, path: Path) -> None:
        self.reader, self.path = reader, path
        self.notes: list[str] = []
        self.remaps: dict[str, str] = {}
        self.of: dict[str, list[str]] = {}
        for topic in reader.topics:
            if topic.message_count and topic.readable:
                self.of.setdefault(topic.type, []).append(topic.name)

    def rover(self) -> Rover:
        """What the bag tells."""
        joints_topic = self._one("joint_states", JOINTS)
        self._one("odom", ODOMETRY)
        joints = [] if joints_topic is None else joint_names(self.reader, joints_topic)
        description = self._description()
        values = self._wheels(joints, description)
        return completed(
            str(self.path), values, description, tuple(self.notes), self.remaps, self._left_out()
        )

    def _one(self, name: str, kind: str) -> str | None:
        """The topic of an input that there is once; it is remapped where it has another name."""
        topics = self.of.get(kind, [])
        found = f"/{name}" if f"/{name}" in topics else None
        if found is None and topics:
            found = only_or_best_match(name, topics)
            if found is None:
                self.notes.append(
                    f"which of {', '.join(topics)} is {name} is not clear: say --remap {name}:=TOPIC"
                )
                return None
            self.remaps[name] = found
            self.notes.append(f"assumed: {found} is {name}, the only one like it of its type")
        if found is None:
            self.notes.append(
                f"no topic of type {kind}: without {name} there is no slip and no thrust"
            )
        return found

    def _wheels(self, joints: list[str], description: str | None) -> dict[str, Value]:
        """Wheels by the topics of loads and sinkages, or by the joints of the description."""
        loads, sinkages = self._by_wheel(WRENCH), self._by_wheel(SINKAGE)
        ranges = {} if sinkages else self._by_wheel(RANGE)
        turned: dict[str, str] = {}
        if description is not None:
            with suppress(RobotDescriptionError):  # what is wrong with it is said where it is read
                turned = wheel_joints(description)
        wheels = list(loads or sinkages or ranges or turned)
        if not wheels:
            raise InitError(
                f"{self.path}: no topic of a wheel's load ({WRENCH}) or sinkage ({SINKAGE}, {RANGE}), and no "
                "robot description with wheels: `smallwheel init --wheels N` makes a file to fill in"
            )
        values: dict[str, Value] = {"wheels": wheels}
        for wheel in wheels:
            self._topic(values, wheel, "load", loads, WRENCH)
            self._topic(
                values, wheel, "sinkage", sinkages or ranges, SINKAGE if sinkages else RANGE
            )
            if ranges and f"{wheel}.sinkage_topic" in values:
                values[f"{wheel}.sinkage_source"] = "Range"
            joint = turned.get(wheel) or best_match(wheel, "joint", joints)
            if joint is not None:
                values |= {n: v for n, v in with_joints({wheel: joint}).items() if n != "wheels"}
            elif joints:
                self.notes.append(
                    f"which joint turns {wheel} is not clear: there is {', '.join(joints)}"
                )
        if not loads:
            values["load.source"] = "static"
            self.notes.append(f"no topic of type {WRENCH}: the mass is split over the wheels")
        return values

    def _by_wheel(self, kind: str) -> dict[str, str]:
        topics = self.of.get(kind, [])
        return wheels_named_by(topics) if topics else {}

    def _topic(
        self, values: dict[str, Value], wheel: str, what: str, found: dict[str, str], kind: str
    ) -> None:
        """The topic of a wheel's input, where it has another name than the node expects."""
        topic = found.get(wheel) or best_match(wheel, what, self.of.get(kind, []))
        if topic is None and what == "sinkage":
            values[f"{wheel}.sinkage_topic"] = ""
            self.notes.append(f"no topic of the sinkage of {wheel}: it is only predicted")
        elif topic is not None and (topic != f"/{wheel}/{what}" or kind == RANGE):
            values[f"{wheel}.{what}_topic"] = topic

    def _left_out(self) -> dict[str, LeftOut]:
        """What may help, and only people know."""
        found: dict[str, LeftOut] = {}
        measured = [t for t in self.of.get(TWIST, []) if "cmd" not in t]
        if measured:
            found["velocity_topic"] = LeftOut(measured[0], OF_A_BAG["velocity_topic"])
        if self.of.get(IMU):
            found["imu_topic"] = LeftOut(self.of[IMU][0], OF_A_BAG["imu_topic"])
        return found

    def _description(self) -> str | None:
        """The text of the bag's robot description, if there is one."""
        named = [t for t in self.of.get(DESCRIPTION_TYPE, []) if "robot_description" in t]
        if not named:
            return None
        with suppress(BagError):
            for message in self.reader.messages({named[0]}):
                if named[0] != "/robot_description":
                    self.remaps["robot_description"] = named[0]
                self.notes.append(f"sizes and places of wheels from {named[0]}")
                return str(message.message.data)
        return None


def joint_names(reader: BagReader, topic: str) -> list[str]:
    """Return the joints in the first message of a topic of JointState."""
    with suppress(BagError):  # damaged, or defined otherwise than here
        for message in reader.messages({topic}):
            return [str(name) for name in getattr(message.message, "name", [])]
    return []


# --- The command

_PATH = click.Path(path_type=Path)


@click.command(
    "init", short_help="A rover's parameter file, from a bag, a URDF or a number of wheels."
)
@click.argument("source", required=False, type=_PATH, metavar="[BAG|URDF]")
@click.option(
    "--urdf", type=_PATH, metavar="FILE", help="A robot description: sizes, places and joints."
)
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
    show(rover, json_file, [output])
    if rover.missing and json_file != "-":
        click.echo(f"look for {FILL_IN} in {output}")
