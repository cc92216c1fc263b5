# SPDX-License-Identifier: Apache-2.0
"""The robot description that the node listens to where parameters of wheels are not given."""

from __future__ import annotations

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from std_msgs.msg import String

from smallwheel_ros.common.errors import SmallwheelError
from smallwheel_ros.onboard.robot_description import (
    DESCRIPTION_TYPE,
    Filled,
    fill_silent,
    needs_description,
    silent_parameters,
)
from smallwheel_ros.ros import qos
from smallwheel_ros.ros.parameters import NodeParameters


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
