from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest

from smallwheel_ros.compare.comparison import CompareError, Comparison, compare
from smallwheel_ros.compare.contenders import Contender
from smallwheel_ros.compare.document import comparison_document
from smallwheel_ros.compare.text import comparison_text
from smallwheel_ros.effects.slip_sinkage import Exponential
from smallwheel_ros.fitting import fit_model
from smallwheel_ros.measurements.table import Measurements, read_measurements
from smallwheel_ros.model import Model, predict
from smallwheel_ros.physics.conditions import Conditions
from smallwheel_ros.physics.soil import Soil
from smallwheel_ros.simulate import RigSettings, simulate_rig, write_table

SHARED = Path(os.environ.get("SMALLWHEEL_SHARED", Path(__file__).parents[2] / "shared"))
RIG = SHARED / "data" / "cmu_wheel_rig"

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
        c if isinstance(c, Contender) else Contender(f"model {i}", "as it stands", None, c)
        for i, c in enumerate(contenders)
    ]
    return compare(data or table(), named, standard=False)


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> Measurements:
    rig = simulate_rig(RigSettings(seed=11, runs=16, rows_per_run=3))
    path = tmp_path_factory.mktemp("rig") / "rig.csv"
    write_table(rig.table, path)
    return read_measurements(path)


@pytest.fixture(scope="module")
def comparison(simulated: Measurements) -> Comparison:
    return compare(simulated, folds=4)


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
    seen: list[set[str]] = []

    def fit(part: Measurements) -> Model:
        seen.append(set(part.run.tolist()))
        # a model that tells by its k what it was fitted to
        return Model(Soil("sand", 1e6 + len(seen), 0.8))

    found = compare(data, [Contender("spy", "", fit)], standard=False, folds=4)
    assert seen[0] == set(data.run.tolist())
    assert found.folds == 4
    assert len(seen) == 5
    held_out = found.models[0].held_out
    assert held_out is not None
    for number, trained in enumerate(seen[1:], start=2):
        rows = ~np.isin(data.run, list(trained))
        assert rows.any()
        own = predict(Model(Soil("sand", 1e6 + number, 0.8)), data.conditions).sinkage
        np.testing.assert_allclose(held_out.values["sinkage"][rows], own[rows], rtol=1e-12)
    left_out = [set(data.run.tolist()) - trained for trained in seen[1:]]
    assert sum(map(len, left_out)) == 11  # each run once


def test_progress_counts_every_fit() -> None:
    told: list[tuple[int, int]] = []
    compare(
        table(22),
        [Contender("a", "", lambda part: Model(SAND)), Contender("b", "", None, Model(SAND))],
        standard=False,
        folds=3,
        progress=lambda done, needed: told.append((done, needed)),
    )
    assert told == [(0, 4), (1, 4), (2, 4), (3, 4), (4, 4)]


def test_held_out_errors_are_those_of_a_refit_by_hand(
    simulated: Measurements, comparison: Comparison
) -> None:
    result = comparison.models[-1]
    assert result.held_out is not None
    predicted = result.held_out.values["sinkage"]
    # rows that one model predicted: find the runs of the first fold from outside
    runs = np.unique(comparison.run)
    fold = np.random.default_rng(0).permutation(np.arange(runs.size) % 4)
    rows = np.isin(comparison.run, runs[fold == 0])
    model = fit_model(simulated.take(~rows), geometry="contact_integral").model
    own = predict(model, simulated.conditions.take(rows)).sinkage
    np.testing.assert_allclose(predicted[rows], own, rtol=1e-9)


def test_the_truth_without_hidden_effect_is_met_to_its_scatter(comparison: Comparison) -> None:
    """The simulated truth shares no code with the models; 5 % of scatter in k is between runs."""
    exact = comparison.models[-1]
    assert exact.contender.name == "contact_integral"
    for channel in ("sinkage", "resistance"):
        score = comparison.score(exact, channel, held_out=True)
        floor = comparison.noise[channel].value
        assert score is not None
        assert floor is not None
        measured = comparison.measurements.channels[channel]
        assert score.rmse < 0.12 * np.sqrt(np.mean(measured**2)) + 2 * floor


def test_bekker_has_no_diameter_and_splits_the_modulus_over_widths(comparison: Comparison) -> None:
    bekker = comparison.models[0]
    assert bekker.contender.name == "bekker"
    assert bekker.model is not None
    assert abs(bekker.model.soils[0].m) < 1e-4
    assert bekker.model.geometry == "closed_form"
    assert [effect.id for effect in bekker.model.effects] == ["width_dependent_modulus"]
    assert "kc and kphi of K" in bekker.contender.description
    proposed = comparison.models[1]
    assert proposed.model is not None
    assert proposed.model.geometry == "closed_form"
    assert abs(proposed.model.soils[0].m) > 1e-3


