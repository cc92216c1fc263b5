"""The node's subscriptions: made when it is activated, destroyed when it is deactivated."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from typing import Any

from geometry_msgs.msg import TwistStamped, WrenchStamped
from nav_msgs.msg import OccupancyGrid, Odometry
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription
from sensor_msgs.msg import JointState, Range

from smallwheel_ros.msg import WheelSinkage
from smallwheel_ros.onboard.feed import Topic
from smallwheel_ros.ros import qos
from smallwheel_ros.ros.cost_publisher import TERRAIN_CLASSES

_TYPES = {
    "geometry_msgs/msg/TwistStamped": TwistStamped,
    "geometry_msgs/msg/WrenchStamped": WrenchStamped,
    "nav_msgs/msg/Odometry": Odometry,
    "sensor_msgs/msg/JointState": JointState,
    "sensor_msgs/msg/Range": Range,
    "smallwheel_ros/msg/WheelSinkage": WheelSinkage,
}


# A turn ends after so many messages of each topic: timers and services must have theirs too.
_MOST_OF_A_TOPIC = 4


class Listening:
    """What the node listens to now.

    The executor waits for a message and hands it over; what other topics have by then is taken in
    the same turn. The executor's own way, a wait and a task for each message, costs more processor
    time than the message: vehicles send a dozen of them at one instant.

    on: whether it listens.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._subscriptions: list[Subscription] = []
        self._inputs: list[tuple[Subscription, Callable[[Any], None]]] = []

    @property
    def on(self) -> bool:
        """Whether there is any subscription."""
        return bool(self._subscriptions)

    def start(
        self,
        topics: Iterable[Topic],
        take: Callable[[Topic, Any], None],
        take_classes: Callable[[Any], None],
    ) -> None:
        """Subscribe to topics, and to grids of terrain classes."""
        for topic in topics:
            handle = partial(take, topic)
            first = partial(self._take_all, handle)
            kind = _TYPES[topic.type]
            self._inputs.append((self._subscribe(kind, topic.name, first, qos.INPUT), handle))
        # A classifier's grids come as they are made, a map server's one grid was there before us.
        for profile in (qos.INPUT, qos.LATCHED):
            self._subscribe(OccupancyGrid, TERRAIN_CLASSES, take_classes, profile)

    def stop(self) -> None:
        """Listen no more."""
        for subscription in self._subscriptions:
            self._node.destroy_subscription(subscription)
        self._subscriptions, self._inputs = [], []

    def _take_all(self, handle: Callable[[Any], None], first: Any) -> None:
        """Handle a message, then what has come by any topic until then."""
        handle(first)
        if self._node.get_clock().ros_time_is_active:
            # /clock comes by the executor as well: what is taken before it looks like the future.
            return
        for _ in range(_MOST_OF_A_TOPIC):
            more = False
            for subscription, handle_other in self._inputs:
                with subscription.handle:
                    taken = subscription.handle.take_message(
                        subscription.msg_type, subscription.raw
                    )
                if taken is not None:
                    handle_other(taken[0])
                    more = True
            if not more:
                return

    def _subscribe(
        self, kind: Any, topic: str, callback: Callable[[Any], None], profile: QoSProfile
    ) -> Subscription:
        # Each event handler costs time at every wait: what they would tell of inputs, the reporter
        # finds out where a topic stays silent.
        events = SubscriptionEventCallbacks(use_default_callbacks=False)
        subscription = self._node.create_subscription(
            kind, topic, callback, profile, event_callbacks=events
        )
        self._subscriptions.append(subscription)
        return subscription
