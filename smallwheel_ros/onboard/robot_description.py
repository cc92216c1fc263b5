"""Fill parameters of wheels that are silent from the robot description; same for node and replay.

A parameter that is given wins. What a description cannot fill is said, with what was found in it
and what was expected.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from smallwheel_ros.onboard.parameter_table import parameters_for
from smallwheel_ros.onboard.parameters import (
    ParametersError,
    problems,
    wheel_names,
)
from smallwheel_ros.onboard.urdf import (
    TURNING,
    Joint,
    Pose,
    RobotDescriptionError,
    Urdf,
    quoted,
)
from smallwheel_ros.physics.conditions import PRESSED

DESCRIPTION_TYPE = "std_msgs/msg/String"

_SIZE = ("diameter", "width")
_PLACE = ("lateral_position", "longitudinal_position")
_SIGN = ("joint_sign",)
# Directions within 25 degrees of each other: more than wheels are cambered or toed in, and far from
# the 90 degrees by which an axis or a cylinder is turned by mistake.
_ALONG = 0.9
_UPRIGHT = 0.7  # an axis within 45 degrees of the vertical steers
_DIGITS = 9  # of metres: products of rotations are only exact to rounding
_MOST_NAMES = 8
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
    silent = silent_parameters(given)
    needed = [name for name in silent if name.endswith(_SIZE)]
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
    urdf = Urdf(text)
    wheels = wheel_names(given.get("wheels"))
    silent, table = silent_parameters(given), {p.name: p for p in parameters_for(wheels)}
    filled = Filled()
    for wheel in wheels:
        wanted = [name for name in silent if name.startswith(f"{wheel}.")]
        if not wanted:
            continue
        try:
            of_wheel = _Wheel(urdf, wheel, given)
        except RobotDescriptionError as error:
            filled.lacking.append(f"robot description: {', '.join(wanted)}: {error}")
            continue
        for names, find in (
            (_SIZE, of_wheel.size),
            (_PLACE, of_wheel.place),
            (_SIGN, of_wheel.sign),
        ):
            missing = [name for name in names if f"{wheel}.{name}" in wanted]
            if not missing:
                continue
            try:
                found = dict(zip(names, find(), strict=True))
            except RobotDescriptionError as error:
                parameters = ", ".join(f"{wheel}.{name}" for name in missing)
                filled.lacking.append(f"robot description: {parameters}: {error}")
                continue
            for name in missing:
                parameter = table[f"{wheel}.{name}"]
                problem = parameter.problem(found[name])
                if problem is None:
                    filled.values[parameter.name] = found[name]
                else:
                    filled.lacking.append(f"robot description: {problem}")
        filled.lacking.extend(of_wheel.steering)
    return filled


class _Wheel:
    """A wheel in a robot description. Its methods raise RobotDescriptionError for what it lacks."""

    def __init__(self, urdf: Urdf, wheel: str, given: Mapping[str, object]) -> None:
        self._urdf = urdf
        self._wheel = wheel
        self._rolls = given.get(f"{wheel}.contact") != PRESSED
        self._joint = _joint(urdf, wheel, given.get(f"{wheel}.joint"))
        self._base = _base(urdf, self._joint.child, given.get("base_frame"))

    @property
    def _pose(self) -> Pose:
        """Of the wheel's link in the base frame."""
        return self._urdf.pose(self._joint.child, self._base)

    def size(self) -> tuple[float, float]:
        """Return diameter and width, m."""
        cylinder = self._urdf.cylinder(self._joint.child)
        along = abs(float(cylinder.pose.rotation[:, 2] @ self._joint.axis))
        if along < _ALONG:
            raise RobotDescriptionError(
                f"the cylinder of link {quoted(self._joint.child)} is not about the axis of joint"
                f" {quoted(self._joint.name)}, expected its z along that axis"
            )
        return 2.0 * cylinder.radius, cylinder.length

    def place(self) -> tuple[float, float]:
        """Return lateral and longitudinal position, m: of the cylinder's middle where it has one."""
        pose = self._pose
        try:
            middle = self._urdf.cylinder(self._joint.child).pose.position
        except RobotDescriptionError:
            x, y, _ = pose.position
        else:
            x, y, _ = pose.position + pose.rotation @ middle
        return round(float(y), _DIGITS) + 0.0, round(float(x), _DIGITS) + 0.0  # no -0.0

    def sign(self) -> tuple[int]:
        """Return the joint's sign: a turn about +y takes the top of the wheel forward."""
        name = quoted(self._joint.name)
        if self._joint.kind not in TURNING:
            raise RobotDescriptionError(
                f"joint {name} is {quoted(self._joint.kind)}, expected {' or '.join(TURNING)}"
            )
        axis = self._pose.rotation @ self._joint.axis
        if abs(axis[1]) < _ALONG:
            found = " ".join(f"{number:.2f}" for number in axis)
            raise RobotDescriptionError(
                f"the axis of joint {name} is ({found}) in {quoted(self._base)}, expected (0 1 0)"
                " or (0 -1 0)"
            )
        return (1 if axis[1] > 0.0 else -1,)

    @property
    def steering(self) -> list[str]:
        """A sentence where the wheel is steered."""
        if not self._rolls:
            return []
        try:
            for joint in self._urdf.chain(self._joint.parent):
                axis = self._urdf.pose(joint.child, self._base).rotation @ joint.axis
                if joint.kind in TURNING and abs(axis[2]) > _UPRIGHT:
                    return [
                        f"wheel {self._wheel} is steered by joint {quoted(joint.name)}: steering is"
                        " not read, its slip is that of a wheel that points straight ahead"
                    ]
        except RobotDescriptionError:
            pass  # what is wrong in the chain has been said of the place
        return []


def _joint(urdf: Urdf, wheel: str, given: object) -> Joint:
    name = given if isinstance(given, str) and given else f"{wheel}_joint"
    joint = urdf.joints.get(name)
    if joint is None:
        there = [quoted(j.name) for j in urdf.joints.values() if j.kind in TURNING]
        more = " and others" if len(there) > _MOST_NAMES else ""
        raise RobotDescriptionError(
            f"there is no joint {quoted(name)}, expected parameter {wheel}.joint to be one that"
            f" turns: {', '.join(there[:_MOST_NAMES]) or 'there is none'}{more}"
        )
    return joint


def _base(urdf: Urdf, link: str, given: object) -> str:
    """Return the base frame: the one that is given, else base_link, else the root of the link."""
    name = given if isinstance(given, str) and given else _BASE
    if urdf.has_link(name):
        return name
    if name == _BASE:
        return urdf.root(link)
    raise RobotDescriptionError(
        f"there is no link {quoted(name)}, expected parameter base_frame to be one"
    )
