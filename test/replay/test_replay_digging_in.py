# SPDX-License-Identifier: Apache-2.0
"""A drive whose end is a wheel that digs itself in: what the replay says of it, everywhere."""

from __future__ import annotations

import json
from pathlib import Path

import pandas as pd
import pytest
from click.testing import CliRunner

from smallwheel_ros.bags import BagReader, BagWriter
from smallwheel_ros.cli import main
from smallwheel_ros.pipeline.warning.warning_level import WarningLevel
from smallwheel_ros.simulate import DriveSettings, simulate_drive, write_drive_bag

SECOND = 10**9
LENGTH = 5.0  # s of the end in which the wheel digs itself in
DEPTH = 0.025  # m that it goes down meanwhile


def bent(drive: Path, target: Path, wheel: str, *, speed: bool, sinkage: bool) -> float:
    """Copy a drive whose last seconds are a wheel that digs itself in; return when that begins.

    The wheels turn as before. speed: over ground it falls to a tenth. sinkage: the wheel goes down.
    """
    with BagReader(drive) as reader, BagWriter(target) as writer:
        assert reader.start_time is not None
        assert reader.end_time is not None
        begin = reader.end_time - round(LENGTH * SECOND)
        for topic, kind, log_time, message in reader.messages():
            share = max(0.0, (log_time - begin) / SECOND / LENGTH)
            if topic == "/odom" and speed:
                message.twist.twist.linear.x *= 1.0 - 0.9 * share
                message.twist.twist.angular.z *= 1.0 - 0.9 * share
            elif topic == f"/{wheel}/sinkage" and sinkage:
                message.sinkage += DEPTH * share
            writer.write(topic, kind, log_time, message)
        return (begin - reader.start_time) / SECOND


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Half a minute on one soil, by the truth simulator; the vehicle still drives at its end."""
    whole = tmp_path_factory.mktemp("drive") / "whole"
    settings = DriveSettings(seed=4, distance=12.0, wheels="two_sizes", terrain="single")
    write_drive_bag(simulate_drive(settings), whole)
    driving = whole.with_name("driving")
    with BagReader(whole) as reader, BagWriter(driving) as writer:
        assert reader.end_time is not None
        for raw in reader.raw_messages():
            if raw.log_time < reader.end_time - 4 * SECOND:
                writer.write_raw(*raw)
    return driving


def replay(bag: Path, repository: Path, folder: Path) -> tuple[dict, pd.DataFrame, str]:
    config = repository / "config" / "two_wheel_sizes.yaml"
    arguments = ["replay", str(bag), "--config", str(config), "-o", str(folder), "--copy", "none"]
    done = CliRunner().invoke(main, arguments)
    assert done.exit_code == 0, (done.output, done.exception)
    summary = json.loads((folder / "replay.json").read_text())
    return summary, pd.read_csv(folder / "estimates.csv"), done.output


def test_a_wheel_that_digs_itself_in_is_told_of(
    drive: Path, repository: Path, tmp_path: Path
) -> None:
    begin = bent(drive, tmp_path / "bag", "rear_left", speed=True, sinkage=True)
    summary, table, said = replay(tmp_path / "bag", repository, tmp_path / "out")

    (event,) = [event for event in summary["events"] if event["kind"] == "gets_stuck"]
    assert "dig in" in event["text"]
    # Slip passes a half after half of the time; what is asked for beside it may come before.
    assert begin + 0.3 * LENGTH < event["time"] < begin + LENGTH
    assert event["text"] in said

    # Warned before, at the first level, however many messages are replayed at a time.
    (first,) = [event for event in summary["events"] if event["kind"] == "may_get_stuck"]
    assert begin < first["time"] < event["time"]
    assert "may get stuck" in first["text"]

    digging = table[table["status_text"].str.contains("gets stuck: it slips", na=False)]
    assert set(digging["wheel"]) == set(table["wheel"])  # all that roll: the vehicle gets stuck
    assert digging["time"].min() == pytest.approx(event["time"], abs=0.2)
    assert digging["slip"].median() > 0.4
    vehicle = pd.read_csv(tmp_path / "out" / "vehicle.csv")
    warned = vehicle[vehicle["level"] >= 3]
    assert warned["time"].min() == pytest.approx(event["time"], abs=0.2)
    assert not {"digging_in", "risk_of_getting_stuck"} & {*table}  # they are the vehicle's
    assert warned["risk_of_getting_stuck"].max() <= 1.0

    with BagReader(tmp_path / "out" / "bag") as reader:
        messages = [m.message for m in reader.messages({"/mobility_estimator/vehicle"})]
    stuck = [m for m in messages if m.level >= 3]
    assert stuck
    assert all("dig in" in m.text or m.level == 4 for m in stuck)
    assert {m.level for m in messages} >= {1, 2, 3}
    page = (tmp_path / "out" / "report.html").read_text()
    assert "once that it gets stuck" in page
    # The same words for one level, wherever it is read.
    assert event["kind"] == WarningLevel(3).name.lower()
    assert first["kind"] == WarningLevel(2).name.lower()
    for one in (first, event):
        assert one["text"] in page
        assert one["text"] in set(vehicle["text"])
        assert one["text"] in {message.text for message in messages}


def test_sinkage_of_one_wheel_alone_is_no_digging_in(
    drive: Path, repository: Path, tmp_path: Path
) -> None:
    bent(drive, tmp_path / "bag", "rear_left", speed=False, sinkage=True)
    summary, table, said = replay(tmp_path / "bag", repository, tmp_path / "out")
    assert not table["status_text"].str.contains("gets stuck: it slips", na=False).any()
    assert pd.read_csv(tmp_path / "out" / "vehicle.csv")["level"].max() < 3
    assert "gets_stuck" not in {event["kind"] for event in summary["events"]}
    assert "gets stuck" not in said
    assert "dig in" not in (tmp_path / "out" / "report.html").read_text()
