"""Estimates as rows of a table and as messages, with the names of the messages' fields."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from operator import itemgetter
from typing import Any, Literal, NamedTuple

from smallwheel_ros.bags import Nodetype, packer, typestore
from smallwheel_ros.onboard.message_fields import mobility_fields, soil_fields
from smallwheel_ros.onboard.mobility import Status
from smallwheel_ros.onboard.onboard import Result
from smallwheel_ros.onboard.streams import SECOND

MOBILITY = "smallwheel_ros/msg/MobilityEstimate"
SOIL = "smallwheel_ros/msg/SoilEstimate"
STATUS_NAMES = {status: status.name for status in Status}  # an enum's own lookup is slow
Kind = Literal["integer", "number", "text", "truth"]
_Getter = Callable[[dict[str, Any]], tuple[Any, ...]]
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
        if described[0] == Nodetype.BASE  # a plain value, no message and no array
    )


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
def _own() -> dict[str, Kind]:
    """Columns that are fields of the message about mobility."""
    kinds = _fields(MOBILITY)
    return {name: kind for name, kind in kinds if name not in _VALID and name not in _FIRST}


@cache
def columns() -> dict[str, Kind]:
    """Return the table's columns in their order."""
    soil = {f"soil_{name}": kind for name, kind in _fields(SOIL)}
    after: dict[str, Kind] = dict.fromkeys(_SPREADS, "number")
    return {**_FIRST, **_own(), **soil, **after, "soil_changes": "integer"}


@cache
def _cells() -> tuple[_Getter, _Getter]:
    """Return what takes the cells of a row out of the fields of the two messages."""
    return itemgetter(*_own()), itemgetter(*(name for name, _ in _fields(SOIL)))


@cache
def _flags() -> _Getter:
    return itemgetter(*_VALID)


@cache
def _blanks() -> dict[str, tuple[str, ...]]:
    """Columns to leave blank where a flag is false."""
    return {
        flag: tuple(
            name
            for name in _own()
            if any(name in (start, f"{start}_standard_deviation") for start in starts)
        )
        for flag, starts in _VALID.items()
    }


def _blanked(mobility: dict[str, Any]) -> dict[str, Any]:
    """Fields of a message for the table: nothing where the message has 0 for what is not known."""
    if all(_flags()(mobility)):
        return mobility
    unknown = [name for flag, names in _blanks().items() if not mobility[flag] for name in names]
    return {**mobility, **dict.fromkeys(unknown)}


class Estimate(NamedTuple):
    """One result: a row of the table by `columns`, and the stamp, wheel and fields of messages."""

    row: tuple[Any, ...]
    stamp: int
    wheel: str
    mobility: dict[str, Any]
    soil: dict[str, Any]


def estimate_of(result: Result, start: int) -> Estimate:
    """Return a result as row and messages. start: the bag's first log time, ns."""
    found, believed = result.mobility, result.soil
    mobility, soil = mobility_fields(found), soil_fields(believed, result.rejected)
    own_cells, soil_cells = _cells()
    row = (
        found.stamp,
        (found.stamp - start) / SECOND,
        found.wheel,
        *(result.vehicle or (None, None)),
        result.speed,
        believed.distance,
        STATUS_NAMES[found.status],
        found.status_text,
        *own_cells(_blanked(mobility)),
        *soil_cells(soil),
        *[max(variance, 0.0) ** 0.5 for variance in believed.covariance.diagonal().tolist()],
        believed.soil_changes,
    )
    return Estimate(row, found.stamp, found.wheel, mobility, soil)


@cache
def _after_header(message: str) -> _Getter:
    return itemgetter(*(name for name, _ in typestore().fielddefs[message][1][1:]))


def as_bytes(message: str, fields: dict[str, Any], stamp: int, frame: str) -> bytes:
    """Return a message with a header and these fields as it is in a bag."""
    seconds, rest = divmod(stamp, SECOND)
    return packer(message)((seconds, rest, frame, *_after_header(message)(fields)))
