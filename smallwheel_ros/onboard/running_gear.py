# SPDX-License-Identifier: Apache-2.0
"""Recognition of the joints of a robot description that turn and steer wheels, and of the way ahead.

Wheels and steering need neither names nor shapes: a wheel turns about a horizontal axis across the vehicle,
has no such joint below it, and is among the lowest joints. It is steered by the nearest joint above it that
turns about the vertical. The base's x points ahead (REP 103), unless the wheels turn about it: then their
names have to show the way ahead.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np

from smallwheel_ros.onboard.urdf import TURNING, Array, Joint, RobotDescriptionError, Urdf
from smallwheel_ros.onboard.wheel_names import ACROSS, ALONG, called_by_place, place_of

# Directions within 25 degrees of each other: more than wheels are cambered or toed in, and far from
# the 90 degrees by which an axis or a cylinder is turned by mistake.
PARALLEL = 0.9
_STRAIGHT = 0.01  # rad: what rounding leaves of an axis in a description
_UPRIGHT = 0.7  # an axis within 45 degrees of the vertical steers
_LOWEST = 0.25  # of the height over which joints turn: a wheel is no higher above the lowest one
# Of the length or width of the vehicle: wheels of two sizes, and rockers, whose joints are all low.
_LEVEL = 0.1
# Joints above the last one of an arm. A wheel has four at most: of deployment, rocker, bogie, steering.
_OF_ARM = 5
# Of the length, width or height over which joints turn. A wheel is balanced: in 29 of 30 public descriptions
# its centre of mass is on its axis, to .2 % of that; that of a shank 4 % and more off.
_BALANCED = 0.02
_TRAIL = 0.1  # of its height above a wheel: a swivel so far ahead of the wheel's axis is a caster's
_OF_TRACK = 3  # wheels of a side, from which others above them in line make it a track
_IN_LINE = 0.15  # of the vehicle's width: rollers are beside sprockets
_OTHER_SIDE = {"left": "right", "right": "left"}
_SHOWN = 6  # joints that are named
_AHEAD = (
    (1.0, 0.0),
    (0.0, 1.0),
    (-1.0, 0.0),
    (0.0, -1.0),
)  # by quarter turns of the base to the left


class Steering(NamedTuple):
    """How a joint steers a wheel.

    Attributes
    ----------
    joint
        Name of the joint.
    sign
        1 if its position is positive to the left, else -1.
    arm
        Distance of the wheel's middle to the left of the joint's axis, m.
    zero
        Position of the joint at which the wheel points straight ahead, rad.
    """

    joint: str
    sign: int
    arm: float
    zero: float = 0.0


@dataclass
class RunningGear:
    """The joints of a vehicle that turn wheels.

    Attributes
    ----------
    wheels
        These joints.
    notes
        Sentences about other joints that turn, and about oddities.
    """

    wheels: list[Joint] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)


class VehicleHeading(NamedTuple):
    """Direction in which a vehicle faces in its base frame.

    Attributes
    ----------
    quarters
        Number of 90-degree turns to the left from the frame's x to straight ahead, 0 to 3; None if unknown.
    note
        Explanation for the user if `quarters` is not 0; else empty.
    """

    quarters: int | None
    note: str = ""

    def turned(self, vector: Array) -> Array:
        """Convert a direction or position in the base frame, (3,), to components ahead, left and up.

        An unknown heading counts as along x.
        """
        cosine, sine = _AHEAD[self.quarters or 0]
        x, y, z = vector
        return np.array([cosine * x + sine * y, cosine * y - sine * x, z])


class _Turning(NamedTuple):
    """A joint that turns, in the base frame; m.

    axis: direction of its axis. at: a point on that. centre: middle of its child link's cylinder, or
    `at` if it has none. low: height of the cylinder's lowest point. above: the turning joints between it
    and the base, the nearest first.
    """

    joint: Joint
    axis: Array
    at: Array
    centre: Array
    low: float
    above: list[Joint]


def centre_of(urdf: Urdf, joint: Joint, base: str) -> Array:
    """Compute the position of a wheel's middle: of its cylinder, or without one of its link's origin.

    Parameters
    ----------
    urdf, joint
        The robot's description, and the joint that turns the wheel.
    base
        Name of the base frame's link.

    Returns
    -------
    ndarray
        Shape (3,), in the base frame, m.
    """
    pose = urdf.pose(joint.child, base)
    with suppress(RobotDescriptionError):
        pose = pose @ urdf.cylinder(joint.child)[2]
    return np.asarray(pose[:3, 3])


def axis_of(urdf: Urdf, joint: Joint, base: str) -> Array:
    """Compute the direction of a joint's axis in the base frame.

    Parameters
    ----------
    urdf, joint
        The robot's description and the joint.
    base
        Name of the base frame's link.

    Returns
    -------
    ndarray
        Shape (3,), of length 1.
    """
    return np.asarray(urdf.pose(joint.child, base)[:3, :3] @ joint.axis)


def running_gear(urdf: Urdf) -> RunningGear:
    """Find the joints that turn wheels.

    Raises RobotDescriptionError with the reason if there are none, or if the vehicle is tracked or
    articulated.
    """
    all_ = [joint for joint in urdf.joints.values() if joint.kind in TURNING]
    if not all_:
        raise RobotDescriptionError(_none_turns(urdf))
    base = urdf.base(all_[0].child)
    notes, turning = [], {}
    for joint in all_:
        try:
            turning[joint.name] = _turning(urdf, joint, base)
        except RobotDescriptionError as error:
            notes.append(f"{joint.name} is left out: {error}")
    across = _across(turning.values())
    why = {
        name: _no_wheel(one, turning, across) or _leg(urdf, one, turning, across)
        for name, one in turning.items()
    }
    could = [turning[name] for name, reason in why.items() if not reason]
    if could:
        highest = _height(could, turning.values())
        for one in could:
            above = min(_above_lowest(could, one, "low"), _above_lowest(could, one, "middle"))
            if above > highest:
                why[one.joint.name] = f"{above:.2g} m above the lowest wheel"
        why |= dict.fromkeys(_mates(could, why), "")
    wheels = [one for one in could if not why[one.joint.name]]
    _refuse_tracks(wheels, [one for one in could if why[one.joint.name]], across)
    if (
        len(wheels) == 1
        and "wheel" not in f"{wheels[0].joint.name} {wheels[0].joint.child}".lower()
    ):
        raise RobotDescriptionError(
            f"one joint alone turns about a horizontal axis and without end, {wheels[0].joint.name!r}, and"
            " nothing calls it a wheel"
        )
    steering = {name for one in wheels if (name := _steered_by(one, turning))}
    for name in sorted(steering):
        carried = [one.joint.name for one in wheels if _steered_by(one, turning) == name]
        if len(carried) > 1:
            raise RobotDescriptionError(articulated(name, carried))
    left = {n: reason for n, reason in why.items() if reason and n not in steering}
    if not wheels:
        words = "; ".join(notes + _left_out(left) + _fixed_wheels(urdf))
        raise RobotDescriptionError(
            f"no joint turns like a wheel, about a horizontal axis and without end: {words}"
        )
    for one in wheels:
        notes += [
            f"{joint.name} is called a steering joint, but turns about"
            f" {_shown(turning[joint.name].axis)}: what steers {one.joint.name} is not known from it: give"
            " steering_joint"
            for joint in one.above
            if "steer" in joint.name.lower()
            and joint.name in turning
            and joint.name not in steering
        ]
        left = {name: reason for name, reason in left.items() if not _is_steer(name, one)}
    notes += [f"joints that turn and are no wheels: {words}" for words in _left_out(left)]
    return RunningGear([one.joint for one in wheels], notes)


def _mates(could: list[_Turning], why: Mapping[str, str]) -> list[str]:
    """Names of joints that are too high, as on tilted rockers, but called wheels like one on the other side.

    why: for each joint the reason why it is no wheel; empty for a wheel.
    """
    low = [place_of(one.joint.name) for one in could if not why[one.joint.name]]
    found = []
    for one in could:
        name = one.joint.name
        other = {_OTHER_SIDE.get(word, word) for word in place_of(name)}
        alone = place_of(name) not in low and other in low
        if why[name] and "wheel" in name.lower() and len(other) > 1 and alone:
            found.append(name)
    return found


def _refuse_tracks(wheels: list[_Turning], higher: list[_Turning], across: int) -> None:
    """Raise RobotDescriptionError if on both sides higher joints are in line with wheels, as on tracks.

    across: axis of the base frame, 0 or 1, that is across the vehicle.
    """
    sides = [float(one.centre[across]) for one in wheels]
    middle = 0.5 * (max(sides, default=0.0) + min(sides, default=0.0))
    line = _IN_LINE * (max(sides, default=0.0) - min(sides, default=0.0))
    for sign in (1.0, -1.0):
        row = [y for y in sides if sign * (y - middle) > 0.0]
        above = [one for one in higher if row and abs(one.centre[across] - np.median(row)) < line]
        if len(row) < _OF_TRACK or not above:
            return
    names = ", ".join(one.joint.name for one in higher[:_SHOWN])
    raise RobotDescriptionError(
        f"{len(wheels)} joints turn like wheels, in two rows, and higher ones in line with them ({names}):"
        " the rollers, sprockets and idlers of tracks? A tracked vehicle is not estimated"
    )


def _is_steer(name: str, one: _Turning) -> bool:
    return "steer" in name.lower() and name in [joint.name for joint in one.above]


def steering_of(
    urdf: Urdf, joint: Joint, base: str, heading: VehicleHeading | None = None
) -> Steering | None:
    """Find the joint that steers a wheel.

    Parameters
    ----------
    urdf, joint
        The robot's description, and the joint that turns the wheel.
    base
        Name of the base frame's link.
    heading
        Direction in which the vehicle faces; None: along the base frame's x.

    Returns
    -------
    Steering or None
        The nearest joint above the wheel that turns about the vertical; None if there is none.

    Raises
    ------
    RobotDescriptionError
        If the description does not give the position of one of these joints in the base frame.
    """
    heading = heading or VehicleHeading(0)
    above = {j.name: _turning(urdf, j, base) for j in _above(urdf, joint, base)}
    wheel = _turning(urdf, joint, base)
    name = _steered_by(wheel, above)
    if not name:
        return None
    arm = round(float(heading.turned(wheel.centre - above[name].at)[1]), 9) + 0.0
    sign = 1 if above[name].axis[2] > 0.0 else -1
    ahead, left, _ = heading.turned(wheel.axis)
    toe = math.atan2(-math.copysign(ahead, ahead * left), abs(left)) if left else 0.0
    zero = 0.0 if abs(toe) < _STRAIGHT else round(-sign * toe, 6)
    return Steering(name, sign, arm, zero)


def carried_by(urdf: Urdf, steering: str, wheels: Mapping[str, Joint], base: str) -> list[str]:
    """Return the names of the wheels that a joint steers.

    Parameters
    ----------
    urdf
        The robot's description.
    steering
        Name of the steering joint.
    wheels
        The joint that turns each wheel, by the wheel's name.
    base
        Name of the base frame's link.
    """
    return [
        name
        for name, joint in wheels.items()
        if (found := steering_of(urdf, joint, base)) is not None and found.joint == steering
    ]


def articulated(joint: str, wheels: Iterable[str]) -> str:
    """Return a sentence that a joint steers several wheels, and that such a vehicle is not estimated.

    Parameters
    ----------
    joint
        Name of the joint.
    wheels
        Names of the wheels.
    """
    return (
        f"joint {joint!r} turns about the vertical and carries the wheels of {', '.join(wheels)}: a"
        " vehicle that is steered by an axle or in its middle (articulated) is not estimated"
    )


def heading_of(urdf: Urdf, wheels: Mapping[str, Joint], base: str) -> VehicleHeading:
    """Find the direction in which the vehicle faces in its base frame, by the axes and names of its wheels.

    Parameters
    ----------
    urdf
        The robot's description.
    wheels
        The joint that turns each wheel, by the wheel's name.
    base
        Name of the base frame's link.

    Returns
    -------
    VehicleHeading
        Along x unless names and positions of all wheels show another direction; unknown if all wheels turn
        about x and their names do not show it.

    Raises
    ------
    RobotDescriptionError
        If a wheel's position is unknown.
    """
    centres = {name: centre_of(urdf, joint, base) for name, joint in wheels.items()}
    axes = [axis_of(urdf, joint, base) for joint in wheels.values()]
    sideways = sum(abs(axis[0]) > PARALLEL for axis in axes)
    if sideways and sideways == len(axes):
        possible, usual = (1, 3), None
    else:
        possible, usual = (0, 2), 0
    agreeing = [q for q in possible if _agrees(centres, wheels, VehicleHeading(q)) is True]
    if usual in agreeing or len(agreeing) != 1:
        if usual is not None:
            return VehicleHeading(usual)
        return VehicleHeading(None, _not_ahead(base, list(wheels.values())))
    (quarters,) = agreeing
    where = {1: "to the left of", 2: "opposite to", 3: "to the right of"}[quarters]
    return VehicleHeading(
        quarters,
        f"{base} is turned: by their names and places the wheels' way ahead is {where} its x axis; places and"
        " signs are those of a base whose x is ahead (REP 103)",
    )


def contradicting(
    urdf: Urdf, wheels: Mapping[str, Joint], base: str, heading: VehicleHeading
) -> list[str]:
    """Return the names of wheels whose positions contradict their names, such as a left one on the right.

    Parameters
    ----------
    urdf
        The robot's description.
    wheels
        The joint that turns each wheel, by the wheel's name.
    base
        Name of the base frame's link.
    heading
        Direction in which the vehicle faces.
    """
    centres = {name: centre_of(urdf, joint, base) for name, joint in wheels.items()}
    placed = called_by_place({n: _xy(heading.turned(c)) for n, c in centres.items()})
    if placed is None:
        return []
    return [n for n, joint in wheels.items() if _against(_told(n, joint), placed[n].split("_"))]


def _agrees(
    centres: Mapping[str, Array], wheels: Mapping[str, Joint], heading: VehicleHeading
) -> bool | None:
    """Whether names and positions of all wheels agree if the vehicle faces so; None if names show too little.

    centres: position of each wheel's middle, (3,), m.
    """
    placed = called_by_place({n: _xy(heading.turned(c)) for n, c in centres.items()})
    if placed is None:
        return None
    told = {name: _told(name, joint) for name, joint in wheels.items()}
    if any(_against(told[name], placed[name].split("_")) for name in wheels):
        return False
    words = {word for name in wheels for word in told[name] & {*placed[name].split("_")}}
    return True if len(words) > 1 else None


def _told(wheel: str, joint: Joint) -> set[str]:
    """Words for the place of a wheel in its name, or if that has none in its joint's name."""
    return place_of(wheel) or place_of(joint.name)


