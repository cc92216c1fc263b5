"""The whole story of one table: models compared, where they fail, which effect is missing, what next."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from smallwheel_ros.compare.comparison import Comparison
from smallwheel_ros.compare.results import Floor
from smallwheel_ros.report.compare_report import (
    caveats,
    failure_blocks,
    model_blocks,
    scatter_blocks,
    summary,
)
from smallwheel_ros.report.data_section import data_blocks
from smallwheel_ros.report.diagnosis_report import caveats as diagnosis_caveats
from smallwheel_ros.report.diagnosis_report import (
    check_diagnosis,
    next_blocks,
    ranking_blocks,
    region_blocks,
    step_blocks,
    unknowable_blocks,
)
from smallwheel_ros.report.page import Picture, Section, Text, page
from smallwheel_ros.report.verdict_section import verdict_block

_FLOOR = "with the scatter of the soil from run to run"
_NO_FLOOR = "the diagnosis could not tell noise from misfit: repeat runs"
_TWICE = (
    "Comparison and diagnosis hold out the same runs. The comparison fits each model with noise of "
    "the size that its own predictions have, the diagnosis all models with one size, so that they can "
    "be ranked: their held-out errors of the same base model differ a little."
)


def whole_report(
    comparison: Comparison,
    document: Mapping[str, Any],
    pictures: Mapping[str, Sequence[Picture]] | None = None,
) -> str:
    """One self-contained HTML page for a comparison and a diagnosis of the same measurements.

    document: what `smallwheel diagnose --json` writes. pictures: further ones for the sections
    "where_it_fails" and "steps". Raises ReportError where the document is not one of a diagnosis.
    """
    check_diagnosis(document)
    data = comparison.measurements
    comparison = replace(comparison, noise=_floors(comparison, document))
    more = pictures or {}
    said = dict.fromkeys([*caveats(comparison), *diagnosis_caveats(document), _TWICE])
    return page(
        "Models, measurements, and what is missing",
        [
            Section("In short", [verdict_block(document), Text(items=summary(comparison))]),
            Section("The data", data_blocks(comparison)),
            Section("Models side by side",
                    [*model_blocks(comparison), *scatter_blocks(comparison)]),
            Section("Where the model fails",
                    [*region_blocks(document), *more.get("where_it_fails", ()),
                     *failure_blocks(comparison)]),
            Section("Which effect is missing", ranking_blocks(document)),
            Section("Held-out error, step by step",
                    [*step_blocks(document), *more.get("steps", ())]),
            Section("What this data cannot tell", unknowable_blocks(document)),
            Section("What to measure next", next_blocks(document)),
            Section("What to keep in mind", [Text(items=[*said])]),
        ],
        data.source,
        f"Data: SHA-256 {data.sha256}." if data.sha256 else "",
    )  # fmt: skip


def _floors(comparison: Comparison, document: Mapping[str, Any]) -> dict[str, Floor]:
    """The diagnosis' noise floor in place of the comparison's: one floor in all pictures."""
    known = document.get("channels") or {}
    floors = {}
    for name, floor in comparison.noise.items():
        channel = known.get(name, {})
        value, repeats = channel.get("noise_floor"), channel.get("repeatability")
        repeats = floor.repeatability if repeats is None else repeats
        if value is None:
            floors[name] = Floor(None, None, _NO_FLOOR, repeats)
        else:
            floors[name] = Floor(float(value), channel.get("noise_floor_source"), _FLOOR, repeats)
    return floors
