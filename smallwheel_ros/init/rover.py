# SPDX-License-Identifier: Apache-2.0
"""What is known of a rover's parameters, and the file with them; of wheels, or of a robot description.

Also how names are understood: those of wheels, and how much the name of a topic or joint looks like
that of a wheel's input.
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from difflib import SequenceMatcher
from pathlib import Path
from typing import Any, NamedTuple, cast

from smallwheel_ros.common.errors import SmallwheelError, reason
from smallwheel_ros.common.node_parameter import WHEEL, Value, written
from smallwheel_ros.onboard.declared import PARAMETERS, parameters_for
from smallwheel_ros.onboard.robot_description import (
    TURNING,
    RobotDescriptionError,
    Urdf,
    fill_silent,
)

FILL_IN = "FILL_IN"
_MOST_WHEELS = 20
_MOST_BYTES = 1 << 24  # of a robot description
_NEEDED = ("diameter", "width", "lateral_position", "longitudinal_position")


class InitError(SmallwheelError):
    """Something that no parameter file can be made from."""


@dataclass(frozen=True)
class Rover:
    """A rover's parameters as far as they are known.

    origin: what they come from. values: by full name, those of the wheels' names first. remaps: by the
    node's name of an input, the topic that it has there. notes: what was assumed. described: whether a
    robot description was found. offers: by full name of a parameter that only people can decide on, the
    topic that a bag has for it. ranged: wheels whose sinkage a range sensor measures.
    """

    origin: str
    values: Mapping[str, Value]
    remaps: Mapping[str, str] = field(default_factory=dict)
    notes: Sequence[str] = ()
    described: bool = False
    offers: Mapping[str, str] = field(default_factory=dict)
    ranged: Sequence[str] = ()

    @property
    def wheels(self) -> list[str]:
        """Names of the wheels."""
        return cast("list[str]", self.values["wheels"])

    @property
    def missing(self) -> list[str]:
        """Full names of what must be filled in."""
        known = self.values
        needed = [f"{wheel}.{name}" for wheel in self.wheels for name in _NEEDED]
        needed += [f"{wheel}.range_height" for wheel in self.ranged]
        needed += ["vehicle.mass"] if known.get("load.source") == "static" else []
        return [name for name in needed if name not in known]

    def text(self) -> str:
        """What was found, assumed and is to be filled in."""
        lines = [f"{self.origin}: wheels {', '.join(self.wheels)}"]
        lines += [
            f"  {name}: {written(value)}" for name, value in self.values.items() if name != "wheels"
        ]
        lines += [f"  --remap {name}:={topic}" for name, topic in self.remaps.items()]
        lines += [f"note: {note}" for note in self.notes]
        lines += [f"to be filled in: {', '.join(self.missing)}"] if self.missing else []
        return "\n".join(lines)

    def to_dict(self) -> dict[str, Any]:
        """The same as plain values."""
        return {
            "schema": 1,
            "origin": self.origin,
            "values": self.values,
            "missing": self.missing,
            "remaps": self.remaps,
            "notes": self.notes,
        }

    def parameter_file(self) -> str:
        """A ROS parameter file for the node and for replay."""
        missing = self.missing
        lines = [
            f"# Parameters of mobility_estimator, made by `smallwheel init` from {self.origin}.",
            "# docs/parameters.md explains all there are. Numbers need a point: 1.0, not 1.",
        ]
        if missing:
            lines.append(f"# {FILL_IN} stands where a number has to come from you.")
        if self.remaps:
            lines.append(
                "# Topics under other names: give these to the node and to smallwheel replay, too:"
            )
            lines += [f"#   --remap {name}:={topic}" for name, topic in self.remaps.items()]
        for note in self.notes:
            lines += textwrap.wrap(note, 92, initial_indent="# ", subsequent_indent="#   ")
        lines += ["/**:", "  ros__parameters:", f"    wheels: {written(self.wheels)}"]
        lines += _left_out_lines(self)
        explained: set[str] = set()
        group = ""
        for parameter in parameters_for(self.wheels)[1:]:
            name = parameter.name
            if name not in self.values and name not in missing:
                continue
            above, _, own = name.rpartition(".")
            if above and above != group:
                lines += ["", f"    {above}:"]
            group = above
            indent = "      " if above else "    "
            if name in self.values:
                lines.append(f"{indent}{own}: {written(self.values[name])}")
                continue
            if own not in explained:
                explained.add(own)
                lines += [f"{indent}# {line}" for line in textwrap.wrap(parameter.description, 90)]
            unit = f" # {parameter.unit}" if parameter.unit else ""
            lines.append(f"{indent}{own}: {FILL_IN}{unit}")
        return "\n".join(lines) + "\n"


# --- Rovers without a bag


def rover_of_wheels(count: int) -> Rover:
    """So many wheels of which nothing is known. Raises InitError for a number that is none."""
    if not 1 <= count <= _MOST_WHEELS:
        raise InitError(f"{count} wheels, expected 1 to {_MOST_WHEELS}")
    return Rover(f"{count} wheels", {"wheels": usual_names(count)})


def rover_of_description(path: Path) -> Rover:
    """The wheels of a robot description. Raises InitError."""
    text = description_in(path)
    try:
        joints = wheel_joints(text)
        if not joints:
            raise InitError(
                f"{path}: no joint of type {' or '.join(TURNING)} has 'wheel' in its name or a cylinder "
                "below it, expected one for each wheel; `smallwheel init --wheels N` does without"
            )
        values = {"wheels": list(joints), **joint_values(joints)}
        filled = fill_silent(text, values)
    except RobotDescriptionError as error:
        raise InitError(f"{path}: {error}") from None
    return Rover(str(path), values | filled.values, notes=filled.lacking, described=True)


def description_in(path: Path) -> str:
    """The text of a file with a robot description. Raises InitError."""
    try:
        if path.stat().st_size > _MOST_BYTES:
            raise InitError(f"{path}: more than {_MOST_BYTES >> 20} MiB, expected a URDF")
        text = path.read_text(encoding="utf-8")
    except UnicodeDecodeError:
        raise InitError(f"{path}: cannot be read: it is not text in UTF-8") from None
    except OSError as error:
        raise InitError(f"{path}: cannot be read: {reason(error)}") from None
    return text


def wheel_joints(description: str) -> dict[str, str]:
    """By wheel, the joint of a robot description that turns it. Raises RobotDescriptionError."""
    urdf = Urdf(description)
    turning = [
        joint
        for joint in urdf.joints.values()
        if joint.kind in TURNING and _has_cylinder(urdf, joint.child)
    ]
    named = [joint.name for joint in turning if "wheel" in f"{joint.name} {joint.child}".lower()]
    return wheels_named_by(named or [j.name for j in turning if j.kind == "continuous"])


def _has_cylinder(urdf: Urdf, link: str) -> bool:
    """Whether a link has a cylinder, as a wheel has and a steering arm has not."""
    try:
        urdf.cylinder(link)
    except RobotDescriptionError:
        return False
    return True


def joint_values(joints: Mapping[str, str]) -> dict[str, Value]:
    """The parameters of those joints, by wheel, whose names are not what the node expects."""
    default = str(PARAMETERS[f"{WHEEL}.joint"].default)
    return {
        f"{wheel}.joint": joint
        for wheel, joint in joints.items()
        if joint != default.replace(WHEEL, wheel)
    }


# --- Lines that a parameter file has commented out


class _LeftOut(NamedTuple):
    """A parameter that a file leaves to people.

    value: what to write where nothing is found. why: why it is left out; where empty, it is only
    mentioned where a bag has a topic for it. found: why, in a bag that has one.
    """

    value: Value
    why: str
    brings: str
    found: str = ""
    unit: str = ""


_LEFT_OUT = {
    "imu_topic": _LeftOut(
        "imu",
        "nothing here says whether there is one, of which topic, with z up.",
        "Brings the slope: with vehicle.mass the soil's strength, so drawbar pull and cost do not rest on"
        " configured numbers; without one, the slope is that of odom's orientation.",
        "the bag has it, but not how the imu is mounted: z has to be up, and imu_yaw says where x looks.",
    ),
    "vehicle.mass": _LeftOut(
        0.0,  # refused as it is: a number has to be put in
        "only you know it; what a robot description says is seldom what is driven.",
        "Brings, with a slope (imu_topic, or odom with pitch), the soil's strength; and the loads are"
        " weighed against it, which finds loads in kg and wheels that are not listed.",
        unit="kg, with all that it carries: write yours",
    ),
    "robot_description_topic": _LeftOut(
        "robot_description",
        "no robot description was found here; sizes have to be written below.",
        "Brings diameter, width, place and joint_sign of each wheel for which this file has none: take out"
        " the diameter and width below, and the node waits for the URDF on that topic (its default).",
    ),
    "velocity_topic": _LeftOut(
        "",
        "",
        "Brings slip, thrust and drawbar pull where odom is made from the wheels; else it goes before odom.",
        "the bag has it, but not whether the wheels make it: then it shows no slip.",
    ),
}


def _left_out_lines(rover: Rover) -> list[str]:
    """The lines of a parameter file, below `ros__parameters:`; ## begins what only explains."""
    lines = ["", '    ## To use a line that is left out, remove the "# " before it.']
    for name, one in _LEFT_OUT.items():
        if name in rover.values or name in rover.missing:
            continue
        offer = rover.offers.get(name)
        why = one.found if offer else one.why
        if not why or (rover.described and name == "robot_description_topic"):
            continue
        explained = f"{name} is left out: {why} {one.brings}"
        lines += ["", *(f"    ## {line}" for line in textwrap.wrap(explained, 92))]
        *above, own = name.split(".")
        lines += [f"    # {group}:" for group in above]
        unit = f" # {one.unit}" if one.unit else ""
        lines.append(f"    # {'  ' * len(above)}{own}: {written(offer or one.value)}{unit}")
    return lines


