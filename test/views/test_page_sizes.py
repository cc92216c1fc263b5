# SPDX-License-Identifier: Apache-2.0
"""A page of a diagnosis can be sent by mail, however long the table is that it is of."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import smallwheel_ros as sw
from smallwheel_ros.measurements.columns import CHANNELS
from smallwheel_ros.simulate import RigSettings, simulate_rig

LARGEST = 400_000  # bytes
# Of a table with twelve settings and four channels, each of which has a picture of its own with each.
LARGEST_OF_ALL = 500_000


def size(data: object, folder: Path) -> int:
    return sw.diagnose(data).save(folder / "page.html").stat().st_size  # type: ignore[arg-type]


@pytest.mark.parametrize("channels", [("sinkage",), CHANNELS])
def test_the_page_of_a_usual_table_is_small(tmp_path: Path, channels: tuple[str, ...]) -> None:
    settings = RigSettings(hidden=("slip_sinkage",), runs=16, channels=channels)
    assert size(simulate_rig(settings).table, tmp_path) < LARGEST


@pytest.mark.slow
@pytest.mark.parametrize("runs", [700, 5000])
def test_the_page_of_a_long_table_is_small(tmp_path: Path, runs: int) -> None:
    """Every channel with rows of its own, two soils, remarks of hundreds of letters, own columns."""
    settings = RigSettings(hidden=("slip_sinkage",), runs=runs, channels=CHANNELS)
    table, rng = simulate_rig(settings).table, np.random.default_rng(0)
    rows = len(table)
    table["soil"] = np.where(np.arange(rows) % 2, "sand of the second box", "sand of the first box")
    table["remark"] = [f"row {i}: {'as it was written down ' * 20}" for i in range(rows)]
    table["operator"] = [f"somebody with a long name {i}" for i in range(rows)]
    for i in range(6):
        table[f"own {i}"] = rng.normal(size=rows)
    for name in CHANNELS:
        column = next(header for header in table.columns if header.startswith(name))
        table.loc[rng.random(rows) < 0.3, column] = np.nan
    assert size(table, tmp_path) < LARGEST_OF_ALL
