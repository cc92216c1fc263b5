# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from random_examples import examples

from smallwheel_ros.effects.base import Effect, WheelState
from smallwheel_ros.effects.instruments import LoadGain
from smallwheel_ros.effects.slip import Exponential
from smallwheel_ros.effects.soil import PrestonThomas
from smallwheel_ros.estimator.path_steps import Sample
from smallwheel_ros.estimator.reading import Reading
from smallwheel_ros.estimator.soil_filter import LocalLaw
from smallwheel_ros.estimator.strength_filter import WheelStep
from smallwheel_ros.estimator.traction import TractionEstimator
from smallwheel_ros.model.model import Model, predict
from smallwheel_ros.onboard.mobility import (
    SCATTER,
    MobilityError,
    WheelForces,
    wheel_forces,
)
from smallwheel_ros.onboard.wheel_on_soil import WheelOnSoil, mean_contacts, wheels_on_soil
from smallwheel_ros.physics.conditions import Conditions
from smallwheel_ros.physics.soil import (
    Soil,
    k_from_reference,
    soil,
)
from smallwheel_ros.physics.stresses import ShearLaw
from smallwheel_ros.physics.stresses import wheel_forces as stresses_of
from smallwheel_ros.physics.wheel import Quantity, Strength, Wheel, wheel_slip

WHEEL = Wheel("front_left", 0.25, 0.10)
LOAD, SLIP = Quantity(60.0, 1.5), Quantity(0.2, 0.01)
STRENGTH = Strength(Quantity(500.0, 100.0), Quantity(0.52, 0.03), Quantity(0.015, 0.001))


@dataclass(frozen=True)
class Lugged(Effect):
    """Lugs that add thrust, and throw soil."""

    id = "lugged"

    def thrust_factor(self, state: WheelState, conditions: Conditions) -> float:
        return 1.2

    def added_resistance(self, state: WheelState, conditions: Conditions) -> float:
        return 3.0


def with_law(kind: Soil, log_reference_pressure: float, n: float, m: float) -> Soil:
    k = float(k_from_reference(log_reference_pressure, n, m))
    return replace(kind, k=k, n=float(n), m=float(m))


def estimate(
    kind: Soil, deviations: tuple[float, float, float], correlation: float = 0.0
) -> LocalLaw:
    covariance = np.diag(np.square(deviations))
    covariance[0, 1] = covariance[1, 0] = correlation * deviations[0] * deviations[1]
    return LocalLaw.of((np.array([kind.log_reference_pressure, kind.n, kind.m]), covariance))


SAND = estimate(soil("dry_sand"), (0.05, 0.05, 0.1), -0.4)


def sample(wheel: Wheel, law: LocalLaw, load: Quantity, slip: float | None = None) -> Sample:
    given = None if slip is None else Quantity(slip, 0.0)
    return Sample(Reading(wheel, 0, load, given, None, None, 0.0, 0.0), law, load)


def forces(
    load: Quantity = LOAD,
    slip: Quantity | None = SLIP,
    *,
    wheel: Wheel = WHEEL,
    soil_estimate: LocalLaw = SAND,
    traction: TractionEstimator | None = None,
    scatter: float = 0.03,
    effects: Sequence[Effect] = (),
    reference_slip: float = 0.4,
    torque: float | None = None,
) -> WheelForces | None:
    """What the pipeline does for one wheel."""

    def put(at: float | None) -> WheelOnSoil | None:
        given = sample(wheel, soil_estimate, load, at)
        return wheels_on_soil([given], scatter=scatter, effects=effects, strength=STRENGTH)[0]

    on = put(None if slip is None else slip.value)
    if on is None:
        return None
    return wheel_forces(
        on,
        traction or TractionEstimator(STRENGTH, [wheel]),
        slip,
        reference=put(reference_slip) if effects else on,
        reference_slip=reference_slip,
        torque=torque,
    )


