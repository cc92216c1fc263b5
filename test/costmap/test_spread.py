# SPDX-License-Identifier: Apache-2.0
"""Costs spread over their surroundings, at once and again and again. Tests `spread.py`."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from random_examples import examples

from smallwheel_ros.costmap.grid import Grid
from smallwheel_ros.costmap.spread import Spreader, spread, wide


class TestSpread:
    @settings(max_examples=examples(40))
    @given(
        known=st.dictionaries(
            st.tuples(st.integers(0, 14), st.integers(0, 17)), st.integers(0, 100)
        ),
        reach=st.floats(0.0, 6.0),
    )
    def test_each_cell_has_the_dearest_within_reach(
        self, known: dict[tuple[int, int], int], reach: float
    ) -> None:
        cells = np.full((15, 18), -1, np.int8)
        for at, value in known.items():
            cells[at] = value
        found = spread(cells, reach)
        for at in np.ndindex(cells.shape):
            near = [v for place, v in known.items() if math.dist(at, place) <= reach]
            assert found[at] == max(near, default=-1)

    def test_a_grid_of_many_cells_is_spread_as_its_parts_are(self) -> None:
        rng = np.random.default_rng(3)
        cells = np.where(rng.uniform(size=(900, 700)) < 0.02, 50, -1).astype(np.int8)
        cells[rng.integers(0, 900, 200), rng.integers(0, 700, 200)] = 100
        found = spread(cells, 5.0)
        for row in range(0, 900, 90):
            low = max(row - 5, 0)
            part = spread(cells[low : row + 95], 5.0)
            assert np.array_equal(found[row : row + 90], part[row - low : row - low + 90])


def grid_of(cells: np.ndarray) -> Grid:
    return Grid("odom", 0.5, (0.0, 0.0), cells.astype(np.int8))


changes = st.lists(
    st.tuples(st.integers(0, 19), st.integers(0, 24), st.integers(-1, 100)), max_size=3
)


class TestSpreader:
    @settings(max_examples=examples(100))
    @given(turns=st.lists(changes, max_size=6), reach=st.floats(0.0, 3.0))
    def test_what_changes_is_spread_as_a_new_grid_is(
        self, turns: list[list[tuple[int, int, int]]], reach: float
    ) -> None:
        spreader, cells = Spreader(reach), np.full((20, 25), -1, np.int8)
        for turn in turns:
            for row, column, cost in turn:
                cells[row, column] = cost
            grid = grid_of(cells)
            assert np.array_equal(spreader.spread(grid).cells, spread(cells, reach / 0.5))

    def test_what_a_reader_does_with_a_grid_is_forgotten(self) -> None:
        spreader, cells = Spreader(1.0), np.full((9, 9), -1, np.int8)
        cells[4, 4] = 100
        grid = grid_of(cells)
        first = spreader.spread(grid)
        expected = first.cells.copy()
        first.cells[:] = 7
        grid.cells[:] = 7
        cells[4, 4] = 100
        assert np.array_equal(spreader.spread(grid_of(cells)).cells, expected)

    def test_another_place_is_spread_anew(self) -> None:
        spreader, cells = Spreader(1.0), np.full((9, 9), -1, np.int8)
        cells[4, 4] = 100
        here = spreader.spread(grid_of(cells))
        there = spreader.spread(replace(grid_of(cells), origin=(0.5, 0.0)))
        assert there.origin == (0.5, 0.0)
        assert np.array_equal(here.cells, there.cells)


def test_a_wide_one_has_room_for_all_that_is_spread() -> None:
    found = wide(Grid("odom", 0.1, (1.0, 2.0), np.array([[100]], dtype=np.int8)), 0.35)
    assert found.cells.shape == (9, 9)
    assert found.origin == (1.0 - 0.4, 2.0 - 0.4)
    assert found.cells[4, 4] == found.cells[1, 4] == 100
    assert found.cells[0, 4] == -1
