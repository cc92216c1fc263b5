# SPDX-License-Identifier: Apache-2.0
"""Publish a bag over DDS, for people without rosbag2, and for the demo."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import rclpy
from rclpy.duration import Duration
from rclpy.event_handler import PublisherEventCallbacks, QoSPublisherMatchedInfo
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from rosgraph_msgs.msg import Clock

from smallwheel_ros.bags import BagReader, BagTopic, RawMessage
from smallwheel_ros.common.errors import SmallwheelError
from smallwheel_ros.common.stop import Stop
from smallwheel_ros.onboard.streams import SECOND
from smallwheel_ros.ros.conversions import message_class, time_message

_CLOCK_PERIOD = SECOND // 100
# A listener that is known here may need a moment more to know of us. DDS says nothing of that: a
# reliable listener gets again what it missed meanwhile, one of best effort does not.
_MUTUAL = 0.5  # s
# The subscriptions of one node become known together, well within this; so do nodes that run already.
_QUIET = 2.0  # s
CONFIRM = 5.0  # s: a listener on this machine confirms within milliseconds
_CLOCK = "/clock"
_RELIABLE = QoSProfile(depth=100, reliability=ReliabilityPolicy.RELIABLE)
_KEPT = QoSProfile(
    depth=100,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)


class PlayError(SmallwheelError):
    """A bag that cannot be published."""


@dataclass(frozen=True)
class PlaySettings:
    """How to play a bag.

    rate: times as fast as recorded. start: s after the bag's beginning. loop: again and again.
    clock: publish /clock from the times of recording, for nodes with use_sim_time.
    """

    rate: float = 1.0
    start: float = 0.0
    loop: bool = False
    clock: bool = True


@contextmanager
def own_node(name: str) -> Iterator[Node]:
    """ROS and a node for as long as it lasts. Ctrl-C ends it like any other program."""
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    node = Node(name)
    try:
        yield node
    finally:
        node.destroy_node()  # left to the garbage collector, it stays on the network for as long
        rclpy.try_shutdown()


def _keeps_last(reader: BagReader, topic: BagTopic) -> bool:
    """Whether a topic was recorded as latched: who listens late gets its last messages."""
    found = reader.as_channel(topic.name, topic.type)
    return found is not None and any(q.durability.name == "TRANSIENT_LOCAL" for q in found[0].qos)


def _converted(raw: RawMessage, convert: Callable[[bytes], bytes | memoryview]) -> RawMessage:
    try:
        return raw._replace(data=bytes(convert(raw.data)))
    except Exception as error:  # damaged bytes make rosbags raise as it likes
        raise PlayError(f"topic {raw.topic}: a message is damaged ({error})") from error


class Player:
    """Publishes the messages of one bag in their order; use it in a `with` statement.

    A bag of ROS 1 is converted on the way; a damaged one is played to where it ends.

    Attributes
    ----------
    topics
        Type of each topic that is published.
    skipped
        The same of the topics whose type is not installed here.

    Raises
    ------
    BagError
        If there is no bag, or it cannot be read.
    PlayError
        If there is nothing in it to publish, or it ends before the start.
    """

    def __init__(self, node: Node, bag: Path | str, settings: PlaySettings | None = None) -> None:
        self.node, self.bag, self.stop = node, Path(bag), Stop()
        self.settings = settings or PlaySettings()
        if not self.settings.rate > 0:
            raise PlayError(f"rate is {self.settings.rate:g}, expected more than 0")
        with BagReader(self.bag, salvage=True) as reader:
            types = {topic.name: topic.type for topic in reader.topics}
            kept = {t.name: _keeps_last(reader, t) for t in reader.topics}
            self.message_count = reader.message_count
            self._begin = reader.start_time
            duration = ((reader.end_time or 0) - (reader.start_time or 0)) / SECOND
        if self.settings.start > duration:
            raise PlayError(
                f"start is {self.settings.start:g} s, expected at most {duration:.3f} s: bag"
                f" {self.bag} is no longer"
            )
        classes = {name: message_class(kind) for name, kind in types.items()}
        self.topics = {name: types[name] for name, found in classes.items() if found is not None}
        self.skipped = {name: types[name] for name, found in classes.items() if found is None}
        if not self.topics:
            raise PlayError(f"bag {self.bag} has no message of a type that is installed here")
        self._newest_match = 0.0  # time.monotonic()
        self._listeners = dict.fromkeys(self.topics, 0)
        self._publishers = {
            name: self._publisher(name, classes[name], _KEPT if kept[name] else _RELIABLE)
            for name in self.topics
        }
        self._clock = None
        if self.settings.clock and _CLOCK not in self.topics:
            self._clock = self._publisher(_CLOCK, Clock, _RELIABLE)
            self._publishers[_CLOCK] = self._clock
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(node)

    def _publisher(self, topic: str, kind: Any, profile: QoSProfile) -> Publisher:
        events = PublisherEventCallbacks(matched=partial(self._on_match, topic))
        return self.node.create_publisher(kind, topic, profile, event_callbacks=events)

    def __enter__(self) -> Player:
        return self

    def __exit__(self, *_: object) -> None:
        self._executor.shutdown()

    def spin(self, seconds: float) -> None:
        """Let the node's callbacks run for at most so long. Raises KeyboardInterrupt if asked to stop."""
        self._executor.spin_once(timeout_sec=max(seconds, 0.0))
        self._stop_if_asked()

    def _stop_if_asked(self) -> None:
        # Not from the signal's handler: raised inside of a callback or a destructor it would be lost.
        if self.stop.asked:
            raise KeyboardInterrupt

    def unheard(self) -> list[str]:
        """Topics that nobody listens to, as far as events have been taken by `spin`."""
        return [name for name, count in self._listeners.items() if count == 0]

    def _on_match(self, topic: str, event: QoSPublisherMatchedInfo) -> None:
        # Who listens to our clock need not listen to the bag, but is to have the clock's beginning.
        if topic in self._listeners:
            self._listeners[topic] = event.current_count
        self._newest_match = time.monotonic()

    def _begin_at(self) -> float:
        unheard = self.unheard()
        if len(unheard) == len(self.topics):
            return math.inf
        return self._newest_match + (_QUIET if unheard else _MUTUAL)

    def wait_for_listeners(self, limit: float) -> None:
        """Wait for listeners, at most `limit` s.

        Until every topic is heard, or some are and 2 s have passed since the last listener came:
        nobody here needs the others, as far as can be known.
        """
        deadline = time.monotonic() + limit
        while (left := min(self._begin_at(), deadline) - time.monotonic()) > 0:
            self.spin(min(left, 0.05))

    def nobody_listens(self) -> str:
        """Say which topics have no listener, and to which of them somebody subscribes in vain."""
        unheard = self.unheard()
        vain = [name for name in unheard if self.node.count_subscribers(name) > 0]
        lonely = [name for name in unheard if name not in vain]
        said = []
        if vain:
            said.append(
                f"subscribed to with another type or quality of service, and not heard:"
                f" {', '.join(vain)}"
            )
        if len(lonely) == len(self.topics):
            said.append("nobody listens to any topic: played all the same")
        elif lonely:
            said.append(f"nobody listens to {', '.join(lonely)}")
        return "; ".join(said)

    def wait_for_confirmation(self) -> list[str]:
        """Wait until the listeners have what was published; name the topics that they lack.

        Those of best effort confirm nothing, and are not waited for.
        """
        deadline = time.monotonic() + CONFIRM
        return [
            name
            for name, publisher in self._publishers.items()
            if not publisher.wait_for_all_acked(
                Duration(seconds=max(deadline - time.monotonic(), 0.0))
            )
        ]

    def messages(self) -> Iterator[RawMessage]:
        """Give the bag's messages that can be published, over and over when it loops."""
        assert self._begin is not None
        start = self._begin + round(self.settings.start * SECOND)
        while True:
            with BagReader(self.bag, salvage=True) as reader:
                converters = {
                    (topic.name, topic.type): reader.as_channel(topic.name, topic.type)
                    for topic in reader.topics
                    if not reader.is_ros2
                }
                for raw in reader.raw_messages(list(self.topics), start=start):
                    found = converters.get((raw.topic, raw.type))
                    yield raw if found is None else _converted(raw, found[1])
            if not self.settings.loop:
                return

    def play(self) -> Iterator[RawMessage]:
        """Publish everything at its time; give each message before it is published.

        Who takes them may take their time, and the rest is then later.
        """
        clock = 0
        origin: tuple[float, int] | None = None  # wall time and log time that belong together
        for raw in self.messages():
            now = time.monotonic()
            if origin is None or raw.log_time < clock - _CLOCK_PERIOD:  # the beginning, a loop
                origin, clock = (now, raw.log_time), 0
            due = origin[0] + (raw.log_time - origin[1]) / SECOND / self.settings.rate
            while (now := time.monotonic()) < due:
                self.spin(min(due - now, 0.05))
            yield raw
            # Whoever held it up is not made to catch up.
            late = time.monotonic() - due
            if late > 0.05:
                origin = (origin[0] + late, origin[1])
            if self._clock is not None and raw.log_time >= clock + _CLOCK_PERIOD:
                clock = raw.log_time
                self._clock.publish(Clock(clock=time_message(clock)))
            self._publishers[raw.topic].publish(bytes(raw.data))
            self._stop_if_asked()
