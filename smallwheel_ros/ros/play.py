"""Publish a bag over DDS, for people without rosbag2, and for the demo."""

from __future__ import annotations

import importlib
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from rosgraph_msgs.msg import Clock

from smallwheel_ros.bags import BagReader, BagTopic, RawMessage
from smallwheel_ros.errors import SmallwheelError
from smallwheel_ros.onboard.streams import SECOND
from smallwheel_ros.ros.conversions import time_message
from smallwheel_ros.stop import Stop

_CLOCK_PERIOD = SECOND // 100
_MUTUAL = 0.5  # s
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


def message_class(kind: str) -> Any | None:
    """Return the ROS class of a type like nav_msgs/msg/Odometry; None: it is not installed."""
    try:
        package, _, name = kind.split("/")
        return getattr(importlib.import_module(f"{package}.msg"), name)
    except (ValueError, ImportError, AttributeError):
        return None


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
        self.publishers = {
            name: node.create_publisher(classes[name], name, _KEPT if kept[name] else _RELIABLE)
            for name in self.topics
        }
        self._clock = None
        if self.settings.clock and "/clock" not in self.topics:
            self._clock = node.create_publisher(Clock, "/clock", _RELIABLE)
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(node)

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
        """Topics that nobody listens to (yet)."""
        return [name for name, p in self.publishers.items() if p.get_subscription_count() == 0]

    def wait_for_listeners(self, seconds: float) -> None:
        """Wait until every topic is heard, or so long."""
        deadline = time.monotonic() + seconds
        while self.unheard() and time.monotonic() < deadline:
            self.spin(0.05)
        # A listener that is known here may need a moment more to know of us; what is published
        # before that, it misses.
        deadline = time.monotonic() + _MUTUAL
        while time.monotonic() < deadline:
            self.spin(0.05)

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

    def play(self, before: Callable[[RawMessage], None] | None = None) -> int:
        """Publish everything at its time; return how many messages that were.

        before: called before each message; it may take its time, the rest is then later.
        """
        count, clock = 0, 0
        origin: tuple[float, int] | None = None  # wall time and log time that belong together
        for raw in self.messages():
            now = time.monotonic()
            if origin is None or raw.log_time < clock - _CLOCK_PERIOD:  # the beginning, a loop
                origin, clock = (now, raw.log_time), 0
            due = origin[0] + (raw.log_time - origin[1]) / SECOND / self.settings.rate
            while (now := time.monotonic()) < due:
                self.spin(min(due - now, 0.05))
            if before is not None:
                before(raw)
            # Whoever held it up is not made to catch up.
            late = time.monotonic() - due
            if late > 0.05:
                origin = (origin[0] + late, origin[1])
            if self._clock is not None and raw.log_time >= clock + _CLOCK_PERIOD:
                clock = raw.log_time
                self._clock.publish(Clock(clock=time_message(clock)))
            self.publishers[raw.topic].publish(bytes(raw.data))
            self._stop_if_asked()
            count += 1
        return count


def play(
    bag: Path | str, settings: PlaySettings, progress: Callable[[Player], Callable[[], None]]
) -> int:
    """Publish a bag from a node of its own; return the number of messages.

    progress: gets the player, and gives back what to call at each message.
    """
    # Ctrl-C is ours, not ROS's: it then ends this like any other program.
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    try:
        with Player(Node("smallwheel_play"), bag, settings) as player, player.stop.listening():
            player.wait_for_listeners(2.0)
            step = progress(player)
            return player.play(lambda _: step())
    finally:
        rclpy.try_shutdown()
