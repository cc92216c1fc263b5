# SPDX-License-Identifier: Apache-2.0
"""Everything that node and replay say of a drive while it goes on: one function for both."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Literal, NamedTuple

from smallwheel_ros.onboard.ground import vehicle_margin
from smallwheel_ros.onboard.onboard import Onboard
from smallwheel_ros.onboard.result import Result

Entry = Literal["filter", "sensors", "alarms", "vehicle"]
Kind = Literal["filter", "sensor", "digging_in", "stuck", "missing_effect", "holds_nothing"]
_NUMBER = re.compile(r"[-+]?\d+(\.\d+)?(e[-+]?\d+)?")


class Statement(NamedTuple):
    """Something to look at: which entry of the diagnostics says it, of what kind, how bad, and in words."""

    entry: Entry
    kind: Kind
    is_error: bool
    text: str

    @property
    def about(self) -> str:
        """The text without its numbers: the same as long as the same is said."""
        return _NUMBER.sub("", self.text)


def statements(onboard: Onboard, newest: Iterable[Result]) -> tuple[Statement, ...]:
    """What is to be said now. newest: the newest result of each wheel."""
    results = list(newest)
    return (*alarms(onboard, results), *_of_vehicle(onboard, results), *_of_sensors(onboard))


def alarms(onboard: Onboard, newest: Iterable[Result]) -> tuple[Statement, ...]:
    """What somebody should act on at once."""
    found = []
    digging = ", ".join(result.wheel for result in newest if result.digging_in)
    if digging:
        text = f"{digging}: digging in (slip and sinkage up, speed down): stop"
        found.append(Statement("alarms", "digging_in", True, text))
    if onboard.stuck.warning:
        found.append(Statement("alarms", "stuck", False, onboard.stuck.warning))
    missing = onboard.estimator.missing_effect
    if missing is not None:
        found.append(Statement("alarms", "missing_effect", False, missing.message))
    return tuple(found)


def _of_sensors(onboard: Onboard) -> tuple[Statement, ...]:
    concern = [Statement("filter", "filter", False, text) for text in [onboard.concern] if text]
    words = onboard.findings
    return (*concern, *(Statement("sensors", "sensor", False, text) for text in words))


def _of_vehicle(onboard: Onboard, newest: list[Result]) -> tuple[Statement, ...]:
    margin = vehicle_margin(newest)
    if margin is None or margin.value > 0.0:
        return ()
    text = "the soil holds the vehicle on no slope, nor on the level"
    return (Statement("vehicle", "holds_nothing", True, text),)