# --- Names

_SHORT = {
    "f": ("front",), "r": ("rear", "right"), "l": ("left",), "b": ("rear",), "m": ("middle",),
    "fl": ("front", "left"), "fr": ("front", "right"), "lf": ("front", "left"),
    "rf": ("front", "right"), "rl": ("rear", "left"), "rr": ("rear", "right"),
    "bl": ("rear", "left"), "br": ("rear", "right"), "lr": ("rear", "left"),
    "ml": ("middle", "left"), "mr": ("middle", "right"), "back": ("rear",), "hind": ("rear",),
    "mid": ("middle",), "centre": ("middle",), "center": ("middle",),
}  # fmt: skip
PLACES = ("front", "middle", "rear", "left", "right")  # in the order in which a name has them
_OF = {
    1: ("wheel",),
    2: ("left", "right"),
    3: ("front", "rear_left", "rear_right"),
    4: ("front_left", "front_right", "rear_left", "rear_right"),
    6: ("front_left", "front_right", "middle_left", "middle_right", "rear_left", "rear_right"),
}
_FAIR = 0.5


def usual_names(count: int) -> list[str]:
    """Names of so many wheels."""
    return list(_OF.get(count, [f"wheel_{i}" for i in range(1, count + 1)]))


def words_of(name: str) -> set[str]:
    """Words of a name; short forms of places are spelled out."""
    found: set[str] = set()
    for word in re.findall(r"[a-z]+|\d+", re.sub(r"([a-z])([A-Z])", r"\1_\2", name).lower()):
        found.update(_SHORT.get(word, (word,)))
    return found


