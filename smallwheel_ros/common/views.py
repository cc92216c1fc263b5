# SPDX-License-Identifier: Apache-2.0
"""Who shows which result, and how: a result knows nothing of pictures, pages or files.

The functions are found when they are first asked for, so that a result does not bring what draws it.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from typing import Any

# By what is asked for, by the class of the result: module and function, which takes the result (a
# plot the axes before it). A page is a report.page.Page: HTML, and text where no shorter one is named.
VIEWS: dict[str, dict[str, str]] = {
    "text": {
        "Benchmark": "report.benchmark:benchmark_text",
        "Measurements": "report.measured:measured_text",
        "Model": "model.model_file:model_text",
        "Diagnosis": "report.diagnosis:diagnosis_text",
        "Replayed": "replay.report:replay_text",
    },
    "document": {
        "Benchmark": "report.benchmark:benchmark_document",
        "Model": "model.model_file:model_document",
        "Comparison": "compare.shown:comparison_document",
    },
    "rows": {
        "Benchmark": "report.benchmark:benchmark_rows",
        "Model": "model.model_file:model_rows",
    },
    "plot": {
        "Measurements": "report.measured:draw_measured",
        "FitResult": "pictures.fit:draw_fit",
        "Comparison": "pictures.comparison:draw_comparison",
        "Diagnosis": "pictures.diagnosis:draw_steps",
        "Added": "pictures.fit:draw_added",
        "Learnt": "pictures.fit:draw_learnt",
        "PredictionTable": "pictures.physics:draw_table",
        "Replayed": "replay.pictures:draw_replay",
    },
    "page": {
        "Benchmark": "report.benchmark:benchmark_page",
        "Comparison": "report.comparison:comparison_page",
        "Diagnosis": "explore.data:explored_page",
        "Learnt": "report.learnt:learnt_page",
        "Replayed": "replay.report:replay_page",
    },
    "model": {"Model": "model.model_file:write_model"},
}
READ_MODEL = "model.model_file:read_model"


def view_of(kind: str, result: object) -> Callable[..., Any]:
    """The function that shows a result in that way. Raises NotImplementedError where there is none."""
    known = VIEWS[kind]
    name = next((cls.__name__ for cls in type(result).__mro__ if cls.__name__ in known), None)
    if name is None:
        raise NotImplementedError(f"a {type(result).__name__} has no {kind}")
    return function(known[name])


def function(name: str) -> Callable[..., Any]:
    """The function of that name, `module:function` of this package."""
    module, _, of_it = name.partition(":")
    found: Callable[..., Any] = getattr(import_module(f"smallwheel_ros.{module}"), of_it)
    return found


def has_view(kind: str, result: object) -> bool:
    """Whether a result is shown in that way."""
    return any(cls.__name__ in VIEWS[kind] for cls in type(result).__mro__)
