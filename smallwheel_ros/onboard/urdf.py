# SPDX-License-Identifier: Apache-2.0
"""A robot description (URDF): its links and joints by name, and their poses.

A pose is a homogeneous matrix, (4, 4), that converts positions (m) in the frame of a link to another frame.
"""

from __future__ import annotations

import math
import re
from typing import NamedTuple
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from smallwheel_ros.common.errors import SmallwheelError

Array = NDArray[np.float64]

TURNING = ("continuous", "revolute")
BASE = "base_link"
_EXPAND = "give what `xacro FILE > robot.urdf` writes"
_LARGEST = 1e6  # m or rad: beyond any robot, and products of it stay finite


class RobotDescriptionError(SmallwheelError):
    """A robot description that cannot be read, or lacks what is needed."""


class Joint(NamedTuple):
    """A joint of a robot description.

    Attributes
    ----------
    name, kind
        Name and type, such as `continuous`; empty if missing.
    parent, child
        Names of the links that it joins; it moves the child.
    element
        Its element of the XML.
    """

    name: str
    kind: str
    parent: str
    child: str
    element: Element

    @property
    def axis(self) -> Array:
        """Direction of its axis, (3,), of length 1, in the frame of the child link.

        Raises RobotDescriptionError if that has no direction, or is not three numbers.
        """
        axis = _numbers(self.element.find("axis"), "xyz", (1.0, 0.0, 0.0), f"joint {self.name!r}")
        length = float(np.linalg.norm(axis))
        if length < 1e-6:
            raise RobotDescriptionError(f"joint {self.name!r} has an axis without direction")
        return axis / length

    @property
    def full_turn(self) -> bool:
        """Whether it can make a full turn, as a wheel does; equal limits are treated as none."""
        if self.kind == "continuous":
            return True
        limit, where = self.element.find("limit"), f"joint {self.name!r}"
        low, high = (float(_numbers(limit, n, (0.0,), where)[0]) for n in ("lower", "upper"))
        return self.kind == "revolute" and not 0.0 < high - low < 2.0 * math.pi - 0.01


class Urdf:
    """The links and joints of a robot description, without those of transmissions and plugins.

    Parameters
    ----------
    text
        The URDF.

    Attributes
    ----------
    links
        Elements of the links, by name.
    joints
        The joints, by name.

    Raises
    ------
    RobotDescriptionError
        If the text is not a URDF, or two joints have one name or one child link.
    """

    def __init__(self, text: str) -> None:
        try:
            root = _tree(text)
        except (ElementTree.ParseError, ValueError) as error:
            raise RobotDescriptionError(
                f"it is no XML: {error}" if text.strip() else "it is empty"
            ) from None
        if root.tag != "robot":
            raise RobotDescriptionError(f"its outermost element is {root.tag!r}, expected 'robot'")
        macro = _macro(root)
        if macro:
            raise RobotDescriptionError(
                f"it is xacro that has not been expanded ({macro}): {_EXPAND}"
            )
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
        """Return the joints between a link and the root link, that next to the link first."""
        chain: list[Joint] = []
        while link in self._above:
            if len(chain) > len(self.joints):
                raise RobotDescriptionError(f"the joints above link {link!r} are a circle")
            chain.append(self._above[link])
            link = chain[-1].parent
        return chain

    def base(self, link: str) -> str:
        """Return the name of the base frame for a link: base_link, or without one its root link."""
        return BASE if BASE in self.links else self.root(link)

    def pose(self, link: str, frame: str) -> Array:
        """Compute the pose of a link in the frame of another one, with all joints at zero.

        Parameters
        ----------
        link, frame
            Names of the link, and of the link whose frame is used.

        Returns
        -------
        ndarray
            Shape (4, 4): homogeneous matrix, m.

        Raises
        ------
        RobotDescriptionError
            If no joints connect the two, or one of these has a wrong origin.
        """
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
        """Return the name of the link at the top of the chain of joints above a link."""
        return ([link] + [joint.parent for joint in self.chain(link)])[-1]

    def off_axis(self, joint: Joint) -> float:
        """Return the distance (m) of the middle of the link that a joint turns from its axis; 0 if unknown.

        The middle is the centre of mass, or without one the mean place of the boxes, cylinders and spheres of
        the collision, else of the visual; the origin of a mesh says nothing about its middle.
        """
        element, where = self.links.get(joint.child), f"link {joint.child!r}"
        if element is None:
            return 0.0
        mass = [body for body in element.findall("inertial") if body.find("origin") is not None]
        shaped = [
            body
            for part in ("collision", "visual")
            for body in element.findall(part)
            if body.find("geometry/mesh") is None and body.find("geometry") is not None
        ]
        bodies = mass or [body for body in shaped if body.tag == shaped[0].tag]
        if not bodies:
            return 0.0
        middle = np.mean([_origin(body, where)[:3, 3] for body in bodies], axis=0)
        return float(np.linalg.norm(middle - (middle @ joint.axis) * joint.axis))

    def cylinder(self, link: str) -> tuple[float, float, Array]:
        """Return the cylinder of largest radius of a link: of its collision, or else of its visual.

        Returns
        -------
        radius, length : float
            m.
        pose : ndarray
            Pose in the frame of the link, shape (4, 4), m; the cylinder's axis is along z.

        Raises
        ------
        RobotDescriptionError
            If there is no such link, or it has no cylinder.
        """
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
    """Read the pose (4, 4) of an element's origin.

    rpy are angles about the fixed axes x, y and z, in this order. where: the element in words, for errors.
    """
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


def _tree(text: str) -> Element:
    """Parse the XML; namespace prefixes that it does not declare are added, as in old files for Gazebo."""
    try:
        return ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        begin = re.search(r"<robot(?=[\s>])", text)
        if "unbound prefix" not in str(error) or begin is None:
            raise
        used = dict.fromkeys(re.findall(r"[<\s]/?([A-Za-z_][\w.-]*):[A-Za-z_]", text))
        own = [
            name for name in used if name not in ("xml", "xmlns") and f"xmlns:{name}=" not in text
        ]
        declared = "".join(f" xmlns:{name}='{name}'" for name in own)
        return ElementTree.fromstring(f"{text[: begin.end()]}{declared}{text[begin.end() :]}")


def _macro(root: Element) -> str:
    """Return in words what shows unexpanded xacro: an element of it, or ${} in a link or joint; else ""."""
    for element in root.iter():
        if "xacro" in element.tag.partition("}")[0]:
            return f"it has <xacro:{element.tag.rpartition('}')[2]}>"
    for part in (*root.findall("link"), *root.findall("joint")):
        for element in part.iter():
            for name, text in element.items():
                if name != "filename" and ("${" in text or "$(" in text):
                    return f"{name} of a {element.tag} is {text[:60]!r}"
    return ""
