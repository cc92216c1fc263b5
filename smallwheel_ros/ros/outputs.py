# SPDX-License-Identifier: Apache-2.0
"""Everything that the node publishes of its estimates, each at its rate."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from nav_msgs.msg import OccupancyGrid
from rclpy.lifecycle import LifecycleNode, LifecyclePublisher
from rclpy.qos import QoSCompatibility, qos_check_compatible
from visualization_msgs.msg import MarkerArray

from smallwheel_ros.msg import MobilityEstimate as MobilityMessage
from smallwheel_ros.msg import SoilEstimate as SoilMessage
from smallwheel_ros.onboard.onboard import Onboard
from smallwheel_ros.onboard.result import Result
from smallwheel_ros.onboard.settings import NodeSettings
from smallwheel_ros.onboard.streams import SECOND
from smallwheel_ros.ros import qos
from smallwheel_ros.ros.conversions import mobility_message, soil_message
from smallwheel_ros.ros.cost_publisher import CostPublisher
from smallwheel_ros.ros.markers import deletion, markers

OUTPUTS = {
    "~/mobility": (MobilityMessage, qos.ESTIMATE),
    "~/soil": (SoilMessage, qos.LATCHED),
    "~/markers": (MarkerArray, qos.ESTIMATE),
    "~/cost": (OccupancyGrid, qos.LATCHED),
}
_SOIL_PERIOD = SECOND // 10  # by stamps: no more than ten times a second

# Takes topic, reason and words of something that went wrong.
Report = Callable[[str, str, str], None]


class Outputs:
    """The publishers of a configured node; `destroy` them in the end.

    settings: of the node. newest: each wheel's newest result. cost: the cost map.
    """

    def __init__(self, node: LifecycleNode, settings: NodeSettings, report: Report) -> None:
        self._node = node
        self._report = report
        self._publishers: list[LifecyclePublisher] = []
        self._deaf: dict[tuple[str, bytes], int] = {}  # in so many looks in a row
        self.newest: dict[str, Result] = {}
        self._soil_sent: int | None = None
        self._soil_waits: Result | None = None
        try:
            self._mobility, self._soil, self._markers, self._cost = (
                self._publisher(topic) for topic in OUTPUTS
            )
            self.cost = CostPublisher(settings.cost, settings.onboard.wheels, self._cost, report)
        except Exception:
            self.destroy()
            raise

    def _publisher(self, topic: str) -> LifecyclePublisher:
        kind, profile = OUTPUTS[topic]
        publisher = self._node.create_lifecycle_publisher(
            kind, topic, event_callbacks=qos.no_events(), **qos.overridable(profile)
        )
        self._publishers.append(publisher)
        return publisher

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
        self._mobility.publish(mobility_message(result))

    def keep(self, results: Sequence[Result], frame: str) -> None:
        """Publish the soil at its rate, and keep what the timers publish.

        frame: of the odometry, empty where it is not known.
        """
        for result in results:
            self.cost.add(result, frame)
            self.newest[result.wheel] = result
            stamp, sent = result.instant.stamp, self._soil_sent
            self._soil_waits = result
            if sent is None or not sent <= stamp < sent + _SOIL_PERIOD:
                self.publish_waiting_soil(frame)

    def publish_waiting_soil(self, frame: str) -> None:
        """Publish the newest soil unless it has been already."""
        result = self._soil_waits
        if result is not None:
            stamp = result.instant.stamp
            self._soil.publish(soil_message(result.soil, stamp, frame, result.rejected))
            self._soil_sent, self._soil_waits = stamp, None

    def publish_soil_of(self, onboard: Onboard, frame: str) -> None:
        """Publish the soil as it is believed now, stamped with the clock: before a measurement."""
        stamp = self._node.get_clock().now().nanoseconds
        rejected = onboard.rejected
        self._soil.publish(soil_message(onboard.soil, stamp, frame, rejected))

    def publish_cost(self) -> None:
        """Publish the cost map if it has changed."""
        self.cost.publish(self._node.get_clock().now().nanoseconds)

    def publish_markers(self, frame: str) -> None:
        """Publish the markers if anybody looks at them."""
        if self.newest and self._markers.get_subscription_count():
            self._markers.publish(markers(self.newest.values(), frame))

    def delete_markers(self) -> None:
        """Take the markers away that were published."""
        if self._markers.is_activated:
            self._markers.publish(deletion())
