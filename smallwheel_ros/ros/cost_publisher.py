# SPDX-License-Identifier: Apache-2.0
"""The node's inputs about the ground ahead, and the grids of its cost map that it publishes."""

from __future__ import annotations

import math
import time
from array import array
from collections.abc import Sequence
from typing import Any

import rclpy
from rclpy.duration import Duration
from rclpy.lifecycle import LifecyclePublisher
from rclpy.publisher import Publisher

from smallwheel_ros.costmap.grid import UNKNOWN, Pose
from smallwheel_ros.drive.ground_ahead import AheadInputs, Report
from smallwheel_ros.drive.ground_map import GroundMapper, cost_map_of
from smallwheel_ros.onboard.settings import NodeSettings
from smallwheel_ros.pipeline.mobility.vehicle import VehicleEstimates
from smallwheel_ros.pipeline.tables import Estimates
from smallwheel_ros.ros.conversions import grid_message, nanoseconds_of, pose_of

# s: Nav2 leaves costs where they were when a grid arrived. A correction of map -> odom takes effect once the
# grid is sent again: at once if tf shows the correction, else after so long.
_AGAIN_AFTER = 5.0
_LAST = 0.5  # s for listeners to take the last grid


class CostPublisher:
    """Keeps the cost map of a vehicle (`map`), and publishes its two grids, each on its topic.

    Parameters
    ----------
    settings
        The node's settings.
    publishers
        One for each of `COST_TOPICS`, in that order.
    report
        Called with topic, reason and explanation of a message that cannot be used.

    Attributes
    ----------
    published
        Number of times that the two grids were sent.
    map
        The cost map.
    ahead
        Puts messages about the ground ahead into the map.
    """

    def __init__(
        self, settings: NodeSettings, publishers: Sequence[LifecyclePublisher], report: Report
    ) -> None:
        self._publishers = publishers
        self._stamp = 0
        self._last: Any = None
        # The newest grids, empty before the first, and when they were sent, by time.monotonic().
        self._sent: list[Any] = []
        self._sent_at = 0.0
        # Far corner of these grids by the first transform after they were sent.
        self._corner: tuple[float, float] | None = None
        self._corrected = False
        # Transforms of /tf_static by frame: they come once, mostly before any odometry.
        self._static: dict[str, tuple[str, Pose]] = {}
        self.published = 0
        self.map = cost_map_of(settings)
        self.ahead = AheadInputs(settings, self.map, report)
        self._ground = GroundMapper(self.map, settings.onboard.wheels)

    def take(self, estimates: Estimates, vehicle: VehicleEstimates, frame: str) -> VehicleEstimates:
        """Write the estimates of one turn of the pipeline into the map.

        Parameters
        ----------
        estimates
            Estimates of the wheels, newer than those of earlier calls.
        vehicle
            Estimates of the vehicle in the same turn.
        frame
            Frame of the odometry.

        Returns
        -------
        VehicleEstimates
            The same rows, with the margins of the terrain classes that the vehicle has crossed filled in.
        """
        self._stamp = max(self._stamp, int(estimates.stamp.max(initial=0)))
        vehicle = self._ground.take(estimates, vehicle, frame)
        if self.map.frame in self._static:
            self.map.place_frame(*self._static.pop(self.map.frame))
        return vehicle

    def on_classes(self, message: Any) -> None:
        """Use a grid of terrain classes (nav_msgs/OccupancyGrid); the same one twice in a row counts once."""
        if message == self._last:
            return
        self._last = message
        if self.ahead.take_classes(message):
            self._stamp = max(self._stamp, nanoseconds_of(message.header.stamp))

    def on_elevation(self, message: Any) -> None:
        """Use a map of elevations (grid_map_msgs/GridMap)."""
        if self.ahead.take_elevation(message):
            self._stamp = max(self._stamp, nanoseconds_of(message.header.stamp))

    def on_transforms(self, message: Any) -> None:
        """Use transforms (tf2_msgs/TFMessage): once the grids' frame has moved, they are sent again."""
        of_grid = self._sent[0].header.frame_id if self._sent else None
        for found in message.transforms:
            frame = found.child_frame_id
            if frame not in (self.map.frame, of_grid):
                continue
            pose = pose_of(found.transform)
            if frame == self.map.frame != "" and math.isfinite(sum(pose)):
                self.map.place_frame(found.header.frame_id, pose)
            if frame == of_grid:
                self._look_at_corner(pose)

    def on_static_transforms(self, message: Any) -> None:
        """Use static transforms (tf2_msgs/TFMessage), and keep them: their frames may become known later."""
        for found in message.transforms:
            pose = pose_of(found.transform)
            if math.isfinite(sum(pose)):
                self._static[found.child_frame_id] = found.header.frame_id, pose
        self.on_transforms(message)

    def _look_at_corner(self, pose: Pose) -> None:
        """Note whether the far corner of the grids that were sent has moved by over half a cell.

        pose: that of the grids' frame in the frame above it.
        """
        info = self._sent[0].info
        corner = pose.place(
            info.origin.position.x + info.width * info.resolution,
            info.origin.position.y + info.height * info.resolution,
        )
        if self._corner is None:
            self._corner = corner
        elif not math.dist(corner, self._corner) < 0.5 * info.resolution:
            self._corrected = True

    def clear(self) -> None:
        """Forget all costs, since the soil starts over or time went back."""
        self._ground.clear()
        self._stamp = 0

    def publish(self, now: int) -> None:
        """Publish the grids if they have changed; unchanged ones again after 5 s or a correction by tf.

        now: present time of the node's clock, ns; the grids' stamp before any measurement.
        """
        again = self._corrected or time.monotonic() >= self._sent_at + _AGAIN_AFTER
        grids = self.map.grids() if self.map.changed else None
        if grids is not None:
            self._send([grid_message(grid, self._stamp or now) for grid in grids])
        elif again and self._sent:
            self._send(self._sent)

    def empty(self) -> None:
        """Publish grids of unknown cells before the publishers end: Nav2 would keep the last ones."""
        if not self._sent or not rclpy.ok():
            return
        for publisher, message in zip(self._publishers, self._sent, strict=True):
            message.data = array("b", bytes([UNKNOWN % 256])) * len(message.data)
            # The publisher of a node that is not active any more is silent by itself.
            Publisher.publish(publisher, message)
            publisher.wait_for_all_acked(Duration(seconds=_LAST))
        self._sent = []

    def _send(self, messages: list[Any]) -> None:
        for publisher, message in zip(self._publishers, messages, strict=True):
            publisher.publish(message)
        self._sent, self._sent_at = messages, time.monotonic()
        self._corner, self._corrected = None, False
        self.published += 1
