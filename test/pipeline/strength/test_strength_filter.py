# SPDX-License-Identifier: Apache-2.0
"""The strength's filter on steps of the model's own forces: what it finds, keeps and hands over.

Tests `filter.py` and `forces.py`.
"""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from random_examples import examples
from scipy.optimize import brentq, minimize

from smallwheel_ros.physics.force_slopes import WheelRows, sloped_forces
from smallwheel_ros.physics.wheel import Quantity, Strength, Wheel
from smallwheel_ros.pipeline.strength.contact import OnSoil
from smallwheel_ros.pipeline.strength.filter import StrengthFilter
from smallwheel_ros.pipeline.strength.forces import (
    COHESION,
    FRICTION,
    OTHER,
    Rolling,
    forces,
    pull_and_rim,
)
from smallwheel_ros.pipeline.strength.forces import WHEELS as WHEELS_AT
from smallwheel_ros.pipeline.strength.steps import Steps
from smallwheel_ros.pipeline.strength.two_filters import Strengths
from smallwheel_ros.pipeline.strength.words import constants_of
from smallwheel_ros.pipeline.tables import Array

WHEELS = tuple(
    Wheel(f"{end}_{side}", 0.25, 0.1, longitudinal_position=x, lateral_position=y)
    for end, x in (("front", 0.35), ("rear", -0.35))
    for side, y in (("left", 0.25), ("right", -0.25))
)
# A rim of which is known that it grips like soil: the angle takes all that a balance shows.
PRIOR = Strength(
    Quantity(0.0, 400.0), Quantity(0.5, 0.1), Quantity(0.012, 0.005), Quantity(1.0, 0.5), Quantity(1.0, 1e-3),
    Quantity(0.0, 0.0),
)  # fmt: skip
MASS, LOAD, DEPTH = 24.0, 59.0, 0.012
ALL = np.arange(4)


def contact(count: int, load: float = LOAD) -> OnSoil:
    """So many wheels, known without any error, on a soil of exponent 1."""
    full, none = np.full(count, load), np.zeros(count)
    spread = np.zeros((count, 4, 4))
    return OnSoil(
        np.arange(count), full, np.full(count, DEPTH), none, none, spread, spread, np.full(count, DEPTH),
        np.ones(count), np.full(count, 0.25), full, np.ones(count), none, none, np.zeros(count, dtype=bool),
    )  # fmt: skip


def shown(angle: float, slip: float, grip: float = 1.0) -> Array:
    """Thrust, pull and rim force (N) of a wheel on soil without cohesion, with the prior's displacement."""
    one = np.ones(1)
    made = sloped_forces(
        WheelRows(
            LOAD * one, DEPTH * one, 0.25 * one, 0.1 * one, slip * one, one, 0.0 * one, angle * one,
            math.log(0.012) * one, one, one, 0.0 * one, grip * one,
        )
    )  # fmt: skip
    return np.asarray(made.values[:, 0])


def balance(angle: float, slip: float, grip: float = 1.0) -> float:
    """What four such wheels pull per mass of the vehicle, m/s^2."""
    return 4.0 * float(shown(angle, slip, grip)[1]) / MASS


def step(
    i: int, slip: float, force: float = math.nan, count: int = 4, soil: int = 0, forward: bool = True,
    torque: Array | None = None, pull: Array | None = None,
) -> Steps:  # fmt: skip
    """The i-th step of 0.1 m of the first wheels, all alike. torque: N m; pull: N."""
    each, nothing = np.full(count, slip), np.full(count, np.nan)
    return Steps(
        np.array([i * 300_000_000]), np.array([0.1]), np.array([forward]), np.array([force]),
        np.array([0.07]), np.array([soil]), np.zeros(count, dtype=int), np.arange(count), each,
        np.full(count, 0.025), nothing if torque is None else torque, nothing if pull is None else pull,
        np.full(count, 0.6), contact(count),
    )  # fmt: skip


def fresh(mass: float = MASS) -> Strengths:
    return Strengths(PRIOR, WHEELS, ALL, mass)


def drive(strengths: Strengths, angle: float, begin: int = 0, soil: int = 0) -> None:
    """Over 6 m of slopes."""
    for i in range(60):
        slip = 0.2 + 0.18 * math.sin(0.4 * i)
        strengths.take(step(begin + i, slip, balance(angle, slip), soil=soil))


def angle_of(strengths: Strengths) -> Quantity:
    return Quantity(*constants_of(strengths.believed.newest[0])["friction_angle"])


