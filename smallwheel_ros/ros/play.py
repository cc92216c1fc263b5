# SPDX-License-Identifier: Apache-2.0
"""Publish a bag over DDS, for people without rosbag2, and record what the node answers to it.

The node listens best effort, so nothing in DDS slows a fast player down. `drive_through` looks at
the answers: it holds back while too many sinkages are without one, and no message is lost.
"""

from __future__ import annotations

import math
import re
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from nav_msgs.msg import OccupancyGrid
from rclpy.duration import Duration
from rclpy.exceptions import InvalidTopicNameException
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from rclpy.signals import SignalHandlerOptions
from rclpy.validate_topic_name import validate_topic_name
from rosgraph_msgs.msg import Clock
from tqdm import tqdm

from smallwheel_ros.bags import BagReader, BagTopic, RawMessage
from smallwheel_ros.common.errors import SmallwheelError
from smallwheel_ros.common.stop import Stop
from smallwheel_ros.costmap.grid import Grid, grid_from
from smallwheel_ros.estimator.reading import SECOND
from smallwheel_ros.msg import MobilityEstimate, SoilEstimate, WheelSinkage
from smallwheel_ros.onboard.parameters import NODE_NAME
from smallwheel_ros.ros.outputs import message_class, nanoseconds_of, time_message
from smallwheel_ros.ros.parameters import LATCHED

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


