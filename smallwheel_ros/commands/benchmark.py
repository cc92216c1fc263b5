# SPDX-License-Identifier: Apache-2.0
"""`smallwheel benchmark`: the laws of sinkage, pull and torque on data that anybody may have."""

from __future__ import annotations

from pathlib import Path

import click
from tqdm import tqdm

from smallwheel_ros.benchmark.benchmark import benchmark
from smallwheel_ros.common.console import JSON, show
from smallwheel_ros.common.files import check_targets


@click.command(
    "benchmark", short_help="The laws of sinkage on public data, parts left out in turn."
)
@click.argument("folder", type=click.Path(path_type=Path))
@click.option("-o", "--output", type=click.Path(path_type=Path), metavar="FILE",
              help="Write the errors as a table (CSV).")  # fmt: skip
@JSON
def benchmark_command(folder: Path, output: Path | None, json_file: str | None) -> None:
    """Hold laws of sinkage, pull and torque against the measured data sets in FOLDER.

    A data set is a folder with its licence (a file LICENSE) and its tables. One size of plate, level of
    slip or run after the other is left out; Bernstein-Goriatchkin, Bekker, Reece and Meirion-Griffith &
    Spenko are fitted to the rest, the last also with the contact integral and with the effects that a
    diagnosis of the rest names. Beside them are the mean of the rest, and the law of Wong and Reece where
    pull or torque was measured; these and the contact integral predict pull and torque, too. What is
    printed is the error on what was left out, and where our law loses.
    """
    check_targets([output, json_file])
    with tqdm(desc="benchmark", unit="fit", disable=None, leave=False) as bar:

        def progress(step: str) -> None:
            bar.set_description(step)
            bar.update()

        result = benchmark(folder, progress)
    written = [] if output is None else [result.save(output)]
    show(result, json_file, written)
