# SPDX-License-Identifier: Apache-2.0
"""The result of a replay: the folder with its files, events on the way, and all of it as values."""

from __future__ import annotations

import json
import math
import shutil
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from smallwheel_ros.bags import Key
from smallwheel_ros.common.errors import reason
from smallwheel_ros.common.result import Result
from smallwheel_ros.common.stamps import SECOND
from smallwheel_ros.common.tables import plain
from smallwheel_ros.drive.events import DriveEvents
from smallwheel_ros.drive.messages import soil_fields, strength_of_prior
from smallwheel_ros.onboard.settings import NodeSettings
from smallwheel_ros.physics.conditions import ROLLING
from smallwheel_ros.pipeline.pipeline import Pipeline
from smallwheel_ros.pipeline.warning.margin import is_prior
from smallwheel_ros.replay.diagnosis import DriveDiagnosis
from smallwheel_ros.replay.spec import Input, ReplayError, ReplaySpec
from smallwheel_ros.replay.tables import (
    COUNTS,
    EstimatesTable,
    SteadyStretches,
    VehicleTable,
    deviations,
)

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes

SCHEMA = 1
SUMMARY, ESTIMATES, MEASUREMENTS, BAG = "replay.json", "estimates", "measurements.csv", "bag"
TWISTS, VEHICLE_TABLE = "twists", "vehicle"
FILES = {
    "estimates_csv": f"{ESTIMATES}.csv",
    "estimates_parquet": f"{ESTIMATES}.parquet",
    "measurements": MEASUREMENTS,
    "twists_csv": f"{TWISTS}.csv",
    "twists_parquet": f"{TWISTS}.parquet",
    "vehicle_csv": f"{VEHICLE_TABLE}.csv",
    "vehicle_parquet": f"{VEHICLE_TABLE}.parquet",
    "bag": BAG,
    "report": "report.html",
    "cost_map": "cost_map.yaml",
    "cost_map_image": "cost_map.pgm",
}
_DRAFT = ".replay"
_MOST_EVENTS = 200
_UNITS = {"k": "Pa/m^(n+m)", "n": "1", "m": "1"}
_UNITS |= {"effective_modulus": "Pa/m^n", "reference_pressure": "Pa"}


# --- The folder


def files_in(folder: Path) -> dict[str, str]:
    """Names of a replay's files that exist in a folder, by their keys in `FILES`."""
    return {what: name for what, name in FILES.items() if (folder / name).exists()}


