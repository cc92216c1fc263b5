# SPDX-License-Identifier: Apache-2.0
"""Cost of ground: the cost function, the crossed ground, terrain classes, and all of it together.

Tests `cost.py`, `cost_map.py`, `crossed_ground.py`, `grid.py` and `terrain.py`.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from random_examples import examples

from smallwheel_ros.bags import message_type
from smallwheel_ros.costmap.cost import CostRules, CostSettings
from smallwheel_ros.costmap.cost_map import CostMap
from smallwheel_ros.costmap.crossed_ground import CrossedGround, Line
from smallwheel_ros.costmap.grid import (
    HERE,
    CostMapError,
    Grid,
    Pose,
    grid_from,
    lay_over,
    union,
)
from smallwheel_ros.costmap.spread import spread
from smallwheel_ros.costmap.terrain import TerrainClasses
from smallwheel_ros.physics.wheel import Quantity, Wheel

RULES = CostRules()
margins = st.floats(-2.0, 2.0)
deviations = st.floats(0.0, 3.0)


def cost(margin: float, deviation: float, rules: CostRules = RULES) -> int:
    return rules.cost(margin, deviation)


class TestCost:
    @given(a=margins, b=margins, deviation=deviations, required=st.floats(-0.5, 0.5))
    def test_more_margin_never_costs_more(
        self, a: float, b: float, deviation: float, required: float
    ) -> None:
        rules = CostRules(required_margin=required)
        low, high = min(a, b), max(a, b)
        assert cost(low, deviation, rules) >= cost(high, deviation, rules)

    @given(margin=st.floats(1e-6, 2.0), a=deviations, b=deviations)
    def test_less_certainty_never_costs_less_where_ground_is_passable(
        self, margin: float, a: float, b: float
    ) -> None:
        assert cost(margin, max(a, b)) >= cost(margin, min(a, b))

    @given(margin=st.floats(), deviation=st.floats(min_value=0.0))
    def test_range_and_unknown(self, margin: float, deviation: float) -> None:
        value = cost(margin, deviation)
        assert -1 <= value <= 100
        if math.isfinite(margin) and math.isfinite(deviation):
            assert value >= 0
        if math.isnan(margin) or math.isnan(deviation):
            assert value == -1

    @given(margin=st.floats(1e-6, 2.0), deviation=deviations)
    def test_uncertainty_alone_is_never_lethal(self, margin: float, deviation: float) -> None:
        assert cost(margin, deviation) <= 50

    def test_cost_is_the_risk(self) -> None:
        draws = np.random.default_rng(1).normal(0.08, 0.1, 200_000)
        assert cost(0.08, 0.1) == round(100 * np.mean(draws < 0.0))
        assert cost(0.08, 0.1, CostRules(required_margin=0.05)) == round(
            100 * np.mean(draws < 0.05)
        )

    def test_firm_ground_is_cheap_and_what_cannot_be_crossed_is_lethal(self) -> None:
        assert cost(0.25, 0.08) == 0
        assert cost(-0.3, 0.05) == 100

    def test_what_is_exact_and_what_is_not_known(self) -> None:
        assert [cost(0.0, 0.1), cost(-1.0, 0.0), cost(0.3, 0.0)] == [50, 100, 0]
        assert [cost(math.nan, 0.0), cost(0.0, math.nan)] == [-1, -1]

    @pytest.mark.parametrize("margin", [3.0, math.nan])
    def test_refusals(self, margin: float) -> None:
        with pytest.raises(CostMapError, match="required_margin"):
            CostRules(required_margin=margin)


def line_cells(
    start: tuple[float, float], end: tuple[float, float], resolution: float
) -> set[tuple[int, int]]:
    """Cells under a line, from points that lie much closer together than cells."""
    s = np.linspace(0, 1, 400)
    rows = np.floor((start[1] + s * (end[1] - start[1])) / resolution).astype(int)
    columns = np.floor((start[0] + s * (end[0] - start[0])) / resolution).astype(int)
    return set(zip(rows.tolist(), columns.tolist(), strict=True))


# Places off the borders of cells, where rounding decides.
places = st.integers(-3000, 3000).map(lambda i: 0.01 * i + 0.0037)
steps = st.integers(-60, 60).map(lambda i: 0.0133 * i)


def line(x: float, y: float, width: float = 0.1, heading: float = 0.0) -> Line:
    """An axle of that width across the way."""
    pose = Pose(x, y, heading)
    return pose.place(0.0, 0.5 * width), pose.place(0.0, -0.5 * width)


def cross(
    ground: CrossedGround,
    wheel: str,
    at: tuple[float, float],
    cost: int,
    travel: float = 0.0,
    *,
    width: float = 0.1,
    own: tuple[float, float] | None = None,
    heading: float = 0.0,
    stuck: bool = False,
) -> bool:
    """Lay a strip; own: y of the wheel's edges, if it is narrower than the vehicle."""
    whole = line(*at, width, heading)
    wheels = whole if own is None else ((at[0], own[0]), (at[0], own[1]))
    ground.follow(*at)
    return ground.cross(wheel, (whole, wheels), travel, cost, 100 if stuck else -1)


