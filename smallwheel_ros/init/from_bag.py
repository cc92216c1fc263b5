# SPDX-License-Identifier: Apache-2.0
"""`init`: a rover's parameters from a bag, a robot description, or a number of wheels.

Which topic is which stream, which joint turns which wheel in which direction, and what the
description states.
"""

from collections import defaultdict
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, cast

import numpy as np

from smallwheel_ros.arguments import BagOrUrdf, Count, TopicName, Urdf
from smallwheel_ros.bags import BagError, BagReader
from smallwheel_ros.common.node_parameter import Value
from smallwheel_ros.init.absent import absent, of_transforms
from smallwheel_ros.init.joint_topics import (
    USUAL,
    free_joints,
    joint_states_of,
    of_robot,
    turning_wheels,
)
from smallwheel_ros.init.recorded import (
    JointSpeeds,
    Speed,
    is_of_wheels,
    signs_of,
    speed_of,
    times_the_way,
    unit_by_way,
    unlike_wheels,
    upright,
)
from smallwheel_ros.init.rover import (
    InitError,
    Rover,
    description_in,
    joint_values,
    rover_of_description,
    rover_of_wheels,
    wheel_joints,
)
from smallwheel_ros.init.steering_joints import joints_of, steering_values
from smallwheel_ros.onboard.joint_motion import BY_POSITIONS
from smallwheel_ros.onboard.parameters import for_each_wheel
from smallwheel_ros.onboard.robot_description import (
    DESCRIPTION_TYPE,
    described_mass,
    fill_silent,
)
from smallwheel_ros.onboard.urdf import RobotDescriptionError
from smallwheel_ros.onboard.wheel_names import (
    best_match,
    only_or_best_match,
    wheels_named_by,
)

WRENCH = "geometry_msgs/msg/WrenchStamped"
SINKAGE = "smallwheel_ros/msg/WheelSinkage"
RANGE = "sensor_msgs/msg/Range"
ODOMETRY = "nav_msgs/msg/Odometry"
JOINTS = "sensor_msgs/msg/JointState"
TWIST = "geometry_msgs/msg/TwistStamped"
IMU = "sensor_msgs/msg/Imu"


def rover_of_bag(
    path: Path,
    urdf: Path | None = None,
    joint_states: str | None = None,
    namespace: str | None = None,
) -> Rover:
    """Find the parameters of a rover in a recorded drive.

    Parameters
    ----------
    path
        The bag.
    urdf
        File of a robot description that replaces the bag's; None: the bag's, if it has one.
    joint_states
        The topic with the wheels' joints; None: it is looked for.
    namespace
        Namespace of the robot, if the bag has several; None: topics of all namespaces are used.

    Raises
    ------
    BagError, InitError
        If the bag shows nothing of a wheel, or the description cannot be used.
    """
    text = None if urdf is None else description_in(urdf)
    with BagReader(path) as reader:
        return _Finder(reader, joint_states, namespace).rover(urdf, text)


