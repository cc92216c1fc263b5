# SPDX-License-Identifier: Apache-2.0
"""fit, diagnose and add on the command line: what they write, and what they refuse.

Tests `bench.py`.
"""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path

import pandas as pd
import pytest
from click.testing import CliRunner, Result

import smallwheel_ros as sw
from smallwheel_ros.arguments import understand
from smallwheel_ros.cli import main
from smallwheel_ros.measurements.typed import limits_of
from smallwheel_ros.model.model_file import read_model, write_model
from smallwheel_ros.simulate import RigSettings, simulate_rig, write_table

OWN = """
from dataclasses import dataclass
import numpy as np
from smallwheel_ros.effects.base import Effect, parameter

@dataclass(frozen=True)
class Shaking(Effect):
    id = "shaking"
    summary = "A rig that shakes loosens the soil."
    formula = "k exp(-a s)"
    source = "this test"
    needs = ("shake",)
    a: float = parameter(0.2, (-3.0, 3.0), "loosening")

    def modulus_factor(self, conditions):
        return np.exp(-self.a * conditions["shake"])
"""


def rig(**settings: object) -> pd.DataFrame:
    given = {"runs": 12} | settings
    return simulate_rig(RigSettings(**given)).table  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def digging(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A table in which slip sinkage is hidden."""
    path = tmp_path_factory.mktemp("digging") / "rig.csv"
    write_table(rig(seed=3, hidden=("slip_sinkage",)), path)
    return path


def run(*arguments: object) -> Result:
    return CliRunner().invoke(main, [str(a) for a in arguments])


def refused(result: Result, *words: str) -> None:
    """Assert one message with those words, exit code 2 and no traceback."""
    assert result.exit_code == 2, result.output
    assert isinstance(result.exception, SystemExit)
    for word in words:
        assert word in result.output


def test_diagnose_writes_what_it_says(digging: Path, tmp_path: Path) -> None:
    names = ("d.json", "m.yaml", "r.html", "plots")
    document, model, page, plots = (tmp_path / name for name in names)
    written = ["--json", document, "--apply", "-o", model, "--html", page, "--plots", plots]
    result = run("diagnose", digging, *written)
    assert result.exit_code == 0, result.output
    assert "The model lacks slip sinkage" in result.output
    found = json.loads(document.read_text())
    assert found["missing_effects"] == ["slip_sinkage"]
    assert [e.id for e in read_model(model).model.effects] == ["slip_sinkage"]
    assert "held_out_rmse" in read_model(model).provenance
    assert page.read_text().lstrip().startswith("<!")
    assert list(plots.glob("*.png"))


def test_fit_then_add_then_diagnose_with_the_model(digging: Path, tmp_path: Path) -> None:
    model, better = tmp_path / "m.yaml", tmp_path / "m2.yaml"
    fitted = run("fit", digging, "-o", model)
    assert fitted.exit_code == 0, fitted.output
    assert set(read_model(model).provenance["held_out_rmse"]) == {"sinkage", "resistance"}
    added = run("add", "slip_sinkage", "--model", model, "--data", digging, "-o", better)
    assert added.exit_code == 0, added.output
    assert "recommended: the diagnosis of this data names it" in added.output
    assert [e.id for e in read_model(better).model.effects] == ["slip_sinkage"]
    again = run("diagnose", digging, "--model", better)
    assert again.exit_code == 0, again.output
    assert "The model lacks" not in again.output


@pytest.mark.parametrize(
    ("effect", "said"),
    [
        ("slip_sinkag", "slip_sinkage"),
        ("grouser", "grouser_height"),
        ("covariate:speed", "'speed' is a known setting, and those have effects of their own (pen"),
        ("covariate:load", "(load_dependent_modulus, rig_friction): add one of them"),
        ("covariate:moistness", "no column 'moistness' of numbers"),
        ("covariate:sinkage", "'sinkage' is a measured quantity"),
        ("covariate:wheel", "'wheel' is text"),
    ],
)
def test_an_effect_that_cannot_be_added_is_refused(
    tmp_path: Path, digging: Path, effect: str, said: str
) -> None:
    model = tmp_path / "m.yaml"
    assert run("fit", digging, "-o", model).exit_code == 0
    out = tmp_path / "o.yaml"
    refused(run("add", effect, "--model", model, "--data", digging, "-o", out), said)
    assert not out.exists()


def test_a_fit_of_one_run_has_no_held_out_error(tmp_path: Path) -> None:
    frame = rig(seed=4009)
    write_table(frame[frame["run"] == frame["run"][0]], tmp_path / "one.csv")
    done = run("fit", tmp_path / "one.csv", "-o", tmp_path / "m.yaml")
    assert done.exit_code == 0, done.output
    assert "held_out_rmse" not in read_model(tmp_path / "m.yaml").provenance


def test_one_row_is_insufficient_and_not_an_error(tmp_path: Path) -> None:
    (tmp_path / "one.csv").write_text("load,diameter,width,sinkage\n50,0.2,0.1,0.01\n")
    document, page = tmp_path / "one.json", tmp_path / "one.html"
    result = run("diagnose", tmp_path / "one.csv", "--json", document, "--html", page)
    assert result.exit_code == 0, result.output
    found = json.loads(document.read_text())
    assert found["verdict"] == "insufficient_data"
    assert found["reason"].startswith("1 run: ")
    assert found["steps"] == [{"added": None, "held_out_rmse": {}}]
    assert page.is_file()
    assert "nan" not in result.output.lower().split()


def test_an_effect_of_ones_own_is_named(tmp_path: Path) -> None:
    frame = rig(seed=4012, runs=20)
    runs = frame["run"].unique()
    shake = frame["run"].map({name: (7 * i % len(runs)) / len(runs) for i, name in enumerate(runs)})
    frame["shake"] = shake
    # as a softer soil would: sinkage by k^(-1/(n+1/2)), resistance by half of that; n about 0.9
    frame["sinkage [mm]"] *= 2.0 ** (shake / 1.4)
    frame["resistance [N]"] *= 2.0 ** (0.5 * shake / 1.4)
    write_table(frame, tmp_path / "rig.csv")
    (tmp_path / "own.py").write_text(OWN)
    result = run("diagnose", tmp_path / "rig.csv", "--effects", tmp_path / "own.py")
    assert result.exit_code == 0, result.output
    assert "shaking" in result.stdout.splitlines()[0]


# What is printed to do next


def next_command(result: Result) -> list[str]:
    """The words of the command that a diagnosis says to run next, without those of the program."""
    assert result.exit_code == 0, result.output
    (line,) = (line for line in result.stdout.splitlines() if "Next: " in line)
    (command,) = re.findall("`(.+?)`", line)
    program, *words = shlex.split(command)
    assert program == "smallwheel"
    return words


def shaken(folder: Path) -> tuple[Path, Path]:
    """A table with an effect of one's own, under other headers, and the file of the effect."""
    frame = rig(seed=4012, runs=20)
    runs = frame["run"].unique()
    shake = frame["run"].map({name: (7 * i % len(runs)) / len(runs) for i, name in enumerate(runs)})
    frame["sinkage [mm]"] *= 2.0 ** (shake / 1.4)
    frame["resistance [N]"] *= 2.0 ** (0.5 * shake / 1.4)
    frame["shake"] = shake
    frame = frame.rename(columns={"load [N]": "F3", "diameter [mm]": "D 2"})
    table, own = folder / "my rig.csv", folder / "own law.py"
    write_table(frame, table)
    own.write_text(OWN)
    return table, own


def test_the_next_command_has_the_options_of_the_one_that_prints_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It runs as it is printed, names the same effect, and writes it."""
    monkeypatch.chdir(tmp_path)
    shaken(tmp_path)
    typed = ["my rig.csv", "--effects", "own law.py", "--map", "load [N]=F3"]
    first = run("diagnose", *typed, "--map=diameter [mm]=D 2", "--seed", 3, "--json", "d.json")
    words = next_command(first)
    assert "d.json" not in words
    again = run(*words)
    assert again.exit_code == 0, again.output
    assert again.stdout.splitlines()[0] == first.stdout.splitlines()[0]
    law = sw.effects.load("own law.py")
    assert [e.id for e in read_model(Path("MODEL.yaml"), law).model.effects] == ["shaking"]
    # What is in a model file is not to be written again.
    assert "--apply" not in again.stdout
    assert "confirm it with" in again.stdout


@pytest.mark.slow
def test_the_next_command_of_what_no_effect_explains_learns(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without the effect of one's own: `learn` with the same table and the same effects taken out."""
    monkeypatch.chdir(tmp_path)
    shaken(tmp_path)
    typed = ["my rig.csv", "--map", "load [N]=F3", "--map", "diameter [mm]=D 2"]
    out = "covariate:shake,multipass"
    words = next_command(run("diagnose", *typed, "--without", out))
    assert words[0] == "learn"
    assert words[words.index("--without") + 1] == out
    done = run(*words)
    assert done.exit_code == 0, done.output


def test_in_python_what_is_named_is_saved_from_the_result(digging: Path, tmp_path: Path) -> None:
    found = sw.diagnose(digging)
    assert "smallwheel diagnose" not in str(found)
    assert ".save('MODEL.yaml')" in str(found)
    found.save(tmp_path / "MODEL.yaml")
    assert [e.id for e in read_model(tmp_path / "MODEL.yaml").model.effects] == ["slip_sinkage"]


# What is refused


@pytest.mark.parametrize("content", ["", "load [N]\n", "not a table at all"])
def test_what_is_no_table_gives_one_message(tmp_path: Path, content: str) -> None:
    table, document = tmp_path / "bad.csv", tmp_path / "d.json"
    table.write_text(content)
    refused(run("diagnose", table, "--json", document), "bad.csv")
    assert not document.exists()


GOOD = ["20,0.2,0.1,0.008,1.2,0.1", "60,0.2,0.1,0.012,4.0,0.2", "90,0.3,0.1,0.013,6.1,0.3"]
COLUMNS = ["load", "diameter", "width", "sinkage", "resistance", "slip"]


@pytest.mark.parametrize("command", ["diagnose", "fit"])
@pytest.mark.parametrize(
    ("column", "value"),
    [
        ("load", "1e300"),
        ("load", "-5"),
        ("load", "1e-320"),
        ("diameter", "1e300"),
        ("diameter", "0"),
        ("width", "275"),
        ("sinkage", "1e300"),
        ("sinkage", "12"),
        ("resistance", "-1e300"),
        ("slip", "40"),
        ("load", "inf"),
        ("load", "many"),
    ],
)
def test_absurd_numbers_are_refused_with_their_place(
    tmp_path: Path, command: str, column: str, value: str
) -> None:
    rows = [line.split(",") for line in GOOD * 3]
    rows[4][COLUMNS.index(column)] = value
    table = tmp_path / "rig.csv"
    table.write_text("\n".join([",".join(COLUMNS), *(",".join(row) for row in rows)]) + "\n")
    more = ["-o", tmp_path / "m.yaml"] if command == "fit" else []
    refused(run(command, table, *more), "rig.csv", "6", column)
    assert not (tmp_path / "m.yaml").exists()


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ("slip", "expected NAME=VALUE"),
        ("slip=", "expected NAME=VALUE"),
        ("slip=a..b", "found 'a..b'"),
        ("slip=0.6..0", "the range '0.6..0' is empty"),
        ("slip=nan", "found 'nan'"),
        ("slip=1,,2", "found '1,,2'"),
        ("slop=0..0.6", "slip"),
        ("=3", "expected NAME=VALUE"),
        ("sinkage=0.01", "no setting 'sinkage'"),
    ],
)
def test_limits_that_are_none_are_refused(digging: Path, given: str, said: str) -> None:
    refused(run("diagnose", digging, "--can", given), "--can", said)


