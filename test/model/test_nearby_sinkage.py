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