class TestCrossedGround:
    @settings(max_examples=examples(50))
    @given(x=places, y=places, dx=steps, dy=steps, width=st.floats(0.02, 0.5))
    def test_a_strip_is_marked_and_nothing_far_from_it(
        self, x: float, y: float, dx: float, dy: float, width: float
    ) -> None:
        ground = CrossedGround(8.0, 0.1)
        heading = math.atan2(dy, dx)
        cross(ground, "a", (x, y), 10, width=width, heading=heading)
        cross(ground, "a", (x + dx, y + dy), 10, width=width, heading=heading)
        grid = ground.grid("odom")
        corner = (round(grid.origin[1] / 0.1), round(grid.origin[0] / 0.1))
        marked = {(r + corner[0], c + corner[1]) for r, c in np.argwhere(grid.cells >= 0).tolist()}
        for row, column in marked:
            # From the cell's middle to the line; its corners are half a diagonal away.
            u, v = 0.1 * (column + 0.5) - x, 0.1 * (row + 0.5) - y
            share = (u * dx + v * dy) / max(dx * dx + dy * dy, 1e-12)
            share = min(max(share, 0.0), 1.0)
            gap = math.hypot(u - share * dx, v - share * dy)
            assert gap <= 0.5 * width + 0.071
        # Of the line itself only cells that it merely grazes may be missed: both ends, and a few on its way.
        if math.hypot(dx, dy) >= 0.05:
            middle = line_cells((x, y), (x + dx, y + dy), 0.1)
            ends = {
                (math.floor(b / 0.1), math.floor(a / 0.1)) for a, b in ((x, y), (x + dx, y + dy))
            }
            assert len(middle - marked - ends) <= 0.2 * len(middle) + 1

    @settings(max_examples=examples(60))
    @given(st.lists(st.tuples(places, places), min_size=1, max_size=12))
    def test_the_window_follows_and_nothing_is_lost(self, way: list[tuple[float, float]]) -> None:
        ground = CrossedGround(12.0, 0.5)
        for i, (x, y) in enumerate(way):
            cross(ground, f"wheel {i}", (x, y), i, travel=10.0 * i)
            grid = ground.grid("odom")
            assert grid.cells.shape == (24, 24)
            # Always well inside of the window, and its own cost is there.
            cell = grid.cell(x, y)
            assert cell is not None
            assert 6 <= cell[0] < 18
            assert 6 <= cell[1] < 18
            assert grid.cells[cell] == i
        # On one lattice, whatever the way was.
        assert np.allclose(np.array(grid.origin) % 0.5 % 0.5, 0.0, atol=1e-9)
        whole = ground.whole("odom")
        assert whole is not None
        for i, (x, y) in enumerate(way):
            assert whole.cells[whole.cell(x, y)] >= i

    def test_nothing_is_marked_over_a_jump(self) -> None:
        ground = CrossedGround(20.0, 0.1)
        cross(ground, "a", (0.05, 0.05), 7)
        cross(ground, "a", (4.05, 0.05), 7)
        assert int((ground.grid("odom").cells >= 0).sum()) <= 6

    def at(self, ground: CrossedGround, x: float, y: float) -> int:
        grid = ground.grid("odom")
        return int(grid.cells[grid.cell(x, y)])

    def test_of_wheels_in_one_crossing_the_worst_counts_of_crossings_the_newest(self) -> None:
        ground = CrossedGround(20.0, 0.1, length=1.0)
        for order, costs in (
            ((0.0, 0.7), (30, 60)),
            ((10.0, 10.7), (60, 20)),
            ((20.0, 20.7), (5, 9)),
        ):
            for wheel, travel, cost in zip(("front", "rear"), order, costs, strict=True):
                cross(ground, wheel, (0.05, 0.05), cost, travel)
                cross(ground, wheel, (1.05, 0.05), cost, travel)
                ground.skip(wheel)
            assert self.at(ground, 0.55, 0.05) == max(costs)

    def test_the_newest_cost_of_a_standing_wheel_counts_but_stuck_is_stuck(self) -> None:
        ground = CrossedGround(20.0, 0.1)
        for cost in (27, 85, 40):
            assert cross(ground, "a", (0.05, 0.05), cost)
            assert self.at(ground, 0.05, 0.05) == cost
        assert not cross(ground, "a", (0.05, 0.05), 40)
        cross(ground, "a", (0.05, 0.05), 40, stuck=True)
        cross(ground, "a", (0.05, 0.05), 40)
        assert self.at(ground, 0.05, 0.05) == 100

    def test_looking_at_the_grid_changes_nothing_beside_the_vehicle_either(self) -> None:
        ground = CrossedGround(20.0, 0.1)
        for cost in (85, 40):
            cross(ground, "a", (0.05, 0.05), cost, own=(0.35, 0.25))  # a wheel that stands out
            assert self.at(ground, 0.05, 0.3) == cost

    def test_where_it_was_stuck_only_a_wheel_that_rolls_there_tells_otherwise(self) -> None:
        ground = CrossedGround(20.0, 0.1, length=1.0)
        cross(ground, "a", (0.05, 0.0), 100, 0.0, width=0.6, stuck=True)
        ground.skip("a")
        for wheel, own in (("left", (0.3, 0.15)), ("right", (-0.15, -0.3))):
            cross(ground, wheel, (-0.35, 0.0), 10, 5.0, width=0.6, own=own)
            cross(ground, wheel, (0.45, 0.0), 10, 5.0, width=0.6, own=own)
        assert self.at(ground, 0.05, 0.0) == 100
        assert self.at(ground, 0.05, 0.25) == self.at(ground, 0.05, -0.25) == 10
        assert self.at(ground, -0.25, 0.0) == 10

    def test_what_an_axle_gets_through_is_taken_back_over_the_whole_width(self) -> None:
        for away, left in ((1.3, {10}), (0.9, {10, 100})):
            ground = CrossedGround(20.0, 0.1, length=1.0)
            for x in np.arange(0.05, 0.6, 0.1):
                cross(ground, "a", (x, 0.0), 10, x, width=0.6)
            cross(ground, "a", (0.65, 0.0), 10, 0.65, width=0.6, stuck=True)
            for x in np.arange(0.75, 0.65 + away, 0.1):
                cross(ground, "a", (x, 0.0), 10, x, width=0.6)
            cells = ground.grid("odom").cells
            assert set(cells[cells >= 0].tolist()) == left

    def test_what_it_backs_out_of_is_not_taken_back(self) -> None:
        ground = CrossedGround(20.0, 0.1, length=1.0)
        for x in np.arange(0.05, 0.6, 0.1):
            cross(ground, "a", (x, 0.0), 10, x, width=0.6)
        cross(ground, "a", (0.65, 0.0), 10, 0.65, width=0.6, stuck=True)
        for i, x in enumerate(np.arange(0.55, -3.0, -0.1)):
            cross(ground, "a", (x, 0.0), 10, 0.75 + 0.1 * i, width=0.6)
        assert self.at(ground, 0.63, 0.0) == 100
        assert self.at(ground, 0.25, 0.0) == 10

    def test_without_a_place_or_a_frame_there_is_no_grid(self) -> None:
        ground = CrossedGround(1.0, 0.1)
        assert ground.grid("odom") is None
        ground.follow(0.0, 0.0)
        assert ground.grid("odom") is not None
        assert ground.grid("") is ground.whole("") is None

    def test_refusals(self) -> None:
        with pytest.raises(CostMapError, match="expected at most"):
            CrossedGround(500.0, 0.01)
        with pytest.raises(CostMapError, match="resolution"):
            CrossedGround(1.0, 2.0)


