"""Pictures of a diagnosis: residuals before and after, the staircase, the ranking; and the report."""

from __future__ import annotations

from pathlib import Path

from matplotlib.figure import Figure

from smallwheel_ros.diagnosis.candidates import settings_of
from smallwheel_ros.diagnosis.pipeline import Diagnosis
from smallwheel_ros.display import words
from smallwheel_ros.output import OutputError, write_bytes
from smallwheel_ros.pictures.comparison import resistance_ratio
from smallwheel_ros.pictures.diagnosis import ranking_bars, staircase
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
    if diagnosis.workbench is None:
        return None
    observations = diagnosis.workbench.observations
    shown = [Shown(diagnosis.steps[0].errors, BEFORE, "base model")]
    if len(diagnosis.steps) > 1:
        added = ", ".join(words(step.added or "") for step in diagnosis.steps[1:])
        shown.append(Shown(diagnosis.steps[-1].errors, AFTER, f"with {added}"))
    pairs = failing_settings(diagnosis.document, settings_of(observations))
    return residual_panels(diagnosis.measurements, observations, shown, pairs)


def figures(diagnosis: Diagnosis) -> dict[str, Figure]:
    """Every picture by name."""
    found = {
        "resistance_ratio": resistance_ratio(diagnosis.measurements),
        "residuals": residual_figure(diagnosis),
        "ranking": ranking_bars(diagnosis.document),
        "staircase": staircase(diagnosis.document),
    }
    return {name: figure for name, figure in found.items() if figure is not None}


def report_page(diagnosis: Diagnosis) -> str:
    """The diagnosis as one self-contained HTML page."""
    pictures: dict[str, list[Picture]] = {}
    ratio = resistance_ratio(diagnosis.measurements)
    if ratio is not None:
        caption = (
            "A check free of k: compaction alone gives R/W along the curves; points above are a missing "
            "resistance, whatever k, n and m are."
        )
        pictures["data"] = [Picture(ratio, caption)]
    panels = residual_figure(diagnosis)
    if panels is not None:
        caption = "Held-out errors with a smooth and its 95 % band (bootstrap over runs)."
        pictures["where_it_fails"] = [Picture(panels, caption)]
    return diagnosis_report(diagnosis.document, pictures, source=diagnosis.measurements.source)


def write_pictures(diagnosis: Diagnosis, folder: Path) -> list[Path]:
    """Write every picture as PNG. Raises OutputError where it cannot."""
    import io

    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"{folder}: cannot be made: {error.strerror or error}") from None
    written = []
    for name, figure in figures(diagnosis).items():
        picture = io.BytesIO()
        figure.savefig(picture, format="png", dpi=150)
        path = folder / f"{name}.png"
        write_bytes(path, picture.getvalue())
        written.append(path)
    return written
