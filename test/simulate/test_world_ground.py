# SPDX-License-Identifier: Apache-2.0
"""The ground of a world, by hand: features along the way, loads of a frame, and where wheels come to rest."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy.integrate import quad

from smallwheel_ros.simulate.wheel_laws import RimStrength
from smallwheel_ros.simulate.world import (
    GRAVITY,
    ROVERS,
    Leg,
    SimulatedRover,
    World,
    wheels_on_axles,
)
from smallwheel_ros.simulate.world_ground import (
    CELL,
    Frame,
    Started,
    TrueGround,
    TrueSoil,
    blocks,
    make_ground,
    pressure_law,
    settle,
    texture,
    tilt,
)

STRENGTH = RimStrength(400.0, 0.55, 0.012)
SAND = TrueSoil(math.log(30e3), 0.8, 0.3, STRENGTH)
FLAT: dict[str, Any] = {"slope": 0.0, "swing": 0.0, "grip": 0.0, "own_grip": 0.0, "scatter": 0.0}


def ground(*started: Started, soils: tuple[TrueSoil, ...] = (SAND,), starts: tuple[float, ...] = (0.0,),
           **world: Any) -> TrueGround:  # fmt: skip
    rng = np.random.default_rng(1)
    plain = World("by hand", legs=(Leg(metres=10.0),), **FLAT | world)
    return make_ground(plain, ROVERS["four"], soils, starts, started, rng)


def test_a_feature_rises_over_its_edge_and_falls_over_it_again() -> None:
    one = Started("modulus", -2.0, start=3.0, edge=0.5, end=6.0)
    places = np.array([2.9, 3.0, 3.25, 3.5, 5.0, 6.0, 6.25, 6.5, 7.0])
    assert one.at(places) == pytest.approx([0.0, 0.0, -1.0, -2.0, -2.0, -2.0, -1.0, 0.0, 0.0])


def test_features_of_a_kind_are_added_up() -> None:
    made = ground(
        Started("grip", 0.4, 1.0, 0.1, 5.0),
        Started("grip", 0.2, 3.0, 0.1, 9.0),
        Started("floor", 1.0, 4.0, 0.1, 6.0),
    )
    places = np.array([0.0, 2.0, 4.0, 8.0])
    assert made.value("grip", places) == pytest.approx([0.0, 0.4, 0.6, 0.2])
    assert made.value("nothing", places) == pytest.approx(0.0)
    cells = made.cells(places)
    assert made.at[cells] == pytest.approx(places, abs=0.5 * CELL + 1e-9)
    np.testing.assert_allclose(made.grip[:, cells], np.tile([0.0, 0.4, 0.6, 0.2], (4, 1)), atol=0.1)
    assert made.floor[0, made.cells(np.array([3.9, 5.0, 6.2]))].tolist() == [False, True, False]
    assert made.cells(np.array([-1e3, 1e3])).tolist() == [0, made.at.size - 1]


def test_each_soil_begins_at_its_place_and_the_first_reaches_back() -> None:
    firm = TrueSoil(math.log(90e3), 1.1, 0.3, STRENGTH)
    made = ground(soils=(SAND, firm), starts=(0.0, 4.0))
    assert made.kinds(np.array([-5.0, 0.0, 3.99, 4.0, 50.0])).tolist() == [0, 0, 0, 1, 1]
    before, after = made.cells(np.array([3.5, 4.5]))
    assert (made.exponent[0, before], made.exponent[0, after]) == (0.8, 1.1)
    assert made.soil is SAND


ROVER = SimulatedRover(
    wheels_on_axles((0.4, 0.3, 0.25, 0.1), (-0.4, 0.3, 0.25, 0.1)), 20.0, 0.0, 0.0, 0.3
)


def test_loads_are_those_of_a_rigid_frame() -> None:
    frame, weight = Frame(ROVER, 0.0), 20.0 * GRAVITY
    assert frame.loads(0.0, 0.0, 0.0, 0.0) == pytest.approx(weight / 4.0)
    # Moments about the axle: the slope takes 0.3 tan(climb) / 0.8 of the weight off the front to the rear.
    climb = 0.2
    front, _, rear, _ = frame.loads(climb, 0.0, 0.0, 0.0)
    assert 2.0 * (front + rear) == pytest.approx(weight * math.cos(climb))
    assert 2.0 * (rear - front) == pytest.approx(
        weight * math.cos(climb) * 2.0 * 0.3 * math.tan(climb) / 0.8
    )
    gained, _, _, _ = frame.loads(0.0, 0.0, GRAVITY * math.tan(climb), 0.0)
    assert gained * math.cos(climb) == pytest.approx(front)  # as a slope of that tangent
    left, right, _, _ = frame.loads(0.0, 0.1, 0.0, 0.0)  # the left side is up
    assert 2.0 * (right - left) == pytest.approx(
        weight * math.cos(0.1) * 2.0 * 0.3 * math.tan(0.1) / 0.6
    )
    twisted = frame.loads(0.0, 0.0, 0.0, 0.2)
    assert twisted == pytest.approx(weight / 4.0 * np.array([1.2, 0.8, 0.8, 1.2]))
    assert Frame(ROVER, 0.2).loads(0.0, 0.0, 0.0, 0.0).sum() == pytest.approx(0.8 * weight)
    lifted = frame.loads(np.array([0.0, 1.3]), 0.0, 0.0, 0.0)
    assert lifted.shape == (2, 4)
    assert lifted[1, 0] == pytest.approx(0.1 * weight / 4.0 * math.cos(1.3))  # no wheel pulls


def test_wheels_rest_where_the_pressure_carries_them() -> None:
    firmer = Started("modulus", math.log(3.0), 2.0, 0.1, 8.0)
    made = ground(firmer)
    settle(made)
    wheel, places = ROVERS["four"].wheels[0], made.cells(np.array([0.5, 5.0]))
    for cell, factor in zip(places, (1.0, 3.0), strict=True):
        z, load = made.rest[0, cell], made.load[0, cell]
        entry = math.acos(1.0 - 2.0 * z / wheel.diameter)

        def upward(t: float) -> float:
            depth = 0.5 * wheel.diameter * (math.cos(t) - math.cos(entry))  # noqa: B023
            pressure = factor * 30e3 * (max(depth, 0.0) / 0.01) ** 0.8  # noqa: B023
            return pressure * (wheel.diameter / 0.2) ** 0.3 * math.cos(t)

        carried = wheel.width * 0.5 * wheel.diameter * quad(upward, 0.0, entry, epsrel=1e-9)[0]
        assert carried == pytest.approx(load, rel=1e-3)
    hard = ground(floor=True)
    assert hard.floor.all()


def test_texture_is_correlated_over_its_length_and_blocks_over_theirs() -> None:
    rng, at = np.random.default_rng(2), np.arange(0.0, 1000.0, CELL)
    made = texture(rng, at, 0.3, 0.25)
    assert np.std(made) == pytest.approx(0.3, rel=0.1)
    lag = round(0.25 / CELL)
    assert np.corrcoef(made[lag:], made[:-lag])[0, 1] == pytest.approx(
        math.exp(-lag * CELL / 0.25), abs=0.05
    )
    coarse = blocks(rng, at, 0.3)
    assert np.std(coarse) == pytest.approx(0.3, rel=0.15)
    lag = round(2.6 / CELL)  # longer than any block
    assert abs(np.corrcoef(coarse[lag:], coarse[:-lag])[0, 1]) < 0.15


def test_stones_are_no_higher_than_they_may_be_and_not_on_the_first_two_metres() -> None:
    made = ground(bumps=0.2)
    assert made.bumps.max() <= 0.2 * 0.25
    assert made.bumps.max() > 0.4 * 0.2 * 0.25 - 1e-3
    assert not made.bumps[:, made.at < 2.0].any()
    assert (made.bumps >= 0.0).all()
    assert not ground().bumps.any()


def test_below_a_hardpan_pressure_rises_eight_times_as_fast() -> None:
    law = pressure_law(np.array([2e6]), np.array([1.0]), 0.03)
    depths = np.array([[-0.01, 0.0, 0.02, 0.03, 0.05]])
    assert law(depths)[0] == pytest.approx(
        2e6 * np.array([0.0, 0.0, 0.02, 0.03, 0.05 + 8.0 * 0.02])
    )
    plain = pressure_law(np.array([2e6]), np.array([1.0]), None)
    assert plain(depths)[0, -1] == pytest.approx(1e5)


def test_climb_and_roll_are_those_of_the_way_it_looks() -> None:
    made = ground(Started("climb", 0.1, -50.0, 0.1, 50.0))
    made.east[:], made.north[:] = 0.2, -0.05
    for yaw, climb, roll in ((0.0, 0.2, -0.05), (np.pi / 2, -0.05, -0.2), (np.pi, -0.2, 0.05)):
        found = tilt(made, 300, yaw)
        assert found == pytest.approx((climb + 0.1, roll))
