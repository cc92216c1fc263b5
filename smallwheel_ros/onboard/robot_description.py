# SPDX-License-Identifier: Apache-2.0
"""Fill parameters of wheels that are silent from the robot description; same for node and replay.

A parameter that is given wins. What a description cannot fill is said, with what was found in it
and what was expected.

The text comes from somebody else: nothing in it is expanded or run, and its size is limited. Of the parsers
that others keep, urdf_parser_py 0.0.4 takes NaN, infinity and two joints of a name, and fills the memory on
a circle of joints; yourdfpy 0.0.60 mends what is no XML and gives poses of NaN. Poses are matrices, (4, 4),
of what is in a frame to that frame; m.
"""

from __future__ import annotations

import math
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
from smallwheel_ros.common.parameter import WHEEL
from smallwheel_ros.onboard.parameters import ParametersError, problems, wheel_names
from smallwheel_ros.onboard.settings import PARAMETERS
from smallwheel_ros.physics.conditions import PRESSED

Array = NDArray[np.float64]

# Those of large robots have a megabyte, some thousand elements and ten joints above each other.
_MOST_CHARACTERS = 10_000_000
_MOST_ELEMENTS = 100_000
_DEEPEST = 100
_LONGEST_NAME = 60  # characters of a name or number that are repeated in a message
_MOST_NAMES = 5  # that are listed in a message
_LARGEST = 1e6  # m or rad: beyond any robot, and products of it stay finite
TURNING = ("continuous", "revolute")


class RobotDescriptionError(SmallwheelError):
    """A robot description that cannot be read, or that lacks what is looked for."""


def quoted(text: str) -> str:
    """Return a text from the description as it may stand in a message."""
    return repr(text if len(text) <= _LONGEST_NAME else f"{text[:_LONGEST_NAME]}...")


def listed(names: list[str]) -> str:
    """Return names from the description as they may stand in a message; empty where none is."""
    more = " and others" if len(names) > _MOST_NAMES else ""
    return ", ".join(map(quoted, names[:_MOST_NAMES])) + more


class Cylinder(NamedTuple):
    """A cylinder of a link; radius and length in m, its axis is z of its pose in the link."""

    radius: float
    length: float
    pose: Array


class _LimitedBuilder(ElementTree.TreeBuilder):
    """Builds the tree of a description; raises RobotDescriptionError beyond the limits."""

    def __init__(self) -> None:
        super().__init__()
        self._count = 0

    def start(self, tag: str, attrs: dict[str, str]) -> Element:
        """Begin an element."""
        self._count += 1
        if self._count > _MOST_ELEMENTS:
            raise RobotDescriptionError(
                f"more than {_MOST_ELEMENTS} elements, expected the URDF of a robot"
            )
        return super().start(tag, attrs)

    def doctype(self, name: str, pubid: str | None, system: str | None) -> None:
        """Refuse a document type: it can define entities, and a URDF has none."""
        raise RobotDescriptionError(
            "it has a DOCTYPE, which can let text grow without end: expected a URDF without one"
        )


class Joint:
    """A joint; its numbers are read, and can be wrong, when they are asked for. kind: its type."""

    def __init__(self, element: Element) -> None:
        self._element = element
        self.name, self.kind = element.get("name", ""), element.get("type", "")
        self.parent, self.child = (
            "" if end is None else end.get("link", "")
            for end in (element.find("parent"), element.find("child"))
        )
        self._where = f"joint {quoted(self.name)}"

    @property
    def pose(self) -> Array:
        """Pose of the child link in the parent link, with the joint at zero."""
        return _pose(self._element, self._where)

    @property
    def axis(self) -> Array:
        """Direction that it turns about, (3,), of length 1, in the frame of the child link."""
        axis = _numbers(self._element.find("axis"), "xyz", (1.0, 0.0, 0.0), self._where)
        length = math.hypot(*axis)
        if length < 1e-6:
            raise RobotDescriptionError(f"{self._where} has an axis without direction")
        return np.array(axis) / length


