# SPDX-License-Identifier: Apache-2.0
"""A law that the library lacks: drafted where the data can tell, and refused where it cannot.

Tests `document.py`, `draft.py`, `grammar.py`, `law.py`, `search.py`, `tangent.py` and `verdict.py`.
"""

from __future__ import annotations

import hashlib
import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st

from rates.learn_worlds import table
from smallwheel_ros.api.learn import learn
from smallwheel_ros.cli import main
from smallwheel_ros.effects.drafted import Drafted, continued
from smallwheel_ros.effects.registry import load_effects
from smallwheel_ros.fitting import FittingError, Problem
from smallwheel_ros.fitting.parameters import part_of
from smallwheel_ros.learn.draft import Number, class_text, file_text
from smallwheel_ros.learn.grammar import (
    DEPTH,
    HINGE,
    SATURATION,
    Driver,
    Term,
    drivers_of,
    terms_of,
)
from smallwheel_ros.learn.law import PLACES, LearntLaw
from smallwheel_ros.learn.learning import LearnError, Learnt
from smallwheel_ros.learn.search import LawSearch, TermGrid
from smallwheel_ros.learn.verdict import SURE, chance
from smallwheel_ros.measurements.from_file import read_measurements
from smallwheel_ros.measurements.measurements import Measurements
from smallwheel_ros.model.model import Model, predict
from smallwheel_ros.model.model_file import write_model
from smallwheel_ros.onboard.parameters import settings_from
from smallwheel_ros.physics.conditions import Conditions

COLUMNS = ["run", "load [N]", "diameter [m]", "width [m]", "slip", "sinkage [m]", "resistance [N]"]


def rig(world: str, seed: int = 1, part: int = 0, runs: int = 24) -> pd.DataFrame:
    return table(world, seed, part, runs=runs)[COLUMNS]


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("learn") / "rig.csv"
    rig("tanh_slip").to_csv(path, index=False)
    return path


@pytest.fixture(scope="module")
def data(path: Path) -> Measurements:
    return read_measurements(path)


@pytest.fixture(scope="module")
def learnt(data: Measurements) -> Learnt:
    return learn(data, name="slip_law", can={"slip": [0.0, 0.3, 0.6]})


@pytest.fixture(scope="module")
def law(learnt: Learnt, tmp_path_factory: pytest.TempPathFactory) -> Path:
    assert learnt.source is not None
    path = tmp_path_factory.mktemp("law") / "law.py"
    path.write_text(learnt.source)
    return path


def test_a_hidden_law_is_drafted_with_its_stage_and_driver(learnt: Learnt) -> None:
    document = learnt.document
    assert document["verdict"] == "law"
    assert document["law"]["stage"] == "z"
    assert document["law"]["drivers"] == ["slip"]
    # Truth: z (1 + 0.5 tanh 4 i), so a factor of 1.48 from slip 0 to 0.5.
    x, factor = (np.array(document["shape"][k]) for k in ("x", "factor"))
    found = np.interp(0.5, x, factor) / np.interp(0.02, x, factor)
    assert found == pytest.approx((1 + 0.5 * np.tanh(2.0)) / (1 + 0.5 * np.tanh(0.08)), rel=0.06)
    for error in document["held_out"].values():
        assert error["after"] < 0.5 * error["before"]
        assert error["after"] < 1.5 * error["floor"]


TOP = {
    "schema", "verdict", "reasons", "data", "search", "held_out", "law", "places", "tied", "implied",
    "shape", "stage_disagreement", "measure_next", "file",
}  # fmt: skip
STAGES = {"k", "z", "z without resistance", "n", "D", "R"}