def drawn(slip: Quantity, count: int = 3000) -> dict[str, np.ndarray]:
    """The forces for draws of everything that is uncertain, each by the pipeline's own functions."""
    rng = np.random.default_rng(5)
    spread = SAND.covariance[:3, :3] + np.diag([0.03**2, 0.0, 0.0])
    traction = TractionEstimator(STRENGTH, [WHEEL])
    mean, covariance = traction.now.kalman.x.copy(), traction.now.kalman.P
    rows = []
    for law in rng.multivariate_normal(SAND.law, spread, count):
        kind = with_law(soil("dry_sand"), *law)
        traction.now.kalman.x = rng.multivariate_normal(mean, covariance)
        scatter = 1.0 + SCATTER * rng.standard_normal()
        w, i = rng.normal(60.0, 1.5), rng.normal(slip.value, slip.standard_deviation)
        one = forces(
            Quantity(w, 0.0),
            Quantity(min(i, 0.99), 0.0),
            soil_estimate=estimate(kind, (1e-9, 1e-9, 1e-9)),
            traction=traction,
        )
        push = one.thrust.value * scatter
        rows.append(
            (
                one.sinkage.value,
                one.compaction_resistance.value,
                push,
                one.drawbar_pull.value + push - one.thrust.value,
                one.rolling_resistance_coefficient.value,
            )
        )
    names = "sinkage compaction_resistance thrust drawbar_pull rolling_resistance_coefficient"
    return dict(zip(names.split(), np.array(rows).T, strict=True))


