# SPDX-License-Identifier: Apache-2.0
"""Replay one bag: its messages go to the estimator as the node would give them, and all is written."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from smallwheel_ros.bags import BagError, BagReader, DefinitionError, Key, RawMessage
from smallwheel_ros.common.errors import reason
from smallwheel_ros.common.stop import Stop
from smallwheel_ros.common.tables import write_json
from smallwheel_ros.costmap.cost_map import COST_PERIOD, CostMap
from smallwheel_ros.costmap.grid import wide, write_map
from smallwheel_ros.onboard.robot_description import DESCRIPTION_TYPE
from smallwheel_ros.onboard.settings import ODOMETRY
from smallwheel_ros.pipeline.answers import margin_before_driving, mobility_columns, soil_fields
from smallwheel_ros.pipeline.bag import Decoder
from smallwheel_ros.pipeline.events import DriveEvents
from smallwheel_ros.pipeline.ground_map import GroundMapper
from smallwheel_ros.pipeline.identifiability import SoilEstimate
from smallwheel_ros.pipeline.inputs import Fields, Rows, Topic, topics_of
from smallwheel_ros.pipeline.pipeline import Pipeline, Turn
from smallwheel_ros.pipeline.replay import Message, feed
from smallwheel_ros.pipeline.soil_file import SoilFile
from smallwheel_ros.pipeline.tables import SECOND, Integers
from smallwheel_ros.replay.new_bag import NewBag
from smallwheel_ros.replay.result import (
    BAG,
    ESTIMATES,
    FILES,
    MEASUREMENTS,
    SUMMARY,
    TWISTS,
    Replayed,
    draft,
)
from smallwheel_ros.replay.spec import (
    ReplayError,
    ReplaySpec,
    check_enough,
    inputs_of,
    read_settings,
)
from smallwheel_ros.replay.tables import EstimatesTable, SteadyStretches, TwistsTable, deviations

Progress = Callable[[int, int], object]
Report = Callable[[Replayed, Path], object]  # writes a page of what is in the folder of that path
_BLOCK = 4096  # messages of a turn at most; one takes a second of the recording, as often as the node speaks
_CLOCK = ("/clock", "rosgraph_msgs/msg/Clock")
_BY_CLOCK = ("stamp_in_future", "stamp_too_old")
_HINT = (
    "header stamps are far from the times of recording, so most messages were refused, as the node"
    " would refuse them; with --no-clock stamps are judged only by each other"
)


def replay(
    spec: ReplaySpec,
    *,
    progress: Progress = lambda _done, _all: None,
    report: Report = lambda _result, _folder: None,
) -> Replayed:
    """Replay one bag into the spec's folder; also one that is damaged, or until somebody interrupts.

    progress: called now and then with the messages done and all. report: writes a page, before the
    replay counts as done.

    Raises BagError if nothing can be read, or the new bag cannot be written; ParametersError if the
    parameter file cannot be used; ReplayError if nothing can be estimated from the bag, or a file cannot
    be written.
    """
    stop = Stop()
    with BagReader(spec.bag) as reader, stop.listening():
        drive = _Drive(spec, reader)
        with draft(spec) as folder:
            bag = NewBag(folder / BAG, reader, drive.copied)
            wheels = drive.wheels
            with EstimatesTable(folder / ESTIMATES, drive.start, wheels) as table, bag:
                result = drive.run(table, bag, stop, progress)
            drive.twists.write(folder / TWISTS)
            measured = result.stretches.table()
            result.measurements = len(measured)
            if result.measurements:
                measured.to_csv(folder / MEASUREMENTS, index=False)
            if result.state != "interrupted" and (saved := drive.save_soil()):
                result.notes.append(saved)
            drive.write_map(folder / FILES["cost_map"])
            report(result, folder)
            write_json(str(folder / SUMMARY), result.to_dict(folder))
    return result


class _Drive:
    """One run of the estimator over an open bag. copied: topics that go into the new bag."""

    def __init__(self, spec: ReplaySpec, reader: BagReader) -> None:
        self._spec, self._reader = spec, reader
        self._settings, self._notes = read_settings(spec, reader)
        if not reader.message_count or reader.start_time is None:
            raise ReplayError(f"bag {spec.bag} has no messages: nothing can be estimated")
        if self._settings.soil_file and spec.soil_file is None:
            self._notes.append(
                "soil.file is the node's, and not read: give --soil-file to go on from it"
            )
        if self._settings.onboard.unknown_positions:
            self._notes.append(self._settings.onboard.unknown_positions)
        self.start = self._time = reader.start_time  # log times, of the message that is worked on
        onboard = self._settings.onboard
        self.wheels = [wheel.name for wheel in onboard.wheels]
        self._pipeline = Pipeline(onboard)
        cost_map = CostMap(self._settings.cost, onboard.wheels, margin_before_driving(onboard))
        self._ground = GroundMapper(cost_map, onboard.wheels)
        self._soil_file = SoilFile(str(spec.soil_file or ""))
        self._go_on()
        self._happened = DriveEvents(self._pipeline, self.start)
        pull_std = onboard.noise.drawbar_pull if onboard.with_drawbar_pull else None
        self._stretches = SteadyStretches(onboard.wheels, pull_std)
        self.twists = TwistsTable(self.start)
        self._soils: list[tuple[SoilEstimate, dict[str, Any]]] = []  # with its fields
        self._fields: tuple[str, ...] = ()
        self._frame = ""  # of odometry
        self._clock, self._last_stamp = 0, 0
        self._chunk: list[Message] = []
        self._read_topics(spec)

    def _go_on(self) -> None:
        """Go on from a saved soil and map. Raises ReplayError where there is one that cannot be used."""
        restored = self._soil_file.restore(self._pipeline)
        if self._soil_file.problem:
            raise ReplayError(f"{self._soil_file.problem}; give another file with --soil-file")
        remembered = self._soil_file.restore_map(self._ground.map)
        self._notes += [text for text in (restored, remembered) if text]

    def save_soil(self) -> str:
        """Save the soil where the spec says; return in words what came of it, empty where it says nothing."""
        if self._spec.soil_file is None:
            return ""
        saved, words = self._soil_file.save(self._pipeline, self._ground.map)
        return f"soil saved: {words}" if saved else words

    def _read_topics(self, spec: ReplaySpec) -> None:
        """Find out which topic is which input, and what is copied."""
        present = {topic[:2] for topic in self._reader.topics}
        self._has_clock = spec.clock and _CLOCK in present
        self._topics: dict[str, Topic] = {}  # by their names in the bag
        self._decoders: dict[str, Decoder] = {}
        self._converts: dict[Key, Callable[[bytes], bytes | memoryview]] = {}
        unusable = {}  # those that the bag defines otherwise
        topics = topics_of(self._settings)
        for topic in topics:
            key = name, kind = spec.in_bag(topic.name), topic.type
            if key not in present:
                continue
            try:
                self._reader.decoder(*key)
            except DefinitionError as error:
                unusable[key] = str(error)
                continue
            channel = self._reader.channel(*key)
            if channel is None:
                unusable[key] = f"its type {kind} is not known"
                continue
            self._topics[name] = _both(self._topics[name], topic) if name in self._topics else topic
            self._decoders[name] = Decoder(channel.store, channel.type)
            self._converts[key] = channel.convert
        if self._has_clock:
            self._read_clock = self._reader.decoder(*_CLOCK)
        self._inputs = inputs_of(spec, topics, self._settings, self._reader, unusable)
        check_enough(self.wheels, self._inputs, self._reader)
        described = (spec.in_bag(self._settings.robot_description_topic), DESCRIPTION_TYPE)
        keys = {(spec.in_bag(topic.name), topic.type) for topic in topics}
        used = {_CLOCK, described, *keys} & present
        self.copied: set[Key] = {"all": present, "used": used, "none": set()}[spec.copy]
        self._names = {name for name, _ in used | self.copied}

    def run(self, table: EstimatesTable, bag: NewBag, stop: Stop, progress: Progress) -> Replayed:
        """Read the bag to its end, its damage, or a signal."""
        self._table, self._bag = table, bag
        total = sum(t.message_count for t in self._reader.topics if t.name in self._names)
        read, state, ended, begin = 0, "complete", "", self.start
        try:
            for raw in self._reader.raw_messages(self._names):
                full = len(self._chunk) >= _BLOCK or not 0 <= raw.log_time - begin < SECOND
                if full:
                    self._turn()
                    begin = raw.log_time
                    progress(read, total)
                    if stop.asked:
                        since = (self._time - self.start) / SECOND
                        state = "interrupted"
                        ended = (
                            f"stopped by {stop.asked} {since:.3f} s after the bag's beginning, after"
                            f" {read} of {total} messages; the same command does all of it"
                        )
                        break
                self._time = raw.log_time
                bag.copy_message(raw)
                self._keep(raw)
                read += 1
        except BagError as error:
            if error.path != self._reader.path:
                raise  # of the new bag
            state, ended = "ended_early", str(error)
        self._turn(last=True)
        if self._last_stamp and self._ground.map.changed:
            self._write_grid(self._last_stamp)
        bag.write_soil()
        self._happened.finish()
        progress(read, total)
        whole = state == "complete" and self._reader.end_time is not None
        return Replayed(
            spec=self._spec,
            settings=self._settings,
            notes=[*self._spec.notes, *self._notes, *self._hints()],
            inputs=self._seen_inputs(),
            start=self.start,
            end=(self._reader.end_time or 0) if whole else max(self._time, self.start),
            message_count=total,
            pipeline=self._pipeline,
            happened=self._happened,
            estimates=table,
            stretches=self._stretches,
            state=state,
            ended=ended,
            messages_read=read,
            prefix=bag.prefix,
            has_twists=bag.has_twists,
            left_out=bag.left_out,
        )

    def _keep(self, raw: RawMessage) -> None:
        """Keep a message for the next turn, if it is an input."""
        key = (raw.topic, raw.type)
        if key == _CLOCK and self._has_clock:
            try:
                clock = self._read_clock(raw.data).clock
            except Exception as error:  # as below
                self._pipeline.note(
                    raw.topic, "not_readable", f"topic {raw.topic}: {reason(error)}"
                )
                return
            self._clock = clock.sec * SECOND + clock.nanosec
            return
        if key not in self._converts:
            return
        try:
            data = bytes(self._converts[key](raw.data))
        except (
            Exception
        ) as error:  # damaged bytes of a ROS 1 message make rosbags raise as it likes
            stream, text = self._topics[raw.topic].streams[0], reason(error)
            self._pipeline.note(stream, "not_readable", f"topic {raw.topic}: {text}")
            return
        by_recording = self._spec.clock and not self._has_clock
        self._chunk.append((raw.topic, data, raw.log_time if by_recording else self._clock))
        if ODOMETRY in self._topics[raw.topic].streams:
            self._frame = _frame_of(data) or self._frame

    def _turn(self, *, last: bool = False) -> None:
        """Give what was kept to the pipeline, and write what it makes."""
        if self._chunk:
            feed(self._pipeline, self._topics, self._decoders, self._chunk)
            self._chunk = []
        for turn in self._pipeline.turns(last=last):
            self._write(turn)
        self._happened.take_problems(self._time)

    def _write(self, turn: Turn) -> None:
        """Write a turn into tables and bag, and lay it down on the map."""
        if turn.starts_over:
            self._stretches.starts_over()
        changing = self._happened.take(turn)
        self._stretches.add(turn.readings, changing)

        def times(stamps: Integers) -> Integers:
            """When the turn was: what is recorded stays in its order."""
            return np.full(stamps.size, self._time, dtype=np.int64)

        if turn.twists is not None and len(turn.twists):
            assert self._settings.onboard.twist is not None
            self.twists.add(turn.twists)
            self._bag.write_twists(
                turn.twists, self._settings.onboard.twist, times(turn.twists.stamp)
            )
        rows = turn.estimates
        if not len(rows):
            return
        due = turn.readings.due
        soils, soil_of = self._told(), self._happened.soil_of[due]
        columns = mobility_columns(rows, self._pipeline)
        columns["status_text"] = np.array(columns["status_text"], dtype=object)
        self._table.add(rows, turn.readings.speed[due], columns, soils, soil_of)
        plain = [{name: soil[name] for name in self._fields} for soil in soils]
        rejected = rows.rejected.tolist()
        of_rows = [
            plain[k] | {"measurements_rejected": rejected[i]}
            for i, k in enumerate(soil_of.tolist())
        ]
        self._bag.write_estimates(
            rows, columns, of_rows, times(rows.stamp), self._frame, self.wheels
        )
        self._ground.add(rows, self._frame)
        self._last_stamp = int(rows.stamp[-1])
        period = round(COST_PERIOD * SECOND)
        if self._ground.map.changed and self._bag.is_due("cost", self._time, period):
            self._write_grid(self._last_stamp)

    def _told(self) -> list[dict[str, Any]]:
        """What is told of the soils of the newest turn."""
        told = []
        for soil in self._happened.soils:
            known = next((fields for one, fields in self._soils if one is soil), None)
            if known is None:
                plain = soil_fields(soil, rejected=0)
                self._fields = tuple(plain)
                known = plain | deviations(soil) | {"changes": soil.soil_changes}
            told.append(known)
        self._soils = list(zip(self._happened.soils, told, strict=True))
        return told

    def _write_grid(self, stamp: int) -> None:
        """Write the grid as the node would have published it."""
        grid = self._ground.map.grid()
        if grid is not None:
            self._bag.write_grid(grid, stamp, self._time)

    def write_map(self, path: Path) -> None:
        """Write all that was crossed, also what the window has left behind, for map_server."""
        whole = self._ground.map.whole()
        if whole is not None:
            write_map(path, wide(whole, self._ground.map.spread))

    def _hints(self) -> list[str]:
        """What is to be said of stamps, and of messages that were damaged."""
        streams, notes = self._pipeline.streams, []
        if self._bag.damaged:
            notes.append(f"{self._bag.damaged} damaged messages are not in the new bag")
        refused = sum(n for (_, why), n in streams.problems.items() if why in _BY_CLOCK)
        if self._spec.clock and 2 * refused > sum(s.received for s in streams.all.values()):
            notes.append(_HINT)
        return notes

    def _seen_inputs(self) -> tuple[Any, ...]:
        """The inputs, those that never came marked as lacking."""
        streams = self._pipeline.streams
        return tuple(
            item
            if item.lacking or streams.all[item.stream].received
            else replace(
                item, lacking=streams.words.get((item.stream, "no_value")) or "never in a message"
            )
            for item in self._inputs
        )


def _both(one: Topic, other: Topic) -> Topic:
    """A topic that two inputs come by."""

    def read(fields: Fields, joints: list[str]) -> Rows:
        return one.read(fields, joints) | other.read(fields, joints)

    return replace(one, read=read, streams=(*one.streams, *other.streams))


def _frame_of(message: bytes) -> str:
    """frame_id of a serialised message that begins with a header: behind encapsulation and stamp."""
    order: Literal["little", "big"] = "big" if message[1:2] == b"\0" else "little"
    end = 16 + int.from_bytes(message[12:16], order) - 1
    return message[16:end].decode(errors="replace")
