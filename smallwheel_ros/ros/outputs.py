# SPDX-License-Identifier: Apache-2.0
"""The node's publishers: contents of their messages, and the rate of each."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from geometry_msgs.msg import TwistWithCovarianceStamped
from nav_msgs.msg import OccupancyGrid
from rclpy.lifecycle import LifecycleNode, LifecyclePublisher
from rclpy.qos import QoSCompatibility, QoSProfile, qos_check_compatible
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from smallwheel_ros.common.stamps import SECOND
from smallwheel_ros.costmap.cost_map import COST_TOPICS
from smallwheel_ros.costmap.grid import Pose
from smallwheel_ros.drive.ground_ahead import Report
from smallwheel_ros.drive.messages import (
    mobility_columns,
    soil_fields,
    vehicle_columns,
)
from smallwheel_ros.drive.speed_limit import SpeedLimit
from smallwheel_ros.msg import MobilityEstimate, SoilEstimate, VehicleMobility
from smallwheel_ros.onboard.declared import TwistSettings
from smallwheel_ros.onboard.settings import NodeSettings
from smallwheel_ros.physics.wheel import Wheel
from smallwheel_ros.pipeline.intake.layout import MAXIMUM_GAP
from smallwheel_ros.pipeline.mobility.status import Status
from smallwheel_ros.pipeline.mobility.vehicle import VehicleEstimates
from smallwheel_ros.pipeline.pipeline import Pipeline, Turn
from smallwheel_ros.pipeline.soil.identifiability import SoilEstimate as Soil
from smallwheel_ros.pipeline.tables import Estimates, none_of
from smallwheel_ros.pipeline.twist.twist import Twists, messages
from smallwheel_ros.ros.conversions import header_of, message_class
from smallwheel_ros.ros.cost_publisher import CostPublisher
from smallwheel_ros.ros.parameters import ESTIMATE, LATCHED, NO_PUBLISHER_EVENTS

OUTPUTS = {
    "~/vehicle": (VehicleMobility, ESTIMATE),
    "~/soil": (SoilEstimate, LATCHED),
    "~/markers": (MarkerArray, ESTIMATE),
    **{f"~/{name}": (OccupancyGrid, LATCHED) for name in COST_TOPICS},
}
TWIST = {"~/twist": (TwistWithCovarianceStamped, ESTIMATE)}  # where twist.publish is set
SPEED_LIMIT = "nav2_msgs/msg/SpeedLimit"
BEFORE = "~/mobility"  # carried the messages of all wheels in releases up to 0.3
_SOIL_PERIOD = SECOND // 10  # by stamps: no more than ten times a second

# --- Markers

# A colour for each margin, from stuck to easy: dark red, orange, yellow-green. They differ in
# lightness too, for those who cannot tell red from green.
_MARGINS = (0.0, 0.1, 0.2)  # and the red, green and blue of each
_COLOURS = ((0.55, 0.95, 0.75), (0.0, 0.55, 0.9), (0.1, 0.1, 0.45))
_UNKNOWN = [0.6, 0.6, 0.6]
_EXAGGERATION = 10.0  # sinkages are small beside a vehicle


def markers(newest: Estimates, wheels: Sequence[Wheel], frame: str) -> MarkerArray:
    """Make markers for viewers: a column under each wheel, ten times as high as its sinkage, and text above.

    Parameters
    ----------
    newest
        The newest estimate of each wheel; those without a position or a sinkage have no markers.
    wheels
        All wheels, in the order of their numbers; the number is the markers' id.
    frame
        Frame of the odometry.

    Returns
    -------
    MarkerArray
        Two markers for each wheel: a cylinder, coloured by the margin, and text with name, sinkage and
        steepest slope.
    """
    array = MarkerArray()
    for i in range(len(newest)):
        array.markers.extend(_of_wheel(newest, i, wheels[int(newest.wheel[i])], frame))
    return array


def _of_wheel(newest: Estimates, i: int, wheel: Wheel, frame: str) -> list[Marker]:
    measured, margin = float(newest.sinkage_measured[i]), float(newest.margin[i])
    depth = float(newest.sinkage[i]) if math.isnan(measured) else measured
    pose = Pose(float(newest.x[i]), float(newest.y[i]), float(newest.heading[i]))
    if not math.isfinite(sum(pose) + depth):
        return []
    header, number = header_of(int(newest.stamp[i]), frame), int(newest.wheel[i])
    column = Marker(header=header, ns="sinkage", id=number, type=Marker.CYLINDER)
    words = Marker(header=header, ns="sinkage_text", id=number, type=Marker.TEXT_VIEW_FACING)
    place = pose.place(wheel.longitudinal_position, wheel.lateral_position)
    for marker in (column, words):
        marker.pose.position.x, marker.pose.position.y = place
        marker.pose.orientation.w = 1.0
    if math.isnan(margin):
        colour, held = _UNKNOWN, ""
    else:
        colour = [float(np.interp(margin, _MARGINS, part)) for part in _COLOURS]
        held = f"\nholds {math.degrees(math.atan(margin)):.0f}°"
    height = max(_EXAGGERATION * depth, 1e-3)
    column.pose.position.z = -0.5 * height
    column.scale.x = column.scale.y = wheel.width
    column.scale.z = height
    column.color.r, column.color.g, column.color.b = colour
    column.color.a = 0.9
    words.pose.position.z = wheel.diameter
    words.scale.z = 0.5 * wheel.width
    words.color = ColorRGBA(r=1.0, g=1.0, b=1.0, a=1.0)
    words.text = f"{wheel.name}\n{1e3 * depth:.1f} mm{held}"
    return [column, words]


# --- All of it


class Outputs:
    """The publishers of a configured node; call `destroy` at the end.

    Parameters
    ----------
    node
        The node.
    settings
        Its settings.
    pipeline
        Its pipeline.
    report
        Called with topic, reason and explanation of a problem.

    Attributes
    ----------
    newest
        The newest estimate of each wheel, in the order of their numbers; empty before the first.
    cost
        Publisher of the cost map.
    """

    def __init__(
        self, node: LifecycleNode, settings: NodeSettings, pipeline: Pipeline, report: Report
    ) -> None:
        self._node, self._settings, self._pipeline, self._report = node, settings, pipeline, report
        self._publishers: dict[str, LifecyclePublisher] = {}
        self._deaf: dict[tuple[str, bytes], int] = {}  # in so many looks in a row
        self.newest = none_of(Estimates)
        self._told_what_went = False
        self._soil_sent: int | None = None
        # Stamp, soil and rejected readings of the newest soil that is not published yet.
        self._soil_waits: tuple[int, Soil, int] | None = None
        try:
            for topic, (kind, profile) in outputs_of(settings).items():
                self._publishers[topic] = node.create_lifecycle_publisher(
                    kind, topic, profile, event_callbacks=NO_PUBLISHER_EVENTS
                )
            cost = [self._publishers[f"~/{name}"] for name in COST_TOPICS]
            self.cost = CostPublisher(settings, cost, report)
            self._limit = SpeedLimit()
        except Exception:
            self.destroy()
            raise

    def destroy(self) -> None:
        """Destroy all publishers."""
        for publisher in self._publishers.values():
            self._node.destroy_lifecycle_publisher(publisher)
        self._publishers = {}

    def report_deaf_subscribers(self) -> None:
        """Report subscribers that get no message, since they request QoS that is not offered; each once."""
        deaf: dict[tuple[str, bytes], int] = {}
        for publisher in self._publishers.values():
            topic = publisher.topic_name
            # The profile in DDS: that of the publisher itself has 0 instead of infinite.
            offers = [i.qos_profile for i in self._node.get_publishers_info_by_topic(topic)]
            for info in self._node.get_subscriptions_info_by_topic(topic) if offers else ():
                fits, why = qos_check_compatible(offers[0], info.qos_profile)
                if fits != QoSCompatibility.ERROR:
                    continue
                key = (topic, bytes(info.endpoint_gid))
                deaf[key] = self._deaf.get(key, 0) + 1
                # The first look may come before DDS knows the QoS of a subscriber that it has found.
                if deaf[key] == 2:
                    text = f"a subscriber asks for QoS that is not offered, and gets nothing: {why}"
                    self._report(topic, "incompatible_qos", text)
        self._deaf = deaf

    def start_over(self) -> None:
        """Forget what was published: the soil has changed, or time went back."""
        self.cost.clear()
        self._limit.clear()
        self.delete_markers()
        self.newest = none_of(Estimates)
        self._soil_sent = self._soil_waits = None

    def publish(self, turn: Turn, frame: str) -> None:
        """Publish the results of one turn of the pipeline, and keep those that are published at lower rates.

        Parameters
        ----------
        turn
            Results of a turn of the pipeline.
        frame
            Frame of the odometry.
        """
        # Before the first estimate there is nothing to forget: a map that was restored stays.
        if turn.starts_over and len(self.newest):
            self.start_over()
        if turn.twists is not None:
            self._publish_twists(turn.twists, self._settings.twist)
        found = turn.estimates
        self._publish_vehicle(self.cost.take(found, turn.vehicle, frame))
        if not len(found):
            return
        self._publish_estimates(found)
        self._count_lonely(found)
        for stamp, version, rejected in zip(
            found.stamp.tolist(), found.soil_version.tolist(), found.rejected.tolist(), strict=True
        ):
            sent = self._soil_sent
            self._soil_waits = stamp, self._pipeline.soil_at(version), rejected
            if sent is None or not sent <= stamp < sent + _SOIL_PERIOD:
                self.publish_waiting_soil(frame)
        self.newest = newest_of(self.newest, found)
        if self._limit.take(found):
            self.publish_speed_limit()

    def _publish_estimates(self, found: Estimates) -> None:
        columns = mobility_columns(found, self._pipeline)
        for stamp, row in zip(found.stamp.tolist(), _fields_of(columns), strict=True):
            wheel = row["wheel"]
            header = header_of(stamp, self._settings.frame_of(wheel))
            message = MobilityEstimate(header=header, **row)
            self._publishers[mobility_topic(wheel)].publish(message)

    def _publish_vehicle(self, rows: VehicleEstimates) -> None:
        for stamp, row in zip(rows.stamp.tolist(), _fields_of(vehicle_columns(rows)), strict=True):
            message = VehicleMobility(header=header_of(stamp, self._settings.base_frame), **row)
            self._publishers["~/vehicle"].publish(message)

    def report_waiting_for_what_went(self) -> None:
        """Log once which topics replace ~/mobility, which no longer exists, if it has subscribers."""
        if self._told_what_went or not self._node.count_subscribers(BEFORE):
            return
        self._told_what_went = True
        wheels = [mobility_topic(wheel.name) for wheel in self._settings.onboard.wheels]
        of_each, vehicle = (
            [self._node.resolve_topic_name(name) for name in names]
            for names in (wheels, ["~/vehicle"])
        )
        self._node.get_logger().warning(
            f"a subscriber waits on {self._node.resolve_topic_name(BEFORE)}, which is gone: each wheel has a"
            f" topic of its own ({', '.join(of_each)}), the vehicle {vehicle[0]}"
        )

    def _count_lonely(self, found: Estimates) -> None:
        """Count the estimates for which there was no load as problems of their streams."""
        lonely = found.status == Status.LOAD_MISSING
        kinds = np.where(np.isnan(found.sinkage_measured[lonely]), "load", "sinkage").tolist()
        wheels = found.wheel[lonely].tolist()
        for (wheel, kind), times in Counter(zip(wheels, kinds, strict=True)).items():
            stream = f"{self._settings.onboard.wheels[wheel].name}/{kind}"
            text = f"no usable load within {MAXIMUM_GAP:g} s of its stamp"
            self._pipeline.note(stream, "load_missing", text, times, unused=False)

    def _publish_twists(self, twists: Twists, settings: TwistSettings) -> None:
        parts = messages(twists, settings)
        for stamp, linear, angular, covariance in zip(twists.stamp.tolist(), *parts, strict=True):
            message = TwistWithCovarianceStamped(header=header_of(stamp, self._settings.base_frame))
            mean = message.twist.twist
            mean.linear.x, mean.linear.y, mean.linear.z = linear.tolist()
            mean.angular.x, mean.angular.y, mean.angular.z = angular.tolist()
            message.twist.covariance = covariance
            self._publishers["~/twist"].publish(message)

    def publish_waiting_soil(self, frame: str) -> None:
        """Publish the newest soil, unless it has been published already. frame: of the odometry."""
        if self._soil_waits is not None:
            stamp, soil, rejected = self._soil_waits
            self._soil_sent, self._soil_waits = stamp, None
            self._publish_soil(soil, rejected, stamp, frame)

    def publish_soil(self, frame: str) -> None:
        """Publish the present soil, stamped with the clock, without a new measurement.

        frame: of the odometry.
        """
        now = self._node.get_clock().now().nanoseconds
        self._publish_soil(self._pipeline.soil, self._pipeline.rejected, now, frame)

    def _publish_soil(self, soil: Soil, rejected: int, stamp: int, frame: str) -> None:
        message = SoilEstimate(header=header_of(stamp, frame), **soil_fields(soil, rejected))
        self._publishers["~/soil"].publish(message)

    def publish_cost(self) -> None:
        """Publish the cost grids if they have changed."""
        self.cost.publish(self._node.get_clock().now().nanoseconds)

    def publish_speed_limit(self) -> None:
        """Publish the speed limit, if a topic is configured for it; report any other publisher there."""
        topic, kind = self._settings.speed_limit_topic, message_class(SPEED_LIMIT)
        if not topic or kind is None:
            return
        message = kind(percentage=True, speed_limit=self._limit.percent)
        now = self._node.get_clock().now().nanoseconds
        message.header = header_of(now, self._settings.base_frame)
        self._publishers[topic].publish(message)
        if self._node.count_publishers(topic) > 1:
            text = "somebody else publishes speed limits there (a SpeedFilter?): the last message counts"
            self._report(topic, "two_publishers", text)

    def publish_markers(self, frame: str) -> None:
        """Publish the markers if there is a subscriber. frame: of the odometry."""
        publisher = self._publishers["~/markers"]
        if len(self.newest) and publisher.get_subscription_count():
            publisher.publish(markers(self.newest, self._settings.onboard.wheels, frame))

    def delete_markers(self) -> None:
        """Delete the published markers, which viewers would keep for ever."""
        publisher = self._publishers["~/markers"]
        if publisher.is_activated:
            publisher.publish(MarkerArray(markers=[Marker(action=Marker.DELETEALL)]))


def outputs_of(settings: NodeSettings) -> dict[str, tuple[Any, QoSProfile]]:
    """Return type and QoS of each topic that the node publishes, by the topic's name before remapping."""
    wheels = {mobility_topic(name): (MobilityEstimate, ESTIMATE) for name in settings.inputs}
    topic = settings.speed_limit_topic
    limit = {topic: (message_class(SPEED_LIMIT), ESTIMATE)} if topic else {}
    return wheels | OUTPUTS | (TWIST if settings.twist.publish else {}) | limit


def mobility_topic(wheel: str) -> str:
    """Return the topic of a wheel's estimates, given the wheel's name."""
    return f"~/{wheel}/mobility"


def _fields_of(columns: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    """Turn columns into one dictionary of fields for each row."""
    values = zip(*(np.asarray(column).tolist() for column in columns.values()), strict=True)
    return (dict(zip(columns, row, strict=True)) for row in values)


def newest_of(before: Estimates, found: Estimates) -> Estimates:
    """Find the newest estimate of each wheel.

    Parameters
    ----------
    before
        Newest estimates so far.
    found
        Later estimates, in order of stamps.

    Returns
    -------
    Estimates
        One row for each wheel in either, in the order of the wheels' numbers.
    """
    every = Estimates.joined([before, found])
    _, last = np.unique(every.wheel[::-1], return_index=True)
    return every.take(len(every) - 1 - last)