@pytest.mark.parametrize("seed", range(5))
def test_forces_without_slopes_are_those_with_them(seed: int) -> None:
    """Whatever the state, and with an effect's factor and a resistance besides."""
    rng = np.random.default_rng(seed)
    strengths = fresh()
    drive(strengths, 0.42)
    now = strengths.believed.newest[0]
    x = now.x + rng.normal(0.0, 0.05, now.x.size)
    x[[COHESION, OTHER]] = rng.uniform(0.0, 500.0), rng.uniform(-0.05, 0.1)
    on = replace(contact(4), factor=rng.uniform(0.6, 1.4, 4), other=rng.uniform(0.0, 5.0, 4))
    slip = rng.uniform(-0.3, 0.9, 4)
    at = Rolling(ALL, on, np.full(4, 0.25), np.full(4, 0.1), slip, 0.1, np.ones(1))
    _, pull, rim = forces(x, now.cells, at)
    np.testing.assert_allclose(pull_and_rim(x, now.cells, at), [pull.value, rim.value], rtol=1e-12)


def test_balance_finds_the_friction_angle() -> None:
    strengths = fresh()
    drive(strengths, 0.42)
    angle = angle_of(strengths)
    assert abs(angle.value - 0.42) < 3.0 * angle.standard_deviation
    # Grip, cohesion and shear displacement take their part of what slopes show.
    assert angle.standard_deviation < 0.8 * PRIOR.friction_angle.standard_deviation
    assert strengths.sources == {"balance"}


def test_what_a_rim_grips_with_is_not_taken_for_the_angle() -> None:
    """Where nobody knows mu, the angle is less sure by as much; what is held is as sure."""
    held = []
    for mu in (Quantity(1.0, 1e-3), Quantity(1.0, 0.2)):
        strengths = Strengths(replace(PRIOR, rim_friction=mu), WHEELS, ALL, MASS)
        drive(strengths, 0.42)
        now = strengths.believed.newest[0]
        at = Rolling(
            ALL, contact(4), np.full(4, 0.25), np.full(4, 0.1), np.full(4, 0.3), 0.0, np.ones(1)
        )
        push = now.forces(at)[0]
        spread = float(np.sqrt(now.product(push.row, push.row))[0]) / float(push.value[0])
        held.append((angle_of(strengths).standard_deviation, spread))
    (sure, of_sure), (unsure, of_unsure) = held
    assert unsure > 1.15 * sure
    assert of_unsure < 1.1 * of_sure


def test_each_soil_keeps_its_strength() -> None:
    strengths = fresh()
    drive(strengths, 0.40)
    first = angle_of(strengths)
    drive(strengths, 0.60, begin=60, soil=1)
    assert angle_of(strengths).value > first.value + 0.08
    strengths.take(step(120, 0.2, count=1))
    again = angle_of(strengths)
    assert again.value == pytest.approx(first.value)
    assert again.standard_deviation == pytest.approx(first.standard_deviation, rel=2e-3)  # 0.1 m on


def test_strength_is_handed_over_to_another_soil_and_less_sure() -> None:
    """F14: a found change of soil had put it back to the prior."""
    strengths = fresh()
    drive(strengths, 0.62)
    before = angle_of(strengths)
    strengths.take(step(60, 0.2, count=1, soil=1))
    after, prior = angle_of(strengths), PRIOR.friction_angle
    off = math.sqrt(0.5) * abs(before.value - prior.value)
    assert abs(after.value - prior.value) == pytest.approx(off, rel=0.02)
    assert before.standard_deviation < after.standard_deviation < prior.standard_deviation


def test_not_all_soils_are_kept_for_ever() -> None:
    strengths = fresh()
    for soil in range(40):
        strengths.take(step(soil, 0.2, soil=soil))
    assert len(strengths._soils) == 4


def test_a_slippery_place_is_grip_and_not_strength() -> None:
    strengths = fresh()
    drive(strengths, 0.5)
    before = angle_of(strengths).value
    push = float(shown(0.5, 0.3, grip=0.4)[0])
    for i in range(6):
        strengths.take(step(60 + i, 0.3, balance(0.5, 0.3, grip=0.4)))
    at = Rolling(
        ALL, contact(4), np.full(4, 0.25), np.full(4, 0.1), np.full(4, 0.3), 0.0, np.ones(1)
    )
    found = strengths.believed.newest[0].forces(at)[0].value
    assert (push < found).all()
    assert (found < 1.7 * push).all()
    # A factor of 0.4 is 3.7 deviations of the grip: strength, of which a metre has told, takes some of it.
    assert angle_of(strengths).value > before - 0.1


