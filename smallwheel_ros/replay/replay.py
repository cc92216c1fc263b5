# SPDX-License-Identifier: Apache-2.0
"""Replay one bag: read it, estimate, write everything."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from smallwheel_ros.bags import (
    BagError,
    BagReader,
    BagWriter,
    DefinitionError,
    Key,
    Message,
    RawMessage,
    header,
)
from smallwheel_ros.common.errors import reason
from smallwheel_ros.common.stop import Stop
from smallwheel_ros.common.tables import write_json, write_rows
from smallwheel_ros.costmap.cost_map import CostMap
from smallwheel_ros.costmap.grid import Grid, wide, write_map
from smallwheel_ros.estimator.reading import SECOND, Reading
from smallwheel_ros.onboard.feed import Feed
from smallwheel_ros.onboard.ground import GroundMapper
from smallwheel_ros.onboard.onboard import Onboard
from smallwheel_ros.onboard.parameters import NODE_NAME
from smallwheel_ros.onboard.result import Result
from smallwheel_ros.onboard.robot_description import DESCRIPTION_TYPE
from smallwheel_ros.replay.result import (
    BAG,
    ESTIMATES,
    FILES,
    MEASUREMENTS,
    SUMMARY,
    DriveSummary,
    Replayed,
    begin,
    claimed,
)
from smallwheel_ros.replay.spec import (
    ReplayError,
    ReplaySpec,
    check_enough,
    inputs_of,
    read_settings,
)
from smallwheel_ros.replay.tables import (
    MOBILITY,
    SOIL,
    Estimate,
    SteadySegments,
    columns,
    table,
)

_Handler = Callable[[Any, int | None], object]
Progress = Callable[[int, int], None]
Report = Callable[[Replayed, Path], object]
_AddRow = Callable[[list[Any]], object]
_STEP = 256  # messages between two looks at signals, problems and progress
_CLOCK = ("/clock", "rosgraph_msgs/msg/Clock")
_BY_CLOCK = ("stamp_in_future", "stamp_too_old")
_HINT = (
    "header stamps are far from the times of recording, so most messages were refused, as the node"
    " would refuse them; with --no-clock stamps are judged only by each other"
)
_GRID, _TF = "nav_msgs/msg/OccupancyGrid", "tf2_msgs/msg/TFMessage"
_POSE_PERIOD = SECOND // 20
_SOIL_PERIOD = SECOND // 10  # as the node: by stamps, no more than ten times a second


def replay(
    spec: ReplaySpec,
    *,
    progress: Progress = lambda _done, _all: None,
    report: Report = lambda _result, _path: None,
) -> Replayed:
    """Replay one bag into the spec's folder; also one that is damaged, or until somebody interrupts.

    progress: called now and then with the messages done and all. report: called with the result and a
    path before the replay counts as done, to write a page.

    Raises BagError if nothing can be read, or the new bag cannot be written; ParametersError if the
    parameter file cannot be used; ReplayError if nothing can be estimated from the bag, a file cannot be
    written, or another replay is at work in the folder.
    """
    stop, folder = Stop(), spec.folder
    with BagReader(spec.bag, salvage=True) as reader, stop.listening():
        session = _Session(spec, reader)
        result = session.result
        with claimed(folder):
            result.notes += begin(spec)
            bag = _NewBag(folder / BAG, reader, session.copied)
            with table(folder / ESTIMATES, columns()) as add_row, bag:
                session.run(add_row, bag, stop, progress)
            measured = result.segments.table()
            if measured:
                write_rows(folder / MEASUREMENTS, measured)
            session.write_map(folder / FILES["cost_map"])
            report(result, folder / FILES["report"])
            write_json(str(folder / SUMMARY), result.to_dict())
    return result


class _Session:
    """One run of the estimator over an open bag."""

    def __init__(self, spec: ReplaySpec, reader: BagReader) -> None:
        settings, notes = read_settings(spec, reader)
        if not reader.message_count or reader.start_time is None or reader.end_time is None:
            raise ReplayError(f"bag {spec.bag} has no messages: nothing can be estimated")
        if settings.soil_file:
            notes.append("soil_file is not read: a replay begins with the configured soil")
        wheels = settings.onboard.wheels
        self._reader = reader
        self._onboard = Onboard(settings.onboard)
        self._feed = Feed(self._onboard, settings)
        self._ground = GroundMapper(CostMap(settings.cost, wheels))
        self._time = reader.start_time  # of recording, of the message that is worked on
        self._clock: int | None = None
        self._last: Estimate | None = None
        present = {(topic.name, topic.type) for topic in reader.topics}
        self._has_clock = spec.clock and _CLOCK in present
        handlers: list[tuple[Key, _Handler]] = [
            ((spec.in_bag(topic.name), topic.type), topic.handle) for topic in self._feed.topics
        ]
        if self._has_clock:
            handlers.append((_CLOCK, self._on_clock))
        self._takers: dict[Key, tuple[Callable[[bytes], Any], list[_Handler]]] = {}
        unusable = {}  # those that the bag defines otherwise
        for key, handle in handlers:
            if key in present:
                try:
                    self._takers.setdefault(key, (reader.decoder(*key), []))[1].append(handle)
                except DefinitionError as error:
                    unusable[key] = str(error)
        inputs = inputs_of(spec, self._feed, reader, unusable)
        check_enough(self._onboard, inputs, reader)
        described = (spec.in_bag(settings.robot_description_topic), DESCRIPTION_TYPE)
        used = {_CLOCK, described, *(key for key, _ in handlers)} & present
        self.copied: set[Key] = {"all": present, "used": used, "none": set()}[spec.copy]
        self._read = {name for name, _ in used | self.copied}
        self.result = Replayed(
            spec=spec,
            settings=settings,
            notes=[*spec.notes, *notes],
            inputs=inputs,
            start=reader.start_time,
            end=reader.end_time,
            message_count=sum(t.message_count for t in reader.topics if t.name in self._read),
            onboard=self._onboard,
            summary=DriveSummary(self._onboard, reader.start_time),
            segments=SteadySegments(wheels, bool(settings.onboard.with_drawbar_pull)),
        )

    def run(self, add_row: _AddRow, bag: _NewBag, stop: Stop, progress: Progress) -> None:
        """Read the bag to its end, its damage, or a signal."""
        result, total = self.result, self.result.message_count
        self._add_row, self._bag = add_row, bag
        self._onboard.on_result, self._onboard.on_reading = self._write, self._on_reading
        try:
            for raw in self._reader.raw_messages(self._read):
                self._time = raw.log_time
                bag.copy(raw)
                self._take(raw)
                result.messages_read += 1
                if result.messages_read % _STEP == 0:
                    result.summary.take_problems(self._time)
                    progress(result.messages_read, total)
                    if stop.asked:
                        result.state = "interrupted"
                        result.ended = (
                            f"stopped by {stop.asked} {(self._time - result.start) / SECOND:.3f} s after"
                            f" the bag's beginning, after {result.messages_read} of {total} messages;"
                            " the same command does all of it"
                        )
                        break
        except BagError as error:
            if error.path != self._reader.path:
                raise  # of the new bag
            result.state, result.ended = "ended_early", str(error)
        self._onboard.flush()
        # The result keeps the estimator, which would keep all of this.
        self._onboard.on_result = self._onboard.on_reading = None
        if self._last is not None and self._ground.map.changed:
            self._write_grid(self._last.result.reading.stamp)
        bag.finish()
        self._finish(bag)
        progress(result.messages_read, total)

    def _take(self, raw: RawMessage) -> None:
        """Give a message to the estimator, if it is an input; `_write` is given what it makes ready."""
        key = (raw.topic, raw.type)
        if key not in self._takers:
            return
        decode, handlers = self._takers[key]
        try:
            message = decode(raw.data)
        except Exception as error:  # damaged bytes make rosbags raise as it likes
            text = f"a message cannot be deserialised ({reason(error)})"
            streams = (i.stream for i in self.result.inputs if (i.topic, i.type) == key)
            stream = next(streams, raw.topic)
            self._onboard.problems.add(stream, "undecodable", text, unused=False)
            return
        by_recording = self.result.spec.clock and not self._has_clock
        now = raw.log_time if by_recording else self._clock
        for handle in handlers:
            handle(message, now)

    def _on_clock(self, message: Any, _: int | None) -> None:
        self._clock = message.clock.sec * SECOND + message.clock.nanosec

    def _write(self, found: Result) -> None:
        """Write an estimate into table and bag, and lay it down on the map."""
        self._last = estimate = Estimate(found, self._last)
        self._add_row(estimate.row(self.result.start))
        frame = self._feed.odometry_frame
        self._bag.write_estimate(estimate, self._time, frame)
        self._ground.add(found, frame)
        self._bag.write_pose(found.reading, self._time, frame)
        period = round(self.result.settings.cost.period * SECOND)
        if self._ground.map.changed and self._bag.is_due("cost", self._time, period):
            self._write_grid(found.reading.stamp)
        self.result.summary.add(found)

    def _on_reading(self, reading: Reading) -> None:
        """Every reading counts for the steady stretches, whether an estimate was due or not."""
        way, changing = self._onboard.estimator.distance, self.result.summary.changing
        self.result.segments.add(reading, way, changing)

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

    def _finish(self, bag: _NewBag) -> None:
        """Complete the result after the last message."""
        result, onboard = self.result, self._onboard
        result.prefix, result.left_out = bag.prefix, bag.left_out
        if bag.damaged:
            result.notes.append(f"{bag.damaged} damaged messages are not in the new bag")
        result.summary.take_problems(self._time)
        result.summary.finish()
        result.segments.finish()
        onboard.find_slip_tests()
        if result.state != "complete":
            result.end = max(self._time, result.start)
        result.inputs = tuple(
            item
            if item.lacking or onboard.received[item.stream]
            else replace(item, lacking="never in a message")
            for item in result.inputs
        )
        refused = sum(n for (_, why), n in onboard.counts.items() if why in _BY_CLOCK)
        if result.spec.clock and 2 * refused > onboard.received.total():
            result.notes.append(_HINT)


class _NewBag(BagWriter):
    """Writes originals as they are and estimates as the node would have published them.

    It is stored as the old bag is, so that whoever reads that one reads this one too.

    prefix: of the topics of the estimates: the node's name, or /replay before it where the bag has the
    node's own estimates already. left_out: topics and types that are not copied, since their type cannot
    be understood. damaged: messages that are not copied, since they cannot be converted.
    """

    def __init__(self, path: Path, reader: BagReader, copied: set[Key]) -> None:
        super().__init__(path, storage=reader.storage)
        own = f"/{NODE_NAME}"
        taken = any(topic.name.startswith(f"{own}/") for topic in reader.topics)
        self.prefix = f"/replay{own}" if taken else own
        found = {key: reader.as_channel(*key) for key in sorted(copied)}
        self._channels = {key: channel for key, channel in found.items() if channel is not None}
        self.left_out = [key for key in found if key not in self._channels]
        self.damaged = 0
        self._has_tf = any(topic in ("/tf", "tf") for topic, _ in self._channels)
        self._sent: dict[str, int] = {}
        self._soil_waits: tuple[int, Estimate, str] | None = None

    def __enter__(self) -> _NewBag:
        super().__enter__()
        self.add(f"{self.prefix}/mobility", MOBILITY)
        self.add(f"{self.prefix}/soil", SOIL, keeps_last=True)
        self.add(f"{self.prefix}/cost", _GRID, keeps_last=True)
        return self

    def copy(self, raw: RawMessage) -> None:
        """Write a message of the bag, where its topic is copied."""
        if (raw.topic, raw.type) not in self._channels:
            return
        channel, convert = self._channels[raw.topic, raw.type]
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
        if self.is_due("soil", estimate.result.reading.stamp, _SOIL_PERIOD):
            self.finish()

    def is_due(self, what: str, time: int, period: int) -> bool:
        """Whether a period (ns) has passed since this was last said, or time went back."""
        sent = self._sent.get(what)
        due = sent is None or not sent <= time < sent + period
        if due:
            self._sent[what] = time
        return due

    def write_grid(self, grid: Grid, stamp: int, log_time: int) -> None:
        """Write a cost grid; stamp and log_time in ns."""
        (x, y), (height, width) = grid.origin, grid.cells.shape
        stamped = header(stamp, grid.frame)
        info = Message(map_load_time=stamped.stamp, resolution=grid.resolution)
        info.width, info.height = width, height
        level = Message(x=0.0, y=0.0, z=0.0, w=1.0)
        info.origin = Message(position=Message(x=x, y=y, z=0.0), orientation=level)
        message = Message(header=stamped, info=info, data=grid.cells.ravel())
        self.write(f"{self.prefix}/cost", _GRID, log_time, message)

    def write_pose(self, reading: Reading, log_time: int, frame: str) -> None:
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
        self.write("/tf", _TF, log_time, Message(transforms=[link]))

    def finish(self) -> None:
        """Write the last soil, if it still waits."""
        if self._soil_waits is not None:
            log_time, estimate, frame = self._soil_waits
            self.write(f"{self.prefix}/soil", SOIL, log_time, estimate.soil(frame))
            self._soil_waits = None
