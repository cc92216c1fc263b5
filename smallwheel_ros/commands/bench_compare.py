"""`smallwheel compare`: models against measurements."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path

import click
from matplotlib.figure import Figure
from tqdm import tqdm

from smallwheel_ros.commands.inputs import warn
from smallwheel_ros.compare.comparison import Comparison
from smallwheel_ros.compare.comparison import compare as compare_models
from smallwheel_ros.compare.contenders import STANDARD, Contender
from smallwheel_ros.compare.document import comparison_document
from smallwheel_ros.compare.text import comparison_text
from smallwheel_ros.effects.registry import load_effects
from smallwheel_ros.measurements.table import read_measurements
from smallwheel_ros.model_file import read_model
from smallwheel_ros.output import OutputError, check_folder_target, check_targets, write_bytes
from smallwheel_ros.pictures.comparison import (
    error_bars,
    measured_against_predicted,
    residuals,
    resistance_ratio,
)
from smallwheel_ros.report.compare_report import compare_report
from smallwheel_ros.report.page import write_page
from smallwheel_ros.tables import write_json


@click.command("compare", short_help="Models against measurements, side by side.")
@click.argument("data", type=click.Path(path_type=Path))
@click.option("--model", "models", multiple=True, type=click.Path(path_type=Path),
              help="A model file to compare too; may be given several times.")  # fmt: skip
@click.option("--effects", "effects_file", type=click.Path(path_type=Path),
              help="A Python file with effects of your own that a model file uses. It is run: name "
              "only files that you trust.")  # fmt: skip
@click.option("--diameter", type=float, help="Wheel diameter [m] for all rows.")
@click.option("--width", type=float, help="Wheel width [m] for all rows.")
@click.option("--json", "json_file", metavar="FILE", help="Write the result as JSON, - for stdout.")
@click.option("--plots", metavar="DIR", type=click.Path(path_type=Path),
              help="Write pictures (PNG) into this folder.")  # fmt: skip
@click.option("--html", metavar="FILE", type=click.Path(path_type=Path),
              help="Write a self-contained report.")  # fmt: skip
def compare(
    data: Path,
    models: tuple[Path, ...],
    effects_file: Path | None,
    diameter: float | None,
    width: float | None,
    json_file: str | None,
    plots: Path | None,
    html: Path | None,
) -> None:
    """Compare models with the measurements in DATA (CSV or Parquet).

    The closed forms of Bekker and of Meirion-Griffith & Spenko and the contact integral are fitted to
    the data, and judged on runs that were held out of the fit. A model file stands as it is. Errors
    are given for each channel, soil, wheel and range of conditions, beside the noise floor: the error
    that a true model would leave.
    """
    check_targets([html, json_file], [data, *models, effects_file])
    check_folder_target(plots)
    measurements = read_measurements(data, diameter=diameter, width=width)
    contenders = standing_contenders(models, effects_file)
    with tqdm(desc="fitting", unit="fit", disable=None, leave=False) as bar:

        def show(done: int, needed: int) -> None:
            bar.total = needed
            bar.update(done - bar.n)

        comparison = compare_models(measurements, contenders, progress=show)
    warn(measurements)
    if html is not None:
        write_page(html, compare_report(comparison))
    if plots is not None:
        write_pictures(comparison, plots)
    if json_file is not None:
        write_json(json_file, comparison_document(comparison))
    if json_file != "-":
        click.echo(comparison_text(comparison))
        written = [str(path) for path in (html, plots, json_file) if path is not None]
        if written:
            click.echo(f"written: {', '.join(written)}")


def standing_contenders(
    models: Sequence[Path], effects_file: Path | None = None
) -> list[Contender]:
    """One contender for each model file, each under a name of its own."""
    user = load_effects(effects_file) if effects_file else None
    found: list[Contender] = []
    for path in models:
        read = read_model(path, user)
        names = [*STANDARD, *(c.name for c in found)]
        name = path.stem if path.stem not in names else str(path)
        effects = ", ".join(effect.id for effect in read.model.effects)
        about = f"model file {path}: {read.model.geometry}, " + (effects or "no effects")
        digest = str(read.provenance.get("sha256", ""))
        found.append(Contender(name, about, read.model, str(path), digest))
    return found


def write_pictures(comparison: Comparison, folder: Path) -> list[Path]:
    """Write every picture of the comparison as PNG. Raises OutputError where it cannot."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"{folder}: cannot be made: {error.strerror or error}") from None
    figures: dict[str, Figure | None] = {
        "resistance_ratio": resistance_ratio(comparison.measurements)
    }
    if comparison.channels:
        figures["errors"] = error_bars(comparison)
    for channel in comparison.channels:
        figures[f"{channel}_measured_predicted"] = measured_against_predicted(comparison, channel)
        figures[f"{channel}_residuals"] = residuals(comparison, channel)
    written = []
    for name, figure in figures.items():
        if figure is None:
            continue
        buffer = io.BytesIO()
        figure.savefig(buffer, format="png", dpi=150)
        written.append(folder / f"{name}.png")
        write_bytes(written[-1], buffer.getvalue())
    return written
