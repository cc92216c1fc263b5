# SPDX-License-Identifier: Apache-2.0
"""The demo over real DDS: its tables, its pictures, and what it says.

Tests `command.py`, `demo.py` and `pictures.py`.
"""

from __future__ import annotations

import re
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from smallwheel_ros.cli import main
from smallwheel_ros.simulate import DriveSettings

pytestmark = pytest.mark.dds


def test_demo_makes_table_and_picture(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """At twice its speed: the drive to where it is stuck takes half as long."""
    import pandas as pd

    from smallwheel_ros.demo import demo

    monkeypatch.setattr(demo, "DriveSettings", partial(DriveSettings, speed=1.0))
    folder = tmp_path / "demo"
    done = CliRunner().invoke(
        main, ["demo", "-o", str(folder), "--distance", "2", "--seed", "3", "--rate", "16"]
    )
    assert done.exit_code == 0, (done.output, done.exception)
    pictures = ("drive.png", "cost.png")
    for name in (*pictures, "mobility.csv", "soil.csv"):
        assert str(folder / name) in done.stdout
    for name in pictures:
        assert (folder / name).read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    assert re.search(r"stuck on the slope at .* s before \(may get stuck\)", done.stdout), (
        done.stdout
    )
    table = pd.read_csv(folder / "mobility.csv")
    assert sorted(table["wheel"].unique()) == [
        "front_left",
        "front_right",
        "rear_left",
        "rear_right",
    ]
    assert f"{len(table)} estimates, 0 sinkages without answer" in done.stdout
    assert (table["status"] == 0).sum() > 100
    soil = pd.read_csv(folder / "soil.csv")
    assert np.all(np.isfinite(soil[["k", "n", "m", "k_standard_deviation"]]))