def read_summary(folder: Path) -> dict[str, Any]:
    """Return the content of replay.json in a folder; empty if there is none, or it cannot be read."""
    try:
        content = json.loads((folder / SUMMARY).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return content if isinstance(content, dict) else {}


def is_done(spec: ReplaySpec) -> bool:
    """Whether the spec's folder has the result of the same replay, to the end of the bag or its damage."""
    return result_state(spec) in ("complete", "ended_early")


def result_state(spec: ReplaySpec) -> str:
    """State, as in `Replayed`, of this very replay's result in the spec's folder; empty if there is none."""
    summary = read_summary(spec.folder)
    try:
        mine = bool(summary) and summary.get("fingerprint") == spec.fingerprint()
    except OSError:  # the bag is gone
        mine = False
    return str(summary.get("state", "")) if mine else ""


@contextmanager
def draft(spec: ReplaySpec) -> Iterator[Path]:
    """Provide a hidden folder in the spec's folder; at the end its files replace those of an earlier replay.

    If the `with` block raises an error, or its process dies, the earlier files are unchanged.

    Parameters
    ----------
    spec
        Specification of the replay.

    Yields
    ------
    Path
        The hidden folder; the block has to write replay.json into it.

    Raises
    ------
    ReplayError
        If the folder is the bag, contains the bag where the new one would be, has files of these names that
        no replay wrote, or cannot be used.
    """
    folder, bag = spec.folder, spec.bag.resolve()
    if folder.resolve() == bag:
        raise ReplayError(f"folder {folder} is the bag itself: give another one with -o")
    if bag.is_relative_to((folder / BAG).resolve()):
        raise ReplayError(
            f"bag {spec.bag} is what an earlier replay has written into folder {folder}, which a"
            " new one clears: give another one with -o"
        )
    there = files_in(folder)
    if there and not read_summary(folder):
        raise ReplayError(
            f"folder {folder} has {next(iter(there.values()))}, which no replay wrote: give another"
            " folder, or remove it"
        )
    hidden = folder / _DRAFT
    try:
        shutil.rmtree(hidden, ignore_errors=True)  # of one that was killed
        hidden.mkdir(parents=True)
        yield hidden
        mark = (
            hidden / "unfinished.json"
        )  # tells whoever comes, if this is killed now, whose files these are
        mark.write_text('{"state": "unfinished"}', encoding="utf-8")
        mark.replace(folder / SUMMARY)
        for name in FILES.values():
            old, new = folder / name, hidden / name
            if old.is_dir():
                shutil.rmtree(old)
            old.unlink(missing_ok=True)
            if new.exists():
                new.rename(old)
        (hidden / SUMMARY).replace(folder / SUMMARY)  # last: then all is there
    except OSError as error:
        raise ReplayError(f"folder {folder} cannot be used: {reason(error)}") from error
    finally:
        shutil.rmtree(hidden, ignore_errors=True)


# --- All of it


@dataclass(repr=False)
class Replayed(Result, shown="replay.report"):
    """Result of a replay.

    Attributes
    ----------
    spec, settings
        What was replayed and how, and the node's settings.
    notes
        Sentences on parameters, inputs and stamps that the user should know of.
    inputs
        The node's inputs, with the reason for each that the bag lacks.
    pipeline, happened
        The estimator in its state at the end, and the events of the drive.
    estimates, vehicle, stretches
        The tables that were written, with their counts.
    measurements
        Number of rows of measurements.csv.
    has_twists
        Whether the new bag has the vehicle's twists.
    state
        ``complete``, ``ended_early`` (the bag is damaged) or ``interrupted``.
    ended
        What is wrong with the bag, or where the replay stopped, in words; empty when complete.
    start, end
        Recording times of the first and the last message, ns.
    messages_read, message_count
        Number of messages read, and the number that the bag states for the topics that were read.
    prefix
        Prefix of the topics of the estimates in the new bag, such as `/mobility_estimator`.
    left_out
        Topics and types that are not in the new bag, since the type is unknown.
    diagnosis
        Diagnosis of the steady stretches; None if there are none, or the replay was interrupted.
    place
        The temporary folder of the files, which is deleted together with the result; None if the files are
        in a folder of the user's.
    """

    spec: ReplaySpec
    settings: NodeSettings
    notes: list[str]
    inputs: tuple[Input, ...]
    start: int
    end: int
    message_count: int
    pipeline: Pipeline
    happened: DriveEvents
    estimates: EstimatesTable
    vehicle: VehicleTable
    stretches: SteadyStretches
    state: str = "complete"
    ended: str = ""
    messages_read: int = 0
    measurements: int = 0
    diagnosis: DriveDiagnosis | None = None
    prefix: str = ""
    has_twists: bool = False
    left_out: list[Key] = field(default_factory=list)
    place: TemporaryDirectory[str] | None = None

    def headline(self) -> str:
        """The length of the drive, and the number of estimates."""
        seconds, metres = (self.end - self.start) / SECOND, self.happened.travel
        state = "" if self.state == "complete" else f", {self.state.replace('_', ' ')}"
        count = self.estimates.statuses.total()
        return f"{self.spec.bag.name}: {seconds:.1f} s, {metres:.1f} m, {count} estimates{state}"

    def rows(self) -> list[dict[str, Any]]:
        """One row for each wheel: its name, the counts of `COUNTS`, and sinkage_rms.

        That is the root mean square of measured minus predicted sinkage, m; None if no sinkage was used.
        """
        return [{"wheel": name, **counts} for name, counts in self._wheels().items()]

    def _wheels(self) -> dict[str, dict[str, Any]]:
        """Counts of each wheel, and the root mean square of measured minus predicted sinkage, m."""
        found: dict[str, dict[str, Any]] = {}
        for wheel in self.settings.onboard.wheels:
            counts = self.estimates.counts.get(wheel.name, Counter[str]())
            used, squares = counts.get("used_for_soil", 0), counts.get("squares", 0.0)
            rms = math.sqrt(squares / used) if used else None
            whole = {name: int(counts.get(name, 0)) for name in COUNTS}
            found[wheel.name] = {**whole, "sinkage_rms": rms}
        return found

    def to_frame(self) -> pd.DataFrame:
        """Every estimate, one row each, SI units, as in estimates.csv."""
        import pandas

        return pandas.read_csv(self.spec.folder / FILES["estimates_csv"])

    def plot(self, ax: Axes | None = None, quantity: str = "sinkage_predicted") -> Axes:
        """Draw a column of the estimates over time, one curve for each wheel.

        Parameters
        ----------
        ax
            Axes to draw on; those of a new figure if not given.
        quantity
            Name of the column.

        Raises
        ------
        ResultError
            If there is no such column of numbers.
        """
        return self._drawn(ax, quantity)

    def to_dict(self, folder: Path | None = None) -> dict[str, Any]:
        """The content of replay.json: SI units, times in s since the bag's beginning.

        It lists the files in `folder`, or in the spec's folder if none is given.
        """
        happened, received = (
            self.happened,
            {n: s.received for n, s in self.pipeline.streams.all.items()},
        )
        rolling = {w.name for w in self.settings.onboard.wheels if w.contact == ROLLING}
        topics = {item.stream: item.topic for item in self.inputs}
        not_used = []
        for (stream, why), count in sorted(self.pipeline.problems.items()):
            drop = {"topic": topics.get(stream, stream), "stream": stream, "reason": why}
            text, time = happened.examples.get((stream, why), ("", None))
            not_used.append({**drop, "count": count, "first_time": time, "example": text})
        content = {
            "schema": SCHEMA,
            "state": self.state,
            "ended": self.ended,
            "bag": str(self.spec.bag),
            "config": str(self.spec.config),
            "remaps": dict(self.spec.remaps),
            "fingerprint": self.spec.fingerprint(),
            "start": self.start / SECOND,
            "duration": (self.end - self.start) / SECOND,
            "travel": happened.travel,
            "messages": {"read": self.messages_read, "in_bag": self.message_count},
            "estimates": self.estimates.statuses.total(),
            "statuses": dict(self.estimates.statuses),
            "wheels": {
                name: {"rolls": name in rolling, **counts}
                for name, counts in self._wheels().items()
            },
            "soil": self._soil(),
            "mobility": self._mobility(),
            "strength": {
                "measured_by": sorted(self.pipeline.strength.sources),
                "determined": self.pipeline.strength.determined,
                "status": list(self.pipeline.strength.status),
                "of_model_file": self.pipeline.settings.strength_measured,
                "of_prior": self._prior_strength(),
            },
            "sensors": list(self.pipeline.findings),
            "filter": self.pipeline.concern,
            "events": [event._asdict() for event in happened.events[:_MOST_EVENTS]],
            "unlisted_events": max(len(happened.events) - _MOST_EVENTS, 0),
            "inputs": [
                {
                    "stream": i.stream,
                    "topic": i.topic,
                    "type": i.type,
                    "messages": received[i.stream],
                }
                for i in self.inputs
            ],
            "missing": [str(item) for item in self.inputs if item.lacking],
            "not_used": not_used,
            "measurements": {
                "rows": self.measurements,
                "stretches_not_steady": self.stretches.unsteady,
                "results_without_load_slip_or_sinkage": self.stretches.unusable,
                "results_at_changes_of_soil": self.stretches.at_changes,
            },
            "diagnosis": None if self.diagnosis is None else self.diagnosis.to_dict(),
            "not_copied": [f"{name} ({kind})" for name, kind in self.left_out],
            "notes": self.notes,
            "topics_of_estimates": [
                f"{self.prefix}/{name}"
                for name in (
                    "vehicle",
                    *(f"{wheel.name}/mobility" for wheel in self.settings.onboard.wheels),
                    "soil",
                    *(["twist"] if self.has_twists else []),
                )
            ],
            "files": files_in(folder or self.spec.folder),
        }
        return dict(plain(content))

    def _mobility(self) -> dict[str, Any]:
        """Summary of slip, margin and risk, and whether the margin is still that of any ground's prior."""
        told: dict[str, Any] = {**self.estimates.told(), "risk": self.vehicle.risk()}
        settings, spread = self.pipeline.settings, told["margin"]["std"]
        of_prior = spread is not None and bool(is_prior(spread, settings.reference_slip))
        told["margin"] = {**told["margin"], "of_prior": of_prior and not settings.strength_measured}
        return told

    def _prior_strength(self) -> str:
        """Name of the soil whose strength was assumed for the pull; empty if the strength was measured."""
        strength, settings = self.pipeline.strength, self.pipeline.settings
        measured = strength.determined or settings.strength_measured
        return "" if measured else strength_of_prior(settings)

    def _soil(self) -> dict[str, Any]:
        soil, alarm = self.pipeline.soil, self.pipeline.soil.missing_effect
        told = soil_fields(soil, rejected=0) | deviations(soil)
        found: dict[str, Any] = {
            name: {
                "value": told[name],
                "std": told[f"{name}_standard_deviation"],
                "unit": unit,
                "determined": told[f"{name}_identifiable"],
            }
            for name, unit in _UNITS.items()
        }
        found["missing_effect"] = alarm and {
            "effect": alarm.effect,
            "rivals": list(alarm.rivals),
            "follows": alarm.follows,
            "text": alarm.message,
        }
        return found | {
            "reference_sinkage": soil.reference_sinkage,
            "reference_diameter": soil.reference_diameter,
            "status": list(soil.status),
            "remarks": list(soil.remarks),
            "changes": self.happened.soil_changes,
        }