class TestTerrainClasses:
    def test_a_class_is_what_was_found_on_it(self) -> None:
        classes = TerrainClasses(RULES, 0.1)
        for i in range(40):
            assert classes.learn("a", 0.2 * i, 0.0, 3, Quantity(0.1 + 0.02 * (-1) ** i, 0.01))
        found = classes.margins()[3]
        assert found.value == pytest.approx(0.1)
        assert found.standard_deviation == pytest.approx(math.hypot(0.02, 0.01), rel=0.15)
        assert set(classes.margins()) == {3}

    def test_first_touch_costs_more_than_a_long_crossing(self) -> None:
        classes = TerrainClasses(RULES, 0.1)
        costs = []
        for i in range(30):
            classes.learn("a", 0.2 * i, 0.0, 0, Quantity(0.12, 0.01))
            costs.append(int(classes.table()[0]))
        assert costs == sorted(costs, reverse=True)
        # One place: the scatter counts twice.
        assert costs[0] == cost(0.12, math.hypot(0.01, math.sqrt(2) * 0.05))
        # In the end little is left but the estimate's own uncertainty.
        assert costs[-1] <= cost(0.12, 0.01) + 12

    def test_places_at_one_spot_count_once(self) -> None:
        classes = TerrainClasses(RULES, 0.1)
        assert classes.learn("a", 0.0, 0.0, 0, Quantity(0.1, 0.01))
        assert not classes.learn("a", 0.05, 0.0, 0, Quantity(0.1, 0.01))
        assert classes.learn("b", 0.05, 0.0, 0, Quantity(0.1, 0.01))
        assert not classes.learn("a", 5.0, 0.0, -1, Quantity(0.1, 0.01))
        assert classes.places() == {0: 2}

    @settings(max_examples=examples(50))
    @given(
        cells=st.lists(st.integers(-128, 127), min_size=1, max_size=60),
        known=st.dictionaries(st.integers(0, 127), st.floats(-0.5, 0.5), max_size=6),
    )
    def test_every_cell_gets_the_cost_of_its_class_or_unknown(
        self, cells: list[int], known: dict[int, float]
    ) -> None:
        classes = TerrainClasses(RULES, 0.1)
        for terrain, margin in known.items():
            classes.learn("a", float(terrain), 0.0, terrain, Quantity(margin, 0.02))
        grid = Grid("map", 0.5, (1.0, 2.0), np.array([cells], dtype=np.int8))
        costs = classes.costs(grid)
        assert costs.geometry == grid.geometry
        for terrain, value in zip(cells, costs.cells[0].tolist(), strict=True):
            margin = classes.margins().get(terrain)
            if margin is None:
                assert value == -1
            else:
                assert value == min(cost(margin.value, margin.standard_deviation), 99)
                assert 0 <= value <= 100


