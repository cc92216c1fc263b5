# SPDX-License-Identifier: Apache-2.0
"""What a law may see of a table, and laws that somebody enters by a file.

Tests `fitted_laws.py`, `left_out.py` and `own_law.py`.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner, Result
from lab_truth import plate_rows, write

from smallwheel_ros.cli import main
from smallwheel_ros.compare.fitted_laws import OURS, Fold, predictions
from smallwheel_ros.compare.left_out import tasks_of
from smallwheel_ros.compare.own_law import load_laws
from smallwheel_ros.fitting.points import Points, points_of
from smallwheel_ros.measurements.from_file import read_measurements
from smallwheel_ros.measurements.measurements import Measurements

HEADER = "run,diameter,width,load,slip,sinkage,drawbar_pull\n"
LAW = """
from dataclasses import dataclass
import numpy as np
from smallwheel_ros.compare import Law, parameter

@dataclass(frozen=True)
class Saturating(Law):
    name = "Saturating"
    p: float = parameter(1e5, (1e3, 1e7), "pressure that is never reached", unit="Pa")
    z: float = parameter(0.01, (1e-4, 1.0), "depth of half of it", unit="m")

    def sinkage(self, conditions):
        pressure = conditions.load / (0.25 * np.pi * conditions.diameter**2)
        return self.z * pressure / np.maximum(self.p - pressure, 1e-3 * self.p)
"""


def table(path: Path, rows: list[str]) -> Measurements:
    path.write_text(HEADER + "\n".join(rows))
    return read_measurements(path)


def rolled(slips: list[tuple[str, float]], wheels: tuple[float, ...] = (0.2,)) -> list[str]:
    """A wheel that digs with slip; each row a load of its own."""
    rows = []
    for diameter in wheels:
        for i, (name, slip) in enumerate(slips):
            load = 40 + 7 * (i % 5)
            sinkage = 0.002 + 1e-4 * load * (1 + 2 * slip)
            rows.append(f"{name} {diameter},{diameter},0.1,{load},{slip},{sinkage},{5 * slip - 2}")
    return rows


def test_a_run_is_never_on_both_sides(tmp_path: Path) -> None:
    """Runs of two slips each: with a slip, all of its runs are gone."""
    slips = [
        (f"r{i // 2}", [0.0, 0.1, 0.2, 0.3, 0.4, 0.5][(i // 2 + 3 * (i % 2)) % 6])
        for i in range(12)
    ]
    data = table(tmp_path / "t.csv", rolled(slips))
    for task in tasks_of(data):
        seen = np.zeros(len(data), dtype=bool)
        for out, others in task.folds():
            assert not set(data.run[out]) & set(data.run[others])
            assert out.any()
            seen |= out
        assert seen.all()


def test_a_way_that_leaves_nothing_is_left_out(tmp_path: Path) -> None:
    """Each run is swept over all slips: to leave out a slip is to leave out everything."""
    data = table(tmp_path / "t.csv", rolled([(f"r{i % 4}", 0.1 * (i // 4)) for i in range(16)]))
    assert [task.what for task in tasks_of(data)] == ["run"]


def test_ways_to_leave_out(tmp_path: Path) -> None:
    slips = [(f"r{i}", 0.1 * (i % 4)) for i in range(8)]
    data = table(tmp_path / "t.csv", rolled(slips, (0.2, 0.3)))
    found = {task.what: task for task in tasks_of(data)}
    assert {what: len(task.names) for what, task in found.items()} == {
        "slip": 4,
        "wheel": 2,
        "run": 16,
    }
    assert len(list(found["run"].folds())) == 6  # runs of one fold are left out together
    data = table(tmp_path / "t.csv", rolled([(f"r{i}", 0.04 * i) for i in range(16)]))
    (task,) = (task for task in tasks_of(data) if task.what == "slip")
    assert len(task.names) == 16
    assert len(list(task.folds())) == 6


def test_a_soil_that_is_left_out_is_not_known(tmp_path: Path) -> None:
    rows = [[f"{soil}, {row[0]}", *row[1:], soil]
            for i, soil in enumerate(("loose", "firm", "dense"))
            for row in plate_rows(np.random.default_rng(i), rows=6)]  # fmt: skip
    header = ["run", "contact", "diameter", "width", "load", "sinkage", "soil"]
    data = read_measurements(write(tmp_path / "t.csv", rows, header))
    (task,) = (task for task in tasks_of(data) if task.what == "soil")
    assert task.names == ("loose", "firm", "dense")
    assert task.measurements.conditions.soil is None


def test_no_law_knows_what_it_is_to_predict(tmp_path: Path) -> None:
    """With other values of what is left out, every law says the same of it."""
    slips = [(f"r{i}", 0.1 * (i % 5)) for i in range(15)]
    data = table(tmp_path / "t.csv", rolled(slips))
    (tmp_path / "law.py").write_text(LAW)
    own = load_laws(tmp_path / "law.py")
    out, others = next(next(task for task in tasks_of(data) if task.what == "slip").folds())
    points = points_of(data)
    mine = out[[rows[0] for rows in points.rows]]
    wrong = Points(
        **vars(points) | {"value": np.where(mine, 3.0 * points.value + 1.0, points.value)}
    )
    said: list[dict[str, Any]] = []
    for given in (points, wrong):
        fold = Fold(given, ~mine, data.take(others))
        said.append({law.law: law.value[mine] for law in predictions(fold, own)})
    assert "Saturating" in said[0]
    assert OURS in said[0]
    for law, values in said[0].items():
        np.testing.assert_allclose(said[1][law], values, rtol=1e-9, err_msg=law)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Plates whose pressure levels off, as no power of depth does."""
    (tmp_path / "sets").mkdir()
    rng, rows = np.random.default_rng(1), []
    for diameter in (0.04, 0.06, 0.08, 0.12):
        p = 8e4 * np.exp(0.005 * rng.normal())
        for z in np.geomspace(0.002, 0.1, 12):
            load = 0.25 * np.pi * diameter**2 * p * z / (0.012 + z)
            rows.append([f"plate {diameter}", "plate", diameter, "", load, z])
    write(tmp_path / "sets" / "plates.csv", rows)
    (tmp_path / "sets" / "LICENSE").write_text("CC0\n")
    return tmp_path


