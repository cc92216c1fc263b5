from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner

from smallwheel_ros.cli import main
from smallwheel_ros.simulate.rig import RigSettings, simulate_rig


def diagnosed(folder: Path, settings: RigSettings) -> tuple[Path, bytes]:
    table, document = folder / "rig.csv", folder / "diagnosis.json"
    simulate_rig(settings).table.to_csv(table, index=False)
    result = CliRunner().invoke(main, ["diagnose", str(table), "--json", str(document)])
    assert result.exit_code == 0, result.output
    return document, document.read_bytes()


def test_names_the_hidden_effect_and_the_error_falls(tmp_path: Path, shared_tools: Path) -> None:
    path, content = diagnosed(tmp_path, RigSettings(seed=3, hidden=("slip_sinkage",)))
    document = json.loads(content)
    assert document["verdict"] == "missing_effect"
    assert document["missing_effects"] == ["slip_sinkage"]
    before, after = (step["held_out_rmse"]["sinkage"] for step in document["steps"])
    assert after < 0.4 * before
    checker = shared_tools / "check_diagnosis_json.py"
    checked = subprocess.run(
        [sys.executable, str(checker), str(path)], capture_output=True, text=True, check=False
    )
    assert checked.stdout.strip() == "ok"


def test_nothing_missing_is_said_and_the_same_seed_gives_the_same_bytes(tmp_path: Path) -> None:
    _, first = diagnosed(tmp_path, RigSettings(seed=11))
    _, again = diagnosed(tmp_path, RigSettings(seed=11))
    assert first == again
    assert json.loads(first)["verdict"] == "adequate"


def test_five_runs_are_too_few(tmp_path: Path) -> None:
    _, content = diagnosed(tmp_path, RigSettings(seed=3, hidden=("slip_sinkage",), runs=5))
    document = json.loads(content)
    assert document["verdict"] == "insufficient_data"
    assert document["missing_effects"] == []


@pytest.mark.parametrize("content", ["", "load [N]\n", "not a table at all"])
def test_what_is_no_table_gives_one_message(tmp_path: Path, content: str) -> None:
    table, document = tmp_path / "bad.csv", tmp_path / "diagnosis.json"
    table.write_text(content)
    result = CliRunner().invoke(main, ["diagnose", str(table), "--json", str(document)])
    assert result.exit_code == 2
    assert "bad.csv" in result.output
    assert not document.exists()