@pytest.mark.parametrize(
    ("given", "levels"),
    [
        ("slip=0..60%", [0.0, 0.3, 0.6]),
        ("slip=0,1..0,5", [0.1, 0.3, 0.5]),
        ("slip=0:0.6:0.2", [0.0, 0.2, 0.4, 0.6]),
        ("load=20,40 N", [20.0, 40.0]),
        ("load=5 kgf", [49.03325]),
        ("load=5 kg", [49.03325]),
        ("width=80 mm", [0.08]),
    ],
)
def test_limits_are_read_as_cells_of_a_table_are(
    digging: Path, given: str, levels: list[float], capsys: pytest.CaptureFixture[str]
) -> None:
    name, _, typed = given.partition("=")
    found = limits_of({name: typed}, sw.read(digging), understand)
    assert found == {name: pytest.approx(levels)}
    said = capsys.readouterr().err
    assert ("weight of that mass" in said) == given.endswith("kg")
    assert ("decimal comma" in said) == ("0,1" in given)


@pytest.mark.parametrize("command", ["diagnose", "fit"])
def test_sizes_for_all_rows_are_typed_as_cells_are(
    digging: Path, tmp_path: Path, command: str
) -> None:
    """The table's own diameter and width, typed in other ways, give the same document."""
    table = pd.read_csv(digging)
    table = table[table["wheel"] == table["wheel"][0]]
    sizes = {name: float(table.pop(f"{name} [mm]").iloc[0]) / 1e3 for name in ("diameter", "width")}
    typed = {"diameter": f"{100 * sizes['diameter']:g} cm",
             "width": f"{sizes['width']:g}".replace(".", ",")}  # fmt: skip
    table.to_csv(tmp_path / "bare.csv", index=False)
    documents = []
    for written in ({n: f"{v:g}" for n, v in sizes.items()}, typed):
        options = [word for name, text in written.items() for word in (f"--{name}", text)]
        done = run(command, tmp_path / "bare.csv", *options, "--json", "-")
        assert done.exit_code == 0, done.output
        documents.append(json.loads(done.stdout))
    assert f"-> width {sizes['width']:g} m, a decimal comma" in done.stderr
    assert documents[0] == documents[1]
    refused(run(command, digging, "--width", "5 kg"), "unit 'kg' is a mass, expected a length")
    refused(run(command, digging, "--width", "0.1,0.2"), "found '0.1,0.2', expected a number")
    refused(run(command, digging, "--width", "1:3:1"), "found '1:3:1', expected one number")