def test_the_document_has_what_was_promised(learnt: Learnt, path: Path) -> None:
    document = json.loads(json.dumps(learnt.to_dict(), allow_nan=False))
    assert set(document) >= TOP
    assert document["schema"] == 1
    assert document["reasons"] == []
    assert document["data"] == {
        "file": str(path), "sha256": hashlib.sha256(path.read_bytes()).hexdigest(),
        "rows": 72, "runs": 24, "settings": 24,
    }  # fmt: skip

    search = document["search"]
    assert set(search) >= {"formulas", "stages", "drivers", "p", "permutations", "folds"}
    assert search["formulas"] > 1000
    assert set(search["stages"]) == STAGES
    assert set(search["drivers"]) >= {"load", "diameter", "width", "slip", "sinkage/diameter"}
    assert search["p"] == 1 / 200
    assert (search["permutations"], search["folds"]) == (199, 8)

    assert set(document["held_out"]) == {"sinkage", "resistance"}
    for error in document["held_out"].values():
        assert set(error) == {"before", "after", "floor"}
        assert 0.0 < error["floor"] < error["before"]
        assert 0.0 < error["after"] < error["before"]

    law = document["law"]
    assert set(law) == {"id", "stage", "drivers", "formula", "constants", "range"}
    assert (law["id"], law["stage"], law["drivers"]) == ("slip_law", "z", ["slip"])
    slip = rig("tanh_slip")["slip"]
    assert law["range"]["slip"] == pytest.approx([slip.min(), slip.max()])
    for constant in law["constants"]:
        assert {"name", "value", "std", "unit"} <= set(constant)
        assert constant["low"] <= constant["value"] <= constant["high"]
        assert constant["std"] > 0.0
        assert f"{constant['value']:.3g}" in law["formula"]

    tied = document["tied"]
    assert all(set(t) == {"formula", "stage", "drivers", "nats"} for t in tied)
    assert law["formula"] in [t["formula"] for t in tied]
    assert [t["nats"] for t in tied] == sorted(t["nats"] for t in tied)
    assert (tied[0]["nats"], tied[-1]["nats"] < 3.0) == (0.0, True)
    assert {"stage": "z", "drivers": ["slip"]} in document["places"]

    assert len(document["implied"]) == 24
    for asked in document["implied"]:
        assert set(asked) == {"run", "x", "sinkage", "std", "resistance", "resistance_std"}
        assert asked["x"] == pytest.approx(slip[3 * (int(asked["run"][1:]) - 1)], rel=1e-4)
        assert asked["std"] > 0.0
    shape = document["shape"]
    assert set(shape) == {"x", "factor", "low", "high"}
    assert shape["x"] == sorted(shape["x"])
    low, factor, high = (np.array(shape[k]) for k in ("low", "factor", "high"))
    assert np.all((low <= factor) & (factor <= high))

    # The stage at which the law acts is the one on which the channels agree.
    disagree = document["stage_disagreement"]
    assert disagree["z"] < 3.0 < disagree["k"]
    assert set(disagree) <= STAGES
    assert document["measure_next"] is None or document["measure_next"]["text"]
    assert document["file"] is None  # nobody asked for one


def test_the_file_predicts_what_the_search_did(
    learnt: Learnt, law: Path, data: Measurements
) -> None:
    effect = load_effects(law)["slip_law"][0]()
    best = learnt.sought[0].best
    assert best is not None
    fitted = best.law.fit.model
    loaded = Model(fitted.soils, fitted.geometry, (effect,), fitted.thrust_form)
    ours, theirs = (predict(model, data.conditions) for model in (fitted, loaded))
    np.testing.assert_array_equal(theirs.sinkage, ours.sinkage)
    np.testing.assert_array_equal(theirs.resistance, ours.resistance)


