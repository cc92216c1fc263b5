# SPDX-License-Identifier: Apache-2.0
"""Fill missing parameters of wheels from the robot description; the same for node and replay.

A parameter that is given takes precedence. What a description cannot fill is reported, with what it
contains and what was expected.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field

from smallwheel_ros.common.node_parameter import WHEEL, Value
from smallwheel_ros.onboard.declared import PARAMETERS
from smallwheel_ros.onboard.parameters import (
    ParametersError,
    elsewhere,
    for_each_wheel,
    problems,
    wheel_names,
)
from smallwheel_ros.onboard.running_gear import (
    PARALLEL,
    VehicleHeading,
    articulated,
    axis_of,
    carried_by,
    centre_of,
    contradicting,
    heading_of,
    steering_of,
)
from smallwheel_ros.onboard.urdf import BASE, TURNING, Joint, RobotDescriptionError, Urdf
from smallwheel_ros.physics.conditions import PRESSED

DESCRIPTION_TYPE = "std_msgs/msg/String"
_SIZE, _PLACE = ("diameter", "width"), ("lateral_position", "longitudinal_position")
_STEERING = ("steering_joint", "steering_sign", "steering_arm", "steering_zero")
_FILLED = (*_SIZE, *_PLACE, "joint_sign", "frame", *_STEERING)
_HEAVIEST = 1e5  # kg, as vehicle.mass


@dataclass(frozen=True)
class Filled:
    """Parameters from a robot description.

    Attributes
    ----------
    values
        Values by full name of the parameter, such as `front_left.diameter`; m, rad.
    lacking
        Sentences about parameters that could not be filled, and about contradictions.
    """

    values: dict[str, Value] = field(default_factory=dict)
    lacking: list[str] = field(default_factory=list)

    @property
    def text(self) -> str:
        """The values as `name=value`, separated by commas; "nothing" if there are none."""
        return ", ".join(f"{name}={value}" for name, value in self.values.items()) or "nothing"


def silent_parameters(given: Mapping[str, object]) -> list[str]:
    """Return the full names of parameters that a robot description may fill and that are not given.

    The list is empty if the wheels have no usable names.

    Parameters
    ----------
    given
        Values of parameters by full name; one that is None or absent is not given.
    """
    try:
        wheels = wheel_names(given.get("wheels"))
    except ParametersError:
        return []
    own = for_each_wheel(given)
    # A wheel that is declared not to be steered lacks no parameters of steering.
    fixed = {wheel for wheel in wheels if own.get(f"{wheel}.steering_joint") == ""}
    names = [
        f"{wheel}.{name}"
        for wheel in wheels
        for name in _FILLED
        if not (wheel in fixed and name in _STEERING)
    ]
    return [name for name in names if own.get(name) is None]


def described_mass(text: str) -> float | None:
    """Return the sum of the masses of all links of a URDF, kg, or None.

    None if only links that joints turn have a mass, or if the sum is 100 t or more. Raises
    RobotDescriptionError if the text is not a URDF.
    """
    urdf = Urdf(text)
    turned = {joint.child for joint in urdf.joints.values() if joint.kind in TURNING}
    masses = {}
    for name, link in urdf.links.items():
        element = link.find("inertial/mass")
        with suppress(ValueError):
            masses[name] = float(element.get("value", "")) if element is not None else 0.0
    body = sum(mass for name, mass in masses.items() if name not in turned)
    total = round(sum(masses.values()), 3)
    return total if body > 0.0 and 0.0 < total < _HEAVIEST else None


def needs_description(given: Mapping[str, object]) -> list[str]:
    """Return the full names of missing diameters and widths, for which it is worth waiting for a description.

    Empty if there are none, or if another parameter is wrong, which a description would not mend.
    """
    needed = [name for name in silent_parameters(given) if name.endswith(_SIZE)]
    return needed if len(problems(given)) == len(needed) else []


def fill_silent(text: str, given: Mapping[str, object]) -> Filled:
    """Fill the wheels' missing parameters from a robot description (URDF).

    A wheel's frame is the link that its joint moves; diameter and width are those of the cylinder of this
    link. Its position is that of the cylinder's middle in the base frame, with all joints at zero. The
    joint's sign is 1 if its axis points to the left, -1 to the right. The joint that steers it is the nearest
    one above it that turns about the vertical.

    Parameters
    ----------
    text
        The URDF.
    given
        Values of parameters by full name, as in `silent_parameters`; these are not filled.

    Returns
    -------
    Filled
        The values, and sentences about what is lacking.

    Raises
    ------
    RobotDescriptionError
        If the text is not a URDF, or if one of its joints steers several wheels.
    ParametersError
        If the wheels have no usable names.
    """
    urdf, filled, silent = Urdf(text), Filled(), silent_parameters(given)
    given = for_each_wheel(given)
    heading = _heading(urdf, given, silent, filled)
    for wheel in wheel_names(given.get("wheels")):
        failed: dict[str, list[str]] = {}  # parameters, by what is wrong
        for names, find in ((_SIZE, _size), (_PLACE, _place), (("joint_sign",), _sign)):
            wanted = {f"{wheel}.{name}": i for i, name in enumerate(names)}
            wanted = {name: i for name, i in wanted.items() if name in silent}
            if not wanted:
                continue
            try:
                found = find(urdf, *_mounting(urdf, wheel, given), heading)
            except RobotDescriptionError as error:
                failed.setdefault(str(error), []).extend(wanted)
                continue
            for name, i in wanted.items():
                parameter = PARAMETERS[f"{WHEEL}.{name.partition('.')[2]}"].for_wheel(wheel)
                problem = parameter.problem(found[i])
                if problem is None:
                    filled.values[name] = found[i]
                else:
                    filled.lacking.append(f"robot description: {problem}")
        for why, lacking in failed.items():
            filled.lacking.append(f"robot description: {', '.join(lacking)}: {why}")
        if f"{wheel}.frame" in silent:
            with suppress(RobotDescriptionError):  # reported with the wheel's other parameters
                filled.values[f"{wheel}.frame"] = _mounting(urdf, wheel, given)[0].child
        if (
            given.get(f"{wheel}.contact") != PRESSED
            and given.get(f"{wheel}.steering_joint") is None
        ):
            filled.values.update(_steering(urdf, wheel, given, heading))
        elif given.get(f"{wheel}.steering_joint"):
            own = _steering(urdf, wheel, given, heading)
            same = own.get(f"{wheel}.steering_joint") == given[f"{wheel}.steering_joint"]
            filled.values.update({n: v for n, v in own.items() if same and n in silent})
    for text in elsewhere(filled.values, given):
        filled.lacking.append(f"robot description: {text}: the description's is taken")
    return filled


def _heading(
    urdf: Urdf, given: Mapping[str, object], silent: list[str], filled: Filled
) -> VehicleHeading:
    """Direction in which the vehicle faces in the base frame; remarks on it are added to `filled.lacking`."""
    wheels, base = {}, BASE
    for wheel in wheel_names(given.get("wheels")):
        try:
            wheels[wheel], base = _mounting(urdf, wheel, given)
            axis_of(urdf, wheels[wheel], base)
        except RobotDescriptionError:  # reported where its position is looked for
            wheels.pop(wheel, None)
    wanted = {
        f"{wheel}.{name}" for wheel in wheels for name in (*_PLACE, "joint_sign", "steering_joint")
    }
    if not wanted & {*silent}:
        return VehicleHeading(0)
    heading = heading_of(urdf, wheels, base)
    if heading.quarters:
        filled.lacking.append(f"robot description: {heading.note}")
    filled.lacking.extend(
        f"robot description: {wheel} is not where its name says: check its place and its joint"
        for wheel in contradicting(urdf, wheels, base, heading)
    )
    return heading


def _mounting(urdf: Urdf, wheel: str, given: Mapping[str, object]) -> tuple[Joint, str]:
    """Return the joint that turns a wheel, and the name of the base frame's link.

    That link is the one that is given or base_link, or the root link if there is no base_link.
    """
    name = given.get(f"{wheel}.joint") or f"{wheel}_joint"
    joint = urdf.joints.get(str(name))
    if joint is None:
        there = [repr(joint.name) for joint in urdf.joints.values() if joint.kind in TURNING]
        more = " and others" if len(there) > 5 else ""
        raise RobotDescriptionError(
            f"there is no joint {name!r}, expected parameter {wheel}.joint to be one that"
            f" turns: {', '.join(there[:5]) or 'there is none'}{more}"
        )
    base = str(given.get("base_frame") or BASE)
    if base not in urdf.links and base != BASE:
        words = "expected parameter base_frame to be one"
        raise RobotDescriptionError(f"there is no link {base!r}, {words}")
    return joint, base if base in urdf.links else urdf.base(joint.child)


def _size(urdf: Urdf, joint: Joint, base: str, heading: VehicleHeading) -> tuple[float, float]:
    """Diameter and width (m) of the wheel that a joint turns, from its cylinder."""
    radius, length, pose = urdf.cylinder(joint.child)
    if abs(float(pose[:3, 2] @ joint.axis)) < PARALLEL:
        raise RobotDescriptionError(
            f"the cylinder of link {joint.child!r} is not about the axis of joint {joint.name!r},"
            " expected its z along that axis"
        )
    return 2.0 * radius, length


def _place(urdf: Urdf, joint: Joint, base: str, heading: VehicleHeading) -> tuple[float, float]:
    """Lateral and longitudinal position (m) of a wheel: of its cylinder's middle, if it has one."""
    centre = centre_of(urdf, joint, base)
    if heading.quarters is None:
        raise RobotDescriptionError(heading.note)
    x, y = (round(float(m), 9) + 0.0 for m in heading.turned(centre)[:2])  # no -0.0, no rounding
    return y, x


