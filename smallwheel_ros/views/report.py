# SPDX-License-Identifier: Apache-2.0
"""The complete report on a table in one page: its diagnosis, and models side by side."""

from __future__ import annotations

from smallwheel_ros.compare.comparison import Comparison
from smallwheel_ros.diagnosis.pipeline import Diagnosis
from smallwheel_ros.views import comparison as compared
from smallwheel_ros.views import diagnosis as diagnosed
from smallwheel_ros.views.blocks import Models, Section, Text
from smallwheel_ros.views.page import Page

_TWICE = (
    "Comparison and diagnosis hold out the same runs, and state the same error of the same model."
)


def page(found: Diagnosis, beside: Comparison, models: Models | None = None) -> Page:
    """Make the page of a diagnosis with a comparison of models on the same measurements.

    Parameters
    ----------
    found
        The diagnosis.
    beside
        The comparison; its expected errors of a true model are replaced by those of the diagnosis.
    models
        Block in which effects can be set and unset; None: the one that `models_block` makes.
    """
    beside = compared.with_floors(beside, found.document)
    made = diagnosed.page(found, models=models)
    sections = {section.title: section for section in made.sections}
    sections["In short"] = Section(
        "In short",
        [*sections["In short"].blocks, Text(items=compared.best_sentences(beside, diagnosed=True))],
    )
    sections["The data"] = Section("The data", compared.data_blocks(beside))
    side = Section("Models side by side",
                   [*compared.model_blocks(beside), *compared.left_blocks(beside)])  # fmt: skip
    caveats = compared.caveats(beside, diagnosed=True) + diagnosed.caveats(found.document)
    kept = Section("What to keep in mind", [Text(items=list(dict.fromkeys([*caveats, _TWICE])))])
    listed = [kept if s.title == kept.title else s for s in sections.values()]
    at = next(i for i, section in enumerate(listed) if section.title == "Where the model fails")
    data = found.measurements
    return Page("Models, measurements, and what is missing", [*listed[:at], side, *listed[at:]],
                data.source, made.footer)  # fmt: skip
