# SPDX-License-Identifier: Apache-2.0
"""Strength and grip from balance, torque and drawbar pull, in worlds whose thrust is another law."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from random_examples import examples
from scipy.optimize import minimize

from benchmarks._traction_table import rates
from benchmarks.traction_rates import run, summed
from benchmarks.traction_worlds import WORLDS, make_drive
from smallwheel_ros.estimator.path_steps import (
    PathStep,
    PathSteps,
    RollingContact,
    Sample,
    WheelMean,
)
from smallwheel_ros.estimator.reading import Reading
from smallwheel_ros.estimator.soil_filter import LocalLaw
from smallwheel_ros.estimator.strength_filter import (
    COHESION,
    FRICTION,
    OTHER,
    SHEAR,
    TractionFilter,
    WheelStep,
    iterated_update,
)
from smallwheel_ros.estimator.strength_filter import WHEELS as WHEELS_AT
from smallwheel_ros.estimator.traction import Excitation, TractionEstimator
from smallwheel_ros.onboard.onboard import Onboard
from smallwheel_ros.physics.stresses import PointForces, point_forces
from smallwheel_ros.physics.wheel import Quantity, Strength, Wheel

WHEELS = tuple(
    Wheel(f"{end}_{side}", 0.25, 0.1, longitudinal_position=x, lateral_position=y)
    for end, x in (("front", 0.35), ("rear", -0.35))
    for side, y in (("left", 0.25), ("right", -0.25))
)
PRIOR = Strength(Quantity(0.0, 400.0), Quantity(0.5, 0.1), Quantity(0.012, 0.005))
MASS = 24.0
LOAD = Quantity(60.0, 1.0)
LAW = LocalLaw(np.zeros(3), 0.0, 0.0, np.zeros((5, 5)))


def shown(angle: float, slip: float, grip: float = 1.0) -> PointForces:
    """Forces of a wheel on soil without cohesion, with the prior's shear displacement."""
    load, sinkage, diameter, width, n = CONTACT[:5]
    return point_forces(
        load, sinkage, diameter, width, slip, n, 0.0, angle, math.log(0.012), 1.0, grip
    )


def balance(angle: float, slip: float, grip: float = 1.0) -> float:
    """What four such wheels pull per mass of the vehicle, m/s^2."""
    made = shown(angle, slip, grip)
    return 4.0 * (made.thrust - made.resistance) / MASS


@given(
    slip=st.floats(-0.6, 0.9).filter(lambda slip: abs(slip) > 1e-3),
    grip=st.floats(-1.0, 0.5),
    cohesion=st.floats(0.0, 1500.0),
)
@settings(max_examples=examples(30), deadline=None)
def test_slopes_of_forces_are_those_of_differences(
    slip: float, grip: float, cohesion: float
) -> None:
    """By the whole state, and by slip, load and sinkage."""
    made = TractionFilter(PRIOR, WHEELS, MASS)
    made.kalman.x[[COHESION, OTHER]] = cohesion, 0.02
    made.kalman.x[WHEELS_AT + len(WHEELS) :] = grip  # and the scales of torques
    contact = CONTACT._replace(thrust_factor=1.2, other=1.0)
    here, centre = made.forces(WheelStep(1, contact, slip)), made.kalman.x.copy()

    def slopes(step: float, at: Callable[[float], WheelStep | np.ndarray]) -> np.ndarray:
        found = []
        for x in (at(-step), at(step)):
            given = x if isinstance(x, WheelStep) else WheelStep(1, contact, slip)
            made.kalman.x = centre if isinstance(x, WheelStep) else x
            found.append([force.value for force in made.forces(given)])
        return np.subtract(found[1], found[0]) / (2.0 * step)

    unit = np.eye(len(centre))
    for place in range(len(centre)):
        by_state = slopes(1e-6, lambda h, place=place: centre + h * unit[place])
        assert [f.row[place] for f in here] == pytest.approx(by_state, rel=1e-3, abs=1e-4)
    by_slip = slopes(1e-6, lambda h: WheelStep(1, contact, slip + h))
    assert [force.by_slip for force in here] == pytest.approx(by_slip, rel=1e-3, abs=1e-4)

    def loaded(h: float) -> WheelStep:
        more = math.exp(h)
        return WheelStep(1, contact._replace(load=59.0 * more, other=more), slip)

    by_load = slopes(1e-6, loaded)
    by_load[1] += 1.0  # of the other resistance, which is not the soil's
    assert [force.by_log_load for force in here] == pytest.approx(by_load, rel=1e-3, abs=1e-4)
    by_depth = slopes(
        1e-6, lambda h: WheelStep(1, contact._replace(sinkage=contact.sinkage + h), slip)
    )
    # A one-sided difference.
    assert [force.by_sinkage for force in here] == pytest.approx(by_depth, rel=1e-2, abs=1.0)


