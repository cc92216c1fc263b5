# SPDX-License-Identifier: Apache-2.0
"""No command writes over what it reads, or computes for long and then cannot write.

Tests `outputs.py`.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result

from smallwheel_ros import cli
from smallwheel_ros.common.files import OutputError, check_targets
from smallwheel_ros.model.model import CalibratedModel, Model
from smallwheel_ros.model.model_file import write_model
from smallwheel_ros.physics.soil import Soil
from smallwheel_ros.simulate import RigSettings, simulate_rig, write_table

PREDICT = ["predict", "--load", "50", "--diameter", "0.2", "--width", "0.1", "--model", "m.yaml"]
ADD = ["add", "slip_sinkage", "--model", "m.yaml", "--data", "d.csv"]
INPUTS = ("d.csv", "m.yaml", "own.py")


def smallwheel(*arguments: str) -> Result:
    return CliRunner().invoke(cli.main, arguments)


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    # Four runs: too few for a diagnosis, enough for each command to be quick.
    write_table(simulate_rig(RigSettings(seed=1, runs=4)).table, Path("d.csv"))
    model = CalibratedModel(Model(Soil("rig_soil", 1e6, 0.9)), ("rig_soil.n",), np.eye(1) * 1e-3)
    write_model("m.yaml", model)
    Path("own.py").write_text("# effects of one's own\n")
    Path("link.csv").symlink_to("d.csv")
    return tmp_path


@pytest.mark.parametrize(
    "arguments",
    [
        ["fit", "d.csv", "-o", "d.csv"],
        ["fit", "d.csv", "-o", "link.csv"],
        ["fit", "d.csv", "-o", "new.yaml", "--json", "d.csv"],
        ["fit", "d.csv", "--effects", "own.py", "-o", "own.py"],
        ["diagnose", "d.csv", "--json", "./d.csv"],
        ["diagnose", "d.csv", "--html", "d.csv"],
        ["diagnose", "d.csv", "--apply", "-o", "d.csv"],
        ["diagnose", "d.csv", "--model", "m.yaml", "--json", "m.yaml"],
        [*ADD, "-o", "d.csv"],
        [*ADD, "-o", "new.yaml", "--json", "m.yaml"],
        ["compare", "d.csv", "--json", "d.csv"],
        ["compare", "d.csv", "--model", "m.yaml", "--html", "m.yaml"],
        ["report", "d.csv", "-o", "d.csv"],
        ["report", "d.csv", "--model", "m.yaml", "-o", "m.yaml"],
        [*PREDICT, "--json", "m.yaml"],
        ["effects", "--effects", "own.py", "--json", "own.py"],
        ["compare", ".", "--law", "own.py", "-o", "own.py"],
        ["replay", "bag", "--config", "m.yaml", "-o", "out", "--json", "m.yaml"],
    ],
)
def test_an_input_is_never_written_over(arguments: list[str]) -> None:
    before = {name: Path(name).read_bytes() for name in INPUTS}
    result = smallwheel(*arguments)
    assert result.exit_code == 2, result.output
    assert "is read by this command" in result.stderr
    assert {name: Path(name).read_bytes() for name in INPUTS} == before
    assert not list(Path().glob("new*"))


@pytest.mark.parametrize(
    "arguments",
    [
        ["fit", "d.csv", "-o", "new", "--json", "new"],
        ["diagnose", "d.csv", "--json", "new", "--html", "./new"],
        [*ADD, "-o", "new", "--json", "new"],
        ["compare", "d.csv", "--json", "new", "--html", "new"],
        [*PREDICT, "--json", "new", "--plot", "new"],
    ],
)
def test_two_outputs_never_share_a_name(arguments: list[str]) -> None:
    result = smallwheel(*arguments)
    assert result.exit_code == 2, result.output
    assert "two outputs name the same file" in result.stderr
    assert not Path("new").exists()


def test_a_model_file_may_be_replaced_by_a_better_one() -> None:
    before = Path("m.yaml").read_text()
    result = smallwheel(*ADD, "-o", "m.yaml")
    assert result.exit_code == 0, result.output
    assert "slip_sinkage" in Path("m.yaml").read_text()
    assert "slip_sinkage" not in before


@pytest.mark.parametrize("command", ["diagnose", "compare"])
def test_a_file_in_place_of_the_folder_of_pictures_costs_no_result(command: str) -> None:
    result = smallwheel(command, "d.csv", "--plots", "m.yaml", "--json", "new.json")
    assert result.exit_code == 2
    assert "m.yaml: a file, expected a folder" in result.stderr


def test_a_model_that_is_not_written_is_said() -> None:
    """Four runs are insufficient data: -o then writes nothing, and an old file would pass for it."""
    result = smallwheel("diagnose", "d.csv", "--apply", "-o", "new.yaml")
    assert result.exit_code == 0, result.output
    assert "new.yaml was not written" in result.stderr
    assert not Path("new.yaml").exists()


def test_where_nothing_can_be_written_is_said_before_the_work() -> None:
    with pytest.raises(OutputError, match=r"/proc/result\.json: cannot be written"):
        check_targets(["/proc/result.json"])
    check_targets(["/dev/null", "/dev/null", "-", "-", None], ["/dev/null"])
