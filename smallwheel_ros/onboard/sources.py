"""Where loads, torques, sinkage and the speed over ground come from."""

from __future__ import annotations

from enum import Enum


class LoadSource(Enum):
    """Where the wheels' loads come from."""

    WRENCH = "wrench"
    JOINT_STATES = "joint_states"
    STATIC = "static"


class TorqueSource(Enum):
    """Where a wheel's torque comes from."""

    NONE = "none"
    EFFORT = "effort"


class SinkageSource(Enum):
    """What a wheel's sinkage topic carries."""

    SINKAGE = "WheelSinkage"
    RANGE = "Range"


class VelocitySource(Enum):
    """Where the speed over ground comes from that slip is worked out with."""

    ODOMETRY = "odometry"  # which the wheels do not measure
    TOPIC = "topic"  # a sensor of its own: radar, optical flow, visual odometry
    NONE = "none"  # odometry is made from the wheels: it cannot show slip
