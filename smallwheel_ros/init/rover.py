# SPDX-License-Identifier: Apache-2.0
"""A rover's parameters as far as they are known, from wheels or a robot description, and their file."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple, cast

from smallwheel_ros.common.errors import SmallwheelError, reason
from smallwheel_ros.common.node_parameter import ALL, WHEEL, Value, written
from smallwheel_ros.onboard.declared import PARAMETERS, PER_WHEEL, parameters_for
from smallwheel_ros.onboard.parameters import for_each_wheel, places_of
from smallwheel_ros.onboard.robot_description import described_mass, fill_silent
from smallwheel_ros.onboard.running_gear import centre_of, heading_of, running_gear
from smallwheel_ros.onboard.urdf import RobotDescriptionError, Urdf
from smallwheel_ros.onboard.wheel_names import usual_names, wheels_named_by

FILL_IN = "FILL_IN"
_MOST_WHEELS = 20
_MOST_BYTES = 1 << 24  # of a robot description
_SIZES = ("diameter", "width")
_PLACES = {"lateral_position": "vehicle.track", "longitudinal_position": "vehicle.wheelbase"}


class InitError(SmallwheelError):
    """No parameter file can be made from this input."""


@dataclass(frozen=True)
class Rover:
    """The parameters of a rover that are known, and the file that is made from them.

    Attributes
    ----------
    origin
        Source of the parameters, in words: a file, or a number of wheels.
    values
        Known parameters by full name, as "fl.diameter"; `wheels`, the names of the wheels, comes first.
    notes
        Sentences on what was assumed.
    described
        Whether a robot description was found.
    offers
        By full name, values of parameters that were found but that only the user can decide to use: the file
        has them commented out.
    ranged
        Names of the wheels whose sinkage a range sensor measures.
    of_bag
        Whether the parameters come from a bag, which can be replayed.
    """

    origin: str
    values: Mapping[str, Value]
    notes: Sequence[str] = ()
    described: bool = False
    offers: Mapping[str, Value] = field(default_factory=dict)
    ranged: Sequence[str] = ()
    of_bag: bool = False

    @property
    def wheels(self) -> list[str]:
        """Names of the wheels."""
        return cast("list[str]", self.values["wheels"])

    @property
    def missing(self) -> list[str]:
        """Full names of parameters to be filled in; one that all wheels lack is named once, `all_wheels`."""
        of_each = [*_SIZES, *(["range_height"] if self.ranged else [])]
        needed = [self._once(name) for name in of_each]
        needed += [self._place(name) for name in _PLACES]
        mass = ["vehicle.mass"] if self.values.get("load.source") == "static" else []
        return list(dict.fromkeys([*mass, *(name for names in needed for name in names)]))

    def _lack(self, name: str) -> list[str]:
        """Names of the wheels for which a parameter is needed and not known."""
        known = for_each_wheel(self.values)
        wheels = self.ranged if name == "range_height" else self.wheels
        return [wheel for wheel in wheels if f"{wheel}.{name}" not in known]

    def _once(self, name: str) -> list[str]:
        """Full names of a missing parameter that wheels usually share: one name if every wheel lacks it."""
        lack = self._lack(name)
        if len(lack) == len(self.wheels):
            return [f"{ALL}.{name}"]
        return [f"{wheel}.{name}" for wheel in lack]

    def _place(self, name: str) -> list[str]:
        """Full names of what is missing to know a coordinate of all wheels.

        It is the vehicle's track or wheelbase if the wheels' names show where they are, else the coordinate
        of each wheel. One axle needs no wheelbase, wheels in one line no track: they are at 0.
        """
        lack = self._lack(name)
        size = _PLACES[name]
        if not lack or size in self.values:
            return []
        by_name = places_of({"wheels": lack, size: 1.0})
        if by_name:
            return [size]
        alone = len(self.wheels) == 1
        placed = places_of({"wheels": lack, **dict.fromkeys(_PLACES.values(), 1.0)})
        return [] if placed or alone else [f"{wheel}.{name}" for wheel in lack]

    def text(self) -> str:
        """Report for people: the parameters that were found or assumed, and those to be filled in."""
        lines = [f"{self.origin}: wheels {', '.join(self.wheels)}"]
        lines += [
            f"  {name}: {written(value)}" for name, value in self.values.items() if name != "wheels"
        ]
        lines += [f"note: {note}" for note in self.notes]
        lines += [f"to be filled in: {', '.join(self.missing)}"] if self.missing else []
        return "\n".join(lines)

    def to_dict(self) -> dict[str, Any]:
        """The content of `text` as plain values."""
        return {
            "schema": 1,
            "origin": self.origin,
            "values": self.values,
            "missing": self.missing,
            "notes": self.notes,
        }

    def parameter_file(self) -> str:
        """The text of a ROS parameter file for the node and for replay, with FILL_IN for what is missing."""
        missing = self.missing
        lines = [
            f"# Parameters of mobility_estimator, made by `smallwheel init` from {self.origin}.",
            "# `smallwheel init --template` prints all there are, each explained.",
        ]
        if missing:
            lines.append(f"# {FILL_IN} stands where a number has to come from you.")
        for note in self.notes:
            lines += textwrap.wrap(note, 92, initial_indent="# ", subsequent_indent="#   ")
        lines += ["/**:", "  ros__parameters:", f"    wheels: {written(self.wheels)}"]
        lines += _left_out_lines(self)
        values = _shared(self.values, self.wheels)
        explained: set[str] = set()
        group = ""
        for parameter in parameters_for(self.wheels)[1:]:
            name = parameter.name
            if name not in values and name not in missing:
                continue
            above, _, own = name.rpartition(".")
            if above and above != group:
                lines += ["", f"    {above}:"]
            group = above
            indent = "      " if above else "    "
            if name in values:
                lines.append(f"{indent}{own}: {written(values[name])}")
                continue
            if own not in explained:
                explained.add(own)
                lines += [f"{indent}# {line}" for line in textwrap.wrap(parameter.description, 90)]
            unit = f" # {parameter.unit}" if parameter.unit else ""
            lines.append(f"{indent}{own}: {FILL_IN}{unit}")
        return "\n".join(lines) + "\n"


def _shared(values: Mapping[str, Value], wheels: Sequence[str]) -> dict[str, Value]:
    """The values, with one `all_wheels` in place of a parameter that all wheels have alike.

    Texts are alike if they differ only by the name of the wheel, which is replaced by `<wheel>`.
    """
    found = dict(values)
    for row in PER_WHEEL:
        names = {wheel: row.for_wheel(wheel).name for wheel in wheels}
        known = [found[name] for name in names.values() if name in found]
        if len(known) < max(len(wheels), 2):
            continue
        alike = {_pattern(found[name], wheel) for wheel, name in names.items()}
        if len(alike) == 1:
            for name in names.values():
                del found[name]
            found[row.for_all().name] = alike.pop()
    return found


def _pattern(value: Any, wheel: str) -> Any:
    return value.replace(wheel, WHEEL) if isinstance(value, str) else value


# --- Rovers without a bag


def rover_of_wheels(count: int) -> Rover:
    """A rover with this number of wheels and nothing else known. Raises InitError for a wrong number."""
    if not 1 <= count <= _MOST_WHEELS:
        raise InitError(f"{count} wheels, expected 1 to {_MOST_WHEELS}")
    return Rover(f"{count} wheels", {"wheels": usual_names(count)})


def rover_of_description(path: Path) -> Rover:
    """The rover that a robot description describes. Raises InitError if it cannot be used."""
    text = description_in(path)
    try:
        joints, notes = wheel_joints(text)
        values = {"wheels": list(joints), **joint_values(joints)}
        filled = fill_silent(text, values)
    except RobotDescriptionError as error:
        raise InitError(
            f"{path}: {error}; `smallwheel init --wheels N` does without a description"
        ) from None
    mass = described_mass(text)
    return Rover(
        str(path),
        values | filled.values,
        [*notes, *filled.lacking],
        described=True,
        offers={} if mass is None else {"vehicle.mass": mass},
    )


def description_in(path: Path) -> str:
    """The text of a file with a robot description. Raises InitError if it cannot be read."""
    try:
        if path.stat().st_size > _MOST_BYTES:
            raise InitError(f"{path}: more than {_MOST_BYTES >> 20} MiB, expected a URDF")
        text = path.read_text(encoding="utf-8")
    except UnicodeDecodeError:
        raise InitError(f"{path}: cannot be read: it is not text in UTF-8") from None
    except OSError as error:
        raise InitError(f"{path}: cannot be read: {reason(error)}") from None
    return text


def wheel_joints(description: str) -> tuple[dict[str, str], list[str]]:
    """The joint of a robot description that turns each wheel, by name of the wheel; and notes for the user.

    description: text of the URDF. Raises RobotDescriptionError, with the reason, if no joint turns a wheel.
    """
    urdf = Urdf(description)
    gear = running_gear(urdf)
    names = [joint.name for joint in gear.wheels]
    joints = {joint.name: joint for joint in gear.wheels}
    base = urdf.base(gear.wheels[0].child)
    heading = heading_of(urdf, joints, base)
    where = None
    if heading.quarters is not None:
        centres = {
            n: heading.turned(centre_of(urdf, joint, base))[:2] for n, joint in joints.items()
        }
        where = {name: (float(x), float(y)) for name, (x, y) in centres.items()}
    return wheels_named_by(names, where), gear.notes


def joint_values(joints: Mapping[str, str]) -> dict[str, Value]:
    """Parameters `<wheel>.joint` of the wheels whose joints do not have the default name.

    joints: name of each wheel's joint, by wheel.
    """
    default = str(PARAMETERS[f"{WHEEL}.joint"].default)
    return {
        f"{wheel}.joint": joint
        for wheel, joint in joints.items()
        if joint != default.replace(WHEEL, wheel)
    }


# --- Lines that a parameter file has commented out


class _LeftOut(NamedTuple):
    """A parameter that a file has commented out, for the user to decide.

    value: the value in that line if nothing was found. why: why it is left out; if empty, it is mentioned
    only if a value was found. brings: what it is good for. found: why it is left out although one was found.
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
        "the bag has it, but no gravity along its z axis: z has to be up, and imu_yaw says where x looks.",
    ),
    "vehicle.mass": _LeftOut(
        0.0,  # refused as it is: a number has to be put in
        "only you know it; what a robot description says is seldom what is driven.",
        "Brings, with a slope (imu_topic, or odom with pitch), the soil's strength; and the loads are"
        " weighed against it, which finds loads in kg and wheels that are not listed.",
        "this is the sum of the robot description's links, which is seldom what is driven: weigh it.",
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
    """Lines of a file, below `ros__parameters:`, for parameters left out; explanations begin with ##."""
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
        unit = f" # {one.unit}" if one.unit else ""
        lines.append(f"    # {name}: {written(offer or one.value)}{unit}")
    return lines
