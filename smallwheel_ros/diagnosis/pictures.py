"""Pictures of a diagnosis: residuals before and after, the staircase, the ranking; and the report."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from smallwheel_ros.compare.scores import UNITS
from smallwheel_ros.compare.smoothing import smooth
from smallwheel_ros.diagnosis.candidates import settings_of
from smallwheel_ros.diagnosis.pipeline import Diagnosis
from smallwheel_ros.display import column_display, display, words
from smallwheel_ros.output import OutputError, write_bytes
from smallwheel_ros.pictures.comparison import COLOURS, GREY, new_figure, resistance_ratio, style
from smallwheel_ros.pictures.diagnosis import ranking_bars, staircase
from smallwheel_ros.report.diagnosis_report import diagnosis_report
from smallwheel_ros.report.page import Picture

_PANELS = 3


def residual_panels(diagnosis: Diagnosis) -> Figure | None:
    """Held-out errors over the settings in which the base fails, before and after what was added."""
    if not diagnosis.steps or diagnosis.workbench is None:
        return None
    regions = diagnosis.document["where_it_fails"]
    pairs = list(dict.fromkeys((r["channel"], str(r["region"]).split(" ")[0]) for r in regions))
    if not pairs:
        observations = diagnosis.workbench.observations
        pairs = [(channel, "load") for channel in observations.channels]
    pairs = pairs[:_PANELS]
    figure = new_figure(3.6 * len(pairs), 2.9)
    panels = figure.subplots(1, len(pairs), squeeze=False)[0]
    for axes, (channel, setting) in zip(panels, pairs, strict=True):
        _panel(diagnosis, axes, channel, setting)
    panels[0].legend(fontsize=8, frameon=False)
    return figure


def _panel(diagnosis: Diagnosis, axes: object, channel: str, setting: str) -> None:
    from matplotlib.axes import Axes

    assert isinstance(axes, Axes)
    assert diagnosis.workbench is not None
    observations = diagnosis.workbench.observations
    mask = observations.of_channel(channel)
    how = display(channel, UNITS[channel])
    across = column_display(diagnosis.measurements, setting)
    x = settings_of(observations)[setting][observations.row[mask]] * across.scale
    shown = [(diagnosis.steps[0], "base model", GREY)]
    if len(diagnosis.steps) > 1:
        added = ", ".join(words(step.added or "") for step in diagnosis.steps[1:])
        shown.append((diagnosis.steps[-1], f"with {added}", COLOURS[2]))
    for step, label, colour in shown:
        y = step.errors.error[mask] * how.scale
        axes.plot(x, y, "o", markersize=3, color=colour, alpha=0.6, label=label)
        if np.unique(x).size > 4:
            curve = smooth(x, y, observations.run[mask])
            axes.plot(curve.x, curve.y, color=colour, linewidth=1.4)
            axes.fill_between(curve.x, curve.low, curve.high, color=colour, alpha=0.15, linewidth=0)
    axes.axhline(0.0, color=GREY, linewidth=0.8)
    style(axes, across.label, f"measured - predicted [{how.unit}]", words(channel))


def figures(diagnosis: Diagnosis) -> dict[str, Figure]:
    """Every picture by name."""
    found = {
        "resistance_ratio": resistance_ratio(diagnosis.measurements),
        "residuals": residual_panels(diagnosis),
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
    panels = residual_panels(diagnosis)
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