class Urdf:
    """The links and joints of a robot description.

    links, joints: by name; only those of the robot, not those within transmissions or plugins.

    Raises
    ------
    RobotDescriptionError
        If the text is no URDF, is too large, or has two joints of a name or above one link.
    """

    def __init__(self, text: str) -> None:
        if len(text) > _MOST_CHARACTERS:
            raise RobotDescriptionError(
                f"it has {len(text)} characters, expected at most {_MOST_CHARACTERS}"
            )
        try:
            root = ElementTree.fromstring(text, ElementTree.XMLParser(target=_LimitedBuilder()))
        except (ElementTree.ParseError, ValueError) as error:
            raise RobotDescriptionError(f"it is no XML: {error}") from None
        if root.tag != "robot":
            raise RobotDescriptionError(
                f"its outermost element is {quoted(root.tag)}, expected 'robot'"
            )
        self.links = {link.get("name", ""): link for link in root.findall("link")}
        self.joints: dict[str, Joint] = {}
        self._above: dict[str, Joint] = {}
        for joint in map(Joint, root.findall("joint")):
            if joint.name in self.joints:
                raise RobotDescriptionError(f"two joints are called {quoted(joint.name)}")
            if joint.child in self._above:
                raise RobotDescriptionError(
                    f"link {quoted(joint.child)} is the child of two joints,"
                    f" {quoted(self._above[joint.child].name)} and {quoted(joint.name)}"
                )
            self.joints[joint.name] = self._above[joint.child] = joint

    def chain(self, link: str) -> list[Joint]:
        """Return the joints above a link, from the lowest up to the root link."""
        chain: list[Joint] = []
        while link in self._above:
            chain.append(self._above[link])
            link = chain[-1].parent
            if len(chain) > _DEEPEST:
                raise RobotDescriptionError(
                    f"above link {quoted(chain[0].child)} are more than {_DEEPEST} joints, or they are"
                    " a circle"
                )
        return chain

    def root(self, link: str) -> str:
        """Return the link at the top of the chain that a link is in."""
        return ([link] + [joint.parent for joint in self.chain(link)])[-1]

    def pose(self, link: str, frame: str) -> Array:
        """Return the pose of a link in the frame of another one, with all joints at zero."""
        if self.root(link) != self.root(frame):
            raise RobotDescriptionError(
                f"no joints connect link {quoted(link)} with link {quoted(frame)}"
            )
        of_link, of_frame = np.eye(4), np.eye(4)
        for joint in self.chain(link):
            of_link = joint.pose @ of_link
        for joint in self.chain(frame):
            of_frame = joint.pose @ of_frame
        return np.asarray(np.linalg.solve(of_frame, of_link), dtype=np.float64)

    def cylinder(self, link: str) -> Cylinder:
        """Return the largest cylinder of a link's collision, else of its visual."""
        element, where = self.links.get(link), f"link {quoted(link)}"
        if element is None:
            raise RobotDescriptionError(f"there is no {where}")
        for part in ("collision", "visual"):
            found = [
                Cylinder(
                    _numbers(shape, "radius", (0.0,), where)[0],
                    _numbers(shape, "length", (0.0,), where)[0],
                    _pose(body, where),
                )
                for body in element.findall(part)
                for shape in body.findall("geometry/cylinder")
            ]
            if found:
                return max(found, key=lambda cylinder: cylinder.radius)
        shapes = sorted({shape.tag for shape in element.findall("*/geometry/*")})
        raise RobotDescriptionError(
            f"{where} has {listed(shapes) or 'no geometry'}, expected a cylinder in its collision or"
            " visual"
        )


def _pose(element: Element, where: str) -> Array:
    """Read the element's origin; rpy are angles about the fixed axes x, y and z, in this order."""
    origin, nothing, pose = element.find("origin"), (0.0, 0.0, 0.0), np.eye(4)
    angles = _numbers(origin, "rpy", nothing, where)
    pose[:3, :3] = Rotation.from_euler("xyz", angles).as_matrix()
    pose[:3, 3] = _numbers(origin, "xyz", nothing, where)
    return pose


def _numbers(
    element: Element | None, attribute: str, default: tuple[float, ...], where: str
) -> tuple[float, ...]:
    text = None if element is None else element.get(attribute)
    if element is None or text is None:
        return default
    try:
        numbers = tuple(float(word) for word in text.split(maxsplit=len(default)))
    except ValueError:
        numbers = ()
    if len(numbers) != len(default) or not all(abs(number) <= _LARGEST for number in numbers):
        raise RobotDescriptionError(
            f"{where}: {attribute} of its {element.tag} is {quoted(text)}, expected"
            f" {len(default)} number{'s' if len(default) > 1 else ''} of at most {_LARGEST:g}"
        )
    return numbers


DESCRIPTION_TYPE = "std_msgs/msg/String"

_SIZE = ("diameter", "width")
_PLACE = ("lateral_position", "longitudinal_position")
_SIGN = ("joint_sign",)
# Directions within 25 degrees of each other: more than wheels are cambered or toed in, and far from
# the 90 degrees by which an axis or a cylinder is turned by mistake.
_ALONG = 0.9
_UPRIGHT = 0.7  # an axis within 45 degrees of the vertical steers
_DIGITS = 9  # of metres: products of rotations are only exact to rounding
_BASE = "base_link"


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
    names = [f"{wheel}.{name}" for wheel in wheels for name in (*_SIZE, *_PLACE, *_SIGN)]
    return [name for name in names if given.get(name) is None]


def needs_description(given: Mapping[str, object]) -> list[str]:
    """Return the names of parameters without which nothing works and that only a description fills.

    Empty where none is missing, and where anything else is wrong: that is to be said at once.
    """
    needed = [name for name in silent_parameters(given) if name.endswith(_SIZE)]
    return needed if len(problems(given)) == len(needed) else []


