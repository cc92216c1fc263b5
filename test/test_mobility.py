from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from random_examples import examples

from smallwheel_ros.effects.slip_sinkage import Exponential
from smallwheel_ros.estimator.identifiability import SoilEstimate, Variety
from smallwheel_ros.estimator.law_covariance import LawCovariance
from smallwheel_ros.model import Model, predict
from smallwheel_ros.onboard.force_gradients import force_gradients
from smallwheel_ros.onboard.mobility import MobilityError, WheelForces, wheel_forces
from smallwheel_ros.physics.conditions import Conditions
from smallwheel_ros.physics.soil import REFERENCE_DIAMETER, REFERENCE_SINKAGE, Soil, soil
from smallwheel_ros.physics.wheel import Quantity, Strength, Wheel, wheel_slip

WHEEL = Wheel("front_left", 0.25, 0.10)
STRENGTH = Strength(Quantity(500.0, 100.0), Quantity(0.52, 0.03), Quantity(0.015, 0.001))


def estimate(kind: Soil, deviations: tuple[float, float, float], correlation: float = 0.0):
    covariance = np.diag(np.square(deviations))
    covariance[0, 1] = covariance[1, 0] = correlation * deviations[0] * deviations[1]
    law = LawCovariance.of(covariance)
    return SoilEstimate(
        k=kind.k,
        n=kind.n,
        m=kind.m,
        log_reference_pressure=kind.log_reference_pressure,
        law_covariance=law,
        prior=law,
        reference_sinkage=REFERENCE_SINKAGE,
        reference_diameter=REFERENCE_DIAMETER,
        variety=Variety(),
        accepted=1,
        outliers=0,
        refused={},
        soil_changes=0,
        distance=0.0,
    )


SAND = estimate(soil("dry_sand"), (0.05, 0.05, 0.1), -0.4)


def sample(
    mean: SoilEstimate,
    load: Quantity,
    slip: Quantity,
    strength: Strength,
    scatter: float = 0.0,
    contact: str = "rolling",
    count: int = 4000,
) -> dict[str, np.ndarray]:
    """The forces of many soils, loads and slips drawn from what is known of them, by the model."""
    rng = np.random.default_rng(5)
    covariance = mean.log_covariance + np.diag([scatter**2, 0.0, 0.0])
    centre = [mean.log_reference_pressure, mean.n, mean.m]
    laws = rng.multivariate_normal(centre, covariance, count)
    single = [load, slip, strength.cohesion, strength.friction_angle, strength.shear_displacement]
    w, i, c, phi, kappa = (rng.normal(q.value, q.standard_deviation, count) for q in single)
    base = Soil("base", 1.0, 1.0)
    soils = [
        replace(
            base.with_parameters(*law),
            name=str(row),
            cohesion=c[row],
            friction_angle=phi[row],
            shear_displacement=kappa[row],
        )
        for row, law in enumerate(laws)
    ]
    names = [s.name for s in soils]
    conditions = Conditions.of(w, 0.25, 0.10, contact=contact, soil=names, slip=i)
    predicted = predict(Model(soils), conditions)
    return {
        "sinkage": predicted.sinkage,
        "compaction_resistance": predicted.compaction_resistance,
        "rolling_resistance_coefficient": predicted.resistance / w,
        "thrust": predicted.thrust,
        "drawbar_pull": predicted.drawbar_pull,
        "energy_per_metre": predicted.thrust * np.where(i >= 0, 1 / (1 - i), 1 + i),
    }


