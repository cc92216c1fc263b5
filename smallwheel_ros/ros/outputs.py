# SPDX-License-Identifier: Apache-2.0
"""Everything that the node publishes of its estimates, each at its rate; and what its messages hold."""

from __future__ import annotations

import importlib
import math
import time
from array import array
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
import rclpy
from builtin_interfaces.msg import Time
from nav_msgs.msg import OccupancyGrid
from rclpy.duration import Duration
from rclpy.lifecycle import LifecycleNode, LifecyclePublisher
from rclpy.publisher import Publisher
from rclpy.qos import QoSCompatibility, qos_check_compatible
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from smallwheel_ros.costmap.cost_map import CostMap, CostSettings
from smallwheel_ros.costmap.grid import UNKNOWN, CostMapError, Grid, Pose, grid_from
from smallwheel_ros.estimator.reading import SECOND
from smallwheel_ros.msg import MobilityEstimate, SoilEstimate
from smallwheel_ros.onboard.feed import Feed, angles_of
from smallwheel_ros.onboard.ground import GroundMapper, margin_before_driving
from smallwheel_ros.onboard.result import Result, mobility_fields, soil_fields
from smallwheel_ros.physics.wheel import Quantity, Wheel
from smallwheel_ros.ros.parameters import ESTIMATE, LATCHED, NO_PUBLISHER_EVENTS

OUTPUTS = {
    "~/mobility": (MobilityEstimate, ESTIMATE),
    "~/soil": (SoilEstimate, LATCHED),
    "~/markers": (MarkerArray, ESTIMATE),
    "~/cost": (OccupancyGrid, LATCHED),
}
_SOIL_PERIOD = SECOND // 10  # by stamps: no more than ten times a second
# Takes topic, reason and words of something that went wrong.
Report = Callable[[str, str, str], None]


# --- Between messages and values; nothing is worked out here


def message_class(kind: str) -> Any | None:
    """Return the ROS class of a type like nav_msgs/msg/Odometry; None: it is not installed."""
    try:
        package, _, name = kind.split("/")
        return getattr(importlib.import_module(f"{package}.msg"), name)
    except (ValueError, ImportError, AttributeError):
        return None


def nanoseconds_of(stamp: Time) -> int:
    """Turn a header's stamp into ns."""
    return int(stamp.sec) * SECOND + int(stamp.nanosec)


