# SPDX-License-Identifier: Apache-2.0
"""The commands predict, effects and paper, and the group that holds all commands.

Tests `command.py` and `physics.py`.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result

from smallwheel_ros import __version__, cli
from smallwheel_ros.effects.registry import effect, families
from smallwheel_ros.model.model import CalibratedModel, Model, predict
from smallwheel_ros.model.model_file import write_model
from smallwheel_ros.physics.conditions import Conditions
from smallwheel_ros.physics.soil import soil

WHEEL = ("--diameter", "0.2", "--width", "0.1")


def run(*arguments: str | Path) -> Result:
    result = CliRunner().invoke(cli.main, [str(a) for a in arguments])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result


def test_help_imports_nothing_heavy() -> None:
    """`smallwheel --help` must be quick: neither NumPy nor any command is imported."""
    code = (
        "import sys\n"
        "from smallwheel_ros.cli import main\n"
        "try:\n    main(['--help'])\n"
        "except SystemExit:\n    pass\n"
        "print([m for m in ('numpy', 'scipy', 'matplotlib', 'pint') if m in sys.modules])\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "predict" in done.stdout
    assert "paper" in done.stdout
    assert done.stdout.rstrip().endswith("[]")


def test_version_and_commands() -> None:
    assert run("--version").output == f"smallwheel, version {__version__}\n"
    listed = cli.main.list_commands(None)  # type: ignore[arg-type]
    for name in listed:
        assert run(name, "--help").exit_code == 0, name


def test_unknown_command() -> None:
    result = run("predikt")
    assert result.exit_code == 2
    assert "no command 'predikt': did you mean 'predict'" in result.stderr


def test_predict_table_and_json(tmp_path: Path) -> None:
    out = tmp_path / "out.json"
    result = run(
        "predict", "--load", "20:60:40", *WHEEL, "--slip", "0.2", "--soil", "dry_sand",
        "--json", out, "--plot", tmp_path / "out.png",
    )  # fmt: skip
    assert result.exit_code == 0
    assert result.output.splitlines()[0].split("  ")[0] == "load [N]"
    rows = json.loads(out.read_text())["rows"]
    alone = predict(Model(soil("dry_sand")), Conditions.of([20, 60], 0.2, 0.1, slip=0.2))
    assert [r["sinkage"] for r in rows] == alone.sinkage.tolist()
    assert f"{1e3 * alone.sinkage[1]:.2f}" in result.output
    assert (tmp_path / "out.png").read_bytes().startswith(b"\x89PNG")


def test_predict_writes_nothing_but_json_on_a_dash() -> None:
    result = run("predict", "--load", "60", *WHEEL, "--soil", "dry_sand", "--json", "-")
    assert json.loads(result.stdout)["schema"] == 1


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="this system has no /dev/full")
@pytest.mark.parametrize("more", [(), ("--json", "-")])
def test_a_full_disk_is_one_message(more: tuple[str, ...]) -> None:
    arguments = ["predict", "--load", "100", *WHEEL, "--soil", "dry_sand", *more]
    # With a buffer, as usual, Python tries once more at its exit.
    buffered = {k: v for k, v in os.environ.items() if k != "PYTHONUNBUFFERED"}
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "smallwheel_ros", *arguments],
            stdout=full, stderr=subprocess.PIPE, text=True, check=False, env=buffered,
        )  # fmt: skip
    assert done.returncode == 2
    assert "No space left" in done.stderr
    assert "Traceback" not in done.stderr


def test_a_reader_that_has_seen_enough_is_no_error() -> None:
    command = f"{sys.executable} -m smallwheel_ros predict --load 1:2000:0.1 --diameter 0.2 "
    command += "--width 0.1 --soil dry_sand | head -1"
    done = subprocess.run(command, shell=True, capture_output=True, text=True, check=True)
    assert done.stdout.startswith("load")
    assert done.stderr == ""


def test_predict_closed_form() -> None:
    text = run(
        "predict", "--load", "65", "--diameter", "17 cm", "--width", "85 mm",
        "--soil", "dry_sand", "--closed-form",
    ).output  # fmt: skip
    assert " 11.89 " in text


def test_predict_from_a_model_file(tmp_path: Path) -> None:
    path = tmp_path / "model.yaml"
    model = Model([soil("dry_sand"), soil("moist_earth")]) + effect("penetration_rate", mu=0.1)
    write_model(path, CalibratedModel(model, ("dry_sand.n",), np.array([[1e-4]])))
    asked = ("predict", "--load", "60", *WHEEL, "--model", path)
    result = run(*asked, "--soil", "dry_sand", "--set", "speed=20 cm/s")
    assert result.exit_code == 0
    assert "+-" in result.output
    result = run(*asked, "--soil", "dry_sand")
    assert result.exit_code == 2
    assert "effect 'penetration_rate' needs the column 'speed'" in result.stderr
    result = run(*asked, "--set", "speed=0.2")
    assert result.exit_code == 2
    assert "has several soils (dry_sand, moist_earth)" in result.stderr


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--soil", "drysand"), "no soil 'drysand': did you mean 'dry_sand'"),
        ((), "give a soil (--soil) or a model (--model)"),
        (("--soil", "dry_sand", "--slip", "2"), "slip is 2, expected -1 to 1"),
        (("--soil", "dry_sand", "--load", "1e-320"), "load is 9.99989e-321, expected 0.001 to"),
        (("--soil", "dry_sand", "--load", "1e300"), "load is 1e+300, expected 0.001 to 1000000 N"),
        (("--soil", "dry_sand", "--load", "10,1e7"), "load is 1e+07, expected 0.001 to 1000000 N"),
        (("--soil", "dry_sand", "--diameter", "170"), "diameter is 170, expected 0.001 to 20 m"),
        (("--soil", "dry_sand", "--width", "1e-9"), "width is 1e-09, expected 0.001 to 20 m"),
        (("--soil", "dry_sand", "--set", "speed=1e30"), "speed is 1e+30, expected 0 to 1000 m/s"),
        (("--soil", "dry_sand", "--set", "heat=1e30"), "heat is 1e+30, expected"),
        (("--soil", "dry_sand", "--load", "1 9⁹⁹⁹⁹ N"), "unknown unit '9⁹⁹⁹⁹ N'"),
        (("--soil", "dry_sand", "--set", "speed"), "--set speed: expected NAME=VALUE"),
        (("--soil", "dry_sand", "--set", "load=3"), "expected NAME=VALUE with a new NAME"),
        (("--soil", "dry_sand", "--set", "slope=5 mm"), "slope: unit 'mm' is a length"),
        (("--soil", "dry_sand", "--plot", "/nowhere/x.png"), "the folder /nowhere does not exist"),
        (("--soil", "dry_sand", "--plot", "x.nonsense"), "cannot be drawn"),
        (("--model", "/nowhere/m.yaml"), "/nowhere/m.yaml: cannot be read"),
    ],
)
def test_predict_refuses(
    arguments: tuple[str, ...], message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    result = run("predict", "--load", "60", *WHEEL, *arguments)
    assert result.exit_code == 2
    assert message in result.stderr
    assert "Traceback" not in result.stderr
    assert not list(tmp_path.iterdir())


def test_effects_are_listed() -> None:
    text = run("effects").output
    assert all(id in text for id in families())
    assert "covariate:NAME" in text
    listed = json.loads(run("effects", "--json", "-").stdout)["effects"]
    assert set(listed) == set(families())
    slip = listed["slip_sinkage"][0]
    assert slip["parameters"][0]["name"] == "a"
    assert slip["needs"] == slip["drivers"] == ["slip"]
    kinds = {id: forms[0]["kind"] for id, forms in listed.items()}
    assert (kinds["slip_sinkage"], kinds["load_gain"]) == ("soil", "instrument")


@pytest.mark.parametrize("id", [*families(), "covariate:temperature"])
def test_effects_are_explained(id: str) -> None:
    result = run("effects", id)
    assert result.exit_code == 0
    for form in families().get(id, ()):
        assert form.formula in result.output
        assert form.source in result.output
        assert form.next_step in result.output
        assert f"({form.kind})" in result.output


def test_a_users_effect_is_explained_with_the_rest(tmp_path: Path) -> None:
    own = tmp_path / "own.py"
    own.write_text(
        "from dataclasses import dataclass\n"
        "from smallwheel_ros.effects import Effect, parameter\n"
        "@dataclass(frozen=True)\n"
        "class Own(Effect):\n"
        "    id = 'own_effect'\n"
        "    summary = 'Mine.'\n"
        "    a: float = parameter(1.0, (0.0, 2.0), 'size')\n"
        "    def sinkage(self, sinkage, conditions):\n"
        "        return sinkage * (1 + self.a)\n"
    )
    assert "own_effect" in run("effects", "--effects", own).output
    assert "size" in run("effects", "own_effect", "--effects", own).output
    assert run("effects", "own_effect").exit_code == 2


def test_paper(tmp_path: Path) -> None:
    result = run("paper", "--json", tmp_path / "paper.json")
    assert result.exit_code == 0
    assert "not reproduced" in result.output
    lines = json.loads((tmp_path / "paper.json").read_text())["lines"]
    assert {line["status"] for line in lines} == {
        "reproduced", "reproduced under an inferred reading", "not reproduced", "taken over", "follows",
    }  # fmt: skip


def test_numbers_are_typed_as_cells_of_a_table_are() -> None:
    """Per cent, a decimal comma, a mass: the same rows as in SI, and what was read is said."""
    plain = run("predict", "--load", "49.03325", "--diameter", "0.2", "--width", "0.1", "--slip",
                "0.3", "--soil", "dry_sand", "--json", "-")  # fmt: skip
    typed = run("predict", "--load", "5 kg", "--diameter", "0,2", "--width", "10cm", "--slip",
                "30%", "--soil", "dry_sand", "--json", "-")  # fmt: skip
    (row,), (other,) = (json.loads(r.stdout)["rows"] for r in (plain, typed))
    assert {k: v for k, v in other.items() if k != "status"} == pytest.approx(
        {k: v for k, v in row.items() if k != "status"}
    )
    notes = json.loads(typed.stdout)["notes"]
    assert notes[:2] == ["'5 kg' -> load 49.03 N, the weight of that mass",
                         "'0,2' -> diameter 0.2 m, a decimal comma"]  # fmt: skip
    assert notes[2:] == json.loads(plain.stdout)["notes"]


def test_a_model_may_be_a_soil_of_the_library(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    asked = ("predict", "--load", "60", *WHEEL, "--json", "-")
    by_soil = run(*asked, "--soil", "dry_sand")
    by_name = run(*asked, "--model", "dry_sand")
    assert by_name.stdout == by_soil.stdout
    assert by_name.stderr == ""
    Path("dry_sand").mkdir()  # a folder is no model
    assert run(*asked, "--model", "dry_sand").stdout == by_soil.stdout
    Path("dry_sand").rmdir()
    write_model("dry_sand", Model("moist_earth"))
    by_file = run(*asked, "--model", "dry_sand")
    assert by_file.stdout == run(*asked, "--soil", "moist_earth").stdout
    said = "understood: --model dry_sand is the file of that name, not the soil of the library\n"
    assert by_file.stderr == said
    wrong = run(*asked, "--model", "dry_snd")
    assert wrong.exit_code == 2
    assert "neither a file nor a soil: did you mean 'dry_sand'?" in wrong.output


# A table of settings


PLANNED = (
    "run,load [N],diameter [mm],width [mm],slip [%],sinkage [mm],sinkage_std [mm]\n"
    "a,20,200,100,10,5,0.2\nb,60,200,100,30,,\nc,9000,200,100,30,7,\n"
)


def test_the_rows_of_a_table_come_out_in_their_order(tmp_path: Path) -> None:
    path = tmp_path / "planned.csv"
    path.write_text(PLANNED)
    result = run("predict", "--data", path, "--soil", "dry_sand", "--json", "-")
    rows = json.loads(result.stdout)["rows"]
    assert [row["run"] for row in rows] == ["a", "b", "c"]
    assert [row["load"] for row in rows] == [20.0, 60.0, 9000.0]
    assert rows[0]["measured_sinkage"] == pytest.approx(0.005)
    assert rows[0]["measured_sinkage_std"] == pytest.approx(0.0002)
    assert rows[1]["measured_sinkage"] is None
    assert rows[2]["status"] != "ok"
    assert rows[2]["sinkage"] is None
    alone = run(
        "predict", "--load", "60", *WHEEL, "--slip", "30%", "--soil", "dry_sand", "--json", "-"
    )
    (one,) = json.loads(alone.stdout)["rows"]
    assert rows[1]["sinkage"] == pytest.approx(one["sinkage"], rel=1e-12)
    assert rows[1]["drawbar_pull_std"] == pytest.approx(one["drawbar_pull_std"], rel=1e-9)


def test_a_table_without_measurements_is_a_table_of_settings(tmp_path: Path) -> None:
    path, out = tmp_path / "planned.csv", tmp_path / "out.csv"
    path.write_text("F,D [mm],b [mm]\n20,200,100\n40,200,100\n")
    asked = ("predict", "--data", path, "--soil", "dry_sand", "--map", "load [N]=F", "-o", out)
    assert run(*asked).exit_code == 0
    assert len(out.read_text().splitlines()) == 3


@pytest.mark.parametrize(
    ("table", "more", "said"),
    [
        (PLANNED, ("--load", "5"), "data and load: found both, expected one"),
        ("load,diameter\n20,0.2\n", (), "no column 'width'"),
        ("load,diameter,width\n20,0.2,0.1\n-3,0.2,0.1\n", (), "load"),
        ("load,diameter,width\n20,200,100\n", (), "diameter"),
        ("load,diameter,width,slip\n20,0.2,0.1,7\n", (), "slip"),
        ("load,diameter,width\n20,0.2,0.1\n,0.2,0.1\n", (), "blank"),
    ],
)
def test_a_bad_table_of_settings_is_refused(
    tmp_path: Path, table: str, more: tuple[str, ...], said: str
) -> None:
    path = tmp_path / "planned.csv"
    path.write_text(table)
    result = run("predict", "--data", path, "--soil", "dry_sand", *more)
    assert result.exit_code == 2
    assert said in result.stderr
    assert "Traceback" not in result.stderr


def test_more_rows_than_are_predicted_at_once_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "planned.csv"
    path.write_text("load,diameter,width\n" + "20,0.2,0.1\n" * 200_001)
    result = run("predict", "--data", path, "--soil", "dry_sand")
    assert result.exit_code == 2
    assert "200001 rows, at most 200000" in result.stderr
