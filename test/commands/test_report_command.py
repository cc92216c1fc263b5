# SPDX-License-Identifier: Apache-2.0
"""`smallwheel report`: the page and the JSON are there whole, or one message is.

Tests `bench.py`.
"""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from smallwheel_ros import cli
from smallwheel_ros.effects.registry import default_registry, effect
from smallwheel_ros.measurements.from_file import read_measurements
from smallwheel_ros.model.model import CalibratedModel, Model
from smallwheel_ros.model.model_file import write_model
from smallwheel_ros.physics.soil import Soil
from smallwheel_ros.simulate import RigSettings, simulate_rig, write_table
from smallwheel_ros.views import effects


@pytest.fixture(autouse=True)
def _only_the_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave out the effects beside the steps that a page is fitted with: that takes a while."""
    made = effects.models_block
    monkeypatch.setattr(effects, "models_block", lambda found, **how: made(found))


def smallwheel(*arguments: object) -> Result:
    return CliRunner().invoke(cli.main, [str(a) for a in arguments])


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("rig") / "rig.csv"
    write_table(simulate_rig(RigSettings(seed=5, runs=14, hidden=("slip_sinkage",))).table, path)
    return path


@pytest.fixture(scope="module")
def few(rig: Path) -> Path:
    """Five runs only."""
    lines = rig.read_text().splitlines()
    path = rig.with_name("few.csv")
    path.write_text("\n".join(lines[: 1 + 15]) + "\n")
    assert read_measurements(path).runs.size == 5
    return path


def test_page_and_json_tell_the_same_story(rig: Path, tmp_path: Path) -> None:
    model = tmp_path / "soft.yaml"
    write_model(model, CalibratedModel(Model(Soil("rig_soil", 3e5, 0.9, 0.3))))
    page, document = tmp_path / "report.html", tmp_path / "report.json"
    done = smallwheel("report", rig, "--model", model, "-o", page, "--json", document)
    assert done.exit_code == 0, done.output
    assert done.stdout == f"written: {page}\n"
    html, found = page.read_text(), json.loads(document.read_text())
    assert [m["name"] for m in found["comparison"]["models"]] == [
        "constant", "log_log_regression", "bekker", "meirion_griffith_spenko", "contact_integral",
        "soft"]  # fmt: skip
    diagnosis = found["diagnosis"]
    assert diagnosis["schema"] == 1
    before, after = (s["held_out_rmse"]["sinkage"] for s in diagnosis["steps"][:2])
    assert diagnosis["missing_effects"] == ["slip_sinkage"]
    assert f"Sinkage: {1e3 * before:.2f} mm → {1e3 * after:#.3g} mm" in html
    assert html.count("data-view=") == html.count('data-view="absent"') + 2 + 6  # steps, models
    assert html.count("<h2>") >= 8
    assert re.search(r"\bnan\b", html.partition("<script")[0]) is None


def test_json_on_standard_output_is_nothing_but_json(few: Path, tmp_path: Path) -> None:
    page = tmp_path / "report.html"
    done = smallwheel("report", few, "-o", page, "--json", "-")
    assert done.exit_code == 0, done.output
    assert json.loads(done.stdout)["diagnosis"]["verdict"] == "insufficient_data"
    assert page.is_file()
    text = page.read_text()
    assert "Too little data for a verdict" in text
    assert "step by step" not in text


def test_a_model_with_effects_and_effects_of_ones_own(few: Path, tmp_path: Path) -> None:
    (tmp_path / "warm.py").write_text(
        "from dataclasses import dataclass\n"
        "import numpy as np\n"
        "from smallwheel_ros.effects import Effect, parameter\n"
        "@dataclass(frozen=True)\n"
        "class Warm(Effect):\n"
        "    id = 'warm'\n"
        "    summary = 'Warm sand is softer.'\n"
        "    needs = ('speed',)\n"
        "    a: float = parameter(0.1, (0.0, 8.0), 'loss of ln k per m/s')\n"
        "    def modulus_factor(self, conditions):\n"
        "        return np.exp(-self.a * conditions['speed'])\n"
    )
    own = default_registry().with_file(tmp_path / "warm.py").effect("warm")
    model, page = tmp_path / "model.yaml", tmp_path / "report.html"
    known = (effect("slip_sinkage"), own)
    write_model(model, CalibratedModel(Model(Soil("rig_soil", 3e6, 0.9), effects=known)))
    options = ("report", few, "--model", model, "-o", page)
    without = smallwheel(*options)
    assert without.exit_code == 2
    assert "--effects FILE" in without.stderr
    assert not page.exists()
    done = smallwheel(*options, "--effects", tmp_path / "warm.py")
    assert done.exit_code == 0, done.output
    assert re.search(r"slip sinkage.*\bwarm\b", page.read_text(), re.DOTALL)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("load,diameter,width,sinkage\n20,0.2,0.1,nan\n", "line 2"),
        ("load,diameter,width,sinkage [N]\n20,0.2,0.1,0.01\n", "sinkage"),
        ("load,sinkage\n20,0.01\n", "diameter"),
        ("load,diameter,width,sinkage\n", "no rows"),
        ("load,diameter,width,sinkage\n20,0.2,0.1,0.01\n", "one measurement"),
        ("\x00\x01\x02", ""),
    ],
)
def test_bad_data_gives_one_message_and_no_file(content: str, message: str, tmp_path: Path) -> None:
    data, page = tmp_path / "bad.csv", tmp_path / "report.html"
    data.write_text(content)
    done = smallwheel("report", data, "-o", page, "--json", tmp_path / "report.json")
    assert done.exit_code == 2, done.output
    assert done.stderr.count("Error:") == 1
    assert message in done.stderr
    assert "Traceback" not in done.output
    assert [p.name for p in tmp_path.iterdir()] == ["bad.csv"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["-o", "no/report.html"], "does not exist"),
        (["-o", "."], "a folder"),
        (["-o", "report.html", "--json", "no/x.json"], "does not exist"),
        (["-o", "report.html", "--json", "./report.html"], "expected two"),
        (["-o", "rig.csv"], "is read by this command"),
        (["-o", "report.html", "--model", "none.yaml"], "none.yaml"),
        (["-o", "report.html", "--effects", "none.py"], "none.py"),
        (["-o", "report.html", "--diameter", "0.3"], "diameter"),
        ([], "-o"),
    ],
)
def test_bad_options_give_one_message_before_any_work(
    options: list[str], message: str, rig: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("rig.csv").write_text(rig.read_text())
    done = smallwheel("report", "rig.csv", *options)
    assert done.exit_code == 2, done.output
    assert message in done.stderr
    assert "Traceback" not in done.output
    assert [p.name for p in tmp_path.iterdir()] == ["rig.csv"]
    assert Path("rig.csv").read_text() == rig.read_text()
