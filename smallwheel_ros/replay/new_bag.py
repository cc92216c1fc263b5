# SPDX-License-Identifier: Apache-2.0
"""The bag of a replay: originals as they are, estimates as the node would have published them."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from smallwheel_ros.bags import BagReader, BagWriter, Key, Message, RawMessage, header
from smallwheel_ros.costmap.grid import Grid
from smallwheel_ros.estimator.reading import SECOND, Reading
from smallwheel_ros.onboard.parameters import NODE_NAME

MOBILITY = "smallwheel_ros/msg/MobilityEstimate"
SOIL = "smallwheel_ros/msg/SoilEstimate"
_GRID, _TF = "nav_msgs/msg/OccupancyGrid", "tf2_msgs/msg/TFMessage"
_POSE_PERIOD = SECOND // 20
_SOIL_PERIOD = SECOND // 10  # as the node: by stamps, no more than ten times a second


class NewBag(BagWriter):
    """Is stored as the old bag is, so that whoever reads that one reads this one too.

    prefix: of the topics of the estimates: the node's name, or /replay before it where the bag has the
    node's own estimates already. left_out: topics and types that are not copied, since their type cannot
    be understood. damaged: messages that are not copied, since they cannot be converted.
    """

    def __init__(self, path: Path, reader: BagReader, copied: set[Key]) -> None:
        super().__init__(path, storage=reader.storage)
        own = f"/{NODE_NAME}"
        taken = any(topic.name.startswith(f"{own}/") for topic in reader.topics)
        self.prefix = f"/replay{own}" if taken else own
        found = {key: reader.channel(*key) for key in sorted(copied)}
        self._channels = {key: channel for key, channel in found.items() if channel is not None}
        self.left_out = [key for key in found if key not in self._channels]
        self.damaged = 0
        self._has_tf = any(topic in ("/tf", "tf") for topic, _ in self._channels)
        self._sent: dict[str, int] = {}
        self._soil_waits: tuple[int, Message] | None = None

    def __enter__(self) -> NewBag:
        super().__enter__()
        self.add(f"{self.prefix}/mobility", MOBILITY)
        self.add(f"{self.prefix}/soil", SOIL, keeps_last=True)
        self.add(f"{self.prefix}/cost", _GRID, keeps_last=True)
        return self

    def copy_message(self, raw: RawMessage) -> None:
        """Write a message of the bag, where its topic is copied."""
        channel = self._channels.get((raw.topic, raw.type))
        if channel is None:
            return
        try:
            data = channel.convert(raw.data)
        except Exception:  # damaged bytes of a ROS 1 message make rosbags raise as it likes
            self.damaged += 1
        else:
            self.copy(channel._replace(convert=bytes), raw.log_time, bytes(data))

    def write_estimate(
        self,
        reading: Reading,
        mobility: dict[str, Any],
        soil: dict[str, Any],
        time: int,
        frame: str,
    ) -> None:
        """Write the fields of both messages; time: of recording. frame: that of odometry."""
        stamp = reading.stamp
        message = Message(header=header(stamp, reading.wheel.name), **mobility)
        self.write(f"{self.prefix}/mobility", MOBILITY, time, message)
        self._soil_waits = time, Message(header=header(stamp, frame), **soil)
        if self.is_due("soil", stamp, _SOIL_PERIOD):
            self.write_soil()
        self._write_pose(reading, time, frame)

    def write_soil(self) -> None:
        """Write the last soil, if it still waits."""
        if self._soil_waits is not None:
            self.write(f"{self.prefix}/soil", SOIL, *self._soil_waits)
            self._soil_waits = None

    def is_due(self, what: str, time: int, period: int) -> bool:
        """Whether a period (ns) has passed since this was last said, or time went back."""
        sent = self._sent.get(what)
        due = sent is None or not sent <= time < sent + period
        if due:
            self._sent[what] = time
        return due

    def write_grid(self, grid: Grid, stamp: int, time: int) -> None:
        """Write a cost grid; stamp and time of recording in ns."""
        (x, y), (height, width) = grid.origin, grid.cells.shape
        stamped = header(stamp, grid.frame)
        level = Message(x=0.0, y=0.0, z=0.0, w=1.0)
        info = Message(
            map_load_time=stamped.stamp,
            resolution=grid.resolution,
            width=width,
            height=height,
            origin=Message(position=Message(x=x, y=y, z=0.0), orientation=level),
        )
        message = Message(header=stamped, info=info, data=grid.cells.ravel())
        self.write(f"{self.prefix}/cost", _GRID, time, message)

    def _write_pose(self, reading: Reading, time: int, frame: str) -> None:
        """Write where base_link is in the frame of the odometry, unless the bag's own /tf is copied."""
        if self._has_tf or not frame or reading.vehicle is None or reading.heading is None:
            return
        if not self.is_due("pose", reading.stamp, _POSE_PERIOD):
            return
        (x, y), half = reading.vehicle, reading.heading / 2
        turn = Message(x=0.0, y=0.0, z=math.sin(half), w=math.cos(half))
        moved = Message(translation=Message(x=x, y=y, z=0.0), rotation=turn)
        stamped = header(reading.stamp, frame)
        link = Message(header=stamped, child_frame_id="base_link", transform=moved)
        self.write("/tf", _TF, time, Message(transforms=[link]))