def test_every_place_and_shape_is_written_as_it_is_searched(
    data: Measurements, tmp_path: Path
) -> None:
    points = Problem.of(data).judged.points
    depths = np.linspace(0.01, 0.03, len(points.conditions))
    drivers = [d for d in drivers_of(points, depths)[0] if d.name in ("load", "slip", DEPTH)]
    terms = {t.kind: t for t in terms_of(drivers, 24)}.values()
    assert {"step", "wave", "hinge", "optimum"} <= {s for t in terms for _, s in t.kind}
    simple = next(t for t in terms if t.kind == (("slip", "linear"),))
    depth = next(t for t in terms if t.of_depth and t.free)
    laws = [LearntLaw(place, link, (simple,)) for place in PLACES for link in place.links]
    laws += [LearntLaw(place, "exponential", (depth,)) for place in PLACES if place.stage == "R"]
    laws += [LearntLaw(PLACES[1], "linear", (t,)) for t in terms if t.factors and not t.of_depth]
    laws += [LearntLaw(PLACES[0], "exponential", (simple, laws[-1].terms[0]))]
    classes, effects = [], []
    for i, law in enumerate(laws):
        values = {n: 1e-3 if n[0] == "a" else law.terms[int(n[1]) - 1].constant for n in law.names}
        numbers = [Number(n, v, None, "1", (v - 1.0, v + 1.0)) for n, v in values.items()]
        classes.append(class_text(law, numbers, f"law_{i}", data, 24, 1, law.formula(values)))
        effects.append(law.effect(values))
    path = tmp_path / "laws.py"
    path.write_text(file_text(classes))
    written = load_effects(path)
    for i, effect in enumerate(effects):
        ours = predict(Model("dry_sand", effects=[effect]), data.conditions)
        theirs = predict(Model("dry_sand", effects=[written[f"law_{i}"][0]()]), data.conditions)
        np.testing.assert_allclose(theirs.sinkage, ours.sinkage, rtol=1e-12)
        np.testing.assert_allclose(theirs.resistance, ours.resistance, rtol=1e-12)


def test_beyond_its_range_a_law_says_so_and_goes_on_straight(law: Path) -> None:
    effect = load_effects(law)["slip_law"][0]()
    assert isinstance(effect, Drafted)
    inside = Conditions.of(load=60, diameter=0.2, width=0.1, slip=[0.1, 0.4])
    assert effect.caution(inside) == ""
    slip = np.array([0.8, 0.9, 1.0])
    beyond = Conditions.of(load=60, diameter=0.2, width=0.1, slip=slip)
    assert re.search(r"slip 1 \(learnt from 0\.\d+ to 0\.\d+\).*a guess", effect.caution(beyond))
    grown = np.asarray(effect.sinkage(np.ones(3), beyond))
    assert grown[2] > grown[0]
    assert np.diff(np.log(grown)) == pytest.approx([np.diff(np.log(grown))[0]] * 2, rel=1e-6)


@given(
    u=st.lists(st.floats(-50, 50), min_size=1, max_size=6),
    low=st.floats(-5, 5),
    span=st.floats(0.1, 10),
)
def test_a_shape_is_itself_inside_and_straight_outside(
    u: list[float], low: float, span: float
) -> None:
    x, high = np.array(u), low + span
    found = continued(np.sinh, x, low, high)
    inside = (x >= low) & (x <= high)
    np.testing.assert_array_equal(found[inside], np.sinh(x[inside]))
    edge = np.clip(x, low, high)
    tangent = np.sinh(edge) + np.cosh(edge) * (x - edge)
    size = np.cosh(max(abs(low), abs(high))) * (1.0 + np.abs(x - edge))
    assert np.all(np.abs(found - tangent) <= 1e-3 * span * size + 1e-9)


def test_nothing_hidden_is_said_to_be_nothing(tmp_path: Path) -> None:
    path = tmp_path / "plain.csv"
    rig("nothing", seed=3).to_csv(path, index=False)
    result = learn(read_measurements(path))
    assert result.verdict == "nothing"
    assert result.source is None
    assert result.document["law"] is None
    assert result.document["search"]["p"] > SURE


def _few(frame: pd.DataFrame) -> pd.DataFrame:
    return frame[frame["run"].isin(sorted(set(frame["run"]))[:8])]


def _one_setting(frame: pd.DataFrame) -> pd.DataFrame:
    return frame.assign(**{c: frame[c].iloc[0] for c in COLUMNS[1:5]})