class TestForces:
    load, slip = Quantity(60.0, 1.5), Quantity(0.2, 0.01)

    def forces(self, **changes) -> WheelForces:
        arguments = {"load": self.load, "slip": self.slip, "scatter": 0.03, **changes}
        made = wheel_forces(WHEEL, SAND, STRENGTH, **arguments)
        assert made is not None
        return made

    def test_values_are_those_of_the_model(self) -> None:
        made = self.forces()
        sand = replace(
            soil("dry_sand"), cohesion=500.0, friction_angle=0.52, shear_displacement=0.015
        )
        expected = predict(Model(sand), Conditions.of(60.0, 0.25, 0.10, slip=0.2))
        assert made.sinkage.value == pytest.approx(expected.sinkage[0], rel=1e-10)
        compaction = made.compaction_resistance.value
        assert compaction == pytest.approx(expected.compaction_resistance[0], rel=1e-10)
        assert made.other_resistance == Quantity(0.0, 0.0)
        assert made.rolling_resistance_coefficient.value == pytest.approx(compaction / 60.0)
        assert made.thrust.value == pytest.approx(expected.thrust[0], rel=1e-10)
        assert made.drawbar_pull.value == pytest.approx(expected.drawbar_pull[0], rel=1e-10)

    @pytest.mark.parametrize("slip", [Quantity(0.2, 0.01), Quantity(-0.15, 0.01)])
    def test_deviations_are_those_of_samples(self, slip: Quantity) -> None:
        made = self.forces(slip=slip)
        drawn = sample(SAND, self.load, slip, STRENGTH, scatter=0.03)
        for name, values in drawn.items():
            quantity = getattr(made, name)
            # 4000 samples know a standard deviation to 1.1 %; the first order adds a little.
            assert quantity.standard_deviation == pytest.approx(np.std(values), rel=0.06), name
        share = np.mean(drawn["drawbar_pull"] > 0)
        assert made.probability_drawbar_pull_positive == pytest.approx(share, abs=0.02)

    def test_margin_is_the_pull_at_the_reference_slip_over_the_load(self) -> None:
        drawn = sample(SAND, self.load, Quantity(0.3, 0.0), STRENGTH, scatter=0.03)
        share = drawn["drawbar_pull"] / 60.0
        for slip in (self.slip, Quantity(-0.4, 0.1), None):
            made = self.forces(slip=slip, reference_slip=0.3)
            assert made.margin.value == pytest.approx(np.median(share), abs=0.005)
            assert made.margin.standard_deviation == pytest.approx(np.std(share), rel=0.06)
            slope = made.steepest_slope
            assert math.tan(slope.value) == pytest.approx(made.margin.value)
            up = math.atan(made.margin.value + made.margin.standard_deviation)
            assert slope.standard_deviation == pytest.approx(up - slope.value, rel=0.03)

    def test_an_effect_of_slip_is_in_the_margin(self) -> None:
        plain, deep = self.forces(), self.forces(effects=[Exponential(a=3.0)])
        assert deep.margin.value < plain.margin.value
        at_reference = self.forces(slip=Quantity(0.4, 0.0), effects=[Exponential(a=3.0)])
        assert deep.margin.value == pytest.approx(at_reference.drawbar_pull.value / 60.0)

    def test_energy_needs_travel(self) -> None:
        assert self.forces(slip=Quantity(0.97, 0.01)).energy_per_metre is None
        assert self.forces(slip=None).energy_per_metre is None
        half = self.forces(slip=Quantity(0.5, 0.01))
        assert half.energy_per_metre.value == pytest.approx(2.0 * half.thrust.value)

    def test_probability_where_it_is_open(self) -> None:
        # about as much thrust as resistance
        slip = Quantity(0.19, 0.01)
        made = self.forces(slip=slip)
        drawn = sample(SAND, self.load, slip, STRENGTH, scatter=0.03)["drawbar_pull"]
        share = np.mean(drawn > 0)
        assert 0.2 < share < 0.8
        assert made.probability_drawbar_pull_positive == pytest.approx(share, abs=0.03)

    def test_without_slip_no_traction(self) -> None:
        made = self.forces(slip=None)
        assert made.thrust is made.drawbar_pull is made.probability_drawbar_pull_positive is None
        assert made.compaction_resistance == self.forces().compaction_resistance

    def test_pressed_wheel_meets_the_soil_on_both_sides(self) -> None:
        pressed = replace(WHEEL, contact="pressed")
        made = wheel_forces(pressed, SAND, STRENGTH, Quantity(120.0, 0.0), self.slip)
        half = wheel_forces(WHEEL, SAND, STRENGTH, Quantity(60.0, 0.0), self.slip)
        assert made.sinkage == half.sinkage
        assert made.compaction_resistance == Quantity(0.0, 0.0)
        assert made.thrust is made.margin is made.steepest_slope is None

    def test_sunk_to_the_axle_is_none(self) -> None:
        assert wheel_forces(WHEEL, SAND, STRENGTH, Quantity(1e6, 0.0), None) is None
        effects = [Exponential(a=1.0)]
        heavy = Quantity(1e6, 0.0)
        assert wheel_forces(WHEEL, SAND, STRENGTH, heavy, self.slip, effects=effects) is None

    def test_effect_adds_to_sinkage_and_deviation(self) -> None:
        made = self.forces(effects=[Exponential(a=1.5)])
        plain = self.forces()
        assert made.sinkage.value == pytest.approx(plain.sinkage.value * math.exp(0.3), rel=1e-9)
        # d ln z / d slip = 1.5 and the slip's 0.01 come on top of the other uncertainties
        relative = made.sinkage.standard_deviation / made.sinkage.value
        before = plain.sinkage.standard_deviation / plain.sinkage.value
        assert relative == pytest.approx(math.hypot(before, 0.015), rel=1e-4)

    def test_refusals_name_wheel_and_number(self) -> None:
        for load in (0.0, -3.0, math.nan, math.inf):
            with pytest.raises(MobilityError, match=r"front_left: load is"):
                self.forces(load=Quantity(load, 1.0))
        for slip in (1.5, math.nan):
            with pytest.raises(MobilityError, match=r"front_left: slip is"):
                self.forces(slip=Quantity(slip, 1.0))
        with pytest.raises(MobilityError, match="'plate', expected rolling or pressed"):
            wheel_forces(replace(WHEEL, contact="plate"), SAND, STRENGTH, self.load, None)

    @settings(max_examples=examples(60))
    @given(
        n=st.floats(0.1, 2.0),
        m=st.floats(-1.0, 1.0),
        pressure=st.floats(2e3, 2e5),
        load=st.floats(1.0, 300.0),
        slip=st.floats(-0.95, 0.95).filter(lambda i: abs(i) > 1e-3),
        contact=st.sampled_from(["rolling", "pressed"]),
    )
    def test_gradients_agree_with_differences_of_the_model(
        self, n: float, m: float, pressure: float, load: float, slip: float, contact: str
    ) -> None:
        kind = Soil("any", 1.0, 1.0).with_parameters(math.log(pressure), n, m)
        mean = estimate(kind, (0.1, 0.1, 0.1))
        wheel = replace(WHEEL, contact=contact)
        analytical = force_gradients(wheel, mean, STRENGTH, load, slip)
        # An effect of size zero changes nothing, but sends the work through the model.
        numerical = force_gradients(wheel, mean, STRENGTH, load, slip, effects=[Exponential(a=0.0)])
        if analytical is None or numerical is None:
            assert analytical is numerical
            return
        np.testing.assert_allclose(analytical.value, numerical.value, rtol=1e-9)
        scale = np.max(np.abs(numerical.gradient), axis=1, keepdims=True)
        np.testing.assert_allclose(
            analytical.gradient / np.where(scale == 0, 1.0, scale),
            numerical.gradient / np.where(scale == 0, 1.0, scale),
            rtol=1e-5,
            atol=1e-7,
        )


