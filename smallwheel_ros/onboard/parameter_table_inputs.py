"""Parameters of what the node listens to: loads, velocity, and each wheel's own."""

from __future__ import annotations

from enum import Enum

from smallwheel_ros.onboard.parameter import Parameter, double
from smallwheel_ros.physics.conditions import PRESSED, ROLLING


class LoadSource(Enum):
    """Where the wheels' loads come from."""

    WRENCH = "wrench"
    JOINT_STATES = "joint_states"
    STATIC = "static"


class SinkageSource(Enum):
    """What a wheel's sinkage topic carries."""

    SINKAGE = "WheelSinkage"
    RANGE = "Range"


STATIC_LOAD_STD = 0.3

INPUTS: tuple[Parameter, ...] = (
    Parameter(
        "load_sign",
        "integer",
        1,
        "",
        "1: force.z (or effort) of a load is positive when the wheel presses on the soil (the soil"
        " pushes the wheel up). -1: negative.",
        choices=(1, -1),
    ),
    Parameter(
        "velocity_topic",
        "string",
        "",
        "",
        "Topic (geometry_msgs/TwistStamped) of a velocity over ground that the wheels do not"
        " measure: radar, optical flow, visual odometry. Empty: odom's is used.",
    ),
    Parameter(
        "odometry_from_wheels",
        "bool",
        False,
        "",
        "Whether odom is made from the wheels. It then cannot show slip: without velocity_topic"
        " there is no slip, no thrust, no drawbar pull, and that is said.",
    ),
    Parameter(
        "load.source",
        "string",
        LoadSource.WRENCH.value,
        "",
        "Where loads come from. wrench: each wheel's load_topic. joint_states: the effort of each"
        " wheel's load_joint. static: nobody measures them; load.mass is split over the wheels.",
        choices=tuple(source.value for source in LoadSource),
    ),
    double(
        "load.mass",
        None,
        "kg",
        0.01,
        1e5,
        "Mass of the vehicle; needed by load.source static, which splits it by load_share.",
    ),
    double(
        "load.static_std",
        STATIC_LOAD_STD,
        "1",
        0.01,
        1.0,
        "Standard deviation of a static load as a share of it: slopes, turns, uneven ground.",
    ),
    double(
        "load.per_effort",
        1.0,
        "N",
        1e-6,
        1e6,
        "Load per unit of effort with load.source joint_states: 1.0 where efforts are N.",
    ),
)

PER_WHEEL: tuple[Parameter, ...] = (
    double("<wheel>.diameter", None, "m", 0.005, 5.0, "Diameter of the wheel.", required=True),
    double("<wheel>.width", None, "m", 0.001, 5.0, "Width of the wheel.", required=True),
    Parameter(
        "<wheel>.contact",
        "string",
        ROLLING,
        "",
        f"{ROLLING}, or {PRESSED} for a wheel that is pushed straight down (a test rig): soil"
        " carries it on both sides of its lowest point, and no odometry is needed.",
        choices=(ROLLING, PRESSED),
    ),
    double(
        "<wheel>.lateral_position",
        0.0,
        "m",
        -10.0,
        10.0,
        "Place of the wheel left of base_link: in turns it travels slower or faster than that.",
    ),
    double(
        "<wheel>.longitudinal_position",
        0.0,
        "m",
        -10.0,
        10.0,
        "Place of the wheel ahead of base_link: which ground of the cost map it is on.",
    ),
    Parameter("<wheel>.load_topic", "string", "<wheel>/load", "", "Topic of the wheel's load."),
    Parameter(
        "<wheel>.drawbar_pull_topic",
        "string",
        "",
        "",
        "Topic (geometry_msgs/WrenchStamped) whose force.x is what a rolling wheel pulls the vehicle with,"
        " positive forward; it tells the soil's strength. It may be load_topic. Empty: nobody"
        " measures it.",
    ),
    Parameter(
        "<wheel>.load_joint",
        "string",
        "<wheel>_load_joint",
        "",
        "Joint whose effort is the load, with load.source joint_states.",
    ),
    double(
        "<wheel>.load_share",
        None,
        "1",
        0.001,
        1.0,
        "Share of load.mass on this wheel, with load.source static. Without it: an equal share.",
    ),
    Parameter(
        "<wheel>.sinkage_topic",
        "string",
        "<wheel>/sinkage",
        "",
        "Topic of the wheel's sinkage. Empty: nobody measures it, it is only predicted.",
    ),
    Parameter(
        "<wheel>.sinkage_source",
        "string",
        SinkageSource.SINKAGE.value,
        "",
        "Type of that topic: smallwheel_ros/WheelSinkage, or sensor_msgs/Range of a sensor that"
        " looks down at undisturbed soil beside the wheel: sinkage = range_height - range.",
        choices=tuple(source.value for source in SinkageSource),
    ),
    double(
        "<wheel>.range_height",
        None,
        "m",
        0.0,
        10.0,
        "What the range sensor shows on hard ground: its height above the wheel's lowest point."
        " Needed by sinkage_source Range.",
    ),
    Parameter("<wheel>.joint", "string", "<wheel>_joint", "", "Name of its joint in joint_states."),
)
