# SPDX-License-Identifier: Apache-2.0
"""What a diagnosis found, in a few sentences; and how its numbers and names are said everywhere."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from smallwheel_ros.diagnosis.text import verdict_sentences
from smallwheel_ros.measurements.display import brief, display, number
from smallwheel_ros.report.page import Callout


def verdict_block(document: Mapping[str, Any]) -> Callout:
    """Say the verdict of a diagnosis document."""
    first, *lines = verdict_sentences(document)
    clear = document["verdict"] in ("missing_effect", "adequate")
    return Callout(first.removesuffix("."), lines, "result" if clear else "warning")


def parameter_cells(
    unit: str, value: float | None, std: float | None, published: Sequence[float] | None
) -> list[str]:
    """Value, deviation, unit and published range of a fitted number, in degrees and millimetres."""
    how = display("", unit)
    shown = [number(None if v is None else v * how.scale, d) for v, d in ((value, 4), (std, 3))]
    known = "-" if not published else " to ".join(brief(v * how.scale) for v in published)
    return [*shown, how.unit.replace(" ", "\u00a0"), known]