# ---- Worlds: one seed of each here, more in benchmarks/traction_rates.py


@pytest.mark.parametrize("kind", ["balance", "balance and torque"])
def test_pulls_and_margin_of_a_slippery_drive(kind: str) -> None:
    assessor, made = run(make_drive(WORLDS["patch"], 1), kind)
    found = {name: value for name, (value, _, _) in rates([summed("patch", 1, kind, made)]).items()}
    assert found["pull rms"] < 2.0
    assert 0.85 < found["pull in band"] <= 1.0
    assert found["Brier"] < 0.09
    assert found["margin in band"] > 0.8
    assert assessor.traction.estimate().sources == set(kind.split(" and "))


def test_without_any_of_them_bands_are_wide_and_hold() -> None:
    assessor, made = run(make_drive(WORLDS["cruise"], 1), "nothing")
    found = rates([summed("cruise", 1, "nothing", made)])
    assert found["pull in band"][0] > 0.88
    assert found["margin in band"][0] > 0.9
    told = assessor.traction.estimate()
    assert told.steps == 0
    assert told.status[0].startswith("thrust is not determined: no balance")


def test_a_restored_strength_is_known_before_the_first_step() -> None:
    assessor, _ = run(make_drive(WORLDS["patch"], 1), "balance and torque")
    told, record = assessor.traction.estimate(), json.loads(json.dumps(assessor.traction.record()))
    again = Onboard(assessor.settings).traction
    assert again.record() is None
    again.restore(record)
    assert again.estimate().status == told.status
    assert again.estimate().sources == told.sources == {"balance", "torque"}
    assert again.estimate().steps == told.steps > 0
    assert again.record() == record


@pytest.mark.slow
def test_rates_over_worlds() -> None:
    drives = [
        (name, seed, make_drive(world, seed)) for name, world in WORLDS.items() for seed in range(4)
    ]
    found = {
        kind: rates([summed(name, seed, kind, run(drive, kind)[1]) for name, seed, drive in drives])
        for kind in ("nothing", "balance", "balance and torque", "pull sensor")
    }
    print(found)
    for kind, brier in (("balance", 0.08), ("balance and torque", 0.045)):
        assert found[kind]["Brier"][0] <= brier
        # 0.98 is aimed at; 128 drives of docs/traction_rates.md hold 0.994 with the balance: too wide.
        assert found[kind]["pull in band"][0] >= 0.9
    assert found["nothing"]["pull in band"][0] >= 0.9
    assert all(rate["margin in band"][0] >= 0.9 for rate in found.values())


def test_a_motor_whose_scale_is_off_does_not_mislead() -> None:
    """The balance tells a motor that shows a quarter too much from the others."""
    estimator = TractionEstimator(PRIOR, WHEELS, MASS)
    for i in range(120):
        distance, slip = 0.1 * i, 0.2 + 0.18 * math.sin(0.1 * i)
        made = step(distance, slip, balance(0.5, slip))
        torque = shown(0.5, slip).torque
        means = {
            name: mean._replace(torque=(1.25 if name == "front_left" else 1.0) * torque)
            for name, mean in made.wheels.items()
        }
        estimator.take(made._replace(wheels=means))
    push = shown(0.5, slip).thrust
    wheel, noise = WheelStep(0, CONTACT, slip), (0.1 * push) ** 2
    told = estimator.now.forces(wheel).thrust
    value, variance = estimator.now.torque(wheel, 1.25 * torque, noise).corrected(
        told.value, estimator.now.variance(told.row) + noise, told.row
    )
    assert abs(value - push) < min(0.08 * push, 2.0 * math.sqrt(variance))


# ---- The filter


@pytest.mark.parametrize("pull", [-2.0, 8.0, 20.0])
def test_an_update_finds_the_most_likely_state(pull: float) -> None:
    """Also where the thrust is another than the prior's by a factor."""
    made = TractionFilter(PRIOR, WHEELS, 0.0)
    before, inverse = made.kalman.x.copy(), np.linalg.inv(made.kalman.P)
    wheel = WheelStep(0, CONTACT, 0.05)

    def unlikely(x: np.ndarray) -> float:
        made.kalman.x = x
        off = pull - made.forces(wheel).pull.value
        return float((x - before) @ inverse @ (x - before) + off**2 / 0.5**2)

    deviations = np.sqrt(np.diag(made.kalman.P))
    best = minimize(lambda u: unlikely(before + u * deviations), np.zeros(len(before)))
    made.kalman.x = before.copy()
    iterated_update(made.kalman, pull, lambda: made.forces(wheel).pull[:2], 0.5**2)
    assert (made.kalman.x - before) / deviations == pytest.approx(best.x, abs=0.02)