def _against(told: set[str], placed: Iterable[str]) -> bool:
    """Whether the words for two places contradict each other, along the vehicle or across it."""
    there = {*placed}
    return any(
        told & {*axis} and there & {*axis} and not told & there & {*axis}
        for axis in (ALONG, ACROSS)
    )


def _xy(centre: Array) -> tuple[float, float]:
    return float(centre[0]), float(centre[1])


# --- One joint


def _above(urdf: Urdf, joint: Joint, base: str) -> list[Joint]:
    """Joints that turn between a joint and the base, the nearest first."""
    fixed = {above.name for above in urdf.chain(base)}
    return [j for j in urdf.chain(joint.parent) if j.kind in TURNING and j.name not in fixed]


def _turning(urdf: Urdf, joint: Joint, base: str) -> _Turning:
    centre = centre_of(urdf, joint, base)
    low = float(centre[2])
    with suppress(RobotDescriptionError):
        low -= urdf.cylinder(joint.child)[0]
    at = np.asarray(urdf.pose(joint.child, base)[:3, 3])
    axis, above = axis_of(urdf, joint, base), _above(urdf, joint, base)
    return _Turning(joint, axis, at, centre, low, above)


def _across(turning: Iterable[_Turning]) -> int:
    """Index of the base frame's axis about which most joints turn that may be wheels: 0 is x, 1 is y.

    Only low joints count, since those of an arm turn about all axes.
    """
    free = [one for one in turning if one.joint.full_turn and max(abs(one.axis[:2])) > PARALLEL]
    heights = [float(one.centre[2]) for one in free] or [0.0]
    highest = min(heights) + max(_LOWEST * (max(heights) - min(heights)), 1e-3)
    free = [one for one in free if one.centre[2] <= highest]
    about = [sum(abs(one.axis[i]) > PARALLEL for one in free) for i in (0, 1)]
    return 0 if about[0] > about[1] else 1


