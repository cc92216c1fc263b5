# SPDX-License-Identifier: Apache-2.0
"""Replays one bag: its messages go to the estimator as in the node, and all results are written."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from smallwheel_ros.bags import BagReader, Key, RawMessage
from smallwheel_ros.common.stamps import SECOND
from smallwheel_ros.common.stop import Stop
from smallwheel_ros.common.tables import write_json
from smallwheel_ros.costmap.cost_map import COST_PERIOD
from smallwheel_ros.costmap.grid import write_map
from smallwheel_ros.drive.events import DriveEvents
from smallwheel_ros.drive.ground_map import GroundMapper, cost_map_of
from smallwheel_ros.drive.messages import mobility_columns, soil_fields, vehicle_columns
from smallwheel_ros.drive.soil_file import SoilFile
from smallwheel_ros.onboard.robot_description import DESCRIPTION_TYPE
from smallwheel_ros.pipeline.intake.inputs import topics_of
from smallwheel_ros.pipeline.mobility.vehicle import VehicleEstimates
from smallwheel_ros.pipeline.pipeline import Pipeline, Turn
from smallwheel_ros.pipeline.soil.identifiability import SoilEstimate
from smallwheel_ros.pipeline.tables import Estimates
from smallwheel_ros.replay.diagnosis import diagnosed
from smallwheel_ros.replay.new_bag import NewBag
from smallwheel_ros.replay.recorded_ahead import RecordedAhead
from smallwheel_ros.replay.recording import Recording
from smallwheel_ros.replay.result import (
    BAG,
    ESTIMATES,
    FILES,
    MEASUREMENTS,
    SUMMARY,
    TWISTS,
    VEHICLE_TABLE,
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
from smallwheel_ros.replay.tables import (
    EstimatesTable,
    SteadyStretches,
    TwistsTable,
    VehicleTable,
    deviations,
)

Progress = Callable[[int, int], object]
Report = Callable[[Replayed, Path], object]  # writes a page on the result into the folder
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
    """Replay one bag, even a damaged one, to its end or until interrupted, into the spec's folder.

    Parameters
    ----------
    spec
        Bag, parameters, folder and options.
    progress
        Called from time to time with the number of messages done and their total.
    report
        Called with the result and the folder in which it is being prepared, to write a page into that folder
        before the replay counts as done.

    Returns
    -------
    Replayed
        The result; its files are in the spec's folder.

    Raises
    ------
    BagError
        If nothing can be read, or the new bag cannot be written.
    ParametersError
        If the parameter file cannot be used.
    ReplayError
        If nothing can be estimated from the bag, or a file cannot be written.
    """
    stop = Stop()
    with BagReader(spec.bag) as reader, stop.listening():
        drive = _Drive(spec, reader)
        with draft(spec) as folder:
            bag = drive.new_bag(folder / BAG)
            wheels = drive.wheels
            with EstimatesTable(folder / ESTIMATES, drive.start, wheels) as table, bag:
                result = drive.run(table, bag, stop, progress)
            drive.twists.write(folder / TWISTS)
            drive.vehicle.write(folder / VEHICLE_TABLE)
            measured = result.stretches.table()
            result.measurements = len(measured)
            if result.measurements:
                measured.to_csv(folder / MEASUREMENTS, index=False)
                if result.state != "interrupted":
                    remarks = result.pipeline.soil.remarks
                    result.diagnosis = diagnosed(measured, spec.folder / MEASUREMENTS, remarks)
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
        self._notes += [reader.hole] if reader.hole else []
        if not reader.message_count or reader.start_time is None:
            raise ReplayError(f"bag {spec.bag} has no messages: nothing can be estimated")
        if self._settings.soil.file and spec.soil_file is None:
            self._notes.append(
                "soil.file is the node's, and not read: give --soil-file to go on from it"
            )
        onboard = self._settings.onboard
        self._notes += filter(None, [onboard.unknown_positions, onboard.model_note])
        self.start = reader.start_time  # log time
        self.wheels = [wheel.name for wheel in onboard.wheels]
        self._pipeline = Pipeline(onboard)
        self._ground = GroundMapper(cost_map_of(self._settings), onboard.wheels)
        self._soil_file = SoilFile(str(spec.soil_file or ""))
        self._go_on()
        self._happened = DriveEvents(self._pipeline, self.start)
        pull_std = onboard.noise.drawbar_pull if onboard.with_drawbar_pull else None
        self._stretches = SteadyStretches(onboard.wheels, pull_std, onboard.gravity)
        self.twists, self.vehicle = TwistsTable(self.start), VehicleTable(self.start)
        self._soils: list[tuple[SoilEstimate, dict[str, Any]]] = []  # with its fields
        self._fields: tuple[str, ...] = ()
        self._last_stamp = 0
        self._recording = Recording(
            reader, self._settings, self._pipeline, spec.in_bag, clock=spec.clock
        )
        self._ahead = RecordedAhead(spec, reader, self._settings, self._ground.map, self._pipeline)
        self._notes += self._ahead.notes
        self._look_for_inputs(spec)

    def _go_on(self) -> None:
        """Start from a saved soil and map if there are any. Raises ReplayError if the soil is unusable."""
        restored = self._soil_file.restore(self._pipeline)
        if self._soil_file.problem:
            raise ReplayError(f"{self._soil_file.problem}; give another file with --soil-file")
        remembered = self._soil_file.restore_map(self._ground.map)
        self._notes += [text for text in (restored, remembered) if text]

    def save_soil(self) -> str:
        """Save the soil into the spec's soil file; return what was done, in words, empty without a file."""
        if self._spec.soil_file is None:
            return ""
        saved, words = self._soil_file.save(self._pipeline, self._ground.map)
        return f"soil saved: {words}" if saved else words

    def _look_for_inputs(self, spec: ReplaySpec) -> None:
        """Determine the topic of each input, and the topics that are copied."""
        reader, settings, used = self._reader, self._settings, self._recording.used
        present = {topic[:2] for topic in reader.topics}
        unusable = self._recording.unusable
        self._inputs = inputs_of(spec, topics_of(settings), settings, reader, unusable)
        check_enough(self.wheels, self._inputs, reader)
        described = (spec.in_bag(settings.robot_description_topic), DESCRIPTION_TYPE)
        used = used | ({described} & present) | self._ahead.topics.keys()
        self.copied: set[Key] = {"all": present, "used": used, "none": set()}[spec.copy]
        self._names = frozenset(name for name, _ in used | self.copied)

    def new_bag(self, path: Path) -> NewBag:
        """The bag that estimates go into."""
        frames = {wheel: self._settings.frame_of(wheel) for wheel in self.wheels}
        return NewBag(path, self._reader, self.copied, frames, self._settings.base_frame)

    def run(self, table: EstimatesTable, bag: NewBag, stop: Stop, progress: Progress) -> Replayed:
        """Read the bag to its end, its damage or a signal to stop, write estimates, and return the result."""
        self._table, self._bag = table, bag
        recording = self._recording
        total = sum(t.message_count for t in self._reader.topics if t.name in self._names)
        state, ended = "complete", ""

        def each(message: RawMessage) -> None:
            self._ahead.keep(message)
            if self.copied:
                bag.copy_message(message)

        for turns in recording.turns(self._names, each):
            for turn in turns:
                self._write(turn)
            self._happened.take_problems(recording.time)
            progress(recording.read, total)
            if stop.asked and recording.read < total and not recording.stopped:
                since = (recording.time - self.start) / SECOND
                recording.stopped, state = True, "interrupted"
                ended = (
                    f"stopped by {stop.asked} {since:.3f} s after the bag's beginning, after"
                    f" {recording.read} of {total} messages; the same command does all of it"
                )
        if recording.damage is not None:
            state, ended = "ended_early", str(recording.damage)
        self._ahead.take_until(recording.time)
        if self._last_stamp and self._ground.map.changed:
            self._write_grids(self._last_stamp, recording.time)
        bag.write_soil()
        self._happened.finish()
        whole = state == "complete" and self._reader.end_time is not None
        return Replayed(
            spec=self._spec,
            settings=self._settings,
            notes=[*self._spec.notes, *self._notes, *self._hints()],
            inputs=self._seen_inputs(),
            start=self.start,
            end=(self._reader.end_time or 0) if whole else max(recording.time, self.start),
            message_count=total,
            pipeline=self._pipeline,
            happened=self._happened,
            estimates=table,
            vehicle=self.vehicle,
            stretches=self._stretches,
            state=state,
            ended=ended,
            messages_read=recording.read,
            prefix=bag.prefix,
            has_twists=bag.has_twists,
            left_out=bag.left_out,
        )

    def _write(self, turn: Turn) -> None:
        """Write the results of one turn of the pipeline into the tables, the bag and the cost map."""
        if turn.starts_over:
            self._stretches.starts_over()
        changing, log_times = self._happened.take(turn), self._recording.log_times
        self._stretches.add(turn.readings, changing)

        if turn.twists is not None and len(turn.twists):
            self.twists.add(turn.twists)
            self._bag.write_twists(turn.twists, self._settings.twist, log_times(turn.twists.stamp))
        rows = turn.estimates
        vehicle = self._lay(rows, turn.vehicle)
        if len(vehicle):
            of_vehicle, stamps = vehicle_columns(vehicle), vehicle.stamp
            self.vehicle.add(stamps, of_vehicle)
            self._bag.write_vehicle(stamps, of_vehicle, log_times(stamps))
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
        recorded = log_times(rows.stamp)
        self._bag.write_estimates(rows, columns, of_rows, recorded, self._recording.frame)

    def _lay(self, rows: Estimates, vehicle: VehicleEstimates) -> VehicleEstimates:
        """Write rows into the cost map, and the map into the bag as often as the node would publish it.

        Returns the vehicle's rows with the margins of terrain classes where nothing else is known.
        """
        period, recorded = round(COST_PERIOD * SECOND), self._recording.log_times(rows.stamp)
        cuts = np.flatnonzero(np.diff(recorded // period)) + 1
        before = np.searchsorted(vehicle.stamp, rows.stamp[cuts], side="right")
        with_classes = []
        for part, of_vehicle in zip(
            np.split(np.arange(len(rows)), cuts),
            np.split(np.arange(len(vehicle)), before),
            strict=True,
        ):
            if len(part):
                self._ahead.take_until(int(recorded[part[-1]]))
            laid = rows.take(part), vehicle.take(of_vehicle)
            with_classes.append(self._ground.take(*laid, self._recording.frame))
            if not len(part):
                continue
            time, self._last_stamp = int(recorded[part[-1]]), int(rows.stamp[part[-1]])
            if self._ground.map.changed and self._bag.is_due("cost", time, period):
                self._write_grids(self._last_stamp, time)
        return VehicleEstimates.joined(with_classes)

    def _told(self) -> list[dict[str, Any]]:
        """Fields of SoilEstimate, one mapping for each soil of the newest turn of the pipeline, in order."""
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

    def _write_grids(self, stamp: int, time: int) -> None:
        """Write the grids as the node would have published them."""
        grids = self._ground.map.grids()
        if grids is not None:
            self._bag.write_grids(grids, stamp, time)

    def write_map(self, path: Path) -> None:
        """Write all crossed ground, inside and outside the window, as a map for map_server."""
        whole = self._ground.map.spread_whole()
        if whole is not None:
            write_map(path, whole)

    def _hints(self) -> list[str]:
        """Hints about stamps, and about messages that were damaged."""
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
