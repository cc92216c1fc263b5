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
    found = list(alarms(onboard, results))
    margin = vehicle_margin(results)
    if margin is not None and not margin.value > 0.0:
        text = "the soil holds the vehicle on no slope, nor on the level"
        found.append(Statement("vehicle", "holds_nothing", True, text))
    if onboard.concern:
        found.append(Statement("filter", "filter", False, onboard.concern))
    found += [Statement("sensors", "sensor", False, text) for text in onboard.findings]
    return tuple(found)


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