class TestSlip:
    def slip(self, speed: float, rim: float) -> float:
        made = wheel_slip(Quantity(speed, 0.01), Quantity(rim, 0.005), standstill=0.01)
        assert made is not None
        return made.value

    @pytest.mark.parametrize(
        ("speed", "rim", "slip"),
        [
            (0.4, 0.5, 0.2),  # driven: 1 - v/(r omega)
            (0.5, 0.4, -0.2),  # skidding: r omega/v - 1
            (0.5, 0.5, 0.0),
            (-0.4, -0.5, 0.2),  # the same backwards
            (-0.5, -0.4, -0.2),
            (0.0, 0.5, 1.0),
            (0.5, 0.0, -1.0),
            (-0.1, 0.5, 1.0),  # rolls back while it drives forward
            (0.5, -0.1, -1.0),
        ],
    )
    def test_definition(self, speed: float, rim: float, slip: float) -> None:
        assert self.slip(speed, rim) == pytest.approx(slip)

    def test_standing_is_unknown(self) -> None:
        assert wheel_slip(Quantity(0.004, 0.0), Quantity(-0.009, 0.0), standstill=0.01) is None
        # a speed that may well be none
        assert wheel_slip(Quantity(0.019, 0.01), Quantity(0.0, 0.0), standstill=0.01) is None

    @pytest.mark.parametrize(("speed", "rim"), [(0.4, 0.5), (0.5, 0.4), (-0.4, -0.5)])
    def test_deviation_is_that_of_samples(self, speed: float, rim: float) -> None:
        made = wheel_slip(Quantity(speed, 0.01), Quantity(rim, 0.005), standstill=0.01)
        rng = np.random.default_rng(3)
        v, r = rng.normal(speed, 0.01, 20_000), rng.normal(rim, 0.005, 20_000)
        drawn = 1 - v / r if abs(rim) >= abs(speed) else r / v - 1
        assert made.standard_deviation == pytest.approx(np.std(drawn), rel=0.03)
