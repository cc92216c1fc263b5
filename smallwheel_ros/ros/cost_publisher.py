# SPDX-License-Identifier: Apache-2.0
"""The node's cost map: terrain classes in, grid out, at a bounded rate."""

from __future__ import annotations

import math
import time
from array import array
from collections.abc import Callable, Sequence
from typing import Any

import rclpy
from rclpy.duration import Duration
from rclpy.lifecycle import LifecyclePublisher
from rclpy.publisher import Publisher

from smallwheel_ros.costmap.cost_map import CostMap, CostSettings
from smallwheel_ros.costmap.grid import UNKNOWN, CostMapError, Pose
from smallwheel_ros.onboard.feed import angles_of
from smallwheel_ros.onboard.ground import GroundMapper
from smallwheel_ros.onboard.result import Result
from smallwheel_ros.physics.wheel import Wheel
from smallwheel_ros.ros.conversions import grid_from, grid_message, nanoseconds_of

TERRAIN_CLASSES = "terrain_classes"
# s: Nav2 leaves costs where they were when a grid came. After a correction of map -> odom they are
# where they belong once it comes again: at once where tf tells of it, else after so long.
AGAIN_AFTER = 5.0
_LAST = 0.5  # s for listeners to take the last grid


class CostPublisher:
    """Keeps the cost map of a vehicle, and publishes it.

    received: how many grids of terrain classes have come. report: takes stream, reason and words of
    a grid that cannot be used.
    """

    def __init__(
        self,
        settings: CostSettings,
        wheels: Sequence[Wheel],
        publisher: LifecyclePublisher,
        report: Callable[[str, str, str], None],
    ) -> None:
        self._publisher = publisher
        self._report = report
        self._stamp = 0
        self._last: Any = None
        self._sent: Any = None  # the newest grid, and when that was by time.monotonic()
        self._sent_at = 0.0
        self._corner: tuple[float, float] | None = (
            None  # of the grid, where tf had it when it was sent
        )
        self._corrected = False
        self.received = 0
        self.published = 0
        self._ground = GroundMapper(CostMap(settings, wheels))

    @property
    def map(self) -> CostMap:
        """The cost map itself."""
        return self._ground.map

    def add(self, result: Result, frame: str) -> None:
        """Take a result of the estimate; frame is that of the odometry."""
        self._stamp = max(self._stamp, result.instant.stamp)
        self._ground.add(result, frame)

    def on_classes(self, message: Any) -> None:
        """Take a grid of terrain classes; one that comes by two subscriptions counts once."""
        if message == self._last:
            return
        self._last = message
        self.received += 1
        try:
            self.map.take_classes(grid_from(message))
        except CostMapError as error:
            self._report(TERRAIN_CLASSES, "malformed_grid", f"not used: {error}")
            return
        self._stamp = max(self._stamp, nanoseconds_of(message.header.stamp))
        if self.map.in_other_frame:
            self._report(TERRAIN_CLASSES, "other_frame", self.map.problem)

    def on_transforms(self, message: Any) -> None:
        """Take transforms (tf2_msgs/TFMessage): the grid is sent again once its frame has moved."""
        for found in message.transforms:
            if found.child_frame_id == self.map.frame != "":
                by, turn = found.transform.translation, found.transform.rotation
                yaw, *_ = angles_of(turn.x, turn.y, turn.z, turn.w)
                if yaw is not None and math.isfinite(by.x + by.y + yaw):
                    self.map.place_frame(found.header.frame_id, Pose(by.x, by.y, yaw))
        if self._sent is None:
            return
        frame, resolution = self._sent.header.frame_id, self._sent.info.resolution
        for found in message.transforms:
            if found.child_frame_id == frame:
                corner = self._corner_by(found.transform)
                if self._corner is None:
                    self._corner = corner
                elif not math.dist(corner, self._corner) < 0.5 * resolution:
                    self._corrected = True

    def _corner_by(self, transform: Any) -> tuple[float, float]:
        """The far corner of the grid that was sent, in the frame above that of the grid."""
        info, by, turn = self._sent.info, transform.translation, transform.rotation
        x = info.origin.position.x + info.width * info.resolution
        y = info.origin.position.y + info.height * info.resolution
        yaw, *_ = angles_of(turn.x, turn.y, turn.z, turn.w)
        cosine, sine = math.cos(yaw or 0.0), math.sin(yaw or 0.0)
        return by.x + cosine * x - sine * y, by.y + sine * x + cosine * y

    def clear(self) -> None:
        """Forget the ground: the soil is another one, or time has gone back."""
        self._ground.clear()
        self._stamp = 0

    def publish(self, now: int) -> None:
        """Publish the grid if it has changed, and the same one again after 5 s or a correction by tf.

        now (ns): its stamp before any measurement.
        """
        if self.map.changed:
            grid = self.map.grid()
            if grid is not None:
                self._send(grid_message(grid, self._stamp or now))
        elif self._sent is not None and (
            self._corrected or time.monotonic() >= self._sent_at + AGAIN_AFTER
        ):
            self._send(self._sent)

    def empty(self) -> None:
        """Tell listeners, before the topic goes, that nothing is known any more: Nav2 would keep it."""
        if self._sent is None or not rclpy.ok():
            return
        self._sent.data = array("b", bytes([UNKNOWN % 256])) * len(self._sent.data)
        # The publisher of a node that is not active any more is silent by itself.
        Publisher.publish(self._publisher, self._sent)
        self._publisher.wait_for_all_acked(Duration(seconds=_LAST))
        self._sent = None

    def _send(self, message: Any) -> None:
        self._publisher.publish(message)
        self._sent, self._sent_at = message, time.monotonic()
        self._corner, self._corrected = None, False
        self.published += 1