class Player:
    """Publishes the messages of one bag in their order; use it in a `with` statement.

    It has a ROS and a node of its own for as long as that lasts. A bag of ROS 1 is converted on the way; a
    damaged one is played to where it ends.

    name: of the node. rate: times as fast as recorded. start: s after the bag's beginning. loop: again
    and again. clock: publish /clock from the times of recording, for nodes with use_sim_time. topics: type
    of each topic that is published. skipped: why a topic is not published, in words.

    Raises
    ------
    BagError
        If there is no bag, or it cannot be read.
    PlayError
        If there is nothing in it to publish, or it ends before the start.
    """

    def __init__(
        self,
        name: str,
        bag: Path | str,
        *,
        rate: float = 1.0,
        start: float = 0.0,
        loop: bool = False,
        clock: bool = True,
    ) -> None:
        self._name, self._bag, self._rate, self._loop = name, Path(bag), rate, loop
        self.stop = Stop()
        with BagReader(self._bag, salvage=True) as reader:
            recorded = {topic.name: topic for topic in reader.topics}
            self._channels = {t[:2]: reader.as_channel(*t[:2]) for t in reader.topics}
            self.message_count = reader.message_count
            begin = reader.start_time or 0
            duration = ((reader.end_time or 0) - begin) / SECOND
        if start > duration:
            raise PlayError(
                f"start is {start:g} s, expected at most {duration:.3f} s: bag {self._bag} is no longer"
            )
        self._begin = begin + round(start * SECOND)
        reasons = {name: _why_not(topic) for name, topic in recorded.items()}
        self.skipped = {name: why for name, why in reasons.items() if why}
        self.topics = {name: recorded[name].type for name, why in reasons.items() if not why}
        if not self.topics:
            why = "; ".join(f"{name}: {words}" for name, words in self.skipped.items())
            raise PlayError(f"bag {self._bag} has no message that can be played here ({why})")
        self._wanted = {
            name: (message_class(kind), _quality(recorded[name]))
            for name, kind in self.topics.items()
        }
        self._ticks = clock and _CLOCK not in self.topics
        if self._ticks:
            self._wanted[_CLOCK] = (Clock, _RELIABLE)

    def __enter__(self) -> Player:
        # Ctrl-C ends it like any other program.
        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
        try:
            self.node = Node(self._name)
            self._publishers = {
                topic: self.node.create_publisher(kind, topic, quality)
                for topic, (kind, quality) in self._wanted.items()
            }
        except BaseException:
            rclpy.try_shutdown()
            raise
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.node)
        return self

    def __exit__(self, *_: object) -> None:
        self._executor.shutdown()
        self.node.destroy_node()  # left to the garbage collector, it stays on the network for as long
        rclpy.try_shutdown()

    def spin(self, seconds: float) -> None:
        """Let the node's callbacks run for at most so long. Raises KeyboardInterrupt if asked to stop."""
        self._executor.spin_once(timeout_sec=max(seconds, 0.0))
        self._stop_if_asked()

    def _stop_if_asked(self) -> None:
        # Not from the signal's handler: raised inside of a callback or a destructor it would be lost.
        if self.stop.asked:
            raise KeyboardInterrupt

    def unheard(self) -> list[str]:
        """Topics that nobody listens to."""
        return [name for name in self.topics if not self._publishers[name].get_subscription_count()]

    def wait_for_listeners(self, limit: float) -> None:
        """Wait for listeners, at most `limit` s.

        Until every topic is heard, or some are and 2 s have passed since the last listener came or
        left: nobody here needs the others, as far as can be known.
        """
        deadline = time.monotonic() + limit
        count, changed = 0, 0.0
        while True:
            # Who listens to our clock need not listen to the bag, but is to have the clock's beginning.
            listeners = [p.get_subscription_count() for p in self._publishers.values()]
            if sum(listeners) != count:
                count, changed = sum(listeners), time.monotonic()
            unheard = self.unheard()
            begin = changed + (_QUIET if unheard else _MUTUAL)
            if len(unheard) == len(self.topics):
                begin = math.inf
            if time.monotonic() >= min(begin, deadline):
                return
            self.spin(0.05)

    def nobody_listens(self) -> str:
        """Say which topics have no listener, and to which of them somebody subscribes in vain."""
        unheard = self.unheard()
        vain = [name for name in unheard if self.node.count_subscribers(name) > 0]
        lonely = [name for name in unheard if name not in vain]
        said = []
        if vain:
            words = "subscribed to with another type or quality of service, and not heard"
            said.append(f"{words}: {', '.join(vain)}")
        if len(lonely) == len(self.topics):
            said.append("nobody listens to any topic: played all the same")
        elif lonely:
            said.append(f"nobody listens to {', '.join(lonely)}")
        return "; ".join(said)

    def wait_for_confirmation(self) -> list[str]:
        """Wait until the listeners have what was published; name the topics that they lack.

        Those of best effort confirm nothing, and are not waited for.
        """
        deadline, lacking = time.monotonic() + CONFIRM, []
        for name, publisher in self._publishers.items():
            left = Duration(seconds=max(deadline - time.monotonic(), 0.0))
            if not publisher.wait_for_all_acked(left):
                lacking.append(name)
        return lacking

    def _messages(self) -> Iterator[RawMessage]:
        """Give the bag's messages that can be published, over and over when it loops."""
        while True:
            with BagReader(self._bag, salvage=True) as reader:
                for raw in reader.raw_messages(list(self.topics)):
                    if raw.log_time < self._begin:
                        continue
                    channel = self._channels[raw.topic, raw.type]
                    try:
                        data = raw.data if channel is None else channel[1](raw.data)
                    except Exception as error:  # damaged bytes make rosbags raise as it likes
                        words = f"topic {raw.topic}: a message is damaged ({error})"
                        raise PlayError(words) from error
                    yield raw._replace(data=bytes(data))
            if not self._loop:
                return

    def play(self) -> Iterator[RawMessage]:
        """Publish everything at its time; give each message before it is published.

        Who takes them may take their time, and the rest is then later.
        """
        clock = 0
        origin: tuple[float, int] | None = None  # wall time and log time that belong together
        for raw in self._messages():
            now = time.monotonic()
            if origin is None or raw.log_time < clock - _CLOCK_PERIOD:  # the beginning, a loop
                origin, clock = (now, raw.log_time), 0
            due = origin[0] + (raw.log_time - origin[1]) / SECOND / self._rate
            while (now := time.monotonic()) < due:
                self.spin(min(due - now, 0.05))
            yield raw
            # Whoever held it up is not made to catch up.
            late = time.monotonic() - due
            if late > 0.05:
                origin = (origin[0] + late, origin[1])
            if self._ticks and raw.log_time >= clock + _CLOCK_PERIOD:
                clock = raw.log_time
                self._publishers[_CLOCK].publish(Clock(clock=time_message(clock)))
            self._publishers[raw.topic].publish(raw.data)
            self._stop_if_asked()


