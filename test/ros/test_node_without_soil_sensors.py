# SPDX-License-Identifier: Apache-2.0
"""The node of a vehicle that measures neither sinkage nor load, over DDS, with the shipped parameters."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from bag_kinds import beginning

from smallwheel_ros.bags import BagReader, BagWriter
from smallwheel_ros.ros import NodeProcess
from smallwheel_ros.simulate import DriveSettings, simulate_drive, write_drive_bag

pytestmark = pytest.mark.dds


def test_it_says_slip_and_grip_and_that_sinkage_is_unknown(
    repository: Path, tmp_path: Path
) -> None:
    from smallwheel_ros.ros.play import drive_through

    write_drive_bag(simulate_drive(DriveSettings(seed=5, distance=4.0)), tmp_path / "whole")
    first = beginning(tmp_path / "whole", tmp_path / "first", 10.0)
    with BagReader(first) as reader, BagWriter(tmp_path / "drive") as writer:
        for raw in reader.raw_messages():
            if not raw.topic.endswith(("/load", "/sinkage")):
                writer.write_raw(*raw)
    config, log = repository / "config" / "without_soil_sensors.yaml", tmp_path / "node.log"
    with NodeProcess([config], log, {"use_sim_time": "true"}) as node:
        found = drive_through(tmp_path / "drive", rate=4.0, alive=node.death)
        assert node.death() is None
    assert "Traceback" not in log.read_text()
    assert "nothing of the soil's law (no sinkage is measured)" in log.read_text()
    rows = found.mobility
    assert len(rows) > 200
    for row in rows:
        assert not row["prediction_valid"]
        assert np.isfinite([v for v in row.values() if isinstance(v, float)]).all()
    rolls = [row for row in rows if row["slip_valid"]]
    assert len(rolls) > 50
    assert all(row["slip_standard_deviation"] > 0.0 for row in rolls)
    assert all(row["traction_valid"] and row["margin_valid"] for row in rolls)
    assert any(row["risk_valid"] and row["level"] == 1 for row in found.vehicle)
