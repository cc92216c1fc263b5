# SPDX-License-Identifier: Apache-2.0
"""Wheels on the soil under them: sinkage, resistances and covariance against the model, for many at once.

Tests `contact.py`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from random_examples import examples

from smallwheel_ros.effects.base import Effect, WheelState
from smallwheel_ros.effects.instruments import LoadGain
from smallwheel_ros.effects.slip import Exponential
from smallwheel_ros.effects.soil import PrestonThomas
from smallwheel_ros.model.model import Model, predict
from smallwheel_ros.physics.conditions import Conditions
from smallwheel_ros.physics.soil import soil
from smallwheel_ros.physics.wheel import Quantity, Strength, Wheel
from smallwheel_ros.pipeline.soil.local_law import LocalLaws
from smallwheel_ros.pipeline.strength.contact import OnSoil, on_soil
from smallwheel_ros.pipeline.tables import Array

WHEEL = Wheel("front_left", 0.25, 0.10)
STRENGTH = Strength(Quantity(500.0, 100.0), Quantity(0.52, 0.03), Quantity(0.015, 0.001))
SAND = soil("dry_sand")


@dataclass(frozen=True)
class Lugged(Effect):
    """Lugs that add thrust, and throw soil."""

    id = "lugged"

    def thrust_factor(self, state: WheelState, conditions: Conditions) -> float:
        return 1.2

    def added_resistance(self, state: WheelState, conditions: Conditions) -> float:
        return 3.0


def laws(*numbers: tuple[float, float, float]) -> LocalLaws:
    """Of ln pressure, n and m, each with a deviation of 0.1."""
    covariance = np.zeros((len(numbers), 5, 5))
    covariance[:, range(3), range(3)] = 0.01
    nothing = np.zeros(len(numbers))
    return LocalLaws(np.array(numbers), nothing, nothing, covariance)


def put(
    wheel: Wheel = WHEEL,
    law: tuple[float, float, float] = (SAND.log_reference_pressure, SAND.n, SAND.m),
    load: float = 60.0,
    load_std: float = 1.5,
    effects: tuple[Effect, ...] = (),
    slip: float = 0.2,
) -> OnSoil:
    return on_soil(
        (wheel,), np.array([0]), laws(law), np.array([load]), np.array([load_std]), scatter=0.05,
        effects=effects, slip=np.array([slip]), strength=STRENGTH,
    )  # fmt: skip


def test_values_are_those_of_the_model() -> None:
    expected = predict(Model(SAND), Conditions.of(60.0, 0.25, 0.10, slip=0.2))
    on = put()
    assert on.sinkage == pytest.approx(expected.sinkage, rel=1e-10)
    assert on.compaction == pytest.approx(expected.compaction_resistance, rel=1e-10)
    assert on.other.tolist() == [0.0]
    deeper = put(effects=(Exponential(a=1.5),))
    assert deeper.sinkage == pytest.approx(on.sinkage * math.exp(0.3), rel=1e-9)
    lugs = put(effects=(Lugged(),))
    assert (lugs.factor[0], lugs.other[0]) == pytest.approx((1.2, 3.0))
    shown = put(load=75.0, load_std=1.5 * 1.25, effects=(LoadGain(g=0.25),))
    assert shown.compaction == pytest.approx(on.compaction, rel=1e-9)


def test_deviations_are_those_of_samples() -> None:
    on, rng = put(), np.random.default_rng(5)
    spread = np.diag([0.1**2 + 0.05**2, 0.01, 0.01])
    mean = SAND.log_reference_pressure, SAND.n, SAND.m
    drawn = rng.multivariate_normal(mean, spread, 3000)
    load = rng.normal(60.0, 1.5, len(drawn))
    many = on_soil(
        (WHEEL,), np.zeros(len(drawn), dtype=int), laws(*map(tuple, drawn)), load, np.zeros(len(drawn)),
        scatter=0.0,
    )  # fmt: skip
    for name in ("sinkage", "compaction"):
        stated = float(np.sqrt(on.variance(**{name: 1.0}))[0])
        # 3000 draws know a deviation to 1.3 %; what the law bends is a few per cent.
        assert stated == pytest.approx(float(np.std(getattr(many, name))), rel=0.1), name


def test_a_pressed_wheel_meets_the_soil_on_both_sides() -> None:
    made = put(replace(WHEEL, contact="pressed"), load=120.0)
    assert made.sinkage == pytest.approx(put(load=60.0).sinkage)
    assert made.compaction.tolist() == [0.0]


def test_sunk_to_the_axle_is_said() -> None:
    assert put(load=1e6).sunk.all()
    assert put(load=1e6, effects=(Exponential(a=1.0),)).sunk.all()
    assert not put().sunk.any()


@settings(max_examples=examples(40), deadline=None)
@given(
    wheels=st.lists(
        st.tuples(
            st.floats(0.1, 0.5),
            st.sampled_from(["rolling", "pressed"]),
            st.floats(0.3, 1.5),
            st.floats(1.0, 5e3),
            st.floats(-0.5, 0.9),
        ),
        min_size=1,
        max_size=5,
    ),
    effects=st.sampled_from([(), (Lugged(),), (PrestonThomas(c=10.0), LoadGain(g=0.1))]),
)
def test_wheels_together_are_as_each_alone(
    wheels: list[tuple[float, str, float, float, float]], effects: tuple[Effect, ...]
) -> None:
    """Of other sizes, on other soils, sunk to the axle or not."""
    made = tuple(Wheel(str(i), d, 0.4 * d, contact=c) for i, (d, c, *_) in enumerate(wheels))
    kinds = [(SAND.log_reference_pressure, n, SAND.m) for _, _, n, _, _ in wheels]
    load, slip = (np.array([row[i] for row in wheels]) for i in (3, 4))
    together = on_soil(
        made, np.arange(len(made)), laws(*kinds), load, 0.02 * load, scatter=0.05, effects=effects,
        slip=slip, strength=STRENGTH,
    )  # fmt: skip
    for i, wheel in enumerate(made):
        alone = put(wheel, kinds[i], load[i], 0.02 * load[i], effects, slip[i])
        assert together.sunk[i] == alone.sunk[0]
        if together.sunk[i]:
            continue
        for field in fields(OnSoil):
            if field.name in ("wheel", "covariance", "own"):
                continue
            expected = pytest.approx(getattr(alone, field.name)[0], rel=1e-9, nan_ok=True)
            assert getattr(together, field.name)[i] == expected, field.name
        spread = alone.covariance[0]
        np.testing.assert_allclose(
            together.covariance[i], spread, rtol=1e-5, atol=1e-7 * spread.max()
        )


@settings(max_examples=examples(60), deadline=None)
@given(
    n=st.floats(0.1, 2.0),
    m=st.floats(-1.0, 1.0),
    pressure=st.floats(2e3, 2e5),
    load=st.floats(1.0, 300.0),
    contact=st.sampled_from(["rolling", "pressed"]),
)
def test_slopes_agree_with_differences_of_the_model(
    n: float, m: float, pressure: float, load: float, contact: str
) -> None:
    given = replace(WHEEL, contact=contact), (math.log(pressure), n, m), load, 1.0
    analytical = put(*given)
    # An effect of size zero changes nothing, but sends the work through the model.
    numerical = put(*given, effects=(Exponential(a=0.0),))
    assert analytical.sunk[0] == numerical.sunk[0]
    if analytical.sunk[0]:
        return
    for name in ("sinkage", "compaction", "other", "reaching"):
        expected = pytest.approx(getattr(numerical, name)[0], rel=1e-9, abs=1e-12)
        assert getattr(analytical, name)[0] == expected, name
    size: Array = np.sqrt(np.diag(numerical.covariance[0])) + 1e-12
    got, expected = (on.covariance[0] / np.outer(size, size) for on in (analytical, numerical))
    np.testing.assert_allclose(got, expected, atol=1e-5)  # differences are not more exact
