"""Read a robot description (URDF): its joints, where they are, and cylinders of its links.

The text comes from somebody else: nothing in it is expanded or run, and its size is limited.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from smallwheel_ros.errors import SmallwheelError

Array = NDArray[np.float64]

# Those of large robots have a megabyte, some thousand elements and ten levels.
_MOST_CHARACTERS = 10_000_000
_MOST_ELEMENTS = 100_000
_DEEPEST = 100
_LONGEST_NAME = 60  # characters of a name or number that are repeated in a message
_MOST_SHAPES = 5  # that are named in a message
_LARGEST = 1e6  # m or rad: beyond any robot, and products of it stay finite
TURNING = ("continuous", "revolute")


class RobotDescriptionError(SmallwheelError):
    """A robot description that cannot be read, or that lacks what is looked for."""


def quoted(text: str) -> str:
    """Return a text from the description as it may stand in a message."""
    return repr(text if len(text) <= _LONGEST_NAME else f"{text[:_LONGEST_NAME]}...")


@dataclass(frozen=True)
class Pose:
    """Where something is in another frame.

    rotation: (3, 3), from its axes to those of the frame. position: (3,), m.
    """

    rotation: Array
    position: Array

    def of(self, inner: Pose) -> Pose:
        """Return where something is in the frame, of which inner says where it is in this."""
        return Pose(self.rotation @ inner.rotation, self.position + self.rotation @ inner.position)

    @property
    def inverse(self) -> Pose:
        """Where the frame is in this."""
        return Pose(self.rotation.T, -self.rotation.T @ self.position)


@dataclass(frozen=True)
class Cylinder:
    """A cylinder of a link; radius and length in m, its axis is z of its pose in the link."""

    radius: float
    length: float
    pose: Pose


class _LimitedBuilder(ElementTree.TreeBuilder):
    """Builds the tree of a description; raises RobotDescriptionError beyond the limits."""

    def __init__(self) -> None:
        super().__init__()
        self._depth = self._count = 0

    def start(self, tag: str, attrs: dict[str, str]) -> Element:
        """Begin an element."""
        self._depth += 1
        self._count += 1
        if self._depth > _DEEPEST:
            raise RobotDescriptionError(
                f"elements more than {_DEEPEST} deep in each other, expected a URDF"
            )
        if self._count > _MOST_ELEMENTS:
            raise RobotDescriptionError(
                f"more than {_MOST_ELEMENTS} elements, expected the URDF of a robot"
            )
        return super().start(tag, attrs)

    def end(self, tag: str) -> Element:
        """End an element."""
        self._depth -= 1
        return super().end(tag)

    def doctype(self, name: str, pubid: str | None, system: str | None) -> None:
        """Refuse a document type: it can define entities, and a URDF has none."""
        raise RobotDescriptionError(
            "it has a DOCTYPE, which can let text grow without end: expected a URDF without one"
        )


class Urdf:
    """The links and joints of a robot description.

    Attributes
    ----------
    joints
        By name; only those of the robot, not those within transmissions or plugins.

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
        parser = ElementTree.XMLParser(target=_LimitedBuilder())
        try:
            parser.feed(text)
            root = parser.close()
        except (ElementTree.ParseError, ValueError) as error:
            raise RobotDescriptionError(f"it is no XML: {error}") from None
        if root.tag != "robot":
            raise RobotDescriptionError(
                f"its outermost element is {quoted(root.tag)}, expected 'robot'"
            )
        self._links = {link.get("name", ""): link for link in root.findall("link")}
        self.joints: dict[str, Joint] = {}
        self._above: dict[str, Joint] = {}
        for element in root.findall("joint"):
            joint = Joint(element)
            if joint.name in self.joints:
                raise RobotDescriptionError(f"two joints are called {quoted(joint.name)}")
            if joint.child in self._above:
                raise RobotDescriptionError(
                    f"link {quoted(joint.child)} is the child of two joints,"
                    f" {quoted(self._above[joint.child].name)} and {quoted(joint.name)}"
                )
            self.joints[joint.name] = self._above[joint.child] = joint

    def has_link(self, name: str) -> bool:
        """Whether there is a link of that name."""
        return name in self._links

    def chain(self, link: str) -> list[Joint]:
        """Return the joints from the root link down to a link."""
        chain: list[Joint] = []
        while link in self._above:
            chain.append(self._above[link])
            link = chain[-1].parent
            if len(chain) > _DEEPEST:
                raise RobotDescriptionError(
                    f"above link {quoted(chain[0].child)} are more than {_DEEPEST} joints, or they are"
                    " a circle"
                )
        return chain[::-1]

    def root(self, link: str) -> str:
        """Return the link at the top of the chain that a link is in."""
        chain = self.chain(link)
        return chain[0].parent if chain else link

    def pose(self, link: str, frame: str) -> Pose:
        """Return where a link is in the frame of another one, with all joints at zero."""
        if self.root(link) != self.root(frame):
            raise RobotDescriptionError(
                f"no joints connect link {quoted(link)} with link {quoted(frame)}"
            )
        return self._in_root(frame).inverse.of(self._in_root(link))

    def _in_root(self, link: str) -> Pose:
        pose = Pose(np.eye(3), np.zeros(3))
        for joint in self.chain(link):
            pose = pose.of(joint.origin)
        return pose

    def cylinder(self, link: str) -> Cylinder:
        """Return the largest cylinder of a link's collision, else of its visual."""
        element = self._links.get(link)
        if element is None:
            raise RobotDescriptionError(f"there is no link {quoted(link)}")
        for part in ("collision", "visual"):
            found = [
                _cylinder(body, shape, f"link {quoted(link)}")
                for body in element.findall(part)
                for shape in body.findall("geometry/cylinder")
            ]
            if found:
                return max(found, key=lambda cylinder: cylinder.radius)
        shapes = sorted({quoted(s.tag) for s in element.findall("*/geometry/*")})[:_MOST_SHAPES]
        raise RobotDescriptionError(
            f"link {quoted(link)} has {', '.join(shapes) or 'no geometry'}, expected a cylinder in"
            " its collision or visual"
        )


