# SPDX-License-Identifier: Apache-2.0
"""What a drive's numbers show: which joints turn and how, the odometry's source, the imu's orientation."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from itertools import islice
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.bags import BagError, BagReader
from smallwheel_ros.common.stamps import SECOND
from smallwheel_ros.onboard.felt_gravity import unlike_gravity
from smallwheel_ros.onboard.idle_publisher import IdlePublisher
from smallwheel_ros.onboard.joint_motion import JointMotion
from smallwheel_ros.onboard.joint_units import UNITS_OF_TURNING, VelocityUnit

Array = NDArray[np.float64]
_MOST = 50_000  # messages of a topic that are read: minutes of driving show all that is needed
_TURNS = 0.05  # rad/s: slower is the noise of a joint that stands
_DRIVES = 0.3  # of the root mean square of the speed: slower is standing, or turning on the spot
_CLEAR = 0.5  # cosine between a joint's speed and the vehicle's over a drive, from which its sign is clear
# Share of an odometry's speed that no combination of rims explains. For one that is computed from the rims it
# is rounding and the motion between two messages; for cameras, lidars and GNSS it is several hundredths.
_OF_WHEELS = 0.01
_LEAST = 50  # instants of driving, under which nothing is reported
# s between two speeds of a joint that a line connects: joint states come at 4 Hz or more
_GAP = 0.25
_BASE = 1.0  # s between two places whose difference is a speed
_FAR = 4.0  # path of the rims over that of the vehicle: no drive has such a slip throughout
_NEAR = (
    1.5  # times a known factor, or less: slip makes it larger, and the next one is 6 times as large
)
_UPRIGHT = 0.8  # of the felt force along z, up or down: within 37 degrees


class JointSpeeds(NamedTuple):
    """Speeds of the joints of one topic.

    Attributes
    ----------
    times
        Times of the instants, s, shape (instants,), rising.
    names
        Names of the joints.
    speeds
        Speeds, rad/s, shape (instants, joints); NaN if unknown.
    by_positions
        Joints whose speeds are computed from their positions, as their velocities are missing or unusable.
    wrong
        By joint, words on how its velocities contradict its positions; joints without a fault are absent.
    """

    times: Array
    names: list[str]
    speeds: Array
    by_positions: Sequence[str] = ()
    wrong: Mapping[str, str] = MappingProxyType({})

    def turning(self) -> list[str]:
        """Names of the joints that turn at some time."""
        with np.errstate(invalid="ignore"):
            moved = np.flatnonzero((abs(self.speeds) > _TURNS).any(axis=0))
        return [self.names[i] for i in moved]


class Speed(NamedTuple):
    """A vehicle's forward speed by an odometry.

    Attributes
    ----------
    times, values
        Times (s) and speeds (m/s, negative backward), shape (instants,).
    by_pose
        Whether the speed is computed from poses, since every twist is 0.
    """

    times: Array
    values: Array
    by_pose: bool


def joint_speeds(reader: BagReader, topic: str) -> JointSpeeds:
    """Read the speeds of all joints of a JointState topic, from positions if velocities are unusable.

    Parameters
    ----------
    reader
        The bag, of which the topic's first messages are read.
    topic
        Name of the topic.
    """
    told: dict[str, list[tuple[int, float, float, bool]]] = {}
    for states in first_messages(reader, topic):
        stamp = states.header.stamp.sec * SECOND + states.header.stamp.nanosec
        count = len(states.name)
        velocities, positions = (
            values if len(values) == count else [math.nan] * count
            for values in (states.velocity, states.position)
        )
        has = len(states.velocity) == count
        for name, velocity, position in zip(states.name, velocities, positions, strict=True):
            row = stamp, float(velocity), float(position), has
            told.setdefault(str(name), []).append(row)
    found, by_positions = {}, []
    wrong: dict[str, str] = {}
    for name, rows in told.items():
        stamps, velocity, position, has_one = (
            np.array(column) for column in zip(*rows, strict=True)
        )
        idle = IdlePublisher().idle(stamps, velocity, position)
        stamps, velocity, position, has_one = (
            c[~idle] for c in (stamps, velocity, position, has_one)
        )
        unit = VelocityUnit()
        unit.take(stamps, np.column_stack([velocity, position]))
        wrong |= {name: unit.wrong} if unit.wrong else {}
        joint = JointMotion()
        at, speeds, _ = joint.take(stamps, velocity, position, has_one)
        found[name] = dict(zip(at.tolist(), speeds.tolist(), strict=True))
        by_positions += [name] if joint.by_positions else []
    times = sorted({stamp for one in found.values() for stamp in one})
    table = [[one.get(stamp, math.nan) for one in found.values()] for stamp in times]
    speeds = np.array(table, dtype=float).reshape(len(times), len(found))
    return JointSpeeds(np.array(times) / SECOND, list(found), speeds, by_positions, wrong)


def speed_of(reader: BagReader, topic: str) -> Speed:
    """Read the forward speed from a topic of Odometry: its twist or, if every twist is 0, from its poses.

    Parameters
    ----------
    reader
        The bag, of which the topic's first messages are read.
    topic
        Name of the topic.
    """
    rows = []
    for odometry in first_messages(reader, topic):
        place, turn = odometry.pose.pose.position, odometry.pose.pose.orientation
        yaw = math.atan2(
            2.0 * (turn.w * turn.z + turn.x * turn.y),
            1.0 - 2.0 * (turn.y * turn.y + turn.z * turn.z),
        )
        twist = odometry.twist.twist.linear.x
        rows.append((_seconds(odometry.header.stamp), twist, place.x, place.y, yaw))
    table = np.array(rows, dtype=float).reshape(-1, 5)
    table = table[np.isfinite(table).all(axis=1)]
    table = table[np.unique(table[:, 0], return_index=True)[1]]
    times, twist = table[:, 0], table[:, 1]
    if twist.any() or len(times) < 2:
        return Speed(times, twist, by_pose=False)
    before, after = times - _BASE / 2.0, times + _BASE / 2.0
    moved = [np.interp(after, times, c) - np.interp(before, times, c) for c in table[:, 2:4].T]
    span = np.clip(after, times[0], times[-1]) - np.clip(before, times[0], times[-1])
    ahead = moved[0] * np.cos(table[:, 4]) + moved[1] * np.sin(table[:, 4])
    return Speed(times, ahead / np.maximum(span, 1e-9), by_pose=True)


def first_messages(reader: BagReader, topic: str, most: int = _MOST) -> Iterator[Any]:
    """Yield the first messages of a topic; in a damaged bag, those before the damage.

    Parameters
    ----------
    reader
        The bag.
    topic
        Name of the topic.
    most
        Number of messages.
    """
    with suppress(BagError):
        for message in islice(reader.messages({topic}), most):
            yield message.message


def _seconds(stamp: Any) -> float:
    return float(stamp.sec) + float(stamp.nanosec) * 1e-9


def _filled(times: Array, speeds: Array) -> Array:
    """Speeds of a joint, NaN where it has none, with straight lines between those at most `_GAP` apart.

    Wheels may come in messages of their own, with stamps of their own.
    """
    known = np.isfinite(speeds)
    at = times[known]
    if at.size < 2:
        return speeds
    after = np.clip(np.searchsorted(at, times), 1, at.size - 1)
    near = at[after] - at[after - 1] <= _GAP
    filled = np.interp(times, at, speeds[known], math.nan, math.nan)
    return np.where(~known & near, filled, speeds)


def _together(joints: JointSpeeds, speed: Speed, wheels: list[str]) -> tuple[Array, Array]:
    """Speeds of these joints (rad/s), shape (instants, wheels), and of the vehicle (m/s), while it drives."""
    places = [joints.names.index(name) for name in wheels]
    turned = joints.speeds[:, places]
    if len(speed.times) < 2 or not len(joints.times):
        return turned[:0], np.empty(0)
    inside = (joints.times >= speed.times[0]) & (joints.times <= speed.times[-1])
    inside &= np.isfinite(turned).any(axis=1)  # of no other joint of the topic
    turned = np.column_stack([_filled(joints.times, one) for one in turned.T])
    inside &= np.isfinite(turned).all(axis=1)
    values = np.interp(joints.times, speed.times, speed.values)
    usual = math.sqrt(float(np.mean(values[inside] ** 2))) if inside.any() else 0.0
    drives = inside & (abs(values) > _DRIVES * usual)
    return turned[drives], values[drives]


def signs_of(joints: JointSpeeds, speed: Speed, wheels: list[str]) -> dict[str, int]:
    """Find for each joint the sign of its speed as the vehicle drives forward: 1 or -1, by name of the joint.

    Joints for which that is unclear, or was recorded too briefly, are absent.

    Parameters
    ----------
    joints, speed
        Speeds of the joints and of the odometry, from one drive.
    wheels
        Names of the joints that turn wheels.
    """
    found = {}
    for name in wheels:
        turned, values = _together(joints, speed, [name])
        length = float(np.linalg.norm(turned) * np.linalg.norm(values))
        if len(values) < _LEAST or length == 0.0:
            continue
        cosine = float(turned[:, 0] @ values) / length
        if abs(cosine) > _CLEAR:
            found[name] = 1 if cosine > 0.0 else -1
    return found


def unlike_wheels(joints: JointSpeeds, speed: Speed, wheels: list[str]) -> float | None:
    """Compute the share of an odometry's speed that no linear combination of the joints' speeds explains.

    It is a number from 0 to 1, near 0 if the odometry is computed from the wheels; None if the drive is short
    or there are no such joints.

    Parameters
    ----------
    joints, speed
        Speeds of the joints and of the odometry, from one drive.
    wheels
        Names of the joints that turn wheels.
    """
    if not wheels:
        return None
    turned, values = _together(joints, speed, wheels)
    if len(values) < _LEAST:
        return None
    fitted = turned @ np.linalg.lstsq(turned, values, rcond=None)[0]
    return float(np.linalg.norm(values - fitted) / np.linalg.norm(values))


def times_the_way(joints: JointSpeeds, speed: Speed, radii: Mapping[str, float]) -> float:
    """Compute the ratio of the rims' mean distance to the vehicle's, by absolute speeds while it drives.

    It is 1 without slip; NaN if either distance is unknown, or was recorded too briefly.

    Parameters
    ----------
    joints, speed
        Speeds of the joints and of the odometry, from one drive.
    radii
        Radius of the wheel (m) by name of the joint that turns it.
    """
    wheels = [joint for joint in radii if joint in joints.names]
    turned, values = _together(joints, speed, wheels) if wheels else (np.empty((0, 0)), np.empty(0))
    if len(values) < _LEAST:
        return math.nan
    rims = np.abs(turned) @ np.array([radii[joint] for joint in wheels]) / len(wheels)
    return float(rims.sum() / np.abs(values).sum())


def unit_by_way(times: float, radius: float) -> str:
    """Find in which unit, other than rad/s, joints' speeds must be, from the distances of rims and vehicle.

    Returns words for the unit or units that the ratio `times` fits; empty if it fits rad/s, or is NaN. A
    ratio of 4 would mean a slip of 0.75, which no drive has from end to end.

    Parameters
    ----------
    times
        Ratio of the rims' mean distance to the vehicle's, as returned by `times_the_way`.
    radius
        Radius of the wheels, m.
    """
    if not (times > _FAR or times < 1.0 / _FAR):
        return ""
    units = {**UNITS_OF_TURNING, "m/s at the rim": radius}
    known = [unit for unit, factor in units.items() if 1.0 / _NEAR < times / factor < _NEAR]
    return " or ".join(known) or "another unit, or of a motor before its gear"


def is_of_wheels(share: float | None) -> bool:
    """Whether an odometry is computed from the wheels. share: that of `unlike_wheels`; False for None."""
    return share is not None and share < _OF_WHEELS


def upright(reader: BagReader, topic: str) -> tuple[int, str]:
    """Find the direction of an imu's z axis from the gravity that it measures: 1 up, -1 down, 0 if unclear.

    The second value is the reason why it is unclear, in words; empty if it is clear.

    Parameters
    ----------
    reader
        The bag, of which the topic's first messages are read.
    topic
        Name of the topic.
    """
    felt = [m.linear_acceleration for m in first_messages(reader, topic)]
    table = np.array([(f.x, f.y, f.z) for f in felt], dtype=float).reshape(-1, 3)
    if not len(table):
        return 0, "none of its messages can be read"
    table = table[np.isfinite(table).all(axis=1)]
    if not len(table):
        return 0, f"none of its {len(felt)} accelerations is a number"
    mean = table.mean(axis=0)
    strength = float(np.linalg.norm(mean))
    if why := unlike_gravity(strength):
        return 0, why
    if abs(mean[2]) > _UPRIGHT * strength:
        return int(np.sign(mean[2])), ""
    along = " ".join(f"{number:.1f}" for number in mean)
    return 0, (
        f"gravity is not along its z axis, but ({along}) m/s^2: publish it in base_link's axes"
    )