WHEEL = Wheel("a", 0.2, 0.1)
ROVER = tuple(
    Wheel(f"{x} {y}", 0.2, 0.1, lateral_position=y, longitudinal_position=x)
    for x in (0.3, -0.3)
    for y in (0.3, -0.3)
)


def made(
    wheels: tuple[Wheel, ...] = (WHEEL,), prior: Quantity | None = None, **changes: object
) -> CostMap:
    """A map that is not spread, unless it is said otherwise."""
    settings_ = CostSettings(**{"size": 10.0, "spread": 0.0, "unknown": "none", **changes})  # type: ignore[arg-type]
    return CostMap(settings_, wheels, prior)


def drive(
    cost_map: CostMap,
    to: float,
    margin: Quantity | None,
    start: float = 0.0,
    y: float = 0.0,
    wheels: tuple[Wheel, ...] = (WHEEL,),
    travel: float = 0.0,
    **stuck: bool,
) -> None:
    for x in np.arange(start, to, math.copysign(0.02, to - start)):
        for wheel in wheels:
            way = travel + abs(x - start)
            cost_map.add(wheel, "odom", Pose(float(x), y, 0.0), way, margin, **stuck)


def spread_of(cost_map: CostMap) -> Grid | None:
    """The grid that planners get which check a point."""
    grids = cost_map.grids()
    return None if grids is None else grids.spread


