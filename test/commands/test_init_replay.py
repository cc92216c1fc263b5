# SPDX-License-Identifier: Apache-2.0
"""`smallwheel init` and `smallwheel replay`, one behind the other, as a user types them.

Tests `init.py` and `replay.py`.
"""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from smallwheel_ros.cli import main
from smallwheel_ros.simulate import DriveSettings, simulate_drive, write_drive_bag


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("drive")
    write_drive_bag(
        simulate_drive(DriveSettings(seed=5, distance=2.0, wheels="two_sizes")), folder / "bag"
    )
    return folder / "bag"


def run(*arguments: object) -> Result:
    return CliRunner().invoke(main, [str(one) for one in arguments])


def test_a_parameter_file_is_not_written_over(bag: Path, tmp_path: Path) -> None:
    file = tmp_path / "rover.yaml"
    done = run("init", bag, "-o", file)
    assert done.exit_code == 0, done.output
    assert f"written: {file}" in done.output
    written = file.read_text()
    assert "wheels" in written
    refused = run("init", bag, "-o", file)
    assert refused.exit_code == 2
    assert "--force" in refused.stderr
    assert run("init", bag, "-o", file, "--force").exit_code == 0
    assert file.read_text() == written


def test_a_bag_is_listed_and_replayed(bag: Path, tmp_path: Path, repository: Path) -> None:
    listed = run("replay", bag, "--topics", "--json", "-")
    assert listed.exit_code == 0
    assert "/odom" in [topic["name"] for topic in json.loads(listed.stdout)["topics"]]
    config = repository / "config" / "two_wheel_sizes.yaml"
    done = run("replay", bag, "--config", config, "-o", tmp_path / "out", "--copy", "none")
    assert done.exit_code == 0, done.output
    assert (tmp_path / "out" / "estimates.csv").stat().st_size > 1000
    assert run("replay", bag, "--config", config).exit_code == 2  # without -o