class Joint:
    """A joint; its numbers are read, and can be wrong, when they are asked for.

    kind: its type.
    """

    def __init__(self, element: Element) -> None:
        self._element = element
        self.name = element.get("name", "")
        self.kind = element.get("type", "")
        self.parent, self.child = (
            "" if end is None else end.get("link", "")
            for end in (element.find("parent"), element.find("child"))
        )

    @cached_property
    def origin(self) -> Pose:
        """Where the child link is in the parent link, with the joint at zero."""
        return _pose(self._element, f"joint {quoted(self.name)}")

    @property
    def axis(self) -> Array:
        """Direction that it turns about, (3,), of length 1, in the frame of the child link."""
        axis = _numbers(
            self._element.find("axis"), "xyz", (1.0, 0.0, 0.0), f"joint {quoted(self.name)}"
        )
        length = math.hypot(*axis)
        if length < 1e-6:
            raise RobotDescriptionError(f"joint {quoted(self.name)} has an axis without direction")
        return np.array(axis) / length


def _cylinder(body: Element, shape: Element, where: str) -> Cylinder:
    (radius,) = _numbers(shape, "radius", (0.0,), where)
    (length,) = _numbers(shape, "length", (0.0,), where)
    return Cylinder(radius, length, _pose(body, where))


def _pose(element: Element, where: str) -> Pose:
    """Read the element's origin; rpy are angles about the fixed axes x, y and z, in this order."""
    origin, nothing = element.find("origin"), (0.0, 0.0, 0.0)
    angles = _numbers(origin, "rpy", nothing, where)
    position = _numbers(origin, "xyz", nothing, where)
    return Pose(Rotation.from_euler("xyz", angles).as_matrix(), np.array(position))


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