def best_match(wheel: str, kind: str, names: Iterable[str]) -> str | None:
    """The name that looks most like that of a wheel's input; None where none does, or two alike."""
    scored = sorted(((_likeness(wheel, kind, name), name) for name in names), reverse=True)
    if not scored or scored[0][0] < _FAIR:
        return None
    if len(scored) > 1 and scored[1][0] == scored[0][0]:
        return None  # nothing tells the two apart
    return scored[0][1]


def only_or_best_match(name: str, names: Sequence[str]) -> str | None:
    """The only one of these names, or the one that looks most like an input of the vehicle."""
    return names[0] if len(names) == 1 else best_match(name, "", names)


def _likeness(wheel: str, kind: str, name: str) -> float:
    """How much a topic's or joint's name looks like that of a wheel's input; 0 to 1."""
    wanted, there = words_of(wheel), words_of(name)
    places, others = wanted & {*PLACES}, there & {*PLACES}
    if others - places and places - others:
        return 0.0  # the place of another wheel
    share = len(wanted & there) / max(len(wanted), 1)
    letters = SequenceMatcher(None, f"{wheel}/{kind}", name.strip("/")).ratio()
    return 0.7 * share + 0.3 * letters


def wheels_named_by(names: Sequence[str]) -> dict[str, str]:
    """By wheel, the one of these topics or joints that is of it: each is of another wheel.

    A wheel is called by its place where the names tell it, else by the words that tell them apart.
    """
    words = {name: words_of(name) for name in names}
    found = {name: "_".join(p for p in PLACES if p in words[name]) for name in names}
    if not all(found.values()) or len({*found.values()}) < len(names):
        common = set.intersection(*words.values()) if len(names) > 1 else {*words[names[0]]}
        found = {name: "_".join(sorted(words[name] - common)) for name in names}
    if len({*found.values()}) < len(names) or not all(found.values()):
        found = dict(zip(names, usual_names(len(names)), strict=True))
    called = {
        name: wheel if wheel[0].isalpha() else f"wheel_{wheel}" for name, wheel in found.items()
    }
    return {called[name]: name for name in sorted(names, key=lambda n: _order(called[n]))}


def _order(wheel: str) -> tuple[int, ...]:
    """Front before rear, left before right."""
    words = wheel.split("_")
    return tuple(PLACES.index(word) if word in PLACES else len(PLACES) for word in words)