@pytest.mark.parametrize("command", ["fit", "diagnose", "compare", "add"])
def test_a_soil_of_the_library_is_a_model_in_every_command(
    digging: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: str
) -> None:
    """Its name says what a file of it says; a file of the same name goes first."""
    monkeypatch.chdir(tmp_path)
    table = ["slip_sinkage", "--data", digging, "-o", "out.yaml"] if command == "add" else [digging]
    write_model("sand.yaml", sw.Model("moist_earth"))

    def found(model: str) -> tuple[object, str]:
        done = run(command, *table, "--model", model, "--json", "-")
        assert done.exit_code == 0, done.output
        document = json.loads(done.stdout)
        if command == "compare":
            standing = document["models"].pop()
            assert (standing["file"] is None) == (not Path(model).exists())
            document = (document["models"], standing["channels"])
        return document, done.stderr

    by_name, said = found("moist_earth")
    assert "--model" not in said
    assert found("sand.yaml")[0] == by_name
    write_model("moist_earth", sw.Model("wong_snow"))
    by_file, said = found("moist_earth")
    assert "--model moist_earth is the file of that name" in said
    write_model("snow.yaml", sw.Model("wong_snow"))
    assert found("snow.yaml")[0] == by_file
    refused(run(command, *table, "--model", "moist_earht"), "did you mean 'moist_earth'?")


def test_an_unknown_effect_cannot_be_left_out(digging: Path) -> None:
    refused(run("diagnose", digging, "--without", "slip_sinkag"), "slip_sinkag", "slip_sinkage")
    refused(run("diagnose", digging, "--without", "multipass,nonsense"), "nonsense")


@pytest.mark.parametrize("options", [["--apply"], ["-o", "m.yaml"]])
def test_options_that_do_not_go_together(digging: Path, options: list[str]) -> None:
    refused(run("diagnose", digging, *options), "--apply and -o")


def test_a_folder_that_does_not_exist_is_refused_before_the_work(
    digging: Path, tmp_path: Path
) -> None:
    refused(run("fit", digging, "-o", tmp_path / "no" / "m.yaml"), "does not exist")
