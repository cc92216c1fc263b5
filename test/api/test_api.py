# SPDX-License-Identifier: Apache-2.0
"""`import smallwheel_ros as sw`: what the functions return, and that the commands print the same.

Tests `add.py`, `compare.py`, `diagnose.py`, `fit.py`, `learn.py`, `predict.py`,
`read.py` and `replay.py`.
"""

from __future__ import annotations

import doctest
import inspect
import json
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import click
import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner
from matplotlib import pyplot
from matplotlib.axes import Axes

import smallwheel_ros as sw
from docs.function_table import PAGE, with_table
from smallwheel_ros.api.compare import compare
from smallwheel_ros.cli import main
from smallwheel_ros.commands.command import described
from smallwheel_ros.common.result import Result
from smallwheel_ros.compare.comparison import Comparison
from smallwheel_ros.diagnosis.apply import Added
from smallwheel_ros.diagnosis.pipeline import Diagnosis
from smallwheel_ros.fitting import FitResult
from smallwheel_ros.prediction.prediction import PredictionTable
from smallwheel_ros.simulate import (
    DriveSettings,
    RigSettings,
    simulate_drive,
    simulate_rig,
    write_drive_bag,
    write_table,
)

OWN = """
from dataclasses import dataclass
from smallwheel_ros.effects import Effect, parameter

@dataclass(frozen=True)
class Sticky(Effect):
    id = "sticky"
    summary = "Soil that sticks to the wheel."
    formula = "R + drag"
    source = "this test"
    drag: float = parameter(1.0, (0.0, 9.0), "drag", unit="N")

    def added_resistance(self, state, conditions):
        return self.drag
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, repository: Path) -> Path:
    """A table in which slip sinkage is hidden, a short drive, and the rover that made it."""
    path = tmp_path_factory.mktemp("lab")
    settings = RigSettings(seed=3, hidden=("slip_sinkage",), runs=12)
    write_table(simulate_rig(settings).table, path / "rig.csv")
    drive = simulate_drive(DriveSettings(seed=5, distance=2.0, wheels="two_sizes"))
    write_drive_bag(drive, path / "drive")
    (path / "rover.yaml").write_bytes((repository / "config" / "two_wheel_sizes.yaml").read_bytes())
    (path / "own.py").write_text(OWN)
    return path


@dataclass(frozen=True)
class Results:
    """One of each."""

    fitted: FitResult
    compared: Comparison
    diagnosed: Diagnosis
    added: Added
    predicted: PredictionTable

    def __iter__(self) -> Iterator[Result]:
        return iter(vars(self).values())


@pytest.fixture(scope="module")
def results(folder: Path) -> Results:
    data = sw.read(folder / "rig.csv")
    fitted = sw.fit(data)
    return Results(
        fitted,
        sw.compare(data),
        sw.diagnose(data),
        sw.add("slip_sinkage", fitted, data),
        sw.predict(fitted, load="20:80:20", diameter=0.2, width=0.1, slip=0.2),
    )


def test_importing_loads_nothing_that_takes_long() -> None:
    code = "import smallwheel_ros, sys; print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout
    assert "smallwheel_ros" in loaded.split()
    assert not {"numpy", "scipy", "pandas", "click", "smallwheel_ros.arguments"} & set(
        loaded.split()
    )


def test_every_public_name_is_there_and_listed() -> None:
    assert {*sw.__all__} == {name for name in dir(sw) if name in sw.__all__}
    for name in sw.__all__:
        assert getattr(sw, name) is not None
    with pytest.raises(AttributeError, match="no attribute 'nonsense'"):
        _ = sw.nonsense


def test_functions_stay_functions_when_a_folder_of_their_name_is_imported() -> None:
    import smallwheel_ros.compare.comparison
    import smallwheel_ros.replay.replay  # noqa: F401

    assert sw.compare is compare
    assert callable(sw.replay)


@pytest.mark.parametrize("function", ["fit", "compare", "predict", "replay", "read"])
def test_the_examples_in_the_docstrings_hold(
    function: str, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    found = doctest.DocTestFinder().find(getattr(sw, function), function, globs={})
    assert any(test.examples for test in found)
    for test in found:
        assert doctest.DocTestRunner().run(test).failed == 0


def test_the_examples_on_the_page_hold(results: Results, repository: Path) -> None:
    text = (repository / "docs" / "python.md").read_text()
    space = {"sw": sw, "data": results.fitted.measurements, "fitted": results.fitted,
             "found": results.diagnosed, "added": results.added}  # fmt: skip
    test = doctest.DocTestParser().get_doctest(text, space, "python.md", "docs/python.md", 0)
    assert len(test.examples) >= 8
    kinds = doctest.ELLIPSIS | doctest.IGNORE_EXCEPTION_DETAIL
    assert doctest.DocTestRunner(optionflags=kinds).run(test).failed == 0


def test_the_table_of_functions_is_that_of_their_docstrings() -> None:
    page = PAGE.read_text(encoding="utf-8")
    assert page == with_table(page), "run python docs/function_table.py"


@pytest.mark.parametrize("name", ["fit", "compare", "diagnose", "learn", "add", "predict"])
def test_each_argument_of_a_function_is_an_option_with_its_text(name: str) -> None:
    words, texts = described(getattr(sw, name))
    signature = inspect.signature(getattr(sw, name))
    assert list(texts) == list(signature.parameters)
    command = main.get_command(click.Context(main), name)
    assert command is not None
    found = {option.name: option for option in command.params}
    assert set(texts) - set(found) == {"done", "progress"} & set(texts)  # what Python alone gives
    assert words in str(command.help)
    shown = str(command.help) + " ".join(str(getattr(o, "help", "")) for o in found.values())
    for parameter in set(texts) & set(found):
        assert texts[parameter].removesuffix(".") in shown, parameter


def test_the_examples_of_diagnose_and_add_hold(results: Results) -> None:
    """As their docstrings say of this table: those take longest, and their results are here."""
    assert (results.diagnosed.verdict, results.diagnosed.missing_effects) == (
        "missing_effect",
        ["slip_sinkage"],
    )
    assert "('missing_effect', ['slip_sinkage'])" in str(sw.diagnose.__doc__)
    assert results.added.recommended


def test_results_are_shown_short_and_whole(results: Results) -> None:
    for result in (*results, results.fitted.measurements):
        assert "array" not in repr(result)
        assert "\n" not in repr(result)
        assert len(repr(result)) < 250
        page = result._repr_html_()
        assert page.count("<table>") == page.count("</table>") == 1
        assert len(result.to_frame()) == len(result.rows()) > 0
        assert json.loads(json.dumps(result.to_dict(), allow_nan=False)) == result.to_dict()
        axes = pyplot.figure().subplots()
        assert result.plot(axes) is axes
        assert axes.has_data()
        pyplot.close("all")
    assert isinstance(results.diagnosed.plot(channel="resistance"), Axes)
    pyplot.close("all")


def test_a_channel_that_is_not_there_is_named_beside_those_that_are(
    results: Results, folder: Path
) -> None:
    drawn = (results.fitted, results.compared, results.diagnosed, results.added)
    for result in (*drawn, sw.read(folder / "rig.csv")):
        with pytest.raises(sw.Error, match=r"no column .foo. to draw: .*resistance, sinkage"):
            result.plot(channel="foo")
        assert isinstance(result.plot(channel="resistance"), Axes)
    pyplot.close("all")


def test_pages_escape_what_comes_from_a_file(folder: Path) -> None:
    table = pd.read_csv(folder / "rig.csv")
    table["soil"] = "<script>"
    table.to_csv(folder / "odd.csv", index=False)
    page = sw.fit(folder / "odd.csv")._repr_html_()
    assert "<script>" not in page
    assert "&lt;script&gt;" in page


@pytest.mark.parametrize(
    ("name", "arguments"),
    [
        ("fitted", ["fit", "rig.csv", "-o", "fit.yaml"]),
        ("compared", ["compare", "rig.csv"]),
        ("predicted", ["predict", "--model", "fitted.yaml", "--load", "20:80:20", "--diameter", "0.2",
                       "--width", "0.1", "--slip", "0.2"]),
    ],
)  # fmt: skip
def test_a_command_prints_the_result_of_its_function(
    name: str, arguments: list[str], results: Results, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    results.fitted.save("fitted.yaml")
    result = getattr(results, name)
    written = CliRunner().invoke(main, [*arguments, "--json", "found.json"])
    assert written.exit_code == 0, written.output
    said = str(result).replace(str(folder / "rig.csv"), "rig.csv")
    assert said in written.stdout
    document = json.loads(Path("found.json").read_text())
    ours = json.loads(json.dumps(result.to_dict()).replace(str(folder / "rig.csv"), "rig.csv"))
    assert document == ours


def test_results_are_saved_by_suffix(results: Results, folder: Path, tmp_path: Path) -> None:
    assert sw.Model.load(results.fitted.save(tmp_path / "m.yaml")).names == results.fitted.names
    assert [e.id for e in sw.Model.from_file(results.added.save(tmp_path / "a.yaml")).effects] == [
        "slip_sinkage"
    ]
    assert json.loads(results.compared.save(tmp_path / "c.json").read_text()) == (
        results.compared.to_dict()
    )
    assert len(pd.read_csv(results.predicted.save(tmp_path / "p.csv"))) == 4
    assert results.diagnosed.save(tmp_path / "d.svg").read_text().startswith("<?xml")
    with pytest.raises(sw.Error, match=r"cannot be saved as '\.doc': .*\.json"):
        results.fitted.save(tmp_path / "m.doc")


def test_a_model_is_composed_and_fitted(results: Results, folder: Path) -> None:
    by_class = sw.Model("dry_sand") + sw.effects.slip_sinkage
    assert by_class == sw.Model(sw.soil("dry_sand"), effects=["slip_sinkage"])
    again = sw.fit(folder / "rig.csv", model=results.fitted + sw.effects.slip_sinkage)
    assert {p.full_name for p in again.parameters} > {"slip_sinkage.a", "rig_soil.n"}
    assert next(p for p in again.parameters if p.name == "a").status == "determined"
    assert again.held_out["sinkage"] < 0.7 * results.fitted.held_out["sinkage"]
    named = sw.fit(folder / "rig.csv", "slip_sinkage/exponential")
    assert named.held_out["sinkage"] == pytest.approx(again.held_out["sinkage"], rel=0.05)


def test_effects_and_soils_are_listed_by_name_and_from_a_file(folder: Path) -> None:
    assert "slip_sinkage" in sw.effects
    assert sorted(sw.effects) == list(sw.effects)
    assert sw.effects["hardpan"] is sw.effects.hardpan is sw.effects.Hardpan
    assert sw.soil["dry_sand"] is sw.soil("dry_sand") is sw.soil.dry_sand
    assert not hasattr(sw.soil, "dry_sant")
    assert "wong_snow" in list(sw.soil)
    own = sw.effects.load(folder / "own.py")
    assert "sticky" in own
    assert "sticky" not in sw.effects
    model = sw.Model("dry_sand") + own["sticky"]
    alone = sw.predict("dry_sand", load=60, diameter=0.2, width=0.1).rows()[0]
    stuck = sw.predict(model, load=60, diameter=0.2, width=0.1).rows()[0]
    assert stuck["resistance"] == pytest.approx(alone["resistance"] + 1.0)
    model.save(folder / "sticky.yaml")
    with pytest.raises(sw.Error, match="no effect 'sticky'"):
        sw.Model.load(folder / "sticky.yaml")
    assert sw.Model.load(folder / "sticky.yaml", own) == sw.Model.load(folder / "sticky.yaml", own)
    assert sw.predict(folder / "sticky.yaml", load=60, diameter=0.2, width=0.1, effects=own)


def test_a_model_file_keeps_its_uncertainty(results: Results, tmp_path: Path) -> None:
    model = sw.Model.load(results.fitted.save(tmp_path / "m.yaml"))
    wheel = {"load": 60, "diameter": 0.2, "width": 0.1}
    known = sw.predict(model, **wheel).rows()[0]
    assert known == sw.predict(results.fitted, **wheel).rows()[0]
    assert known["sinkage_std"] > 0.0
    assert "sinkage_std" not in sw.predict(model.model, **wheel).rows()[0]


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (
            lambda: sw.predict("dry_sand", load=1, diameter=0.2, width=0.1, sliip=0.2),
            "setting: found 'sliip', which is nearly 'slip'",
        ),
        (lambda: sw.read(42), "data: found int, expected a file, a DataFrame"),
        (lambda: sw.fit("/nowhere.csv"), "/nowhere.csv: no such file"),
        (lambda: sw.fit(DATA, effects="slip_sinkag"), "did you mean 'slip_sinkage'"),
        (lambda: sw.fit(DATA, effects=[3]), "effects: found int, expected ids or classes"),
        (
            lambda: sw.fit(DATA, model="dry_sant"),
            "neither a file nor a soil: did you mean 'dry_sand'",
        ),
        (lambda: sw.fit(DATA, model="dry_sand", geometry="closed_form"), "expected one"),
        (lambda: sw.compare(DATA, 3), "models: found int"),
        (lambda: sw.compare(DATA, [3]), "model: found int, expected a Model"),
        (lambda: sw.diagnose(DATA, without="slip"), "no effect 'slip'"),
        (lambda: sw.diagnose(DATA, effects=3), "effects: found int, expected a Python file"),
        (lambda: sw.add("slip_sinkage"), "data: found nothing, expected the measurements"),
        (lambda: sw.add(3, data=DATA), "effect: found int, expected an effect's id or class"),
        (
            lambda: sw.read(sw.read(DATA), diameter=0.5),
            "diameter: found 0.5 for a table that was read",
        ),
        (lambda: sw.read(sw.read(DATA), map={"load": "F"}), "map: found {'load': 'F'} for a table"),
        (
            lambda: sw.predict("dry_sand", data=sw.read(DATA), width=0.2),
            "width: found 0.2 for a table",
        ),
        (
            lambda: sw.predict("dry_sand", data=sw.read(DATA), sheet="a"),
            "sheet: found 'a' for a table",
        ),
        (
            lambda: sw.predict("dry_sand", map={"load": "F"}, **WHEEL),
            "map: found {'load': 'F'} without",
        ),
        (
            lambda: sw.predict("dry_sand", sheet=2, **WHEEL),
            "sheet: found 2 without data: give the table",
        ),
        (
            lambda: sw.fit(SHEAR, effects="bulldozing"),
            "effects: found 'bulldozing' with shear tests alone",
        ),
        (
            lambda: sw.fit(SHEAR, geometry="closed_form"),
            "geometry: found 'closed_form' with shear tests",
        ),
        (lambda: sw.predict("dry_sand", load="x", diameter=1, width=1), "load: found 'x'"),
        (lambda: sw.predict("dry_sand", load=object(), diameter=1, width=1), "load: found <object"),
        (lambda: sw.predict("dry_sand", load=[], diameter=1, width=1), "load: found no value"),
        (lambda: sw.predict("dry_sand", load=np.nan, diameter=1, width=1), "load is nan"),
        (lambda: sw.soil("dry"), "no soil 'dry'"),
        (lambda: sw.Model(3), "soils: found int, expected a soil or its name"),
        (lambda: sw.Model("dry_sand") + 3, "found int, expected an effect"),
        (lambda: sw.replay("/nowhere", config="/nowhere.yaml"), "/nowhere"),
    ],
)
def test_a_bad_argument_is_an_error_in_words(
    call: object, words: str, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    with pytest.raises(sw.Error, match=r".*") as error:
        call()  # type: ignore[operator]
    assert words in str(error.value)


DATA = "rig.csv"
WHEEL = {"load": 40, "diameter": 0.2, "width": 0.1}
SHEAR = pd.DataFrame({
    "normal stress [kPa]": np.repeat([5.0, 10.0], 4), "shear displacement [mm]": [2.0, 5.0, 10.0, 30.0] * 2,
    "shear stress [kPa]": [1.2, 2.2, 2.9, 3.4, 2.2, 4.1, 5.5, 6.4], "run": np.repeat(["a", "b"], 4),
})  # fmt: skip


def test_the_command_refuses_what_it_would_not_use(tmp_path: Path) -> None:
    path = tmp_path / "shear.csv"
    SHEAR.to_csv(path, index=False)
    model = str(tmp_path / "m.yaml")
    said = CliRunner().invoke(main, ["fit", str(path), "--effects", "bulldozing", "-o", model])
    assert (said.exit_code, "bulldozing" in said.output) == (2, True), said.output
    assert not Path(model).exists()
    wheel = ["--load", "40", "--diameter", "0.2", "--width", "0.1"]
    said = CliRunner().invoke(main, ["predict", "--soil", "dry_sand", *wheel, "--map", "load=F"])
    assert (said.exit_code, "without data" in said.output) == (2, True), said.output


def test_without_pandas_a_table_says_what_to_do(
    results: Results, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(ImportError, match=r"pip install pandas; to_dict\(\)"):
        results.fitted.to_frame()


def test_a_replay_is_a_result(folder: Path) -> None:
    drive = sw.replay(folder / "drive", folder / "rover.yaml")
    assert drive.state == "complete"
    frame = drive.to_frame()
    assert len(frame) == drive.to_dict()["estimates"] > 0
    assert {row["wheel"] for row in drive.rows()} == set(frame["wheel"])
    assert str(drive).startswith(str(folder / "drive"))
    axes = pyplot.figure().subplots()
    assert drive.plot(axes, "soil_n") is axes
    with pytest.raises(sw.Error, match="no column 'soil_q'"):
        drive.plot(axes, "soil_q")
    pyplot.close("all")
    place = drive.spec.folder
    del drive
    assert not place.exists()


def test_a_fit_of_runs_that_differ_refers_to_the_diagnosis_which_does_not_refer_to_itself(
    tmp_path: Path,
) -> None:
    rows = simulate_rig(RigSettings(seed=3, runs=12)).table
    firmness = dict(zip(rows["run"].unique(), np.geomspace(0.3, 3.0, 12), strict=True))
    rows["sinkage [mm]"] /= rows["run"].map(firmness)
    write_table(rows, tmp_path / "mixed.csv")
    fitted = " ".join(sw.fit(tmp_path / "mixed.csv").notes)
    assert "more than those of one soil: name the soils (column soil)" in fitted
    assert "`smallwheel diagnose` looks for what is missing where runs differ so much" in fitted
    sw.diagnose(tmp_path / "mixed.csv").save(tmp_path / "diagnosis.html")
    page = (tmp_path / "diagnosis.html").read_text()
    assert "more than those of one soil" in page
    assert "smallwheel diagnose" not in page
