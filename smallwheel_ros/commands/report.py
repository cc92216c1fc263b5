"""`smallwheel report`: the whole story of a table in one page."""

from __future__ import annotations

from pathlib import Path

import click
from tqdm import tqdm

from smallwheel_ros.commands.bench_compare import standing_contenders
from smallwheel_ros.commands.inputs import data_options, read_inputs
from smallwheel_ros.compare.comparison import compare
from smallwheel_ros.compare.document import comparison_document
from smallwheel_ros.diagnosis import diagnose
from smallwheel_ros.output import check_targets
from smallwheel_ros.report.diagnosis_pictures import residual_pictures
from smallwheel_ros.report.page import write_page
from smallwheel_ros.report.whole_report import whole_report
from smallwheel_ros.tables import write_json

_STEPS = 5  # that a diagnosis tells of


@click.command("report", short_help="The whole story of a table of measurements in one HTML page.")
@data_options
@click.option("-o", "--output", required=True, type=click.Path(path_type=Path), metavar="FILE",
              help="HTML file to write.")  # fmt: skip
@click.option("--json", "json_file", metavar="FILE",
              help="Write comparison and diagnosis as JSON, - for standard output.")  # fmt: skip
def report(
    data: Path,
    model_file: Path | None,
    own: Path | None,
    diameter: float | None,
    width: float | None,
    output: Path,
    json_file: str | None,
) -> None:
    """Write one self-contained HTML page on the measurements in DATA (CSV or Parquet).

    The data, models side by side, where the model fails, which effect is missing, the held-out
    error step by step, what this data cannot tell, what to measure next.
    """
    targets = [output, *(Path(name) for name in (json_file,) if name not in (None, "-"))]
    check_targets(targets, [data, model_file, own])
    measurements, base, registry = read_inputs(data, model_file, own, diameter, width)
    standing = [] if model_file is None else standing_contenders([model_file], own)
    with tqdm(desc="comparing", unit="fit", disable=None, leave=False) as bar:

        def count(done: int, needed: int) -> None:
            bar.total = needed
            bar.update(done - bar.n)

        comparison = compare(measurements, standing, progress=count)
    with tqdm(desc="diagnosing", total=_STEPS, disable=None, leave=False) as bar:

        def step(name: str) -> None:
            bar.set_description(name)
            bar.update()

        diagnosis = diagnose(measurements, base, registry=registry, progress=step)
    html = whole_report(comparison, diagnosis.document, {"steps": residual_pictures(diagnosis)})
    document = {
        "schema": 1,
        "comparison": comparison_document(comparison),
        "diagnosis": diagnosis.document,
    }
    write_page(output, html)
    if json_file is not None:
        write_json(json_file, document)
    click.echo(f"written: {', '.join(str(target) for target in targets)}", err=json_file == "-")