class _Finder:
    """Looks through the topics of an open bag."""

    def __init__(
        self, reader: BagReader, joint_states: str | None = None, namespace: str | None = None
    ) -> None:
        self._reader, self._asked, self._namespace = reader, joint_states, namespace
        self._notes: list[str] = [reader.hole] if reader.hole else []
        self._no_description = "no robot description with wheels"
        # Parameters of topics that are not called as is expected.
        self._named: dict[str, Value] = {}
        self._ranged: list[str] = []  # wheels with a range sensor
        self._topics: defaultdict[str, list[str]] = defaultdict(list)  # names, by type
        for topic in reader.topics:
            if topic.message_count and topic.readable:
                self._topics[topic.type].append(topic.name)
        if namespace is not None:
            kept = {*of_robot(namespace, sorted({n for ns in self._topics.values() for n in ns}))}
            for kind, names in self._topics.items():
                self._topics[kind] = [name for name in names if name in kept]

    def rover(self, urdf: Path | None, description: str | None) -> Rover:
        """The rover's parameters by the bag. description: text of the file `urdf`; None: that of the bag."""
        turned: dict[str, str] = {}
        if description is None:
            description = self._description()
        else:
            self._notes.append(f"sizes and places of wheels from {urdf}")
        if description is not None:
            try:
                turned, notes = wheel_joints(description)
                self._notes += notes
            except RobotDescriptionError as error:
                if urdf is not None:
                    raise InitError(f"{urdf}: {error}") from None
                self._no_description = f"the robot description is not used: {error}"
                self._notes.append(self._no_description)
                description = None
        topic, found, words = joint_states_of(
            self._reader, self._topics[JOINTS], turned.values(), self._asked
        )
        joints = found or JointSpeeds(np.empty(0), [], np.empty((0, 0)))
        if topic not in (None, USUAL):
            self._named["joint_states_topic"] = str(topic)
        self._notes += [words] if words else []
        values = self._wheels(joints, turned)
        values |= self._named  # of joint states and the description; the odometry's comes below
        if description is not None:
            filled = fill_silent(description, values)
            values |= filled.values
            self._notes += filled.lacking
        steers, words_ = steering_values(
            values, as_names(values["wheels"]), joints_of(self._reader, self._topics[JOINTS]), topic
        )
        values |= steers
        self._notes += words_
        turning = self._recorded_joints(values, joints)
        rims = [joint for joint in turning.values() if joint in joints.names]
        if which := [joint for joint in rims if joint in joints.by_positions]:
            self._notes.append(f"{topic}: {', '.join(which)}: {BY_POSITIONS}")
        for joint in rims:
            if joint in joints.wrong:
                self._notes.append(f"{topic}: {joint}: {joints.wrong[joint]}; it will not be used")
        speed = self._odometry(joints, rims)
        values |= self._named
        if speed is not None:
            self._unit(joints, speed, turning, values)
        if speed is not None:
            signs = signs_of(joints, speed, rims)
            if not self._looks_back(values, turning, signs):
                self._turn_axes(values, turning, signs)
        # Topics that may help, if people know that they can: not made from the wheels, mounted with z up.
        offers: dict[str, Value] = {}
        if speeds := [topic for topic in self._topics[TWIST] if "cmd" not in topic]:
            offers["velocity_topic"] = speeds[0]
        if not self._imu(values) and self._topics[IMU]:
            offers["imu_topic"] = self._topics[IMU][0]
        self._mass(values, description, offers)
        return Rover(
            str(self._reader.path),
            values,
            self._notes,
            described=description is not None,
            offers=offers,
            ranged=self._ranged,
            of_bag=True,
        )

    def _mass(
        self, values: dict[str, Value], description: str | None, offers: dict[str, Value]
    ) -> None:
        """Set `vehicle.mass` to that of the robot description if loads are shares of it; else only offer it.

        Measured loads are checked against it, and a mass that differs from that of the vehicle as it drives
        would make good load cells look wrong.
        """
        mass = None if description is None else described_mass(description)
        if mass is None:
            return
        if values.get("load.source") == "static":
            values["vehicle.mass"] = mass
            self._notes.append(
                "vehicle.mass is the sum of the robot description's links: weigh the vehicle as it drives"
            )
        else:
            offers["vehicle.mass"] = mass

    def _odometry(self, joints: JointSpeeds, rims: list[str]) -> Speed | None:
        """Choose the topic of odometry, with a note on why; one not computed from the wheels goes first.

        Returns its speed; None if the bag has no odometry. rims: names of the joints that turn wheels.
        """
        topics = self._topics[ODOMETRY]
        if not topics:
            why = absent(self._reader, ODOMETRY, self._namespace)
            pose = of_transforms(self._reader)
            self._notes.append(f"{why}: without odom there is no slip and no thrust{pose}")
            return None
        speeds = {topic: speed_of(self._reader, topic) for topic in topics}
        shares = {topic: unlike_wheels(joints, speed, rims) for topic, speed in speeds.items()}
        own = [topic for topic, share in shares.items() if not is_of_wheels(share)]
        fit = own or topics
        alike = "/odom" if "/odom" in fit else only_or_best_match("odom", fit)
        chosen = alike or max(fit, key=lambda topic: len(speeds[topic].times))
        said = [] if chosen == "/odom" else [f"assumed: {chosen} is odom"]
        if len(topics) > 1:
            said += [
                f"{topic} is computed from the wheels and shows no slip"
                for topic in topics
                if topic not in own and own
            ]
            others = [topic for topic in fit if topic != chosen]
            how = "by its name" if alike else "since it has the most messages"
            said += [f"chosen before {', '.join(others)} {how}"] if others else []
        elif said:
            said[0] += ", the only one like it of its type"
        if not own:
            said.append(
                f"{'it' if said else chosen} is computed from the wheels and shows no slip: give an"
                " independent odometry (camera, lidar, GNSS), if there is one"
            )
        if speeds[chosen].by_pose:
            said.append(f"{chosen} has no speed (its twist is 0 throughout)")
        if chosen != "/odom":
            self._named["odom_topic"] = chosen
        if said:
            self._notes.append("; ".join(said))
        return speeds[chosen]

    def _unit(
        self,
        joints: JointSpeeds,
        speed: Speed,
        turned: Mapping[str, str],
        values: Mapping[str, Value],
    ) -> None:
        """Add a note if the rims travel so much more or less than the vehicle that they are not in rad/s.

        turned: by wheel, the joint that turns it.
        """
        each = for_each_wheel(values)
        radii = {
            joint: float(cast("float", each[f"{wheel}.diameter"])) / 2.0
            for wheel, joint in turned.items()
            if f"{wheel}.diameter" in each and joint not in joints.wrong
        }
        times = times_the_way(joints, speed, radii)
        unit = unit_by_way(times, sum(radii.values()) / len(radii)) if radii else ""
        if unit and {*radii} & {*joints.by_positions}:
            unit = unit.replace("/s", "") + " (positions)"
        if unit:
            words = (
                f"by their joints the rims travel {times:.3g} times the distance by the odometry"
            )
            self._notes.append(f"{words}: in {unit}? expected rad and rad/s")

    def _looks_back(
        self, values: Mapping[str, Value], turned: Mapping[str, str], signs: Mapping[str, int]
    ) -> bool:
        """Whether all joints turn backward about the description's axes, by the odometry; add a note if so.

        turned: by wheel, its joint. signs: by joint, as returned by `signs_of`.
        """
        described = {j: values.get(f"{w}.joint_sign") for w, j in turned.items() if j in signs}
        against = [joint for joint, sign in described.items() if sign == -signs[joint]]
        if len(against) < max(2, len(turned)) or len(against) < len(described):
            return False
        self._notes.append(
            "the odometry looks backward: when it says that the vehicle drives ahead, all joints turn"
            " backward by the description's axes; joint_sign is left as described: turn the odometry's frame"
            " (REP 105)"
        )
        return True

    def _turn_axes(
        self, values: dict[str, Value], turned: Mapping[str, str], signs: Mapping[str, int]
    ) -> None:
        """Set `joint_sign` of wheels whose joints turned in the drive against the sign that `values` has."""
        mirrored = []
        for wheel, joint in turned.items():
            sign, name = signs.get(joint), f"{wheel}.joint_sign"
            if sign is not None and sign != values.get(name, 1):
                values[name] = sign
                mirrored.append(wheel)
        if mirrored:
            self._notes.append(
                f"joint_sign of {', '.join(mirrored)} by the drive: the joints turned so when it went ahead"
            )

    def _imu(self, values: dict[str, Value]) -> bool:
        """Set `imu_topic` to an imu with gravity along its z axis; returns whether there is one."""
        topics = self._topics[IMU]
        if not topics:
            return False
        first = only_or_best_match("imu", topics) or topics[0]
        for found in sorted(topics, key=lambda topic: topic != first):
            way, why = upright(self._reader, found)
            if not way:
                self._notes.append(f"{found} is not used: {why}")
                continue
            values["imu_topic"] = found
            shown = "up as gravity shows" if way > 0 else "down as gravity shows: it is turned over"
            others = ", ".join(topic for topic in topics if topic != found)
            instead = f"; in place of {others}, if you write that as imu_topic" if others else ""
            self._notes.append(
                f"{found} is the imu, z {shown}; if its x axis does not look ahead, write imu_yaw{instead}"
            )
            return True
        return False

    def _recorded_joints(self, values: dict[str, Value], joints: JointSpeeds) -> dict[str, str]:
        """By wheel, the name of its joint in the joint states, even if the description has another name."""
        found = {}
        for wheel in as_names(values["wheels"]):
            name = str(values.get(f"{wheel}.joint", f"{wheel}_joint"))
            recorded = (
                None if name in joints.names else best_match(wheel, "joint", free_joints(joints))
            )
            if recorded is not None:
                self._notes.append(f"{recorded} turns {wheel}, by its name; there is no {name}")
                values.pop(f"{wheel}.joint", None)
                values |= joint_values({wheel: recorded})
            elif joints.names and name not in joints.names:
                self._notes.append(
                    f"which joint turns {wheel} is not clear: there is {', '.join(joints.names)}"
                )
            found[wheel] = recorded or name
        return found

    def _wheels(self, joints: JointSpeeds, turned: Mapping[str, str]) -> dict[str, Value]:
        """Parameters of the wheels, which are named by topics of loads or sinkages, else by joints.

        turned: by wheel, the joint of the description; without one, joints that turn like wheels are used.
        """
        loads, sinkages = (wheels_named_by(self._topics[kind]) for kind in (WRENCH, SINKAGE))
        ranges = {} if sinkages else wheels_named_by(self._topics[RANGE])
        depths = sinkages or ranges
        if not (loads or depths or turned):
            turned = wheels_named_by(turning_wheels(joints))
        wheels = list(loads or depths or turned)
        if not wheels:
            raise InitError(
                f"{self._reader.path}: no topic of a wheel's load ({WRENCH}) or sinkage ({SINKAGE}, {RANGE}),"
                f" {self._no_description}, and no joint that turns like a wheel ({self._no_joint(joints)}):"
                " `smallwheel init BAG --urdf FILE` reads a robot description from a file, and"
                " `smallwheel init --wheels N` makes a file to fill in"
            )
        values: dict[str, Value] = {"wheels": wheels}
        for wheel in wheels:
            load = loads.get(wheel)
            if load is not None and load != f"/{wheel}/load":
                values[f"{wheel}.load_topic"] = load
            depth = depths.get(wheel) or best_match(wheel, "sinkage", depths.values())
            if depth is None:
                values[f"{wheel}.sinkage_topic"] = ""
            elif ranges or depth != f"/{wheel}/sinkage":
                values[f"{wheel}.sinkage_topic"] = depth
            joint = turned.get(wheel) or best_match(wheel, "joint", free_joints(joints))
            if joint is not None:
                values |= joint_values({wheel: joint})
        self._ranged = wheels if ranges else []
        blind = [w for w in wheels if values.get(f"{w}.sinkage_topic") == ""]
        if blind:
            of = "the wheels" if len(blind) == len(wheels) else ", ".join(blind)
            self._notes.append(f"no topic of the sinkage of {of}: it is only predicted")
        if not loads:
            values["load.source"] = "static"
            why = absent(self._reader, WRENCH, self._namespace)
            self._notes.append(f"{why}: the mass is split over the wheels")
        return values

    def _no_joint(self, joints: JointSpeeds) -> str:
        """Words on why joint states show no joint that turns a wheel."""
        if not self._topics[JOINTS]:
            return absent(self._reader, JOINTS, self._namespace)
        if not joints.names:
            return "which topic has them is not clear, or its messages name none"
        which = "none of them turns:" if not joints.turning() else "its joints are"
        return f"{which} {', '.join(joints.names)}"

    def _description(self) -> str | None:
        """The text of the bag's robot description, if there is one."""
        named = [topic for topic in self._topics[DESCRIPTION_TYPE] if "robot_description" in topic]
        message = _first(self._reader, named[0]) if named else None
        if message is None:
            return None
        if named[0] != "/robot_description":
            self._named["robot_description_topic"] = named[0]
        self._notes.append(f"sizes and places of wheels from {named[0]}")
        return str(message.data)