def _why_not(topic: BagTopic) -> str:
    """Why a topic cannot be published; empty: it can."""
    if message_class(topic.type) is None:
        return f"its type {topic.type} is not installed here"
    try:
        validate_topic_name(topic.name)
    except InvalidTopicNameException:
        return "ROS 2 allows no topic of that name"
    return ""


def _quality(topic: BagTopic) -> QoSProfile:
    """How a topic is offered. One that was recorded as latched: who listens late gets its last messages."""
    latched = any(profile.durability.name == "TRANSIENT_LOCAL" for profile in topic.qos)
    return _KEPT if latched else _RELIABLE


# --- The node's answers

_MOST_UNANSWERED = 20
_FURTHEST_BEHIND = SECOND // 2
# s without an answer. Python and ROS start within seconds, but take half a minute where ten programs
# compete for two processors; a node that has died is not waited for.
_PATIENCE = 120.0
_LAST = 6.0  # s without an answer at the end: a sinkage that the node refused gets none
_SINKAGE = "smallwheel_ros/msg/WheelSinkage"
_EVERYTHING = QoSProfile(depth=1000, reliability=ReliabilityPolicy.RELIABLE)


class DriveThroughError(SmallwheelError):
    """The node did not answer."""


@dataclass
class Recording:
    """What the node published."""

    # One row per message: its fields, with `stamp` (ns) and `frame_id` of the header.
    mobility: list[dict[str, Any]] = field(default_factory=list)
    soil: list[dict[str, Any]] = field(default_factory=list)
    # Message of the newest entry of each name.
    diagnostics: dict[str, str] = field(default_factory=dict)
    # Stamp (ns) of the newest estimate, and message, of each alarm in the diagnostics.
    warnings: list[tuple[int, str]] = field(default_factory=list)
    cost: Grid | None = None  # the newest of the cost map
    published: int = 0  # messages that were played
    sinkages: int = 0  # how many of them were sinkages
    # s from each sinkage's publication to its answer, waiting for other topics included.
    latencies: list[float] = field(default_factory=list)

    @property
    def unanswered(self) -> int:
        """Sinkages that no mobility estimate has come for."""
        return self.sinkages - len(self.mobility)


def drive_through(
    bag: Path | str,
    *,
    rate: float = 1.0,
    seconds: float = math.inf,
    by_sinkage: bool = True,
    alive: Callable[[], str | None] = lambda: None,
) -> Recording:
    """Play a bag into the running node at most at this rate, and record its answers.

    Parameters
    ----------
    seconds
        Of the bag that are played.
    by_sinkage
        Whether the node listens to sinkages, and answers each; else it answers when it likes, and must
        not fall behind by more than half a second of the bag.
    alive
        Says why the node is dead, None while it lives.

    Raises
    ------
    DriveThroughError
        If the node does not listen, dies, or does not answer.
    BagError
        If the bag cannot be read.
    """
    if rclpy.ok():
        raise DriveThroughError("rclpy is running in this process already: shut it down first")
    with Player("smallwheel_drive_through", bag, rate=rate) as player:
        return _Recorder(player, alive, by_sinkage).record(seconds)


