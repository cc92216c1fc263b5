# SPDX-License-Identifier: Apache-2.0
"""`smallwheel report`: the whole story of a table in one page."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from smallwheel_ros import api
from smallwheel_ros.arguments import registry_of
from smallwheel_ros.commands.inputs import (
    DATA,
    MODEL,
    OWN,
    progress_of_fits,
    progress_of_steps,
    read_table,
    table_options,
)
from smallwheel_ros.common.console import JSON
from smallwheel_ros.common.files import check_targets
from smallwheel_ros.common.tables import write_json
from smallwheel_ros.diagnosis import Diagnosis
from smallwheel_ros.explore.data import explored_page
from smallwheel_ros.explore.session import ExploreError, Session


@click.command("report", short_help="The whole story of a table of measurements in one HTML page.")
@DATA
@MODEL
@OWN
@table_options
@click.option("-o", "--output", required=True, type=click.Path(path_type=Path), metavar="FILE",
              help="HTML file to write.")  # fmt: skip
@click.option("--pairs/--no-pairs", default=True, show_default=True,
              help="Whether pairs of effects can be set in the page: they take most of the time, with "
              "many runs long.")  # fmt: skip
@JSON
def report(
    data: Path,
    model_file: Path | None,
    own: Path | None,
    how: dict[str, Any],
    output: Path,
    pairs: bool,
    json_file: str | None,
) -> None:
    """Write one self-contained HTML page on the measurements in DATA.

    Effects to set and unset, the data, models side by side, where the model fails, which effect is
    missing, the held-out error step by step, what this data cannot tell, what to measure next.
    """
    targets = [output, *(Path(name) for name in (json_file,) if name not in (None, "-"))]
    check_targets(targets, [data, model_file, own])
    measurements = read_table(data, how)
    models = [] if model_file is None else [model_file]
    with progress_of_fits() as fits:
        comparison = api.compare(measurements, models, effects=own, progress=fits)
    with progress_of_steps("diagnosing") as steps:
        diagnosis = api.diagnose(measurements, model_file, effects=own, progress=steps)
    with progress_of_fits() as fits:
        page = explored_page(diagnosis, _session(diagnosis, own), comparison, fits, pairs)
    page.save(output)
    if json_file is not None:
        document = {
            "schema": 1,
            "comparison": comparison.to_dict(),
            "diagnosis": diagnosis.to_dict(),
        }
        write_json(json_file, document)
    click.echo(f"written: {', '.join(str(target) for target in targets)}", err=json_file == "-")


def _session(diagnosis: Diagnosis, own: Path | None) -> Session | None:
    """Effects to set and unset; None where all is of one run."""
    try:
        return Session(diagnosis, registry_of(own))
    except ExploreError:
        return None
