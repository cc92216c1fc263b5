"""The bag with the estimates next to the originals."""

from __future__ import annotations

from pathlib import Path
from types import TracebackType

from smallwheel_ros.bag_files import BagTopic, RawMessage, Storage
from smallwheel_ros.bags import BagReader, BagWriter, Channel
from smallwheel_ros.bags.codec import Convert
from smallwheel_ros.onboard.parameters import NODE_NAME
from smallwheel_ros.onboard.streams import SECOND
from smallwheel_ros.replay.rows import MOBILITY, SOIL, Estimate

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
        Topics that are not copied, since their type cannot be understood.
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
        self._channels: dict[tuple[str, str], tuple[Channel, Convert]] = {}
        for topic in reader.topics:
            if (topic.name, topic.type) not in copied:
                continue
            channel = reader.as_channel(topic.name, topic.type)
            if channel is None:
                self.left_out.append(topic)
            else:
                self._channels[topic.name, topic.type] = channel
        self._soil_sent: int | None = None
        self._soil_waits: tuple[int, object] | None = None
        self.damaged = 0

    def __enter__(self) -> NewBag:
        self._writer.__enter__()
        self._writer.add(f"{self.prefix}/mobility", MOBILITY)
        self._writer.add(f"{self.prefix}/soil", SOIL, keeps_last=True)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._writer.__exit__(kind, error, trace)

    def copy(self, raw: RawMessage) -> None:
        """Write a message of the bag, where its topic is copied."""
        found = self._channels.get((raw.topic, raw.type))
        if found is not None:
            channel, convert = found
            try:
                converted = convert(raw.data)
            except Exception:  # damaged bytes of a ROS 1 message make rosbags raise as it likes
                self.damaged += 1
                return
            self._writer.write_bytes(channel, raw.log_time, converted)

    def write(self, estimate: Estimate, log_time: int, frame: str) -> None:
        """Write an estimate; frame: that of odometry."""
        stamp = estimate.result.mobility.stamp
        mobility, soil = estimate.messages(frame)
        self._writer.write(f"{self.prefix}/mobility", MOBILITY, log_time, mobility)
        self._soil_waits = (log_time, soil)
        sent = self._soil_sent
        if sent is None or not sent <= stamp < sent + _SOIL_PERIOD:
            self._soil_sent = stamp
            self.finish()

    def finish(self) -> None:
        """Write the last soil, if it still waits."""
        if self._soil_waits is not None:
            self._writer.write(f"{self.prefix}/soil", SOIL, *self._soil_waits)
            self._soil_waits = None
