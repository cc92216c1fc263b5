# SPDX-License-Identifier: Apache-2.0
"""Fill parameters of wheels that are silent from the robot description; same for node and replay.

A parameter that is given wins. What a description cannot fill is reported, with what was found in it
and what was expected. Poses are matrices, (4, 4), of what is in a frame to that frame; m.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from typing import NamedTuple
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from smallwheel_ros.common.errors import SmallwheelError
from smallwheel_ros.common.node_parameter import WHEEL
from smallwheel_ros.onboard.declared import PARAMETERS
from smallwheel_ros.onboard.parameters import ParametersError, problems, wheel_names
from smallwheel_ros.physics.conditions import PRESSED

Array = NDArray[np.float64]

DESCRIPTION_TYPE = "std_msgs/msg/String"
TURNING = ("continuous", "revolute")
_SIZE, _PLACE = ("diameter", "width"), ("lateral_position", "longitudinal_position")
_FILLED = (*_SIZE, *_PLACE, "joint_sign")
# Directions within 25 degrees of each other: more than wheels are cambered or toed in, and far from
# the 90 degrees by which an axis or a cylinder is turned by mistake.
_ALONG = 0.9
_UPRIGHT = 0.7  # an axis within 45 degrees of the vertical steers
_LARGEST = 1e6  # m or rad: beyond any robot, and products of it stay finite
_BASE = "base_link"


class RobotDescriptionError(SmallwheelError):
    """A robot description that cannot be read, or that lacks what is looked for."""


class Joint(NamedTuple):
    """A joint: its name, type, the links that it joins, and its element."""

    name: str
    kind: str
    parent: str
    child: str
    element: Element

    @property
    def axis(self) -> Array:
        """Direction that it turns about, (3,), of length 1, in the frame of the child link."""
        axis = _numbers(self.element.find("axis"), "xyz", (1.0, 0.0, 0.0), f"joint {self.name!r}")
        length = float(np.linalg.norm(axis))
        if length < 1e-6:
            raise RobotDescriptionError(f"joint {self.name!r} has an axis without direction")
        return axis / length


class Urdf:
    """The links and joints of a robot description, by name; not those of transmissions and plugins.

    Raises RobotDescriptionError if the text is no URDF, or has two joints of a name or above one link.
    """

    def __init__(self, text: str) -> None:
        try:
            root = ElementTree.fromstring(text)
        except (ElementTree.ParseError, ValueError) as error:
            raise RobotDescriptionError(f"it is no XML: {error}") from None
        if root.tag != "robot":
            raise RobotDescriptionError(f"its outermost element is {root.tag!r}, expected 'robot'")
        self.links = {link.get("name", ""): link for link in root.findall("link")}
        self.joints: dict[str, Joint] = {}
        self._above: dict[str, Joint] = {}
        for element in root.findall("joint"):
            name, kind = element.get("name", ""), element.get("type", "")
            ends = (element.find(end) for end in ("parent", "child"))
            above, below = ("" if end is None else end.get("link", "") for end in ends)
            joint = Joint(name, kind, above, below, element)
            twin = self._above.get(joint.child)
            if name in self.joints:
                raise RobotDescriptionError(f"two joints are called {name!r}")
            if twin is not None:
                raise RobotDescriptionError(
                    f"link {joint.child!r} is the child of two joints, {twin.name!r} and {name!r}"
                )
            self.joints[name] = self._above[joint.child] = joint

    def chain(self, link: str) -> list[Joint]:
        """Return the joints above a link, from the lowest up to the root link."""
        chain: list[Joint] = []
        while link in self._above:
            if len(chain) > len(self.joints):
                raise RobotDescriptionError(f"the joints above link {link!r} are a circle")
            chain.append(self._above[link])
            link = chain[-1].parent
        return chain

    def pose(self, link: str, frame: str) -> Array:
        """Return the pose of a link in the frame of another one, with all joints at zero."""
        poses = []
        for each in (frame, link):
            pose = np.eye(4)
            for joint in self.chain(each):
                pose = _origin(joint.element, f"joint {joint.name!r}") @ pose
            poses.append(pose)
        if self.root(link) != self.root(frame):
            raise RobotDescriptionError(f"no joints connect link {link!r} with link {frame!r}")
        return np.asarray(np.linalg.solve(*poses), dtype=np.float64)

    def root(self, link: str) -> str:
        """Return the link at the top of the chain that a link is in."""
        return ([link] + [joint.parent for joint in self.chain(link)])[-1]

    def cylinder(self, link: str) -> tuple[float, float, Array]:
        """Return radius, length (m) and pose of the largest cylinder of a link; its axis is its z."""
        element, where = self.links.get(link), f"link {link!r}"
        if element is None:
            raise RobotDescriptionError(f"there is no {where}")
        for part in ("collision", "visual"):
            found = []
            for body in element.findall(part):
                for shape in body.findall("geometry/cylinder"):
                    radius, length = (
                        float(_numbers(shape, name, (0.0,), where)[0])
                        for name in ("radius", "length")
                    )
                    found.append((radius, length, _origin(body, where)))
            if found:
                return max(found, key=lambda cylinder: cylinder[0])
        shapes = sorted({repr(shape.tag) for shape in element.findall("*/geometry/*")})
        raise RobotDescriptionError(
            f"{where} has {', '.join(shapes[:5]) or 'no geometry'}, expected a cylinder in its collision"
            " or visual"
        )


def _origin(element: Element, where: str) -> Array:
    """Read the element's origin; rpy are angles about the fixed axes x, y and z, in this order."""
    origin, pose = element.find("origin"), np.eye(4)
    angles = _numbers(origin, "rpy", (0.0, 0.0, 0.0), where)
    pose[:3, :3] = Rotation.from_euler("xyz", angles).as_matrix()
    pose[:3, 3] = _numbers(origin, "xyz", (0.0, 0.0, 0.0), where)
    return pose


