# SPDX-License-Identifier: Apache-2.0
"""Lines that a parameter file has commented out: why, and what each would bring."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from dataclasses import dataclass

from smallwheel_ros.common.parameter import Value, written

_BRINGS = {
    "velocity_topic": (
        "Brings slip, thrust and drawbar pull where odom is made from the wheels; else it goes before odom."
    ),
    "imu_topic": (
        "Brings the slope: with vehicle.mass the soil's strength, so drawbar pull and cost do not rest on"
        " configured numbers; without one, the slope is that of odom's orientation."
    ),
    "vehicle.mass": (
        "Brings, with a slope (imu_topic, or odom with pitch), the soil's strength; and the loads are"
        " weighed against it, which finds loads in kg and wheels that are not listed."
    ),
    "robot_description_topic": (
        "Brings diameter, width, place and joint_sign of each wheel for which this file has none: take out"
        " the diameter and width below, and the node waits for the URDF on that topic (its default)."
    ),
}
_UNITS = {"vehicle.mass": "kg, with all that it carries: write yours"}
OF_A_BAG = {
    "velocity_topic": "the bag has it, but not whether the wheels make it: then it shows no slip.",
    "imu_topic": (
        "the bag has it, but not how the imu is mounted: z has to be up, and imu_yaw says where x looks."
    ),
}


@dataclass(frozen=True)
class LeftOut:
    """What to write for a parameter that is commented out, and why it is."""

    value: Value
    why: str


def usually_left_out(known: Mapping[str, Value], description: str | None) -> dict[str, LeftOut]:
    """What no file of any origin can say.

    known: values by full name. description: URDF, if there is one.
    """
    no_imu = "nothing here says whether there is one, of which topic, with z up."
    no_mass = "only you know it; what a robot description says is seldom what is driven."
    found = {
        "imu_topic": LeftOut("imu", no_imu),
        "vehicle.mass": LeftOut(0.0, no_mass),  # refused as it is: a number has to be put in
    }
    if description is None:
        why = "no robot description was found here; sizes have to be written below."
        found["robot_description_topic"] = LeftOut("robot_description", why)
    return {name: one for name, one in found.items() if name not in known}


def left_out_lines(left_out: Mapping[str, LeftOut]) -> list[str]:
    """The lines of a parameter file, below `ros__parameters:`; ## begins what only explains."""
    lines = []
    for name, one in left_out.items():
        *above, own = name.split(".")
        explained = f"{name} is left out: {one.why} {_BRINGS[name]}"
        lines += ["", *(f"    ## {line}" for line in textwrap.wrap(explained, 92))]
        lines += [f"    # {group}:" for group in above]
        unit = f" # {_UNITS[name]}" if name in _UNITS else ""
        lines.append(f"    # {'  ' * len(above)}{own}: {written(one.value)}{unit}")
    if lines:
        lines[:0] = ["", '    ## To use a line that is left out, take the "# " before it away.']
    return lines