def time_message(stamp: int) -> Time:
    """Turn ns into a header's stamp."""
    return Time(sec=stamp // SECOND, nanosec=stamp % SECOND)


def _header(stamp: int, frame: str) -> Header:
    return Header(stamp=time_message(stamp), frame_id=frame)


def grid_message(grid: Grid, stamp: int) -> OccupancyGrid:
    """Turn a grid into its message; stamp in ns."""
    message = OccupancyGrid(header=_header(stamp, grid.frame))
    info = message.info
    info.map_load_time = message.header.stamp
    info.resolution = grid.resolution
    info.height, info.width = grid.cells.shape
    info.origin.position.x, info.origin.position.y = grid.origin
    info.origin.orientation.w = 1.0
    # An array of the right type is taken as it is; anything else is looked at cell by cell.
    message.data = array("b", grid.cells.tobytes())
    return message


def _pose_of(transform: Any) -> Pose:
    """Place and heading of a geometry_msgs/Transform; the heading is NaN where it has no rotation."""
    by, turn = transform.translation, transform.rotation
    yaw, *_ = angles_of(turn.x, turn.y, turn.z, turn.w)
    return Pose(by.x, by.y, math.nan if yaw is None else yaw)


# --- Markers

# A colour for each margin, from stuck to easy: dark red, orange, yellow-green. They differ in
# lightness too, for those who cannot tell red from green.
_MARGINS = (0.0, 0.1, 0.2)  # and the red, green and blue of each
_COLOURS = ((0.55, 0.95, 0.75), (0.0, 0.55, 0.9), (0.1, 0.1, 0.45))
_UNKNOWN = [0.6, 0.6, 0.6]
_EXAGGERATION = 10.0  # sinkages are small beside a vehicle


def markers(newest: Iterable[Result], frame: str) -> MarkerArray:
    """A column under each wheel, ten times as high as it is deep, with its sinkage in words.

    newest: a result of each wheel, always in one order, by which markers are numbered; one without a
    place has none. frame: of the odometry.
    """
    array = MarkerArray()
    for i, result in enumerate(newest):
        array.markers.extend(_of_wheel(i, result, frame))
    return array


def _of_wheel(number: int, result: Result, frame: str) -> list[Marker]:
    reading, place, wheel = result.reading, result.reading.place, result.reading.wheel
    depth = reading.sinkage or result.sinkage_predicted
    if place is None or depth is None:
        return []
    header = _header(reading.stamp, frame)
    column = Marker(header=header, ns="sinkage", id=number, type=Marker.CYLINDER)
    words = Marker(header=header, ns="sinkage_text", id=number, type=Marker.TEXT_VIEW_FACING)
    for marker in (column, words):
        marker.pose.position.x, marker.pose.position.y = place
        marker.pose.orientation.w = 1.0
    margin = None if result.forces is None else result.forces.margin
    if margin is None:
        colour, held = _UNKNOWN, ""
    else:
        colour = [float(np.interp(margin.value, _MARGINS, part)) for part in _COLOURS]
        held = f"\nholds {math.degrees(math.atan(margin.value)):.0f}°"
    height = max(_EXAGGERATION * depth.value, 1e-3)
    column.pose.position.z = -0.5 * height
    column.scale.x = column.scale.y = wheel.width
    column.scale.z = height
    column.color.r, column.color.g, column.color.b = colour
    column.color.a = 0.9
    words.pose.position.z = wheel.diameter
    words.scale.z = 0.5 * wheel.width
    words.color = ColorRGBA(r=1.0, g=1.0, b=1.0, a=1.0)
    words.text = f"{wheel.name}\n{1e3 * depth.value:.1f} mm{held}"
    return [column, words]


# --- The cost map

TERRAIN_CLASSES = "terrain_classes"
# s: Nav2 leaves costs where they were when a grid came. After a correction of map -> odom they are
# where they belong once it comes again: at once where tf tells of it, else after so long.
_AGAIN_AFTER = 5.0
_LAST = 0.5  # s for listeners to take the last grid


class CostPublisher:
    """Keeps the cost map of a vehicle (`map`), and publishes it.

    received, published: how many grids of terrain classes have come, and how many of costs were sent.
    report: takes what is wrong with a grid that cannot be used. prior: the vehicle's margin on any ground, as
    it is believed before driving.
    """

    def __init__(
        self,
        settings: CostSettings,
        wheels: Sequence[Wheel],
        publisher: LifecyclePublisher,
        report: Report,
        prior: Quantity | None = None,
    ) -> None:
        self._publisher = publisher
        self._report = report
        self._stamp = 0
        self._last: Any = None
        self._sent: Any = None  # the newest grid, and when that was by time.monotonic()
        self._sent_at = 0.0
        # Of that grid, where tf had it when it was sent.
        self._corner: tuple[float, float] | None = None
        self._corrected = False
        # By frame, what /tf_static says of it: that comes once, mostly before any odometry.
        self._static: dict[str, tuple[str, Pose]] = {}
        self.received = 0
        self.published = 0
        self.map = CostMap(settings, wheels, prior)
        self._ground = GroundMapper(self.map)

    def add(self, result: Result, frame: str) -> None:
        """Take a result of the estimate; frame is that of the odometry."""
        self._stamp = max(self._stamp, result.reading.stamp)
        self._ground.add(result, frame)
        if self.map.frame in self._static:
            self.map.place_frame(*self._static.pop(self.map.frame))

    def on_classes(self, message: Any) -> None:
        """Take a grid of terrain classes; one that comes by two subscriptions counts once."""
        if message == self._last:
            return
        self._last = message
        self.received += 1
        try:
            self.map.take_classes(grid_from(message))
        except CostMapError as error:
            self._report(TERRAIN_CLASSES, "malformed_grid", f"not used: {error}")
            return
        self._stamp = max(self._stamp, nanoseconds_of(message.header.stamp))
        if self.map.in_other_frame:
            self._report(TERRAIN_CLASSES, "other_frame", self.map.problem)

    def on_transforms(self, message: Any) -> None:
        """Take transforms (tf2_msgs/TFMessage): the grid is sent again once its frame has moved."""
        of_grid = None if self._sent is None else self._sent.header.frame_id
        for found in message.transforms:
            frame = found.child_frame_id
            if frame not in (self.map.frame, of_grid):
                continue
            pose = _pose_of(found.transform)
            if frame == self.map.frame != "" and math.isfinite(sum(pose)):
                self.map.place_frame(found.header.frame_id, pose)
            if frame == of_grid:
                self._look_at_corner(pose)

    def on_static_transforms(self, message: Any) -> None:
        """Take transforms that are said once: of frames that are not known yet, they are kept."""
        for found in message.transforms:
            pose = _pose_of(found.transform)
            if math.isfinite(sum(pose)):
                self._static[found.child_frame_id] = found.header.frame_id, pose
        self.on_transforms(message)

    def _look_at_corner(self, pose: Pose) -> None:
        """See whether the far corner of the grid that was sent has moved in the frame above it."""
        info = self._sent.info
        corner = pose.place(
            info.origin.position.x + info.width * info.resolution,
            info.origin.position.y + info.height * info.resolution,
        )
        if self._corner is None:
            self._corner = corner
        elif not math.dist(corner, self._corner) < 0.5 * info.resolution:
            self._corrected = True

    def clear(self) -> None:
        """Forget the ground: the soil is another one, or time has gone back."""
        self._ground.clear()
        self._stamp = 0

    def publish(self, now: int) -> None:
        """Publish the grid if it has changed, and the same one again after 5 s or a correction by tf.

        now (ns): its stamp before any measurement.
        """
        again = self._corrected or time.monotonic() >= self._sent_at + _AGAIN_AFTER
        grid = self.map.grid() if self.map.changed else None
        if grid is not None:
            self._send(grid_message(grid, self._stamp or now))
        elif again and self._sent is not None:
            self._send(self._sent)

    def empty(self) -> None:
        """Tell listeners, before the topic goes, that nothing is known any more: Nav2 would keep it."""
        if self._sent is None or not rclpy.ok():
            return
        self._sent.data = array("b", bytes([UNKNOWN % 256])) * len(self._sent.data)
        # The publisher of a node that is not active any more is silent by itself.
        Publisher.publish(self._publisher, self._sent)
        self._publisher.wait_for_all_acked(Duration(seconds=_LAST))
        self._sent = None

    def _send(self, message: Any) -> None:
        self._publisher.publish(message)
        self._sent, self._sent_at = message, time.monotonic()
        self._corner, self._corrected = None, False
        self.published += 1


# --- All of it


class Outputs:
    """The publishers of a configured node; `destroy` them in the end.

    newest: each wheel's newest result. cost: the cost map.
    """

    def __init__(self, node: LifecycleNode, feed: Feed, report: Report) -> None:
        self._node, self._feed, self._report = node, feed, report
        settings = feed.settings
        self._publishers: list[LifecyclePublisher] = []
        self._deaf: dict[tuple[str, bytes], int] = {}  # in so many looks in a row
        self.newest: dict[str, Result] = {}
        self._soil_sent: int | None = None
        self._soil_waits: Result | None = None
        try:
            for topic, (kind, profile) in OUTPUTS.items():
                self._publishers.append(
                    node.create_lifecycle_publisher(
                        kind, topic, profile, event_callbacks=NO_PUBLISHER_EVENTS
                    )
                )
            self._mobility, self._soil, self._markers, cost = self._publishers
            prior = margin_before_driving(settings.onboard)
            self.cost = CostPublisher(settings.cost, settings.onboard.wheels, cost, report, prior)
        except Exception:
            self.destroy()
            raise

    def destroy(self) -> None:
        """Take the topics away."""
        for publisher in self._publishers:
            self._node.destroy_lifecycle_publisher(publisher)
        self._publishers = []

    def report_deaf_subscribers(self) -> None:
        """Report each subscriber, once, that asks for QoS that is not offered: it gets nothing."""
        deaf: dict[tuple[str, bytes], int] = {}
        for publisher in self._publishers:
            topic = publisher.topic_name
            # As DDS has it: the publisher's own profile has 0 where DDS says infinite.
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
        """Forget what was published: the soil is another one, or time has gone back."""
        self.cost.clear()
        self.delete_markers()
        self.newest, self._soil_sent, self._soil_waits = {}, None, None

    def answer(self, result: Result) -> None:
        """Publish a wheel's mobility."""
        header = _header(result.reading.stamp, result.wheel)
        self._mobility.publish(MobilityEstimate(header=header, **mobility_fields(result)))

    def keep(self, results: Sequence[Result]) -> None:
        """Publish the soil at its rate, and keep what the timers publish."""
        for result in results:
            self.cost.add(result, self._feed.odometry_frame)
            self.newest[result.wheel] = result
            self._soil_waits = result
            stamp, sent = result.reading.stamp, self._soil_sent
            if sent is None or not sent <= stamp < sent + _SOIL_PERIOD:
                self.publish_waiting_soil()

    def publish_waiting_soil(self) -> None:
        """Publish the newest soil unless it has been already."""
        result = self._soil_waits
        if result is not None:
            self._soil_sent, self._soil_waits = result.reading.stamp, None
            self._publish_soil(soil_fields(result.soil, result.rejected), result.reading.stamp)

    def publish_soil(self) -> None:
        """Publish the soil as it is believed now, stamped with the clock: before a measurement."""
        fields = soil_fields(self._feed.onboard.soil, self._feed.onboard.rejected)
        self._publish_soil(fields, self._node.get_clock().now().nanoseconds)

    def _publish_soil(self, fields: dict[str, Any], stamp: int) -> None:
        header = _header(stamp, self._feed.odometry_frame)
        self._soil.publish(SoilEstimate(header=header, **fields))

    def publish_cost(self) -> None:
        """Publish the cost map if it has changed."""
        self.cost.publish(self._node.get_clock().now().nanoseconds)

    def publish_markers(self) -> None:
        """Publish the markers if anybody looks at them."""
        if self.newest and self._markers.get_subscription_count():
            self._markers.publish(markers(self.newest.values(), self._feed.odometry_frame))

    def delete_markers(self) -> None:
        """Take the markers away that were published: viewers keep them for ever otherwise."""
        if self._markers.is_activated:
            self._markers.publish(MarkerArray(markers=[Marker(action=Marker.DELETEALL)]))