def _numbers(element: Element | None, name: str, default: tuple[float, ...], where: str) -> Array:
    text = None if element is None else element.get(name)
    if element is None or text is None:
        return np.array(default)
    try:
        numbers = np.array([float(word) for word in text.split()])
    except ValueError:
        numbers = np.empty(0)
    if len(numbers) != len(default) or not (np.abs(numbers) <= _LARGEST).all():
        raise RobotDescriptionError(
            f"{where}: {name} of its {element.tag} is {text[:60]!r}, expected"
            f" {len(default)} number{'s' if len(default) > 1 else ''} of at most {_LARGEST:g}"
        )
    return numbers


# --- What it says of wheels


@dataclass(frozen=True)
class Filled:
    """What a description gives.

    values: by full name of the parameter. lacking: a sentence for what could not be filled, and for
    what the estimate cannot go by.
    """

    values: dict[str, float | int] = field(default_factory=dict)
    lacking: list[str] = field(default_factory=list)

    @property
    def text(self) -> str:
        """The values in words."""
        return ", ".join(f"{name}={value}" for name, value in self.values.items()) or "nothing"


def silent_parameters(given: Mapping[str, object]) -> list[str]:
    """Return the full names of parameters that a description may fill and that are not given.

    given: values of parameters by full name; one that is None or absent is silent.
    """
    try:
        wheels = wheel_names(given.get("wheels"))
    except ParametersError:
        return []
    names = [f"{wheel}.{name}" for wheel in wheels for name in _FILLED]
    return [name for name in names if given.get(name) is None]


def needs_description(given: Mapping[str, object]) -> list[str]:
    """Return the names of parameters without which nothing works and that only a description fills.

    Empty where none is missing, and where anything else is wrong: that is to be said at once.
    """
    needed = [name for name in silent_parameters(given) if name.endswith(_SIZE)]
    return needed if len(problems(given)) == len(needed) else []


