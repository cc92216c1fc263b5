"""Pictures of a diagnosis that need more than its document; its report with them."""

from __future__ import annotations

from matplotlib.figure import Figure

from smallwheel_ros.diagnosis.pipeline import Diagnosis
from smallwheel_ros.display import listed
from smallwheel_ros.pictures.comparison import resistance_ratio
from smallwheel_ros.pictures.diagnosis import ranking_bars, staircase, unknown_curves
from smallwheel_ros.report.diagnosis_report import diagnosis_report
from smallwheel_ros.report.page import Picture
from smallwheel_ros.report.residual_picture import (
    AFTER,
    BEFORE,
    Shown,
    failing_settings,
    residual_panels,
)


def residual_figure(diagnosis: Diagnosis) -> Figure | None:
    """Held-out errors over the settings at which the model fails, before and after what was added."""
    if not diagnosis.steps:
        return None
    first, *added = diagnosis.steps
    shown = [Shown(first.errors, BEFORE, "base model")]
    if added:
        names = [step.added for step in added if step.added is not None]
        shown.append(Shown(added[-1].errors, AFTER, f"with {listed(names)}"))
    settings = diagnosis.problem.points.settings
    pairs = failing_settings(diagnosis.document, settings)
    return residual_panels(diagnosis.measurements, shown, pairs)


def residual_pictures(diagnosis: Diagnosis) -> list[Picture]:
    """The same as a picture of a report; none where nothing was held out."""
    figure = residual_figure(diagnosis)
    caption = "Held-out errors with a smooth and its 95 % band (bootstrap over runs)."
    return [] if figure is None else [Picture(figure, caption)]


def figures(diagnosis: Diagnosis) -> dict[str, Figure]:
    """Every picture by name."""
    unknown = diagnosis.document["verdict"] == "unknown_effect"
    found = {
        "resistance_ratio": resistance_ratio(diagnosis.measurements),
        "residuals": residual_figure(diagnosis),
        "ranking": ranking_bars(diagnosis.document),
        "curves": unknown_curves(diagnosis.document) if unknown else None,
        "staircase": staircase(diagnosis.document),
    }
    return {name: figure for name, figure in found.items() if figure is not None}


def report_page(diagnosis: Diagnosis) -> str:
    """The diagnosis as one self-contained HTML page."""
    pictures = {"where_it_fails": residual_pictures(diagnosis)}
    ratio = resistance_ratio(diagnosis.measurements)
    if ratio is not None:
        caption = (
            "A check free of k: compaction alone gives R/W along the curves; points above are a missing "
            "resistance, whatever k, n and m are."
        )
        pictures["data"] = [Picture(ratio, caption)]
    return diagnosis_report(diagnosis.document, pictures, source=diagnosis.measurements.source)
