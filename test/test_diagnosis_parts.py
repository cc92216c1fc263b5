"""The parts of the diagnosis one by one: score test, held-out error, ties, regions."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from smallwheel_ros.diagnosis.candidates import list_families, measured_forces
from smallwheel_ros.diagnosis.document import plain
from smallwheel_ros.diagnosis.held_out import Errors, better, one_step, refitted
from smallwheel_ros.diagnosis.regions import where_it_fails
from smallwheel_ros.diagnosis.score import Columns, p_value, scores, simulate
from smallwheel_ros.diagnosis.search import best_form, plausible
from smallwheel_ros.diagnosis.ties import find_ties
from smallwheel_ros.diagnosis.workbench import Base, Workbench
from smallwheel_ros.effects.registry import default_registry, effect
from smallwheel_ros.fitting.calibrate import calibrate
from smallwheel_ros.fitting.layout import make_layout
from smallwheel_ros.fitting.mixed import Padding, RunEffects
from smallwheel_ros.fitting.observations import Observations, observe
from smallwheel_ros.measurements.table import Measurements, read_measurements
from smallwheel_ros.simulate import RigSettings, simulate_rig, write_table


def table(folder: Path, frame: pd.DataFrame) -> Measurements:
    write_table(frame, folder / "rig.csv")
    return read_measurements(folder / "rig.csv")


def observed(folder: Path, settings: RigSettings) -> Observations:
    return observe(table(folder, simulate_rig(settings).table))


def bench(observations: Observations) -> Workbench:
    return Workbench(calibrate(observations, make_layout(observations)), Base())


def toy(seed: int) -> tuple[RunEffects, np.ndarray, np.ndarray, np.random.Generator]:
    rng = np.random.default_rng(seed)
    run = np.repeat(np.arange(30), 3)
    effects = RunEffects(np.ones(90), np.ones((90, 1)), ("ln k",), Padding.of(run))
    design = np.column_stack([np.ones(90), rng.normal(size=30)[run]])
    column = rng.normal(size=30)[run]
    return effects, design, column, rng


def test_score_of_a_column_of_no_meaning_is_chi_square_like() -> None:
    effects, design, column, rng = toy(1)
    tau = np.array([0.8])
    columns = Columns(column[:, None], ("a",), (None,), ({},), np.zeros(1, dtype=bool))
    draws = simulate(effects, tau, 2000, rng)
    found = scores(effects, np.ones(1), tau, design, np.zeros((2, 2)), columns, draws)
    # 5 % of chi-square with one degree of freedom is over 3.84; few runs make the tail heavier.
    assert 0.04 < np.mean(found.statistic[0] > 3.84) < 0.09


def test_rows_of_a_run_are_not_more_evidence_than_the_run() -> None:
    effects, design, column, rng = toy(2)
    columns = Columns(column[:, None], ("a",), (None,), ({},), np.zeros(1, dtype=bool))
    response = simulate(effects, np.array([5.0]), 400, rng)
    naive = RunEffects(np.full(90, 26.0), np.zeros((90, 1)), ("ln k",), effects.padding)
    honest = scores(
        effects, np.ones(1), np.array([5.0]), design, np.zeros((2, 2)), columns, response
    )
    fooled = scores(naive, np.ones(1), np.zeros(1), design, np.zeros((2, 2)), columns, response)
    assert np.mean(honest.statistic[0] > 3.84) < 0.10
    assert np.mean(fooled.statistic[0] > 3.84) > 0.20


def test_strength_and_share_left_are_those_of_least_squares() -> None:
    effects, design, column, rng = toy(3)
    y = 2.0 * column + 0.3 * rng.normal(size=90)
    columns = Columns(column[:, None], ("a",), (None,), ({},), np.zeros(1, dtype=bool))
    none = np.zeros(1)
    found = scores(effects, np.ones(1), none, design, np.zeros((2, 2)), columns, y[:, None])
    full = np.column_stack([design, column])
    assert found.strength[0] == pytest.approx(np.linalg.lstsq(full, y, rcond=None)[0][-1])
    left = column - design @ np.linalg.lstsq(design, column, rcond=None)[0]
    share = np.linalg.norm(left) / np.linalg.norm(column)
    assert found.left[0] == pytest.approx(share)


def test_one_sided_columns_gain_nothing_from_the_wrong_sign() -> None:
    effects, design, column, _ = toy(4)
    columns = Columns(column[:, None], ("a",), (None,), ({},), np.ones(1, dtype=bool))
    y = np.column_stack([column, -column])
    found = scores(effects, np.ones(1), np.zeros(1), design, np.zeros((2, 2)), columns, y)
    assert found.statistic[0, 0] > 10.0
    assert found.statistic[0, 1] == 0.0


def test_p_values_fall_and_go_on_beyond_the_draws() -> None:
    null = np.random.default_rng(0).chisquare(1, 999)
    values = [p_value(t, null) for t in (0.0, 1.0, 3.84, 10.0, 60.0)]
    assert values == sorted(values, reverse=True)
    assert values[0] == 1.0
    assert values[2] == pytest.approx(0.05, abs=0.02)
    assert 0.0 < values[-1] < 1e-10


def test_held_out_error_by_one_step_is_that_of_a_new_fit(tmp_path: Path) -> None:
    workbench = bench(observed(tmp_path, RigSettings(seed=3001, hidden=("multipass",))))
    fitted = workbench.fit([])
    quick, anew = one_step(workbench, fitted).rmse(), refitted(workbench, fitted).rmse()
    for name in quick:
        assert quick[name] == pytest.approx(anew[name], rel=0.03)


def test_better_counts_runs_not_rows() -> None:
    run = np.repeat(np.arange(8), 50)
    before = Errors(np.ones(400), np.ones(400), run, np.zeros(400, dtype=np.intp), ("sinkage",))
    after_error = np.where(run == 0, 0.0, 1.0)  # one run of eight got better, 50 rows or not
    after = Errors(after_error, before.variance, run, before.channel, before.channels)
    fall, sigmas = better(before, after)
    assert fall > 0.05
    assert sigmas == pytest.approx(1.0, abs=0.1)


def test_settings_varied_together_are_tied_until_runs_break_it(tmp_path: Path) -> None:
    rig = simulate_rig(RigSettings(seed=3002, tie=("slip", "load")))
    ties = find_ties(observe(table(tmp_path, rig.table)))
    assert {t.first for t in ties} == {"slip", "load"}
    more = rig.table.iloc[:6].copy()
    more["load [N]"], more["slip"], more["run"] = 25.0, 0.55, "break"
    assert find_ties(observe(table(tmp_path, pd.concat([rig.table, more])))) == []
    free = simulate_rig(RigSettings(seed=3003))
    assert find_ties(observe(table(tmp_path, free.table))) == []


def test_the_region_in_which_a_model_fails(tmp_path: Path) -> None:
    observations = observed(tmp_path, RigSettings(seed=3004, channels=("sinkage",)))
    rng = np.random.default_rng(1)
    slip = observations.conditions["slip"][observations.row]
    error = rng.normal(0.0, 1e-4, slip.size) + np.where(slip > 0.4, 2e-3, 0.0)
    errors = Errors(
        error, np.full(slip.size, 1e-8), observations.run, observations.channel, ("sinkage",)
    )
    worst = where_it_fails(observations, errors, seed=0)[0]
    name, sign, value = worst.region.split()
    assert (name, sign) == ("slip", ">")
    assert 0.35 < float(value) < 0.45
    assert worst.bias == pytest.approx(2e-3, rel=0.1)
    assert worst.p < 0.01
    assert worst.rmse > 5.0 * worst.rmse_elsewhere


def test_no_region_in_noise(tmp_path: Path) -> None:
    observations = observed(tmp_path, RigSettings(seed=3005, channels=("sinkage",)))
    noise = np.random.default_rng(3).normal(0.0, 1e-4, len(observations))
    errors = Errors(
        noise, np.full(noise.size, 1e-8), observations.run, observations.channel, ("sinkage",)
    )
    assert where_it_fails(observations, errors, seed=0) == []


def test_what_cannot_be_tested_says_why(tmp_path: Path) -> None:
    rig = simulate_rig(RigSettings(seed=3006, channels=("sinkage",)))
    frame = rig.table.copy()
    frame["speed [mm/s]"] = 50.0
    frame["towing force [N]"] = np.linspace(1.0, 9.0, len(frame))
    measurements = table(tmp_path, frame)
    families = list_families(observe(measurements), responses=measured_forces(measurements.units))
    why = {family.name: family.blocked for family in families}
    assert "speed never varies" in why["penetration_rate"]
    assert "no column 'grouser_height'" in why["grouser"]
    assert "resistance" in why["bulldozing"]
    assert "no row has a wheel that skids" in why["skid_sinkage"]
    assert "known physics" in why["slope"] or "no column" in why["slope"]
    assert "measured force" in why["covariate:towing force"]
    assert why["slip_sinkage"] == ""
    assert set(default_registry().families) <= set(why)


def test_the_best_form_is_found_and_plausible(tmp_path: Path) -> None:
    rig = simulate_rig(RigSettings(seed=3007, hidden=("multipass",), form="published"))
    observations = observe(table(tmp_path, rig.table))
    workbench = bench(observations)
    family = next(f for f in list_families(observations) if f.name == "multipass")
    found = best_form(workbench, workbench.fit([family.forms[-1]]), family)
    forms = {f.effect.form: workbench.fit([f]) for f in family.forms}
    assert found.cost == min(e.cost for e in forms.values())
    assert plausible(found, "multipass")
    strength = workbench.strength(forms["power"], "multipass")
    assert strength == pytest.approx(rig.truth.effects[0].amplitude, rel=0.15)


def test_json_has_no_numbers_that_are_none() -> None:
    found = plain({"a": float("nan"), "b": [np.inf, 1.23456789], "c": (True, None, 3, "x")})
    assert found == {"a": None, "b": [None, 1.23457], "c": [True, None, 3, "x"]}


def test_effects_of_the_base_are_refitted_and_not_named_again(tmp_path: Path) -> None:
    observations = observed(tmp_path, RigSettings(seed=3008, hidden=("multipass",)))
    base = Base(effects=(effect("multipass", "logarithmic"),))
    layout = make_layout(observations, base.effects)
    workbench = Workbench(calibrate(observations, layout), base)
    assert workbench.fit([]).theta.size == 4
    families = list_families(observations, ["multipass"])
    blocked = next(f for f in families if f.name == "multipass").blocked
    assert blocked == "the model has it already"
