# SPDX-License-Identifier: Apache-2.0
"""What counts as evidence: runs and not rows, every channel for itself, and one verdict for all commands.

Tests `apply.py`, `competitors.py`, `held_out.py`, `pipeline.py` and `posterior.py`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fitted import fit_model
from plain_rig import PlainRig, PlainSoil, rolled, table

from rates.diagnosis import WORLDS
from smallwheel_ros.api.add import add
from smallwheel_ros.api.diagnose import diagnose
from smallwheel_ros.diagnosis.competitors import field_of
from smallwheel_ros.diagnosis.held_out import _evidence_alone
from smallwheel_ros.effects.base import Array, Effect, EffectError, parameter
from smallwheel_ros.effects.registry import default_registry, effect
from smallwheel_ros.fitting import Base, Problem
from smallwheel_ros.fitting.held_out import CvErrors
from smallwheel_ros.fitting.problem import base_of
from smallwheel_ros.measurements.from_file import read_measurements
from smallwheel_ros.measurements.measurements import Measurements
from smallwheel_ros.model.model import predict
from smallwheel_ros.physics.conditions import Conditions
from smallwheel_ros.simulate import RigSettings, simulate_rig, write_table

DIGGING = PlainRig(slip_growth=2.0)


# What the model has already


@pytest.mark.parametrize("strength", [0.5, pytest.param(4.0, marks=pytest.mark.slow)])
def test_an_effect_of_the_model_is_found_to_have_another_strength(strength: float) -> None:
    base = Base(effects=(effect("slip_sinkage", "quadratic", s=strength, q=0.0),))
    found = diagnose(DIGGING.measure(rolled(0, 14), 1), base).document
    assert found["missing_effects"] == ["slip_sinkage"]
    row = found["ranking"][0]
    assert "the model has it, with another strength or law" in row["reason"]
    errors = [step["held_out_rmse"]["sinkage"] for step in found["steps"]]
    assert errors[1] < 0.6 * errors[0]


def test_a_model_that_has_the_effect_as_it_is_lacks_nothing() -> None:
    base = Base(effects=(effect("slip_sinkage", "quadratic", s=2.0, q=0.0),))
    assert diagnose(DIGGING.measure(rolled(0), 1), base).document["verdict"] == "adequate"


# An effect of the user's own


@dataclass(frozen=True)
class Packing(Effect):
    id = "packing"
    summary = "Soil under a heavier wheel packs and becomes firmer."
    formula = "k (W / 60 N)^a"
    source = "this test"
    drivers = ("load",)

    a: float = parameter(0.2, (-2.0, 2.0), "packing")

    def modulus_factor(self, conditions: Conditions) -> Array:
        return np.asarray((conditions.load / 60.0) ** self.a)


@pytest.mark.parametrize("tie", [(), ("slip", "load")])
def test_an_effect_of_ones_own_that_follows_the_load_has_its_ties(
    tmp_path: Path, tie: tuple[str, ...]
) -> None:
    registry = default_registry().with_families({"packing": (Packing,)}, "this test")
    settings = RigSettings(seed=2, hidden=("load_dependent_modulus",), runs=20, tie=tie)
    write_table(simulate_rig(settings).table, tmp_path / "rig.csv")
    measured = read_measurements(tmp_path / "rig.csv")
    out = ("load_dependent_modulus", "unknown")
    found = diagnose(measured, effects=registry, without=out).document
    if tie:
        assert found["verdict"] == "indistinguishable"
        assert {"packing", "slip_sinkage"} <= set(found["candidates"])
        assert "varied together" in found["reason"]
    else:
        assert found["missing_effects"] == ["packing"]


# A channel whose law is wrong


def hump(load: Array, slip: Array) -> Array:
    """Thrust that is largest at slip 0.3 and falls beyond, as no law of the library does."""
    x = slip / 0.3
    return np.asarray(0.6 * load * x * np.exp(1.0 - x) - 0.1 * load)


def against(load: Array, slip: Array) -> Array:
    """A sensor mounted the wrong way round: it shows the load as resistance."""
    return -load


def with_pull(growth: float, pull: Any) -> tuple[Measurements, Measurements]:
    measured = PlainRig(slip_growth=growth, channels=("sinkage",)).measure(rolled(3), 2)
    at, noise = measured.conditions, np.random.default_rng(0).normal(size=len(measured))
    pulled = pull(at.load, at["slip"]) * (1.0 + 0.03 * noise)
    both = table(
        {**measured.channels, "drawbar_pull": pulled},
        measured.run,
        load=at.load,
        diameter=at.diameter,
        **at.covariates,
    )
    return measured, both


@pytest.mark.parametrize(
    ("growth", "pull"),
    [
        pytest.param(0.0, hump, marks=pytest.mark.slow),
        (0.0, against),
        pytest.param(2.0, hump, marks=pytest.mark.slow),
    ],
)
def test_a_wrong_law_of_pull_does_not_decide_about_sinkage(growth: float, pull: Any) -> None:
    alone, both = with_pull(growth, pull)
    without, found = diagnose(alone).document, diagnose(both).document
    for key in ("verdict", "missing_effects", "candidates", "run_scatter"):
        assert found[key] == without[key]
    for first, second in zip(without["steps"], found["steps"], strict=True):
        # The error is of the model that a command writes, which is fitted to pull too: a law of pull
        # as wrong as these costs the sinkage up to 3 %.
        assert second["held_out_rmse"]["sinkage"] == pytest.approx(
            first["held_out_rmse"]["sinkage"], rel=0.05
        )
        assert "drawbar_pull" in second["held_out_rmse"]
    said = found["channels"]["drawbar_pull"]["finding"]
    assert ("look at its sign" in said) == (pull is against)
    assert ("about as far as its law usually is" in said) == (pull is not against)


# Rows of a curve


def curves(rows: int, seed: int) -> Measurements:
    """Nine plate curves of the exact law with smooth deviations of 6 %, sampled thinly or densely."""
    keep = np.round(np.linspace(0, 299, rows)).astype(int)
    depth = np.linspace(1e-3, 30e-3, 300)
    load, shown, size, name = [], [], [], []
    for number in range(9):
        rng = np.random.default_rng([seed, number])
        diameter = (0.05, 0.10, 0.15)[number // 3]
        frequency, phase = rng.normal(0.0, 1.4, 40), rng.uniform(0.0, 2 * np.pi, 40)
        wave = np.cos(np.log(depth)[:, None] * frequency + phase).sum(axis=1) * np.sqrt(2 / 40)
        pressure = 900e3 * depth**0.8 * np.exp(0.06 * wave + 0.03 * rng.normal())
        area = np.pi / 4 * diameter**2
        load.append((area * pressure * (1 + 0.005 * rng.normal(size=300)))[keep])
        shown.append((depth + 3e-5 * rng.normal(size=300))[keep])
        size += [diameter] * rows
        name += [f"curve {number}"] * rows
    return table(
        {"sinkage": np.concatenate(shown)},
        name,
        load=np.concatenate(load),
        diameter=np.array(size),
        width=0.1,
        contact="plate",
    )


@pytest.mark.parametrize(
    "seed", [0, *(pytest.param(s, marks=pytest.mark.slow) for s in range(1, 6))]
)
def test_curves_of_the_exact_law_are_adequate_at_each_density(seed: int) -> None:
    words = [diagnose(curves(rows, seed)).document["verdict"] for rows in (3, 20, 100)]
    assert words == ["adequate"] * 3


# A fold that can only extrapolate has no say against evidence


@pytest.mark.parametrize(
    ("slips", "better", "alone"),
    [
        ((0.25, 0.5, 0.8), (), True),  # each is beyond the others, or alone between them
        ((0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8), (), False),
        ((0.25, 0.25, 0.25, 0.8), (), False),  # three runs that have a say, and say nothing
        ((0.25, 0.25, 0.25, 0.8), (0.25,), True),
    ],
)
def test_a_fold_that_can_only_extrapolate_has_no_say(
    slips: tuple[float, ...], better: tuple[float, ...], alone: bool
) -> None:
    runs = [{"load": load, "slip": 0.0} for load in (20.0, 40.0, 60.0, 80.0)]
    runs += [{"load": 60.0 + i, "slip": slip} for i, slip in enumerate(slips)]
    problem = Problem.of(DIGGING.measure(runs, 3))
    model = problem.vector.model(problem.vector.start)
    field = field_of(problem.points, model, default_registry())
    law = next(c for c in field.competitors if c.family == "slip_sinkage")
    slip, row = (
        problem.points.measurements.conditions["slip"],
        np.arange(len(problem.points.measurements)),
    )
    before = CvErrors({"sinkage": 1.0 + 0.01 * (row % 3)}, row // 3)
    after = CvErrors(
        {"sinkage": before.error["sinkage"] * np.where(slip == 0.8, 3.0, 1.0)}, row // 3
    )
    helped = after.error["sinkage"] * np.where(np.isin(slip, better), 0.1, 1.0)
    assert (
        _evidence_alone(problem.points, law, before, CvErrors({"sinkage": helped}, row // 3))
        is alone
    )


@pytest.mark.parametrize(
    ("skids", "alone"), [((0.15, 0.45, 0.9), True), ((0.15, 0.3, 0.45, 0.6, 0.7, 0.8, 0.9), False)]
)
def test_three_skids_far_apart_are_named_by_evidence_and_what_settles_it_is_said(
    skids: tuple[float, ...], alone: bool
) -> None:
    """Sinkage that rises steeply: from two of three skids the third cannot be predicted."""
    runs = [{"load": load, "slip": 0.0} for load in (20.0, 30.0, 45.0, 65.0, 90.0, 120.0)]
    runs += [{"load": 40.0 + 20.0 * (i % 3), "slip": -skid} for i, skid in enumerate(skids)]
    rig = PlainRig().measure(runs, 1)
    depth = rig.channels["sinkage"] * np.exp(1.2 * np.abs(rig.conditions["slip"]) ** 4)
    found = diagnose(Measurements(rig.conditions, {"sinkage": depth}, rig.run, rig.wheel, rig.line))
    assert found.missing_effects == ["skid_sinkage"]
    reason = found.document["reason"]
    assert ("skid sinkage is named by evidence alone" in reason) is alone
    assert ("measure at further values of slip between these" in reason) is alone


# One verdict for diagnose and add


def test_what_is_recommended_is_what_is_named() -> None:
    measured = DIGGING.measure(rolled(0, 14), 1)
    right, wrong = (add(name, Base(), measured) for name in ("slip_sinkage", "bulldozing"))
    assert right.recommended
    assert not wrong.recommended
    assert "favours slip_sinkage" in wrong.reason


def test_one_step_has_one_error_whatever_command_asks() -> None:
    measured = DIGGING.measure(rolled(0, 14), 1)
    judged, added = diagnose(measured), add("slip_sinkage", Base(), measured)
    before, after = (step.errors.rmse() for step in judged.steps)
    assert (added.before.rmse(), added.after.rmse()) == (before, after)
    base = judged.problem.held_out()
    assert base is not None
    assert base.rmse() == pytest.approx(before, rel=1e-9)


@pytest.mark.slow
def test_beside_pull_too_one_step_has_one_error(tmp_path: Path) -> None:
    write_table(WORLDS["pull/rim-without-R-slip_sinkage"].table(3, 0), tmp_path / "rig.csv")
    measured = read_measurements(tmp_path / "rig.csv")
    assert set(measured.channels) == {"sinkage", "drawbar_pull"}
    judged, added = diagnose(measured), add("slip_sinkage", Base(), measured)
    errors = [step.errors.rmse() for step in judged.steps]
    assert [added.before.rmse(), added.after.rmse()] == errors
    base = Problem.of(measured).held_out()
    assert base is not None
    assert base.rmse() == pytest.approx(errors[0], rel=1e-9)
    # An effect that is not named passes the same function: its error before is the same number.
    other = add("hardpan", Base(), measured)
    assert other.before.rmse() == pytest.approx(errors[0], rel=1e-9)


@pytest.mark.parametrize(
    "name", ["sinkage_gain", pytest.param("slip_sinkage", marks=pytest.mark.slow)]
)
def test_noise_is_not_recommended(name: str) -> None:
    """Nothing is hidden; what is not named is not recommended, whatever the fit gains."""
    added = add(name, Base(), PlainRig().measure(rolled(0, 12), 2))
    assert not added.recommended
    assert "not recommended" in added.reason


@pytest.mark.slow
def test_what_makes_one_channel_worse_is_not_recommended(tmp_path: Path) -> None:
    rig = simulate_rig(RigSettings(seed=5, hidden=("slip_resistance=0.5",), runs=20))
    write_table(rig.table, tmp_path / "rig.csv")
    measured = read_measurements(tmp_path / "rig.csv")
    kinds = default_registry().families
    out = (*(n for n, forms in kinds.items() if forms[0].kind == "instrument"), "unknown")
    added = add("slip_sinkage", Base(), measured, without=out)
    assert added.change.worse == ("sinkage",)
    assert not added.recommended


def test_an_effect_that_the_data_cannot_have_is_refused() -> None:
    with pytest.raises(EffectError, match="grouser_height"):
        add("grouser", Base(), PlainRig().measure(rolled(0, 8), 1))


# What is reported is what fresh runs show


def reported_over_fresh(growth: float, seeds: range, runs: int) -> Mapping[str, list[float]]:
    ratios: dict[str, list[float]] = {}
    for seed in seeds:
        rig = PlainRig(PlainSoil(n=0.7 + 0.02 * (seed % 10)), slip_growth=growth)
        found = diagnose(rig.measure(rolled(seed, runs), seed))
        fresh = rig.measure(rolled(seed + 10_000, 200), seed + 10_000)
        said = predict(found.fitted(len(found.steps) - 1).model, fresh.conditions)
        for name, measured in fresh.channels.items():
            error = float(np.sqrt(np.mean((getattr(said, name) - measured) ** 2)))
            reported = found.document["steps"][-1]["held_out_rmse"][name]
            ratios.setdefault(name, []).append(reported / error)
    return ratios


@pytest.mark.parametrize(
    ("growth", "seeds", "off"),
    [
        (0.0, range(2), 0.2),
        pytest.param(0.0, range(100, 112), 0.1, marks=pytest.mark.slow),
        pytest.param(2.0, range(100, 112), 0.1, marks=pytest.mark.slow),
    ],
)
def test_the_reported_error_is_that_of_fresh_runs(growth: float, seeds: range, off: float) -> None:
    """After the choice of an effect too, as with growth 2."""
    ratios = reported_over_fresh(growth, seeds, 24)
    for values in ratios.values():
        assert 1.0 - off < np.mean(values) < 1.05 + off


# A real rig


@pytest.fixture(scope="module")
def real_rig(shared_data: Path) -> tuple[Measurements, Base]:
    """A smooth wheel at all slip angles, in soil that is known from the wheel pressed straight down."""
    folder = shared_data / "cmu_wheel_rig"
    whole = read_measurements(folder / "indentation.csv")
    pressed = whole.take(whole.conditions.contact == "pressed")
    rolling = read_measurements(folder / "rolling_smooth_wheel.csv")
    return rolling, base_of(fit_model(pressed).model, rolling)


def test_the_real_wheel_at_slip_angle_none(real_rig: tuple[Measurements, Base]) -> None:
    rolling, base = real_rig
    assert base.priors
    straight = rolling.take(np.abs(rolling.conditions["slip_angle"]) < 0.01)
    found = diagnose(straight, base).document
    assert set(found["missing_effects"]) == {"slip_sinkage", "skid_sinkage"}
    errors = [step["held_out_rmse"]["sinkage"] for step in found["steps"]]
    assert 0.011 < errors[0] < 0.016
    assert errors[-1] < 0.0015
    untested = {r["effect"] for r in found["ranking"] if r["status"] == "not_testable"}
    assert {"width_dependent_modulus", "multipass"} <= untested


@pytest.mark.slow
def test_the_real_wheel_at_all_slip_angles(real_rig: tuple[Measurements, Base]) -> None:
    found = diagnose(*real_rig).document
    named = {"slip_angle_sinkage", "skid_sinkage", "slip_sinkage"}
    assert set(found["missing_effects"]) == named
    errors = [step["held_out_rmse"]["sinkage"] for step in found["steps"]]
    assert errors[0] > 0.012
    assert errors[-1] < 0.003
    assert any("deeper than its axle" in note for note in found["notes"])
    assert any("drawbar_pull of " in note for note in found["notes"])
