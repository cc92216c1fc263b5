# SPDX-License-Identifier: Apache-2.0
"""Cost of ground: the cost function, the crossed ground, terrain classes, and all of it together."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from random_examples import examples

from smallwheel_ros.costmap.cost import CostRules
from smallwheel_ros.costmap.cost_map import CostMap, CostSettings
from smallwheel_ros.costmap.crossed_ground import CrossedGround
from smallwheel_ros.costmap.grid import CostMapError, Grid, grid_of
from smallwheel_ros.costmap.terrain_classes import TerrainClasses
from smallwheel_ros.physics.wheel import Quantity

RULES = CostRules()
margins = st.floats(-2.0, 2.0)
deviations = st.floats(0.0, 3.0)
STRAIGHT = (0.0, 0.0, 0.0, 1.0)


def cost(margin: float, deviation: float, rules: CostRules = RULES) -> int:
    return int(rules.cost(margin, deviation))


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

    def test_arrays(self) -> None:
        found = RULES.cost([[0.0, np.nan], [-1.0, 0.3]], [[0.1, 0.0], [0.0, 0.0]])
        assert found.dtype == np.int8
        assert found.tolist() == [[50, -1], [100, 0]]

    @pytest.mark.parametrize("changes", [{"required_margin": 3.0}, {"class_scatter": math.nan}])
    def test_refusals(self, changes: dict[str, float]) -> None:
        with pytest.raises(CostMapError, match=next(iter(changes))):
            CostRules(**changes)


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


class TestCrossedGround:
    @settings(max_examples=examples(50))
    @given(
        x=places,
        y=places,
        dx=steps,
        dy=steps,
        width=st.floats(0.02, 0.5),
    )
    def test_a_strip_is_marked_and_nothing_far_from_it(
        self, x: float, y: float, dx: float, dy: float, width: float
    ) -> None:
        ground = CrossedGround(8.0, 0.1)
        ground.cross("a", x, y, width, 10)
        ground.cross("a", x + dx, y + dy, width, 10)
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
        # Of the line itself only cells that it merely grazes may be missed.
        middle = line_cells((x, y), (x + dx, y + dy), 0.1)
        assert len(middle - marked) <= 0.2 * len(middle) + 1

    @settings(max_examples=examples(60))
    @given(st.lists(st.tuples(places, places), min_size=1, max_size=12))
    def test_the_window_follows_and_keeps_what_is_in_it(
        self, way: list[tuple[float, float]]
    ) -> None:
        ground = CrossedGround(12.0, 0.5)
        for i, (x, y) in enumerate(way):
            ground.cross(f"wheel {i}", x, y, 0.1, i)
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
        last = way[-1]
        for i, (x, y) in enumerate(way):
            if all(math.hypot(u - last[0], v - last[1]) < 2.0 for u, v in way[i:]):
                cell = grid.cell(x, y)
                assert cell is not None
                assert grid.cells[cell] >= i

    def test_nothing_is_marked_over_a_jump(self) -> None:
        ground = CrossedGround(20.0, 0.1)
        ground.cross("a", 0.05, 0.05, 0.05, 7)
        ground.cross("a", 4.05, 0.05, 0.05, 7)
        assert int((ground.grid("odom").cells >= 0).sum()) <= 4

    def test_refusals(self) -> None:
        with pytest.raises(CostMapError, match="expected at most"):
            CrossedGround(500.0, 0.01)
        with pytest.raises(CostMapError, match="resolution"):
            CrossedGround(1.0, 2.0)
        with pytest.raises(CostMapError, match="no place yet"):
            CrossedGround(1.0, 0.1).grid("odom")


class TestTerrainClasses:
    def test_a_class_is_what_was_found_on_it(self) -> None:
        classes = TerrainClasses(RULES, 0.1)
        for i in range(40):
            assert classes.learn("a", 0.2 * i, 0.0, 3, Quantity(0.1 + 0.02 * (-1) ** i, 0.01))
        found = classes.margin(3)
        assert found is not None
        assert found.value == pytest.approx(0.1)
        assert found.standard_deviation == pytest.approx(math.hypot(0.02, 0.01), rel=0.15)
        assert classes.margin(4) is None

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
            margin = classes.margin(terrain)
            if margin is None:
                assert value == -1
            else:
                assert value == cost(margin.value, margin.standard_deviation)
                assert 0 <= value <= 100


def drive(
    cost_map: CostMap, to: float, margin: Quantity, start: float = 0.0, y: float = 0.0
) -> None:
    for x in np.arange(start, to, 0.02):
        cost_map.add("a", "odom", (float(x), y), 0.1, margin)


class TestCostMap:
    def test_crossed_ground_has_its_cost_and_the_rest_is_unknown(self) -> None:
        cost_map = CostMap(CostSettings(size=10.0))
        assert cost_map.grid() is None
        drive(cost_map, 2.0, Quantity(0.05, 0.0741))
        grid = cost_map.grid()
        assert grid is not None
        assert grid.frame == "odom"
        assert set(np.unique(grid.cells)) == {-1, 25}
        for x in (0.05, 1.0, 1.95):
            assert grid.cells[grid.cell(x, 0.01)] == 25
        assert grid.cells[grid.cell(1.0, 0.5)] == -1

    def test_changed_only_when_a_cell_has_changed(self) -> None:
        cost_map = CostMap(CostSettings(size=10.0))
        assert not cost_map.changed
        cost_map.follow("odom", 0.0, 0.0)
        assert cost_map.changed  # a window of unknown cells is worth telling
        drive(cost_map, 1.0, Quantity(0.05, 0.0741))
        cost_map.grid()
        assert not cost_map.changed
        drive(cost_map, 1.0, Quantity(0.05, 0.0741))
        cost_map.follow("odom", 0.5, 0.0)
        assert not cost_map.changed
        cost_map.add("a", "odom", (0.5, 0.0), 0.1, Quantity(0.05, 0.03))
        assert cost_map.changed

    def test_where_nothing_is_known_nothing_is_marked(self) -> None:
        cost_map = CostMap(CostSettings(size=10.0))
        drive(cost_map, 0.5, Quantity(0.05, 0.0741))
        cost_map.add("a", "odom", (0.6, 0.0), 0.1, None)
        drive(cost_map, 2.0, Quantity(0.05, 0.0741), start=1.5)
        grid = cost_map.grid()
        assert grid is not None
        assert grid.cells[grid.cell(1.0, 0.01)] == -1

    def test_stuck_is_lethal_even_without_having_moved(self) -> None:
        cost_map = CostMap(CostSettings(size=10.0))
        drive(cost_map, 1.0, Quantity(0.05, 0.0741))
        cost_map.add("a", "odom", (0.98, 0.0), 0.1, Quantity(0.05, 0.0741), stuck=True)
        grid = cost_map.grid()
        assert grid is not None
        assert grid.cells[grid.cell(0.98, 0.01)] == 100

    def test_terrain_classes_carry_the_cost_ahead(self) -> None:
        cost_map = CostMap(CostSettings(size=10.0))
        cells = np.zeros((20, 60), dtype=np.int8)
        cells[:, 20:] = 1
        cells[:, 40:] = 2
        cells[0, :] = -1
        cost_map.take_classes(Grid("odom", 0.25, (-1.0, -2.5), cells))
        drive(cost_map, 3.9, Quantity(0.15, 0.005))
        drive(cost_map, 6.0, Quantity(0.03, 0.005), start=4.1)
        grid = cost_map.grid()
        assert grid is not None
        assert (grid.resolution, grid.origin, grid.cells.shape) == (0.25, (-1.0, -2.5), (20, 60))
        firm, soft = grid.cells[15, 5], grid.cells[15, 30]
        assert 0 <= firm < soft <= 99
        assert (grid.cells[15, 45:] == -1).all()  # class 2: nobody has been there
        assert (grid.cells[0] == -1).all()
        # What was crossed has what was found, which is surer than what is expected of the class.
        assert grid.cells[grid.cell(1.0, 0.01)] == cost(0.15, 0.005) <= firm
        assert sorted(cost_map.classes.places()) == [0, 1]

    @pytest.mark.parametrize("resolution", [0.03, 0.1, 0.17, 0.5])
    def test_crossed_cells_reach_a_class_grid_of_any_resolution(self, resolution: float) -> None:
        cost_map = CostMap(CostSettings(size=10.0, resolution=0.1))
        side = math.ceil(6.0 / resolution)
        cost_map.take_classes(
            Grid("odom", resolution, (-3.0, -3.0), np.full((side, side), -1, np.int8))
        )
        drive(cost_map, 2.0, Quantity(0.05, 0.0741))
        grid = cost_map.grid()
        assert grid is not None
        for x in np.arange(0.05, 1.9, resolution / 3):
            assert grid.cells[grid.cell(float(x), 0.01)] == 25, x

    def test_of_several_crossed_cells_in_one_the_worst_counts(self) -> None:
        for first, second in ((0.08, 0.01), (0.01, 0.08)):
            cost_map = CostMap(CostSettings(size=10.0, resolution=0.1))
            cost_map.take_classes(Grid("odom", 1.0, (-3.0, -3.0), np.full((6, 6), -1, np.int8)))
            drive(cost_map, 0.9, Quantity(first, 0.05), y=0.2)
            drive(cost_map, 0.9, Quantity(second, 0.05), y=0.7)
            grid = cost_map.grid()
            assert grid is not None
            assert grid.cells[grid.cell(0.5, 0.5)] == cost(0.01, 0.05) > cost(0.08, 0.05)

    def test_classes_of_another_frame_are_said_and_stay_unknown(self) -> None:
        cost_map = CostMap(CostSettings())
        cost_map.take_classes(Grid("map", 0.5, (0.0, 0.0), np.zeros((4, 4), np.int8)))
        drive(cost_map, 1.0, Quantity(0.05, 0.0741))
        assert "in frame map, positions are in odom" in cost_map.problem
        grid = cost_map.grid()
        assert grid is not None
        assert (grid.cells == -1).all()
        told = CostMap(CostSettings(frame="map"))
        told.take_classes(Grid("map", 0.5, (0.0, 0.0), np.zeros((4, 4), np.int8)))
        drive(told, 1.0, Quantity(0.05, 0.0741))
        assert told.problem == ""
        assert (told.grid().cells >= 0).all()

    def test_clear_forgets_and_is_a_change(self) -> None:
        cost_map = CostMap(CostSettings(size=10.0))
        drive(cost_map, 1.0, Quantity(0.05, 0.0741))
        cost_map.grid()
        cost_map.clear()
        assert cost_map.changed
        assert (cost_map.grid().cells == -1).all()

    def test_another_frame_is_another_ground(self) -> None:
        cost_map = CostMap(CostSettings(size=10.0))
        drive(cost_map, 1.0, Quantity(0.05, 0.0741))
        cost_map.add("a", "odom2", (0.0, 0.0), 0.1, Quantity(0.2, 0.0))
        grid = cost_map.grid()
        assert grid is not None
        assert grid.frame == "odom2"
        assert set(np.unique(grid.cells)) == {-1, 0}


class TestGridOf:
    def make(self, **changes: object) -> Grid:
        arguments: dict[str, object] = {
            "frame": "map",
            "resolution": 0.1,
            "size": (3, 2),
            "position": (0.0, 1.0, 0.0),
            "orientation": STRAIGHT,
            "data": np.arange(6, dtype=np.int8),
            **changes,
        }
        return grid_of(**arguments)  # type: ignore[arg-type]

    def test_row_major(self) -> None:
        assert self.make().cells.tolist() == [[0, 1, 2], [3, 4, 5]]
        assert self.make(orientation=(0.0, 0.0, 0.0, -1.0)).origin == (0.0, 1.0)

    @pytest.mark.parametrize(
        ("changes", "words"),
        [
            ({"frame": ""}, "no frame: header.frame_id is empty"),
            ({"resolution": 0.0}, "resolution is 0.0 m"),
            ({"resolution": math.nan}, "resolution is nan m"),
            ({"size": (3, 3)}, r"has 6 cells, expected width \* height = 3 \* 3"),
            ({"size": (0, 0), "data": np.empty(0, np.int8)}, "is empty"),
            ({"position": (math.inf, 0.0, 0.0)}, "origin is not finite"),
            ({"orientation": (0.0, 0.0, 0.7071, 0.7071)}, "is turned"),
            ({"orientation": (0.0, 0.0, 0.0, 0.0)}, "is turned"),
        ],
    )
    def test_refusals(self, changes: dict[str, object], words: str) -> None:
        with pytest.raises(CostMapError, match=words):
            self.make(**changes)