def fill_silent(text: str, given: Mapping[str, object]) -> Filled:
    """Return what a robot description (URDF) says of the parameters of wheels that are silent.

    Diameter and width come from the cylinder of the link that the wheel's joint moves, places from
    the chain of joints between it and the base frame (all at zero) and the cylinder's middle, the
    joint's sign from its axis: 1 where that points along +y of the base frame, -1 along -y. given: as
    in `silent_parameters`. Raises RobotDescriptionError if the text is no URDF, ParametersError if the
    wheels have no usable names.
    """
    urdf, filled, silent = Urdf(text), Filled(), silent_parameters(given)
    for wheel in wheel_names(given.get("wheels")):
        failed: dict[str, list[str]] = {}  # parameters, by what is wrong
        for names, find in ((_SIZE, _size), (_PLACE, _place), (("joint_sign",), _sign)):
            wanted = {f"{wheel}.{name}": i for i, name in enumerate(names)}
            wanted = {name: i for name, i in wanted.items() if name in silent}
            if not wanted:
                continue
            try:
                found = find(urdf, *_mounting(urdf, wheel, given))
            except RobotDescriptionError as error:
                failed.setdefault(str(error), []).extend(wanted)
                continue
            for name, i in wanted.items():
                parameter = PARAMETERS[name.replace(wheel, WHEEL, 1)].for_wheel(wheel)
                problem = parameter.problem(found[i])
                if problem is None:
                    filled.values[name] = found[i]
                else:
                    filled.lacking.append(f"robot description: {problem}")
        for why, lacking in failed.items():
            filled.lacking.append(f"robot description: {', '.join(lacking)}: {why}")
        steering = "" if given.get(f"{wheel}.contact") == PRESSED else _steering(urdf, wheel, given)
        if steering and any(name.startswith(f"{wheel}.") for name in silent):
            filled.lacking.append(
                f"wheel {wheel} is steered by joint {steering!r}: steering is not read, its slip"
                " is that of a wheel that points straight ahead"
            )
    return filled


def _mounting(urdf: Urdf, wheel: str, given: Mapping[str, object]) -> tuple[Joint, str]:
    """Return a wheel's joint and the base frame: the one that is given, base_link, or the root link."""
    name = given.get(f"{wheel}.joint") or f"{wheel}_joint"
    joint = urdf.joints.get(str(name))
    if joint is None:
        there = [repr(joint.name) for joint in urdf.joints.values() if joint.kind in TURNING]
        more = " and others" if len(there) > 5 else ""
        raise RobotDescriptionError(
            f"there is no joint {name!r}, expected parameter {wheel}.joint to be one that"
            f" turns: {', '.join(there[:5]) or 'there is none'}{more}"
        )
    base = str(given.get("base_frame") or _BASE)
    if base not in urdf.links and base != _BASE:
        words = "expected parameter base_frame to be one"
        raise RobotDescriptionError(f"there is no link {base!r}, {words}")
    return joint, base if base in urdf.links else urdf.root(joint.child)


def _size(urdf: Urdf, joint: Joint, _: str) -> tuple[float, float]:
    """Diameter and width, m."""
    radius, length, pose = urdf.cylinder(joint.child)
    if abs(float(pose[:3, 2] @ joint.axis)) < _ALONG:
        raise RobotDescriptionError(
            f"the cylinder of link {joint.child!r} is not about the axis of joint {joint.name!r},"
            " expected its z along that axis"
        )
    return 2.0 * radius, length


def _place(urdf: Urdf, joint: Joint, base: str) -> tuple[float, float]:
    """Lateral and longitudinal position, m: of the cylinder's middle where the wheel has one."""
    pose = urdf.pose(joint.child, base)
    with suppress(RobotDescriptionError):
        pose = pose @ urdf.cylinder(joint.child)[2]
    x, y = (round(float(metres), 9) + 0.0 for metres in pose[:2, 3])  # no -0.0, no rounding errors
    return y, x


def _sign(urdf: Urdf, joint: Joint, base: str) -> tuple[int]:
    """The joint's sign: a turn about +y takes the top of the wheel forward."""
    if joint.kind not in TURNING:
        kinds = " or ".join(TURNING)
        raise RobotDescriptionError(f"joint {joint.name!r} is {joint.kind!r}, expected {kinds}")
    axis = urdf.pose(joint.child, base)[:3, :3] @ joint.axis
    if abs(axis[1]) < _ALONG:
        found = " ".join(f"{number:.2f}" for number in axis)
        raise RobotDescriptionError(
            f"the axis of joint {joint.name!r} is ({found}) in {base!r}, expected (0 1 0) or (0 -1 0)"
        )
    return (1 if axis[1] > 0.0 else -1,)


def _steering(urdf: Urdf, wheel: str, given: Mapping[str, object]) -> str:
    """Name of a joint that steers the wheel; empty where there is none, or something else is wrong."""
    try:
        joint, base = _mounting(urdf, wheel, given)
        for above in urdf.chain(joint.parent):
            turned = urdf.pose(above.child, base)[:3, :3] @ above.axis
            if above.kind in TURNING and abs(turned[2]) > _UPRIGHT:
                return above.name
    except RobotDescriptionError:
        pass
    return ""