def entered(folder: Path, law: str) -> Result:
    (folder / "law.py").write_text(law)
    arguments = [
        "compare",
        folder / "sets",
        "--law",
        folder / "law.py",
        "--json",
        folder / "o.json",
    ]
    return CliRunner().invoke(main, list(map(str, arguments)))


def named(name: str, *changes: tuple[str, str]) -> str:
    """The law again under another name, with some of its text replaced."""
    text = LAW[LAW.index("@dataclass") :].replace("Saturating", name)
    for old, new in changes:
        text = text.replace(old, new)
    return text


def test_laws_of_ones_own(folder: Path) -> None:
    """One that is right beats ours; others are held, refuse everything, or lack their column."""
    laws = [
        LAW,
        named("Held", ("(1e-4, 1.0)", "(1e-4, 5e-3)")),
        named("Silent", ("return ", "return np.nan * ")),
        named("Slipping", ("    p: float", "    needs = ('slip',)\n    p: float")),
    ]
    result = entered(folder, "\n".join(laws))
    assert result.exit_code == 0, result.output
    (task,) = json.loads((folder / "o.json").read_text())["tasks"]
    law = {law["law"]: law for law in task["laws"]}
    assert law["Saturating"]["ours"] == "loses"
    assert law["Saturating"]["sinkage_rmse"] < 0.3 * law[OURS]["sinkage_rmse"]
    assert law["Saturating"]["at_bound"] == {}
    assert "Saturating" in result.output.split("Where ours loses")[1]
    assert "Held, of 4 fits at a bound: z in 4." in result.output
    # It takes nobody along: the others are judged on all points.
    assert law["Silent"]["sinkage_rmse"] is None
    assert law["Silent"]["refused"] == task["points"]["sinkage"] > 0
    assert law["Silent"]["ours"] is None
    assert law[OURS]["refused"] == 0
    assert "Slipping" not in law
    assert "Not used: Slipping: no table has what it needs: slip." in result.output


def test_what_a_law_refuses_is_counted_and_nobody_is_judged_on_it(folder: Path) -> None:
    deep = LAW.replace("return ", "return np.where(conditions.diameter > 0.1, np.nan, 1.0) * ")
    result = entered(folder, deep)
    assert result.exit_code == 0, result.output
    (task,) = json.loads((folder / "o.json").read_text())["tasks"]
    refused = {law["law"]: law["refused"] for law in task["laws"]}
    assert refused.pop("Saturating") > 0
    assert set(refused.values()) == {0}
    assert all(law["by_part"]["120 mm"] is None for law in task["laws"])
    assert "Saturating does not predict" in result.output