@given(slip=st.floats(0.02, 0.6), shear=st.floats(0.01, 0.5), angle=st.floats(0.01, 0.12))
@settings(max_examples=examples(20), deadline=None)
def test_spread_is_that_of_a_product_of_factors(slip: float, shear: float, angle: float) -> None:
    """The mean square deviation of draws from the value, which is their median."""
    made = TractionFilter(PRIOR, WHEELS, 0.0)
    mean, factors = made.kalman.x.copy(), np.zeros(len(made.kalman.x))
    factors[[FRICTION, SHEAR, -1]] = angle, shear, 0.25
    made.kalman.P = np.diag(factors**2)
    wheel = WheelStep(2, CONTACT, slip)  # on the last cell
    push = made.forces(wheel, exact_slip=True).thrust
    drawn = []
    for row in np.random.default_rng(2).standard_normal((1000, 3)):
        made.kalman.x = mean.copy()
        made.kalman.x[[FRICTION, SHEAR, -1]] += row * factors[[FRICTION, SHEAR, -1]]
        drawn.append(made.forces(wheel, exact_slip=True).thrust.value)
    made.kalman.x = mean
    found = math.sqrt(made.spread(push, push.row))
    away = math.sqrt(float(np.mean(np.square(np.array(drawn) - push.value))))
    assert found == pytest.approx(away, rel=0.15)


CONTACT = RollingContact(59.0, 0.012, 0.25, 0.1, 1.0)


def step(
    distance: float,
    slip: float,
    force: float | None = None,
    wheels: tuple[Wheel, ...] = WHEELS,
    forward: bool = True,
    **of_wheels: object,
) -> PathStep:
    """A step of 0.1 m of these wheels, all alike."""
    mean = WheelMean(Quantity(slip, 0.025), CONTACT, None, None)._replace(**of_wheels)
    means = {wheel.name: mean for wheel in wheels}
    return PathStep(distance / 0.3, distance, 0.1, forward, True, means, force, 0.0, 0.07)


def drive(estimator: TractionEstimator, angle: float, begin: float = 0.0, soil: int = 0) -> None:
    """Over 6 m of slopes, with the model's own forces."""
    for i in range(60):
        distance, slip = begin + 0.1 * i, 0.2 + 0.18 * math.sin(0.4 * i)
        estimator.take(step(distance, slip, balance(angle, slip)), soil)


def test_balance_finds_the_friction_angle() -> None:
    estimator = TractionEstimator(PRIOR, WHEELS, MASS)
    drive(estimator, 0.42)
    told = estimator.estimate()
    angle = told.strength.friction_angle
    assert abs(angle.value - 0.42) < 3.0 * angle.standard_deviation
    # Grip, cohesion and shear displacement take their part of what slopes show.
    assert angle.standard_deviation < 0.8 * PRIOR.friction_angle.standard_deviation
    assert told.sources == {"balance"}


def test_each_soil_keeps_its_strength() -> None:
    estimator = TractionEstimator(PRIOR, WHEELS, MASS)
    drive(estimator, 0.40, soil=0)
    first = estimator.estimate().strength.friction_angle
    drive(estimator, 0.60, begin=6.0, soil=1)
    other = estimator.estimate().strength.friction_angle
    assert other.value > first.value + 0.08
    estimator.take(step(12.0, 0.2, wheels=WHEELS[:1]), soil=0)
    again = estimator.estimate().strength.friction_angle
    assert again.value == pytest.approx(first.value)
    assert again.standard_deviation == pytest.approx(first.standard_deviation, rel=2e-3)  # 0.1 m on


def test_strength_is_handed_over_to_another_soil_and_less_sure() -> None:
    """F14: a found change of soil had put it back to the prior."""
    estimator = TractionEstimator(PRIOR, WHEELS, MASS)
    drive(estimator, 0.62)
    before = estimator.estimate().strength.friction_angle
    estimator.take(step(6.0, 0.2, wheels=WHEELS[:1]), soil=1)
    after = estimator.estimate().strength.friction_angle
    prior = PRIOR.friction_angle
    assert abs(after.value - prior.value) == pytest.approx(
        math.sqrt(0.5) * abs(before.value - prior.value), rel=0.02
    )
    assert before.standard_deviation < after.standard_deviation < prior.standard_deviation


