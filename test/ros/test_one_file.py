# SPDX-License-Identifier: Apache-2.0
"""The file that `init` writes is enough: the node runs with it alone, on bags of real robots."""

from __future__ import annotations

from pathlib import Path

import pytest
from bag_kinds import beginning
from click.testing import CliRunner

from smallwheel_ros.cli import main
from smallwheel_ros.ros import NodeProcess

pytestmark = pytest.mark.dds
# Sizes, places and mass, in whole numbers where they are: of each vehicle, as its own file has them.
NUMBERS = {
    "husky": {"diameter": 0.33, "width": 0.125, "track": 0.555, "wheelbase": 0.512, "mass": 75},
    "pathfinder": {"diameter": 0.22, "width": 0.1, "track": 0.6, "wheelbase": 0.4, "mass": 30},
    "warthog": {"diameter": 0.6, "width": 0.25, "track": 1.08, "wheelbase": 0.92, "mass": 280},
}
SLOW = pytest.mark.slow


@pytest.mark.parametrize(
    "name",
    [
        "pathfinder_flat",
        *(
            pytest.param(name, marks=SLOW)
            for name in (
                "husky_snow",
                "husky_wetgrass",
                "warthog_grass",
                "warthog_grass_pose_only",
                "warthog_gravel",
                "warthog_ice",
                "warthog_sand1",
            )
        ),
    ],
)
def test_the_node_runs_with_the_file_of_init_alone(
    name: str, shared_data: Path, tmp_path: Path
) -> None:
    from smallwheel_ros.ros.play import drive_through

    whole = shared_data / "real_drives" / name
    if not whole.exists():
        pytest.skip(f"no recorded drive {whole}")
    config = tmp_path / "rover.yaml"
    said = CliRunner().invoke(main, ["init", str(whole), "-o", str(config)])
    assert said.exit_code == 0, said.output
    text = config.read_text()
    assert text.count(": FILL_IN") == 5
    for key, number in NUMBERS[name.split("_")[0]].items():
        text = text.replace(f" {key}: FILL_IN", f" {key}: {number}")
    config.write_text(text)
    bag, log = beginning(whole, tmp_path / "bag", 15.0), tmp_path / "node.log"
    with NodeProcess([config], log, {"use_sim_time": "true"}) as node:
        recording = drive_through(bag, rate=8.0, alive=node.death)
    assert len(recording.mobility) > 100, log.read_text()
    assert any(row["slip_valid"] for row in recording.mobility)
    text = log.read_text()
    assert "inputs are here" in text
    assert "still waiting for" not in text.partition("inputs are here")[2]