def _two_values(frame: pd.DataFrame) -> pd.DataFrame:
    """Twelve settings of the columns together, and each column with two values."""
    code = np.arange(len(frame)) // 3
    bits = [(code >> i) % 2 for i in range(4)]
    values = [(40.0, 90.0), (0.15, 0.3), (0.05, 0.1), (0.1, 0.4)]
    pairs = zip(COLUMNS[1:5], bits, values, strict=True)
    return frame.assign(**{c: np.where(bit, v[1], v[0]) for c, bit, v in pairs})


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (_few, "8 settings, and a law needs 10"),
        (_one_setting, "every run has the same setting"),
        (_two_values, "slip has 2 values"),
    ],
)  # fmt: skip
def test_too_little_is_refused_with_the_reason(change: object, said: str, tmp_path: Path) -> None:
    path, out = tmp_path / "rig.csv", tmp_path / "law.py"
    change(rig("tanh_slip")).to_csv(path, index=False)  # type: ignore[operator]
    arguments = ["learn", str(path), "-o", str(out), "--json", str(tmp_path / "r.json")]
    result = CliRunner().invoke(main, arguments)
    assert result.exit_code == 0, result.output
    document = json.loads((tmp_path / "r.json").read_text())
    assert document["verdict"] == "refused"
    assert any(said in reason for reason in document["reasons"])
    assert not out.exists()


def test_columns_that_no_law_can_follow_are_said(tmp_path: Path) -> None:
    frame = rig("nothing", seed=3).assign(operator="Anna", rain=1.5)
    frame["shift"] = np.arange(len(frame)) % 6 // 3
    path = tmp_path / "rig.csv"
    frame.to_csv(path, index=False)
    points = Problem.of(read_measurements(path)).judged.points
    drivers, _ = drivers_of(points, np.full(len(points.conditions), 0.02))
    assert not {d.name for d in drivers} & {"operator", "rain"}
    # Two values are in the search, so that what follows them is not laid at another's door.
    terms = [t for t in terms_of(drivers, 24) if "shift" in t.drivers]
    assert [t.kind for t in terms] == [(("shift", "linear"),)]


@pytest.mark.slow
def test_what_follows_a_column_of_two_values_is_no_law(tmp_path: Path) -> None:
    frame = rig("nothing", seed=3)
    frame["shift"] = np.arange(len(frame)) // 3 % 2
    frame["sinkage [m]"] *= 1.0 + 0.4 * frame["shift"]
    path = tmp_path / "rig.csv"
    frame.to_csv(path, index=False)
    found = learn(read_measurements(path)).document
    assert found["verdict"] == "refused"
    assert "follows shift; shift has 2 values: a law needs 3 or more" in found["reasons"][0]
    assert found["law"] is None


@pytest.mark.slow
def test_a_column_with_blanks_may_be_what_is_missing(tmp_path: Path) -> None:
    frame = table("moisture_optimum", 2, runs=24)[[*COLUMNS, "moisture"]]
    frame.loc[4, "moisture"] = np.nan
    path = tmp_path / "rig.csv"
    frame.to_csv(path, index=False)
    assert learn(read_measurements(path)).verdict in ("refused", "nothing")


def test_runs_are_permuted_whole(data: Measurements) -> None:
    """Points of one run share its errors: without that, a run's own offset would pass for a law."""
    problem = Problem.of(data).judged
    sought = LawSearch(problem.fitter, problem.fit, _small_grid(problem))
    assert chance(sought, 19, np.random.default_rng(0)) == 1 / 20


def _small_grid(problem: Problem) -> TermGrid:
    """What follows slip."""
    grid = TermGrid.of(problem.points, problem.fit.model)
    own = [i for i, term in enumerate(grid.terms) if term.drivers == {"slip"}]
    return replace(grid, terms=tuple(grid.terms[i] for i in own), values=grid.values[:, own])