def as_names(wheels: Value) -> list[str]:
    """The value of the parameter `wheels`, as a list of names for the type checker."""
    return cast("list[str]", wheels)


def _first(reader: BagReader, topic: str) -> Any | None:
    """The first message of a topic; None if it has none that can be read."""
    with suppress(BagError):  # damaged, or defined otherwise than here
        return next((message.message for message in reader.messages({topic})), None)
    return None


# --- From whatever there is


def init(
    source: BagOrUrdf | None = None,
    *,
    urdf: Urdf | None = None,
    wheels: Count | None = None,
    joint_states: TopicName | None = None,
    namespace: TopicName | None = None,
) -> Rover:
    """Write a parameter file for the node and for `smallwheel replay`.

    A recorded drive shows the wheels, by their topics or joints, the signs of the joints, and the odometry;
    sizes and places come from the robot's description, in the bag or given as --urdf. What only you can know
    is marked FILL_IN.

    Parameters
    ----------
    source
        A recorded drive, or a robot description.
    urdf
        A robot description, for sizes, places and joints; alone, or beside a BAG.
    wheels
        Number of wheels, if there is neither a BAG nor a URDF.
    joint_states
        Topic of the wheels' joint states, if a BAG has several.
    namespace
        Namespace of the robot's topics, if a BAG has several robots.

    Raises
    ------
    InitError, BagError
        If the arguments do not go together, an input cannot be used, or a bag shows nothing of a wheel.
    """
    bag = None if source is None else Path(source)
    description = None if urdf is None else Path(urdf)
    if bag is not None and bag.suffix.lower() in (".urdf", ".xml"):
        if description is not None:
            raise InitError("two robot descriptions: give one")
        bag, description = None, bag
    if (bag is None and description is None) == (wheels is None):
        raise InitError("give a BAG, a URDF (--urdf FILE), both, or --wheels N alone")
    if bag is not None:
        return rover_of_bag(bag, description, joint_states, namespace)
    if description is not None:
        return rover_of_description(description)
    return rover_of_wheels(wheels or 0)