def _no_wheel(one: _Turning, turning: Mapping[str, _Turning], across: int) -> str:
    """Reason in words why a joint turns no wheel, whatever its height; empty if it may turn one.

    across: axis of the base frame, 0 or 1, that is across the vehicle.
    """
    if abs(one.axis[across]) < PARALLEL:
        return f"about {_shown(one.axis)}"
    below = [
        other.joint.name
        for other in turning.values()
        if one.joint in other.above and abs(other.axis[across]) > PARALLEL
    ]
    if below:
        return f"above {below[0]}"
    if not one.joint.full_turn:
        return "limited to less than a turn"
    if len(one.above) >= _OF_ARM and "wheel" not in f"{one.joint.name} {one.joint.child}".lower():
        return f"at the end of {len(one.above)} others: an arm"
    return _caster(one, turning)


def _leg(urdf: Urdf, one: _Turning, turning: Mapping[str, _Turning], across: int) -> str:
    """Reason in words why a joint is the knee of a leg; empty if it is none, or is called a wheel.

    A knee is below a parallel joint, and its link hangs to one side of its axis. So may a wheel whose centre
    of mass was typed wrongly, but that is mostly attached to the base or to a steering joint.
    """
    size = float(np.ptp([other.at for other in turning.values()], axis=0).max())
    called = "wheel" in f"{one.joint.name} {one.joint.child}".lower()
    hips = [j for j in one.above[:1] if j.name in turning]
    if called or not any(abs(turning[j.name].axis[across]) > PARALLEL for j in hips):
        return ""
    off = urdf.off_axis(one.joint)
    return "its link is not balanced about the axis, a leg" if off > _BALANCED * size else ""


