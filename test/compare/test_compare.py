# SPDX-License-Identifier: Apache-2.0
"""Tests `comparison.py`, `contenders.py`, `reasons.py`, `resistance_ratio.py` and `shown.py`."""

from __future__ import annotations

import json
import os
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from numpy.typing import NDArray
from scipy.optimize import least_squares

from smallwheel_ros import fit
from smallwheel_ros.api.diagnose import diagnose
from smallwheel_ros.compare.comparison import Comparison, comparison_of
from smallwheel_ros.compare.contenders import Contender, contenders_of
from smallwheel_ros.compare.shown import comparison_document
from smallwheel_ros.effects.registry import default_registry, effect
from smallwheel_ros.effects.slip import Exponential
from smallwheel_ros.fitting import Base, FittingError, Problem
from smallwheel_ros.fitting.held_out import folds_of, in_sample
from smallwheel_ros.fitting.parameters import ParameterVector
from smallwheel_ros.fitting.points import Points
from smallwheel_ros.measurements.display import words
from smallwheel_ros.measurements.from_file import read_measurements
from smallwheel_ros.measurements.measurements import Measurements
from smallwheel_ros.model.model import CalibratedModel, Model, predict
from smallwheel_ros.physics.conditions import Conditions
from smallwheel_ros.physics.soil import Soil
from smallwheel_ros.simulate import RigSettings, simulate_rig, write_table

SHARED = Path(os.environ.get("SMALLWHEEL_SHARED", Path(__file__).parents[3] / "shared"))
RIG = SHARED / "data" / "cmu_wheel_rig"
EXAMPLES = Path(__file__).parents[2] / "examples" / "data"

SAND = Soil("sand", 1.6e6, 0.8, 0.4)


