# SPDX-License-Identifier: Apache-2.0
"""The way back along base_link's own track. Tests `own_track.py`."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from random_examples import examples

from smallwheel_ros.costmap.grid import HERE, Grid, Pose
from smallwheel_ros.costmap.own_track import OwnTrack


def dear() -> Grid:
    return Grid("odom", 0.1, (-2.0, -2.0), np.full((40, 40), 100, dtype=np.int8))


@settings(max_examples=examples(60))
@given(
    way=st.lists(st.tuples(st.floats(-1.9, 1.9), st.floats(-1.9, 1.9)), min_size=2, max_size=80),
    home=st.integers(0, 99),
    turn=st.floats(-3.0, 3.0),
)
def test_every_place_of_it_costs_what_the_way_back_does(
    way: list[tuple[float, float]], home: int, turn: float
) -> None:
    track, poses = OwnTrack(0.1), [Pose(x, y, 0.0) for x, y in way]
    for last, pose in pairwise(poses):
        track.follow(last, pose, home)
    costs, lies = dear(), Pose(0.1, -0.2, turn)
    track.leave_way_home(costs, lies, free=5)
    for pose in poses[1:]:
        # The cell of the track that it was in has been left in some cell around it.
        at = costs.cell(*lies.place(pose.x, pose.y))
        if at is not None and min(at) >= 1 and max(at) < 39:
            around = costs.cells[at[0] - 1 : at[0] + 2, at[1] - 1 : at[1] + 2]
            assert around.min() == (home if home > 5 else 0)


def test_between_two_places_no_cell_is_missed_and_none_over_a_jump() -> None:
    track = OwnTrack(0.1)
    track.follow(Pose(-1.0, 0.05, 0.0), Pose(0.5, 0.05, 0.0), 30)
    costs = dear()
    track.leave_way_home(costs, HERE, free=0)
    assert (costs.cells[20, 11:25] == 30).all()
    far = OwnTrack(0.1)
    far.follow(Pose(-1.9, 0.05, 0.0), Pose(1.5, 0.05, 0.0), 30)
    costs = dear()
    far.leave_way_home(costs, HERE, free=0)
    assert (costs.cells != 100).sum() == 1


def test_where_it_was_stuck_stays_what_it_is() -> None:
    track, here = OwnTrack(0.1), Pose(0.05, 0.05, 0.0)
    track.follow(here, here, 100)
    track.follow(here, here, 10)
    costs = dear()
    track.leave_way_home(costs, HERE, free=0)
    assert (costs.cells == 100).all()


def test_it_makes_nothing_dearer_and_can_be_forgotten() -> None:
    track = OwnTrack(0.1)
    track.follow(Pose(0.0, 0.0, 0.0), Pose(1.0, 0.0, math.pi), 50)
    cheap = Grid("odom", 0.1, (-2.0, -2.0), np.full((40, 40), 20, dtype=np.int8))
    track.leave_way_home(cheap, HERE, free=0)
    assert (cheap.cells == 20).all()
    track.clear()
    costs = dear()
    track.leave_way_home(costs, HERE, free=0)
    assert (costs.cells == 100).all()