def test_not_all_soils_are_kept_for_ever() -> None:
    estimator = TractionEstimator(PRIOR, WHEELS, MASS)
    for soil in range(40):
        estimator.take(step(0.1 * soil, 0.2), soil=soil)
    assert len(estimator._soils) == 4


def test_a_slippery_place_is_grip_and_not_strength() -> None:
    estimator = TractionEstimator(PRIOR, WHEELS, MASS)
    estimator.level(Quantity(0.0, 0.05))
    drive(estimator, 0.5)
    before = estimator.estimate().strength.friction_angle.value
    push = shown(0.5, 0.3, grip=0.4).thrust
    for i in range(6):
        estimator.take(step(6.0 + 0.1 * i, 0.3, balance(0.5, 0.3, grip=0.4)))
    wheel, _ = estimator.wheel("front_left", CONTACT, 0.3, 6.6 / 0.3)
    assert push < estimator.now.forces(wheel).thrust.value < 1.5 * push
    # A factor of 0.4 is 3.7 deviations of the grip: strength, of which a metre has told, takes a sixth of it.
    assert estimator.estimate().strength.friction_angle.value > before - 0.1


def test_no_mass_means_no_balance() -> None:
    estimator = TractionEstimator(PRIOR, WHEELS)
    drive(estimator, 0.42)
    assert estimator.estimate().steps == 0


def test_one_wheel_without_slip_leaves_the_balance_out() -> None:
    estimator = TractionEstimator(PRIOR, WHEELS, MASS)
    for i in range(30):
        estimator.take(step(0.1 * i, 0.2, 0.0, WHEELS[:3]))
    assert estimator.estimate().steps == 0


def test_words_say_what_is_not_determined() -> None:
    estimator = TractionEstimator(PRIOR, WHEELS, MASS)
    for i in range(30):
        estimator.take(step(0.1 * i, 0.2, 0.3))
    words = "; ".join(estimator.estimate().status)
    assert "slip hardly varied (0.20 to 0.20)" in words
    assert "load hardly varied (59 to 59 N)" in words


@settings(max_examples=examples(40), deadline=None)
@given(
    st.lists(
        st.tuples(
            st.floats(-1.0, 1.0),
            st.floats(-50.0, 50.0),
            st.none() | st.floats(-500.0, 500.0) | st.just(math.nan),
            st.none() | st.floats(-1e4, 1e4) | st.just(math.inf),
            st.floats(0.0, 3.0),
            st.booleans(),
        ),
        min_size=1,
        max_size=25,
    )
)
def test_no_sample_breaks_the_filter(rows: list[tuple[object, ...]]) -> None:
    estimator, distance = TractionEstimator(PRIOR, WHEELS, MASS), 0.0
    steps = PathSteps(lambda samples: dict.fromkeys(samples, CONTACT))
    for i, (slip, force, torque, pull, way, forward) in enumerate(rows):
        distance += way
        quantity = None if pull is None else Quantity(pull, 0.6)
        for wheel in WHEELS:
            reading = Reading(
                wheel,
                300_000_000 * i,
                LOAD,
                None,
                None,
                0.3 * (1.0 - slip),
                distance,
                distance,
                drawbar_pull=quantity,
                rim_speed=0.3,
                slope_force=force,
                torque=torque,
                forward=forward,
                gained_force=0.0,
                speed_std=0.01,
                rim_std=0.003,
            )
            made = steps.add(Sample(reading, LAW, LOAD))
            if made is not None:
                estimator.take(made)
    for one in (estimator.now, estimator.reserve):
        assert np.isfinite(one.kalman.x).all()
        assert np.linalg.eigvalsh(one.kalman.P).min() > -1e-9 * np.abs(one.kalman.P).max()
    told = estimator.estimate()
    assert told.strength.cohesion.value >= 0.0
    assert told.strength.shear_displacement.value > 0.0


# ---- Saved


def test_a_record_goes_on_with_the_strength() -> None:
    estimator = TractionEstimator(PRIOR, WHEELS, MASS)
    assert estimator.record() is None
    drive(estimator, 0.42)
    record = json.loads(json.dumps(estimator.record()))
    again = TractionEstimator(PRIOR, WHEELS, MASS)
    again.restore(record)
    assert again.estimate().strength == estimator.estimate().strength
    estimator.excitation = Excitation()  # as just behind a border
    record = json.loads(json.dumps(estimator.record(), allow_nan=False))
    again.restore(record)
    assert again.excitation == Excitation()
    other = TractionEstimator(replace(PRIOR, cohesion=Quantity(9.0, 1.0)), WHEELS, MASS)
    with pytest.raises(ValueError, match="another prior of the soil's strength"):
        other.restore(record)
    assert other.record() is None  # nothing has changed
