"""What the node says of itself: throttled log lines, topics still waited for, diagnostics."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from rclpy.node import Node
from rclpy.qos import QoSCompatibility, qos_check_compatible

from smallwheel_ros.estimator.identifiability import SoilEstimate
from smallwheel_ros.onboard.intake import ODOMETRY
from smallwheel_ros.onboard.mobility import MobilityEstimate, Status
from smallwheel_ros.onboard.onboard import Onboard
from smallwheel_ros.onboard.parameters import NodeSettings
from smallwheel_ros.onboard.problems import Problem
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


def inputs_of(node: Node, settings: NodeSettings, streams: Iterable[str]) -> Iterator[Input]:
    """Say by which topic each stream of the estimate comes."""
    for stream in streams:
        wheel, _, kind = stream.partition("/")
        if stream == ODOMETRY:
            yield Input(stream, node.resolve_topic_name("odom"), "nav_msgs/msg/Odometry")
            continue
        inputs = settings.inputs[wheel]
        if kind == "wheel_speed":
            topic = node.resolve_topic_name("joint_states")
            yield Input(stream, topic, "sensor_msgs/msg/JointState", f", joint {inputs.joint}")
        elif kind == "load":
            topic = node.resolve_topic_name(inputs.load_topic)
            yield Input(stream, topic, "geometry_msgs/msg/WrenchStamped")
        else:
            topic = node.resolve_topic_name(inputs.sinkage_topic)
            yield Input(stream, topic, "smallwheel_ros/msg/WheelSinkage")


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
            f"{self.inputs[stream].topic}: no message for {now - last:.0f} s"
            for stream, (last, count) in self._seen.items()
            if count and now - last > _SILENT_AFTER
        ]

    def entries(
        self, name: str, onboard: Onboard | None, newest: Iterable[MobilityEstimate]
    ) -> list[DiagnosticStatus]:
        """Return the diagnostics of a node of that name; onboard is None while it is not active."""
        if onboard is None:
            text = "not active: it waits for a lifecycle manager"
            return [status(f"{name}: inputs", DiagnosticStatus.OK, text)]
        return [
            self.inputs_status(f"{name}: inputs", onboard),
            soil_status(f"{name}: soil", onboard.soil, onboard.rejected),
            *(wheel_status(f"{name}: wheel {estimate.wheel}", estimate) for estimate in newest),
        ]

    def inputs_status(self, name: str, onboard: Onboard) -> DiagnosticStatus:
        """Rates of the inputs, what is missing, and what could not be used, by reason."""
        self.measure(onboard)
        missing, silent = self.waiting_for(onboard), self.silent()
        values = {
            f"{item.topic}{item.detail}": f"{self._rates.get(item.stream, 0.0):.1f} Hz,"
            f" {onboard.received[item.stream]} received"
            for item in self.inputs.values()
        }
        refused = 0
        for (stream, reason), count in sorted(onboard.counts.items()):
            item = self.inputs.get(stream)
            values[f"{item.topic if item else stream}: {reason}"] = str(count)
            refused += count
        words = [f"still waiting for {text}" for text in missing] + silent
        if words:
            return status(name, DiagnosticStatus.WARN, "; ".join(words), values)
        text = f"all {len(self.inputs)} inputs come in"
        if refused:
            text += f"; {refused} messages could not be used, see the counts"
        return status(name, DiagnosticStatus.OK, text, values)


def soil_status(name: str, soil: SoilEstimate, rejected: int) -> DiagnosticStatus:
    """The soil in numbers, and what is not determined, in words."""
    pressure, deviation = soil.reference_pressure, soil.reference_pressure_std
    spread = soil.covariance.diagonal() ** 0.5
    values = {
        "reference pressure [Pa]": f"{pressure:.6g} +- {deviation:.2g}",
        "k [Pa/m^(n+m)]": f"{soil.k:.6g} +- {spread[0]:.2g}",
        "n": f"{soil.n:.4f} +- {spread[1]:.2g}",
        "m": f"{soil.m:.4f} +- {spread[2]:.2g}",
        "accepted": str(soil.accepted),
        "rejected": str(rejected),
        "outliers": str(soil.outliers),
        "soil changes": str(soil.soil_changes),
        "travel [m]": f"{soil.distance:.2f}",
    }
    text = "; ".join(soil.status) or "k, n and m are determined"
    return status(name, DiagnosticStatus.OK, text, values)


_LEVELS = {
    Status.LOAD_MISSING: DiagnosticStatus.WARN,
    Status.SUNK_TO_AXLE: DiagnosticStatus.ERROR,
}


def wheel_status(name: str, estimate: MobilityEstimate) -> DiagnosticStatus:
    """How one wheel does."""
    values = {"status": estimate.status.name}
    pull = estimate.forces.drawbar_pull if estimate.forces else None
    if pull is not None:
        values["drawbar pull [N]"] = f"{pull.value:.4g} +- {pull.standard_deviation:.2g}"
    level = _LEVELS.get(estimate.status, DiagnosticStatus.OK)
    return status(name, level, estimate.status_text or "OK", values)


def status(
    name: str, level: bytes, message: str, values: Mapping[str, str] | None = None
) -> DiagnosticStatus:
    """Return one entry of the diagnostics."""
    return DiagnosticStatus(
        name=name,
        level=level,
        message=message,
        hardware_id="",
        values=[KeyValue(key=key, value=value) for key, value in (values or {}).items()],
    )
