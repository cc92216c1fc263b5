# SPDX-License-Identifier: Apache-2.0
"""The bag with the estimates next to the originals."""

from __future__ import annotations

import math
from pathlib import Path

from smallwheel_ros.bags import BagReader, BagWriter, Message, header
from smallwheel_ros.bags.files import RawMessage, Storage, storage_kind
from smallwheel_ros.bags.storage import Key
from smallwheel_ros.costmap.grid import Grid
from smallwheel_ros.estimator.reading import Reading
from smallwheel_ros.onboard.parameters import NODE_NAME
from smallwheel_ros.onboard.streams import SECOND
from smallwheel_ros.replay.estimates import MOBILITY, SOIL, Estimate

_GRID, _TF = "nav_msgs/msg/OccupancyGrid", "tf2_msgs/msg/TFMessage"
_POSE_PERIOD = SECOND // 20
_SOIL_PERIOD = SECOND // 10  # as the node: by stamps, no more than ten times a second


class NewBag(BagWriter):
    """Writes originals as they are and estimates as the node would have published them.

    It is stored as the old bag is, so that whoever reads that one reads this one too.

    Attributes
    ----------
    prefix
        Of the topics of the estimates: the node's name, or /replay before it where the bag has
        the node's own estimates already.
    left_out
        Topics and types that are not copied, since their type cannot be understood.
    damaged
        Messages that are not copied, since they cannot be converted.
    """

    def __init__(self, path: Path, reader: BagReader, copied: set[Key]) -> None:
        files = list(reader.path.iterdir()) if reader.path.is_dir() else [reader.path]
        sqlite = any(storage_kind(file) == ".db3" for file in files)
        storage: Storage = "sqlite3" if sqlite else "mcap"
        super().__init__(path, storage=storage)
        own = f"/{NODE_NAME}"
        taken = any(topic.name.startswith(f"{own}/") for topic in reader.topics)
        self.prefix = f"/replay{own}" if taken else own
        found = {key: reader.as_channel(*key) for key in sorted(copied)}
        self._channels = {key: channel for key, channel in found.items() if channel is not None}
        self.left_out = [key for key, channel in found.items() if channel is None]
        self.damaged = 0
        self._has_tf = any(topic in ("/tf", "tf") for topic, _ in self._channels)
        self._posed = -_POSE_PERIOD
        self._soil_sent: int | None = None
        self._soil_waits: tuple[int, Estimate, str] | None = None

    def __enter__(self) -> NewBag:
        super().__enter__()
        self.add(f"{self.prefix}/mobility", MOBILITY)
        self.add(f"{self.prefix}/soil", SOIL, keeps_last=True)
        self.add(f"{self.prefix}/cost", _GRID, keeps_last=True)
        return self

    def copy(self, raw: RawMessage) -> None:
        """Write a message of the bag, where its topic is copied."""
        found = self._channels.get((raw.topic, raw.type))
        if found is None:
            return
        channel, convert = found
        try:
            data = convert(raw.data)
        except Exception:  # damaged bytes of a ROS 1 message make rosbags raise as it likes
            self.damaged += 1
        else:
            self.write_bytes(channel, raw.log_time, data)

    def write_estimate(self, estimate: Estimate, log_time: int, frame: str) -> None:
        """Write an estimate; frame: that of odometry."""
        self.write(f"{self.prefix}/mobility", MOBILITY, log_time, estimate.mobility())
        self._soil_waits = (log_time, estimate, frame)
        stamp, sent = estimate.result.instant.stamp, self._soil_sent
        if sent is None or not sent <= stamp < sent + _SOIL_PERIOD:
            self._soil_sent = stamp
            self.finish()

    def write_grid(self, grid: Grid, stamp: int, log_time: int) -> None:
        """Write a cost grid; stamp and log_time in ns."""
        (x, y), (height, width) = grid.origin, grid.cells.shape
        stamped = header(stamp, grid.frame)
        place = Message(x=x, y=y, z=0.0)
        origin = Message(position=place, orientation=Message(x=0.0, y=0.0, z=0.0, w=1.0))
        info = Message(
            map_load_time=stamped.stamp,
            resolution=grid.resolution,
            width=width,
            height=height,
            origin=origin,
        )
        message = Message(header=stamped, info=info, data=grid.cells.ravel())
        self.write(f"{self.prefix}/cost", _GRID, log_time, message)

    def write_pose(self, instant: Reading, log_time: int, frame: str) -> None:
        """Write where base_link is in the frame of the odometry, unless the bag's own /tf is copied."""
        if self._has_tf or not frame or instant.vehicle is None or instant.heading is None:
            return
        if instant.stamp < self._posed + _POSE_PERIOD:
            return
        self._posed = instant.stamp
        x, y = instant.vehicle
        turn = Message(
            x=0.0, y=0.0, z=math.sin(instant.heading / 2), w=math.cos(instant.heading / 2)
        )
        moved = Message(translation=Message(x=x, y=y, z=0.0), rotation=turn)
        stamped = header(instant.stamp, frame)
        link = Message(header=stamped, child_frame_id="base_link", transform=moved)
        self.write("/tf", _TF, log_time, Message(transforms=[link]))

    def finish(self) -> None:
        """Write the last soil, if it still waits."""
        if self._soil_waits is not None:
            log_time, estimate, frame = self._soil_waits
            self.write(f"{self.prefix}/soil", SOIL, log_time, estimate.soil(frame))
            self._soil_waits = None