class TestCostMap:
    def test_crossed_ground_has_its_cost_and_the_rest_is_unknown(self) -> None:
        cost_map = made()
        assert spread_of(cost_map) is None
        drive(cost_map, 2.0, Quantity(0.05, 0.0741))
        grid = spread_of(cost_map)
        assert grid is not None
        assert grid.frame == "odom"
        assert set(np.unique(grid.cells)) == {-1, 25}
        for x in (0.05, 1.0, 1.95):
            assert grid.cells[grid.cell(x, 0.01)] == 25
        assert grid.cells[grid.cell(1.0, 0.5)] == -1

    def test_changed_only_when_a_cell_has_changed(self) -> None:
        cost_map = made()
        assert not cost_map.changed
        drive(cost_map, 0.02, None)
        assert cost_map.changed  # a window of unknown cells is worth telling
        drive(cost_map, 1.0, Quantity(0.05, 0.0741))
        spread_of(cost_map)
        assert not cost_map.changed
        drive(cost_map, 1.0, Quantity(0.05, 0.0741))
        cost_map.add(WHEEL, "odom", Pose(0.5, 0.0, 0.0), 9.0, Quantity(0.05, 0.03))
        assert cost_map.changed

    def test_where_nothing_is_known_nothing_is_marked(self) -> None:
        cost_map = made()
        drive(cost_map, 0.5, Quantity(0.05, 0.0741))
        cost_map.add(WHEEL, "odom", Pose(0.6, 0.0, 0.0), 9.0, None)
        drive(cost_map, 2.0, Quantity(0.05, 0.0741), start=1.5)
        grid = spread_of(cost_map)
        assert grid is not None
        assert grid.cells[grid.cell(1.0, 0.01)] == -1

    def test_what_is_expected_is_dear_but_never_an_obstacle(self) -> None:
        cost_map = made()
        drive(cost_map, 1.0, Quantity(-0.5, 0.01))
        cost_map.add(WHEEL, "odom", Pose(1.02, 0.0, 0.0), 9.0, Quantity(0.3, 0.01), risk=1.0)
        grids = cost_map.grids()
        assert grids is not None
        grid = grids.bare
        assert grid.cells[grid.cell(0.5, 0.01)] == grid.cells[grid.cell(1.02, 0.01)] == 99

    def test_stuck_is_lethal_even_without_having_moved(self) -> None:
        cost_map = made()
        drive(cost_map, 1.0, Quantity(0.05, 0.0741))
        cost_map.add(WHEEL, "odom", Pose(0.98, 0.0, 0.0), 9.0, Quantity(0.05, 0.0741), stuck=True)
        grid = spread_of(cost_map)
        assert grid is not None
        assert grid.cells[grid.cell(0.98, 0.01)] == 99  # as long as it is there
        drive(cost_map, -1.0, None, start=0.9)
        grid = spread_of(cost_map)
        assert grid.cells[grid.cell(0.98, 0.01)] == 100

    def test_terrain_classes_carry_the_cost_ahead(self) -> None:
        cost_map = made()
        cells = np.zeros((20, 60), dtype=np.int8)
        cells[:, 20:] = 1
        cells[:, 40:] = 2
        cells[0, :] = -1
        cost_map.take_classes(Grid("odom", 0.25, (-1.0, -2.5), cells))
        drive(cost_map, 3.9, Quantity(0.15, 0.005))
        drive(cost_map, 6.0, Quantity(0.03, 0.005), start=4.1)
        grid = spread_of(cost_map)
        assert grid is not None
        assert (grid.resolution, grid.origin, grid.cells.shape) == (0.25, (-1.0, -2.5), (20, 60))
        firm, soft = grid.cells[15, 5], grid.cells[15, 30]
        assert 0 <= firm < soft <= 99
        assert (grid.cells[15, 45:] == -1).all()  # class 2: nobody has been there
        assert (grid.cells[0] == -1).all()
        # What was crossed has what was found, which is surer than what is expected of the class.
        assert grid.cells[grid.cell(1.0, 0.01)] == cost(0.15, 0.005) <= firm
        assert sorted(cost_map.ahead.classes.places()) == [0, 1]

    @pytest.mark.parametrize("resolution", [0.03, 0.1, 0.17, 0.5])
    def test_crossed_cells_reach_a_class_grid_of_any_resolution(self, resolution: float) -> None:
        cost_map = made()
        side = math.ceil(6.0 / resolution)
        cost_map.take_classes(
            Grid("odom", resolution, (-3.0, -3.0), np.full((side, side), -1, np.int8))
        )
        drive(cost_map, 2.0, Quantity(0.05, 0.0741))
        grid = spread_of(cost_map)
        assert grid is not None
        for x in np.arange(0.05, 1.9, resolution / 3):
            assert grid.cells[grid.cell(float(x), 0.01)] == 25, x

    def test_of_several_crossed_cells_in_one_the_worst_counts(self) -> None:
        for first, second in ((0.08, 0.01), (0.01, 0.08)):
            cost_map = made()
            cost_map.take_classes(Grid("odom", 1.0, (-3.0, -3.0), np.full((6, 6), -1, np.int8)))
            drive(cost_map, 0.9, Quantity(first, 0.05), y=0.2)
            drive(cost_map, 0.9, Quantity(second, 0.05), y=0.7)
            grid = spread_of(cost_map)
            assert grid is not None
            assert grid.cells[grid.cell(0.5, 0.5)] == cost(0.01, 0.05) > cost(0.08, 0.05)

    def test_classes_of_another_frame_are_said_and_stay_unknown(self) -> None:
        cost_map = made(size=40.0)
        cost_map.take_classes(Grid("map", 0.5, (0.0, 0.0), np.zeros((4, 4), np.int8)))
        drive(cost_map, 1.0, Quantity(0.05, 0.0741))
        assert "in frame map, positions are in odom" in cost_map.problem
        grid = spread_of(cost_map)
        assert grid is not None
        assert (grid.cells == -1).all()

    def test_clear_forgets_and_is_a_change(self) -> None:
        cost_map = made()
        drive(cost_map, 1.0, Quantity(0.05, 0.0741))
        spread_of(cost_map)
        cost_map.clear()
        assert cost_map.changed
        assert (spread_of(cost_map).cells == -1).all()

    def test_another_frame_is_another_ground(self) -> None:
        cost_map = made()
        drive(cost_map, 1.0, Quantity(0.05, 0.0741))
        cost_map.add(WHEEL, "odom2", Pose(0.0, 0.0, 0.0), 9.0, Quantity(0.2, 0.0))
        grid = spread_of(cost_map)
        assert grid is not None
        assert grid.frame == "odom2"
        assert set(np.unique(grid.cells)) == {-1, 0}