def test_with_one_width_and_diameter_the_description_says_what_is_determined() -> None:
    rng = np.random.default_rng(2)
    conditions = Conditions.of(rng.uniform(20, 90, 8), 0.2, 0.1)
    exact = predict(Model(SAND), conditions)
    data = table(8, conditions=conditions, channels={"sinkage": exact.sinkage})
    found = compare(data, folds=2)
    assert "not kc and kphi" in found.models[0].contender.description
    assert "not m" in found.models[1].contender.description
    assert found.models[0].model is not None
    assert not found.models[0].model.effects


# What cannot be predicted is said and counted, and never a NaN


def document_of(found: Comparison) -> dict:
    return json.loads(json.dumps(comparison_document(found), allow_nan=False))


def test_rows_in_which_the_model_sinks_to_the_axle_are_reported() -> None:
    soft = Model(Soil("mud", 3e4, 0.8, 0.4))
    data = table()
    sunk = predict(soft, data.conditions).immobilised
    assert 0 < sunk.sum() < 12
    found = standing(soft, data=data)
    (why, rows), *_ = found.models[0].in_sample.reasons
    assert "sunk to the axle" in why
    np.testing.assert_array_equal(rows, np.flatnonzero(sunk))
    score = found.score(found.models[0], "sinkage")
    assert score is not None
    assert score.rows == 12 - sunk.sum()
    assert document_of(found)["models"][0]["not_predicted"][0]["rows"] == sunk.sum()
    assert "sunk to the axle" in comparison_text(found)


def test_a_model_whose_column_is_missing_predicts_nothing_and_says_so() -> None:
    data = table()
    plain = Measurements(
        Conditions(data.conditions.load, data.conditions.diameter, data.conditions.width,
                   data.conditions.contact),
        data.channels, data.run, data.wheel, data.line,
    )  # fmt: skip
    found = standing(Model(SAND) + Exponential(), Model(SAND), data=plain)
    assert found.score(found.models[0], "sinkage") is None
    assert "effect slip_sinkage needs the column 'slip'" in found.models[0].in_sample.reasons[0][0]
    assert found.score(found.models[1], "sinkage") is not None
    scores = document_of(found)["models"][0]["channels"]["sinkage"]
    assert scores == {"in_sample": None, "held_out": None}


def test_rows_whose_covariate_is_blank_are_reported() -> None:
    data = table()
    slip = data.conditions["slip"].copy()
    slip[[2, 5]] = np.nan
    conditions = Conditions(data.conditions.load, data.conditions.diameter, data.conditions.width,
                            data.conditions.contact, None, {"slip": slip})  # fmt: skip
    found = standing(Model(SAND) + Exponential(), data=table(12, conditions=conditions))
    (why, rows), *_ = found.models[0].in_sample.reasons
    assert "'slip', which is blank" in why
    assert rows.tolist() == [2, 5]


def test_bodies_that_do_not_roll_have_no_resistance_to_predict() -> None:
    conditions = Conditions.of(
        [30.0, 40.0, 50.0, 60.0], 0.2, 0.1, contact=["rolling", "pressed", "plate", "rolling"]
    )
    values = {"sinkage": np.full(4, 0.01), "resistance": np.array([5.0, 5.0, 5.0, np.nan])}
    data = table(4, conditions=conditions, channels=values)
    found = standing(Model(SAND), data=data)
    score = found.score(found.models[0], "resistance")
    assert score is not None
    assert score.rows == 1
    reasons = dict(found.models[0].in_sample.reasons)
    assert reasons["a wheel that does not roll has no resistance"].tolist() == [1, 2]


def test_drawbar_pull_without_slip_is_said_to_need_it() -> None:
    conditions = Conditions.of([30.0, 40.0, 50.0], 0.2, 0.1)
    values = {"sinkage": np.full(3, 0.01), "drawbar_pull": np.full(3, 2.0)}
    found = standing(Model(SAND), data=table(3, conditions=conditions, channels=values))
    assert "drawbar_pull" not in found.channels
    assert dict(found.models[0].in_sample.reasons)["drawbar_pull needs the column 'slip'"].size == 3