class _Recorder:
    """Records what the node publishes, and waits for it."""

    def __init__(self, player: Player, alive: Callable[[], str | None], by_sinkage: bool) -> None:
        self._player, self._alive, self._by_sinkage = player, alive, by_sinkage
        self._found = Recording()
        self._sent: dict[int, float] = {}  # time.monotonic() of sinkages, by their stamps
        self._diagnosed = 0  # messages of diagnostics
        for kind, topic, callback, quality in (
            (MobilityEstimate, f"/{NODE_NAME}/mobility", self._on_mobility, _EVERYTHING),
            (SoilEstimate, f"/{NODE_NAME}/soil", self._on_soil, LATCHED),
            (OccupancyGrid, f"/{NODE_NAME}/cost", self._on_cost, LATCHED),
            (DiagnosticArray, "/diagnostics", self._on_diagnostics, 10),
        ):
            player.node.create_subscription(kind, topic, callback, quality)

    def record(self, seconds: float) -> Recording:
        """Play everything; wait for the node before it, for its answers meanwhile and after it."""
        found, player = self._found, self._player
        self._wait(lambda: not self._deaf(), lambda: f"nobody listens to {', '.join(self._deaf())}")
        # Topics that the node does not need may stay unheard.
        player.wait_for_listeners(_PATIENCE)
        # The node knows that we listen when its first soil has come, and that we publish when it misses
        # nobody who does: what a stranger sends is lost.
        self._wait(lambda: bool(found.soil), lambda: "it published no soil")
        self._wait(lambda: self._diagnosed > 0)
        self._wait(lambda: self._missed().isdisjoint(player.topics))

        def answered() -> bool:
            if self._by_sinkage or not found.mobility:
                return found.unanswered < _MOST_UNANSWERED
            return raw.log_time - int(found.mobility[-1]["stamp"]) < _FURTHEST_BEHIND

        def silent() -> str:
            return f"{len(found.mobility)} answers until then"

        end = math.inf
        total = player.message_count
        for raw in tqdm(player.play(), total=total, unit=" messages", disable=None, leave=False):
            end = min(end, raw.log_time + seconds * SECOND)
            if raw.log_time > end:
                break
            # The node may refuse a sinkage and give no answer: then it is not waited for for ever.
            self._wait(answered, silent if self._by_sinkage else None)
            if self._by_sinkage and raw.type == _SINKAGE:
                message = deserialize_message(raw.data, WheelSinkage)
                self._sent[nanoseconds_of(message.header.stamp)] = time.monotonic()
                found.sinkages += 1
            found.published += 1
            if found.published % 10 == 0:
                player.spin(0.0)
        self._wait(lambda: found.unanswered <= 0)
        # The last soil, and diagnostics that know of the last message, come by timers, the soil more
        # often; the first diagnostics may be under way already.
        until = self._diagnosed + 2
        self._wait(lambda: self._diagnosed >= until)
        return found

    def _wait(self, done: Callable[[], bool], failure: Callable[[], str] | None = None) -> None:
        """Spin until it is done; too long without an answer is an error where there are words for one."""
        limit = _PATIENCE if failure is not None else _LAST
        answers, newest = len(self._found.mobility), time.monotonic()
        while not done():
            dead = self._alive()
            if dead is not None:
                raise DriveThroughError(f"the node {NODE_NAME} has died: {dead}")
            if len(self._found.mobility) > answers:
                answers, newest = len(self._found.mobility), time.monotonic()
            if time.monotonic() - newest > limit:
                if failure is None:
                    return
                raise DriveThroughError(
                    f"the node {NODE_NAME} does not answer within {limit:.0f} s: {failure()}"
                )
            self._player.spin(0.02)

    def _deaf(self) -> list[str]:
        """Topics of sinkages that the node is to answer, and does not listen to."""
        unheard = self._player.unheard() if self._by_sinkage else ()
        return [name for name in unheard if self._player.topics[name] == _SINKAGE]

    def _missed(self) -> set[str]:
        """Topics of which the node says that nobody publishes them; it says so once a second."""
        inputs = self._found.diagnostics.get(f"{NODE_NAME}: inputs", "")
        return set(re.findall(r"waiting for (\S+) \([^)]*\): no publisher", inputs))

    def _on_mobility(self, message: Any) -> None:
        sent = self._sent.pop(nanoseconds_of(message.header.stamp), None)
        if sent is not None:
            self._found.latencies.append(time.monotonic() - sent)
        self._found.mobility.append(_row(message))

    def _on_soil(self, message: Any) -> None:
        self._found.soil.append(_row(message))

    def _on_diagnostics(self, message: Any) -> None:
        self._diagnosed += 1
        newest = self._found.mobility[-1]["stamp"] if self._found.mobility else 0
        for status in message.status:
            self._found.diagnostics[status.name] = status.message
            if status.name.endswith(": alarms") and status.level != DiagnosticStatus.OK:
                self._found.warnings.append((newest, status.message))

    def _on_cost(self, message: Any) -> None:
        self._found.cost = grid_from(message)


def _row(message: Any) -> dict[str, Any]:
    """Turn a message with a header into a flat row."""
    names = [name for name in message.get_fields_and_field_types() if name != "header"]
    header = {"stamp": nanoseconds_of(message.header.stamp), "frame_id": message.header.frame_id}
    return header | {name: getattr(message, name) for name in names}
