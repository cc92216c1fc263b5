# SPDX-License-Identifier: Apache-2.0
"""The node's subscriptions: messages wait in the middleware until the node's timer takes them."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from operator import itemgetter
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from nav_msgs.msg import OccupancyGrid
from rclpy.callback_groups import CallbackGroup
from rclpy.node import Node
from rclpy.qos import QoSCompatibility, QoSProfile, qos_check_compatible
from rclpy.subscription import Subscription

from smallwheel_ros.bags.types import typestore
from smallwheel_ros.common.stamps import SECOND
from smallwheel_ros.drive.feed import Message, feed
from smallwheel_ros.drive.ground_ahead import ELEVATION
from smallwheel_ros.onboard.settings import NodeSettings, OnboardSettings
from smallwheel_ros.physics.conditions import ROLLING
from smallwheel_ros.pipeline.intake.decoder import Decoder, frame_of
from smallwheel_ros.pipeline.intake.inputs import Topic, topics_of
from smallwheel_ros.pipeline.pipeline import Pipeline
from smallwheel_ros.pipeline.refused import Refusal
from smallwheel_ros.ros.conversions import message_class
from smallwheel_ros.ros.diagnostics import OK, WARN, status
from smallwheel_ros.ros.parameters import (
    INPUT,
    LATCHED,
    NEWEST,
    NO_SUBSCRIPTION_EVENTS,
    STATIC_TRANSFORMS,
)

try:
    from tf2_msgs.msg import TFMessage
except ImportError:  # no package of PyPI; ROS installations have it
    TFMessage = None

_REPEAT_AFTER = 10.0  # s: the same problem of the same topic is reported again
_SILENT_AFTER = 2.0  # s without a message of a topic that had some
# What a stream measures; those of a wheel are `<wheel>/load` and so on.
_MEASURED = {
    "wheel_speed": "wheel speed",
    "steering": "steering angle",
    "drawbar_pull": "drawbar pull",
    "odom": "odometry",
    "velocity": "velocity over ground",
    "imu": "slope",
}


@dataclass
class _Listened:
    """Topic and type that a stream is read from, messages counted so far, and arrival of the newest one."""

    topic: str
    type: str
    detail: str  # which part of the message, in words
    count: int
    last: float  # time.monotonic()


class _ReadAtTurns(CallbackGroup):  # type: ignore[misc]  # rclpy has no types
    """Callback group of subscriptions that the node's timer reads; the executor never wakes for them.

    Serving a message by the executor costs ten times as much as taking it: at 2,800 a second, 0.3 of a
    processor.
    """

    def can_execute(self, entity: object) -> bool:
        """Return False: the executor does not serve these subscriptions."""
        return False

    def beginning_execution(self, entity: object) -> bool:
        """Return False: the executor does not serve these subscriptions."""
        return False

    def ending_execution(self, entity: object) -> None:
        """Do nothing, as nothing was begun."""


def _never(_: bytes) -> None:
    """Callback of a subscription that the executor does not serve; it is never called."""


class Inputs:
    """A node's subscriptions and their state.

    Parameters
    ----------
    node
        The node.
    settings
        Its settings.
    pipeline
        Its pipeline, to whose streams messages are given.

    Attributes
    ----------
    arrived
        When the newest message arrived, by time.monotonic(), s.
    """

    def __init__(self, node: Node, settings: NodeSettings, pipeline: Pipeline) -> None:
        self._node, self._settings, self._pipeline = node, settings, pipeline
        self.arrived = now = time.monotonic()
        self._topics: dict[str, Topic] = {}
        self._listened: dict[str, _Listened] = {}
        for topic in topics_of(settings):
            name = node.resolve_topic_name(topic.name)
            self._topics[name] = topic
            for stream in topic.streams:
                detail = part_of_message(stream, settings)
                self._listened[stream] = _Listened(name, topic.type, detail, 0, now)
        self._decoders = {n: Decoder(typestore(), t.type) for n, t in self._topics.items()}
        self._read_at_turns = _ReadAtTurns()
        self._raw: dict[str, Subscription] = {}
        self._newest: dict[str, bytes] = {}  # message of each topic
        self._subscriptions: list[Subscription] = []
        self._said: dict[tuple[str, str], tuple[float, int]] = {}  # when, and how often since
        self._said_missing: set[tuple[str, str]] = set()
        self._all_here = False  # and said
        self._measured_at = now

    # --- Messages

    def listen(
        self,
        take_classes: Callable[[Any], None],
        take_transforms: Callable[[Any], None],
        take_static: Callable[[Any], None],
        take_elevation: Callable[[Any], None],
    ) -> None:
        """Subscribe to all topics; if one subscription fails, cancel the others and raise its error.

        Parameters
        ----------
        take_classes
            Called with each grid of terrain classes, if a topic for them is configured.
        take_transforms
            Called with each message of /tf and tf, if tf2_msgs is installed.
        take_static
            Called with each message of /tf_static and tf_static, if tf2_msgs is installed.
        take_elevation
            Called with each elevation map, if a topic for them is configured.
        """
        self.arrived = time.monotonic()

        def subscribe(
            kind: Any,
            topic: str,
            to: Callable[..., None],
            profile: QoSProfile = INPUT,
            **how: Any,
        ) -> None:
            """Subscribe to a topic; `to` is called with its messages, `how` goes to create_subscription."""
            self._subscriptions.append(
                self._node.create_subscription(
                    kind, topic, to, profile, event_callbacks=NO_SUBSCRIPTION_EVENTS, **how
                )
            )

        try:
            for name, topic in self._topics.items():
                how = {"raw": True, "callback_group": self._read_at_turns}
                subscribe(message_class(topic.type), name, _never, **how)
                self._raw[name] = self._subscriptions[-1]
            # A classifier's grids come as they are made, a map server's was there before us.
            if classes := self._settings.terrain_classes_topic:
                subscribe(OccupancyGrid, classes, take_classes)
                subscribe(OccupancyGrid, classes, take_classes, LATCHED)
            if elevations := self._settings.elevation_topic:
                subscribe(message_class(ELEVATION), elevations, take_elevation, NEWEST)
            if TFMessage is not None:
                # Nav2 below a namespace has its transforms there: its launch files make /tf tf.
                for name in {self._node.resolve_topic_name(name) for name in ("/tf", "tf")}:
                    subscribe(TFMessage, name, take_transforms)
                # A map -> odom that never changes is sent once, maybe before the node was there.
                for name in {
                    self._node.resolve_topic_name(name) for name in ("/tf_static", "tf_static")
                }:
                    subscribe(TFMessage, name, take_static, STATIC_TRANSFORMS)
        except Exception:
            self.stop()
            raise

    def stop(self) -> None:
        """Unsubscribe from all topics."""
        for subscription in self._subscriptions:
            self._node.destroy_subscription(subscription)
        self._subscriptions, self._raw = [], {}

    def take(self) -> bool:
        """Decode the messages that have arrived since the last call, and add them to the streams.

        They are processed in the order of arrival, after those of a simulated clock.

        Returns
        -------
        bool
            Whether there were any.
        """
        for clock in (s for s in self._node.subscriptions if s.topic_name == "/clock"):
            for message, _ in _queued(clock, raw=False):
                clock.callback(message)
        now = self._node.get_clock().now().nanoseconds
        came: list[tuple[int, Message]] = []  # with the time by the middleware's clock, ns
        for name, subscription in self._raw.items():
            for raw, info in _queued(subscription, raw=True):
                came.append((info["received_timestamp"], (name, raw, now)))
        chunk = [message for _, message in sorted(came, key=itemgetter(0))]
        if chunk:
            self.arrived = time.monotonic()
            self._newest.update((name, raw) for name, raw, _ in chunk)
            feed(self._pipeline, self._topics, self._decoders, chunk)
        return bool(chunk)

    def frame(self, topic: str) -> str:
        """Return the frame_id of the newest message of a topic; empty before the first."""
        raw = self._newest.get(self._node.resolve_topic_name(topic))
        return "" if raw is None else frame_of(raw)

    # --- Log and diagnostics

    def log(self, problems: Iterable[Refusal]) -> None:
        """Log problems by topic, each reason at most once in 10 s for a stream, and the same line once."""
        shared = set()
        for problem in problems:
            key, now = (problem.stream, problem.reason), time.monotonic()
            said, held = self._said.get(key, (-_REPEAT_AFTER, 0))
            if now - said < _REPEAT_AFTER:
                self._said[key] = (said, held + 1)
                continue
            self._said[key] = (now, 0)
            more = f" ({held} more like this since)" if held else ""
            line = f"{self._topic_of(problem.stream)}: {problem.text}{more}"
            if line not in shared:
                self._node.get_logger().warning(line)
            shared.add(line)

    def _topic_of(self, stream: str) -> str:
        found = self._listened.get(stream)
        return stream if found is None else found.topic

    def say_what_is_expected(self) -> None:
        """Log which inputs are expected, unless all have arrived before."""
        if not self._all_here:
            for line in input_lines(self._topics):
                self._node.get_logger().info(line)

    def say_when_all_are_here(self) -> None:
        """Log, once, that every input has arrived, and what is estimated from now on."""
        if self._all_here or not all(map(self._is_here, self._listened)):
            return
        self._all_here = True
        words = estimates(self._pipeline.settings, self._pipeline.undeterminable)
        self._node.get_logger().info(f"all {len(self._listened)} inputs are here: {words}")

    def _is_here(self, stream: str) -> bool:
        """Whether a stream has a usable row; loads of 0 or less are kept, but not usable."""
        kept = self._pipeline.streams.all[stream]
        return kept.newest > 0 and (kept.kind != "load" or bool((kept.values > 0.0).any()))

    def _newest_stamp(self, stream: str) -> int | None:
        """Newest stamp (ns) of the rows that were kept of a stream; None if there are none."""
        newest = self._pipeline.streams.all[stream].newest
        return newest if newest > 0 else None

    def say_what_is_missing(self) -> None:
        """Log which inputs are missing and why, in one line for each type and reason.

        A missing input is not reported twice.
        """
        groups: dict[str, list[str]] = {}
        for topic, why in self._missing():
            if (topic, why) not in self._said_missing:
                self._said_missing.add((topic, why))
                groups.setdefault(why, []).append(topic)
        for why, topics in groups.items():
            self._node.get_logger().warning(f"still waiting for {', '.join(topics)} {why}")

    def _missing(self) -> list[tuple[str, str]]:
        """Topics from which nothing has been received yet, each with its type and the reason in words."""
        missing: dict[tuple[str, str], str] = {}
        for name, stream in self._listened.items():
            if self._received(name) == 0:
                key = (stream.topic, stream.type)
                missing[key] = missing.get(key, "") + stream.detail
        return [
            (topic, f"({kind}{details}): {self._why(topic, kind)}")
            for (topic, kind), details in missing.items()
        ]

    def _received(self, stream: str) -> int:
        return self._pipeline.streams.all[stream].received

    def _why(self, topic: str, kind: str) -> str:
        publishers = self._node.get_publishers_info_by_topic(topic)
        if not publishers:
            return "no publisher"
        types = sorted({info.topic_type for info in publishers})
        if kind not in types:
            return f"its publisher has another type, {', '.join(types)}"
        asked = next((s.qos_profile for s in self._subscriptions if s.topic_name == topic), INPUT)
        for info in publishers:
            compatibility, reason = qos_check_compatible(info.qos_profile, asked)
            if compatibility == QoSCompatibility.ERROR:
                return f"its publisher has incompatible QoS: {reason}"
        count = len(publishers)
        return f"{count} publisher{'s' if count > 1 else ''}, nothing received yet"

    def status(self, longest: float) -> DiagnosticStatus:
        """Make the entry of the inputs in the diagnostics: rates, ages, and what is missing or was not used.

        Rates are means since the last call. longest: duration of the longest turn of
        the node's timer since then, s.
        """
        settings, now = self._pipeline.settings, time.monotonic()
        elapsed, self._measured_at = max(now - self._measured_at, 1e-6), now
        words = [f"still waiting for {topic} {why}" for topic, why in self._missing()]
        values = {}
        for key, stream in self._listened.items():
            count, newest = self._received(key), self._newest_stamp(key)
            flow = f"{(count - stream.count) / elapsed:.1f} Hz, {count} received"
            if newest is not None:
                age = (self._node.get_clock().now().nanoseconds - newest) / SECOND
                flow += f", newest stamp {age:.2f} s ago"
            values[f"{stream.topic}{stream.detail}"] = flow
            if count > stream.count:
                stream.count, stream.last = count, now
            if count and now - stream.last > _SILENT_AFTER:
                words.append(f"{stream.topic}: no message for {now - stream.last:.0f} s")
        values["longest turn [ms]"] = f"{1e3 * longest:.1f}"
        counts = sorted(self._pipeline.problems.items())
        for (key, reason), count in counts:
            values[f"{self._topic_of(key)}: {reason}"] = str(count)
        said = []
        if settings.static_loads:
            said.append("loads are not measured, they are configured")
        if settings.velocity == "none":
            said.append("odometry comes from the wheels: slip is unknown")
        if words:
            return status("inputs", WARN, "; ".join(words + said), values)
        text = f"all {len(self._listened)} inputs come in"
        if counts:
            unused = sum(count for _, count in counts)
            text += f"; {unused} messages could not be used, see the counts"
        level = WARN if settings.velocity == "none" else OK
        return status("inputs", level, "; ".join([text, *said]), values)


# --- Of messages and streams


def _queued(subscription: Subscription, *, raw: bool) -> Iterator[tuple[Any, Mapping[str, int]]]:
    """Take the messages that wait for a subscription, each with the middleware's information about it.

    raw: whether messages stay serialised.
    """
    with subscription.handle:
        while taken := subscription.handle.take_message(subscription.msg_type, raw):
            yield taken


def part_of_message(stream: str, settings: NodeSettings) -> str:
    """Name the part of a message that a stream is read from.

    Parameters
    ----------
    stream
        Name of the stream, such as `<wheel>/load` or `odom`.
    settings
        The node's settings.

    Returns
    -------
    str
        Words to follow the topic's name, such as ", effort of joint wheel_fl"; empty where the topic's name
        says enough.
    """
    wheel, _, kind = stream.rpartition("/")
    own = settings.inputs.get(wheel)
    if own is None:
        return ""
    if kind == "load" and settings.load.source == "joint_states":
        return f", effort of joint {own.load_joint}"
    return {
        "wheel_speed": f", joint {own.joint}",
        "torque": f", effort of joint {own.joint}",
        "steering": f", joint {own.steering_joint}",
        "drawbar_pull": ", force.x",
    }.get(kind, "")


# --- What the node logs of them as it starts


def input_lines(topics: Mapping[str, Topic]) -> list[str]:
    """Describe the expected inputs in lines for the log, one for all topics that measure the same.

    topics: by full name.
    """
    groups: dict[tuple[str, str], list[str]] = {}
    for resolved, topic in topics.items():
        measured = (stream.rpartition("/")[2] for stream in topic.streams)
        what = " and ".join(dict.fromkeys(_MEASURED.get(name, name) for name in measured))
        groups.setdefault((what, topic.type), []).append(resolved)
    return [
        f"waits for {what}: {', '.join(names)} ({kind})" for (what, kind), names in groups.items()
    ]


def estimates(settings: OnboardSettings, undeterminable: Sequence[str]) -> str:
    """Describe in words what is estimated, and for which wheels, given that all inputs have arrived.

    Parameters
    ----------
    settings
        The pipeline's settings.
    undeterminable
        Sentences about what these wheels cannot determine of the soil; only whether there are any matters.
    """
    if len(settings.without_sinkage) == len(settings.wheels):
        law = "nothing of the soil's law (no sinkage is measured)"
    elif undeterminable:
        law = "n and k D^m of the soil"  # why not m has been said as a warning
    else:
        law = "k, n and m of the soil"
    ways = {
        "the balance of the vehicle's forces": settings.mass and settings.velocity != "none",
        "torque": settings.with_torque,
        "drawbar pull": settings.with_drawbar_pull,
    }
    by = " and ".join(way for way, there in ways.items() if there)
    strength = f" and its strength by {by}" if by else "; its strength stays as configured"
    found = [f"estimates {law}{strength}"]
    deep, pulls = ["sinkage", "resistance"], ["thrust", "drawbar pull"]
    lacking = []
    if settings.law_unknown:
        deep, pulls = [], [*pulls, "margin"]
        lacking.append("no sinkage, resistance: nothing measures sinkage, and no soil is named")
    elif settings.without_soil_sensors:
        lacking.append("sinkage, resistance: as in the soil that is named")
    if settings.velocity == "none":
        pulls = [name for name in pulls if name == "margin"]
        lacking.append("no slip, thrust, pull: odometry comes from the wheels")
    *some, last = [*deep, *pulls]
    what = f"{', '.join(some)} and {last}" if some else last
    what += f" ({'; '.join(lacking)}) of" if lacking else " of"
    rolling = [wheel.name for wheel in settings.wheels if wheel.contact == ROLLING]
    pressed = [wheel.name for wheel in settings.wheels if wheel.contact != ROLLING]
    if rolling:
        found.append(f"{what} {', '.join(rolling)}")
    if pressed and not settings.law_unknown:
        found.append(f"sinkage of {', '.join(pressed)}")
    return "; ".join(found)
