# SPDX-License-Identifier: Apache-2.0
"""The node's parameters: one table.

The node's ROS descriptors, the values that node and replay accept, config/template.yaml and
docs/parameters.md all come from it. A name with `<wheel>` stands for one parameter of each wheel.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from smallwheel_ros.onboard.parameter import WHEEL, NodeParameter
from smallwheel_ros.physics.conditions import PRESSED, ROLLING
from smallwheel_ros.physics.soil import SOILS


def _number(
    name: str, default: float | None, unit: str, low: float, high: float, text: str, **more: Any
) -> NodeParameter:
    return NodeParameter(name, "double", default, text, unit, low, high, **more)


def _text(name: str, default: str | None, text: str, *choices: str, **more: Any) -> NodeParameter:
    return NodeParameter(name, "string", default, text, choices=choices, **more)


def _topic(name: str, default: str, text: str, **more: Any) -> NodeParameter:
    return NodeParameter(name, "string", default, text, form="topic", **more)


def _path(name: str, text: str, **more: Any) -> NodeParameter:
    return NodeParameter(name, "string", "", text, form="path", **more)


def _switch(name: str, text: str, *, default: bool = False, **more: Any) -> NodeParameter:
    return NodeParameter(name, "bool", default, text, **more)


def _sign(name: str, text: str) -> NodeParameter:
    return NodeParameter(name, "integer", 1, text, choices=(1, -1))


TABLE = (
    # --- The vehicle
    NodeParameter(
        "wheels", "string_array", None, "Names of the wheels. Each has parameters of its own, below.",
        required=True, at_start=True,
    ),
    _switch(
        "autostart", "Configure and activate at the start. False: left to a lifecycle manager.",
        default=True, at_start=True,
    ),
    _topic(
        "robot_description_topic", "robot_description",
        "Topic (std_msgs/String, latched) of the URDF: sizes, positions and joint_sign of wheels where none"
        " are given. Empty: no URDF.", at_start=True,
    ),
    _text(
        "base_frame", "base_link",
        "Link that positions are measured from; the URDF's root link where it has no base_link.",
        at_start=True,
    ),
    _number(
        "vehicle.mass", None, "kg", 0.01, 1e5,
        "Mass. The balance of forces on slopes and while gaining speed then tells the soil's strength;"
        " loads are checked against it, or are its share with load.source static.",
    ),
    _number(
        "vehicle.gravity_height", None, "m", 0.01, 10.0,
        "Height of the centre of gravity above ground: how a slope shifts static loads. Without it: 1.2"
        " mean wheel diameters.",
    ),
    # --- Inputs
    _switch(
        "odometry_from_wheels",
        "Whether odom is computed from the wheels and shows no slip: velocity_topic has to.",
    ),
    _topic(
        "velocity_topic", "",
        "Topic (geometry_msgs/TwistStamped, in base_frame) of a speed over ground that the wheels do not"
        " measure: radar, optical flow. Empty: odom's.",
    ),
    _topic(
        "imu_topic", "",
        "Topic (sensor_msgs/Imu) that tells the slope. Empty: odom's orientation does.",
    ),
    _number(
        "imu_yaw", 0.0, "rad", -3.15, 3.15,
        "Direction of the imu's x axis in base_frame, positive to the left.",
    ),
    _text(
        "load.source", "wrench",
        "Where loads come from: load_topic, the effort of load_joint, or vehicle.mass split over the"
        " wheels (static).", "wrench", "joint_states", "static",
    ),
    _number("load.per_effort", 1.0, "N", 1e-6, 1e6, "Load per unit of effort of load_joint."),
    # --- How often, and what is answered
    _number(
        "mobility.rate", 10.0, "Hz", 0.0, 1000.0,
        "Estimates of each wheel's mobility a second at most. 0: one for each measured sinkage.",
    ),
    _number(
        "reference_slip", 0.4, "1", 0.02, 0.9,
        "Slip at which margin, steepest slope and cost are worked out.",
    ),
    # --- What is known beforehand
    _path(
        "model_file",
        "Model file of fit, add or diagnose --apply: its soil in place of the library's, and its effects.",
    ),
    _path(
        "effects_file",
        "Python file with effects of your own that model_file names. It is run: name only files that you"
        " trust.",
        at_start=True,
    ),
    _text(
        "soil.name", None,
        "Soil that the estimate starts from: of model_file, or of the library:"
        f" {', '.join(SOILS)}.",
    ),
    _path(
        "soil.file",
        "File that ~/save_soil writes and that the estimate goes on from. Empty: none.",
    ),
    _number(
        "sinkage_zero_std", 0.002, "m", 0.0, 1.0,
        "Standard deviation of the zero of the sinkage sensors, which limits how well n and the pressure"
        " can be known: set them on firm ground, and lower it.",
    ),
    _switch(
        "twist.publish",
        "Whether ~/twist is sent, for robot_localization and others (docs/odometry.md). It needs imu_topic"
        " and lateral_position.",
    ),
    _number(
        "twist.rim_delay", 0.0, "s", 0.0, 1.0,
        "How much later wheel speeds are stamped than the imu's readings of the same instant.",
    ),
    _number(
        "twist.correlation_time", 0.4, "s", 0.0, 10.0,
        "How long errors of slip last: variances sent are multiplied by twice this times the rate. 0: the"
        " variance of one reading.",
    ),
    _number(
        "noise.sinkage", 0.001, "m", 1e-5, 1.0,
        "Standard deviation of a sinkage whose message states none.",
    ),
    _number("noise.load", 0.5, "N", 0.0, 1e5, "Standard deviation of a load, besides 2 % of it."),
    _number(
        "noise.drawbar_pull", 0.6, "N", 1e-3, 1e5, "Standard deviation of a measured drawbar pull."
    ),
    _number("noise.speed", 0.01, "m/s", 0.0, 10.0, "Standard deviation of odometry's speed."),
    # --- Time
    _number(
        "timing.reorder_time", 0.2, "s", 0.0, 5.0,
        "How long, by stamps, a sinkage waits for those of other wheels that belong before it. 0: results"
        " depend on the order of arrival.",
    ),
    _number(
        "timing.maximum_age", 5.0, "s", 0.01, 1e9,
        "Messages stamped further behind the clock are refused.",
    ),
    # --- The cost map
    _number("cost.resolution", 0.1, "m", 0.01, 10.0, "Side of a cell of ~/cost."),
    _number(
        "cost.size", 40.0, "m", 1.0, 2000.0,
        "Side of the window of crossed ground around the vehicle; at most 4 million cells.",
    ),
    _number(
        "cost.spread", None, "m", 0.0, 10.0,
        "Each cell takes the highest cost within this distance, for every planner (docs/nav2.md). Without"
        " it: to the outermost corner.",
    ),
    _text(
        "cost.unknown", "prior",
        "Cost of a terrain class that has not been crossed yet: that of any ground, or none (-1).",
        "prior", "none",
    ),
    _number(
        "cost.required_margin", 0.0, "1", -1.0, 2.0,
        "Margin needed beyond the slope measured at a place. Cost: the risk, in per cent, that the ground"
        " does not give it.",
    ),
    # --- Each wheel
    _number(
        "<wheel>.diameter", None, "m", 0.005, 5.0,
        "Diameter of the wheel. Without it: of its link's cylinder in the URDF.", required=True,
    ),
    _number(
        "<wheel>.width", None, "m", 0.001, 5.0, "Width of the wheel. Without it: of that cylinder.",
        required=True,
    ),
    _text(
        "<wheel>.contact", ROLLING,
        "pressed: pushed straight down by a test rig, without odometry.", ROLLING, PRESSED,
    ),
    _number(
        "<wheel>.lateral_position", 0.0, "m", -10.0, 10.0,
        "Left of base_frame: speed in turns, place on the map. Without it: the URDF's.",
    ),
    _number(
        "<wheel>.longitudinal_position", 0.0, "m", -10.0, 10.0,
        "Ahead of base_frame: which wheels follow in a rut and come to another soil first. Without it: the"
        " URDF's.",
    ),
    _topic(
        "<wheel>.load_topic", "<wheel>/load", "Topic (geometry_msgs/WrenchStamped) of its load, force.z."
    ),
    _text(
        "<wheel>.load_joint", "<wheel>_load_joint",
        "Joint whose effort is the load with load.source joint_states.",
    ),
    _sign("<wheel>.load_sign", "-1: the load is negative when the wheel presses on the soil."),
    _number(
        "<wheel>.load_share", None, "1", 0.001, 1.0,
        "Share of the weight with load.source static. Without it: an equal one.",
    ),
    _topic(
        "<wheel>.sinkage_topic", "<wheel>/sinkage",
        "Topic (smallwheel_ros/WheelSinkage) of its sinkage. Empty: it is not measured.",
    ),
    _number(
        "<wheel>.range_height", None, "m", 0.0, 10.0,
        "Given: sinkage_topic is a sensor_msgs/Range that looks down at undisturbed soil and shows this on"
        " hard ground.",
    ),
    _topic(
        "<wheel>.drawbar_pull_topic", "",
        "Topic (geometry_msgs/WrenchStamped) of what it pulls the vehicle with, force.x, positive forward."
        " Empty: it is not measured.",
    ),
    _text("<wheel>.joint", "<wheel>_joint", "Its joint in joint_states and in the URDF."),
    _sign(
        "<wheel>.joint_sign",
        "-1: its joint turns backwards when it drives forward. Without it: by the axis in the URDF.",
    ),
    _number(
        "<wheel>.torque_per_effort", 0.0, "1", 0.0, 1e4,
        "Torque at the wheel (N m) per unit of its joint's effort, gear and its losses included. 0: it is not"
        " measured.",
    ),
)  # fmt: skip
PARAMETERS = {parameter.name: parameter for parameter in TABLE}
GENERAL = tuple(p for p in TABLE if not p.name.startswith(WHEEL))
PER_WHEEL = tuple(p for p in TABLE if p.name.startswith(WHEEL))


def parameters_for(wheels: Sequence[str]) -> tuple[NodeParameter, ...]:
    """Return all parameters of a vehicle with these wheels."""
    return GENERAL + tuple(p.for_wheel(wheel) for wheel in wheels for p in PER_WHEEL)
