# SPDX-License-Identifier: Apache-2.0
"""The table of laws: what is held against what, that ours may lose, and what is said of it.

Tests `data_sets.py` and `law_table.py`.
"""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner, Result
from lab_truth import plate_rows, write
from scipy.stats import ttest_rel

from smallwheel_ros.api.compare import compare
from smallwheel_ros.cli import main
from smallwheel_ros.compare.fitted_laws import CONSTANT, INTEGRAL, OURS, SIZE_LAWS, WONG_REECE
from smallwheel_ros.compare.law_table import Difference, Errors, difference
from smallwheel_ros.measurements.from_file import read_measurements
from smallwheel_ros.views.law_table import table_text

SIZES = (0.04, 0.07, 0.12, 0.2)


def run(*arguments: str | Path) -> Result:
    return CliRunner().invoke(main, ["compare", *map(str, arguments)])


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Result, dict[str, Any]]:
    """Two licensed sets, one whose sizes follow Reece's law, and two that cannot be used."""
    folder = tmp_path_factory.mktemp("sets")
    for name, law in (("ours", "meirion_griffith_spenko"), ("theirs", "reece")):
        (folder / name).mkdir()
        rng = np.random.default_rng(3)
        rows = plate_rows(rng, law, SIZES, runs=1, rows=10, stray=0.01)
        write(folder / name / "plates.csv", rows)
        (folder / name / "LICENSE").write_text("\nCC BY 4.0, somebody\n")
    (folder / "ours" / "notes.csv").write_text("name,remark\nplate,dry\n")
    (folder / "unlicensed").mkdir()
    write(folder / "unlicensed" / "plates.csv", rows)
    outputs = [part for name in ("json", "html") for part in (f"--{name}", folder / f"out.{name}")]
    result = run(folder, "-o", folder / "out.csv", *outputs)
    return folder, result, json.loads((folder / "out.json").read_text())


def test_each_size_is_left_out_under_each_law(
    found: tuple[Path, Result, dict[str, Any]],
) -> None:
    folder, result, document = found
    assert result.exit_code == 0, result.output
    names = [CONSTANT, *(law.name for law in SIZE_LAWS), INTEGRAL, OURS]
    # With one run of each size, to leave out a run is to leave out a size.
    assert [task["left_out"] for task in document["tasks"]] == ["size", "size"]
    for task in document["tasks"]:
        assert task["licence"] == "CC BY 4.0, somebody"
        assert [law["law"] for law in task["laws"]] == names
        for law in task["laws"]:
            assert all(error > 0 for error in law["by_part"].values())
            assert law["law"] in result.output
            assert law["refused"] == 0
        assert list(law["by_part"]) == ["40 mm", "70 mm", "120 mm", "200 mm"]
    with (folder / "out.csv").open() as file:
        assert len(list(csv.DictReader(file))) == 2 * len(names) * 4


def test_the_law_of_the_soil_wins(found: tuple[Path, Result, dict[str, Any]]) -> None:
    folder, _, document = found
    ours, theirs = ({law["law"]: law for law in task["laws"]} for task in document["tasks"])
    assert ours["Bernstein-Goriatchkin"]["sinkage_rmse"] > 2 * ours[OURS]["sinkage_rmse"]
    assert ours[CONSTANT]["ours"] == "wins"
    assert ours[INTEGRAL]["ours"] == "cannot tell"  # nothing was named: they are one law
    best = min(theirs, key=lambda law: theirs[law]["sinkage_rmse"])
    assert best in ("Reece", "Bekker")
    assert best in document["tasks"][1]["lost"].values()
    judged = [law for task in document["tasks"] for law in task["laws"]]
    counted = [law["ours"] for law in judged if law["law"] not in (INTEGRAL, OURS)]
    for word, key in (("wins", "wins"), ("loses", "losses"), ("cannot tell", "cannot_tell")):
        assert document[key] == counted.count(word)
    assert "Where ours loses" in (folder / "out.html").read_text()


def test_each_table_is_told_when_it_is_done(tmp_path: Path) -> None:
    rows = plate_rows(np.random.default_rng(3), sizes=(0.04, 0.16), runs=2, rows=6)
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        write(tmp_path / name / "plates.csv", rows)
        (tmp_path / name / "LICENSE").write_text("CC0\n")
    heard: list[str] = []
    whole = compare(tmp_path, progress=heard.append, done=lambda table: heard.append("done"))
    first, second = (i for i, text in enumerate(heard) if text == "done")
    assert all(text.startswith("a/plates.csv, plate: without run") for text in heard[:first])
    assert all(text.startswith("b/plates.csv") for text in heard[first + 1 : second])
    tables = "\n\n".join(table_text(table) for table in whole.tasks)
    assert whole.text().startswith(tables + "\n\n")
    assert run(tmp_path).stdout.startswith(tables + "\n\n")