def _caster(one: _Turning, turning: Mapping[str, _Turning]) -> str:
    """Return "a caster" if a joint turns a wheel that trails an undriven swivel; else an empty text."""
    name = _steered_by(one, turning)
    called = f"{name} {one.joint.name} {one.joint.child}".lower()
    if "caster" in called or "castor" in called:
        return "a caster"
    if not name:
        return ""
    swivel = turning[name]
    away = one.centre - swivel.at
    trail = float(np.linalg.norm((away - (away @ one.axis) * one.axis)[:2]))
    trails = trail > _TRAIL * max(swivel.at[2] - one.low, 0.0) + 1e-3
    return "a caster" if swivel.joint.kind == "continuous" and trails else ""


def _steered_by(one: _Turning, turning: Mapping[str, _Turning]) -> str:
    """Name of the nearest joint above a wheel that turns about the vertical; empty without one."""
    upright = (
        joint.name
        for joint in one.above
        if joint.name in turning and abs(turning[joint.name].axis[2]) > _UPRIGHT
    )
    return next(upright, "")


def _above_lowest(could: list[_Turning], one: _Turning, what: Literal["low", "middle"]) -> float:
    """Height (m) of the lowest point or the middle of a joint's link above the lowest one of `could`."""
    heights = {id(o): o.low if what == "low" else float(o.centre[2]) for o in could}
    return heights[id(one)] - min(heights.values())


