# SPDX-License-Identifier: Apache-2.0
"""What others say of the robot where parameters are not given: its description, and tf."""

from __future__ import annotations

from typing import Any

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.time import Time
from std_msgs.msg import String

from smallwheel_ros.common.errors import SmallwheelError
from smallwheel_ros.onboard.feed import angles_of
from smallwheel_ros.onboard.robot_description import (
    DESCRIPTION_TYPE,
    Filled,
    fill_silent,
    needs_description,
    silent_parameters,
)
from smallwheel_ros.ros import qos
from smallwheel_ros.ros.parameters import VELOCITY_SENSOR, NodeParameters

try:
    import tf2_ros
except ImportError:  # no package of PyPI; ROS installations have it
    tf2_ros = None

_UPRIGHT = 0.9  # cosine of 25 degrees, as for the axes of wheels: speeds along it are 10 % off


class RobotDescription:
    """Listens to the robot description, and gives the parameters what it says.

    It does not listen where every parameter is given that a description can fill.

    Attributes
    ----------
    lacking
        A sentence for what the newest description could not fill.
    """

    def __init__(self, node: Node, table: NodeParameters) -> None:
        self._node, self._table = node, table
        self.lacking: list[str] = []
        self._arrived = self._listens = False
        topic = table.values()["robot_description_topic"]
        if not silent_parameters(table.given()) or not isinstance(topic, str) or not topic:
            return
        try:
            self._topic = node.resolve_topic_name(topic)
            node.create_subscription(
                String,
                topic,
                self._take,
                qos.LATCHED,
                event_callbacks=SubscriptionEventCallbacks(use_default_callbacks=False),
            )
        except Exception as error:  # rcl's; its words have several lines
            reason = " ".join(str(error).split())
            self.lacking.append(f"robot description: cannot listen to {topic!r}: {reason}")
            return
        self._listens = True

    @property
    def waiting(self) -> str:
        """What is waited for before the node can be configured, in words; empty: nothing."""
        if not self._listens or self._arrived or self._table.wrong:
            return ""
        needed = needs_description(self._table.given())
        if not needed:
            return ""
        publishers = self._node.count_publishers(self._topic)
        why = "its publisher has sent nothing yet" if publishers else "no publisher"
        return (
            f"waiting for {self._topic} ({DESCRIPTION_TYPE}): {why}; {', '.join(needed)} are not"
            " given and come from it"
        )

    def _take(self, message: String) -> None:
        self._arrived = True
        filled, problem = Filled(), ""
        try:
            filled = fill_silent(message.data, self._table.given())
        except SmallwheelError as error:
            problem = f"robot description: {error}"
        else:
            refused = self._table.fill(filled.values)
            problem = f"robot description: {refused}" if refused else ""
        self.lacking = [problem] if problem else filled.lacking
        log = self._node.get_logger()
        if not problem:
            log.info(f"from {self._topic}: {filled.text}")
        for text in self.lacking:
            log.warning(text)


class VelocityFrame:
    """Looks the frame of `velocity_topic` up in tf, once, and gives the parameters what it finds.

    It listens to tf only from the first message in a frame that is not the base frame until the
    transform is known.

    Attributes
    ----------
    lacking
        A sentence while the frame is not the base frame and nobody says where the sensor is.
    """

    def __init__(self, node: Node, table: NodeParameters) -> None:
        self._node, self._table = node, table
        self._buffer: Any = None
        self._listener: Any = None
        self._known = ""  # frame that has been looked up
        self.lacking: list[str] = []

    def look_up(self, frame: str) -> None:
        """Look a frame up, if that is needed; called now and then with the newest one."""
        given, base = self._table.given(), str(self._table.values()["base_frame"])
        silent = [name for name in VELOCITY_SENSOR if name not in given]
        if not silent or frame in ("", base):
            self.lacking = []
            return
        if frame == self._known:
            return
        try:
            found, problem = self._in_base(frame, base)
        except Exception as error:  # tf2's own, or a release with another interface
            found, problem = {}, f"tf does not connect them ({' '.join(str(error).split())})"
        if not problem:
            problem = self._table.fill({name: found[name] for name in silent})
        if problem:
            self.lacking = [
                f"velocity_topic is in frame {frame!r}, expected {base!r}: {problem}; {', '.join(silent)}"
                " stay as they are: give them"
            ]
            return
        self._known, self.lacking = frame, []

    def _in_base(self, frame: str, base: str) -> tuple[dict[str, float], str]:
        """Return the sensor's place and direction in the base frame, or why they are unknown."""
        if tf2_ros is None:
            return {}, "tf2_ros is not installed"
        if self._buffer is None:
            self._buffer = tf2_ros.Buffer()
            self._listener = tf2_ros.TransformListener(self._buffer, self._node)
        transform = self._buffer.lookup_transform(base, frame, Time()).transform
        self._listener.unregister()
        self._listener = self._buffer = None
        turn = transform.rotation
        yaw, *_ = angles_of(turn.x, turn.y, turn.z, turn.w)
        if yaw is None:
            return {}, "the rotation in tf is no unit quaternion"
        if 1.0 - 2.0 * (turn.x**2 + turn.y**2) < _UPRIGHT:
            return {}, "by tf its z axis is not upright"
        return dict(zip(VELOCITY_SENSOR, (transform.translation.y, yaw), strict=True)), ""
