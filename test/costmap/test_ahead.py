# SPDX-License-Identifier: Apache-2.0
"""Ground ahead and ground that was crossed, on one map: what is feared, what is proven, and the way home."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from smallwheel_ros.costmap.cost import CostRules, CostSettings
from smallwheel_ros.costmap.cost_map import CostMap
from smallwheel_ros.costmap.elevation import Elevation
from smallwheel_ros.costmap.grid import Grid, Pose
from smallwheel_ros.costmap.terrain import PRIORS
from smallwheel_ros.physics.wheel import Quantity, Wheel

ROVER = tuple(
    Wheel(f"{x} {y}", 0.2, 0.1, lateral_position=y, longitudinal_position=x)
    for x in (0.3, -0.3)
    for y in (0.3, -0.3)
)
ANY, SAND = Quantity(0.31, 0.18), Quantity(0.2, 0.05)


def made(prior: Quantity | None = ANY, names: tuple[str, ...] = (), **settings: object) -> CostMap:
    given = {"size": 20.0, **settings}
    return CostMap(CostSettings(**given), ROVER, prior, names)  # type: ignore[arg-type]


def drive(
    cost_map: CostMap, to: float, margin: Quantity = SAND, start: float = 0.0, **more: float
) -> None:
    for x in np.arange(start, to, math.copysign(0.02, to - start)):
        for wheel in ROVER:
            cost_map.add(wheel, "odom", Pose(float(x), 0.0, 0.0), abs(float(x)), margin, **more)


def at(cost_map: CostMap, x: float, y: float = 0.0, bare: bool = True) -> int:
    grids = cost_map.grids()
    assert grids is not None
    grid = grids.bare if bare else grids.spread
    return int(grid.cells[grid.cell(x, y)])


def slope_of(slope: float, frame: str = "odom", **classes: np.ndarray) -> Elevation:
    """Ground from -5 to 15 m ahead, 10 m wide, that is level till 5 m."""
    cells = np.full((100, 200), slope)
    cells[:, :100] = 0.0
    return Elevation(frame, 0.1, (-5.0, -5.0), cells, np.full((100, 200), 0.01), classes)


class TestShown:
    @given(margin=st.floats(-1.0, 1.0), deviation=st.floats(0.0, 1.0), shown=st.floats(-1.0, 1.0))
    def test_what_was_shown_never_makes_it_dearer(
        self, margin: float, deviation: float, shown: float
    ) -> None:
        rules = CostRules()
        cost = rules.cost(margin, deviation, shown)
        assert 0 <= cost <= rules.cost(margin, deviation) or cost == 0

    def test_it_is_what_is_left_of_what_was_believed(self) -> None:
        draws = np.random.default_rng(1).normal(0.1, 0.2, 400_000)
        left = draws[draws > -0.15]
        assert CostRules().cost(0.1, 0.2, -0.15) == round(100 * np.mean(left < 0.0))
        assert CostRules(0.1).cost(0.1, 0.2, -0.15) == round(100 * np.mean(left < 0.1))
        assert CostRules().cost(-0.5, 0.01, 0.0) == 0  # it did get over
        assert CostRules().cost(math.nan, 0.1, 0.0) == -1

    def test_forecasts_are_no_obstacles(self) -> None:
        costs = CostRules().expected(np.array([-9.0, 9.0, math.nan]), np.array([0.1, 0.1, 0.1]))
        assert costs.tolist() == [99, 0, -1]


class TestProven:
    def test_ground_that_was_crossed_is_never_dearer_than_ground_that_nobody_has_seen(self) -> None:
        cost_map = made()
        assert 5 < cost_map.free < 20
        drive(cost_map, 3.0, ANY)
        assert at(cost_map, 1.5) == at(cost_map, 1.5, bare=False) == 0
        assert at(cost_map, 1.5, 3.0) == -1

    def test_grades_above_it_stay_as_they_are(self) -> None:
        cost_map = made(free_below=10.0)
        drive(cost_map, 1.0, Quantity(0.1, 0.1))
        drive(cost_map, 2.2, Quantity(0.15, 0.1), start=1.5)
        assert at(cost_map, 0.5) == 16
        assert at(cost_map, 1.9) == 0
        whole = cost_map.whole()
        assert whole is not None
        assert whole.cells[whole.cell(1.9, 0.0)] == 7  # what is saved is what was found

    def test_the_way_back_down_a_slope_is_cheap_though_the_slope_is_dear(self) -> None:
        cost_map = made()
        drive(cost_map, 4.0, Quantity(0.25, 0.05), slope=0.25, demand=0.25)
        assert at(cost_map, 2.0) == 50
        assert at(cost_map, 2.0, 0.6, bare=False) == 50
        assert at(cost_map, 2.0, bare=False) == 0


class TestTwoGrids:
    def test_the_bare_one_has_each_cell_s_own_cost_and_the_other_the_highest_around(self) -> None:
        cost_map = made()
        drive(cost_map, 3.0)
        cost_map.add(ROVER[0], "odom", Pose(3.04, 0.0, 0.0), 3.04, None, stuck=True)
        drive(cost_map, 0.5, start=2.9)
        grids = cost_map.grids()
        assert grids is not None
        assert grids.bare.geometry == grids.spread.geometry
        assert (grids.spread.cells >= grids.bare.cells)[grids.bare.cells < 0].all()
        lethal = np.argwhere(grids.bare.cells == 100)
        # Under the stuck axle, over the vehicle's width.
        assert len(lethal) in range(7, 17)
        assert at(cost_map, 3.35) == at(cost_map, 3.35, bare=False) == 100
        assert at(cost_map, 3.75) == -1
        assert at(cost_map, 3.75, bare=False) == 100

    def test_a_vehicle_that_moves_has_something_to_publish(self) -> None:
        cost_map = made()
        drive(cost_map, 1.0)
        cost_map.grids()
        assert not cost_map.changed
        cost_map.add(ROVER[0], "odom", Pose(0.98, 0.0, 0.0), 1.0, SAND)
        cost_map.grids()
        cost_map.add(ROVER[0], "odom", Pose(0.9, 0.0, 0.0), 1.1, SAND)
        assert cost_map.changed


class TestSlopes:
    def test_slopes_have_a_cost_before_a_wheel_is_on_them(self) -> None:
        cost_map = made()
        cost_map.take_elevation(slope_of(0.3))
        drive(cost_map, 2.0)
        cost_map.expect(Quantity(0.2, 0.08))
        assert at(cost_map, 7.0) == 89
        assert at(cost_map, 4.0) == 1
        # What was crossed has what was found.
        assert at(cost_map, 1.0) == 0
        cost_map.expect(Quantity(0.2, 0.0))
        assert at(cost_map, 7.0) == 99

    def test_what_was_crossed_is_seen_and_no_forecast_any_more(self) -> None:
        cost_map = made()
        cost_map.take_elevation(slope_of(0.3))
        drive(cost_map, 8.0, Quantity(0.5, 0.02), slope=0.3)
        cost_map.expect(Quantity(0.2, 0.08))
        assert at(cost_map, 7.0) == 0
        assert at(cost_map, 7.0, 2.0) == 89
        # Its own track is spared what the ground beside it is feared for.
        assert at(cost_map, 7.0, bare=False) == 0
        assert at(cost_map, 7.0, 0.3, bare=False) == 89

    def test_another_frame_waits_for_tf_and_is_said(self) -> None:
        cost_map = made()
        cost_map.take_elevation(slope_of(0.3, frame="map"))
        drive(cost_map, 1.0)
        cost_map.expect(Quantity(0.2, 0.08))
        assert "map of elevations is in frame map, positions are in odom" in cost_map.problem
        assert at(cost_map, 7.0) == -1
        cost_map.place_frame("map", Pose(2.0, 0.0, 0.0))
        assert cost_map.problem == ""
        assert at(cost_map, 5.5) == 89
        assert at(cost_map, 2.0) == 1

    def test_forgetting_the_ground_keeps_what_others_have_given(self) -> None:
        cost_map = made()
        cost_map.take_elevation(slope_of(0.3))
        drive(cost_map, 2.0)
        cost_map.expect(Quantity(0.2, 0.0))
        cost_map.clear()
        drive(cost_map, 0.1)
        assert 30 < at(cost_map, 7.0) < 60  # as any ground


class TestClasses:
    def test_a_named_class_costs_before_it_is_met_and_learns_from_then_on(self) -> None:
        cost_map = made(names=("asphalt", "ice", "building"))
        cells = np.zeros((40, 60), dtype=np.int8)
        cells[20:], cells[:5] = 1, 2
        cost_map.take_classes(Grid("odom", 0.25, (-5.0, -5.0), cells))
        cost_map.add(ROVER[0], "odom", Pose(0.0, -2.0, 0.0), 0.0, None)
        ice = PRIORS["ice"].margin(0.4)
        assert at(cost_map, 5.0, -2.0) == 0
        assert at(cost_map, 5.0, 3.0) == CostRules().cost(ice.value, ice.standard_deviation) == 5
        assert at(cost_map, 5.0, -4.5) == CostRules().cost(ANY.value, ANY.standard_deviation)
        # Ice that holds after all, at 40 places.
        for x in np.arange(0.0, 4.0, 0.1):
            cost_map.ahead.classes.learn("a", float(x), 3.0, 1, Quantity(0.4, 0.02))
        assert cost_map.ahead.classes.margins()[1].value == pytest.approx(0.385, abs=0.01)
        assert at(cost_map, 5.0, 3.0) == 0

    def test_a_prior_is_worth_two_places(self) -> None:
        cost_map = made(names=("sand",))
        classes = cost_map.ahead.classes
        assert classes.margins()[0].value == pytest.approx(0.199, abs=0.001)
        assert classes.margins()[0].standard_deviation == pytest.approx(0.10)
        for x in (0.0, 1.0):
            classes.learn("a", x, 0.0, 0, Quantity(0.3, 0.0))
        assert classes.margins()[0].value == pytest.approx((0.199 + 0.3) / 2, abs=0.001)

    def test_layers_mix_and_slopes_come_on_top(self) -> None:
        """The moments of a mixture, drawn; by the normal distribution that has them."""
        whole = np.ones((100, 200))
        cost_map = made(names=("sand", "grass"))
        cost_map.take_elevation(slope_of(0.2, sand=0.5 * whole, grass=0.5 * whole))
        drive(cost_map, 0.1)
        sand, grass = (
            PRIORS[name].margin(0.7) for name in ("sand", "grass")
        )  # what they give at most
        rng = np.random.default_rng(2)
        draws = np.where(
            rng.uniform(size=200_000) < 0.5,
            rng.normal(sand.value, sand.standard_deviation, 200_000),
            rng.normal(grass.value, grass.standard_deviation, 200_000),
        )
        left = rng.normal(draws.mean() - 0.2, math.hypot(draws.std(), 0.01), 200_000)
        assert at(cost_map, 7.0) == pytest.approx(100 * np.mean(left < 0.0), abs=1.0)

    def test_a_forecast_of_a_class_is_no_obstacle(self) -> None:
        cost_map = made()
        cost_map.take_classes(Grid("odom", 0.25, (-5.0, -5.0), np.zeros((40, 60), np.int8)))
        for _ in range(3):
            cost_map.add(ROVER[0], "odom", Pose(0.0, 0.0, 0.0), 0.0, None, stuck=True)
        assert at(cost_map, 5.0, 3.0) == 99
