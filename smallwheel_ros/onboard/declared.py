# SPDX-License-Identifier: Apache-2.0
"""The node's parameters, each declared once.

From these declarations come the node's ROS descriptors, the values that node and replay accept, the
resulting settings, config/template.yaml and the tables of docs/parameters.md. To add one, add a
field below; `PYTHONPATH=. python docs/parameter_pages.py` writes the template anew. A parameter that the
pipeline needs belongs in `DriveParameters` or one of its groups. `<wheel>` stands for a wheel's
name.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from smallwheel_ros.common.node_parameter import (
    ALL,
    WHEEL,
    NodeParameter,
    group,
    group_per_wheel,
    parameter,
    path,
    rows_of,
    topic,
)
from smallwheel_ros.costmap.cost import CostSettings
from smallwheel_ros.costmap.terrain import REFERENCE_SLIP, TerrainSettings
from smallwheel_ros.effects.instruments import SINKAGE_ZERO_STD
from smallwheel_ros.onboard.prior import SINKAGE_STD
from smallwheel_ros.physics.conditions import ROLLING
from smallwheel_ros.physics.soil import SOILS
from smallwheel_ros.physics.wheel import GRAVITY

LoadSource = Literal["wrench", "joint_states", "static"]
Sign = Literal[1, -1]


@dataclass(frozen=True, kw_only=True)
class VehicleParameters:
    """Parameters vehicle.*, of the vehicle's body."""

    mass: float | None = parameter(
        None,
        "kg",
        (0.01, 1e5),
        "Mass. The balance of forces on slopes and while gaining speed then shows the soil's strength;"
        " loads are checked against it, or are its share with load.source static.",
    )
    gravity_height: float | None = parameter(
        None,
        "m",
        (0.01, 10.0),
        "Height of the centre of gravity above ground: how a slope shifts static loads. Without it: 1.2"
        " mean wheel diameters.",
    )
    track: float | None = parameter(
        None,
        "m",
        (0.01, 20.0),
        "Between the middles of left and right wheels: places of wheels whose names say left or right, and"
        " for which neither a place nor a URDF is given.",
    )
    wheelbase: float | None = parameter(
        None,
        "m",
        (0.01, 20.0),
        "Between the front and the rear axle: likewise for names that say front, middle or rear.",
    )
    base_at: Literal["middle", "rear_axle"] = parameter(
        "middle", text="Where base_frame is, for vehicle.wheelbase."
    )  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class LoadParameters:
    """Parameters load.*, the source of wheel loads."""

    source: LoadSource = parameter(
        "wrench",
        text="Where loads come from: load_topic, the effort of load_joint, or vehicle.mass split over the"
        " wheels (static).",
    )
    per_effort: float = parameter(
        1.0, "N", (1e-6, 1e6), "Load per unit of effort of load_joint."
    )  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class MobilityParameters:
    """Parameters mobility.*, of the estimates that the node publishes."""

    rate: float = parameter(
        10.0, "Hz", (0.0, 1000.0),
        "Most estimates of each wheel's mobility per second. 0: one for each measured sinkage.",
    )  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class SoilParameters:
    """Parameters soil.*, of the prior knowledge of the soil and the file that it is saved to."""

    name: str | None = parameter(
        None,
        text="Soil that the estimate starts from: of model_file, or of the library:"
        f" {', '.join(SOILS)}.",
    )
    file: str = path(
        "File that ~/save_soil writes and that the estimate continues from. Empty: none."
    )
    autosave_period: float = parameter(
        30.0, "s", (0.0, 86400.0),
        "How often soil and cost map are saved to soil.file, if they have changed; and at the end. 0: only by"
        " ~/save_soil.",
    )  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class TwistSettings:
    """Parameters twist.*, of ~/twist, the vehicle's twist by its rims for other estimators."""

    publish: bool = parameter(
        False,
        text="Whether ~/twist is sent, for robot_localization and others (docs/odometry.md). It needs"
        " imu_topic and lateral_position.",
    )
    rim_delay: float = parameter(
        0.0,
        "s",
        (0.0, 1.0),
        "How much later wheel speeds are stamped than the imu's readings of the same instant.",
    )
    correlation_time: float = parameter(
        0.4, "s", (0.0, 10.0),
        "How long errors of slip last: variances sent are multiplied by twice this times the rate. 0: the"
        " variance of one reading.",
    )  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class SensorNoise:
    """Parameters noise.*, standard deviations of measurements whose messages state none."""

    sinkage: float = parameter(
        SINKAGE_STD,
        "m",
        (1e-5, 1.0),
        "Standard deviation of a sinkage whose message states none.",
    )
    load: float = parameter(
        0.5, "N", (0.0, 1e5), "Standard deviation of a load, in addition to 2 % of it."
    )
    drawbar_pull: float = parameter(
        0.6, "N", (1e-3, 1e5), "Standard deviation of a measured drawbar pull."
    )
    speed: float = parameter(
        0.01, "m/s", (0.0, 10.0), "Standard deviation of odometry's speed."
    )  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Timing:
    """Parameters timing.*, limits on the stamps of messages."""

    reorder_time: float = parameter(
        0.2,
        "s",
        (0.0, 5.0),
        "How long, by stamps, a sinkage waits for those of other wheels that belong before it. 0: results"
        " depend on the order of arrival.",
    )
    maximum_age: float = parameter(
        5.0, "s", (0.01, 1e9),
        "Messages stamped further behind the clock are refused.",
    )  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class WheelParameters:
    """Parameters <wheel>.*, of one wheel and the sources of its measurements."""

    diameter: float = parameter(
        None,
        "m",
        (0.005, 5.0),
        "Diameter of the wheel. Without it: of its link's cylinder in the URDF.",
        required=True,
    )
    width: float = parameter(
        None,
        "m",
        (0.001, 5.0),
        "Width of the wheel. Without it: of that cylinder.",
        required=True,
    )
    contact: Literal["rolling", "pressed"] = parameter(
        ROLLING, text="pressed: pushed straight down by a test rig, without odometry."
    )
    lateral_position: float = parameter(
        0.0,
        "m",
        (-10.0, 10.0),
        "How far left of base_frame it is, for its speed in turns and its place on the map. Without it: the"
        " URDF's.",
    )
    longitudinal_position: float = parameter(
        0.0,
        "m",
        (-10.0, 10.0),
        "How far ahead of base_frame it is: which wheels run in another's rut, and which come to another soil"
        " first. Without it: the URDF's.",
    )
    load_topic: str = topic(
        "<wheel>/load", "Topic (geometry_msgs/WrenchStamped) of its load, force.z."
    )
    load_joint: str = parameter(
        "<wheel>_load_joint", text="Joint whose effort is the load with load.source joint_states."
    )
    load_sign: Sign = parameter(
        1, text="-1: the load is negative when the wheel presses on the soil."
    )
    load_share: float | None = parameter(
        None,
        "1",
        (0.001, 1.0),
        "Share of the weight with load.source static. Without it: an equal one.",
    )
    sinkage_topic: str = topic(
        "<wheel>/sinkage",
        "Topic (smallwheel_ros/WheelSinkage) of its sinkage. Empty: it is not measured.",
    )
    range_height: float | None = parameter(
        None,
        "m",
        (0.0, 10.0),
        "Given: sinkage_topic is a sensor_msgs/Range that looks down at undisturbed soil and shows this on"
        " hard ground.",
    )
    drawbar_pull_topic: str = topic(
        "",
        "Topic (geometry_msgs/WrenchStamped) of what it pulls the vehicle with, force.x, positive forward."
        " Empty: it is not measured.",
    )
    joint: str = parameter("<wheel>_joint", text="Its joint in joint_states and in the URDF.")
    joint_sign: Sign = parameter(
        1,
        text="-1: its joint turns backwards when it drives forward. Without it: by the axis in the URDF.",
    )
    steering_joint: str = parameter(
        "",
        text="Joint whose position is its steering angle; two wheels of an axle that name one joint have a"
        " linkage with one central angle. Empty: it is not steered. Without it: by the URDF.",
    )
    steering_sign: Sign = parameter(
        1,
        text="-1: its angle is positive to the right. Without it: by the axis in the URDF.",
    )
    steering_zero: float = parameter(
        0.0,
        "rad",
        (-3.15, 3.15),
        "Position of steering_joint at which the wheel points straight ahead.",
    )
    steering_arm: float | None = parameter(
        None,
        "m",
        (-2.0, 2.0),
        "How far its middle is to the left of its steering axis, straight ahead. Without it: the URDF's, else"
        " unknown, up to a quarter of the diameter either way.",
    )
    frame: str | None = parameter(
        None,
        text="Frame of its messages. Without it: the link that its joint moves in the URDF, else its name.",
    )
    torque_per_effort: float = parameter(
        0.0, "1", (0.0, 1e4),
        "Torque at the wheel (N m) per unit of its joint's effort, gear and its losses included. 0: it is not"
        " measured.",
    )  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class DriveParameters:
    """Those of the node's parameters that the pipeline uses directly."""

    vehicle: VehicleParameters = group(VehicleParameters)
    mobility: MobilityParameters = group(MobilityParameters)
    reference_slip: float = parameter(
        REFERENCE_SLIP,
        "1",
        (0.02, 0.9),
        "Slip at which margin and steepest slope are worked out.",
    )
    gravity: float = parameter(
        GRAVITY, "m/s^2", (0.01, 100.0),
        "Acceleration of free fall where the vehicle drives: of a lunar test bed, of a simulator.",
    )  # fmt: skip
    twist: TwistSettings = group(TwistSettings)
    noise: SensorNoise = group(SensorNoise)
    timing: Timing = group(Timing)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Parameters(DriveParameters):
    """All parameters of the node; each field declares default, unit, range and meaning of one of them."""

    wheels: tuple[str, ...] = parameter(
        None,
        text="Names of the wheels. Each has parameters of its own, below.",
        required=True,
        at_start=True,
    )
    autostart: bool = parameter(
        True,
        text="Configure and activate at the start. False: left to a lifecycle manager.",
        at_start=True,
    )
    robot_description_topic: str = topic(
        "robot_description",
        "Topic (std_msgs/String, latched) of the URDF: sizes, positions and joint_sign of wheels where"
        " none are given. Empty: no URDF.",
        at_start=True,
    )
    base_frame: str = parameter(
        "base_link",
        text="Link that positions are measured from; the URDF's root link where it has no base_link.",
        at_start=True,
    )
    # --- Inputs
    odom_topic: str = parameter(
        "odom",
        text="Topic (nav_msgs/Odometry) of the odometry: speed, place and, without an imu, slope.",
        form="topic",
    )
    joint_states_topic: str = parameter(
        "joint_states",
        text="Topic (sensor_msgs/JointState) with the joints of the wheels.",
        form="topic",
    )
    steering_topic: str = topic(
        "",
        "Topic (sensor_msgs/JointState) with the joints that steer. Empty: that of joint states.",
    )
    terrain_classes_topic: str = topic(
        "terrain_classes",
        "Topic (nav_msgs/OccupancyGrid) of terrain classes, one a cell (docs/nav2.md). Empty: none.",
    )
    odometry_from_wheels: bool = parameter(
        False,
        text="Whether odom is computed from the wheels and shows no slip, which then needs velocity_topic.",
    )
    velocity_topic: str = topic(
        "",
        "Topic (geometry_msgs/TwistStamped, in base_frame) of a speed over ground that the wheels do not"
        " measure: radar, optical flow. Empty: odom's.",
    )
    imu_topic: str = topic(
        "", "Topic (sensor_msgs/Imu) that gives the slope. Empty: from odom's orientation."
    )
    imu_yaw: float = parameter(
        0.0,
        "rad",
        (-3.15, 3.15),
        "Direction of the imu's x axis in base_frame, positive to the left.",
    )
    load: LoadParameters = group(LoadParameters)
    # --- What is known beforehand
    model_file: str = path(
        "Model file of fit, add or diagnose --apply: its soil in place of the library's, and its effects."
    )
    effects_file: str = path(
        "Python file with effects of your own that model_file names. It is run: name only files that you"
        " trust.",
        at_start=True,
    )
    soil: SoilParameters = group(SoilParameters)
    sinkage_zero_std: float = parameter(
        SINKAGE_ZERO_STD,
        "m",
        (0.0, 1.0),
        "Standard deviation of the zero of the sinkage sensors, which limits how well n and the pressure"
        " can be known: set them on firm ground, and lower it.",
    )
    cost: CostSettings = group(CostSettings)
    terrain: TerrainSettings = group(TerrainSettings)
    elevation_topic: str = topic(
        "",
        "Topic (grid_map_msgs/GridMap) of a map of the ground ahead: slopes that are seen have a cost before"
        " a wheel is on them. Empty: none.",
    )
    elevation_layer: str = parameter("elevation", text="Its layer of heights, m; NaN is not known.")
    speed_limit_topic: str = topic(
        "",
        "Topic (nav2_msgs/SpeedLimit) that the controller slows down by: to 50 % from a first warning until"
        " 2 m without, to 20 % at the second level. Empty: none.",
    )
    inputs: Mapping[str, WheelParameters] = group_per_wheel(WheelParameters)  # fmt: skip


PARAMETERS = {row.name: row for row in rows_of(Parameters)}
GENERAL = tuple(row for row in PARAMETERS.values() if not row.name.startswith(WHEEL))
PER_WHEEL = tuple(row for row in PARAMETERS.values() if row.name.startswith(WHEEL))
OF_ALL = tuple(row.for_all() for row in PER_WHEEL)
GROUPS = {row.name.split(".")[0] for row in GENERAL} | {ALL}  # no wheel is called so


def parameters_for(wheels: Sequence[str]) -> tuple[NodeParameter, ...]:
    """Return all parameters of a vehicle with these wheels."""
    return GENERAL + OF_ALL + tuple(p.for_wheel(wheel) for wheel in wheels for p in PER_WHEEL)
