# SPDX-License-Identifier: Apache-2.0
"""The slopes that the missing-effect test goes by, against the model itself."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from smallwheel_ros.effects.base import Effect
from smallwheel_ros.effects.registry import families
from smallwheel_ros.effects.slip import Exponential
from smallwheel_ros.model.model import Model, predict
from smallwheel_ros.model.nearby_sinkage import NearbySinkage
from smallwheel_ros.physics.conditions import Conditions
from smallwheel_ros.physics.contact import contact_load, contact_sinkage
from smallwheel_ros.physics.soil import soil

SAND = soil("dry_sand")
RNG = np.random.default_rng(1)
ROWS = 300
WHEELS = Conditions(
    RNG.uniform(30.0, 90.0, ROWS),
    RNG.choice([0.25, 0.35], ROWS),
    RNG.uniform(0.08, 0.14, ROWS),
    np.full(ROWS, "rolling"),
    None,
    {"slip": RNG.uniform(-0.2, 0.5, ROWS), "speed": RNG.uniform(0.1, 0.6, ROWS)},
)
FORMS = [
    form
    for forms in families().values()
    for form in forms
    if form.parameters() and all(name in WHEELS for name in form.needs)
]


def exact(law: object, *effects: Effect) -> np.ndarray:
    return np.log(predict(Model(law, effects=effects), WHEELS).sinkage)


@pytest.mark.parametrize("base", [(), (Exponential(a=0.7),)], ids=["plain", "slip sinkage"])
@pytest.mark.parametrize("form", FORMS, ids=lambda f: f"{f.id}.{f.form}")
def test_a_weak_effect_moves_sinkage_as_the_model_says(
    form: type[Effect], base: tuple[Effect, ...]
) -> None:
    first = form.parameters()[0]
    neutral = 0.0 if first.neutral is None else first.neutral
    weak = form(**{first.name: neutral + 2e-4 * (first.bounds[1] - neutral)})
    nearby = NearbySinkage(SAND, base, WHEELS)
    got = nearby.log_sinkage(SAND, weak) - nearby.log_sinkage(SAND)
    expected = exact(SAND, *base, weak) - exact(SAND, *base)
    np.testing.assert_allclose(got, expected, atol=1e-7 + 0.05 * np.abs(expected).max())


def test_the_soil_itself_is_exact_and_a_neighbour_nearly() -> None:
    nearby = NearbySinkage(SAND, (), WHEELS)
    np.testing.assert_allclose(nearby.log_sinkage(SAND), exact(SAND), rtol=1e-12)
    for law in (replace(SAND, n=SAND.n + 0.02), replace(SAND, m=SAND.m + 0.02)):
        got, expected = (f(law) - exact(SAND) for f in (nearby.log_sinkage, exact))
        np.testing.assert_allclose(got, expected, atol=0.03 * np.abs(expected).max())


def test_a_neighbour_of_soil_that_does_not_carry_the_wheels_is_near_to_its_extrapolation() -> None:
    heavy = replace(WHEELS, load=300.0 * WHEELS.load)
    assert predict(Model(SAND), heavy).immobilised.all()
    nearby = NearbySinkage(SAND, (), heavy)
    for law in (replace(SAND, n=SAND.n + 1e-3), replace(SAND, k=1.01 * SAND.k)):
        got, expected = (
            of(law) - of(SAND)
            for of in (
                nearby.log_sinkage,
                lambda soil: np.log(predict(Model(soil), heavy).sinkage),
            )
        )
        np.testing.assert_allclose(got, expected, rtol=0.01)


@pytest.mark.parametrize("form", [f for f in FORMS if "pressure_factor" in f.acts], ids=str)
@pytest.mark.filterwarnings("error")
def test_a_layer_shifts_wheels_beyond_the_axle_as_those_that_just_reach_it(
    form: type[Effect],
) -> None:
    first = form.parameters()[0]
    neutral = 0.0 if first.neutral is None else first.neutral
    weak = form(**{first.name: neutral + 2e-4 * (first.bounds[1] - neutral)})
    modulus = SAND.k * 0.25**SAND.m
    axle = float(contact_load(0.125, 0.25, 0.1, modulus, SAND.n))
    shifts = []
    for load in (axle * (1.0 - 1e-6), axle * (1.0 + 1e-6), 2.0 * axle, 300.0 * axle):
        wheel = Conditions(
            np.array([load]), np.array([0.25]), np.array([0.1]), np.array(["rolling"]), None, {}
        )
        nearby = NearbySinkage(SAND, (), wheel)
        shifts.append(float((nearby.log_sinkage(SAND, weak) - nearby.log_sinkage(SAND))[0]))
    slope = contact_sinkage(axle * (1.0 - 1e-6), 0.25, 0.1, modulus, SAND.n).slope_load
    at_axle = shifts[0] / float(slope) / (SAND.n + 0.5)
    np.testing.assert_allclose(shifts[1:], at_axle, rtol=1e-3)