GOOD, BAD = Quantity(0.3, 0.01), Quantity(0.0, 0.05)


def at(cost_map: CostMap, x: float, y: float) -> int:
    grid = spread_of(cost_map)
    assert grid is not None
    return int(grid.cells[grid.cell(x, y)])


class TestVehicle:
    def test_the_whole_swath_costs_and_it_is_spread_to_the_outermost_corner(self) -> None:
        plain, default = made(ROVER), made(ROVER, spread=None)
        for cost_map in (plain, default):
            drive(cost_map, 3.0, BAD, wheels=ROVER)
        # And from a cell's middle to its corner.
        assert default.spread == pytest.approx(math.hypot(0.3, 0.35) + math.hypot(0.05, 0.05))
        for y in (0.0, 0.15, -0.25, 0.33):
            assert at(plain, 1.5, y) == at(default, 1.5, y) == 50
        assert at(plain, 1.5, 0.55) == -1
        assert at(default, 1.5, 0.55) == at(default, 1.5, -0.55) == 50
        assert at(default, 1.5, 0.75) == 50
        assert at(default, 1.5, 1.05) == -1

    @pytest.mark.parametrize("resolution", [0.05, 0.1])
    def test_where_the_middle_is_cheap_no_wheel_stands_on_dear_ground(
        self, resolution: float
    ) -> None:
        """Whichever way the vehicle looks; so a planner that goes by base_link keeps all wheels off."""
        cost_map = made(ROVER, spread=None, resolution=resolution)
        cells = np.full((61, 61), 0, np.int8)
        cells[30, 30] = 100
        dear = spread(cells, cost_map.spread / resolution) == 100
        outline = cost_map.outline
        rows, columns = np.nonzero(~dear)
        for yaw in np.arange(0.0, math.pi, 0.05):
            for ahead in (outline.rear, outline.front):
                for left in (outline.right, outline.left):
                    x, y = Pose(0.0, 0.0, float(yaw)).place(ahead, left)
                    at_row = np.floor((rows + 0.5) + y / resolution).astype(int)
                    at_column = np.floor((columns + 0.5) + x / resolution).astype(int)
                    assert not np.any((at_row == 30) & (at_column == 30)), yaw
        assert dear.sum() < 1.5 * math.pi * (cost_map.spread / resolution) ** 2  # and no more

    def test_who_is_stuck_is_let_out_and_does_not_come_back_there(self) -> None:
        for settings_ in ({"spread": 0.0}, {"spread": None}):
            cost_map = made(ROVER, **settings_)
            drive(cost_map, 2.0, GOOD, wheels=ROVER)
            for wheel in ROVER[:2]:
                cost_map.add(wheel, "odom", Pose(2.0, 0.0, 0.0), 2.0, None, stuck=True)
            for back in np.arange(2.0, 0.0, -0.1):
                cost_map.add(ROVER[0], "odom", Pose(back, 0.0, 0.0), 4.0 - back, None)
                outline = [(back + a, b) for a in (-0.35, 0.0, 0.35) for b in (-0.3, 0.0, 0.3)]
                assert max(at(cost_map, *place) for place in outline) <= 99
            assert at(cost_map, 2.25, 0.0) == at(cost_map, 2.25, 0.25) == 100
            # Whoever is put onto it again gets out as well.
            cost_map.add(ROVER[0], "odom", Pose(2.2, 0.0, 0.0), 9.0, None)
            assert at(cost_map, 2.25, 0.0) == at(cost_map, 2.25, 0.25) == 99

    def test_driving_up_to_it_does_not_open_it(self) -> None:
        cost_map = made(ROVER, spread=None)
        drive(cost_map, 2.0, GOOD, wheels=ROVER)
        cost_map.add(ROVER[0], "odom", Pose(2.0, 0.0, 0.0), 2.0, None, stuck=True)
        drive(cost_map, 0.0, None, start=1.9, wheels=ROVER)
        for x in (0.5, 1.0, 1.5):
            cost_map.add(ROVER[0], "odom", Pose(x, 0.0, 0.0), 9.0, None)
            assert at(cost_map, 2.25, 0.0) == 100

    @pytest.mark.parametrize(("unknown", "costs"), [("none", -1), ("prior", 30)])
    def test_a_prior_is_for_ground_that_a_class_tells_of_and_no_other(
        self, unknown: str, costs: int
    ) -> None:
        cost_map = made(ROVER, spread=None, unknown=unknown, prior=Quantity(0.0524, 0.1))
        drive(cost_map, 3.0, GOOD, wheels=ROVER)
        # Ground that nothing tells of stays unknown, whatever Nav2 makes of that.
        assert at(cost_map, 1.5, 2.0) == at(cost_map, 4.5, 0.0) == -1
        # What was crossed is no dearer than what nobody has seen, nor is what lies beside it.
        assert at(cost_map, 1.5, 0.0) == at(cost_map, 1.5, 0.55) == 0
        terrain = np.full((30, 40), 3, np.int8)
        terrain[25:], terrain[:5] = 8, -1
        cost_map.take_classes(Grid("odom", 0.2, (-2.0, -3.0), terrain))
        drive(cost_map, 1.0, GOOD, start=2.9, wheels=ROVER, travel=3.0)
        assert 0 <= at(cost_map, 4.5, 0.0) < 5  # of a class that was crossed
        assert at(cost_map, 1.5, 2.5) == costs  # of one that was not
        assert at(cost_map, 1.5, -2.5) == -1  # not classified

    def test_an_unfit_vehicle_and_uncertainty_alone_make_no_obstacle(self) -> None:
        cost_map = made(ROVER, spread=None, unknown="prior", prior=Quantity(-1.0, 0.0))
        cost_map.take_classes(Grid("odom", 0.2, (-2.0, -3.0), np.zeros((30, 40), np.int8)))
        cost_map.add(ROVER[0], "odom", Pose(0.0, 0.0, 0.0), 0.0, None)
        assert at(cost_map, 1.5, 2.0) == 99

    def test_forgetting_the_ground_leaves_what_was_believed_before(self) -> None:
        cost_map = made(ROVER, spread=None, unknown="prior", prior=Quantity(0.0524, 0.1))
        cost_map.take_classes(Grid("odom", 0.2, (-2.0, -3.0), np.zeros((30, 40), np.int8)))
        drive(cost_map, 3.0, GOOD, wheels=ROVER)
        assert at(cost_map, 4.5, 0.0) < 5
        cost_map.clear()
        cost_map.add(ROVER[0], "odom", Pose(0.0, 0.0, 0.0), 0.0, None)
        assert at(cost_map, 4.5, 0.0) == 30

    def test_a_class_on_which_it_was_stuck_and_was_not_is_said(self) -> None:
        cost_map = made(ROVER)
        cost_map.take_classes(Grid("odom", 0.25, (-2.0, -2.0), np.zeros((20, 40), np.int8)))
        drive(cost_map, 3.0, GOOD, wheels=ROVER)
        assert cost_map.problem == ""
        cost_map.add(ROVER[0], "odom", Pose(3.0, 0.0, 0.0), 3.0, None, stuck=True)
        at(cost_map, 0.0, 0.0)
        assert "terrain class 0 is both: stuck at 1 of" in cost_map.problem
        # Once it has got through, nothing is left of that.
        drive(cost_map, 4.5, GOOD, start=3.02, travel=3.0, wheels=ROVER)
        at(cost_map, 0.0, 0.0)
        assert cost_map.problem == ""
        assert cost_map.ahead.classes.margins()[0].value == pytest.approx(GOOD.value)


