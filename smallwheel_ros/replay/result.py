# SPDX-License-Identifier: Apache-2.0
"""What came of a replay: as values, as replay.json and what `--json` prints."""

from __future__ import annotations

from dataclasses import dataclass, field
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from smallwheel_ros.bags.storage import Key
from smallwheel_ros.common.results import Result, pandas
from smallwheel_ros.common.tables import plain
from smallwheel_ros.onboard.onboard import Onboard
from smallwheel_ros.onboard.settings import NodeSettings
from smallwheel_ros.onboard.streams import SECOND
from smallwheel_ros.physics.conditions import ROLLING
from smallwheel_ros.replay.folder import FILES, files_in
from smallwheel_ros.replay.inputs import Input
from smallwheel_ros.replay.spec import ReplaySpec
from smallwheel_ros.replay.steady_segments import SteadySegments
from smallwheel_ros.replay.summary import DriveSummary

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes

SCHEMA = 1


@dataclass(repr=False)
class Replayed(Result):
    """What came of a replay.

    Attributes
    ----------
    state
        ``complete``, ``ended_early`` (the bag is damaged) or ``interrupted``.
    ended
        In words, what is wrong with the bag, or where the replay stopped; empty when complete.
    messages_read, message_count
        Of the topics that were read, and how many the bag says there are.
    prefix
        Of the topics of the estimates in the new bag.
    left_out
        Topics and types that are not in the new bag, since nobody knows the type.
    place
        What keeps a folder that is only for this result; it goes when the result does.
    """

    spec: ReplaySpec
    settings: NodeSettings
    notes: list[str]
    inputs: tuple[Input, ...]
    start: int
    end: int
    message_count: int
    onboard: Onboard
    summary: DriveSummary
    segments: SteadySegments
    state: str = "complete"
    ended: str = ""
    messages_read: int = 0
    prefix: str = ""
    left_out: list[Key] = field(default_factory=list)
    place: TemporaryDirectory[str] | None = None

    def headline(self) -> str:
        """How far the drive was, and how many estimates it gave."""
        seconds, metres = (self.end - self.start) / SECOND, self.summary.travel
        state = "" if self.state == "complete" else f", {self.state.replace('_', ' ')}"
        count = self.summary.statuses.total()
        return f"{self.spec.bag.name}: {seconds:.1f} s, {metres:.1f} m, {count} estimates{state}"

    def to_dict(self) -> dict[str, Any]:
        """As replay.json and `smallwheel replay --json` have it."""
        return self.document(files_in(self.spec.folder))

    def rows(self) -> list[dict[str, Any]]:
        """How well the measured sinkage of each wheel was met."""
        return [
            {"wheel": name, **counts, "sinkage_rms": self.summary.rms(name)}
            for name, counts in self.summary.wheels.items()
        ]

    def to_frame(self) -> pd.DataFrame:
        """Every estimate, one row each, SI units, as in estimates.csv."""
        frame: pd.DataFrame = pandas().read_csv(self.spec.folder / FILES["estimates_csv"])
        return frame

    def plot(self, ax: Axes | None = None, quantity: str = "sinkage_predicted") -> Axes:
        """Draw a column of the estimates over time, one curve for each wheel."""
        return self._drawn(ax, quantity)

    def document(self, files: dict[str, str]) -> dict[str, Any]:
        """Return the summary of the replay; SI units, times in s since the bag's beginning.

        files: what was written, by what it is, as names in the replay's folder.
        """
        summary, received = self.summary, self.onboard.received
        rolling = {w.name for w in self.settings.onboard.wheels if w.contact == ROLLING}
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
            "travel": summary.travel,
            "messages": {"read": self.messages_read, "in_bag": self.message_count},
            "estimates": summary.statuses.total(),
            "statuses": dict(summary.statuses),
            "wheels": {
                name: {"rolls": name in rolling, **counts, "sinkage_rms": summary.rms(name)}
                for name, counts in summary.wheels.items()
            },
            "soil": self._soil(),
            "sensors": list(self.onboard.findings),
            "slip_tests": [test.text for test in self.onboard.slip_tests],
            "filter": self.onboard.concern,
            "events": [event._asdict() for event in summary.events],
            "unlisted_events": summary.unlisted_events,
            "inputs": [
                {
                    "stream": item.stream,
                    "topic": item.topic,
                    "type": item.type,
                    "messages": received[item.stream],
                }
                for item in self.inputs
            ],
            "missing": [str(item) for item in self.inputs if item.lacking],
            "not_used": [self._not_used(*key) for key in sorted(self.onboard.counts)],
            "measurements": {
                "rows": len(self.segments),
                "stretches_not_steady": self.segments.unsteady,
                "results_without_load_slip_or_sinkage": self.segments.unusable,
                "results_at_changes_of_soil": self.segments.at_changes,
            },
            "not_copied": [f"{name} ({kind})" for name, kind in self.left_out],
            "notes": self.notes,
            "topics_of_estimates": [f"{self.prefix}/mobility", f"{self.prefix}/soil"],
            "files": files,
        }
        found = plain(content)
        assert isinstance(found, dict)
        return found

    def _soil(self) -> dict[str, Any]:
        soil = self.onboard.soil
        known, alarm = soil.identifiable, soil.missing_effect
        k_std, n_std, m_std = soil.covariance.diagonal() ** 0.5
        modulus, modulus_std = soil.effective_modulus()
        pressure, pressure_std = soil.reference_pressure, soil.reference_pressure_std
        values = {
            "k": (soil.k, k_std, "Pa/m^(n+m)", known.k),
            "n": (soil.n, n_std, "1", known.n),
            "m": (soil.m, m_std, "1", known.m),
            "effective_modulus": (modulus, modulus_std, "Pa/m^n", known.effective_modulus),
            "reference_pressure": (pressure, pressure_std, "Pa", known.reference_pressure),
        }
        parts = ("value", "std", "unit", "determined")
        return {
            **{name: dict(zip(parts, value, strict=True)) for name, value in values.items()},
            "reference_sinkage": soil.reference_sinkage,
            "reference_diameter": soil.reference_diameter,
            "status": list(soil.status),
            "changes": self.summary.soil_changes,
            "missing_effect": alarm
            and {
                "effect": alarm.effect,
                "rivals": list(alarm.rivals),
                "follows": alarm.follows,
                "text": alarm.message,
            },
        }

    def _not_used(self, stream: str, reason: str) -> dict[str, Any]:
        """Say how many messages of an input could not be used for one reason, and the first one."""
        text, time = self.summary.examples.get((stream, reason), ("", None))
        return {
            "topic": next((item.topic for item in self.inputs if item.stream == stream), stream),
            "stream": stream,
            "reason": reason,
            "count": self.onboard.counts[stream, reason],
            "first_time": time,
            "example": text,
        }
