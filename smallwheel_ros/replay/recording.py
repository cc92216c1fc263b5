# SPDX-License-Identifier: Apache-2.0
"""A bag as the node would have received it: which topic is which input, and runs of the pipeline over it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from smallwheel_ros.bags import BagError, BagReader, DefinitionError, Key, RawMessage
from smallwheel_ros.common.errors import reason
from smallwheel_ros.common.stamps import SECOND
from smallwheel_ros.drive.feed import Message, feed
from smallwheel_ros.onboard.settings import ODOMETRY, NodeSettings
from smallwheel_ros.pipeline.intake.decoder import Decoder, frame_of
from smallwheel_ros.pipeline.intake.inputs import Fields, Rows, Topic, topics_of
from smallwheel_ros.pipeline.pipeline import Pipeline, Turn
from smallwheel_ros.pipeline.tables import Integers
from smallwheel_ros.replay.spec import resolved

# Messages in a block, and its length (ns) in the recording, at most: larger blocks take less time in all.
_BLOCK, _LONGEST = 16_384, 5 * SECOND
_TURNS = 3  # blocks whose ends are remembered: rows wait for the slowest stream
_CLOCK = ("/clock", "rosgraph_msgs/msg/Clock")


class Recording:
    """The inputs of a vehicle in an open bag, and its messages in the order in which they were recorded.

    Parameters
    ----------
    reader
        The open bag.
    settings
        The node's settings.
    pipeline
        Pipeline to whose streams the messages go.
    in_bag
        Function that converts the node's name of a topic to the bag's.
    clock
        Whether stamps are compared with the recorded /clock or, if there is none, with recording times.

    Attributes
    ----------
    used
        Topics and types that are inputs, readable or not, and the clock.
    unusable
        By topic and type, why an input cannot be read, in words.
    time, read
        Log time (ns) of the newest message, and number of messages read.
    frame
        Name of the odometry's frame; empty while unknown.
    damage
        The error at which a damaged bag ended early; None if it did not.
    stopped
        Set it to True to stop reading; messages read before are still processed.
    """

    def __init__(
        self,
        reader: BagReader,
        settings: NodeSettings,
        pipeline: Pipeline,
        in_bag: Callable[[str], str] = resolved,
        *,
        clock: bool = True,
    ) -> None:
        self._reader, self._pipeline, self._by_clock = reader, pipeline, clock
        self.time, self.read, self.frame = reader.start_time or 0, 0, ""
        self.damage: BagError | None = None
        self.stopped = False
        self._topics: dict[str, Topic] = {}  # by their names in the bag
        self._decoders: dict[str, Decoder] = {}
        self._converts: dict[Key, Callable[[bytes], bytes | memoryview]] = {}
        self.unusable: dict[Key, str] = {}
        present = {topic[:2] for topic in reader.topics}
        self._has_clock = clock and _CLOCK in present
        self._clock = 0  # time of the newest /clock message, ns
        for topic in topics_of(settings):
            key = in_bag(topic.name), topic.type
            if key in present:
                self._listen(key, topic)
        self.used = {*self._converts, *self.unusable}
        if self._has_clock:
            self._read_clock = reader.decoder(*_CLOCK)
            self.used.add(_CLOCK)
        of = self._topics.items()
        self._odometry = {name for name, topic in of if ODOMETRY in topic.streams}
        self._newest: list[tuple[int, int]] = []  # stamps at ends of blocks, and log times

    def _listen(self, key: Key, topic: Topic) -> None:
        """Note that a topic of the bag is an input, and how to read it, or why it cannot be read."""
        try:
            self._reader.decoder(*key)
        except DefinitionError as error:
            self.unusable[key] = str(error)
            return
        channel = self._reader.channel(*key)
        if channel is None:
            self.unusable[key] = f"its type {key[1]} is not known"
            return
        name = key[0]
        self._topics[name] = _both(self._topics[name], topic) if name in self._topics else topic
        self._decoders[name] = Decoder(channel.store, channel.type)
        self._converts[key] = channel.convert

    def turns(
        self,
        also: frozenset[str] = frozenset(),
        each: Callable[[RawMessage], object] | None = None,
        block: int = _BLOCK,
    ) -> Iterator[Iterator[Turn]]:
        """Read the bag to its end in blocks, and yield for each block the results of the pipeline (`Turn`).

        Parameters
        ----------
        also
            Names of topics to read in addition to the inputs.
        each
            Called with every message that is read, in order; None: nothing is called.
        block
            Messages in a block, at most; a block also ends after 5 s of the recording.

        Yields
        ------
        iterator of Turn
            Results of the pipeline's turns over a block, none if no rows are complete; computed on demand.

        Raises
        ------
        BagError
            If `each` writes to another bag, and that fails. Damage to this bag is kept in `damage`.
        """
        begin, chunk = self.time, list[Message]()
        by_recording = self._by_clock and not self._has_clock
        try:
            for raw in self._reader.raw_messages({name for name, _ in self.used} | also):
                topic, kind, time, data = raw
                if len(chunk) >= block or not 0 <= time - begin < _LONGEST:
                    yield self._turn(chunk)
                    begin, chunk = time, []
                    if self.stopped:
                        break
                self.time = time
                if each is not None:
                    each(raw)
                self.read += 1
                convert = self._converts.get((topic, kind))
                if convert is not None:
                    try:
                        now = time if by_recording else self._clock
                        chunk.append((topic, bytes(convert(data)), now))
                    except (
                        Exception
                    ) as error:  # damaged bytes of ROS 1 make rosbags raise as it likes
                        self._not_readable(self._topics[topic].streams[0], topic, error)
                elif self._has_clock and (topic, kind) == _CLOCK:
                    self._set_clock(data)
        except BagError as error:
            if error.path != self._reader.path:
                raise  # of a bag that is written
            self.damage = error
        yield self._turn(chunk, last=True)

    def _set_clock(self, data: bytes) -> None:
        topic, _ = _CLOCK
        try:
            clock = self._read_clock(data).clock
        except Exception as error:  # damaged bytes make rosbags raise as it likes
            self._not_readable(topic, topic, error)
            return
        self._clock = clock.sec * SECOND + clock.nanosec

    def _not_readable(self, stream: str, topic: str, error: Exception) -> None:
        self._pipeline.note(stream, "not_readable", f"topic {topic}: {reason(error)}")

    def _turn(self, chunk: list[Message], *, last: bool = False) -> Iterator[Turn]:
        """Feed a block to the pipeline, and return the results of its turns, computed on demand."""
        if chunk:
            feed(self._pipeline, self._topics, self._decoders, chunk)
            of_odometry = (data for topic, data, _ in reversed(chunk) if topic in self._odometry)
            self.frame = next(filter(None, map(frame_of, of_odometry)), self.frame)
            newest = self._pipeline.streams.latest
            before = [pair for pair in self._newest if pair[0] < newest]
            self._newest = [*before[-_TURNS:], (newest, self.time)]
        return self._pipeline.turns(last=last)

    def log_times(self, stamps: Integers) -> Integers:
        """Log times (ns) at which the newest messages had these stamps (ns), interpolated between blocks.

        They are at most the log time of the newest message read.
        """
        known, times = np.array(self._newest or [(self.time, self.time)], dtype=np.int64).T
        since = stamps - known[0]  # as floats, whole nanoseconds of a year are lost
        passed = np.interp(since, known - known[0], times - times[0])
        found = times[0] + np.where(since < 0, since, passed).astype(np.int64)
        return np.asarray(np.minimum(found, self.time))


def turns_of(
    bag: Path,
    settings: NodeSettings,
    block: int = _BLOCK,
    *,
    clock: bool = True,
    remap: Mapping[str, str] | None = None,
) -> Iterator[Turn]:
    """Run the pipeline over a bag, and yield the results of each turn of the pipeline.

    Parameters
    ----------
    bag
        The bag.
    settings
        The node's settings.
    block
        Messages in a block, at most.
    clock
        Whether stamps are compared with the recorded /clock or, if there is none, with recording times.
    remap
        Names of topics in the bag, by the names in the node's parameters.

    Yields
    ------
    Turn
        In the order of time.

    Raises
    ------
    BagError
        If the bag cannot be read; if it is damaged, after the turns of its readable part.
    """
    names = {resolved(name): resolved(other) for name, other in (remap or {}).items()}
    with BagReader(bag) as reader:
        recording = Recording(
            reader,
            settings,
            Pipeline(settings.onboard),
            lambda name: names.get(resolved(name), resolved(name)),
            clock=clock,
        )
        for turns in recording.turns(block=block):
            yield from turns
        if recording.damage is not None:
            raise recording.damage


def _both(one: Topic, other: Topic) -> Topic:
    """Join two inputs that come by the same topic into one."""

    def read(fields: Fields, joints: list[str]) -> Rows:
        return one.read(fields, joints) | other.read(fields, joints)

    return replace(one, read=read, streams=(*one.streams, *other.streams))
