"""Read bags: rosbag2 (mcap, sqlite3) and ROS 1, whole or, where asked, damaged."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Collection, Generator, Iterator, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

from smallwheel_ros.bag_files import (
    REPAIR,
    BagError,
    BagMessage,
    BagTopic,
    RawMessage,
    check_is_bag,
    reason,
)
from smallwheel_ros.bags.field_reader import FieldReader, Fields
from smallwheel_ros.bags.library import Channel
from smallwheel_ros.bags.salvage import SalvageSource, unfinished_log
from smallwheel_ros.bags.source import RosbagsSource, Source


class BagReader:
    """An open bag; use it in a `with` statement.

    Parameters
    ----------
    path
        A rosbag2 folder, one ``.mcap`` or ``.db3`` file (or one of these with ``.zstd`` behind it),
        or a ROS 1 ``.bag`` file.
    salvage
        Read what is left of a bag that is damaged, was not closed, or lacks metadata or a file;
        `damage` then says what is wrong. Without it such a bag is an error at once.

    Raises
    ------
    BagError
        If there is no bag at `path`, or it is damaged so that nothing can be read.
    """

    def __init__(self, path: Path | str, *, salvage: bool = False) -> None:
        self.path = Path(path)
        self._salvage = salvage
        check_is_bag(self.path, needs_metadata=not salvage)
        self._source: Source | None = None

    def __enter__(self) -> BagReader:
        # A damaged file makes rosbags raise almost anything (struct.error, IndexError, KeyError,
        # AssertionError, database errors), so everything that is an Exception is meant here.
        try:
            if unfinished_log(self.path):
                raise EOFError(f"{unfinished_log(self.path)} holds messages of a killed recorder")
            self._source = RosbagsSource(self.path)
        except Exception as error:
            # One foreign definition that rosbags does not understand is no damage: a scan reads it.
            source = SalvageSource(self.path)
            why = reason(error) if self.path.suffix != ".zstd" else source.damage
            if (source.damage and not self._salvage) or not (source.topics or source.sound):
                source.close()
                unreadable = BagError(self.path, f"cannot be read ({why}); {REPAIR}")
                raise unreadable from error
            self._source = source
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        assert self._source is not None
        with contextlib.suppress(Exception):
            self._source.close()
        self._source = None

    @property
    def _open(self) -> Source:
        assert self._source is not None, "use BagReader in a with statement"
        return self._source

    @property
    def topics(self) -> tuple[BagTopic, ...]:
        """What is in the bag, by name; a topic with two types is there twice."""
        codec = self._open.codec
        return tuple(
            BagTopic(name, kind, topic.messages, codec.store_of(kind) is not None)
            for (name, kind), topic in self._open.topics.items()
        )

    @property
    def damage(self) -> str:
        """What is wrong with the bag as a whole, empty where nothing is; needs `salvage`."""
        return self._open.damage

    @property
    def is_ros2(self) -> bool:
        """False for a bag of ROS 1."""
        return self._open.codec.ros2

    @property
    def message_count(self) -> int:
        """Number of messages in the bag."""
        return sum(topic.messages for topic in self._open.topics.values())

    @property
    def start_time(self) -> int | None:
        """Log time of the first message (ns), None when the bag is empty."""
        return self._open.start_time

    @property
    def end_time(self) -> int | None:
        """Log time of the last message (ns), None when the bag is empty."""
        return self._open.end_time

    def decoder(self, kind: str) -> Callable[[bytes], Any] | None:
        """Return what makes a message of the bytes of a type; None for one that nobody knows."""
        return self._open.codec.decoder(kind)

    def field_reader(
        self, kind: str, names: Sequence[str], values_of: Callable[[Any], Fields]
    ) -> FieldReader | None:
        """Return what reads fields of the bytes of a type; None for one that nobody knows.

        For its parameters see `FieldReader`.
        """
        codec = self._open.codec
        store = codec.store_of(kind)
        return None if store is None else FieldReader(store, kind, codec.ros2, names, values_of)

    def as_channel(
        self, topic: str, kind: str
    ) -> tuple[Channel, Callable[[bytes], bytes | memoryview]] | None:
        """Return a topic as `BagWriter.write_bytes` takes it, and what its bytes become there.

        None for a type whose definition is neither in the bag nor known here.
        """
        entry = self._open.topics[topic, kind]
        return self._open.codec.as_channel(topic, kind, entry.qos)  # type: ignore[arg-type]

    def messages(
        self,
        topics: Collection[str] | None = None,
        *,
        start: int | None = None,
        stop: int | None = None,
    ) -> Iterator[BagMessage]:
        """Give messages in the order of their log times.

        Header stamps may come in another order. Arrays in a message are read-only.

        Parameters
        ----------
        topics
            Only these; None means all whose definition is known.
        start, stop
            Only log times from `start` on and before `stop` (ns).

        Raises
        ------
        BagError
            If a wanted topic's definition is unknown, or, after the readable messages have been
            given, where the bag is damaged.
        """
        decoders: dict[str, Callable[[bytes], Any]] = {}
        readable = set()
        for name, kind in self._keys(topics):
            decoder = self.decoder(kind)
            if decoder is not None:
                decoders[kind] = decoder
                readable.add((name, kind))
            elif topics is not None:
                raise BagError(
                    self.path,
                    f"topic {name} has type {kind}, whose definition is neither in the bag nor"
                    " known here; record the bag with its definitions (mcap does)",
                )
        for read, (topic, kind, time, data) in enumerate(self._stream(readable, start, stop)):
            try:
                message = decoders[kind](data)
            except Exception as error:
                raise self.damaged(error, read, time, topic) from error
            yield BagMessage(topic, kind, time, message)

    def raw_messages(
        self,
        topics: Collection[str] | None = None,
        *,
        start: int | None = None,
        stop: int | None = None,
    ) -> Generator[RawMessage, None, None]:
        """Give messages without deserialising them; otherwise like `messages`."""
        return self._stream(self._keys(topics), start, stop)

    def _keys(self, topics: Collection[str] | None) -> set[tuple[str, str]]:
        return {key for key in self._open.topics if topics is None or key[0] in topics}

    def _stream(
        self, wanted: set[tuple[str, str]], start: int | None, stop: int | None
    ) -> Generator[RawMessage, None, None]:
        read, message = 0, None
        try:
            for message in self._open.stream(wanted, start, stop):
                yield message
                read += 1
        except Exception as error:
            last = None if message is None else message.log_time
            raise self.damaged(error, read, last) from error
        last = None if message is None else message.log_time
        if self._open.damage:
            raise self.damaged(EOFError(self._open.damage), read, last)
        # Damage inside a chunk can make rosbags skip messages without a word: count them.
        expected = sum(self._open.topics[key].messages for key in wanted)
        if start is None and stop is None and read < expected:
            raise self.damaged(EOFError(f"{expected - read} of {expected} are lost"), read, last)

    def damaged(
        self, error: Exception, read: int, last: int | None, topic: str | None = None
    ) -> BagError:
        """Return the error of a bag that is damaged after so many messages."""
        where = f" on topic {topic}" if topic else ""
        until = f", the last at {last / 1e9:.3f} s" if last is not None else ""
        return BagError(
            self.path,
            f"damaged{where} after {read} messages{until} ({reason(error)}); what came before is"
            " good",
            messages_read=read,
            last_log_time=last,
        )