def fill_silent(text: str, given: Mapping[str, object]) -> Filled:
    """Return what a robot description says of the parameters of wheels that are silent.

    Diameter and width come from the cylinder of the link that the wheel's joint moves, places from
    the chain of joints between it and the base frame (all at zero) and the cylinder's middle, the
    joint's sign from its axis: 1 where that points along +y of the base frame, -1 along -y.

    Parameters
    ----------
    text
        URDF.
    given
        Values of parameters by full name; one that is None or absent is silent.

    Raises
    ------
    RobotDescriptionError
        If the text is no URDF, or beyond a limit.
    ParametersError
        If the wheels have no usable names.
    """
    urdf, filled, silent = Urdf(text), Filled(), set(silent_parameters(given))
    for wheel in wheel_names(given.get("wheels")):
        failed: dict[str, list[str]] = {}  # parameters, by what is wrong
        steered = ""
        for names, find in ((_SIZE, _size), (_PLACE, _place), (_SIGN, _sign)):
            wanted = [name for name in names if f"{wheel}.{name}" in silent]
            if not wanted:
                continue
            try:
                joint = _joint(urdf, wheel, given.get(f"{wheel}.joint"))
                base = _base(urdf, joint.child, given.get("base_frame"))
                found = dict(zip(names, find(urdf, joint, base), strict=True))
            except RobotDescriptionError as error:
                failed.setdefault(str(error), []).extend(f"{wheel}.{name}" for name in wanted)
                continue
            for name in wanted:
                parameter = PARAMETERS[f"{WHEEL}.{name}"].for_wheel(wheel)
                problem = parameter.problem(found[name])
                if problem is None:
                    filled.values[parameter.name] = found[name]
                else:
                    filled.lacking.append(f"robot description: {problem}")
            if given.get(f"{wheel}.contact") != PRESSED:
                steered = steered or _steering(urdf, joint, base)
        for why, lacking in failed.items():
            filled.lacking.append(f"robot description: {', '.join(lacking)}: {why}")
        if steered:
            filled.lacking.append(
                f"wheel {wheel} is steered by joint {quoted(steered)}: steering is not read, its slip"
                " is that of a wheel that points straight ahead"
            )
    return filled


def _joint(urdf: Urdf, wheel: str, given: object) -> Joint:
    name = given if isinstance(given, str) and given else f"{wheel}_joint"
    joint = urdf.joints.get(name)
    if joint is None:
        there = [joint.name for joint in urdf.joints.values() if joint.kind in TURNING]
        raise RobotDescriptionError(
            f"there is no joint {quoted(name)}, expected parameter {wheel}.joint to be one that"
            f" turns: {listed(there) or 'there is none'}"
        )
    return joint


def _base(urdf: Urdf, link: str, given: object) -> str:
    """Return the base frame: the one that is given, else base_link, else the root of the link."""
    name = given if isinstance(given, str) and given else _BASE
    if name in urdf.links:
        return name
    if name == _BASE:
        return urdf.root(link)
    raise RobotDescriptionError(
        f"there is no link {quoted(name)}, expected parameter base_frame to be one"
    )


def _size(urdf: Urdf, joint: Joint, base: str) -> tuple[float, float]:
    """Diameter and width, m."""
    radius, length, pose = urdf.cylinder(joint.child)
    if abs(float(pose[:3, 2] @ joint.axis)) < _ALONG:
        raise RobotDescriptionError(
            f"the cylinder of link {quoted(joint.child)} is not about the axis of joint"
            f" {quoted(joint.name)}, expected its z along that axis"
        )
    return 2.0 * radius, length


def _place(urdf: Urdf, joint: Joint, base: str) -> tuple[float, float]:
    """Lateral and longitudinal position, m: of the cylinder's middle where the wheel has one."""
    pose = urdf.pose(joint.child, base)
    with suppress(RobotDescriptionError):
        pose = pose @ urdf.cylinder(joint.child).pose
    x, y = (round(float(metres), _DIGITS) + 0.0 for metres in pose[:2, 3])  # no -0.0
    return y, x


def _sign(urdf: Urdf, joint: Joint, base: str) -> tuple[int]:
    """The joint's sign: a turn about +y takes the top of the wheel forward."""
    name = quoted(joint.name)
    if joint.kind not in TURNING:
        expected = " or ".join(TURNING)
        raise RobotDescriptionError(f"joint {name} is {quoted(joint.kind)}, expected {expected}")
    axis = _axis(urdf, joint, base)
    if abs(axis[1]) < _ALONG:
        found = " ".join(f"{number:.2f}" for number in axis)
        raise RobotDescriptionError(
            f"the axis of joint {name} is ({found}) in {quoted(base)}, expected (0 1 0) or (0 -1 0)"
        )
    return (1 if axis[1] > 0.0 else -1,)


def _steering(urdf: Urdf, joint: Joint, base: str) -> str:
    """Name of a joint that steers the wheel; empty where there is none."""
    with suppress(RobotDescriptionError):  # what is wrong in the chain has been said of the place
        for above in urdf.chain(joint.parent):
            if above.kind in TURNING and abs(_axis(urdf, above, base)[2]) > _UPRIGHT:
                return above.name
    return ""


def _axis(urdf: Urdf, joint: Joint, base: str) -> Array:
    """Direction of a joint's axis in the base frame."""
    found: Array = urdf.pose(joint.child, base)[:3, :3] @ joint.axis
    return found
