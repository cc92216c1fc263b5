# SPDX-License-Identifier: Apache-2.0
"""Parameters of earlier releases that are gone: what took their place, and which are missed.

A gone name is a warning. Where it had another value than its default, and measurements or the prior went by
it, nothing is configured until the file says the same by what took its place.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from smallwheel_ros.onboard.parameter import WHEEL
from smallwheel_ros.onboard.table import PARAMETERS

# Each publisher's and subscription's; nodes declared them and `ros2 param dump` wrote them.
_QOS = "qos_overrides."


class Gone(NamedTuple):
    """One parameter that is gone.

    default: that it had. place: what took its place, in words. missed: whether a measurement or the prior
    went by it. by: the parameter that says the same now; where that is given nothing is missed.
    """

    default: object
    place: str
    missed: bool = False
    by: str = ""


_LEARNT = "it is learnt from the drive, from a prior that is wide enough for every vehicle"
_CONSTANT = "a constant that suits every vehicle"
_SOIL = "soil.name or model_file says which soil the estimate starts from"
_SPREAD = "the prior is always as wide as soils of one kind differ"
_FRAME = "publish velocity_topic in base_frame"
_SECOND_LEVEL = "wheels dig in while the warning's second level is exceeded"
_RISK = "cost is the risk of getting stuck, see cost.required_margin"
_TORQUE = (
    f"{WHEEL}.torque_per_effort: gear ratio times efficiency, 1.0 where the effort is the wheel's"
)
_MASS = "vehicle.mass is the mass of both"

GONE: Mapping[str, Gone] = {
    # Measurements, or the prior
    "load_sign": Gone(1, f"{WHEEL}.load_sign of each wheel", missed=True),
    "load.mass": Gone(None, _MASS, missed=True, by="vehicle.mass"),
    "velocity_lateral_position": Gone(0.0, _FRAME, missed=True),
    "velocity_yaw": Gone(0.0, _FRAME, missed=True),
    "soil.k": Gone(None, _SOIL, missed=True),
    "soil.n": Gone(None, _SOIL, missed=True),
    "soil.m": Gone(None, _SOIL, missed=True),
    "soil.cohesion": Gone(None, _SOIL, missed=True),
    "soil.friction_angle": Gone(None, _SOIL, missed=True),
    "soil.shear_displacement": Gone(None, _SOIL, missed=True),
    "soil.log_reference_pressure_std": Gone(0.7, _SPREAD, missed=True),
    "soil.n_std": Gone(None, _SPREAD, missed=True),
    "soil.m_std": Gone(0.4, _SPREAD, missed=True),
    "soil.cohesion_std": Gone(400.0, _SPREAD, missed=True),
    "soil.friction_angle_std": Gone(0.05, _SPREAD, missed=True),
    "soil.shear_displacement_std": Gone(0.005, _SPREAD, missed=True),
    f"{WHEEL}.sinkage_source": Gone(
        "WheelSinkage", f"a Range where {WHEEL}.range_height is given", missed=True,
        by=f"{WHEEL}.range_height",
    ),
    f"{WHEEL}.torque_source": Gone(
        "none", _TORQUE, missed=True, by=f"{WHEEL}.torque_per_effort"
    ),
    f"{WHEEL}.gear_ratio": Gone(1.0, _TORQUE, missed=True, by=f"{WHEEL}.torque_per_effort"),
    f"{WHEEL}.gear_efficiency": Gone(1.0, _TORQUE, missed=True, by=f"{WHEEL}.torque_per_effort"),
    # Others
    "maximum_speed": Gone(10.0, _CONSTANT),
    "standstill_speed": Gone(0.01, _CONSTANT),
    "load.static_std": Gone(0.3, _CONSTANT),
    "noise.load_relative": Gone(0.02, _CONSTANT),
    "noise.wheel_speed_relative": Gone(0.01, _CONSTANT),
    "timing.silent_after": Gone(1.0, _CONSTANT),
    "timing.maximum_gap": Gone(0.2, _CONSTANT),
    "timing.future_tolerance": Gone(0.5, _CONSTANT),
    "timing.jump_tolerance": Gone(1.0, _CONSTANT),
    "estimator.reference_sinkage": Gone(0.01, "~/soil reports the pressure at 10 mm"),
    "estimator.reference_diameter": Gone(0.2, "~/soil reports that of the wheels' mean diameter"),
    "estimator.process_noise": Gone(0.02, f"{WHEEL}.contact: none under a pressed wheel"),
    "estimator.scatter_length": Gone(0.2, f"{WHEEL}.contact: a depth under a pressed wheel"),
    "estimator.soil_scatter": Gone(0.06, _LEARNT),
    "estimator.gate_probability": Gone(0.999, _CONSTANT),
    "estimator.surprises_to_reopen": Gone(5, "a change of soil is judged on stretches of path"),
    "pass_std": Gone(0.3, _LEARNT),
    "load_scale_std": Gone(0.1, _LEARNT),
    "load_zero_std": Gone(0.03, _LEARNT),
    "delay_std": Gone(0.1, _LEARNT),
    "cost.frame": Gone("", "the frame of odom's header"),
    "cost.period": Gone(1.0, "one grid a second at most"),
    "cost.slope": Gone("measured", "the slope that is measured at a place counts"),
    "cost.class_scatter": Gone(0.05, _CONSTANT),
    "cost.easy_margin": Gone(0.1, _RISK),
    "cost.hard_margin": Gone(-0.1, _RISK),
    "cost.confidence": Gone(0.95, _RISK),
    "digging_in.slip": Gone(0.5, _SECOND_LEVEL),
    "digging_in.sinkage_rise": Gone(0.3, _SECOND_LEVEL),
    "digging_in.speed_drop": Gone(0.3, _SECOND_LEVEL),
    "digging_in.time": Gone(1.0, _SECOND_LEVEL),
}  # fmt: skip
GROUPS = {name.split(".")[0] for name in GONE if not name.startswith(WHEEL)} | {_QOS.rstrip(".")}


def is_gone(name: str, wheels: Sequence[str]) -> bool:
    """Whether a parameter's full name is that of one that is gone."""
    return name.startswith(_QOS) or _generic(name, wheels)[0] in GONE