def test_a_motor_whose_scale_is_off_does_not_mislead() -> None:
    """The balance tells a motor that shows a quarter too much from the others."""
    strengths = fresh()
    for i in range(120):
        slip = 0.2 + 0.18 * math.sin(0.1 * i)
        torque = np.array([1.25, 1.0, 1.0, 1.0]) * 0.125 * float(shown(0.5, slip)[2])
        strengths.take(step(i, slip, balance(0.5, slip), torque=torque))
    assert strengths.sources == {"balance", "torque"}
    scale = strengths.now.kalman.x[WHEELS_AT + 4 : WHEELS_AT + 8]
    assert scale[0] - scale[1:].mean() == pytest.approx(math.log(1.25), abs=0.05)


@pytest.mark.parametrize("count", [4, 3])
def test_without_a_mass_or_one_of_the_wheels_there_is_no_balance(count: int) -> None:
    strengths = fresh(0.0 if count == 4 else MASS)
    for i in range(30):
        strengths.take(step(i, 0.2, 0.0, count))
    assert strengths.steps == 0
    assert strengths.record() is None


def _one_wheel(slip: float) -> tuple[StrengthFilter, Rolling]:
    size = np.array([0.25]), np.array([0.1])
    at = Rolling(np.array([0]), contact(1), *size, np.array([slip]), 0.0, np.ones(1))
    return StrengthFilter(PRIOR, WHEELS[:1], 0.0), at


@pytest.mark.parametrize("more", [-1.0, 0.0, 1.0])
def test_an_update_finds_the_most_likely_state(more: float) -> None:
    """Of a pull (N) near that which was expected at this slip."""
    made, at = _one_wheel(0.05)
    before, inverse = made.kalman.x.copy(), np.linalg.inv(made.kalman.P)
    pull = more + float(forces(before, made.cells, at)[1].value[0])
    law = 0.02 * LOAD  # what the law itself is believed to be off by

    def unlikely(x: Array) -> float:
        off = pull - float(forces(x, made.cells, at)[1].value[0])
        return float((x - before) @ inverse @ (x - before) + off**2 / (0.6**2 + law**2))

    deviations = np.sqrt(np.diag(made.kalman.P))
    best = minimize(lambda u: unlikely(before + u * deviations), np.zeros(len(before)))
    made.update(at, np.array([np.nan]), np.array([pull]), np.array([0.6]), math.nan, math.nan)
    assert (made.kalman.x - before) / deviations == pytest.approx(best.x, abs=0.03)


@pytest.mark.parametrize("pull", [-8.0, 8.0, 14.0])
def test_an_update_explains_a_pull_that_was_not_expected(pull: float) -> None:
    """To what the law is believed to be off by, 1.2 N, and its noise."""
    made, at = _one_wheel(0.05)
    made.update(at, np.array([np.nan]), np.array([pull]), np.array([0.6]), math.nan, math.nan)
    assert forces(made.kalman.x, made.cells, at)[1].value[0] == pytest.approx(pull, abs=2.7)


def _missing(slip: float, asked: float, ahead: float, behind: float) -> float:
    """What four wheels on two grips (ln) pull more than is asked for, m/s^2."""
    return 0.5 * sum(balance(0.5, slip, math.exp(grip)) for grip in (ahead, behind)) - asked


@pytest.mark.parametrize("seeds", [1, pytest.param(3, marks=pytest.mark.slow)])
def test_places_of_different_grip_are_not_taken_for_a_flat_curve(seeds: int) -> None:
    """Pull is asked for by the slope, slip follows grip, and over the drive pull hardly goes with slip.

    Slopes taken at the slip that was measured end at 0.2 rad for 0.5, five of their deviations too low.
    """
    wide = replace(PRIOR, friction_angle=Quantity(0.5, 0.25))
    off = []
    for seed in range(seeds):
        normal = np.random.default_rng(seed).standard_normal
        strengths = Strengths(wide, WHEELS, ALL, MASS)
        grip = [0.25 * normal()]
        for _ in range(200):
            grip.append(math.exp(-0.1 / 0.7) * grip[-1] + 0.125 * normal())
        for i in range(7, 200):  # wheels behind come to where those ahead were after 7 steps
            asked = 0.3 * math.sin(0.15 * i)
            slip = brentq(_missing, -0.5, 0.95, args=(asked, grip[i], grip[i - 7]))
            slip += 0.01 * normal()
            strengths.take(step(i, slip, asked))
        angle, deviation = constants_of(strengths.believed.newest[0])["friction_angle"]
        off.append((angle - 0.5) / deviation)
    assert np.abs(off).max() < 2.0
    if seeds > 1:
        assert abs(float(np.mean(off))) < 1.0


