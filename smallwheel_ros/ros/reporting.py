"""What the node knows of its inputs: throttled log lines, rates, topics still waited for."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from rclpy.node import Node
from rclpy.qos import QoSCompatibility, qos_check_compatible

from smallwheel_ros.onboard.feed import Topic
from smallwheel_ros.onboard.onboard import Onboard
from smallwheel_ros.onboard.problems import Problem
from smallwheel_ros.onboard.streams import SECOND
from smallwheel_ros.ros.qos import INPUT

_REPEAT_AFTER = 10.0  # s: the same problem of the same topic is said again
_SILENT_AFTER = 2.0  # s without a message of a topic that had some


@dataclass(frozen=True)
class Input:
    """A topic that the node listens to, for one stream of the estimate."""

    stream: str
    topic: str
    type: str
    detail: str = ""  # which part of the message, in words


def inputs_of(node: Node, topics: Iterable[Topic]) -> Iterator[Input]:
    """Say by which topic each stream of the estimate comes."""
    for topic in topics:
        for stream, detail in topic.streams.items():
            yield Input(stream, node.resolve_topic_name(topic.name), topic.type, detail)


class Throttle:
    """Lets a key pass once in a while, and counts what it held back."""

    def __init__(self, interval: float = _REPEAT_AFTER) -> None:
        self._interval = interval
        self._passed: dict[object, tuple[float, int]] = {}

    def passes(self, key: object) -> int | None:
        """Return how many of that key were held back since the last that passed; None: held."""
        now = time.monotonic()
        last, held = self._passed.get(key, (-self._interval, 0))
        if now - last < self._interval:
            self._passed[key] = (last, held + 1)
            return None
        self._passed[key] = (now, 0)
        return held


class Reporter:
    """Knows by which topic each stream comes, and what to say of it."""

    def __init__(self, node: Node, inputs: Iterable[Input]) -> None:
        self._node = node
        self.inputs = {item.stream: item for item in inputs}
        self._throttle = Throttle()
        self._seen: dict[str, tuple[float, int]] = {}  # monotonic time, count
        self._rates: dict[str, float] = {}
        self._measured_at = time.monotonic()

    def log_problems(self, problems: Iterable[Problem]) -> None:
        """Log problems by topic, each kind once in 10 s."""
        for problem in problems:
            held = self._throttle.passes((problem.stream, problem.reason))
            if held is None:
                continue
            item = self.inputs.get(problem.stream)
            topic = item.topic if item is not None else problem.stream
            more = f" ({held} more like this since)" if held else ""
            self._node.get_logger().warning(f"{topic}: {problem.text}{more}")

    def waiting_for(self, onboard: Onboard) -> list[str]:
        """Say of each topic that has not given a message yet, why that may be."""
        return [
            f"{item.topic} ({item.type}{item.detail}): {self._why(item)}"
            for item in self.inputs.values()
            if onboard.received[item.stream] == 0
        ]

    def _why(self, item: Input) -> str:
        publishers = self._node.get_publishers_info_by_topic(item.topic)
        if not publishers:
            return "no publisher"
        types = sorted({info.topic_type for info in publishers})
        if item.type not in types:
            return f"its publisher has another type, {', '.join(types)}"
        for info in publishers:
            compatibility, reason = qos_check_compatible(info.qos_profile, INPUT)
            if compatibility == QoSCompatibility.ERROR:
                return f"its publisher has incompatible QoS: {reason}"
        count = len(publishers)
        return f"{count} publisher{'s' if count > 1 else ''}, nothing received yet"

    def measure(self, onboard: Onboard) -> None:
        """Note how many messages came since the last call: their rates."""
        now = time.monotonic()
        elapsed = max(now - self._measured_at, 1e-6)
        self._measured_at = now
        for stream in self.inputs:
            count = onboard.received[stream]
            last, before = self._seen.get(stream, (now, 0))
            self._rates[stream] = (count - before) / elapsed
            self._seen[stream] = (now if count > before else last, count)

    def silent(self) -> list[str]:
        """Say of each topic that had messages, that it has none any more."""
        now = time.monotonic()
        return [
            f"{item.topic}: no message for {now - last:.0f} s"
            for stream, item in self.inputs.items()
            for last, count in (self._seen.get(stream, (now, 0)),)
            if count and now - last > _SILENT_AFTER
        ]

    def flow(self, onboard: Onboard, stream: str) -> str:
        """How a stream comes in: rate, count, age of the newest good stamp."""
        text = f"{self._rates.get(stream, 0.0):.1f} Hz, {onboard.received[stream]} received"
        newest = onboard.newest.get(stream)
        if newest is None:
            return text
        age = (self._node.get_clock().now().nanoseconds - newest) / SECOND
        return f"{text}, newest stamp {age:.2f} s ago"

    def refused(self, onboard: Onboard) -> dict[str, int]:
        """How many messages could not be used, by topic and reason."""
        found: dict[str, int] = {}
        for (stream, reason), count in sorted(onboard.counts.items()):
            item = self.inputs.get(stream)
            topic = item.topic if item else stream
            found[f"{topic}: {reason}"] = count
        return found
