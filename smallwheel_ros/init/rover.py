# SPDX-License-Identifier: Apache-2.0
"""What is known of a rover's parameters, and the file with them."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from smallwheel_ros.common.errors import SmallwheelError
from smallwheel_ros.common.files import write_bytes
from smallwheel_ros.common.parameter import WHEEL, Value, written
from smallwheel_ros.common.results import Result, Writer
from smallwheel_ros.common.tables import plain
from smallwheel_ros.init.left_out import LeftOut, left_out_lines, usually_left_out
from smallwheel_ros.init.names import usual_names, wheels_named_by
from smallwheel_ros.onboard.robot_description import (
    TURNING,
    RobotDescriptionError,
    Urdf,
    fill_silent,
)
from smallwheel_ros.onboard.settings import PARAMETERS, parameters_for

FILL_IN = "FILL_IN"
_MOST_WHEELS = 20
_MOST_BYTES = 1 << 24  # of a robot description
_SIZE = ("diameter", "width")


class InitError(SmallwheelError):
    """Something that no parameter file can be made from."""


@dataclass(frozen=True, repr=False)
class Rover(Result):
    """A rover's parameters as far as they are known.

    origin: what they come from. values: by full name. missing: full names of what must be filled in.
    remaps: by the node's name of an input, the topic that it has there. notes: what was assumed.
    left_out: by full name, what is in the file, but commented out.
    """

    origin: str
    values: Mapping[str, Value]
    missing: tuple[str, ...] = ()
    remaps: Mapping[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    left_out: Mapping[str, LeftOut] = field(default_factory=dict)

    @property
    def wheels(self) -> list[str]:
        """Names of the wheels."""
        names = self.values["wheels"]
        return list(names) if isinstance(names, list) else []

    def headline(self) -> str:
        """How many wheels there are, and what is missing."""
        count = len(self.wheels)
        lacks = f"; to be filled in: {', '.join(self.missing)}" if self.missing else ""
        return f"{count} wheel{'s' if count > 1 else ''} from {self.origin}{lacks}"

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
        document = {
            "schema": 1,
            "origin": self.origin,
            "values": dict(self.values),
            "missing": list(self.missing),
            "remaps": dict(self.remaps),
            "notes": list(self.notes),
        }
        return dict(plain(document))

    def rows(self) -> list[dict[str, Any]]:
        """The parameters, those that are missing too."""
        known = [{"parameter": n, "value": str(v), "known": True} for n, v in self.values.items()]
        return known + [{"parameter": n, "value": "", "known": False} for n in self.missing]

    def parameter_file(self) -> str:
        """A ROS parameter file for the node and for replay."""
        lines = [
            f"# Parameters of mobility_estimator, made by `smallwheel init` from {self.origin}.",
            "# docs/parameters.md explains all there are. Numbers need a point: 1.0, not 1.",
        ]
        if self.missing:
            lines.append(f"# {FILL_IN} stands where a number has to come from you.")
        if self.remaps:
            lines.append(
                "# Topics under other names: give these to the node and to smallwheel replay, too:"
            )
            lines += [f"#   --remap {name}:={topic}" for name, topic in self.remaps.items()]
        for note in self.notes:
            lines += textwrap.wrap(note, 92, initial_indent="# ", subsequent_indent="#   ")
        lines += ["/**:", "  ros__parameters:", f"    wheels: {written(self.values['wheels'])}"]
        lines += left_out_lines(self.left_out)
        explained: set[str] = set()
        group = ""
        for parameter in parameters_for(self.wheels)[1:]:
            name, shown = parameter.name, ""
            if name in self.values:
                shown = written(self.values[name])
            elif name in self.missing:
                shown = FILL_IN
            else:
                continue
            *above, own = name.split(".")
            if above and above[0] != group:
                lines += ["", f"    {above[0]}:"]
            group = above[0] if above else ""
            indent = "    " + "  " * len(above)
            if own not in explained and name in self.missing:
                explained.add(own)
                lines += [f"{indent}# {line}" for line in textwrap.wrap(parameter.description, 90)]
            unit = f" # {parameter.unit}" if name in self.missing and parameter.unit else ""
            lines.append(f"{indent}{own}: {shown}{unit}")
        return "\n".join(lines) + "\n"

    def _writers(self) -> dict[str, Writer]:
        def write(path: Path) -> None:
            write_bytes(path, self.parameter_file().encode())

        return {".yaml": write, ".yml": write}


def rover_of_wheels(count: int) -> Rover:
    """So many wheels of which nothing is known. Raises InitError for a number that is none."""
    if not 1 <= count <= _MOST_WHEELS:
        raise InitError(f"{count} wheels, expected 1 to {_MOST_WHEELS}")
    return completed(f"{count} wheels", {"wheels": usual_names(count)})


def completed(
    origin: str,
    values: Mapping[str, Value],
    description: str | None = None,
    notes: tuple[str, ...] = (),
    remaps: Mapping[str, str] | None = None,
    left_out: Mapping[str, LeftOut] | None = None,
) -> Rover:
    """The rover with what a robot description says of its wheels, and what is still missing.

    description: URDF. Raises RobotDescriptionError where it is none.
    """
    known, said = dict(values), list(notes)
    wheels = known["wheels"]
    assert isinstance(wheels, list)
    if description is not None:
        filled = fill_silent(description, known)
        known |= filled.values
        said += filled.lacking
    needed = [f"{wheel}.{name}" for wheel in wheels for name in _SIZE]
    needed += [
        f"{wheel}.range_height"
        for wheel in wheels
        if known.get(f"{wheel}.sinkage_source") == "Range"
    ]
    needed += ["load.mass"] if known.get("load.source") == "static" else []
    missing = tuple(name for name in needed if known.get(name) is None)
    commented = usually_left_out(known, description) | dict(left_out or {})
    return Rover(origin, known, missing, remaps or {}, tuple(said), commented)


def rover_of_description(path: Path) -> Rover:
    """The wheels of a robot description. Raises InitError, RobotDescriptionError."""
    try:
        if path.stat().st_size > _MOST_BYTES:
            raise InitError(f"{path}: more than {_MOST_BYTES >> 20} MiB, expected a URDF")
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "it is no text in UTF-8"
        raise InitError(f"{path}: cannot be read: {reason}") from None
    try:
        joints = wheel_joints(text)
        if not joints:
            raise InitError(
                f"{path}: no joint of type {' or '.join(TURNING)} has 'wheel' in its name or a cylinder "
                "below it, expected one for each wheel; `smallwheel init --wheels N` does without"
            )
        return completed(str(path), with_joints(joints), text)
    except RobotDescriptionError as error:
        raise InitError(f"{path}: {error}") from None


def wheel_joints(description: str) -> dict[str, str]:
    """By wheel, the joint of a robot description that turns it. Raises RobotDescriptionError."""
    urdf = Urdf(description)
    turning = [joint for joint in urdf.joints.values() if joint.kind in TURNING]
    named = [
        j.name for j in turning if "wheel" in f"{j.name} {j.child}".lower() and _rolls(urdf, j.name)
    ]
    names = named or [j.name for j in turning if j.kind == "continuous" and _rolls(urdf, j.name)]
    return wheels_named_by(names) if names else {}


def _rolls(urdf: Urdf, name: str) -> bool:
    """Whether the link below a joint has a cylinder, as a wheel has and a steering arm has not."""
    try:
        urdf.cylinder(urdf.joints[name].child)
    except RobotDescriptionError:
        return False
    return True


def with_joints(joints: Mapping[str, str]) -> dict[str, Value]:
    """The wheels, with those joints whose names are not what the node expects."""
    values: dict[str, Value] = {"wheels": list(joints)}
    default = str(PARAMETERS[f"{WHEEL}.joint"].default)
    values |= {
        f"{wheel}.joint": joint
        for wheel, joint in joints.items()
        if joint != default.replace(WHEEL, wheel)
    }
    return values
