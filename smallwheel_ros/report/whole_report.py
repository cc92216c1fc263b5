# SPDX-License-Identifier: Apache-2.0
"""The whole story of one table: what is missing, models side by side, where they fail, what next."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from smallwheel_ros.compare.comparison import Comparison, Floor
from smallwheel_ros.measurements.table import Measurements
from smallwheel_ros.report.compare_report import (
    caveats,
    failure_blocks,
    model_blocks,
    model_plots,
    summary,
)
from smallwheel_ros.report.data_section import data_blocks
from smallwheel_ros.report.diagnosis_report import caveats as diagnosis_caveats
from smallwheel_ros.report.diagnosis_report import (
    channel_blocks,
    check_diagnosis,
    next_blocks,
    ranking_blocks,
    region_blocks,
    step_blocks,
    unknowable_blocks,
)
from smallwheel_ros.report.effects_section import EffectsPage
from smallwheel_ros.report.page import Block, Section, Text, page
from smallwheel_ros.report.resistance_ratio import ratio_blocks
from smallwheel_ros.report.verdict_section import verdict_block

_FLOOR = "with the scatter of the soil from run to run"
_NO_FLOOR = "the diagnosis could not tell noise from misfit: repeat runs"
_TWICE = (
    "Comparison and diagnosis hold out the same runs. The comparison fits each model with noise of "
    "the size that its own predictions have, the diagnosis all models with one size, so that they can "
    "be ranked: their held-out errors of the same base model differ a little."
)
_HOW = (
    "Tick an effect: error, residuals and parameters follow. Each point is predicted by a fit without "
    "its run. Point at one to see what it is; click on it to put its run aside."
)


def whole_report(
    document: Mapping[str, Any],
    *,
    effects: EffectsPage | None = None,
    comparison: Comparison | None = None,
    measurements: Measurements | None = None,
    served: bool = False,
) -> str:
    """One self-contained HTML page for a diagnosis, and a comparison of the same measurements.

    document: what `smallwheel diagnose --json` writes. effects: those to set and unset; None where
    nothing could be held out. served: by `explore`, which fits what the page lacks.
    Raises ReportError where the document is not one of a diagnosis.
    """
    check_diagnosis(document)
    table = measurements if comparison is None else comparison.measurements
    short: list[Block] = [verdict_block(document)]
    data, models, failures = channel_blocks(document), [], []
    said = diagnosis_caveats(document)
    if comparison is not None:
        comparison = replace(comparison, noise=_floors(comparison, document))
        short.append(Text(items=summary(comparison)))
        data = data_blocks(comparison)
        models = [*model_blocks(comparison), *model_plots(comparison)]
        failures = failure_blocks(comparison)
        said = [*caveats(comparison), *said, _TWICE]
    elif table is not None:
        failures = ratio_blocks(table)
    play: list[Block] = [] if effects is None else [Text(_HOW), effects.block()]
    title = "Which effect is missing?" if comparison is None else (
        "Models, measurements, and what is missing"
    )  # fmt: skip
    return page(
        title,
        [
            Section("In short", short),
            Section("Set and unset effects", play),
            Section("The data", data),
            Section("Models side by side", models),
            Section("Where the model fails", [*region_blocks(document), *failures]),
            Section("Which effect is missing", ranking_blocks(document)),
            Section("Held-out error, step by step", step_blocks(document)),
            Section("What this data cannot tell", unknowable_blocks(document)),
            Section("What to measure next", next_blocks(document)),
            Section("What to keep in mind", [Text(items=[*dict.fromkeys(said)])]),
        ],
        "" if table is None else table.source,
        f"Data: SHA-256 {table.sha256}." if table is not None and table.sha256 else "",
        served=served,
    )


def _floors(comparison: Comparison, document: Mapping[str, Any]) -> dict[str, Floor]:
    """What the diagnosis expects of a true model, in the comparison's pictures too."""
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