def _sign(urdf: Urdf, joint: Joint, base: str, heading: VehicleHeading) -> tuple[int]:
    """Sign of a wheel's joint: 1 if its axis points to the left, so that it turns forward, else -1."""
    if joint.kind not in TURNING:
        kinds = " or ".join(TURNING)
        raise RobotDescriptionError(f"joint {joint.name!r} is {joint.kind!r}, expected {kinds}")
    axis = axis_of(urdf, joint, base)
    if heading.quarters is None:
        raise RobotDescriptionError(heading.note)
    left = float(heading.turned(axis)[1])
    if abs(left) < PARALLEL:
        found = " ".join(f"{number:.2f}" for number in axis)
        raise RobotDescriptionError(
            f"the axis of joint {joint.name!r} is ({found}) in {base!r}, expected (0 1 0) or (0 -1 0)"
        )
    return (1 if left > 0.0 else -1,)


def _steering(
    urdf: Urdf, wheel: str, given: Mapping[str, object], heading: VehicleHeading
) -> dict[str, Value]:
    """Parameters of a wheel's steering by full name; empty if nothing steers it, or its joint is unknown.

    Raises RobotDescriptionError where the joint that steers it carries other wheels, too.
    """
    try:
        mounting = _mounting(urdf, wheel, given)
        found = steering_of(urdf, *mounting, heading)
    except RobotDescriptionError:  # reported where its position is looked for
        return {}
    if found is None:
        return {}
    wheels = {}
    for name in wheel_names(given.get("wheels")):
        with suppress(RobotDescriptionError):
            wheels[name] = _mounting(urdf, name, given)[0]
    carried = carried_by(urdf, found.joint, wheels, mounting[1])
    if len(carried) > 1:
        raise RobotDescriptionError(articulated(found.joint, carried))
    values: dict[str, Value] = {"steering_joint": found.joint}
    if found.sign != PARAMETERS[f"{WHEEL}.steering_sign"].default:
        values["steering_sign"] = found.sign
    values["steering_arm"] = found.arm
    if found.zero:
        values["steering_zero"] = found.zero
    return {f"{wheel}.{name}": value for name, value in values.items()}
