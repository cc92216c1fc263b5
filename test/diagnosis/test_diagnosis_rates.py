# SPDX-License-Identifier: Apache-2.0
"""What an answer counts as in `rates/run.py diagnosis`, and (slow) rates that it must keep."""

from __future__ import annotations

from typing import Any

import pytest

from rates.diagnosis import WORLDS, fresh_errors, marks, read, same_answer, trial
from smallwheel_ros.model.model import Model
from smallwheel_ros.physics.soil import Soil
from smallwheel_ros.simulate import RigSettings, measure, simulate_rig


def answer(verdict: str, named: list[str] | None = None, *candidates: str) -> dict[str, Any]:
    return {"verdict": verdict, "missing_effects": named or [], "candidates": list(candidates)}


@pytest.mark.parametrize(
    ("world", "given", "true"),
    [
        ("soil/nothing", answer("adequate"), {"right"}),
        ("soil/nothing", answer("unknown_effect"), set()),
        ("soil/nothing", answer("missing_effect", ["multipass"]), {"wrong"}),
        ("soil/nothing", answer("indistinguishable", [], "a", "b"), set()),
        ("soil/unrecorded", answer("unknown_effect"), {"right"}),
        ("soil/slip_sinkage", answer("missing_effect", ["slip_sinkage"]), {"right", "listed"}),
        (
            "soil/slip_sinkage",
            answer("missing_effect", ["slip_sinkage", "hardpan"]),
            {"listed", "wrong"},
        ),
        (
            "soil/slip_sinkage",
            answer("indistinguishable", [], "slip_sinkage", "multipass"),
            {"listed"},
        ),
        ("soil/slip_sinkage", answer("adequate"), set()),
        (
            "soil/slip_sinkage+multipass",
            answer("missing_effect", ["multipass"], "slip_sinkage", "grouser"),
            {"listed"},
        ),
        (
            "tie/slip-load-slip_sinkage",
            answer("indistinguishable", [], "slip_sinkage", "load_dependent_modulus"),
            {"right", "listed"},
        ),
        ("few/5-runs-slip_sinkage", answer("insufficient_data"), {"right"}),
        (
            "fault/load_offset=-4",
            answer("missing_effect", ["bulldozing"]),
            {"wrong", "blamed"},
        ),
        ("fault/load_offset=-4", answer("missing_effect", ["load_gain"]), {"wrong"}),
        (
            "soil/slip_sinkage+sinkage_offset",
            answer("missing_effect", ["slip_sinkage", "sinkage_offset"]),
            {"right", "listed"},
        ),
        (
            "poor/column:density",
            answer("missing_effect", ["covariate:density"]),
            {"right", "listed"},
        ),
    ],
)
def test_what_an_answer_counts_as(world: str, given: dict[str, Any], true: set[str]) -> None:
    assert {name for name, value in marks(WORLDS[world], given).items() if value} == true


def test_answers_at_several_densities_are_compared_by_seed() -> None:
    def line(rows: int, seed: int, verdict: str) -> dict[str, Any]:
        return {"world": f"curve/plate-{rows}", "seed": seed, "verdict": verdict, "named": []}

    lines = [line(3, 0, "adequate"), line(20, 0, "adequate"), line(3, 1, "adequate")]
    lines += [line(20, 1, "unknown_effect"), line(3, 2, "adequate")]
    found = same_answer(lines)
    assert found is not None
    assert (found.value, found.count) == (0.5, 2)


def test_fresh_errors_of_the_true_model_are_the_noise() -> None:
    made = simulate_rig(RigSettings(seed=3, noise=0.0, soil_scatter=0.0, runs=12))
    truth = made.truth.soil
    model = Model(Soil("true", truth.k, truth.n, truth.m))
    errors = fresh_errors(model, read(measure(made.truth, made.truth.runs[:4])))
    assert set(errors) == {"sinkage", "resistance"}
    assert errors["sinkage"] < 1e-6
    soft = Model(Soil("soft", 0.5 * truth.k, truth.n, truth.m))
    assert fresh_errors(soft, read(made.table))["sinkage"] > 1e-3


def counted(world: str, seeds: range) -> dict[str, int]:
    """How many of the answers are right, name what is not hidden, or blame the soil for an instrument."""
    found = [trial(world, seed) for seed in seeds]
    return {name: sum(one[name] for one in found) for name in ("right", "wrong", "blamed")}


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
    assert counted(world, range(7100, 7120))["blamed"] <= 1
