# SPDX-License-Identifier: Apache-2.0
"""Play a bag into the node over DDS and record what it answers, without losing a message.

The node listens best effort, so nothing in DDS slows a fast player down. Here the player looks at
the answers: it holds back while too many sinkages are without one.
"""

from __future__ import annotations

import math
import re
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from nav_msgs.msg import OccupancyGrid
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message

from smallwheel_ros.common.errors import SmallwheelError
from smallwheel_ros.costmap.grid import Grid
from smallwheel_ros.msg import MobilityEstimate, SoilEstimate, WheelSinkage
from smallwheel_ros.onboard.parameters import NODE_NAME
from smallwheel_ros.onboard.streams import SECOND
from smallwheel_ros.ros import qos
from smallwheel_ros.ros.conversions import grid_from, nanoseconds_of
from smallwheel_ros.ros.play import Player, PlaySettings, own_node

_MOST_UNANSWERED = 20
_FURTHEST_BEHIND = SECOND // 2
# s without an answer. Python and ROS start within seconds, but take half a minute where ten programs
# compete for two processors; a node that has died is not waited for.
_PATIENCE = 120.0
_LAST = 6.0  # s without an answer at the end: a sinkage that the node refused gets none
_SINKAGE = "smallwheel_ros/msg/WheelSinkage"
_ALARMS = ": alarms"  # end of the name of their entry in the diagnostics
_EVERYTHING = QoSProfile(depth=1000, reliability=ReliabilityPolicy.RELIABLE)


class DriveThroughError(SmallwheelError):
    """The node did not answer."""


@dataclass
class Recording:
    """What the node published.

    Attributes
    ----------
    mobility, soil
        One row per message: its fields, with `stamp` (ns) and `frame_id` of the header.
    diagnostics
        Message of the newest entry of each name.
    warnings
        Stamp (ns) of the newest estimate, and message, of each alarm in the diagnostics.
    cost
        Newest grid of the cost map.
    published, sinkages
        Messages that were played, and how many of them were sinkages.
    latencies
        s from each sinkage's publication to its answer, waiting for other topics included.
    """

    mobility: list[dict[str, Any]] = field(default_factory=list)
    soil: list[dict[str, Any]] = field(default_factory=list)
    diagnostics: dict[str, str] = field(default_factory=dict)
    warnings: list[tuple[int, str]] = field(default_factory=list)
    cost: Grid | None = None
    published: int = 0
    sinkages: int = 0
    latencies: list[float] = field(default_factory=list)

    @property
    def unanswered(self) -> int:
        """Sinkages that no mobility estimate has come for."""
        return self.sinkages - len(self.mobility)


def row(message: Any) -> dict[str, Any]:
    """Turn a message with a header into a flat row."""
    fields = {"stamp": nanoseconds_of(message.header.stamp), "frame_id": message.header.frame_id}
    for name in message.get_fields_and_field_types():
        if name != "header":
            fields[name] = getattr(message, name)
    return fields


