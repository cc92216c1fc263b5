# SPDX-License-Identifier: Apache-2.0
"""Everything that node and replay report during a drive: both use one function."""

from __future__ import annotations

import re
from typing import Literal, NamedTuple

from smallwheel_ros.pipeline.mobility.vehicle import vehicle_margin
from smallwheel_ros.pipeline.pipeline import Pipeline
from smallwheel_ros.pipeline.tables import Estimates

Entry = Literal["filter", "sensors", "alarms", "vehicle"]
Kind = Literal["filter", "sensor", "may_get_stuck", "gets_stuck", "missing_effect", "holds_nothing"]
_NUMBER = re.compile(r"[-+]?\d+(\.\d+)?(e[-+]?\d+)?")


class Statement(NamedTuple):
    """Something to report.

    Attributes
    ----------
    entry
        Entry of the node's diagnostics that it belongs to.
    kind
        Kind of the report, one of `Kind`.
    is_error
        Whether it is an error; otherwise it is a warning.
    text
        The report, a sentence without its full stop.
    """

    entry: Entry
    kind: Kind
    is_error: bool
    text: str

    @property
    def about(self) -> str:
        """The text without its numbers, by which a repeated report is recognised."""
        return _NUMBER.sub("", self.text)


# By level of the warning; names and words are those of `WarningLevel` wherever it is reported.
WARNINGS: tuple[Kind, ...] = ("may_get_stuck", "gets_stuck")


def statements(pipeline: Pipeline, newest: Estimates) -> tuple[Statement, ...]:
    """List everything that node and replay report at present.

    Parameters
    ----------
    pipeline
        Pipeline whose findings and alarms are reported.
    newest
        The newest row of each wheel, for the vehicle's margin.

    Returns
    -------
    tuple of Statement
        Alarms first, then the vehicle's margin, the filter, and findings on sensors.
    """
    found = list(alarms(pipeline))
    margin = vehicle_margin(newest)
    if margin is not None and not margin.value > 0.0:
        text = "the soil does not hold the vehicle, not even on level ground"
        found.append(Statement("vehicle", "holds_nothing", True, text))
    if pipeline.concern:
        found.append(Statement("filter", "filter", False, pipeline.concern))
    found += [Statement("sensors", "sensor", False, text) for text in pipeline.findings]
    return tuple(found)


def alarms(pipeline: Pipeline) -> tuple[Statement, ...]:
    """The reports that need action at once: a warning of getting stuck, and a missing effect."""
    found = []
    level = pipeline.level
    if level:
        found.append(Statement("alarms", WARNINGS[level - 1], level == 2, pipeline.warning))
    missing = pipeline.missing_effect
    if missing is not None:
        found.append(Statement("alarms", "missing_effect", False, missing.message))
    return tuple(found)
