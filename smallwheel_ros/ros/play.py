# SPDX-License-Identifier: Apache-2.0
"""Play a bag over DDS into the running node, no faster than it answers, and record its answers.

The node subscribes with best effort, so that DDS does not slow down a fast player: this one waits while the
node's estimates lag far behind, so that no message is lost. `ros2 bag play` can do more, where it is
installed.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import ExitStack, suppress
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
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock

from smallwheel_ros.bags import BagReader
from smallwheel_ros.common.errors import SmallwheelError
from smallwheel_ros.common.stamps import SECOND
from smallwheel_ros.costmap.grid import Grid, grid_from
from smallwheel_ros.msg import MobilityEstimate, SoilEstimate, VehicleMobility
from smallwheel_ros.onboard.parameters import NODE_NAME
from smallwheel_ros.ros.conversions import message_class, nanoseconds_of, time_message
from smallwheel_ros.ros.parameters import LATCHED

_SINKAGE = "smallwheel_ros/msg/WheelSinkage"
_MOBILITY = "smallwheel_ros/msg/MobilityEstimate"
_PATIENCE = (
    120.0  # s without an answer: Python and ROS may take half of it to start on a busy machine
)
_LAST = 6.0  # s without an answer at the end: a sinkage that the node refused gets none
# ns of recorded time that the node may lag: longer than it waits for a silent stream, and with fewer messages
# than its queues hold.
_FURTHEST_BEHIND = 18 * 10**8
_CLOCK_PERIOD = 10**7  # ns
_MUTUAL = 0.5  # s: a listener that is known here may need a moment to know of us
_RELIABLE = QoSProfile(depth=1000, reliability=ReliabilityPolicy.RELIABLE)


class PlayError(SmallwheelError):
    """A bag cannot be played, or the node does not answer."""


@dataclass
class PlayedRecording:
    """What the node published while a bag was played.

    Rows are dictionaries of a message's fields by name, with `stamp` (ns) and `frame_id` of its header.

    Attributes
    ----------
    mobility
        Rows of MobilityEstimate of all wheels, at the end sorted by stamp and wheel.
    vehicle, soil
        Rows of VehicleMobility and of SoilEstimate, in the order of arrival.
    warnings
        Text of each alarm in each message of diagnostics, with the stamp (ns) of the newest estimate then.
    cost
        The newest grid of costs; None before the first.
    published
        Number of messages played.
    sinkages
        Number of sinkages played.
    sent
        Times at which unanswered sinkages were played (time.monotonic(), s), by their stamps (ns).
    latencies
        Time from each sinkage to its estimate, s.
    diagnostics
        The newest text of each entry of the diagnostics, by its name.
    diagnosed
        Number of messages of diagnostics.
    """

    mobility: list[dict[str, Any]] = field(default_factory=list)
    vehicle: list[dict[str, Any]] = field(default_factory=list)
    soil: list[dict[str, Any]] = field(default_factory=list)
    warnings: list[tuple[int, str]] = field(default_factory=list)
    cost: Grid | None = None
    published: int = 0
    sinkages: int = 0
    sent: dict[int, float] = field(default_factory=dict)
    latencies: list[float] = field(default_factory=list)

    diagnostics: dict[str, str] = field(default_factory=dict)  # the newest text of each entry
    diagnosed: int = 0  # messages of diagnostics

    @property
    def unanswered(self) -> int:
        """Number of sinkages without an estimate so far."""
        return self.sinkages - len(self.mobility)

    def on_mobility(self, message: Any) -> None:
        """Record a MobilityEstimate, and its latency."""
        self.mobility.append(_row(message))
        sent = self.sent.pop(self.mobility[-1]["stamp"], None)
        if sent is not None:
            self.latencies.append(time.monotonic() - sent)

    def on_vehicle(self, message: Any) -> None:
        """Record a VehicleMobility."""
        self.vehicle.append(_row(message))

    def on_soil(self, message: Any) -> None:
        """Record a SoilEstimate."""
        self.soil.append(_row(message))

    def on_diagnostics(self, message: Any) -> None:
        """Record the text of each entry, and the alarms."""
        self.diagnosed += 1
        self.diagnostics |= {status.name: status.message for status in message.status}
        newest = self.mobility[-1]["stamp"] if self.mobility else 0
        self.warnings += [
            (newest, status.message)
            for status in message.status
            if status.name.endswith(": alarms") and status.level != DiagnosticStatus.OK
        ]

    def on_cost(self, message: Any) -> None:
        """Record the newest grid."""
        self.cost = grid_from(message)


def drive_through(
    bag: Path | str, *, rate: float = 1.0, alive: Callable[[], str | None] = lambda: None
) -> PlayedRecording:
    """Play a bag into the running node, and record what it publishes until it has answered everything.

    Parameters
    ----------
    bag
        Path of the bag.
    rate
        Largest factor on the recorded speed, 1; play is slower where the node does not keep up.
    alive
        Returns how the node has ended, in words, or None while it runs.

    Returns
    -------
    PlayedRecording
        What the node published.

    Raises
    ------
    PlayError
        If the node does not listen, dies or does not answer.
    BagError
        If the bag cannot be read.
    """
    if rclpy.ok():
        raise PlayError("rclpy is running in this process already: shut it down first")
    with _Player(Path(bag), alive) as player:
        return player.play_and_listen(rate)


class _Player:
    """A ROS node that publishes a bag, and records in `found` what the estimator publishes."""

    def __init__(self, bag: Path, alive: Callable[[], str | None]) -> None:
        self._bag, self._alive, self.found = bag, alive, PlayedRecording()
        self._in_vain = (
            -1
        )  # answers there were when it was waited for another one that did not come

    def __enter__(self) -> _Player:
        with ExitStack() as stack:
            self._open(stack)
            self._stack = stack.pop_all()
        return self

    def _open(self, stack: ExitStack) -> None:
        """Open the bag, and create the ROS node with its publishers; `stack` closes them."""
        self._reader = stack.enter_context(BagReader(self._bag))
        rclpy.init(args=[])
        stack.callback(rclpy.try_shutdown)
        self._node = Node("smallwheel_player")
        stack.callback(self._node.destroy_node)
        self._executor = SingleThreadedExecutor()
        stack.callback(self._executor.shutdown)
        self._executor.add_node(self._node)
        self._ticks = self._node.create_publisher(Clock, "/clock", _RELIABLE)
        topics = [topic for topic in self._reader.topics if topic.name != "/clock"]
        self._channels = {topic[:2]: self._reader.channel(*topic[:2]) for topic in topics}
        self._publishers = {}
        for topic in topics:
            kind = message_class(topic.type)
            with suppress(InvalidTopicNameException):  # ROS 1 has names that ROS 2 has not
                if kind is not None:
                    publisher = self._node.create_publisher(kind, topic.name, _RELIABLE)
                    self._publishers[topic.name] = publisher
        self._wheels = [topic.name for topic in topics if topic.type == _SINKAGE]

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def play_and_listen(self, rate: float) -> PlayedRecording:
        """Wait for the node, play the whole bag no faster than it answers, and wait for its last answers.

        rate: largest factor on the recorded speed.
        """
        found, node = self.found, self._node
        for kind, topic, callback, quality in (
            (VehicleMobility, "vehicle", found.on_vehicle, _RELIABLE),
            (SoilEstimate, "soil", found.on_soil, LATCHED),
            (OccupancyGrid, "cost", found.on_cost, LATCHED),
        ):
            node.create_subscription(kind, f"/{NODE_NAME}/{topic}", callback, quality)
        node.create_subscription(DiagnosticArray, "/diagnostics", found.on_diagnostics, 10)
        self._wait(lambda: self.heard(*self._wheels), "it does not listen to the wheels' sinkages")
        self._wait(lambda: bool(found.soil), "it published no soil")
        self._wait(lambda: found.diagnosed > 0)
        self._wait(lambda: bool(self._of_wheels()), "it has no topic of a wheel")
        for topic in self._of_wheels():
            node.create_subscription(MobilityEstimate, topic, found.on_mobility, _RELIABLE)
        self.play(rate, self._hold_back)
        self._wait(lambda: found.unanswered <= 0)
        until = found.diagnosed + 2  # the first may be under way already
        self._wait(lambda: found.diagnosed >= until)
        found.mobility.sort(key=lambda row: (row["stamp"], row["wheel"]))  # wheels have own topics
        return found

    def _of_wheels(self) -> list[str]:
        """Topics on which the estimator publishes estimates of wheels."""
        own = (
            self._node.get_publisher_names_and_types_by_node(NODE_NAME, "/") if self._known else []
        )
        return sorted(name for name, types in own if _MOBILITY in types)

    @property
    def _known(self) -> bool:
        return NODE_NAME in self._node.get_node_names()

    def _hold_back(self, now: int) -> None:
        """Wait while the node lags too far behind a recording time (`now`, ns).

        If a wait is in vain there is no other until the node has answered again.
        """
        found = self.found

        def follows() -> bool:
            newest = found.mobility[-1]["stamp"] if found.mobility else self._reader.start_time or 0
            return now - int(newest) < _FURTHEST_BEHIND

        if follows() or self._in_vain == len(found.mobility):
            return
        words = f"{len(found.mobility)} answers until then" if self._wheels else ""
        self._wait(follows, words)
        self._in_vain = -1 if follows() else len(found.mobility)

    @property
    def topics(self) -> list[str]:
        """Names of the topics that are published."""
        return list(self._publishers)

    @property
    def hole(self) -> str:
        """How a gap of years in the recording times was bridged, in words; empty if there is none."""
        return self._reader.hole

    def heard(self, *names: str) -> bool:
        """Return whether each of these topics has a subscriber."""
        return all(self._publishers[name].get_subscription_count() for name in names)

    def play(self, rate: float, hold_back: Callable[[int], object] = lambda _: None) -> int:
        """Publish all messages of the bag at their times.

        Parameters
        ----------
        rate
            Largest factor on the recorded speed, 1.
        hold_back
            Called before each message with its recording time, ns; it returns when the message may be sent.

        Returns
        -------
        int
            Number of messages published.
        """
        self.spin_until(time.monotonic() + _MUTUAL)
        begin, clock, started = self._reader.start_time or 0, 0, time.monotonic()
        for raw in self._reader.raw_messages(list(self._publishers)):
            due = started + (raw.log_time - begin) / 1e9 / rate
            self.spin_until(due)
            hold_back(raw.log_time)
            started += max(time.monotonic() - due - 0.05, 0.0)  # a slow start is not made up for
            if raw.log_time >= clock + _CLOCK_PERIOD:
                clock = raw.log_time
                self._ticks.publish(Clock(clock=time_message(clock)))
            channel = self._channels[raw.topic, raw.type]
            data = raw.data if channel is None else bytes(channel.convert(raw.data))
            if raw.type == _SINKAGE:
                self.found.sent[_stamp_of(data)] = time.monotonic()
                self.found.sinkages += 1
            self._publishers[raw.topic].publish(data)
            self.found.published += 1
            if self.found.published % 10 == 0:
                self._executor.spin_once(timeout_sec=0.0)
        for publisher in self._publishers.values():
            publisher.wait_for_all_acked(Duration(seconds=5.0))
        return self.found.published

    def spin_until(self, due: float) -> None:
        """Let callbacks run until a time (by time.monotonic(), s)."""
        while (left := due - time.monotonic()) > 0.0:
            self._executor.spin_once(timeout_sec=min(left, 0.05))

    def _wait(self, done: Callable[[], bool], failure: str = "") -> None:
        """Let callbacks run until `done`, or until the node has not answered for too long.

        Raises PlayError with the words of `failure` in the latter case, unless they are empty, and if the
        node has ended.
        """
        count, since = len(self.found.mobility), time.monotonic()
        while not done():
            self._executor.spin_once(timeout_sec=0.02)
            if (dead := self._alive()) is not None:
                raise PlayError(f"the node {NODE_NAME} has died: {dead}")
            if len(self.found.mobility) > count:
                count, since = len(self.found.mobility), time.monotonic()
            elif time.monotonic() - since > (_PATIENCE if failure else _LAST):
                if not failure:
                    return
                raise PlayError(f"the node {NODE_NAME} does not answer: {failure}")


def play_bag(bag: Path, rate: float, wait: float) -> tuple[int, str]:
    """Publish a bag without waiting for answers, as soon as all of its topics have subscribers.

    Parameters
    ----------
    bag
        Path of the bag.
    rate
        Factor on the recorded speed, 1.
    wait
        Time after which it is published even without subscribers, s.

    Returns
    -------
    count : int
        Number of messages published.
    hole : str
        How a gap of years in the recording times was bridged, in words; empty if there is none.
    """
    with _Player(bag, lambda: None) as player:
        limit = time.monotonic() + wait
        while time.monotonic() < limit and not player.heard(*player.topics):
            player.spin_until(time.monotonic() + 0.1)
        return player.play(rate), player.hole


def _stamp_of(data: bytes) -> int:
    """Stamp (ns) of a serialised message (little-endian CDR) that begins with a header."""
    second = int.from_bytes(data[4:8], "little", signed=True)
    return second * SECOND + int.from_bytes(data[8:12], "little")


def _row(message: Any) -> dict[str, Any]:
    """Turn a message with a header into a flat row."""
    names = [name for name in message.get_fields_and_field_types() if name != "header"]
    header = {"stamp": nanoseconds_of(message.header.stamp), "frame_id": message.header.frame_id}
    return header | {name: getattr(message, name) for name in names}