def drive_through(
    bag: Path | str,
    *,
    rate: float = 1.0,
    seconds: float = math.inf,
    by_sinkage: bool = True,
    alive: Callable[[], str | None] = lambda: None,
    progress: Callable[[], object] = lambda: None,
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
    progress
        Called for each message.

    Raises
    ------
    DriveThroughError
        If the node does not listen, dies, or does not answer.
    BagError
        If the bag cannot be read.
    """
    if rclpy.ok():
        raise DriveThroughError("rclpy is running in this process already: shut it down first")
    with own_node("smallwheel_drive_through") as node:
        recorder = _Recorder(node, alive, by_sinkage)
        with Player(node, bag, PlaySettings(rate=rate)) as player:
            recorder.record(player, seconds, progress)
        return recorder.recording


class _Recorder:
    """Records what the node publishes, and waits for it."""

    def __init__(self, node: Node, alive: Callable[[], str | None], by_sinkage: bool) -> None:
        self._alive, self._by_sinkage = alive, by_sinkage
        self.recording = Recording()
        self._sent: dict[int, float] = {}
        self._diagnosed = 0  # messages of diagnostics
        own = f"/{NODE_NAME}"
        node.create_subscription(
            MobilityEstimate, f"{own}/mobility", self._on_mobility, _EVERYTHING
        )
        node.create_subscription(SoilEstimate, f"{own}/soil", self._on_soil, qos.LATCHED)
        node.create_subscription(OccupancyGrid, f"{own}/cost", self._on_cost, qos.LATCHED)
        node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)

    def record(self, player: Player, seconds: float, progress: Callable[[], object]) -> None:
        """Play everything; wait for the node before it, for its answers meanwhile and after it."""
        found = self.recording

        def deaf() -> list[str]:
            unheard = player.unheard() if self._by_sinkage else ()
            return [name for name in unheard if player.topics[name] == _SINKAGE]

        def answered() -> bool:
            if self._by_sinkage or not found.mobility:
                return found.unanswered < _MOST_UNANSWERED
            return now - int(found.mobility[-1]["stamp"]) < _FURTHEST_BEHIND

        self._wait(player, lambda: not deaf(), lambda: f"nobody listens to {', '.join(deaf())}")
        # Topics that the node does not need may stay unheard.
        player.wait_for_listeners(_PATIENCE)
        # The node knows that we listen when its first soil has come, and that we publish when it misses
        # nobody who does: what a stranger sends is lost.
        self._wait(player, lambda: bool(found.soil), lambda: "it published no soil")
        self._wait(player, lambda: self._diagnosed > 0, None)
        self._wait(player, lambda: self._missed().isdisjoint(player.topics), None)

        def silent() -> str:
            return f"{len(found.mobility)} answers until then"

        begin, now = -1, 0
        for raw in player.play():
            now = raw.log_time
            begin = now if begin < 0 else begin
            if now - begin > seconds * SECOND:
                break
            # The node may refuse a sinkage and give no answer: then it is not waited for for ever.
            self._wait(player, answered, silent if self._by_sinkage else None)
            if self._by_sinkage and raw.type == _SINKAGE:
                message = deserialize_message(bytes(raw.data), WheelSinkage)
                self._sent[nanoseconds_of(message.header.stamp)] = time.monotonic()
                found.sinkages += 1
            found.published += 1
            progress()
            if found.published % 10 == 0:
                player.spin(0.0)
        self._wait(player, lambda: found.unanswered <= 0, None)
        # The last soil, and diagnostics that know of the last message, come by timers, the soil more
        # often; the first diagnostics may be under way already.
        until = self._diagnosed + 2
        self._wait(player, lambda: self._diagnosed >= until, None)

    def _wait(
        self, player: Player, done: Callable[[], bool], failure: Callable[[], str] | None
    ) -> None:
        """Spin until it is done; too long without an answer is an error where there are words for one."""
        limit = _PATIENCE if failure is not None else _LAST
        answers, newest = len(self.recording.mobility), time.monotonic()
        while not done():
            dead = self._alive()
            if dead is not None:
                raise DriveThroughError(f"the node {NODE_NAME} has died: {dead}")
            if len(self.recording.mobility) > answers:
                answers, newest = len(self.recording.mobility), time.monotonic()
            if time.monotonic() - newest > limit:
                if failure is None:
                    return
                raise DriveThroughError(
                    f"the node {NODE_NAME} does not answer within {limit:.0f} s: {failure()}"
                )
            player.spin(0.02)

    def _missed(self) -> set[str]:
        """Topics of which the node says that nobody publishes them; it says so once a second."""
        inputs = self.recording.diagnostics.get(f"{NODE_NAME}: inputs", "")
        return set(re.findall(r"waiting for (\S+) \([^)]*\): no publisher", inputs))

    def _on_mobility(self, message: Any) -> None:
        sent = self._sent.pop(nanoseconds_of(message.header.stamp), None)
        if sent is not None:
            self.recording.latencies.append(time.monotonic() - sent)
        self.recording.mobility.append(row(message))

    def _on_soil(self, message: Any) -> None:
        self.recording.soil.append(row(message))

    def _on_diagnostics(self, message: Any) -> None:
        self._diagnosed += 1
        newest = self.recording.mobility[-1]["stamp"] if self.recording.mobility else 0
        for status in message.status:
            self.recording.diagnostics[status.name] = status.message
            if status.name.endswith(_ALARMS) and status.level != DiagnosticStatus.OK:
                self.recording.warnings.append((newest, status.message))

    def _on_cost(self, message: Any) -> None:
        self.recording.cost = grid_from(message)