@pytest.mark.slow
def test_where_it_was_learnt_a_law_has_no_p(law: Path, path: Path, tmp_path: Path) -> None:
    def diagnosed(table: Path) -> dict[str, object]:
        out = tmp_path / "diagnosis.json"
        arguments = ["diagnose", str(table), "--effects", str(law), "--json", str(out)]
        result = CliRunner().invoke(main, [*arguments, "--without", "slip_sinkage"])
        assert result.exit_code == 0, result.output
        return dict(json.loads(out.read_text()))

    here = diagnosed(path)
    row = next(r for r in here["ranking"] if r["effect"] == "slip_law")  # type: ignore[attr-defined]
    assert here["missing_effects"] == ["slip_law"]
    assert row["p_value"] is None
    assert "learnt from this data" in row["reason"]
    assert here["lack_of_fit"]["p_value"] is None  # type: ignore[index]
    fresh = tmp_path / "fresh.csv"
    rig("tanh_slip", part=1).to_csv(fresh, index=False)
    there = diagnosed(fresh)
    row = next(r for r in there["ranking"] if r["effect"] == "slip_law")  # type: ignore[attr-defined]
    assert there["missing_effects"] == ["slip_law"]
    assert row["p_value"] < 0.05


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("version = 1", "version = 7", "a file of version 7, expected 1: learn it again"),
        ("version = 1\n", "\n", "a file of version 0, expected 1"),
        ("valid = {'slip'", "valid = {'slip': 3, 'load'", "expected a lowest and a highest value"),
        ("parameter(0.", "parameter(-90.", "expected"),
        ("return sinkage", "return sink age", "line"),
        ("parameter(0.", "parameter('much', 0.", "line"),
    ],
)
def test_a_law_file_that_is_nonsense_says_so_in_one_message(
    old: str, new: str, said: str, law: Path, tmp_path: Path
) -> None:
    broken = tmp_path / "broken.py"
    text = law.read_text()
    assert old in text
    broken.write_text(text.replace(old, new, 1))
    result = CliRunner().invoke(main, ["effects", "--effects", str(broken)])
    assert result.exit_code == 2
    assert len(re.findall("^Error: ", result.stderr, re.MULTILINE)) == 1
    assert said in result.stderr
    assert str(broken) in result.stderr
    assert "Traceback" not in result.output


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("return sinkage *", "return None and sinkage *", "slip_law': sinkage gave NoneType"),
        ("return sinkage *", "return sinkage[:0] *", "slip_law"),
        ('conditions["slip"]', 'conditions["slipp"]', "no column 'slipp'"),
        ("return sinkage *", "return sinkage / 0.0 *",
         "row 1 of 1 (load 60, diameter 0.2, width 0.1, slip 0.3): effect 'slip_law' gives no finite"),
        ('conditions["slip"]', 'np.sqrt(0.2 - conditions["slip"])',
         "row 1 of 1 (load 60, diameter 0.2, width 0.1, slip 0.3): effect 'slip_law' gives no finite"),
    ],
)  # fmt: skip
def test_a_law_file_that_cannot_be_computed_names_itself(
    old: str, new: str, said: str, law: Path, tmp_path: Path
) -> None:
    broken, model = tmp_path / "broken.py", tmp_path / "model.yaml"
    loaded = load_effects(law)["slip_law"][0]()
    write_model(model, Model("dry_sand", effects=[loaded]))
    assert old in law.read_text()
    broken.write_text(law.read_text().replace(old, new, 1))
    wheel = ["--load", "60", "--diameter", "0.2", "--width", "0.1", "--slip", "0.3"]
    arguments = ["predict", *wheel, "--model", str(model), "--effects", str(broken), "--json", "-"]
    result = CliRunner().invoke(main, arguments)
    assert result.exit_code == 2, result.output
    assert said in result.stderr
    assert "Traceback" not in result.output