@settings(max_examples=examples(40), deadline=None)
@given(
    st.lists(
        st.tuples(
            st.floats(-1.0, 1.0),
            st.floats(-50.0, 50.0),
            st.floats(-500.0, 500.0) | st.just(math.nan),
            st.floats(-1e4, 1e4) | st.just(math.nan),
            st.booleans(),
            st.integers(1, 4),
        ),
        min_size=1,
        max_size=25,
    )
)
def test_no_step_breaks_the_filter(
    rows: list[tuple[float, float, float, float, bool, int]],
) -> None:
    strengths = fresh()
    for i, (slip, force, torque, pull, forward, count) in enumerate(rows):
        of = {"torque": np.full(count, torque), "pull": np.full(count, pull)}
        strengths.take(step(i, slip, force, count, forward=forward, **of))
    for one in (strengths.now, strengths.reserve or strengths.now):
        assert np.isfinite(one.kalman.x).all()
        assert np.linalg.eigvalsh(one.kalman.P).min() > -1e-9 * np.abs(one.kalman.P).max()
    told = constants_of(strengths.believed.newest[0])
    assert told["cohesion"][0] >= 0.0
    assert told["shear_displacement"][0] > 0.0


def test_a_record_goes_on_with_the_strength() -> None:
    strengths = fresh()
    assert strengths.record() is None
    drive(strengths, 0.42)
    record = json.loads(json.dumps(strengths.record(), allow_nan=False))
    again = fresh()
    again.restore(record)
    assert angle_of(again) == pytest.approx(angle_of(strengths))
    other = Strengths(replace(PRIOR, cohesion=Quantity(9.0, 1.0)), WHEELS, ALL, MASS)
    with pytest.raises(ValueError, match="another prior of the soil's strength"):
        other.restore(record)
    assert other.record() is None  # nothing has changed


@given(slip=st.floats(0.02, 0.6), grip=st.floats(-1.0, 0.5), cohesion=st.floats(0.0, 1500.0))
@settings(max_examples=examples(20), deadline=None)
def test_slopes_of_forces_are_those_of_differences(
    slip: float, grip: float, cohesion: float
) -> None:
    """By the whole state, and by slip."""
    made = StrengthFilter(PRIOR, WHEELS, MASS)
    x = made.kalman.x.copy()
    x[[COHESION, OTHER, FRICTION]] = cohesion, 0.02, 0.45
    x[WHEELS_AT + len(WHEELS) :] = grip  # and the scales of torques

    def at(slip: float) -> Rolling:
        on = replace(contact(1), factor=np.array([1.2]), other=np.array([1.0]))
        return Rolling(
            np.array([1]), on, np.array([0.25]), np.array([0.1]), np.array([slip]), 0.1, np.ones(1)
        )

    here = forces(x, made.cells, at(slip))
    for place, unit in enumerate(np.eye(len(x))):
        up, down = (forces(x + sign * 1e-6 * unit, made.cells, at(slip)) for sign in (1.0, -1.0))
        for force, more, less in zip(here, up, down, strict=True):
            slope = (more.value[0] - less.value[0]) / 2e-6
            assert force.row[0, place] == pytest.approx(slope, rel=1e-3, abs=1e-4), place
    up, down = (forces(x, made.cells, at(slip + sign * 1e-6)) for sign in (1.0, -1.0))
    for force, more, less in zip(here, up, down, strict=True):
        slope = (more.value[0] - less.value[0]) / 2e-6
        assert force.by_slip[0] == pytest.approx(slope, rel=1e-3, abs=1e-4)


@pytest.mark.parametrize("forward", [True, False])
@pytest.mark.parametrize("moved", [-0.9, 0.9])
def test_where_the_base_frame_is_does_not_matter(moved: float, forward: bool) -> None:
    places = [wheel.longitudinal_position + moved for wheel in WHEELS]
    elsewhere = tuple(
        replace(wheel, longitudinal_position=place)
        for wheel, place in zip(WHEELS, places, strict=True)
    )
    one, other = (StrengthFilter(PRIOR, wheels, MASS) for wheels in (WHEELS, elsewhere))
    for each in (one, other):
        each.move(0.5, forward, 0.02)
    assert other.cells.tolist() == one.cells.tolist()
    np.testing.assert_allclose(other.kalman.P, one.kalman.P, rtol=1e-9, atol=1e-12)
