# SPDX-License-Identifier: Apache-2.0
"""What sensors show of the soil's law: h of many stretches with its Jacobian, against the model itself.

Tests `model.py`.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from smallwheel_ros.effects.base import Effect
from smallwheel_ros.effects.registry import families
from smallwheel_ros.effects.slip import Exponential
from smallwheel_ros.model.model import Model, predict
from smallwheel_ros.onboard.prior import EstimatorSettings, SoilPrior
from smallwheel_ros.physics.conditions import Conditions
from smallwheel_ros.physics.soil import Soil, soil
from smallwheel_ros.physics.wheel import Wheel
from smallwheel_ros.pipeline.soil import model as law
from smallwheel_ros.pipeline.soil.model import LawModel, sinkage_of
from smallwheel_ros.pipeline.soil.stretches import Stretches
from smallwheel_ros.pipeline.tables import Array
from smallwheel_ros.simulate.truth import static_sinkage

PRIOR = SoilPrior.from_soil(soil("dry_sand"))
WHEELS = (
    Wheel("left", 0.4, 0.12, lateral_position=0.3),
    Wheel("right", 0.25, 0.1, lateral_position=-0.3),
)
REFERENCE = (60.0, 0.25, 0.1)
GIVEN = {"load", "diameter", "width", "slip", "speed"}  # what the streams say of a wheel
USABLE = [form for forms in families().values() for form in forms if not set(form().needs) - GIVEN]


def rows(**columns: float) -> Stretches:
    """One stretch of the right wheel, in the rut of another."""
    usual = dict.fromkeys(Stretches.__dataclass_fields__, 0.0)
    usual |= {
        "wheel": 1,
        "sinkage": 0.012,
        "load": 80.0,
        "load_rate": 0.4,
        "slip": 0.2,
        "speed": 0.3,
    }
    usual |= {"pitch": 0.08, "passes": 1.0, "onward": True}
    return Stretches(**{name: np.array([value]) for name, value in (usual | columns).items()})  # type: ignore[arg-type]


def model(effects: tuple[Effect, ...] = ()) -> LawModel:
    return LawModel(PRIOR, EstimatorSettings(), effects, WHEELS, REFERENCE)


def state(made: LawModel) -> Array:
    """A state with every fault in it."""
    x = made.mean.copy()
    x[: law.ZERO + 1] += 0.2, -0.1, 0.15, 0.2, 0.1, 0.05, 0.0, 0.8, 0.1, 0.01, 8e-4
    x[law.WHEELS :] = -3e-4, 0.04, 2e-4, -0.03
    return x


@pytest.mark.parametrize("effects", [(), (Exponential(a=0.7),)], ids=["plain", "slip sinkage"])
@pytest.mark.parametrize("wheel", [0, 1])
def test_the_row_of_h_is_its_slope(effects: tuple[Effect, ...], wheel: int) -> None:
    made, stretch = model(effects), rows(wheel=wheel)
    x = state(made)
    got = made.h(x, stretch)
    steps = np.full(len(x), 1e-4)
    steps[[law.PITCH, law.ZERO, *range(law.WHEELS, len(x), 2)]] = 1e-6
    for i, step in enumerate(steps):
        h = np.zeros(len(x))
        h[i] = step
        up, down = (made.h(x + sign * h, stretch).value[0] for sign in (1, -1))
        assert got.H[0, i] == pytest.approx((up - down) / (2 * step), rel=2e-3, abs=1e-7), i
    heavier = replace(stretch, load=stretch.load * math.exp(1e-4))
    slope = (made.h(x, heavier).value - got.value) / 1e-4
    assert got.by_load[0] == pytest.approx(slope[0], rel=1e-3)


def test_h_is_the_contact_integral_with_each_fault() -> None:
    made, stretch = model(), rows()
    clean = state(made)
    clean[law.PASS :] = 0.0
    pressure, n, m = made.law(clean)[0]

    def static(load: float) -> float:
        modulus = math.exp(pressure - n * math.log(0.01) + m * math.log(0.25 / 0.2))
        one = np.ones(1)
        z = static_sinkage(lambda depth: modulus * depth**n, load * one, 0.25 * one, 0.1 * one)
        return float(z[0])

    def shown(place: int | None = None, value: float = 0.0) -> float:
        y = clean.copy()
        if place is not None:
            y[place] = value
        return float(made.h(y, stretch).value[0])

    assert shown() == pytest.approx(static(80.0), rel=1e-6)
    assert shown(law.PASS, 0.2) == pytest.approx(static(80.0) * math.exp(0.2))
    assert shown(law.LOAD_SCALE, 0.05) == pytest.approx(static(80.0 * math.exp(-0.05)), rel=1e-6)
    assert shown(law.WHEELS + 3, 0.05) == pytest.approx(static(80.0 * math.exp(-0.05)), rel=1e-6)
    assert shown(law.SIDE, 0.1) == pytest.approx(static(80.0 * math.exp(0.1)), rel=1e-6)
    assert shown(law.LOAD_ZERO, 0.1) == pytest.approx(static(80.0 - 0.1 * REFERENCE[0]), rel=1e-6)
    assert shown(law.SLIP, 0.8) == pytest.approx(static(80.0) * (1.0 + 0.8 * 0.2))
    # The load rises: what is shown is that of a lighter wheel.
    assert shown(law.DELAY, 0.1) == pytest.approx(static(80.0 * math.exp(-0.1 * 0.4)), rel=1e-6)
    assert shown(law.PITCH, 0.01) == pytest.approx(static(80.0) + 0.01 * 0.08)
    assert shown(law.WHEELS + 2, 5e-4) == pytest.approx(static(80.0) + 5e-4)


def test_an_effect_of_the_model_takes_the_place_of_the_fault() -> None:
    assert model().soil_covariance[law.SLIP, law.SLIP] == 1.0
    assert model((Exponential(a=0.7),)).soil_covariance[law.SLIP, law.SLIP] < 1e-12


def test_the_prior_is_that_of_the_field() -> None:
    made = model()
    mean, jacobian = made.law(made.mean)
    np.testing.assert_allclose(mean, [PRIOR.log_reference_pressure, PRIOR.n, PRIOR.m])
    covariance = jacobian @ made.soil_covariance @ jacobian.T
    np.testing.assert_allclose(covariance, np.diag([0.49, 0.09, 0.16]), atol=1e-9)


@pytest.mark.parametrize("contact", ["rolling", "pressed"])
@pytest.mark.parametrize("form", [None, *USABLE], ids=str)
def test_the_sinkage_of_a_wheel_is_the_models(form: type[Effect] | None, contact: str) -> None:
    """With any effect that the streams have the inputs of, slopes included."""
    effects = () if form is None else (form(),)
    wheel = Wheel("one", 0.25, 0.08, contact)

    def shown(numbers: Array) -> float:
        log_modulus, n, m, log_load = numbers.tolist()
        conditions = Conditions.of(
            math.exp(log_load), wheel.diameter, wheel.width, contact=contact, slip=0.2, speed=0.15
        )
        kind = Soil("one", math.exp(log_modulus - m * math.log(0.2)), n, m)
        return float(predict(Model(kind, effects=effects), conditions).sinkage[0])

    at = np.array([math.log(1.6e6), 0.8, 0.39, math.log(70.0)])
    one = np.array([0.2]), np.array([0.15])
    got = sinkage_of(at[None, :3], np.array([70.0]), (wheel,), np.array([0]), effects, *one)
    assert got.value[0] == pytest.approx(shown(at), rel=1e-8)
    assert not got.sunk[0]
    for slope, step in zip(got.slopes[0], 1e-4 * np.eye(4), strict=True):
        either = shown(at + step) - shown(at - step)
        assert slope == pytest.approx(either / 2e-4, rel=1e-4, abs=1e-8)