def test_a_fit_of_a_law_that_gives_no_number_names_law_and_setting(
    law: Path, data: Measurements, tmp_path: Path
) -> None:
    broken = tmp_path / "broken.py"
    formula = 'np.sqrt(0.2 - conditions["slip"])'
    broken.write_text(law.read_text().replace('conditions["slip"]', formula, 1))
    problem = Problem.of(data).judged
    part = part_of(load_effects(broken)["slip_law"][0]())
    said = r"the model with slip_law gives no finite \w+ at load .*, slip 0\.[2-9]"
    with pytest.raises(FittingError, match=said):
        problem.fitter.at(replace(problem.fit.vector, parts=(part,)))


@pytest.mark.parametrize(
    ("name", "said"), [("Slip Law", "small letters"), ("slip_sinkage", "exists already")]
)
def test_a_name_that_is_none_is_refused(name: str, said: str, data: Measurements) -> None:
    with pytest.raises(LearnError, match=said):
        learn(data, name=name)


HOSTILE = """x"]); raise SystemExit('no'); ("""


def test_a_column_of_any_name_makes_no_code(data: Measurements, tmp_path: Path) -> None:
    """A drafted file is run by whoever loads it, and a table's header may come from anybody."""
    name = HOSTILE + '\n\\ """ diameter'
    column = np.linspace(1.0, 2.0, len(data))
    conditions = replace(data.conditions, covariates={**data.conditions.covariates, name: column})
    hostile = replace(data, conditions=conditions, source=f"{name}.csv")
    points = Problem.of(hostile).judged.points
    drivers, _ = drivers_of(points, np.full(len(points.conditions), 0.02))
    driver = next(d for d in drivers if d.name == name)
    law = LearntLaw(PLACES[0], "exponential", (Term(((driver, SATURATION),), 0.5),))
    numbers = [
        Number("a1", 0.2, 0.1, "1", (0.0, 1.0)),
        Number("c1", 0.5, 0.1, "1", (0.1, 1.0)),
    ]
    path = tmp_path / "law.py"
    path.write_text(file_text([class_text(law, numbers, "odd", hostile, 24, 3, name)]))
    for tied, words in (
        (1, "no other formula fits"),
        (2, "1 other formula fits"),
        (3, "2 other formulas fit"),
    ):
        assert f"24 settings; {words} as well" in class_text(
            law, numbers, "odd", hostile, 24, tied, name
        )
    effect = load_effects(path)["odd"][0]()
    assert effect.needs == (name,)
    expected = np.exp(0.2 * np.tanh(column / 0.5))
    np.testing.assert_allclose(effect.modulus_factor(conditions), expected, rtol=1e-4)


@pytest.mark.slow
def test_from_a_table_to_a_model_that_predicts_and_that_the_node_reads(
    path: Path, law: Path, tmp_path: Path
) -> None:
    def run(*arguments: str | Path) -> str:
        result = CliRunner().invoke(main, [str(a) for a in arguments])
        assert result.exit_code == 0, result.output
        return result.output

    base, better = tmp_path / "base.yaml", tmp_path / "better.yaml"
    run("fit", path, "-o", base)
    said = run("add", "slip_law", "--model", base, "--data", path, "--effects", law, "-o", better)
    assert "learnt from this very data" in said
    wheel = ("--load", "60", "--diameter", "0.2", "--width", "0.1", "--model", better)
    inside = run("predict", *wheel, "--effects", law, "--slip", "0.3")
    beyond = run("predict", *wheel, "--effects", law, "--slip", "0.9")
    assert "a guess" not in inside
    assert "slip_law is used beyond where it was learnt: slip 0.9" in beyond
    wheels = {"wheels": ["front"], "front.diameter": 0.2, "front.width": 0.1}
    node = settings_from(wheels | {"model_file": str(better), "effects_file": str(law)})
    assert [effect.id for effect in node.onboard.effects] == ["slip_law"]


@pytest.mark.slow
def test_the_same_seed_gives_the_same_bytes(data: Measurements, learnt: Learnt) -> None:
    again = learn(data, name="slip_law", can={"slip": [0.0, 0.3, 0.6]})
    assert again.source == learnt.source
    assert json.dumps(again.document) == json.dumps(learnt.document)


