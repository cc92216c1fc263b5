# SPDX-License-Identifier: Apache-2.0
"""From a table that no known effect explains to a node whose alarm falls silent: `learn` in its place."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
from click.testing import CliRunner

from smallwheel_ros.cli import main
from smallwheel_ros.model.model_file import read_model
from smallwheel_ros.ros import NodeProcess
from smallwheel_ros.simulate import (
    DriveSettings,
    RigSettings,
    simulate_drive,
    simulate_rig,
    write_drive_bag,
)

# Wheels that dig in as they slip, by the truth's own physics: stress under the rim that slip weakens.
HIDDEN = ("slip_sinkage=5.5",)
DENIED = "slip_sinkage"


def run(*arguments: str | Path) -> str:
    result = CliRunner().invoke(main, [str(a) for a in arguments])
    assert result.exit_code == 0, result.output
    return result.output


def document(path: Path) -> dict[str, Any]:
    return dict(json.loads(path.read_text()))


def from_diagnosis_to_model(
    folder: Path, data: Path, denied: str, *start: str | Path
) -> tuple[dict[str, Any], Path, Path]:
    """Follow what the commands say: what was learnt, its file, and a model file with the law.

    start: `--model` with the model to start from, if any.
    """
    found, law, better = folder / "found.json", folder / "law.py", folder / "better.yaml"
    printed = run("diagnose", data, *start, "--without", denied, "--json", found)
    assert document(found)["verdict"] == "unknown_effect"
    (command,) = re.findall(r"`smallwheel (learn [^`]*)`", " ".join(printed.split()))
    asked = [str(law) if word == "law.py" else word for word in shlex.split(command)]
    run(*asked, "--json", found)
    learnt = document(found)
    assert (learnt["verdict"], learnt["file"]) == ("law", str(law))
    name = learnt["law"]["id"]

    own = ("--effects", law)
    run("diagnose", data, *start, "--without", denied, *own, "--json", found)
    after = document(found)
    assert after["missing_effects"] == [name]
    row = next(r for r in after["ranking"] if r["effect"] == name)
    assert row["p_value"] is None  # this table cannot speak for what was learnt from it

    if not start:
        run("fit", data, "-o", folder / "base.yaml")
        start = ("--model", folder / "base.yaml")
    run("add", name, *start, "--data", data, *own, "-o", better)
    return learnt, law, better


def sinkages(folder: Path, *arguments: str | Path) -> list[float]:
    """What `predict` says of each row."""
    run("predict", *arguments, "--json", folder / "predicted.json")
    return [row["sinkage"] for row in document(folder / "predicted.json")["rows"]]


@pytest.mark.slow
@pytest.mark.dds
def test_the_alarm_falls_silent_with_the_law(repository: Path, tmp_path: Path) -> None:
    from smallwheel_ros.ros.play import drive_through

    data, base, bag = tmp_path / "rig.csv", tmp_path / "base.yaml", tmp_path / "drive"
    rig = simulate_rig(RigSettings(seed=1, hidden=HIDDEN, runs=24)).table
    rig.to_csv(data, index=False)
    learnt, law, better = from_diagnosis_to_model(tmp_path, data, DENIED)
    assert learnt["law"]["drivers"] == ["slip"]

    wheel = ("--load", "60", "--diameter", "0.2", "--width", "0.1", "--slip", "0.05,0.5")
    little, much = sinkages(tmp_path, *wheel, "--model", base)
    assert much == little
    little, much = sinkages(tmp_path, *wheel, "--model", better, "--effects", law)
    assert 1.3 < much / little < 3.0  # the truth's wheels sink 2 to 3 times as deep at 0.6

    drive = DriveSettings(seed=3, distance=12.0, terrain="single", hidden=HIDDEN)
    write_drive_bag(simulate_drive(drive), bag)
    rover = repository / "config" / "four_wheels.yaml"
    soil = read_model(base).model.soils[0].name
    said = {}
    for model, effects in ((base, {}), (better, {"effects_file": str(law)})):
        own = {"model_file": str(model), "soil.name": soil, "use_sim_time": "true"} | effects
        with NodeProcess([rover], tmp_path / "node.log", own) as node:
            heard = drive_through(bag, rate=20.0, alive=node.death)
            assert node.death() is None
        assert heard.unanswered == 0
        said[model] = {text for _, text in heard.warnings if "the model misses" in text}
    assert said[base]
    assert all("follows slip: slip_sinkage fits" in text for text in said[base])
    assert said[better] == set()


@pytest.mark.slow
def test_the_real_wheel_with_slip_and_skid_withheld(shared_data: Path, tmp_path: Path) -> None:
    """Soil from the wheel pressed straight down, then rolling at slip angle 0."""
    folder = shared_data / "cmu_wheel_rig"
    pressed = pd.read_csv(folder / "indentation.csv")
    pressed[pressed["contact"] == "pressed"].to_csv(tmp_path / "pressed.csv", index=False)
    rolling = pd.read_csv(folder / "rolling_smooth_wheel.csv")
    data = tmp_path / "rolling.csv"
    rolling[rolling["slip_angle [deg]"].abs() < 0.5].to_csv(data, index=False)
    run("fit", tmp_path / "pressed.csv", "-o", tmp_path / "sand.yaml")
    start = ("--model", tmp_path / "sand.yaml")
    denied = "slip_sinkage,skid_sinkage"
    learnt, law, better = from_diagnosis_to_model(tmp_path, data, denied, *start)
    assert learnt["law"]["drivers"] == ["slip"]
    error = learnt["held_out"]["sinkage"]
    assert error["before"] > 0.012
    assert error["after"] < 0.0025
    wheel = ("--load", "20", "--diameter", "0.116", "--width", "0.05", "--slip=-0.5,0.1,0.7")
    braked, rolled, driven = sinkages(tmp_path, *wheel, "--model", better, "--effects", law)
    assert min(braked, driven) > rolled + error["after"]  # deeper by more than the law is off