def table(rows: int = 12, **more: object) -> Measurements:
    """Rows on which SAND without effects is exactly right."""
    rng = np.random.default_rng(4)
    run = np.repeat(np.arange(-(-rows // 2)), 2)[:rows]
    conditions = Conditions.of(
        rng.uniform(20, 90, run.max() + 1)[run],
        rng.choice([0.15, 0.3], run.max() + 1)[run],
        0.1,
        slip=rng.uniform(0, 0.5, run.max() + 1)[run],
    )
    exact = predict(Model(SAND), conditions)
    given: dict[str, object] = {
        "conditions": conditions,
        "channels": {"sinkage": exact.sinkage, "resistance": exact.resistance},
        "run": np.char.add("r", run.astype(np.str_)),
        "wheel": np.full(rows, "wheel"),
        "line": np.arange(2, rows + 2),
        "source": "made.csv",
        "sha256": "abc",
    }
    return Measurements(**{**given, **more})  # type: ignore[arg-type]


def standing(*contenders: Contender | Model, data: Measurements | None = None) -> Comparison:
    """Compare only these."""
    named = [
        c if isinstance(c, Contender) else Contender(f"model {i}", "as it stands", c)
        for i, c in enumerate(contenders)
    ]
    return comparison_of(data or table(), named, standard=False)


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> Measurements:
    rig = simulate_rig(RigSettings(seed=11, runs=16, rows_per_run=3))
    path = tmp_path_factory.mktemp("rig") / "rig.csv"
    write_table(rig.table, path)
    return read_measurements(path)


@pytest.fixture(scope="module")
def comparison(simulated: Measurements) -> Comparison:
    return comparison_of(simulated)


def test_a_model_that_is_right_has_no_error() -> None:
    found = standing(Model(SAND))
    for channel in ("sinkage", "resistance"):
        score = found.score(found.models[0], channel)
        assert score is not None
        assert score.rmse < 1e-12
        assert (score.rows, score.runs) == (12, 6)


def test_bias_is_positive_where_the_model_predicts_too_little() -> None:
    stiff = Model(Soil("sand", 2 * SAND.k, SAND.n, SAND.m))
    found = standing(stiff)
    score = found.score(found.models[0], "sinkage")
    assert score is not None
    measured = found.measurements.channels["sinkage"]
    predicted = predict(stiff, found.measurements.conditions).sinkage
    assert score.bias == pytest.approx(np.mean(measured - predicted))
    assert score.bias > 0
    assert score.rmse == pytest.approx(np.sqrt(np.mean((measured - predicted) ** 2)))


def test_no_run_is_predicted_by_a_model_that_saw_it() -> None:
    data = table(22)
    seen: list[set[int]] = []

    class Spy(Base):
        def vector(self, points: Points) -> ParameterVector:
            seen.append(set(points.run.tolist()))
            return super().vector(points)

    found = comparison_of(data, [Contender("spy", "", Spy())], standard=False)
    everything, *folds = seen
    assert everything == set(range(11))
    assert len(folds) == found.folds
    left_out = [everything - trained for trained in folds]
    assert sorted(run for runs in left_out for run in runs) == sorted(everything)  # each once
    # the folds are those of every other command
    fold = folds_of(Problem.of(data).points)
    assert left_out == [set(np.flatnonzero(fold == i).tolist()) for i in range(found.folds)]


def test_progress_counts_every_fit() -> None:
    told: list[tuple[int, int]] = []
    fitted = Contender("a", "", Base())
    found = comparison_of(
        table(22),
        [fitted, Contender("b", "", Model(SAND))],
        standard=False,
        progress=lambda done, needed: told.append((done, needed)),
    )
    assert told == [(done, 1 + found.folds) for done in range(2 + found.folds)]


def test_held_out_errors_are_those_of_a_diagnosis(simulated: Measurements) -> None:
    """One definition: the base of a diagnosis leaves the error that the comparison says."""
    found = comparison_of(simulated)
    score = found.score(found.models[-1], "sinkage", held_out=True)
    assert score is not None
    base = diagnose(simulated).document["steps"][0]
    assert score.rmse == pytest.approx(base["held_out_rmse"]["sinkage"], rel=1e-5)


def test_the_truth_without_hidden_effect_is_met_nearly_as_well_as_rows_repeat(
    comparison: Comparison,
) -> None:
    """The simulated truth shares no code with the models; runs differ by more than repeats do."""
    exact = comparison.models[-1]
    assert exact.contender.name == "contact_integral"
    for channel in ("sinkage", "resistance"):
        score = comparison.score(exact, channel, held_out=True)
        floor = comparison.noise[channel]
        assert score is not None
        assert floor.value is None  # for a diagnosis to say
        assert floor.repeatability is not None
        assert 0.5 * floor.repeatability < score.rmse < 3.0 * floor.repeatability


def test_bekker_has_no_diameter_and_splits_the_modulus_over_widths(comparison: Comparison) -> None:
    bekker = comparison.models[2]
    assert bekker.contender.name == "bekker"
    assert bekker.model.soils[0].m == 0.0
    assert bekker.model.geometry == "closed_form"
    assert [effect.id for effect in bekker.model.effects] == ["width_dependent_modulus"]
    assert "kc and kphi of K" in bekker.contender.description
    paper = comparison.models[3]
    assert paper.contender.name == "meirion_griffith_spenko"
    assert paper.model.geometry == "closed_form"
    assert abs(paper.model.soils[0].m) > 1e-3


def test_with_one_width_and_diameter_the_description_says_what_is_determined() -> None:
    rng = np.random.default_rng(2)
    conditions = Conditions.of(rng.uniform(20, 90, 8), 0.2, 0.1)
    exact = predict(Model(SAND), conditions)
    data = table(8, conditions=conditions, channels={"sinkage": exact.sinkage})
    found = comparison_of(data)
    assert "not kc and kphi" in found.models[2].contender.description
    assert "not m" in found.models[3].contender.description
    assert found.models[2].model is not None
    assert not found.models[2].model.effects


# What cannot be predicted is said and counted, and never a NaN


def document_of(found: Comparison) -> dict:
    return json.loads(json.dumps(comparison_document(found), allow_nan=False))


def test_rows_in_which_the_model_sinks_to_the_axle_are_said_and_count() -> None:
    """A model is not better for having no number where it fails."""
    soft = Model(Soil("mud", 3e4, 0.8, 0.4))
    data = table()
    sunk = predict(soft, data.conditions).immobilised
    assert 0 < sunk.sum() < 12
    found = standing(soft, data=data)
    score = found.score(found.models[0], "sinkage")
    assert score is not None
    assert score.rows == 12
    assert f"sinks to the axle in {sunk.sum()} rows" in found.text()


def test_a_model_whose_column_is_missing_predicts_nothing_and_says_so() -> None:
    data = table()
    plain = Measurements(
        Conditions(data.conditions.load, data.conditions.diameter, data.conditions.width,
                   data.conditions.contact),
        data.channels, data.run, data.wheel, data.line,
    )  # fmt: skip
    found = standing(Model(SAND) + Exponential(), Model(SAND), data=plain)
    assert found.score(found.models[0], "sinkage") is None
    (why, rows), *_ = found.models[0].not_predicted
    assert "effect 'slip_sinkage' needs the column 'slip'. The columns are load" in why
    assert rows.size == 12
    assert "12 rows not predicted" in found.text()
    assert found.score(found.models[1], "sinkage") is not None
    scores = document_of(found)["models"][0]["channels"]["sinkage"]
    assert scores == {"in_sample": None, "held_out": None}


def test_bodies_that_do_not_roll_have_no_resistance_to_predict() -> None:
    conditions = Conditions.of(
        [30.0, 40.0, 50.0, 60.0], 0.2, 0.1, contact=["rolling", "pressed", "plate", "rolling"]
    )
    values = {"sinkage": np.full(4, 0.01), "resistance": np.array([5.0, 5.0, 5.0, np.nan])}
    run = np.array(["a", "b", "c", "d"])
    found = standing(Model(SAND), data=table(4, conditions=conditions, channels=values, run=run))
    score = found.score(found.models[0], "resistance")
    assert score is not None
    assert score.rows == 1
    assert "resistance of rows that do not roll is not used: no model predicts it" in found.notes


@pytest.mark.parametrize("channel", ["drawbar_pull", "torque"])
def test_what_needs_slip_is_said_to_where_there_is_none(channel: str) -> None:
    """In the text of every command, with the line: nobody should think that it was used."""
    load = np.linspace(30.0, 80.0, 8)
    conditions = Conditions.of(load, 0.2, 0.1)
    values = {
        "sinkage": predict(Model(SAND), conditions).sinkage,
        channel: np.r_[np.nan, np.full(7, 2.0)],
    }
    run = np.array([f"r{i}" for i in range(8)])
    data = table(8, conditions=conditions, channels=values, run=run)
    found = standing(Model(SAND), data=data)
    assert channel not in found.channels
    for text in (
        found.text(),
        comparison_of(data).text(),
        diagnose(data).text(),
        fit(data).text(),
    ):
        said = f"{channel} (from line 3) is not used: the table has no slip, which it needs"
        assert said in text.lower()


def test_a_soil_that_the_model_does_not_have_is_reported() -> None:
    data = table()
    soil = np.where(np.arange(12) < 4, "loam", "sand")
    conditions = Conditions(data.conditions.load, data.conditions.diameter, data.conditions.width,
                            data.conditions.contact, soil, data.conditions.covariates)  # fmt: skip
    model = Model([SAND, Soil("snow", 2e5, 1.6)])
    found = standing(model, data=table(12, conditions=conditions))
    (why, rows), *_ = found.models[0].not_predicted
    assert why == "the model has no soil 'loam'"
    assert rows.tolist() == [0, 1, 2, 3]


def test_rows_without_a_soil_are_no_rows_of_a_model_of_several() -> None:
    found = standing(Model([SAND, Soil("snow", 2e5, 1.6)]))
    (why, rows), *_ = found.models[0].not_predicted
    assert why == "the rows name no soil, expected one of sand, snow"
    assert rows.size == 12
    assert found.channels == ()
    assert "No model could predict" in found.text()


def test_wheels_measured_below_their_axle_are_left_out_with_their_lines() -> None:
    data = table()
    data.channels["sinkage"][3] = 0.9 * data.conditions.diameter[3]  # type: ignore[index]
    found = standing(Model(SAND), data=data)
    score = found.score(found.models[0], "sinkage")
    assert score is not None
    assert score.rows == 11
    (why, lines), = found.left_out  # fmt: skip
    assert "deeper than its axle" in why
    assert lines.tolist() == [5]
    document = document_of(found)["data"]
    assert document["rows"] == 12
    assert document["left_out"][0]["lines"] == [5]
    assert found.text().count("deeper than its axle") == 1


def test_no_row_to_compare_is_an_error_that_says_what_to_measure() -> None:
    data = table()
    data.channels["sinkage"][:] = data.conditions.diameter  # type: ignore[index]
    data.channels["resistance"][:] = np.nan  # type: ignore[index]
    with pytest.raises(FittingError, match=r"made.csv: no row has a usable sinkage"):
        standing(Model(SAND), data=data)


def test_one_run_holds_nothing_out_and_says_so() -> None:
    data = table(12)
    found = comparison_of(replace(data, run=np.full(12, "only")))
    assert found.folds == 0
    assert all(m.held_out is None for m in found.models)
    assert any("nothing can be held out" in note for note in found.notes)
    document = document_of(found)
    assert document["models"][0]["channels"]["sinkage"]["held_out"] is None
    assert found.best("sinkage") is not None  # of the errors in sample


def test_without_repeats_no_noise_floor_is_known() -> None:
    found = comparison_of(table(8, run=np.array([f"r{i}" for i in range(8)])))
    floor = found.noise["sinkage"]
    assert (floor.value, floor.source, floor.repeatability) == (None, None, None)
    assert "repeat a few runs, or state sinkage_std" in floor.reason
    assert "repeatability unknown" in found.text()


def test_each_of_several_soils_is_fitted_and_one_with_a_single_run_is_told_of() -> None:
    data = table(24)
    soil = np.where(data.run == "r3", "loam", np.where(data.conditions.load > 50, "clay", "sand"))
    conditions = replace(data.conditions, soil=soil)
    found = comparison_of(table(24, conditions=conditions))
    assert [s.name for s in found.models[-1].model.soils] == ["clay", "loam", "sand"]
    assert {part.label for part in found.parts if part.by == "soil"} == {"clay", "loam", "sand"}
    (note,) = [note for note in found.notes if "nothing is known of that soil" in note]
    assert note.startswith("soil 'loam' has one run")


@pytest.mark.parametrize(
    ("fitted_to", "words", "unseen"),
    [
        ("abc", "this very file", False),
        ("def", "another file", True),
        ("", "is unknown", False),
    ],
)
def test_a_standing_model_says_whether_it_saw_the_data(
    fitted_to: str, words: str, unseen: bool
) -> None:
    """Only a model that did not see the data is held against others that did not."""
    found = standing(Contender("m", "", Model(SAND), "m.yaml", fitted_to))
    assert words in found.models[0].notes[0]
    assert found.models[0].held_out is None
    assert (found.models[0].unseen is not None) == unseen


def test_a_model_with_rivals_is_compared_as_their_mean(simulated: Measurements) -> None:
    parts = [CalibratedModel(Model(SAND) + effect("slip_sinkage", a=a)) for a in (0.5, 1.5)]
    both = CalibratedModel(Model(SAND), rivals=tuple((0.5, one) for one in parts))
    (contender,) = contenders_of({"both": both}, default_registry())
    assert "the mean of models that its data could not tell apart: slip sinkage" in (
        contender.description
    )
    assert isinstance(contender.model, Model)
    said = [predict(one, simulated.conditions).sinkage for one in (*parts, contender.model)]
    assert said[2] == pytest.approx(0.5 * (said[0] + said[1]), rel=0.01)


def test_a_model_that_saw_the_data_is_not_held_against_others(
    simulated: Measurements, comparison: Comparison
) -> None:
    fitted = comparison.models[-1].model
    own = [
        Contender("same", "", fitted, "same.yaml", simulated.sha256),
        Contender("other", "", fitted, "other.yaml", "of another file"),
    ]
    found = comparison_of(simulated, own)
    best = found.best("sinkage")
    assert best is not None
    judged = {best.contender.name, *found.differences("sinkage")}
    assert judged == {
        "constant",
        "log_log_regression",
        "bekker",
        "meirion_griffith_spenko",
        "contact_integral",
        "other",
    }


# A constant, and the law of Wong and Reece


def pulls(pull: object, **more: object) -> Measurements:
    """Wheels whose pull is given, as a function of their slip."""
    slip = np.tile(np.linspace(0.0, 0.8, 6), 2)
    conditions = Conditions.of(np.repeat([40.0, 80.0], 6), 0.2, 0.1, slip=slip)
    measured = np.asarray(pull(conditions.load, slip), dtype=float)  # type: ignore[operator]
    run = np.array([f"r{i}" for i in range(12)])
    return table(12, conditions=conditions, channels={"drawbar_pull": measured}, run=run, **more)


def test_the_constant_is_the_mean_of_the_runs_that_it_may_see() -> None:
    found = comparison_of(table(12))
    constant = found.models[0]
    assert (constant.contender.name, constant.model) == ("constant", None)
    value = found.measurements.channels["sinkage"]
    inside = found.residual(constant, "sinkage")
    assert inside == pytest.approx(value - value.mean())
    # each run has a fold of its own here
    others = [value[found.measurements.run != run].mean() for run in found.measurements.run]
    held_out = found.residual(constant, "sinkage", held_out=True)
    assert held_out == pytest.approx(value - np.array(others))


def test_the_regression_is_a_line_through_the_runs_that_it_may_see() -> None:
    rng = np.random.default_rng(8)
    load = np.geomspace(20.0, 90.0, 10)
    depth = 1e-3 * load**0.9 * np.exp(rng.normal(0.0, 0.01, 10))
    run = np.array([f"r{i}" for i in range(10)])
    found = comparison_of(
        table(10, conditions=Conditions.of(load, 0.2, 0.1), channels={"sinkage": depth}, run=run)
    )
    line = found.models[1]
    assert (line.contender.name, line.model) == ("log_log_regression", None)

    def off(seen: NDArray[np.bool_]) -> NDArray[np.float64]:
        weight = np.minimum(depth[seen] / np.median(depth[seen]), 1.0) ** 0.5
        slope = np.polyfit(np.log(load[seen]), np.log(depth[seen]), 1, w=weight)
        return np.asarray(depth - np.exp(np.polyval(slope, np.log(load))))

    assert found.residual(line, "sinkage") == pytest.approx(off(np.ones(10, dtype=bool)))
    # each run has a fold of its own here
    alone = [off(np.arange(10) != i)[i] for i in range(10)]
    assert found.residual(line, "sinkage", held_out=True) == pytest.approx(np.array(alone))


def test_a_regression_that_is_better_than_every_law_is_said_to_be() -> None:
    """A depth that grows with the square of slip: a law without slip loses to a line that has it."""
    slip = np.tile(np.linspace(0.0, 0.8, 6), 2)
    conditions = Conditions.of(np.repeat([40.0, 80.0], 6), 0.2, 0.1, slip=slip)
    exact = predict(Model(SAND), conditions).sinkage * np.exp(slip + slip**2)
    run = np.array([f"r{i}" for i in range(12)])
    found = comparison_of(table(12, conditions=conditions, channels={"sinkage": exact}, run=run))
    text = " ".join(found.text().split())
    assert "no law has less error than a log-log regression" in text
    assert "an effect is missing (`smallwheel diagnose`)" in text
    assert "sinkage best by log_log_regression, which is no law, error" in found.headline()


def pressed(depth: NDArray[np.float64], soil: list[str] | None = None) -> Comparison:
    """Plates of one size under the loads of `LOADS`, a run for each row of depths."""
    runs, rows = depth.shape
    named = None if soil is None else np.repeat(soil, rows)
    conditions = replace(
        Conditions.of(np.tile(LOADS, runs), 0.15, 0.0, contact="plate"), soil=named
    )
    run = np.repeat([f"r{i}" for i in range(runs)], rows)
    channels = {"sinkage": depth.reshape(-1)}
    return comparison_of(table(depth.size, conditions=conditions, channels=channels, run=run))


LOADS = np.geomspace(40.0, 400.0, 12)


def test_a_soil_that_a_fold_never_met_is_the_middle_of_those_that_it_met() -> None:
    """Three soils, the middle one of one run: its ln z is the mean of the others', whatever their n are."""
    factor = np.array([0.5, 0.5, 0.5, 1.0, 2.0, 2.0, 2.0])
    power = np.array([0.9, 0.9, 0.9, 1.2, 1.5, 1.5, 1.5])  # 1 / n
    soil = ["firm"] * 3 + ["middle"] + ["soft"] * 3
    depth = 1e-3 * factor[:, None] * (LOADS / 40.0) ** power[:, None]
    found = pressed(depth, soil)
    law = next(m for m in found.models if m.contender.name == "bekker")
    score = found.score(law, "sinkage", held_out=True, rows=found.measurements.soil == "middle")
    assert score is not None
    assert score.rmse < 0.05 * float(depth[3].max())


def test_runs_of_several_soils_under_one_name_are_told_to_be_named() -> None:
    """Each soil was pressed as far as the press goes: a line takes firmness from load, which no law can."""
    firmness = np.geomspace(1.0, 20.0, 8)
    depth = 1e-3 * (LOADS / 40.0) ** 1.2 * np.ones((8, 1))
    conditions = Conditions.of((firmness[:, None] * LOADS).reshape(-1), 0.15, 0.0, contact="plate")
    run = np.repeat([f"r{i}" for i in range(8)], LOADS.size)
    found = comparison_of(
        table(96, conditions=conditions, channels={"sinkage": depth.reshape(-1)}, run=run)
    )
    said = found.useless("sinkage")
    assert "more than those of one soil: name the soils" in said
    assert "an effect is missing" not in said


def test_curves_that_are_no_power_of_depth_are_no_sign_of_a_missing_effect() -> None:
    rng = np.random.default_rng(1)
    bent = np.log(LOADS / LOADS[-1])
    firm = np.exp(0.02 * rng.normal(size=(6, 1)))
    found = pressed(0.03 * firm * np.exp(1.2 * bent - 0.3 * bent**2))
    said = found.useless("sinkage")
    assert "a log-log regression" in said
    assert "no one power of depth" in said
    assert "an effect is missing" not in said


def test_a_law_that_is_worse_than_a_constant_is_said_to_be() -> None:
    """A pull that follows neither load nor slip: there is nothing for a law to say."""
    found = comparison_of(pulls(lambda load, slip: 5.0 + 0.1 * np.sin(40.0 * slip + load)))
    best, law = found.best("drawbar_pull"), found.best("drawbar_pull", laws=True)
    assert best is found.models[0]
    assert law is not None
    assert law is not best
    text = " ".join(found.text().split())
    assert (
        f"no law has less error than a constant, the mean of the other runs: {words(law.contender.name)}"
        in text
    )
    assert "drawbar pull best by constant, which is no law, error" in found.headline()


def test_a_law_that_holds_is_said_to_be_best() -> None:
    model = Model(SAND)
    found = comparison_of(
        pulls(
            lambda load, slip: predict(model, Conditions.of(load, 0.2, 0.1, slip=slip)).drawbar_pull
        )
    )
    best = found.best("drawbar_pull")
    assert best is not None
    assert best.contender.name == "contact_integral"
    assert found.useless("drawbar_pull") == ""
    assert "no law has less" not in " ".join(found.text().split())
    assert "drawbar pull best by contact_integral, error" in found.headline()


def test_wong_and_reece_stand_beside_ours_where_pull_or_torque_was_measured(
    comparison: Comparison,
) -> None:
    assert "wong_reece" not in [m.contender.name for m in comparison.models]
    found = comparison_of(pulls(lambda load, slip: load * (0.4 * slip - 0.1)))
    forms = {m.contender.name: m.model.thrust_form for m in found.models if m.model is not None}
    assert forms == {
        "bekker": "integrated",
        "meirion_griffith_spenko": "integrated",
        "wong_reece": "wong_reece",
        "contact_integral": "stress_integral",
    }
    for model in found.models:
        assert found.score(model, "drawbar_pull", held_out=True) is not None
    assert "peak moves with slip" in found.text()


@pytest.mark.skipif(not SHARED.is_dir(), reason=f"no measurements at {SHARED}")
def test_on_wheels_of_two_labs_the_balance_of_stresses_beats_the_published_laws() -> None:
    """Ding 2011 and KLS-1, each measured value left out in turn."""
    for file in ("ding2011.csv", "kls1.csv"):
        found = comparison_of(read_measurements(SHARED / "data" / "published_wheels" / file))
        assert found.channels == ("sinkage", "drawbar_pull", "torque")
        error = {}
        for model in found.models:
            score = found.score(model, "drawbar_pull", held_out=True)
            if (
                model.contender.name == "log_log_regression"
            ):  # of what may be of either sign it says nothing
                assert score is None
                continue
            assert score is not None
            error[model.contender.name] = score.rmse
        assert error["contact_integral"] < min(
            e for n, e in error.items() if n != "contact_integral"
        )


# The document


def test_the_document_has_every_part_and_repeats_to_the_byte(simulated: Measurements) -> None:
    def text() -> str:
        found = comparison_of(simulated, [Contender("own", "", Model(SAND))])
        return json.dumps(comparison_document(found), allow_nan=False)

    first = text()
    assert first == text()
    document = json.loads(first)
    assert document["schema"] == 1
    assert document["data"]["rows"] == 48
    assert document["data"]["runs"] == 16
    assert [m["name"] for m in document["models"]] == [
        "constant",
        "log_log_regression",
        "bekker",
        "meirion_griffith_spenko",
        "contact_integral",
        "own",
    ]
    for model in document["models"]:
        for scores in model["channels"].values():
            assert scores["in_sample"]["rmse"] > 0
            assert (scores["held_out"] is not None) == model["fitted"]
        assert {part["by"] for part in model["parts"]} >= {"load", "slip", "diameter", "wheel"}
        if model["name"] in ("constant", "log_log_regression"):
            assert (model["geometry"], model["soils"], model["effects"]) == (None, [], [])
        else:
            assert model["soils"][0]["k"] > 0
    assert set(document["noise_floor"]["sinkage"]) == {"value", "source", "reason", "repeatability"}
    judged = [d for d in document["differences"] if d["channel"] == "sinkage"]
    assert {judged[0]["best"], *(d["other"] for d in judged)} == {
        "constant", "log_log_regression", "bekker", "meirion_griffith_spenko",
        "contact_integral"}  # fmt: skip


def test_text_names_every_model_and_how_it_compares(comparison: Comparison) -> None:
    text = comparison.text()
    for name in (
        "constant",
        "log-log regression",
        "Bekker",
        "Meirion-Griffith & Spenko",
        "contact integral",
    ):
        assert text.count(name) >= 2
    lines = [line.split() for line in text.splitlines()]
    assert sum(cells[-1:] == ["best"] and cells[0] != "model" for cells in lines) == 2
    within = [
        name not in change.worse
        for name in comparison.channels
        for change in comparison.differences(name).values()
    ]
    alike = [line for line in text.splitlines() if line.endswith("within s.e.")]
    assert len(alike) == sum(within)
    assert ("Within s.e.: worse than" in text) == any(within)
    assert "repeats of one run differ by" in text
    assert "nan" not in text.lower()


# Real measurements


@pytest.mark.skipif(not RIG.is_dir(), reason=f"the rig's measurements are not at {RIG}")
def test_on_the_rig_every_base_model_leaves_an_error_that_follows_slip() -> None:
    data = read_measurements(RIG / "rolling_smooth_wheel.csv")
    data = data.take(data.conditions["slip_angle"] == 0)
    data = Measurements(data.conditions, {"sinkage": data.channels["sinkage"]}, data.run,
                        data.wheel, data.line, units=data.units)  # fmt: skip
    found = comparison_of(data)
    slip = np.abs(data.conditions["slip"])
    repeats = found.noise["sinkage"].repeatability
    assert repeats is not None
    laws = [m for m in found.models if m.model is not None]
    assert [m.contender.name for m in laws] == [
        "bekker", "meirion_griffith_spenko", "contact_integral"]  # fmt: skip
    for result in laws:
        far = found.score(result, "sinkage", rows=slip > 0.6)
        near = found.score(result, "sinkage", rows=slip <= 0.3)
        assert far is not None
        assert near is not None
        assert far.bias > 5e-3  # a wheel that slips digs itself in
        assert near.bias < -3 * repeats
        assert far.rmse > 10 * repeats


@pytest.mark.parametrize(
    "channels", [("sinkage", "resistance"), ("sinkage", "drawbar_pull"), ("drawbar_pull",)]
)
def test_the_error_that_is_shown_is_that_of_the_fit(
    tmp_path: Path, channels: tuple[str, ...]
) -> None:
    """One optimum: `fit`, `compare` and `diagnose` fit one law to one table under one noise."""
    write_table(
        simulate_rig(RigSettings(seed=31, runs=12, channels=channels)).table, tmp_path / "r.csv"
    )
    data = read_measurements(tmp_path / "r.csv")
    own = fit(data).errors.rmse()
    shown = comparison_of(data, [Contender("plain", "", Base())], standard=False)
    compared = shown.models[0].in_sample.rmse()
    held_out = shown.models[0].held_out
    assert held_out is not None
    for name, rmse in own.items():
        assert compared[name] == pytest.approx(rmse, rel=1e-9)
    step = diagnose(data).steps[0].errors.rmse()
    assert step == pytest.approx(held_out.rmse(), rel=1e-9)


def of_plates(size: float | None = None, soil: str = "") -> Measurements:
    """Curves of the real plates in examples/data: of one size, or of one soil (or all) of the other sand."""
    if soil:
        data = read_measurements(EXAMPLES / "cullinan_sand" / "plates.csv")
        return data if soil == "all" else data.take(data.soil == soil)
    data = read_measurements(EXAMPLES / "cmu_wheel_rig" / "indentation.csv")
    plates = data.take(data.conditions.plate)
    return plates if size is None else plates.take(np.isclose(plates.conditions.diameter, size))


def test_the_error_of_curves_is_that_of_the_fit() -> None:
    """A diagnosis weighs errors that a whole curve shares, a fit does not: what is shown is the fit's."""
    data = of_plates()
    (model,) = comparison_of(data, [Contender("plain", "", Base())], standard=False).models
    assert model.held_out is not None
    assert model.in_sample.rmse() == pytest.approx(
        Problem.of(data).result().errors.rmse(), rel=1e-9
    )
    assert diagnose(data).steps[0].errors.rmse() == pytest.approx(model.held_out.rmse(), rel=1e-9)


@pytest.mark.parametrize(
    "how",
    [{}, {"size": 0.06}, {"size": 0.08}, {"size": 0.1}]
    + [{"soil": name} for name in ("preparation 1", "preparation 2", "all")],
)
def test_on_real_plates_the_law_is_no_worse_than_a_line_in_logarithms(
    how: dict[str, Any],
) -> None:
    """Curves bend, and the first rows are as shallow as their zero is uncertain."""
    found = comparison_of(of_plates(**how), [Contender("ours", "", Base())])
    error = {m.contender.name: m.held_out.rmse()["sinkage"] for m in found.models if m.held_out}
    assert error["ours"] < 1.1 * error["log_log_regression"]


def test_plates_and_a_pressed_wheel_in_one_fit_are_as_near_as_the_law_can_be() -> None:
    """The law is off by one amount for plates and another for the wheel, which no run tells from its own."""
    data = read_measurements(EXAMPLES / "cmu_wheel_rig" / "indentation.csv")
    problem = Problem.of(data)
    points, fit = problem.points, problem.fit

    def off(theta: NDArray[np.float64]) -> NDArray[np.float64]:
        return (problem.fitter.predictor(fit.vector, theta) - points.value) * np.sqrt(points.count)

    # in mm, so that a step of the solver is no rounding
    nearest = least_squares(lambda theta: 1e3 * off(theta), fit.theta, bounds=fit.vector.bounds).x
    least = in_sample(points, fit.vector.model(nearest)).rmse()["sinkage"]
    held_out = problem.held_out()
    assert held_out is not None
    assert held_out.rmse()["sinkage"] < 1.2 * least


def test_a_soil_of_one_run_has_no_say_in_what_is_said_of_the_law() -> None:
    found = comparison_of(read_measurements(EXAMPLES / "cullinan_sand" / "plates.csv"))
    said = found.useless("sinkage")
    elsewhere = said.partition("nothing is known of it: the errors elsewhere are ")[2]
    law, constant, regression = (float(v) for v in re.findall(r"([\d.]+) mm", elsewhere))
    assert law < regression < constant


def test_curves_of_soils_that_are_not_named_are_told_to_be() -> None:
    """Depth was set and pressure answered: over all of them depth hardly rises with load, as in no soil."""
    table = pd.read_csv(EXAMPLES / "cullinan_sand" / "plates.csv")
    data = read_measurements(table.drop(columns=["soil", "dry_density [kg/m^3]"]))
    said = comparison_of(data).useless("sinkage")
    assert "name the soils" in said
    assert "its n is at its bound" in said
    assert any("name the soils" in note for note in Problem.of(data).result().notes)
    named = Problem.of(read_measurements(table)).result()
    assert not any("name the soils" in note for note in named.notes)