class TestRemembered:
    def test_an_earlier_map_lies_below_what_is_found_now(self) -> None:
        old = Grid("odom", 0.2, (0.0, -1.0), np.full((10, 30), 40, np.int8))
        cost_map = made(ROVER)
        cost_map.remember(old)
        drive(cost_map, 3.0, GOOD, wheels=ROVER)
        assert at(cost_map, 1.5, 0.0) == 0
        assert at(cost_map, 1.5, 0.7) == 40
        whole = cost_map.whole()
        assert whole is not None
        assert whole.cells[whole.cell(5.5, 0.5)] == 40
        assert whole.cells[whole.cell(1.5, 0.0)] == 0

    def test_a_map_of_another_frame_is_said_and_laid_once_tf_tells_where(self) -> None:
        # odom is 10 m east of map, and turned to the north.
        cells = np.full((4, 4), -1, np.int8)
        cells[1, 2] = 77
        cost_map = made(ROVER)
        cost_map.remember(Grid("map", 0.5, (10.0, 0.0), cells))
        drive(cost_map, 1.0, GOOD, wheels=ROVER)
        assert "saved cost map is in frame map" in cost_map.problem
        assert at(cost_map, 0.75, -1.25) == -1
        cost_map.place_frame("map", Pose(10.0, 0.0, math.pi / 2))
        assert cost_map.problem == ""
        assert cost_map.changed
        assert at(cost_map, 0.75, -1.25) == 77
        whole = cost_map.whole()
        assert whole is not None
        assert whole.frame == "map"
        assert whole.cells[whole.cell(11.25, 0.75)] == 77

    @settings(max_examples=examples(30))
    @given(x=places, y=places, heading=st.floats(-3.2, 3.2), side=st.sampled_from([0.05, 0.1, 0.3]))
    def test_a_turned_layer_leaves_no_holes(
        self, x: float, y: float, heading: float, side: float
    ) -> None:
        above = Grid("odom", side, (0.0, 0.0), np.full((int(2 / side), int(3 / side)), 5, np.int8))
        pose = Pose(x, y, heading)
        whole = union("map", [(above, pose), (Grid("map", 0.1, (x, y), above.cells), HERE)])
        lay_over(whole, above, pose)
        for u, v in np.random.default_rng(1).uniform(0.2, 1.7, (50, 2)):
            assert whole.cells[whole.cell(*pose.place(u, v))] == 5


