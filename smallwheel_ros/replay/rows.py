"""Estimates as rows of a table and as messages, with the names of the messages' fields."""

from __future__ import annotations

from functools import cache
from types import SimpleNamespace
from typing import Any, Literal, NamedTuple

from smallwheel_ros.bags import typestore
from smallwheel_ros.onboard.message_fields import mobility_fields, soil_fields
from smallwheel_ros.onboard.mobility import Status
from smallwheel_ros.onboard.onboard import Result
from smallwheel_ros.onboard.streams import SECOND

MOBILITY = "smallwheel_ros/msg/MobilityEstimate"
SOIL = "smallwheel_ros/msg/SoilEstimate"
STATUS_NAMES = {status: status.name for status in Status}  # an enum's own lookup is slow
Kind = Literal["integer", "number", "text", "truth"]
_KINDS: dict[str, Kind] = {"bool": "truth", "string": "text", "float64": "number"}
# Flags of the message, and the beginnings of the names of what they are about. In the table an
# unknown quantity is blank instead.
_VALID = {
    "load_valid": ("load",),
    "slip_valid": ("slip",),
    "sinkage_measured_valid": ("sinkage_measured",),
    "prediction_valid": (
        "sinkage_predicted",
        "compaction_resistance",
        "other_resistance",
        "rolling_resistance_coefficient",
    ),
    "traction_valid": ("thrust", "drawbar_pull", "probability_drawbar_pull_positive"),
    "margin_valid": ("mobility_margin", "steepest_slope"),
    "energy_valid": ("energy_per_metre",),
}
_SPREADS = tuple(f"soil_{name}_standard_deviation" for name in "knm")


@cache
def _fields(message: str) -> tuple[tuple[str, Kind], ...]:
    """Names and kinds of a message's simple fields, without its constants."""
    return tuple(
        (name, _KINDS.get(str(described[1][0]), "integer"))
        for name, described in typestore().fielddefs[message][1]
        if int(described[0]) == 1  # a plain value, no message and no array
    )


@cache
def _soil_fields() -> tuple[str, ...]:
    return tuple(name for name, _ in _fields(SOIL))


@cache
def _soil_names() -> tuple[str, ...]:
    return tuple(f"soil_{name}" for name in _soil_fields())


@cache
def columns() -> dict[str, Kind]:
    """Return the table's columns in their order."""
    first: dict[str, Kind] = {
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
    own = {name: kind for name, kind in _fields(MOBILITY) if name not in _VALID}
    soil = {f"soil_{name}": kind for name, kind in _fields(SOIL)}
    after: dict[str, Kind] = dict.fromkeys(_SPREADS, "number")
    return {**first, **own, "status": "text", **soil, **after, "soil_changes": "integer"}


@cache
def _blanks() -> dict[str, tuple[str, ...]]:
    """Columns to leave blank where a flag is false."""
    names = [name for name, _ in _fields(MOBILITY) if name not in _VALID]
    return {
        flag: tuple(
            name
            for name in names
            if any(name in (start, f"{start}_standard_deviation") for start in starts)
        )
        for flag, starts in _VALID.items()
    }


class Estimate(NamedTuple):
    """One result: a row of the table, and the fields of the two messages."""

    row: dict[str, Any]
    mobility: dict[str, Any]
    soil: dict[str, Any]


def estimate_of(result: Result, start: int) -> Estimate:
    """Return a result as row and messages. start: the bag's first log time, ns."""
    found = result.mobility
    x, y = result.vehicle or (None, None)
    mobility, soil = mobility_fields(found), soil_fields(result.soil, result.rejected)
    row: dict[str, Any] = {
        "stamp": found.stamp,
        "time": (found.stamp - start) / SECOND,
        "wheel": found.wheel,
        "x": x,
        "y": y,
        "speed": result.speed,
        "travel": result.soil.distance,
        **mobility,
        "status": STATUS_NAMES[found.status],
    }
    for flag, names in _blanks().items():
        if not row[flag]:
            row.update(dict.fromkeys(names))
    row.update(zip(_soil_names(), map(soil.__getitem__, _soil_fields()), strict=True))
    for name, variance in zip(_SPREADS, result.soil.covariance.diagonal().tolist(), strict=True):
        row[name] = max(variance, 0.0) ** 0.5
    row["soil_changes"] = result.soil.soil_changes
    return Estimate(row, mobility, soil)


def as_message(fields: dict[str, Any], stamp: int, frame: str) -> Any:
    """Return a message with a header and these fields, to be serialised.

    To serialise, rosbags reads attributes of whatever object; one of its own classes takes three
    times as long to make.
    """
    seconds, rest = divmod(stamp, SECOND)
    header = SimpleNamespace(stamp=SimpleNamespace(sec=seconds, nanosec=rest), frame_id=frame)
    return SimpleNamespace(header=header, **fields)
