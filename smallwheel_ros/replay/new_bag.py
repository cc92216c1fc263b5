"""The bag with the estimates next to the originals."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import TracebackType

from smallwheel_ros.bag_files import BagTopic, Storage
from smallwheel_ros.bags import BagReader, BagWriter, Channel
from smallwheel_ros.onboard.parameters import NODE_NAME
from smallwheel_ros.onboard.streams import SECOND
from smallwheel_ros.replay.rows import MOBILITY, SOIL, Estimate, as_bytes

_SOIL_PERIOD = SECOND // 10  # as the node: by stamps, no more than ten times a second


class NewBag:
    """Writes originals as they are and estimates as the node would have published them.

    Use it in a `with` statement: the bag is there when it has ended without an error.

    Attributes
    ----------
    prefix
        Of the topics of the estimates: the node's name, or /replay before it where the bag has
        the node's own estimates already.
    left_out
        Topics that are not copied, since nobody knows their type.
    damaged
        Messages that are not copied, since they cannot be converted.
    """

    def __init__(
        self, path: Path, storage: Storage, reader: BagReader, copied: set[tuple[str, str]]
    ) -> None:
        self._writer = BagWriter(path, storage=storage)
        own = f"/{NODE_NAME}"
        taken = any(topic.name.startswith(f"{own}/") for topic in reader.topics)
        self.prefix = f"/replay{own}" if taken else own
        self.left_out: list[BagTopic] = []
        self._channels: dict[
            tuple[str, str], tuple[Channel, Callable[[bytes], bytes | memoryview]]
        ] = {}
        for topic in reader.topics:
            if (topic.name, topic.type) not in copied:
                continue
            channel = reader.as_channel(topic.name, topic.type)
            if channel is None:
                self.left_out.append(topic)
            else:
                self._channels[topic.name, topic.type] = channel
        self._soil_sent: int | None = None
        self._soil_waits: tuple[Estimate, int] | None = None
        self.damaged = 0

    def __enter__(self) -> NewBag:
        self._writer.__enter__()
        self._mobility = self._writer.add(f"{self.prefix}/mobility", MOBILITY)
        self._soil = self._writer.add(f"{self.prefix}/soil", SOIL, keeps_last=True)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._writer.__exit__(kind, error, trace)

    def copy(self, key: tuple[str, str], log_time: int, data: bytes) -> None:
        """Write a message of the bag, where its topic is copied."""
        found = self._channels.get(key)
        if found is not None:
            channel, convert = found
            try:
                converted = convert(data)
            except Exception:  # damaged bytes of a ROS 1 message make rosbags raise as it likes
                self.damaged += 1
                return
            self._writer.write_bytes(channel, log_time, converted)

    def write(self, estimate: Estimate, log_time: int, frame: str) -> None:
        """Write an estimate; frame: that of odometry."""
        stamp = estimate.stamp
        message = as_bytes(MOBILITY, estimate.mobility, stamp, estimate.wheel)
        self._writer.write_bytes(self._mobility, log_time, message)
        sent = self._soil_sent
        if sent is None or not sent <= stamp < sent + _SOIL_PERIOD:
            self._write_soil(estimate, log_time, frame)
        else:
            self._soil_waits = (estimate, log_time)

    def finish(self, frame: str) -> None:
        """Write the last soil, if it still waits."""
        if self._soil_waits is not None:
            self._write_soil(*self._soil_waits, frame)

    def _write_soil(self, estimate: Estimate, log_time: int, frame: str) -> None:
        stamp = estimate.stamp
        message = as_bytes(SOIL, estimate.soil, stamp, frame)
        self._writer.write_bytes(self._soil, log_time, message)
        self._soil_sent, self._soil_waits = stamp, None
