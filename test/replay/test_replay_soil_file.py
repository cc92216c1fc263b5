# SPDX-License-Identifier: Apache-2.0
"""A replay goes on from a saved soil and saves it, and says when it knows nothing."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner, Result

import smallwheel_ros as sw
from smallwheel_ros.bags import BagReader, BagWriter
from smallwheel_ros.cli import main
from smallwheel_ros.common.stamps import SECOND
from smallwheel_ros.drive.messages import VEHICLE_VALID
from smallwheel_ros.replay.report import _in_short
from smallwheel_ros.replay.tables import EstimatesTable, VehicleTable
from smallwheel_ros.simulate import DriveSettings, simulate_drive, write_drive_bag


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("drive") / "drive"
    write_drive_bag(simulate_drive(DriveSettings(seed=3, distance=4.0)), path)
    return path


@pytest.fixture(scope="module")
def config(repository: Path) -> Path:
    return repository / "config" / "four_wheels.yaml"


def run(*arguments: object, code: int = 0) -> Result:
    result = CliRunner().invoke(main, ["replay", *map(str, arguments)])
    assert result.exit_code == code, (result.output, result.exception)
    return result


def test_a_soil_is_gone_on_from_and_saved(drive: Path, config: Path, tmp_path: Path) -> None:
    soil = tmp_path / "yesterday.soil"
    options = ("--config", config, "--soil-file", soil, "--copy", "none")
    first = run(drive, *options, "-o", tmp_path / "a").stdout
    assert f"Soil saved: {soil}" in first or f"soil saved: {soil}" in first
    saved = soil.read_bytes()
    second = sw.replay(drive, config, tmp_path / "b", copy="none", soil_file=soil)
    assert any(f"soil restored from {soil}" in note for note in second.notes)
    column = "sinkage_predicted_standard_deviation"
    one, two = (pd.read_csv(tmp_path / name / "estimates.csv")[column].dropna() for name in "ab")
    assert two.head(200).mean() < 0.7 * one.head(200).mean()  # it knew more at its beginning
    assert soil.read_bytes() != saved


def test_a_file_that_is_no_soil_is_left_alone(drive: Path, config: Path, tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    options = ("--config", config, "--soil-file", tmp_path / "notes.txt")
    said = run(drive, *options, "-o", tmp_path / "out", code=2).stderr
    assert "notes.txt" in said
    assert (tmp_path / "notes.txt").read_text() == "mine"
    assert not (tmp_path / "out" / "replay.json").exists()


def test_one_soil_file_is_for_one_bag(drive: Path, config: Path, tmp_path: Path) -> None:
    options = ("--config", config, "--soil-file", tmp_path / "s", "-o", tmp_path / "out")
    assert "for one bag" in run(drive, drive, *options, code=2).stderr


def without_soil_sensors(
    drive: Path, config: Path, folder: Path, *left_out: str
) -> tuple[Path, Path]:
    """The drive without loads, sinkages and some topics, and parameters for it."""
    with BagReader(drive) as reader, BagWriter(folder / "plain") as writer:
        for name, kind, time, message in reader.messages():
            if not name.endswith(("/load", "/sinkage")) and name not in left_out:
                writer.write(name, kind, time, message)
    lines = ["/**:", "  ros__parameters:", "    wheels: [front_left, front_right, rear_left, rear_right]",
             "    load: {source: static}",
             "    vehicle: {mass: 24.0}"]  # fmt: skip
    for name in ("front_left", "front_right", "rear_left", "rear_right"):
        lines.append(f"    {name}: {{diameter: 0.25, width: 0.1, sinkage_topic: ''}}")
    (folder / "plain.yaml").write_text("\n".join(lines))
    return folder / "plain", folder / "plain.yaml"


def test_slip_and_margin_are_said_and_of_the_law_one_line(
    drive: Path, config: Path, tmp_path: Path
) -> None:
    bag, plain = without_soil_sensors(drive, config, tmp_path)
    said = run(bag, "--config", plain, "--copy", "none", "-o", tmp_path / "out").stdout
    assert "Slip: known in" in said
    assert "any ground" in said  # with what the drive has told of it
    assert "k, n and m are as they were before the drive" in said
    assert "Pressure at" not in said
    assert "Under the law" not in said
    found = json.loads((tmp_path / "out" / "replay.json").read_text())
    assert found["strength"]["measured_by"] == ["balance"]
    assert (
        0.0 < found["mobility"]["slip"]["median"] < found["mobility"]["slip"]["quantile_95"] <= 1.0
    )


@pytest.mark.parametrize("known", [0, 1, 4, 5, 100])
def test_of_what_few_estimates_know_no_value_is_the_drives(
    drive: Path, config: Path, tmp_path: Path, known: int
) -> None:
    """As of an odometry that is refused after .7 s, because it looks back."""
    table = EstimatesTable(tmp_path / "estimates", 0, ["front"])
    values = np.where(np.arange(100) < known, 0.25, np.nan)
    names = ("slip", "mobility_margin", "mobility_margin_standard_deviation")
    table.mobility.append(pd.DataFrame(dict.fromkeys(names, values)))
    figures = table.told()
    value = 0.25 if known >= 5 else None
    assert figures == {
        "slip": {"known": known / 100, "median": value, "quantile_95": value},
        "margin": {"known": known / 100, "median": value, "std": value},
    }
    summary = sw.replay(drive, config, tmp_path / "out", copy="none").to_dict()
    summary["mobility"]["slip"] |= figures["slip"]
    summary["mobility"]["margin"] |= figures["margin"]
    text = str(_in_short(summary))
    few = f"known in {known}.0 % of estimates, too few to sum up."
    assert (f"Slip: {few}" in text) == (f"Margin: {few}" in text) == (0 < known < 5)
    assert ("half under" in text) == (known >= 5)
    assert ("Slip: not known." in text) == (known == 0)


def test_the_highest_risk_counts_however_few_rows_know_the_risk() -> None:
    table = VehicleTable(0)
    assert table.risk() == {"known": 0.0, "median": None, "highest": None}
    known = np.arange(100) == 7
    table.add(
        np.arange(100) * SECOND // 10,
        dict.fromkeys(VEHICLE_VALID, known) | {"risk_of_getting_stuck": np.full(100, 0.9)},
    )
    assert table.risk() == {"known": 0.01, "median": None, "highest": 0.9}


def test_nothing_estimated_is_exit_code_2(drive: Path, config: Path, tmp_path: Path) -> None:
    bag, plain = without_soil_sensors(drive, config, tmp_path, "/joint_states", "/odom")
    said = run(bag, "--config", plain, "-o", tmp_path / "out", code=2)
    assert (
        "nothing could be estimated: no row has slip, margin or a measured sinkage" in said.stderr
    )
    assert "/odom (nav_msgs/msg/Odometry): not in the bag" in said.stderr
