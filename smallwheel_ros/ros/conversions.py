"""Between ROS messages and the library's values; nothing is worked out here."""

from __future__ import annotations

from builtin_interfaces.msg import Time

from smallwheel_ros.estimator.identifiability import SoilEstimate
from smallwheel_ros.msg import MobilityEstimate as MobilityMessage
from smallwheel_ros.msg import SoilEstimate as SoilMessage
from smallwheel_ros.onboard.message_fields import mobility_fields, soil_fields
from smallwheel_ros.onboard.mobility import MobilityEstimate
from smallwheel_ros.onboard.streams import SECOND


def nanoseconds_of(stamp: Time) -> int:
    """Turn a header's stamp into ns."""
    return int(stamp.sec) * SECOND + int(stamp.nanosec)


def time_message(stamp: int) -> Time:
    """Turn ns into a header's stamp."""
    return Time(sec=stamp // SECOND, nanosec=stamp % SECOND)


def mobility_message(estimate: MobilityEstimate) -> MobilityMessage:
    """Turn an estimate into its message."""
    message = MobilityMessage(**mobility_fields(estimate))
    message.header.stamp = time_message(estimate.stamp)
    message.header.frame_id = estimate.wheel
    return message


def soil_message(soil: SoilEstimate, stamp: int, frame: str, rejected: int) -> SoilMessage:
    """Turn an estimate of the soil into its message."""
    message = SoilMessage(**soil_fields(soil, rejected))
    message.header.stamp = time_message(stamp)
    message.header.frame_id = frame
    return message