class TestGridFrom:
    def make(self, **changes: object) -> Grid:
        """Of a message as it comes from a bag. turn: z and w of the origin's quaternion."""
        wanted = {"frame": "map", "resolution": 0.1, "size": (3, 2), "place": (0.0, 1.0)}
        wanted |= {"turn": (0.0, 1.0), "data": np.arange(6, dtype=np.int8), **changes}
        (width, height), (x, y), (z, w) = wanted["size"], wanted["place"], wanted["turn"]
        stamp = message_type("builtin_interfaces/msg/Time")(sec=0, nanosec=0)
        header = message_type("std_msgs/msg/Header")(stamp=stamp, frame_id=wanted["frame"])
        origin = message_type("geometry_msgs/msg/Pose")(
            position=message_type("geometry_msgs/msg/Point")(x=x, y=y, z=0.0),
            orientation=message_type("geometry_msgs/msg/Quaternion")(x=0.0, y=0.0, z=z, w=w),
        )
        info = message_type("nav_msgs/msg/MapMetaData")(
            map_load_time=stamp,
            resolution=wanted["resolution"],
            width=width,
            height=height,
            origin=origin,
        )
        grid = message_type("nav_msgs/msg/OccupancyGrid")
        return grid_from(grid(header=header, info=info, data=wanted["data"]))

    def test_row_major(self) -> None:
        assert self.make().cells.tolist() == [[0, 1, 2], [3, 4, 5]]
        assert self.make(turn=(0.0, -1.0)).origin == (0.0, 1.0)

    @pytest.mark.parametrize(
        ("changes", "words"),
        [
            ({"frame": ""}, "no frame: header.frame_id is empty"),
            ({"resolution": 0.0}, "resolution is 0.0 m"),
            ({"resolution": math.nan}, "resolution is nan m"),
            ({"size": (3, 3)}, r"has 6 cells, expected width \* height = 3 \* 3"),
            ({"size": (0, 0), "data": np.empty(0, np.int8)}, "expected .* at least one cell"),
            ({"place": (math.inf, 0.0)}, "origin is .*inf.*, expected finite numbers"),
            ({"turn": (0.7071, 0.7071)}, "is turned"),
            ({"turn": (0.0, 0.0)}, "is turned"),
            ({"turn": (0.0, math.nan)}, "is turned"),
        ],
    )
    def test_refusals(self, changes: dict[str, object], words: str) -> None:
        with pytest.raises(CostMapError, match=words):
            self.make(**changes)
