# SPDX-License-Identifier: Apache-2.0
"""The bag of a replay: the original messages, and the estimates as the node would have published them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from smallwheel_ros.bags import BagReader, BagWriter, Key, Message, RawMessage, header
from smallwheel_ros.common.stamps import SECOND
from smallwheel_ros.costmap.cost_map import COST_TOPICS, CostGrids
from smallwheel_ros.costmap.grid import Grid
from smallwheel_ros.onboard.declared import TwistSettings
from smallwheel_ros.onboard.parameters import NODE_NAME
from smallwheel_ros.pipeline.tables import Estimates, Integers
from smallwheel_ros.pipeline.twist.twist import Twists, messages

MOBILITY = "smallwheel_ros/msg/MobilityEstimate"
VEHICLE = "smallwheel_ros/msg/VehicleMobility"
SOIL = "smallwheel_ros/msg/SoilEstimate"
_TWIST = "geometry_msgs/msg/TwistWithCovarianceStamped"
_GRID, _TF = "nav_msgs/msg/OccupancyGrid", "tf2_msgs/msg/TFMessage"
_POSE_PERIOD = SECOND // 20
_SOIL_PERIOD = SECOND // 10  # as the node: by stamps, no more than ten times a second


class NewBag(BagWriter):
    """A new bag in the storage format of the old one, so that the same programs read both.

    Parameters
    ----------
    path
        Folder of the new bag.
    reader
        Open reader of the old bag.
    copied
        Topics and types whose messages are copied.
    frames
        Name of the frame of each wheel's messages, by the wheel's name.
    base_frame
        Name of the vehicle's base frame.

    Attributes
    ----------
    has_twists
        Whether twists were written.
    prefix
        Prefix of the topics of the estimates: the node's name, preceded by /replay if the bag already
        contains estimates of the node.
    left_out
        Topics and types that were to be copied, but are not, since their type is unknown.
    damaged
        Number of messages so far that are not copied, since they cannot be converted.
    """

    def __init__(
        self,
        path: Path,
        reader: BagReader,
        copied: set[Key],
        frames: Mapping[str, str],
        base_frame: str,
    ) -> None:
        self._frames, self._base_frame = frames, base_frame
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
        self.has_twists = False
        self._soil_waits: tuple[int, int, str, Mapping[str, Any]] | None = None

    def __enter__(self) -> NewBag:
        super().__enter__()
        for wheel in self._frames:
            self.add(f"{self.prefix}/{wheel}/mobility", MOBILITY)
        self.add(f"{self.prefix}/vehicle", VEHICLE)
        self.add(f"{self.prefix}/soil", SOIL, keeps_last=True)
        for name in COST_TOPICS:
            self.add(f"{self.prefix}/{name}", _GRID, keeps_last=True)
        return self

    def copy_message(self, raw: RawMessage) -> None:
        """Copy a message of the original bag if its topic is copied."""
        channel = self._channels.get((raw.topic, raw.type))
        if channel is None:
            return
        try:
            data = channel.convert(raw.data)
        except Exception:  # damaged bytes of a ROS 1 message make rosbags raise as it likes
            self.damaged += 1
        else:
            self.copy(channel._replace(convert=bytes), raw.log_time, bytes(data))

    def write_estimates(
        self,
        rows: Estimates,
        columns: Mapping[str, Any],
        soils: Sequence[Mapping[str, Any]],
        times: Integers,
        frame: str,
    ) -> None:
        """Write a MobilityEstimate for each row, and SoilEstimate and /tf as often as the node would.

        Parameters
        ----------
        rows
            The estimates, for their stamps and poses.
        columns
            Fields of MobilityEstimate by name, each of shape (rows,).
        soils
            Fields of SoilEstimate by name, for each row.
        times
            Recording times, ns, shape (rows,).
        frame
            Name of the odometry's frame; empty if unknown: then no pose is written to /tf.
        """
        names, stamps = list(columns), rows.stamp.tolist()
        values = [c.tolist() if hasattr(c, "tolist") else c for c in columns.values()]
        poses = np.column_stack([rows.x, rows.y, rows.heading]).tolist()
        for i, row in enumerate(zip(*values, strict=True)):
            stamp, time = stamps[i], int(times[i])
            fields = dict(zip(names, row, strict=True))
            wheel = fields["wheel"]
            message = Message(header=header(stamp, self._frames[wheel]), **fields)
            self.write(f"{self.prefix}/{wheel}/mobility", MOBILITY, time, message)
            self._soil_waits = time, stamp, frame, soils[i]
            if self.is_due("soil", stamp, _SOIL_PERIOD):
                self.write_soil()
            self._write_pose(stamp, poses[i], time, frame)

    def write_vehicle(self, stamps: Integers, columns: Mapping[str, Any], times: Integers) -> None:
        """Write a VehicleMobility for each row.

        Parameters
        ----------
        stamps
            Stamps of the messages, ns, shape (rows,).
        columns
            Fields of VehicleMobility by name, each of shape (rows,).
        times
            Recording times, ns, shape (rows,).
        """
        values = [c.tolist() if hasattr(c, "tolist") else c for c in columns.values()]
        for stamp, time, *row in zip(stamps.tolist(), times.tolist(), *values, strict=True):
            fields = dict(zip(columns, row, strict=True))
            message = Message(header=header(stamp, self._base_frame), **fields)
            self.write(f"{self.prefix}/vehicle", VEHICLE, time, message)

    def write_soil(self) -> None:
        """Write the last soil if it is still pending."""
        if self._soil_waits is not None:
            time, stamp, frame, soil = self._soil_waits
            message = Message(header=header(stamp, frame), **soil)
            self.write(f"{self.prefix}/soil", SOIL, time, message)
            self._soil_waits = None

    def write_twists(self, rows: Twists, settings: TwistSettings, times: Integers) -> None:
        """Write a TwistWithCovarianceStamped for each row, on the topic ~/twist.

        Parameters
        ----------
        rows
            The vehicle's twists.
        settings
            Settings of their covariance.
        times
            Recording times, ns, shape (rows,).
        """
        topic = f"{self.prefix}/twist"
        if not self.has_twists:
            self.add(topic, _TWIST)
            self.has_twists = True
        linear, angular, covariance = messages(rows, settings)
        for i, stamp in enumerate(rows.stamp.tolist()):
            ahead, turn = (
                Message(**dict(zip("xyz", part[i].tolist(), strict=True)))
                for part in (linear, angular)
            )
            twist = Message(twist=Message(linear=ahead, angular=turn), covariance=covariance[i])
            message = Message(header=header(stamp, self._base_frame), twist=twist)
            self.write(topic, _TWIST, int(times[i]), message)

    def is_due(self, what: str, time: int, period: int) -> bool:
        """Whether something that is written at intervals is due, and if so, note the time.

        It is due for the first time, a period after it was last due, and if time went back.

        Parameters
        ----------
        what
            Name of what is written, such as `soil`.
        time
            Present time, ns, always on the same clock for one name.
        period
            Length of the interval, ns.
        """
        sent = self._sent.get(what)
        due = sent is None or not sent <= time < sent + period
        if due:
            self._sent[what] = time
        return due

    def write_grids(self, grids: CostGrids, stamp: int, time: int) -> None:
        """Write both cost grids, each on its topic.

        Parameters
        ----------
        grids
            The grids of costs.
        stamp, time
            Stamp of the messages, and time of recording, ns.
        """
        for name, grid in zip(COST_TOPICS, grids, strict=True):
            self._write_grid(f"{self.prefix}/{name}", grid, stamp, time)

    def _write_grid(self, topic: str, grid: Grid, stamp: int, time: int) -> None:
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
        self.write(topic, _GRID, time, message)

    def _write_pose(self, stamp: int, pose: Sequence[float], time: int, frame: str) -> None:
        """Write the pose of base_frame in the odometry's frame to /tf, unless the old bag's /tf is copied."""
        if self._has_tf or not frame or not math.isfinite(sum(pose)):
            return
        if not self.is_due("pose", stamp, _POSE_PERIOD):
            return
        x, y, half = pose[0], pose[1], pose[2] / 2
        turn = Message(x=0.0, y=0.0, z=math.sin(half), w=math.cos(half))
        moved = Message(translation=Message(x=x, y=y, z=0.0), rotation=turn)
        stamped = header(stamp, frame)
        link = Message(header=stamped, child_frame_id=self._base_frame, transform=moved)
        self.write("/tf", _TF, time, Message(transforms=[link]))