def test_what_is_not_used_is_said(found: tuple[Path, Result, dict[str, Any]]) -> None:
    _, result, document = found
    assert set(document["not_used"]) == {"unlicensed/plates.csv", "ours/notes.csv"}
    assert "no licence next to it" in document["not_used"]["unlicensed/plates.csv"]
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
    assert ("no such file" if make == "nothing" else "expected") in result.output
    assert "Traceback" not in result.output


def test_pull_and_torque_are_judged_beside_sinkage(shared_data: Path, tmp_path: Path) -> None:
    """Two published wheels at three slips: a slip, a wheel and a run left out, three channels each."""
    (tmp_path / "sets").mkdir()
    (tmp_path / "sets" / "LICENSE").write_text("MIT\n")
    header, *rows = (shared_data / "published_wheels" / "kls1.csv").read_text().splitlines()
    kept = [row for row in rows if "_s20" not in row and "_s40" not in row]
    (tmp_path / "sets" / "kls1.csv").write_text("\n".join([header, *kept]))
    result = run(tmp_path, "--json", tmp_path / "out.json")
    assert result.exit_code == 0, result.output
    tasks = json.loads((tmp_path / "out.json").read_text())["tasks"]
    assert [task["left_out"] for task in tasks] == ["slip", "wheel", "run"]
    table = read_measurements(tmp_path / "sets" / "kls1.csv")
    for channel in ("sinkage", "drawbar_pull", "torque"):
        error = {law["law"]: law for law in tasks[0]["laws"] if law["channel"] == channel}
        assert list(error)[-3:] == [WONG_REECE, INTEGRAL, OURS]
        assert all(known > 0 for law in error.values() for known in law["by_part"].values())
        value, slip = table.channels[channel], table.conditions["slip"]
        others = np.array([value[slip != level].mean() for level in slip])
        expected = np.sqrt(np.mean((value - others) ** 2))
        assert error[CONSTANT][f"{channel}_rmse"] == pytest.approx(expected)
        assert set(tasks[0]["lost_forces"]) == {"drawbar_pull", "torque"}
    # Of two wheels nothing can be told, however large the difference is.
    assert {law["ours"] for law in tasks[1]["laws"]} == {"cannot tell", None}
    assert "torque, 6 points; each of 3 slips left out" in result.output


def test_a_difference_is_judged_as_scipy_judges_it() -> None:
    rng = np.random.default_rng(0)
    words = []
    for parts in rng.integers(3, 12, 200).tolist():
        law, ours = rng.normal(0.4, 1.0, parts), rng.normal(0.0, 1.0, parts)
        errors = Errors("", "sinkage", 1.0, {}, 0, {}, {}, difference(law.tolist(), ours.tolist()))
        words.append(errors.verdict)
        clear = ttest_rel(law, ours).pvalue < 0.05
        better = "wins" if law.mean() > ours.mean() else "loses"
        assert errors.verdict == (better if clear else "cannot tell")
    assert set(words) == {"wins", "loses", "cannot tell"}


@pytest.mark.parametrize(
    ("parts", "verdict"), [(1, "cannot tell"), (2, "cannot tell"), (3, "wins")]
)
def test_of_two_parts_nothing_is_told(parts: int, verdict: str) -> None:
    law = [2.0, 2.001, 1.999][:parts]
    found = difference(law, [1.0] * parts)
    assert isinstance(found, Difference)
    assert Errors("", "sinkage", 1.0, {}, 0, {}, {}, found).verdict == verdict


def test_what_goes_with_a_table_alone_is_refused_of_a_folder(tmp_path: Path) -> None:
    for words in (["--model", "dry_sand"], ["--map", "load=F3"]):
        result = run(tmp_path, *words)
        assert result.exit_code == 2, result.output
        assert "found a folder" in result.output
    file = tmp_path / "plates.csv"
    write(file, plate_rows(np.random.default_rng(0), rows=4))
    (tmp_path / "law.py").write_text("")
    result = run(file, "--law", tmp_path / "law.py")
    assert result.exit_code == 2
    assert "no folder of data sets" in result.output
