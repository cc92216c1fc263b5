# SPDX-License-Identifier: Apache-2.0
"""`smallwheel compare` as a user calls it.

Tests `bench.py`.
"""

from __future__ import annotations

import inspect
import json
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from smallwheel_ros.cli import main
from smallwheel_ros.effects.registry import effect
from smallwheel_ros.measurements.from_file import read_measurements
from smallwheel_ros.model.model import CalibratedModel, Model
from smallwheel_ros.model.model_file import write_model
from smallwheel_ros.physics.soil import Soil
from smallwheel_ros.simulate import RigSettings, simulate_rig, write_table

USER_EFFECT = """
from dataclasses import dataclass
from smallwheel_ros.effects.base import Effect, parameter

@dataclass(frozen=True)
class Sticky(Effect):
    id = "sticky"
    form = "plain"
    summary = "A constant drag."
    stage = "added_resistance"
    drag: float = parameter(1.0, (0.0, 100.0), "drag", unit="N")

    def added_resistance(self, state, conditions):
        return self.drag + 0.0 * state.load
"""


def smallwheel(*arguments: str | Path) -> Result:
    # click before 8.2 mixes standard error into standard output unless told not to
    old = "mix_stderr" in inspect.signature(CliRunner).parameters
    runner = CliRunner(mix_stderr=False) if old else CliRunner()  # type: ignore[call-arg]
    return runner.invoke(main, ["compare", *map(str, arguments)])


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("compare")
    write_table(simulate_rig(RigSettings(seed=5, runs=8, rows_per_run=2)).table, folder / "rig.csv")
    sha256 = read_measurements(folder / "rig.csv").sha256
    model = Model(Soil("rig_soil", 1e6, 0.9, 0.2))
    write_model(folder / "own.yaml", CalibratedModel(model, provenance={"sha256": sha256}))
    return folder


@pytest.fixture(scope="module")
def done(folder: Path) -> Result:
    return smallwheel(folder / "rig.csv", "--model", folder / "own.yaml", "--json",
                      folder / "out.json", "--html", folder / "out.html", "--plots",
                      folder / "pictures")  # fmt: skip


def test_everything_is_said_and_written(folder: Path, done: Result) -> None:
    assert done.exit_code == 0, done.output
    for words in ("Sinkage, repeats of one run differ by", "Resistance, ", "contact integral", "own",
                  "was fitted to this very file", "written: "):  # fmt: skip
        assert words in done.stdout
    document = json.loads((folder / "out.json").read_text())
    assert [m["name"] for m in document["models"]][-1] == "own"
    assert "<title>Models against measurements</title>" in (folder / "out.html").read_text()
    pictures = {path.name for path in (folder / "pictures").iterdir()}
    assert pictures == {
        "errors.png",
        "resistance_ratio.png",
        "sinkage_residuals.png",
        "measured_predicted.png",
        "resistance_residuals.png",
    }
    for path in (folder / "pictures").iterdir():
        assert path.read_bytes().startswith(b"\x89PNG")


def test_json_on_standard_output_is_nothing_but_json(folder: Path, done: Result) -> None:
    again = smallwheel(folder / "rig.csv", "--model", folder / "own.yaml", "--json", "-")
    assert again.exit_code == 0
    assert json.loads(again.stdout) == json.loads((folder / "out.json").read_text())


def test_warnings_go_to_standard_error(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    rows = [f"r{i},{20 + 5 * i},0.2,0.1,{0.004 + 0.0005 * i},0.97" for i in range(6)]
    path.write_text("run,load,diameter,width,sinkage,slip\n" + "\n".join(rows) + "\n")
    result = smallwheel(path)
    assert result.exit_code == 0, result.output
    assert "warning: slip is beyond" in result.stderr
    assert "warning:" not in result.stdout


def test_a_model_file_keeps_apart_from_the_standard_models_and_may_lack_a_column(
    tmp_path: Path,
) -> None:
    rows = [f"r{i},{20 + 5 * i},0.2,0.1,{0.004 + 0.0005 * i}" for i in range(6)]
    (tmp_path / "plain.csv").write_text(
        "run,load,diameter,width,sinkage\n" + "\n".join(rows) + "\n"
    )
    model = Model(Soil("sand", 1e6, 0.9)) + effect("slip_sinkage")
    file = tmp_path / "bekker.yaml"
    write_model(file, CalibratedModel(model))
    result = smallwheel(tmp_path / "plain.csv", "--model", file, "--json", "-")
    assert result.exit_code == 0, result.output
    models = json.loads(result.stdout)["models"]
    names = [m["name"] for m in models]
    assert names == [
        "constant",
        "log_log_regression",
        "bekker",
        "meirion_griffith_spenko",
        "contact_integral",
        str(file),
    ]
    (why,) = models[-1]["not_predicted"]
    assert "needs the column 'slip'" in why["reason"]
    assert (why["rows"], why["lines"]) == (6, [2, 3, 4, 5, 6, 7])
    assert models[-1]["channels"]["sinkage"] == {"in_sample": None, "held_out": None}


def test_an_effect_of_your_own_needs_its_file(tmp_path: Path, folder: Path) -> None:
    from smallwheel_ros.effects.registry import load_effects

    (tmp_path / "sticky.py").write_text(USER_EFFECT)
    sticky = load_effects(tmp_path / "sticky.py")["sticky"][0]
    model = Model(Soil("rig_soil", 1e6, 0.9, 0.2)) + sticky(drag=2.0)
    write_model(tmp_path / "own.yaml", CalibratedModel(model))
    without = smallwheel(folder / "rig.csv", "--model", tmp_path / "own.yaml")
    assert without.exit_code == 2
    assert "sticky" in without.stderr
    given = smallwheel(folder / "rig.csv", "--model", tmp_path / "own.yaml", "--effects",
                       tmp_path / "sticky.py", "--json", "-")  # fmt: skip
    assert given.exit_code == 0, given.output
    (used,) = json.loads(given.stdout)["models"][-1]["effects"]
    assert used == {"id": "sticky", "form": "plain", "parameters": {"drag": 2.0}}


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["missing.csv"], "missing.csv: no such file"),
        (["bad.csv"], "bad.csv, line 3, column 'load': 'abc' found, expected a number"),
        (["rig.csv", "--model", "missing.yaml"], "missing.yaml"),
        (["rig.csv", "--diameter", "0.2"], "expected one of the two"),
        (["rig.csv", "--width", "wide"], "width: found 'wide', expected a number"),
        (["rig.csv", "--html", "no/where.html"], "the folder no does not exist"),
        (["rig.csv", "--json", "."], "it is a folder"),
        (["rig.csv", "--plots", "rig.csv"], "rig.csv: a file, expected a folder"),
    ],
)
def test_bad_input_is_one_message_and_exit_code_2(
    folder: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str], words: str
) -> None:
    monkeypatch.chdir(folder)
    Path("bad.csv").write_text("load,diameter,width,sinkage\n9,1,1,0.1\nabc,1,1,0.1\n")
    before = sorted(Path().rglob("*"))
    result = smallwheel(*arguments)
    assert result.exit_code == 2
    assert words in result.stderr
    assert "Traceback" not in result.output
    assert sorted(Path().rglob("*")) == before