def gone_and_missed(values: Mapping[str, object], wheels: Sequence[str]) -> list[str]:
    """Say of each gone name that cannot be left out what has to be written in its place."""
    return [text for text, missed in _found(values, wheels) if missed]


def gone_names(values: Mapping[str, object], wheels: Sequence[str]) -> list[str]:
    """Say of each other gone name what took its place."""
    found = [text for text, missed in _found(values, wheels) if not missed]
    if any(name.startswith(_QOS) for name in values):
        found.append(
            f"parameters {_QOS}* are gone: topics have the quality of service that docs/node.md says"
        )
    return found


def _found(values: Mapping[str, object], wheels: Sequence[str]) -> list[tuple[str, bool]]:
    """What is to be said of each gone name, and whether it is missed."""
    found = []
    for name, value in values.items():
        generic, wheel = _generic(name, wheels)
        gone = GONE.get(generic)
        # `ros2 param dump` writes null for one that was not given.
        if gone is None or value is None or (value == "null" and gone.default is None):
            continue
        missed = gone.missed and value != gone.default
        if missed and gone.by:
            said = values.get(gone.by.replace(WHEEL, wheel))
            missed = said in (None, PARAMETERS[gone.by].default)
        why = ", and measurements or the prior went by it" if missed else ""
        text = f"parameter {name} ({value!r}) is gone{why}: {gone.place}"
        found.append((text.replace(WHEEL, wheel), missed))
    return found


def _generic(name: str, wheels: Sequence[str]) -> tuple[str, str]:
    """The name with `<wheel>` in place of the wheel's, and that wheel; both as they are without one."""
    wheel, _, own = name.partition(".")
    return (f"{WHEEL}.{own}", wheel) if wheel in wheels else (name, WHEEL)