def _height(could: list[_Turning], turning: Iterable[_Turning]) -> float:
    """Largest height (m) of a wheel above the lowest one.

    could: joints that may be wheels. turning: all joints that turn.
    """
    heights = [float(one.centre[2]) for one in turning]
    places = np.array([one.centre[:2] for one in could])
    return max(
        _LOWEST * (max(heights) - min(heights)), _LEVEL * float(np.ptp(places, axis=0).max()), 1e-3
    )


# --- Words


def _none_turns(urdf: Urdf) -> str:
    kinds = sorted({joint.kind or "of no type" for joint in urdf.joints.values()})
    if not urdf.joints:
        return f"it has no joint, {len(urdf.links)} links: is it one part of a description?"
    return (
        f"none of its {len(urdf.joints)} joints turns, they are {', '.join(kinds)}: a wheel's is"
        f" {' or '.join(TURNING)}"
    )


def _fixed_wheels(urdf: Urdf) -> list[str]:
    """Names in words of fixed joints that are called wheels; at most one text."""
    names = [
        j.name for j in urdf.joints.values() if j.kind == "fixed" and "wheel" in j.name.lower()
    ]
    return [f"{', '.join(names[:_SHOWN])} (fixed)"] if names else []


def _not_ahead(base: str, wheels: list[Joint]) -> str:
    joint = wheels[0]
    if joint.element.find("axis") is None:
        return (
            f"joint {joint.name!r} has no axis, and then turns about x, that is ahead: write its axis into"
            " the description; places and signs of wheels are left to you"
        )
    return (
        f"wheels turn about the x axis of {base}, which is then not ahead (REP 103), and their names do not"
        " show what is: places and signs of wheels are left to you"
    )


def _left_out(left: Mapping[str, str]) -> list[str]:
    """Names of joints, grouped by the reason why they are no wheels; at most one text."""
    by: dict[str, list[str]] = {}
    for name, reason in left.items():
        by.setdefault(reason, []).append(name)
    words = [f"{', '.join(names)} ({reason})" for reason, names in by.items()]
    return [", ".join(words)] if words else []


def _shown(axis: Array) -> str:
    return "(" + " ".join(f"{number + 0.0:.2g}" for number in np.round(axis, 2)) + ")"
