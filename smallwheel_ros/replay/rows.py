"""Estimates as rows of a table and as messages, with the names of the messages' fields."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any, Literal

from smallwheel_ros.bags import message_type
from smallwheel_ros.bags.library import Nodetype, typestore
from smallwheel_ros.onboard.message_fields import VALID, mobility_fields, soil_fields
from smallwheel_ros.onboard.onboard import Result
from smallwheel_ros.onboard.streams import SECOND

MOBILITY = "smallwheel_ros/msg/MobilityEstimate"
SOIL = "smallwheel_ros/msg/SoilEstimate"
Kind = Literal["integer", "number", "text", "truth"]
_KINDS: dict[str, Kind] = {"bool": "truth", "string": "text", "float64": "number"}
_FIRST: dict[str, Kind] = {
    "stamp": "integer",
    "time": "number",
    "wheel": "text",
    "x": "number",
    "y": "number",
    "speed": "number",
    "travel": "number",
    "status": "text",
    "status_text": "text",
}


@cache
def _fields(message: str) -> dict[str, Kind]:
    """Names and kinds of a message's simple fields, without its constants."""
    return {
        name: _KINDS.get(str(described[1][0]), "integer")
        for name, described in typestore().fielddefs[message][1]
        if described[0] == Nodetype.BASE  # a plain value, no message and no array
    }


@cache
def columns() -> dict[str, Kind]:
    """Return the table's columns in their order."""
    own = {
        name: kind
        for name, kind in _fields(MOBILITY).items()
        if name not in VALID and name not in _FIRST
    }
    soil = {f"soil_{name}": kind for name, kind in _fields(SOIL).items()}
    spreads: dict[str, Kind] = {f"soil_{name}_standard_deviation": "number" for name in "knm"}
    return {**_FIRST, **own, **soil, **spreads, "soil_changes": "integer"}


@dataclass(frozen=True)
class Estimate:
    """One result, as the fields of its two messages (without header) and as a row of the table."""

    result: Result
    mobility: dict[str, Any]
    soil: dict[str, Any]

    @classmethod
    def of(cls, result: Result) -> Estimate:
        """Return the estimate in a result."""
        return cls(
            result, mobility_fields(result.mobility), soil_fields(result.soil, result.rejected)
        )

    def row(self, start: int) -> dict[str, Any]:
        """Return the cells by column, None for a blank one. start: the bag's first log time, ns."""
        found, soil = self.result.mobility, self.result.soil
        x, y = self.result.instant.vehicle or (None, None)
        spreads = [max(variance, 0.0) ** 0.5 for variance in soil.covariance.diagonal().tolist()]
        cells = {
            **self.mobility,
            "stamp": found.stamp,
            "time": (found.stamp - start) / SECOND,
            "wheel": found.wheel,
            "x": x,
            "y": y,
            "speed": self.result.instant.speed,
            "travel": soil.distance,
            "status": found.status.name,
            **{f"soil_{name}": value for name, value in self.soil.items()},
            **{f"soil_{n}_standard_deviation": s for n, s in zip("knm", spreads, strict=True)},
            "soil_changes": soil.soil_changes,
        }
        for flag, names in VALID.items():  # blank where it is not known
            if not self.mobility[flag]:
                for name in names:
                    cells[name] = cells[f"{name}_standard_deviation"] = None
        return cells

    def messages(self, frame: str) -> tuple[Any, Any]:
        """Return MobilityEstimate and SoilEstimate; frame: of the latter, that of odometry."""
        found = self.result.mobility
        seconds, rest = divmod(found.stamp, SECOND)
        stamp = message_type("builtin_interfaces/msg/Time")(sec=seconds, nanosec=rest)
        header = message_type("std_msgs/msg/Header")
        return (
            message_type(MOBILITY)(
                header=header(stamp=stamp, frame_id=found.wheel), **self.mobility
            ),
            message_type(SOIL)(header=header(stamp=stamp, frame_id=frame), **self.soil),
        )
