# SPDX-License-Identifier: Apache-2.0
"""The measured benchmark: which laws are held against what, and that ours may lose."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner, Result
from lab_truth import plate_rows, write

from smallwheel_ros.benchmark.benchmark import benchmark
from smallwheel_ros.benchmark.laws import CONSTANT, FOUND, INTEGRAL, SIZE_LAWS, WONG_REECE
from smallwheel_ros.benchmark.parts import tasks_of
from smallwheel_ros.cli import main
from smallwheel_ros.measurements.wheels import read_measurements

OURS = ("Meirion-Griffith & Spenko", INTEGRAL, FOUND)


def run(*arguments: str | Path) -> Result:
    return CliRunner().invoke(main, ["benchmark", *map(str, arguments)])


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Result, dict[str, Any]]:
    """Two licensed sets, one whose sizes follow Reece's law, and two that cannot be used."""
    folder = tmp_path_factory.mktemp("sets")
    for name, law in (("ours", "meirion_griffith_spenko"), ("theirs", "reece")):
        (folder / name).mkdir()
        rows = plate_rows(np.random.default_rng(3), law, rows=12, stray=0.01)
        write(folder / name / "plates.csv", rows)
        (folder / name / "LICENSE").write_text("\nCC BY 4.0, somebody\n")
    (folder / "ours" / "notes.csv").write_text("name,remark\nplate,dry\n")
    (folder / "unlicensed").mkdir()
    write(folder / "unlicensed" / "plates.csv", rows)
    result = run(folder, "--json", folder / "out.json", "-o", folder / "out.csv")
    return folder, result, json.loads((folder / "out.json").read_text())


def test_each_size_is_left_out_under_each_law(
    found: tuple[Path, Result, dict[str, Any]],
) -> None:
    folder, result, document = found
    assert result.exit_code == 0, result.output
    names = [law.name for law in SIZE_LAWS] + [CONSTANT, INTEGRAL, FOUND]
    for task in document["tasks"]:
        assert task["left_out"] == "size"
        assert task["licence"] == "CC BY 4.0, somebody"
        assert [law["law"] for law in task["laws"]] == names
        for law in task["laws"]:
            assert list(law["by_part"]) == ["40 mm", "80 mm", "160 mm"]
            assert all(error > 0 for error in law["by_part"].values())
            assert law["law"] in result.output
    with (folder / "out.csv").open() as file:
        assert len(list(csv.DictReader(file))) == 2 * len(names) * 3


def test_the_law_of_the_soil_wins_and_a_loss_is_said(
    found: tuple[Path, Result, dict[str, Any]],
) -> None:
    _, result, document = found
    ours, theirs = (
        {law["law"]: law["sinkage_rmse"] for law in task["laws"]} for task in document["tasks"]
    )
    assert min(ours, key=lambda law: ours[law]) in OURS
    assert ours["Bernstein-Goriatchkin"] > 2 * ours["Meirion-Griffith & Spenko"]
    assert min(theirs, key=lambda law: theirs[law]) == "Reece"
    assert "Reece" in document["tasks"][1]["lost"].values()
    assert "Ours loses on" in result.output


def test_each_table_is_told_when_it_is_done(found: tuple[Path, Result, dict[str, Any]]) -> None:
    folder, result, _ = found
    heard: list[str] = []
    whole = benchmark(folder, lambda step: heard.append(step), lambda errors: heard.append("done"))
    first, second = (i for i, text in enumerate(heard) if text == "done")
    assert all(text.startswith("ours/") for text in heard[:first])
    assert all(text.startswith("theirs/") for text in heard[first + 1 : second])
    tables = "\n\n".join(errors.text() for errors in whole.tasks)
    assert result.stdout.startswith(tables + "\n\n")
    assert whole.text().startswith(tables + "\n\n")


def test_what_is_not_used_is_said(found: tuple[Path, Result, dict[str, Any]]) -> None:
    _, result, document = found
    assert set(document["not_used"]) == {"unlicensed/plates.csv", "ours/notes.csv"}
    assert "no licence beside it" in document["not_used"]["unlicensed/plates.csv"]
    assert "Not used: unlicensed/plates.csv" in result.output


@pytest.mark.parametrize("make", ["nothing", "empty", "unlicensed"])
def test_without_a_usable_set_it_is_one_message(tmp_path: Path, make: str) -> None:
    folder = tmp_path / "sets"
    if make != "nothing":
        folder.mkdir()
    if make == "unlicensed":
        write(folder / "plates.csv", plate_rows(np.random.default_rng(0), rows=4))
    result = run(folder)
    assert result.exit_code == 2
    assert "expected" in result.output
    assert "Traceback" not in result.output


def test_pull_and_torque_are_judged_beside_sinkage(shared_data: Path, tmp_path: Path) -> None:
    """A published wheel, each slip left out: a constant and Wong and Reece stand beside our laws."""
    (tmp_path / "sets").mkdir()
    for name in ("kls1.csv", "LICENSE"):
        (tmp_path / "sets" / name).write_bytes(
            (shared_data / "published_wheels" / name).read_bytes()
        )
    result = run(tmp_path, "--json", tmp_path / "out.json")
    assert result.exit_code == 0, result.output
    (task,) = json.loads((tmp_path / "out.json").read_text())["tasks"]
    table = read_measurements(tmp_path / "sets" / "kls1.csv")
    for channel in ("sinkage", "drawbar_pull", "torque"):
        error = {law["law"]: law for law in task["laws"] if law["channel"] == channel}
        assert list(error)[-4:] == [CONSTANT, WONG_REECE, INTEGRAL, FOUND]
        assert all(known > 0 for law in error.values() for known in law["by_part"].values())
        value, slip = table.channels[channel], table.conditions["slip"]
        others = np.array([value[slip != level].mean() for level in slip])
        expected = np.sqrt(np.mean((value - others) ** 2))
        assert error[CONSTANT][f"{channel}_rmse"] == pytest.approx(expected)
        best = min(error, key=lambda law: error[law][f"{channel}_rmse"])
        assert set(task["lost_forces"]) == {"drawbar_pull", "torque"}
        assert f"Least error: {best}" in result.output
    assert "torque [N m, rms] of each slip left out" in result.output


def test_of_a_rolling_wheel_levels_of_slip_are_left_out(shared_data: Path) -> None:
    table = read_measurements(shared_data / "cmu_wheel_rig" / "rolling_smooth_wheel.csv")
    (task,) = tasks_of(table)
    assert task.what == "slip"
    assert len(task.names) == 9
    slip = table.conditions["slip"]
    for part in range(9):
        assert np.ptp(slip[task.part == part]) < 0.02
