"""Replay one bag: read it, estimate, write everything."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Generator
from pathlib import Path

from smallwheel_ros.bag_files import BagError, Storage, reason, storage_kind
from smallwheel_ros.bags import BagReader, FieldError, FieldReader
from smallwheel_ros.onboard.feed import Feed, Fields, Taker, Topic
from smallwheel_ros.onboard.onboard import Onboard, Result
from smallwheel_ros.onboard.parameters import NodeSettings
from smallwheel_ros.onboard.streams import SECOND
from smallwheel_ros.replay.blocks import Blocks
from smallwheel_ros.replay.document import document
from smallwheel_ros.replay.errors import ReplayError
from smallwheel_ros.replay.inputs import (
    CLOCK,
    Missing,
    check_enough,
    inputs_of,
    missing_inputs,
    resolved,
)
from smallwheel_ros.replay.new_bag import NewBag
from smallwheel_ros.replay.outputs import Outputs
from smallwheel_ros.replay.places import Places
from smallwheel_ros.replay.record import Record
from smallwheel_ros.replay.result import Replayed
from smallwheel_ros.replay.rows import columns
from smallwheel_ros.replay.spec import ReplaySpec
from smallwheel_ros.replay.table_files import TableFiles
from smallwheel_ros.replay.topics import proposal_text
from smallwheel_ros.stop import Stop

Key = tuple[str, str]
_STEP = 256  # messages between two looks at signals, problems and progress
_CLOCK_TYPE = "rosgraph_msgs/msg/Clock"
_CLOCK_FIELDS = ("clock.sec", "clock.nanosec")
_BY_CLOCK = ("stamp_in_future", "stamp_too_old")
_HINT = (
    "header stamps are far from the times of recording, so most messages were refused, as the node"
    " would refuse them; with --no-clock stamps are judged only by each other"
)


def replay(
    spec: ReplaySpec,
    *,
    progress: Callable[[int, int], None] = lambda _done, _all: None,
    report: Callable[[Replayed, Path], None] = lambda _result, _path: None,
) -> Replayed:
    """Replay one bag into the spec's folder.

    Parameters
    ----------
    progress
        Called now and then with the messages done and all.
    report
        Called with the result and a path before the replay counts as done, to write a page.

    Returns
    -------
    Replayed
        Also where the bag is damaged or somebody interrupts: with what there was until then.

    Raises
    ------
    BagError
        If nothing can be read, or the new bag cannot be written.
    ParametersError
        If the parameter file cannot be used.
    ReplayError
        If nothing can be estimated from the bag, or a file cannot be written.
    """
    settings, notes = spec.settings()
    places, stop = Places(spec), Stop()
    with BagReader(spec.bag, salvage=True) as reader, stop.listening():
        session = _Session(spec, settings, notes, reader)
        if places.begin():
            text = "an earlier replay into this folder was not finished; it is done anew"
            session.result.notes.append(text)
        with TableFiles(places.estimates, columns()) as table:
            bag = NewBag(places.bag, _storage(spec), reader, session.copied)
            with bag:
                session.run(table, bag, stop, progress)
        result = session.result
        places.write_measurements(result.blocks)
        report(result, places.report)
        places.finish(document(result, places.files()))
    return result


def _storage(spec: ReplaySpec) -> Storage:
    """Storage of the new bag: that of the old one, so that its readers read this one too."""
    files = list(spec.bag.iterdir()) if spec.bag.is_dir() else [spec.bag]
    return "sqlite3" if any(storage_kind(file) == ".db3" for file in files) else "mcap"


class _Session:
    def __init__(
        self, spec: ReplaySpec, settings: NodeSettings, notes: list[str], reader: BagReader
    ) -> None:
        onboard = Onboard(settings.onboard)
        if settings.soil_file:
            notes = [*notes, "soil_file is not read: a replay begins with the configured soil"]
        self._feed = Feed(onboard, settings)
        inputs = inputs_of(self._feed.topics, spec.remaps)
        topics = reader.topics
        if not reader.message_count or reader.start_time is None or reader.end_time is None:
            raise ReplayError(f"bag {spec.bag} has no messages: nothing can be estimated")
        missing = missing_inputs(inputs, topics)
        hint = proposal_text(reader, inputs, spec.bag) if missing else ""
        check_enough(onboard, missing, hint)
        self._reader, self._onboard = reader, onboard
        self._takers: dict[Key, list[tuple[FieldReader, Taker]]] = {}
        for topic in self._feed.topics:
            name = resolved(topic.name)
            self._take_from((spec.remaps.get(name, name), topic.type), topic)
        clock = (CLOCK, _CLOCK_TYPE)
        self._clock: int | None = None
        present = {(topic.name, topic.type) for topic in topics}
        used = {key for key in (*self._takers, clock) if key in present}
        self._has_clock = spec.clock and clock in present
        if self._has_clock:
            self._take_from(clock, Topic(CLOCK, _CLOCK_TYPE, {}, _CLOCK_FIELDS, self._on_clock))
        self.copied: set[Key] = {"all": present, "used": used, "none": set()}[spec.copy]
        self._read = {name for name, _ in used | self.copied}
        total = sum(t.message_count for t in topics if t.name in self._read)
        self.result = Replayed(
            spec=spec,
            settings=settings,
            notes=list(notes),
            inputs=inputs,
            missing=missing,
            topics=topics,
            start=reader.start_time,
            end=reader.end_time,
            message_count=total,
            onboard=onboard,
            record=Record(onboard, reader.start_time),
            blocks=Blocks(settings.onboard.wheels, bool(settings.onboard.with_drawbar_pull)),
        )

    def _take_from(self, key: Key, topic: Topic) -> None:
        names = topic.fields + topic.newer
        fields = self._reader.field_reader(topic.type, names, topic.values_of)
        assert fields is not None, "types of inputs are known here"
        self._takers.setdefault(key, []).append((fields, topic.take))

    def run(
        self, table: TableFiles, bag: NewBag, stop: Stop, progress: Callable[[int, int], None]
    ) -> None:
        """Read the bag to its end, its damage, or a signal."""
        result, total = self.result, self.result.message_count
        time = result.start
        outputs = Outputs(table, bag, result.record, result.blocks, result.start)
        messages = self._messages(outputs)
        try:
            for time in messages:
                result.messages_read += 1
                if result.messages_read % _STEP == 0:
                    outputs.write()
                    result.record.take_problems(time)
                    progress(result.messages_read, total)
                    if stop.asked:
                        result.state = "interrupted"
                        result.ended = (
                            f"stopped by {stop.asked} {(time - result.start) / SECOND:.3f} s after"
                            f" the bag's beginning, after {result.messages_read} of {total}"
                            " messages; the same command does all of it"
                        )
                        break
        except BagError as error:
            if error.path != result.spec.bag:
                raise  # not of the bag that is read: the new one cannot be written
            result.state = "ended_early"
            result.ended = str(error)
        finally:
            with contextlib.suppress(BagError):
                messages.close()
        outputs.add(self._onboard.flush(), time, self._feed.odometry_frame)
        outputs.write()
        bag.finish(self._feed.odometry_frame)
        result.record.take_problems(time)
        result.record.finish()
        result.blocks.finish()
        result.end = max(time, result.start) if result.state != "complete" else result.end
        result.prefix, result.left_out = bag.prefix, bag.left_out
        if bag.damaged:
            result.notes.append(f"{bag.damaged} damaged messages are not in the new bag")
        lost = {entry.input.stream for entry in result.missing}
        result.missing += [
            Missing(item, "never in a message")
            for item in result.inputs
            if item.stream not in lost and not self._onboard.received[item.stream]
        ]
        if result.spec.clock and self._most_are_refused_by_the_clock():
            result.notes.append(_HINT)
        progress(result.messages_read, total)

    def _most_are_refused_by_the_clock(self) -> bool:
        counts = self._onboard.counts
        refused = sum(n for (_, why), n in counts.items() if why in _BY_CLOCK)
        return 2 * refused > self._onboard.received.total()

    def _messages(self, outputs: Outputs) -> Generator[int, None, None]:
        """Work on one message after the other; gives their log times."""
        takers, copied = self._takers, self.copied
        by_recording = self.result.spec.clock and not self._has_clock
        for topic, kind, log_time, data in self._reader.raw_messages(self._read):
            key = (topic, kind)
            if key in copied:
                outputs.copy(key, log_time, data)
            for fields, take in takers.get(key, ()):
                try:
                    values = fields(data)
                except Exception as error:  # damaged bytes make rosbags raise as it likes
                    self._cannot_read(key, error)
                    break
                found = take(values, log_time if by_recording else self._clock)
                if found:
                    outputs.add(found, log_time, self._feed.odometry_frame)
            yield log_time

    def _on_clock(self, values: Fields, _: int | None) -> list[Result]:
        sec, nanosec = values
        self._clock = sec * SECOND + nanosec
        return []

    def _cannot_read(self, key: Key, error: Exception) -> None:
        """Count a message; raises ReplayError if the bag defines its type otherwise than here."""
        if isinstance(error, FieldError):
            topic, kind = key
            raise ReplayError(
                f"topic {topic}: the bag's definition of {kind} is another one than here ({error}):"
                " record it with this version of the message"
            ) from error
        text = f"a message cannot be deserialised ({reason(error)})"
        streams = (i.stream for i in self.result.inputs if (i.topic, i.type) == key)
        self._onboard.report(next(streams, key[0]), "undecodable", text)