@pytest.mark.slow
def test_from_forty_settings_on_some_are_kept_apart(tmp_path: Path) -> None:
    path = tmp_path / "rig.csv"
    rig("tanh_slip", seed=5, runs=48).drop(columns="resistance [N]").to_csv(path, index=False)
    result = learn(read_measurements(path))
    assert result.verdict == "law"
    assert result.document["law"]["drivers"] == ["slip"]
    assert result.document["search"]["vault_settings"] == 9
    assert result.document["held_out"]["sinkage"]["after"] < 2e-3


def test_along_curves_of_slip_the_soil_is_found_and_each_run_is_one_piece_of_evidence(
    tmp_path: Path,
) -> None:
    """A model that predicts nothing is off by all of each value: no run's own error may excuse that."""
    path = tmp_path / "curves.csv"
    table("slip_drag", 900, runs=14, rows=12, within="curve").to_csv(path, index=False)
    problem = Problem.of(read_measurements(path)).judged
    depths = problem.points.of_channel("sinkage")
    measured, predicted = problem.points.value[depths], problem.fit.predicted[depths]
    assert np.sqrt(np.mean(np.log(predicted / measured) ** 2)) < 0.2
    # Fourteen values of a column follow nothing, though each is there for twelve slips.
    followed = {d.name for d in TermGrid.of(problem.points, problem.fit.model).drivers}
    assert followed >= {"load", "slip", "speed", "moisture", "temperature", "battery"}


@given(low=st.floats(1e-6, 1e9), share=st.floats(0.0, 0.6))
def test_the_reference_of_a_driver_far_from_zero_is_never_over_its_lowest_value(
    low: float, share: float
) -> None:
    driver = Driver("air", ("air",), "air", 'conditions["air"]', "Pa")
    values = low * (1.0 + share * np.array([0.0, 0.3, 1.0]))
    measured = driver.measured_at(values)
    assert 0.0 <= measured.low <= 0.1 * np.ptp(values) + 1e-9 * low
    assert measured.reference + measured.high == pytest.approx(values.max(), rel=1e-12)


def test_a_reference_reads_as_a_round_number() -> None:
    air = Driver("air", ("air",), "air", 'conditions["air"]', "Pa")
    measured = air.measured_at(np.array([101723.0, 102950.0]))
    assert measured.text == "(air - 101700)"
    assert Term(((measured, HINGE),), 512.3).text(512.3) == HINGE.text.format(u="air", c="102210")


def test_only_a_slip_of_either_sign_has_shapes_of_one_side(data: Measurements) -> None:
    points = Problem.of(data).judged.points
    depths = np.full(len(points.conditions), 0.02)
    slip = next(d for d in drivers_of(points, depths)[0] if d.name == "slip")
    assert {t.side for t in terms_of([slip], 24)} == {0}
    both = slip.measured_at(np.linspace(-0.6, 0.6, 24))
    sided = [t for t in terms_of([both], 24) if t.side]
    assert {shape for t in sided for _, shape in t.kind} == {
        "positive", "positive_square", "positive_saturation",
        "negative", "negative_square", "negative_saturation",
    }  # fmt: skip
    u = np.linspace(-0.6, 0.6, 24)
    for term in sided:
        values = term.of(lambda driver: u)
        assert np.all(values[u * term.side <= 0] == 0)
        assert np.all(values[u * term.side > 0] > 0)


@pytest.mark.slow
def test_a_wheel_that_drives_and_brakes_digs_by_two_terms(tmp_path: Path) -> None:
    path = tmp_path / "rig.csv"
    table("drive_and_brake", 910).to_csv(path, index=False)
    law = learn(read_measurements(path)).document["law"]
    assert law is not None
    assert (law["stage"], law["drivers"]) == ("z", ["slip"])
    assert "max(slip, 0)" in law["formula"]
    assert "max(-slip, 0)" in law["formula"]