def test_a_soil_that_the_model_does_not_have_is_reported() -> None:
    data = table()
    soil = np.where(np.arange(12) < 4, "loam", "sand")
    conditions = Conditions(data.conditions.load, data.conditions.diameter, data.conditions.width,
                            data.conditions.contact, soil, data.conditions.covariates)  # fmt: skip
    model = Model([SAND, Soil("snow", 2e5, 1.6)])
    found = standing(model, data=table(12, conditions=conditions))
    (why, rows), *_ = found.models[0].in_sample.reasons
    assert why == "the model has no soil 'loam'"
    assert rows.tolist() == [0, 1, 2, 3]


def test_wheels_measured_below_their_axle_are_left_out_with_their_lines() -> None:
    data = table()
    data.channels["sinkage"][3] = 0.9 * data.conditions.diameter[3]  # type: ignore[index]
    found = standing(Model(SAND), data=data)
    assert len(found.measurements) == 11
    (why, lines), = found.left_out  # fmt: skip
    assert "deeper than its axle" in why
    assert lines.tolist() == [5]
    document = document_of(found)["data"]
    assert document["rows"] == 12
    assert document["left_out"][0]["lines"] == [5]


def test_no_row_to_compare_is_an_error_that_says_why() -> None:
    data = table()
    data.channels["sinkage"][:] = data.conditions.diameter  # type: ignore[index]
    with pytest.raises(CompareError, match=r"made.csv: no row to compare: in all 12 rows .* axle"):
        standing(Model(SAND), data=data)
    nothing = table(12, channels={"sinkage": np.full(12, np.nan)})
    with pytest.raises(CompareError, match="nothing was measured"):
        standing(Model(SAND), data=nothing)


def test_one_run_holds_nothing_out_and_says_so() -> None:
    data = table(12, run=np.full(12, "only"))
    found = compare(data, [Contender("fit", "", lambda part: Model(SAND))], standard=False)
    assert found.folds == 0
    assert found.models[0].held_out is None
    assert any("nothing can be held out" in note for note in found.notes)


@pytest.mark.parametrize(
    ("fitted_to", "words"),
    [
        ("abc", "this very file"),
        ("def", "another file"),
        ("", "is not known"),
    ],
)
def test_a_standing_model_says_whether_its_error_is_held_out(fitted_to: str, words: str) -> None:
    found = standing(Contender("m", "", None, Model(SAND), "m.yaml", fitted_to))
    assert words in found.models[0].notes[0]
    assert found.models[0].held_out is None


# The document


def test_the_document_has_every_part_and_repeats_to_the_byte(simulated: Measurements) -> None:
    def text() -> str:
        found = compare(simulated, [Contender("own", "", None, Model(SAND))], folds=2)
        return json.dumps(comparison_document(found), allow_nan=False)

    first = text()
    assert first == text()
    document = json.loads(first)
    assert document["schema"] == 1
    assert document["data"]["rows"] == 48
    assert document["data"]["runs"] == 16
    assert [m["name"] for m in document["models"]] == [
        "bekker",
        "proposed",
        "contact_integral",
        "own",
    ]
    for model in document["models"]:
        for scores in model["channels"].values():
            assert scores["in_sample"]["rmse"] > 0
            assert (scores["held_out"] is not None) == model["fitted"]
        assert {part["by"] for part in model["parts"]} >= {"load", "slip", "diameter", "wheel"}
        assert model["soils"][0]["k"] > 0


def test_text_names_every_model_and_the_noise_floor(comparison: Comparison) -> None:
    text = comparison_text(comparison)
    for name in ("bekker", "proposed", "contact_integral"):
        assert text.count(name) >= 2
    assert "noise floor" in text
    assert "nan" not in text.lower()


# Real measurements


@pytest.mark.skipif(not RIG.is_dir(), reason=f"the rig's measurements are not at {RIG}")
def test_on_the_rig_every_base_model_fails_away_from_slip_zero() -> None:
    data = read_measurements(RIG / "rolling_smooth_wheel.csv")
    data = data.take(data.conditions["slip_angle"] == 0)
    data = Measurements(data.conditions, {"sinkage": data.channels["sinkage"]}, data.run,
                        data.wheel, data.line, units=data.units)  # fmt: skip
    found = compare(data, folds=3)
    slip = np.abs(data.conditions["slip"])
    for result in found.models:
        far = found.score(result, "sinkage", rows=slip > 0.6)
        near = found.score(result, "sinkage", rows=slip <= 0.3)
        assert far is not None
        assert near is not None
        assert far.rmse > 5e-3
        assert far.rmse > 1.5 * near.rmse
        floor = found.noise["sinkage"].value
        assert floor is not None
        assert far.rmse > 10 * floor
