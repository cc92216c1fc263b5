# SPDX-License-Identifier: Apache-2.0
"""A zero of the shown sinkage, as pull and torque see it: named where they ask for it, and not else."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from plain_rig import table

from smallwheel_ros.diagnosis.faults import (
    _as_measured,
    _AsShown,
    _faults,
    _probability,
    gauge_fault,
)
from smallwheel_ros.effects.registry import default_registry, effect
from smallwheel_ros.fitting import Base, Problem
from smallwheel_ros.fitting.parameters import with_values
from smallwheel_ros.measurements.measurements import Measurements
from smallwheel_ros.model.model import Model, predict
from smallwheel_ros.physics.conditions import Conditions
from smallwheel_ros.simulate.truth import Circumstances
from smallwheel_ros.simulate.wheel_laws import RimStrength, Sand, Stresses, response_of

REGISTRY = default_registry()
ALL = ("sinkage", "drawbar_pull", "torque")


def measured(
    seed: int, zero: float = 0.0, runs: int = 12, channels: tuple[str, ...] = ALL
) -> Measurements:
    """Wheels on a sand whose stresses are integrated by trapezoids; zero: that the gauge shows too much."""
    rng = np.random.default_rng(seed)
    load, slip = 20.0 * 6.0 ** rng.uniform(size=runs), rng.uniform(0.02, 0.6, runs)
    diameter = rng.choice([0.2, 0.3], runs)
    at = Circumstances.of(load=load, diameter=diameter, width=0.1, slip=slip)
    k = 9e5 * np.exp(rng.normal(0.0, 0.03, runs))
    sand = Sand(k, 0.8, RimStrength(400.0, 0.55, 0.012), rim=1.0, dug=0.15)
    z, pull, torque = response_of(sand, at, Stresses())
    found = {
        "sinkage": (z + zero) * (1.0 + rng.normal(0.0, 0.02, runs)),
        "drawbar_pull": pull + 0.01 * load * rng.normal(size=runs),
        "torque": torque + 0.005 * load * diameter * rng.normal(size=runs),
    }
    names = [f"r{i}" for i in range(runs)]
    return table({c: found[c] for c in channels}, names, load=load, diameter=diameter, slip=slip)


def told(data: Measurements, without: tuple[str, ...] = ()) -> Any:
    return gauge_fault(Problem.of(data, Base()), REGISTRY, without)


def test_a_good_gauge_is_not_accused() -> None:
    for seed in (1, 2):
        assert told(measured(seed)) is None


def test_without_witnesses_nothing_is_said() -> None:
    assert told(measured(1, 0.03, channels=("sinkage",))) is None  # a soil can always imitate it
    assert told(measured(1, 0.03, channels=("drawbar_pull", "torque"))) is None
    assert told(measured(1, 0.03, runs=5)) is None


@pytest.mark.slow
def test_a_zero_that_pull_and_torque_ask_for_is_named_with_its_size() -> None:
    data = measured(3, 0.03, runs=60)
    found = told(data)
    assert found is not None
    assert found.part.id == found.informed.id == "sinkage_offset"
    (free,) = found.informed.parameters
    assert abs(free.prior.centre - 0.03) < 3.0 * free.prior.deviation < 0.012
    # Even odds of one effect in all families, times the evidence.
    odds = math.exp(found.evidence) / len(REGISTRY.families)
    assert found.probability == pytest.approx(odds / (1.0 + odds))
    assert told(data, ("sinkage_offset",)) is None


@pytest.mark.parametrize(("evidence", "probability"), [(0.0, 1 / 23), (math.log(22.0), 0.5)])
def test_before_any_evidence_one_of_all_effects_is_expected(
    evidence: float, probability: float
) -> None:
    assert _probability(evidence, 22) == pytest.approx(probability)
    assert _probability(1e6, 22) == pytest.approx(1.0)
    assert _probability(-math.inf, 22) == 0.0


def test_at_the_shown_sinkage_less_its_fault_the_wheel_stands_where_it_is() -> None:
    """shown = 1.2 z + 4 mm, taken apart; a wheel on the ground stands no higher than 0.1 mm in it."""
    shown = np.array([0.016, 0.028, 0.001])
    at = Conditions.of([40.0, 60.0, 80.0], 0.2, 0.1, shown_sinkage=shown)
    z = predict(Model("dry_sand") + _AsShown(), at).sinkage
    assert z == pytest.approx(shown)
    zero = _AsShown(with_values(effect("sinkage_offset"), {"offset": 0.004}))
    assert predict(Model("dry_sand") + zero, at).sinkage == pytest.approx([0.012, 0.024, 1e-4])
    gain = _AsShown(with_values(effect("sinkage_gain"), {"g": 0.25}))
    assert predict(Model("dry_sand") + gain, at).sinkage == pytest.approx(shown / 1.25)


def test_faults_are_of_one_number_of_the_gauge_and_those_left_out_are_none() -> None:
    assert {one.id for one in _faults(REGISTRY, ())} == {"sinkage_gain", "sinkage_offset"}
    assert {one.id for one in _faults(REGISTRY, {"sinkage_gain"})} == {"sinkage_offset"}


def test_only_rows_that_have_both_are_witnesses() -> None:
    data = measured(1)
    data.channels["sinkage"][[2, 5]] = np.nan
    data.channels["torque"][[5, 7]] = np.nan
    kept = _as_measured(Problem.of(data, Base()).points)
    assert set(kept.channels) == {"drawbar_pull", "torque"}
    places = {name: set(kept.row[kept.of_channel(name)].tolist()) for name in kept.channels}
    sunk = set(range(12)) - {2, 5}
    assert places == {"drawbar_pull": sunk, "torque": sunk - {7}}
    shown = kept.conditions["shown_sinkage"]
    assert shown[sorted(sunk)] == pytest.approx(data.channels["sinkage"][sorted(sunk)])
