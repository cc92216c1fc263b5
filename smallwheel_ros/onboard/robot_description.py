# SPDX-License-Identifier: Apache-2.0
"""Fill parameters of wheels that are silent from the robot description; same for node and replay.

A parameter that is given wins. What a description cannot fill is said, with what was found in it
and what was expected.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field

from smallwheel_ros.common.parameter import WHEEL
from smallwheel_ros.onboard.parameter_table import PARAMETERS
from smallwheel_ros.onboard.parameters import ParametersError, problems, wheel_names
from smallwheel_ros.onboard.urdf import (
    TURNING,
    Array,
    Joint,
    RobotDescriptionError,
    Urdf,
    listed,
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
    if urdf.has_link(name):
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