@pytest.mark.parametrize(
    ("law", "said"),
    [
        (LAW.replace("np.maximum", "np.maximun"), "law.py, line 14: law 'Saturating': sinkage gave"),
        (LAW.replace("return self.z", "return self.q"), "has no attribute 'q'"),
        (LAW.replace("return ", "return [1.0, 2.0] and [0.0, 1.0] or "), "each of"),
        (LAW.replace("return ", "return 'deep' or "), "each of"),
        (LAW.replace("(1e3, 1e7)", "(1e7, 1e3)"), "expected low < high"),
        (LAW.replace("@dataclass(frozen=True)", ""), "lacks the line '@dataclass(frozen=True)'"),
        (LAW.replace("def sinkage", "def depth"), "expected a method sinkage(conditions)"),
        (LAW.replace("(Law)", ""), "defines no law, expected a class that derives from Law"),
        (LAW.replace('= parameter(0.01, (1e-4, 1.0), "depth of half of it", unit="m")', "= 1.0"),
         "'z' is neither"),
        (LAW.replace("    p: float", "    needs = 'slip'\n    p: float"), "expected a tuple of columns"),
        (LAW.replace('"Saturating"', '"Reece"'), "two laws of the table are called 'Reece'"),
        ("import nothing_of_this_name\n", "law.py, line 1: ModuleNotFoundError"),
        ("def (\n", "law.py, line 1: SyntaxError"),
    ],
)  # fmt: skip
def test_a_law_that_fails_is_one_message(folder: Path, law: str, said: str) -> None:
    result = entered(folder, law)
    assert result.exit_code == 2, result.output
    assert said in result.output
    assert "Traceback" not in result.output


PULL = """
@dataclass(frozen=True)
class Pull(Law):
    needs = ("slip",)
    a: float = parameter(1.0, (-50.0, 50.0), "pull at slip 0", unit="N")
    b: float = parameter(1.0, (-50.0, 50.0), "growth with slip", unit="N")

    def drawbar_pull(self, conditions):
        return self.a + self.b * conditions["slip"]
"""


def test_the_law_of_the_page_and_one_of_pull(tmp_path: Path, repository: Path) -> None:
    """They are the truth of this table: they leave next to nothing of it."""
    page = (repository / "docs" / "benchmark.md").read_text(encoding="utf-8")
    law = page.split("```python\n")[1].split("```")[0]
    (tmp_path / "sets").mkdir()
    table(tmp_path / "sets" / "t.csv", rolled([(f"r{i}", 0.1 * (i % 3)) for i in range(6)]))
    (tmp_path / "sets" / "LICENSE").write_text("CC0\n")
    result = entered(tmp_path, law + PULL)
    assert result.exit_code == 0, result.output
    tasks = json.loads((tmp_path / "o.json").read_text())["tasks"]
    assert [task["left_out"] for task in tasks] == ["slip", "run"]
    for task in tasks:
        by = {(law["law"], law["channel"]): law for law in task["laws"]}
        assert ("Pull", "sinkage") not in by
        assert ("A line over slip", "drawbar_pull") not in by
        assert by["Pull", "drawbar_pull"]["drawbar_pull_rmse"] < 1e-4
        ours, line = (by[name, "sinkage"]["sinkage_rmse"] for name in (OURS, "A line over slip"))
        assert line < 0.2 * ours


def test_a_file_that_is_not_there(folder: Path) -> None:
    result = CliRunner().invoke(main, ["compare", str(folder / "sets"), "--law", "none.py"])
    assert result.exit_code == 2
    assert "none.py: no such file of laws" in result.output


def test_of_a_rolling_wheel_levels_of_slip_are_left_out(repository: Path) -> None:
    """The data that is passed on with the package."""
    data = repository / "examples" / "data"
    table = read_measurements(data / "cmu_wheel_rig" / "rolling_smooth_wheel.csv")
    task = next(iter(tasks_of(table)))
    assert task.what == "slip"
    assert len(task.names) == 9
    slip = table.conditions["slip"]
    for part in range(9):
        assert np.ptp(slip[task.part == part]) < 0.02


def test_the_data_that_is_passed_on_has_licence_source_and_tasks(repository: Path) -> None:
    folders = sorted(f for f in (repository / "examples" / "data").iterdir() if f.is_dir())
    assert folders
    for folder in folders:
        assert (folder / "LICENSE").is_file()
        assert (
            "licence" in (folder / "SOURCE.md").read_text()
            or "CC BY" in (folder / "SOURCE.md").read_text()
        )
        for file in folder.glob("*.csv"):
            assert list(tasks_of(read_measurements(file))), file
            assert file.stat().st_size < 100_000
        assert sum(file.stat().st_size for file in folder.glob("*.mcap")) < 1_500_000
