# SPDX-License-Identifier: Apache-2.0
"""Replay one bag: its messages go to the estimator as the node would give them, and all is written."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from smallwheel_ros.bags import BagError, BagReader, DefinitionError, Key, RawMessage
from smallwheel_ros.common.errors import reason
from smallwheel_ros.common.stop import Stop
from smallwheel_ros.common.tables import write_json
from smallwheel_ros.costmap.cost_map import CostMap
from smallwheel_ros.costmap.grid import wide, write_map
from smallwheel_ros.estimator.reading import SECOND, Reading
from smallwheel_ros.onboard.events import DriveEvents
from smallwheel_ros.onboard.feed import Feed
from smallwheel_ros.onboard.ground import GroundMapper, margin_before_driving
from smallwheel_ros.onboard.onboard import Onboard
from smallwheel_ros.onboard.result import Result, mobility_fields, soil_fields
from smallwheel_ros.onboard.robot_description import DESCRIPTION_TYPE
from smallwheel_ros.onboard.soil_file import SoilFile
from smallwheel_ros.replay.new_bag import NewBag
from smallwheel_ros.replay.result import (
    BAG,
    ESTIMATES,
    FILES,
    MEASUREMENTS,
    SUMMARY,
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
from smallwheel_ros.replay.tables import EstimatesTable, SteadyStretches, deviations

Progress = Callable[[int, int], object]
Report = Callable[[Replayed, Path], object]  # writes a page of what is in the folder of that path
JOINTS = "sensor_msgs/msg/JointState"
_STEP = 256  # messages between two looks at signals, problems and progress
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
            with EstimatesTable(folder / ESTIMATES, drive.start) as table, bag:
                result = drive.run(table, bag, stop, progress)
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
        self._onboard = Onboard(onboard)
        self._feed = Feed(self._onboard, self._settings)
        self._ground = GroundMapper(
            CostMap(self._settings.cost, onboard.wheels, margin_before_driving(onboard))
        )
        self._soil_file = SoilFile(str(spec.soil_file or ""))
        self._go_on()
        self._happened = DriveEvents(self._onboard, self.start)
        self._stretches = SteadyStretches(onboard.wheels, bool(onboard.with_drawbar_pull))
        self._last_stamp = 0
        self._soil: dict[str, Any] = {}
        self._soil_state: tuple[Any, ...] = ()
        self._clock: int | None = None
        self._read_topics(spec)

    def _go_on(self) -> None:
        """Go on from a saved soil and map. Raises ReplayError where there is one that cannot be used."""
        restored = self._soil_file.restore(self._onboard)
        if self._soil_file.problem:
            raise ReplayError(f"{self._soil_file.problem}; give another file with --soil-file")
        remembered = self._soil_file.restore_map(self._ground.map)
        self._notes += [text for text in (restored, remembered) if text]

    def save_soil(self) -> str:
        """Save the soil where the spec says; return in words what came of it, empty where it says nothing."""
        if self._spec.soil_file is None:
            return ""
        saved, words = self._soil_file.save(self._onboard, self._ground.map)
        return f"soil saved: {words}" if saved else words

    def _read_topics(self, spec: ReplaySpec) -> None:
        """Find out which topic is which input, and what is copied."""
        present = {topic[:2] for topic in self._reader.topics}
        self._has_clock = spec.clock and _CLOCK in present
        self._decoders: dict[Key, Callable[[bytes], Any]] = {}
        self._handlers: dict[Key, list[Callable[[Any, int | None], object]]] = {}
        unusable = {}  # those that the bag defines otherwise
        for topic in self._feed.topics:
            key = spec.in_bag(topic.name), topic.type
            self._handlers.setdefault(key, []).append(topic.handle)
        if self._has_clock:
            self._handlers[_CLOCK] = [self._on_clock]
        for key in self._handlers.keys() & present:
            try:
                self._decoders[key] = self._reader.decoder(*key)
            except DefinitionError as error:
                unusable[key] = str(error)
        self._inputs = inputs_of(spec, self._feed, self._reader, unusable)
        wheels = [wheel.name for wheel in self._settings.onboard.wheels]
        check_enough(wheels, self._inputs, self._reader)
        described = (spec.in_bag(self._settings.robot_description_topic), DESCRIPTION_TYPE)
        used = {_CLOCK, described, *self._handlers} & present
        self.copied: set[Key] = {"all": present, "used": used, "none": set()}[spec.copy]
        self._names = {name for name, _ in used | self.copied}

    def run(self, table: EstimatesTable, bag: NewBag, stop: Stop, progress: Progress) -> Replayed:
        """Read the bag to its end, its damage, or a signal."""
        self._table, self._bag, onboard = table, bag, self._onboard
        onboard.on_result, onboard.on_reading = self._write, self._on_reading
        total = sum(t.message_count for t in self._reader.topics if t.name in self._names)
        read, state, ended = 0, "complete", ""
        try:
            for raw in self._reader.raw_messages(self._names):
                self._time = raw.log_time
                bag.copy_message(raw)
                self._take(raw)
                read += 1
                if read % _STEP == 0:
                    self._happened.take_problems(self._time)
                    progress(read, total)
                    if stop.asked:
                        since = (self._time - self.start) / SECOND
                        state, ended = (
                            "interrupted",
                            (
                                f"stopped by {stop.asked} {since:.3f} s after the bag's beginning, after"
                                f" {read} of {total} messages; the same command does all of it"
                            ),
                        )
                        break
        except BagError as error:
            if error.path != self._reader.path:
                raise  # of the new bag
            state, ended = "ended_early", str(error)
        onboard.flush()
        # The result keeps the estimator, which would keep all of this.
        onboard.on_result = onboard.on_reading = None
        if self._last_stamp and self._ground.map.changed:
            self._write_grid(self._last_stamp)
        bag.write_soil()
        self._happened.take_problems(self._time)
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
            onboard=onboard,
            happened=self._happened,
            estimates=table,
            stretches=self._stretches,
            state=state,
            ended=ended,
            messages_read=read,
            prefix=bag.prefix,
            left_out=bag.left_out,
        )

    def _take(self, raw: RawMessage) -> None:
        """Give a message to the estimator, if it is an input; `_write` is given what it makes ready."""
        key = (raw.topic, raw.type)
        if key not in self._decoders:
            return
        try:
            message = self._decoders[key](raw.data)
        except Exception as error:  # damaged bytes make rosbags raise as it likes
            text = f"a message cannot be deserialised ({reason(error)})"
            streams = (i.stream for i in self._inputs if (i.topic, i.type) == key)
            stream = next(streams, raw.topic)
            self._onboard.problems.add(stream, "undecodable", text, unused=False)
            return
        by_recording = self._spec.clock and not self._has_clock
        now = raw.log_time if by_recording else self._clock
        for handle in self._handlers[key]:
            handle(message, now)

    def _on_clock(self, message: Any, _: int | None) -> None:
        self._clock = message.clock.sec * SECOND + message.clock.nanosec

    def _write(self, found: Result) -> None:
        """Write an estimate into table and bag, and lay it down on the map."""
        soil, frame = found.soil, self._feed.odometry_frame
        law = (soil.k, soil.n, soil.m, soil.log_covariance.tobytes())
        state = (*law, soil.variety, soil.accepted, found.rejected)
        if state != self._soil_state:  # it changes only when a stretch of way ends
            self._soil_state, self._soil = state, soil_fields(soil, found.rejected)
            self._soil_row = self._soil | deviations(soil)
        mobility = mobility_fields(found)
        self._table.add(found, mobility, self._soil_row)
        self._bag.write_estimate(found.reading, mobility, self._soil, self._time, frame)
        self._ground.add(found, frame)
        self._last_stamp = found.reading.stamp
        period = round(self._settings.cost.period * SECOND)
        if self._ground.map.changed and self._bag.is_due("cost", self._time, period):
            self._write_grid(found.reading.stamp)
        self._happened.add(found)

    def _on_reading(self, reading: Reading) -> None:
        """Every reading counts for the steady stretches, whether an estimate was due or not."""
        way = self._onboard.estimator.distance
        self._stretches.add(reading, way, self._happened.changing)

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
        onboard, notes = self._onboard, []
        if self._bag.damaged:
            notes.append(f"{self._bag.damaged} damaged messages are not in the new bag")
        refused = sum(n for (_, why), n in onboard.counts.items() if why in _BY_CLOCK)
        if self._spec.clock and 2 * refused > onboard.received.total():
            notes.append(_HINT)
        return notes

    def _seen_inputs(self) -> tuple[Any, ...]:
        """The inputs, those that never came marked as lacking."""
        received, joints = self._onboard.received, self._feed.joints
        there = f"never in a message, which has {', '.join(joints)}" if joints else ""
        return tuple(
            item
            if item.lacking or received[item.stream]
            else replace(item, lacking=(item.type == JOINTS and there) or "never in a message")
            for item in self._inputs
        )