class TestForces:
    def test_values_are_those_of_the_model(self) -> None:
        made = forces()
        sand = replace(
            soil("dry_sand"), cohesion=500.0, friction_angle=0.52, shear_displacement=0.015
        )
        expected = predict(Model(sand), Conditions.of(60.0, 0.25, 0.10, slip=0.2))
        shear = ShearLaw(500.0, 0.52, 0.015)
        stresses = stresses_of(60.0, expected.sinkage[0], 0.25, 0.10, 0.2, sand.n, shear)
        assert made.sinkage.value == pytest.approx(expected.sinkage[0], rel=1e-10)
        compaction = made.compaction_resistance.value
        assert compaction == pytest.approx(expected.compaction_resistance[0], rel=1e-10)
        assert made.other_resistance.value == 0.0
        assert made.rolling_resistance_coefficient.value == pytest.approx(compaction / 60.0)
        assert made.thrust.value == pytest.approx(float(stresses.thrust), abs=1e-3 * 60.0)
        pull = float(stresses.thrust - stresses.resistance)
        assert made.drawbar_pull.value == pytest.approx(pull, abs=1e-3 * 60.0)

    def test_deviations_are_those_of_samples(self) -> None:
        slip = Quantity(0.2, 0.01)
        made, sampled = forces(slip=slip), drawn(slip)
        for name, values in sampled.items():
            deviation = getattr(made, name).standard_deviation
            # 3000 draws know a deviation to 1.3 %; a factor of grip is skewed by a few per cent.
            assert deviation == pytest.approx(np.std(values), rel=0.1), name
        share = np.mean(sampled["drawbar_pull"] > 0)
        assert made.probability_drawbar_pull_positive == pytest.approx(share, abs=0.05)

    def test_margin_on_soft_ground_is_the_pull_at_the_reference_slip(self) -> None:
        soft = estimate(replace(soil("dry_sand"), k=soil("dry_sand").k / 20.0), (0.05, 0.05, 0.1))
        for slip in (Quantity(0.2, 0.01), Quantity(-0.4, 0.1), None):
            made = forces(slip=slip, soil_estimate=soft, reference_slip=0.3)
            there = forces(slip=Quantity(0.3, 0.0), soil_estimate=soft)
            assert made.margin.value == pytest.approx(there.drawbar_pull.value / 60.0)
            slope = made.steepest_slope
            assert math.tan(slope.value) == pytest.approx(made.margin.value)
            up = math.atan(made.margin.value + made.margin.standard_deviation)
            assert slope.standard_deviation == pytest.approx(up - slope.value, rel=0.1)

    @settings(max_examples=examples(60))
    @given(
        n=st.floats(0.3, 1.6),
        pressure=st.floats(2e3, 1e5),
        stiffer=st.floats(1.01, 100.0),
        angle=st.floats(0.25, 0.75),
        cohesion=st.floats(0.0, 3000.0),
        shear=st.floats(0.004, 0.04),
        load=st.floats(10.0, 150.0),
    )
    def test_margin_never_falls_on_stiffer_or_stronger_ground(
        self,
        n: float,
        pressure: float,
        stiffer: float,
        angle: float,
        cohesion: float,
        shear: float,
        load: float,
    ) -> None:
        def margin(pressure: float, angle: float, cohesion: float) -> float:
            kind = with_law(Soil("any", 1.0, 1.0), math.log(pressure), n, 0.4)
            strength = Strength(*(Quantity(v, 0.0) for v in (cohesion, angle, shear)))
            made = forces(
                Quantity(load, 0.0),
                None,
                soil_estimate=estimate(kind, (0.1, 0.1, 0.1)),
                traction=TractionEstimator(strength, [WHEEL]),
            )
            return -1.0 if made is None else made.margin.value

        here = margin(pressure, angle, cohesion)
        assert margin(stiffer * pressure, angle, cohesion) >= here - 1e-3
        assert margin(pressure, angle + 0.05, cohesion) >= here - 1e-3
        assert margin(pressure, angle, cohesion + 200.0) >= here - 1e-3

    def test_hard_ground_holds_slopes(self) -> None:
        hard = estimate(replace(soil("dry_sand"), k=1000.0 * soil("dry_sand").k), (0.05, 0.05, 0.1))
        assert math.degrees(forces(soil_estimate=hard).steepest_slope.value) > 10.0

    def test_an_effect_of_slip_is_in_the_margin(self) -> None:
        # On soft ground: what sinks to a few centimetres pulls no less than a wheel that hardly sinks.
        soft = estimate(replace(soil("dry_sand"), k=soil("dry_sand").k / 10.0), (0.05, 0.05, 0.1))
        plain = forces(soil_estimate=soft)
        deep = forces(soil_estimate=soft, effects=[Exponential(a=1.0)])
        assert -1.0 < deep.margin.value < plain.margin.value - 0.01

    def test_effects_act_on_thrust_resistance_and_load(self) -> None:
        plain, made = forces(), forces(effects=[Lugged()])
        assert made.thrust.value == pytest.approx(1.2 * plain.thrust.value)
        more = 0.2 * plain.thrust.value - 3.0
        assert made.drawbar_pull.value == pytest.approx(plain.drawbar_pull.value + more)
        shown = forces(Quantity(75.0, 1.5), effects=[LoadGain(g=0.25)])
        assert shown.drawbar_pull.value == pytest.approx(plain.drawbar_pull.value)

    def test_energy_needs_travel(self) -> None:
        assert forces(slip=Quantity(0.97, 0.01)).energy_per_metre is None
        assert forces(slip=None).energy_per_metre is None
        half = forces(slip=Quantity(0.5, 0.01))
        assert half.energy_per_metre.value == pytest.approx(2.0 * half.thrust.value)

    def test_a_torque_of_this_moment_is_fused_with_the_thrust(self) -> None:
        plain = forces()
        on = wheels_on_soil([sample(WHEEL, SAND, LOAD)], scatter=0.03)[0]
        rim = TractionEstimator(STRENGTH, [WHEEL]).now.forces(WheelStep(0, on.contact, 0.2)).rim
        fused = forces(torque=0.125 * (rim.value + 5.0))
        assert plain.thrust.value < fused.thrust.value < plain.thrust.value + 5.0
        assert fused.thrust.value > plain.thrust.value + 3.0
        assert fused.drawbar_pull.standard_deviation < plain.drawbar_pull.standard_deviation
        assert fused.margin == plain.margin

    def test_without_slip_no_traction(self) -> None:
        made = forces(slip=None)
        assert made.thrust is made.drawbar_pull is made.probability_drawbar_pull_positive is None
        assert made.compaction_resistance == forces().compaction_resistance

    def test_pressed_wheel_meets_the_soil_on_both_sides(self) -> None:
        made = forces(Quantity(120.0, 0.0), wheel=replace(WHEEL, contact="pressed"))
        half = forces(Quantity(60.0, 0.0))
        assert made.sinkage == half.sinkage
        assert made.compaction_resistance == Quantity(0.0, 0.0)
        assert made.thrust is made.margin is made.steepest_slope is None

    def test_sunk_to_the_axle_is_none(self) -> None:
        heavy = Quantity(1e6, 0.0)
        assert forces(heavy, None) is None
        assert forces(heavy, effects=[Exponential(a=1.0)]) is None

    def test_effect_adds_to_sinkage(self) -> None:
        made, plain = forces(effects=[Exponential(a=1.5)]), forces()
        assert made.sinkage.value == pytest.approx(plain.sinkage.value * math.exp(0.3), rel=1e-9)

    def test_refusals_name_wheel_and_number(self) -> None:
        for load in (0.0, -3.0, math.nan, math.inf):
            with pytest.raises(MobilityError, match=r"front_left: load is"):
                forces(Quantity(load, 1.0))
        for slip in (1.5, math.nan):
            with pytest.raises(MobilityError, match=r"front_left: slip is"):
                forces(slip=Quantity(slip, 1.0))
        with pytest.raises(MobilityError, match="'plate', expected rolling or pressed"):
            forces(wheel=replace(WHEEL, contact="plate"))

    def test_a_load_that_is_next_to_none_is_left_out_of_means(self) -> None:
        """Its noise over itself has no square: one such reading made the filter's covariance NaN."""
        good, none = sample(WHEEL, SAND, LOAD, 0.2), sample(WHEEL, SAND, Quantity(1e-300, 1.0), 0.2)
        found = mean_contacts({"front_left": [good, none]}, scatter=0.05)
        assert found == mean_contacts({"front_left": [good]}, scatter=0.05)

    @settings(max_examples=examples(40))
    @given(
        wheels=st.lists(
            st.tuples(
                st.floats(0.1, 0.5),
                st.sampled_from(["rolling", "pressed"]),
                st.floats(0.3, 1.5),
                st.floats(1.0, 5e3),
                st.none() | st.floats(-0.5, 0.9),
            ),
            min_size=1,
            max_size=5,
        ),
        effects=st.sampled_from([(), (Lugged(),), (PrestonThomas(c=10.0), LoadGain(g=0.1))]),
    )
    def test_wheels_together_are_as_each_alone(
        self,
        wheels: list[tuple[float, str, float, float, float | None]],
        effects: tuple[Effect, ...],
    ) -> None:
        """Of other sizes, on other soils, sunk to the axle or not, with and without a slip."""
        samples = []
        for diameter, contact, n, load, slip in wheels:
            wheel = Wheel("any", diameter, 0.4 * diameter, contact=contact)
            law = estimate(replace(soil("dry_sand"), n=n), (0.1, 0.1, 0.1))
            samples.append(sample(wheel, law, Quantity(load, 0.02 * load), slip))
        given = {"scatter": 0.05, "effects": effects, "strength": STRENGTH}
        together = wheels_on_soil(samples, **given)
        for one, found in zip(samples, together, strict=True):
            (alone,) = wheels_on_soil([one], **given)
            assert (found is None) == (alone is None)
            if found is not None:
                for name in ("sinkage", "compaction", "other", "acting"):
                    expected = pytest.approx(getattr(alone, name), rel=1e-9)
                    assert getattr(found, name) == expected, name
                spread = np.array(alone.covariance)
                np.testing.assert_allclose(
                    found.covariance, spread, rtol=1e-5, atol=1e-7 * spread.max()
                )

    @settings(max_examples=examples(60))
    @given(
        n=st.floats(0.1, 2.0),
        m=st.floats(-1.0, 1.0),
        pressure=st.floats(2e3, 2e5),
        load=st.floats(1.0, 300.0),
        contact=st.sampled_from(["rolling", "pressed"]),
    )
    def test_slopes_agree_with_differences_of_the_model(
        self, n: float, m: float, pressure: float, load: float, contact: str
    ) -> None:
        kind = with_law(Soil("any", 1.0, 1.0), math.log(pressure), n, m)
        given = (
            replace(WHEEL, contact=contact),
            estimate(kind, (0.1, 0.1, 0.1)),
            Quantity(load, 1.0),
        )
        analytical = wheels_on_soil([sample(*given)])[0]
        # An effect of size zero changes nothing, but sends the work through the model.
        numerical = wheels_on_soil([sample(*given, slip=0.2)], effects=[Exponential(a=0.0)])[0]
        if analytical is None or numerical is None:
            assert analytical is numerical
            return
        for name in ("sinkage", "compaction", "other", "acting"):
            expected = getattr(numerical, name)
            assert getattr(analytical, name) == pytest.approx(expected, rel=1e-9, abs=1e-12)
        size = np.sqrt(np.diag(numerical.covariance)) + 1e-12
        got, expected = (
            np.array(on.covariance) / np.outer(size, size) for on in (analytical, numerical)
        )
        np.testing.assert_allclose(got, expected, atol=1e-5)  # differences are not more exact


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
        for speed in (0.019, 0.021, -0.039):
            assert wheel_slip(Quantity(speed, 0.01), Quantity(0.0, 0.0), standstill=0.01) is None
        assert self.slip(0.05, 0.0) == -1.0

    @pytest.mark.parametrize(("speed", "rim"), [(0.4, 0.5), (0.5, 0.4), (-0.4, -0.5)])
    def test_deviation_is_that_of_samples(self, speed: float, rim: float) -> None:
        made = wheel_slip(Quantity(speed, 0.01), Quantity(rim, 0.005), standstill=0.01)
        rng = np.random.default_rng(3)
        v, r = rng.normal(speed, 0.01, 20_000), rng.normal(rim, 0.005, 20_000)
        drawn = 1 - v / r if abs(rim) >= abs(speed) else r / v - 1
        assert made.standard_deviation == pytest.approx(np.std(drawn), rel=0.03)
