# SPDX-License-Identifier: Apache-2.0
"""A bag of a vehicle that measures neither sinkage nor load: what the replay knows of it, and what not."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner

import smallwheel_ros as sw
from smallwheel_ros.bags import BagReader, BagWriter
from smallwheel_ros.cli import main
from smallwheel_ros.simulate import DriveSettings, simulate_drive, write_drive_bag

RADIUS = 0.125  # m, of the wheels of config/without_soil_sensors.yaml


@pytest.fixture(scope="module")
def bags(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """A drive without loads and sinkages, once as it is, once with odometry that is made of the wheels."""
    folder = tmp_path_factory.mktemp("plain")
    write_drive_bag(simulate_drive(DriveSettings(seed=3, distance=10.0)), folder / "whole")
    found = {}
    for name in ("own", "wheels"):
        found[name] = folder / name
        rims = 0.0
        with BagReader(folder / "whole") as reader, BagWriter(found[name]) as writer:
            for topic, kind, log_time, message in reader.messages():
                if topic.endswith(("/load", "/sinkage")):
                    continue
                if topic == "/joint_states":
                    rims = RADIUS * float(np.mean(message.velocity))
                elif topic == "/odom" and name == "wheels":
                    message.twist.twist.linear.x = rims
                writer.write(topic, kind, log_time, message)
    return found


@pytest.fixture(scope="module")
def own(
    bags: dict[str, Path], repository: Path, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Path, str]:
    """A replay of the drive as it is: its folder, and what was printed."""
    folder = tmp_path_factory.mktemp("own") / "out"
    config = repository / "config" / "without_soil_sensors.yaml"
    arguments = ["replay", str(bags["own"]), "--config", str(config), "-o", str(folder)]
    done = CliRunner().invoke(main, [*arguments, "--copy", "none"])
    assert done.exit_code == 0, (done.output, done.exception)
    return folder, done.stdout


def test_slip_grip_and_risk_are_known_and_sinkage_is_not(own: tuple[Path, str]) -> None:
    folder, _ = own
    summary = json.loads((folder / "replay.json").read_text())
    table = pd.read_csv(folder / "estimates.csv")
    rolls = table[table["slip"].notna()]
    assert len(rolls) > 0.5 * len(table) > 100
    assert (rolls["slip_standard_deviation"] > 0.0).all()
    for name in ("thrust", "drawbar_pull", "mobility_margin", "load"):
        assert rolls[name].notna().all(), name
    risk = pd.read_csv(folder / "vehicle.csv")["risk_of_getting_stuck"].dropna()
    assert len(risk) > 20
    assert risk.between(0.0, 1.0).all()
    assert summary["mobility"]["risk"]["highest"] == pytest.approx(risk.max())
    assert table["travel"].iloc[-1] == pytest.approx(10.0, abs=0.5)
    for name in ("sinkage_predicted", "compaction_resistance", "rolling_resistance_coefficient"):
        assert table[name].isna().all(), name
    assert table["status_text"].str.contains("sinkage and resistance unknown").all()
    with BagReader(folder / "bag") as reader:
        messages = [
            m.message
            for m in reader.messages(
                {t.name for t in reader.topics if t.name.endswith("/mobility")}
            )
        ]
    for message in messages:
        assert not message.prediction_valid
        assert message.sinkage_predicted == message.compaction_resistance == 0.0
        assert message.sinkage_predicted_standard_deviation == 0.0
        numbers = [v for v in vars(message).values() if isinstance(v, float)]
        assert np.isfinite(numbers).all()
    assert all(message.margin_valid for message in messages)
    assert sum(message.traction_valid for message in messages) == len(rolls)


def test_the_user_may_say_which_soil_it_is(
    bags: dict[str, Path], repository: Path, tmp_path: Path
) -> None:
    text = (repository / "config" / "without_soil_sensors.yaml").read_text()
    named = tmp_path / "named.yaml"
    named.write_text(
        text.replace("  ros__parameters:\n", "  ros__parameters:\n    soil.name: dry_sand\n")
    )
    sw.replay(bags["own"], named, tmp_path / "out", copy="none")
    table = pd.read_csv(tmp_path / "out" / "estimates.csv")
    assert table["sinkage_predicted"].notna().all()
    assert table["status_text"].str.contains("dry_sand as configured").all()


def test_odometry_that_is_made_of_the_wheels_is_said(
    bags: dict[str, Path], repository: Path, tmp_path: Path
) -> None:
    config = repository / "config" / "without_soil_sensors.yaml"
    summary = sw.replay(bags["wheels"], config, tmp_path / "out", copy="none").to_dict()
    table = pd.read_csv(tmp_path / "out" / "estimates.csv")
    said = [event["text"] for event in summary["events"]]
    assert any("computed from them and shows no slip" in words for words in said), said
    last = table.iloc[-1]
    assert np.isnan(last["slip"])
    vehicle = pd.read_csv(tmp_path / "out" / "vehicle.csv").iloc[-1]
    assert np.isnan(vehicle["slip"])
    assert np.isnan(vehicle["risk_of_getting_stuck"])
    assert np.isnan(last["thrust"])
    assert "odometry shows none" in last["status_text"]


def test_encoders_and_an_imu_alone_give_the_twist_and_end_with_0(
    bags: dict[str, Path], repository: Path, tmp_path: Path
) -> None:
    with BagReader(bags["own"]) as reader, BagWriter(tmp_path / "drive") as writer:
        for topic, kind, time, message in reader.messages():
            if topic != "/odom":
                writer.write(topic, kind, time, message)
    text = (repository / "config" / "without_soil_sensors.yaml").read_text()
    config = tmp_path / "rover.yaml"
    config.write_text(
        text.replace("  ros__parameters:\n", "  ros__parameters:\n    twist.publish: true\n")
    )
    sw.replay(tmp_path / "drive", config, tmp_path / "out", copy="none")
    twists = pd.read_csv(tmp_path / "out" / "twists.csv")
    assert len(twists) > 100


def test_what_is_a_priors_says_so_in_message_text_and_page(own: tuple[Path, str]) -> None:
    """Margin, soil and strength of a drive that has told little of each."""
    folder, printed = own
    strength = "by the strength of any sand, not measured"
    assert f"Thrust, pull and energy: {strength}." in printed
    assert f"Thrust, pull and energy: {strength}." in (folder / "report.html").read_text()
    assert "the soil's law is unknown" in printed
    table = pd.read_csv(folder / "estimates.csv")
    pulls = table[table["drawbar_pull"].notna()]
    assert pulls["status_text"].str.contains(strength).all()
    assert table["status_text"].str.contains("the soil is not named").all()
    first = table[table["mobility_margin"].notna()].iloc[0]
    assert (
        "margin rests on a prior: this drive has shown little of its own yet"
        in first["status_text"]
    )
    summary = json.loads((folder / "replay.json").read_text())
    assert summary["strength"]["of_prior"] == "any sand"
    said = "any ground's: this drive has shown little of its own"
    assert (said in printed) == summary["mobility"]["margin"]["of_prior"]
