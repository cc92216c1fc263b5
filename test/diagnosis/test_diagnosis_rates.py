# SPDX-License-Identifier: Apache-2.0
"""The script that counts how often the diagnosis is right, and (slow) rates that it must keep."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks._rates_table import document, marks, rate
from benchmarks.diagnosis_rates import fresh_errors, main, read, stored, trial
from benchmarks.worlds import WORLDS, matching
from smallwheel_ros.model.model import Model
from smallwheel_ros.physics.soil import Soil
from smallwheel_ros.simulate import RigSettings, measure, simulate_rig


def answer(verdict: str, named: list[str] | None = None, *candidates: str) -> dict[str, Any]:
    return {"verdict": verdict, "named": named or [], "candidates": list(candidates)}


@pytest.mark.parametrize(
    ("world", "given", "true"),
    [
        ("soil/nothing", answer("adequate"), {"right", "adequate"}),
        ("soil/nothing", answer("unknown_effect"), {"unknown"}),
        ("soil/nothing", answer("missing_effect", ["multipass"]), {"wrong"}),
        ("soil/nothing", answer("indistinguishable", [], "a", "b"), {"cannot tell"}),
        ("soil/unrecorded", answer("unknown_effect"), {"right", "unknown"}),
        ("soil/slip_sinkage", answer("missing_effect", ["slip_sinkage"]), {"right", "in the set"}),
        (
            "soil/slip_sinkage",
            answer("missing_effect", ["slip_sinkage", "hardpan"]),
            {"in the set", "wrong"},
        ),
        (
            "soil/slip_sinkage",
            answer("indistinguishable", [], "slip_sinkage", "multipass"),
            {"in the set", "cannot tell"},
        ),
        ("soil/slip_sinkage", answer("adequate"), {"adequate"}),
        (
            "soil/slip_sinkage+multipass",
            answer("missing_effect", ["multipass"], "slip_sinkage", "grouser"),
            {"in the set"},
        ),
        (
            "tie/slip-load-slip_sinkage",
            answer("indistinguishable", [], "slip_sinkage", "load_dependent_modulus"),
            {"right", "in the set", "cannot tell"},
        ),
        ("few/5-runs-slip_sinkage", answer("insufficient_data"), {"right", "cannot tell"}),
        (
            "fault/load_offset=-4",
            answer("missing_effect", ["bulldozing"]),
            {"wrong", "soil for instrument"},
        ),
        ("fault/load_offset=-4", answer("missing_effect", ["load_gain"]), {"wrong"}),
        (
            "soil/slip_sinkage+sinkage_offset",
            answer("missing_effect", ["slip_sinkage", "sinkage_offset"]),
            {"right", "in the set"},
        ),
        (
            "poor/column:density",
            answer("missing_effect", ["covariate:density"]),
            {"right", "in the set"},
        ),
    ],
)
def test_what_an_answer_counts_as(world: str, given: dict[str, Any], true: set[str]) -> None:
    assert {name for name, value in marks(WORLDS[world], given).items() if value} == true


def test_rates_have_wilson_intervals() -> None:
    """Wilson (1927) for 0 of 10 and 5 of 10: (0, 27.75) and (23.66, 76.34) per cent."""
    assert rate(0, 10) == "0 [0-28]"
    assert rate(5, 10) == "5 [24-76]"
    assert rate(0, 0) == ""


def test_tables_count_worlds_groups_and_densities() -> None:
    worlds = matching("curve/plate-*,soil/slip_sinkage")
    trials = [
        {"world": world.name, "seed": seed, "seconds": 1.0 + seed, **answer("adequate")}
        for world in worlds
        for seed in range(2)
    ]
    trials[0] |= answer("unknown_effect")
    trials[-1] |= {"reported_over_fresh": {"sinkage": 0.9, "resistance": 1.1}}
    trials.append({"world": "soil/slip_sinkage", "seed": 2, "failed": "ValueError: no"})
    text = document(worlds, trials, "--seeds 0:3")
    lines = {line.split("|")[1].strip(): line for line in text.splitlines() if line[:2] == "| "}
    assert "| 2 | 1 [9-91] |" in lines["curve/plate-3"]
    assert "| 2 | 2 [34-100] |" in lines["curve/plate-20"]
    assert "| 2 + 1 failed | 0 [0-66] | 0 [0-66] |" in lines["soil/slip_sinkage"]
    assert "0.90, 1.10 |" in lines["soil/slip_sinkage"]
    assert "| 8 | 7 [53-98] |" in lines["**all of curve**"]
    assert lines["curve/plate"].endswith("| 4 | 2 | 1 [9-91] |")
    assert "soil/slip_sinkage, seed 2: ValueError: no" in text


def test_a_trial_cut_short_or_failed_is_tried_again(tmp_path: Path) -> None:
    store = tmp_path / "trials.jsonl"
    whole = {"world": "soil/nothing", "seed": 0, "seconds": 1.0} | answer("adequate")
    failed = {"world": "soil/nothing", "seed": 1, "failed": "ValueError: no"}
    store.write_text("\n".join([json.dumps(whole), json.dumps(failed), '{"world": "soil/n']))
    assert stored(store) == {("soil/nothing", 0): whole}
    assert stored(tmp_path / "missing.jsonl") == {}


def test_fresh_errors_of_the_true_model_are_the_noise(tmp_path: Path) -> None:
    made = simulate_rig(RigSettings(seed=3, noise=0.0, soil_scatter=0.0, runs=12))
    truth = made.truth.soil
    model = Model(Soil("true", truth.k, truth.n, truth.m))
    errors = fresh_errors(model, read(measure(made.truth, made.truth.runs[:4]), tmp_path))
    assert set(errors) == {"sinkage", "resistance"}
    assert errors["sinkage"] < 1e-6
    soft = Model(Soil("soft", 0.5 * truth.k, truth.n, truth.m))
    assert fresh_errors(soft, read(made.table, tmp_path))["sinkage"] > 1e-3


def test_the_script_keeps_its_trials_and_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def run(*more: str) -> None:
        output = str(tmp_path / "rates.md")
        arguments = ["diagnosis_rates.py", "--worlds", "few/*", "--output", output, *more]
        monkeypatch.setattr("sys.argv", arguments)
        main()

    run("--seeds", "0:1")
    store = tmp_path / "rates.trials.jsonl"
    assert len(store.read_text().split()) > 0
    run("--seeds", "0:2", "--jobs", "2")
    kept = [json.loads(line) for line in store.read_text().splitlines() if line]
    assert [(one["world"], one["seed"]) for one in kept] == [
        ("few/5-runs-slip_sinkage", 0),
        ("few/5-runs-slip_sinkage", 1),
    ]
    assert "| few/5-runs-slip_sinkage | 2 | 2 [34-100] |" in (tmp_path / "rates.md").read_text()
    with pytest.raises(SystemExit) as stopped:
        run("--worlds", "soil/gravity")
    assert stopped.value.code == 2
    assert "no world is named 'soil/gravity'" in capsys.readouterr().err


def counted(world: str, seeds: range) -> dict[str, int]:
    """How many of the answers are right, wrong and so on."""
    found = [marks(WORLDS[world], trial(world, seed)) for seed in seeds]
    return {name: int(np.sum([one[name] for one in found])) for name in found[0]}


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [
        "slip_sinkage",
        "bulldozing",
        "penetration_rate",
        "load_dependent_modulus",
        "width_dependent_modulus",
        "multipass",
    ],
)
def test_a_hidden_effect_is_named_alone(name: str) -> None:
    found = counted(f"soil/{name}", range(7100, 7120))
    assert found["right"] >= 17
    assert found["wrong"] <= 1


@pytest.mark.slow
@pytest.mark.parametrize("world", ["soil/nothing", "poor/nothing", "lab/2x5-nothing"])
def test_nothing_hidden_gets_no_name(world: str) -> None:
    found = counted(world, range(7100, 7120))
    assert found["right"] >= 18
    assert found["wrong"] <= 1


@pytest.mark.slow
@pytest.mark.parametrize("world", ["tie/slip-load-slip_sinkage", "soil/unrecorded"])
def test_what_cannot_be_decided_gets_no_wrong_name(world: str) -> None:
    assert counted(world, range(7100, 7120))["wrong"] <= 1


@pytest.mark.slow
@pytest.mark.parametrize(
    "world", ["fault/load_offset=-4", "fault/sinkage_gain=0.1", "fault/rig_friction=0.06"]
)
def test_the_soil_is_not_blamed_for_an_instrument(world: str) -> None:
    assert counted(world, range(7100, 7120))["soil for instrument"] <= 1
