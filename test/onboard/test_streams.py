# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import math
import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from smallwheel_ros.estimator.reading import SECOND
from smallwheel_ros.onboard.settings import Timing
from smallwheel_ros.onboard.streams import (
    Motion,
    Series,
    StampFault,
    Travel,
    nanoseconds,
    stamp_problem,
)
from smallwheel_ros.physics.wheel import Wheel

RULES = Timing(future_tolerance=0.5, maximum_age=5.0, jump_tolerance=1.0)
T = 1_700_000_000 * SECOND


def series(*pairs: tuple[float, float], horizon: float = 100.0) -> Series:
    made = Series(nanoseconds(horizon))
    for time, value in pairs:
        assert made.add(T + nanoseconds(time), (value,)) is None
    return made


def value_at(made: Series, time: float, reach: float = 0.2) -> float | None:
    values = made.at(T + nanoseconds(time), nanoseconds(reach))
    return None if values is None else values[0]


class TestStampFault:
    @pytest.mark.parametrize(
        ("stamp", "newest", "now", "fault"),
        [
            (0, None, T, StampFault.ZERO),
            (-5, None, None, StampFault.ZERO),
            (T, None, None, None),
            (T, None, 0, None),  # a simulated clock that nobody has set yet has no opinion
            (T, T, T, None),
            (T + nanoseconds(0.4), None, T, None),
            (T + nanoseconds(0.6), None, T, StampFault.FUTURE),
            (T - nanoseconds(4.9), None, T, None),
            (T - nanoseconds(5.1), None, T, StampFault.TOO_OLD),
            (T - nanoseconds(0.9), T, None, None),
            (T - nanoseconds(1.1), T, None, StampFault.JUMP_BACK),
            # late for the newest stamp, while the clock says that time goes on
            (T - nanoseconds(2.0), T, T + nanoseconds(0.1), StampFault.LATE),
            # the clock went back together with the stamps
            (T - nanoseconds(100.0), T, T - nanoseconds(99.9), StampFault.JUMP_BACK),
        ],
    )
    def test_judges(
        self, stamp: int, newest: int | None, now: int | None, fault: StampFault | None
    ) -> None:
        problem = stamp_problem(stamp, newest, now, RULES)
        assert (problem and problem[0]) is fault


class TestSeries:
    def test_interpolates_between_neighbours(self) -> None:
        made = series((0.0, 10.0), (0.1, 20.0))
        assert value_at(made, 0.025) == pytest.approx(12.5)
        assert value_at(made, 0.1) == 20.0

    def test_holds_the_nearest_within_reach_only(self) -> None:
        made = series((0.0, 10.0), (1.0, 20.0))
        assert value_at(made, 0.15) == 10.0
        assert value_at(made, 0.85) == 20.0
        assert value_at(made, 0.5) is None
        assert value_at(made, 1.15) == 20.0
        assert value_at(made, -0.15) == 10.0
        assert value_at(made, 1.25) is None
        assert value_at(Series(10), 0.0) is None

    def test_does_not_interpolate_over_a_gap(self) -> None:
        # Both neighbours must be within reach: half way over a long gap nothing is known.
        made = series((0.0, 0.0), (0.3, 30.0))
        assert value_at(made, 0.15, reach=0.2) == pytest.approx(15.0)
        assert value_at(made, 0.05, reach=0.2) == 0.0

    def test_faults(self) -> None:
        made = series((0.0, 1.0), (0.2, 2.0), (0.5, 3.0), horizon=0.4)
        assert made.add(T + nanoseconds(0.2), (9.0,)) is StampFault.DUPLICATE
        assert made.add(T + nanoseconds(0.05), (9.0,)) is StampFault.LATE
        assert value_at(made, 0.2) == 2.0

    @given(st.lists(st.integers(0, 400), min_size=1, unique=True), st.randoms())
    def test_order_of_arrival_does_not_matter(
        self, times: list[int], shuffler: random.Random
    ) -> None:
        in_order = series(*((t / 100, math.sin(t)) for t in sorted(times)))
        shuffled = list(times)
        shuffler.shuffle(shuffled)
        mixed = series(*((t / 100, math.sin(t)) for t in shuffled))
        for i in range(420):
            assert value_at(mixed, i / 100) == value_at(in_order, i / 100)

    def test_memory_is_bounded(self) -> None:
        made = Series(nanoseconds(1.0))
        longest = 0
        for i in range(10_000):
            made.add(T + i * nanoseconds(0.01), (float(i),))
            longest = max(longest, len(made.stamps))
        assert longest <= 202
        # nothing within the horizon was lost
        assert made.stamps[-101:] == [T + i * nanoseconds(0.01) for i in range(9899, 10_000)]


class TestPath:
    def path(self, horizon: float = 100.0) -> Travel:
        return Travel(nanoseconds(horizon), nanoseconds(0.2), standstill=0.01)

    def test_integrates_speed(self) -> None:
        made = self.path()
        for i in range(101):
            t = i / 50
            made.move(T + nanoseconds(t), 0.5 * t)
        assert made.at(T + 2 * SECOND)[0] == pytest.approx(1.0, rel=0.01)
        assert made.at(T + SECOND)[0] == pytest.approx(0.25, rel=0.02)

    def test_reverse_is_travel_too(self) -> None:
        made = self.path()
        for i in range(11):
            made.move(T + nanoseconds(i / 10), -0.5)
        assert made.at(T + SECOND)[0] == pytest.approx(0.5)

    def test_standing_still_adds_nothing(self) -> None:
        made = self.path()
        noise = random.Random(1)
        for i in range(1000):
            made.move(T + nanoseconds(i / 30), noise.gauss(0, 0.003), 0.0, noise.gauss(0, 1), 0.0)
        assert made.at(T + 60 * SECOND)[0] < 0.003

    def test_a_gap_counts_by_position(self) -> None:
        made = self.path()
        made.move(T, 0.5, 0.0, 0.0, 0.0)
        made.move(T + 10 * SECOND, 0.0, 0.0, 3.0, 4.0)
        assert made.at(T + 10 * SECOND)[0] == pytest.approx(5.0)
        # a position that only wobbles is no travel
        made.move(T + 20 * SECOND, 0.0, 0.0, 3.0, 4.05)
        assert made.at(T + 20 * SECOND)[0] == pytest.approx(5.0)

    def test_a_gap_without_positions_counts_by_the_slower_end(self) -> None:
        made = self.path()
        made.move(T, 0.5)
        made.move(T + 10 * SECOND, 0.1)
        assert made.at(T + 10 * SECOND)[0] == pytest.approx(1.0)

    def test_a_gap_longer_than_the_memory_does_not_lose_the_path(self) -> None:
        made = self.path(horizon=1.0)
        for i in range(301):
            made.move(T + i * nanoseconds(0.02), 1.0, 0.0, 0.02 * i, 0.0)
        made.move(T + 20 * SECOND, 1.0, 0.0, 9.0, 4.0)
        assert made.at(T + 20 * SECOND)[0] == pytest.approx(6.0 + 5.0)

    def test_it_is_held_outside(self) -> None:
        made = self.path()
        assert made.at(T) is None
        made.move(T, 1.0)
        made.move(T + nanoseconds(0.1), 1.0)
        assert made.at(T - SECOND)[0] == 0.0
        assert made.at(T + SECOND)[0] == pytest.approx(0.1)

    @given(st.permutations(range(12)))
    def test_order_of_arrival_does_not_matter(self, order: list[int]) -> None:
        made, sorted_one = self.path(), self.path()
        for numbers, target in ((order, made), (range(12), sorted_one)):
            for i in numbers:
                target.move(T + i * nanoseconds(0.05), math.cos(i))
        # The path's zero is at whatever came first, so differences are compared.
        for i in range(1, 12):
            steps = [
                o.at(T + i * nanoseconds(0.05))[0] - o.at(T + (i - 1) * nanoseconds(0.05))[0]
                for o in (made, sorted_one)
            ]
            assert steps[0] == pytest.approx(steps[1], abs=1e-12)

    def test_memory_is_bounded_and_the_path_goes_on(self) -> None:
        made = self.path(horizon=1.0)
        for i in range(5001):
            made.move(T + i * nanoseconds(0.02), 1.0)
        assert made.at(T + 100 * SECOND)[0] == pytest.approx(100.0)
        assert len(made.stamps) <= 110

    def test_each_point_has_its_own_path_in_a_turn(self) -> None:
        made = Travel(100 * SECOND, SECOND, 0.01, (0.0, 0.3, -0.3))
        for i in range(3):
            made.move(T + i * SECOND, 0.1, 1.0)
        assert (made.at(T + 2 * SECOND) or ())[:3] == pytest.approx((0.2, 0.4, 0.8))


def test_yaw_is_read_across_the_jump_of_the_angle() -> None:
    """Cosine and sine are interpolated, not the angle."""
    made = Series(10 * SECOND)
    for i, yaw in enumerate((math.pi - 0.1, -math.pi + 0.1)):
        made.add((i + 1) * SECOND, Motion.of(0.0, 2.0 * i, 0.5, 0.0, yaw, 0.0, (0.0, 0.0)))
    between = Motion(*(made.at(3 * SECOND // 2, SECOND) or ()))
    ahead = Wheel("ahead", 0.2, 0.1, longitudinal_position=0.5)
    assert between.place(ahead) == pytest.approx((-0.5, 1.0))
    unknown = Motion.of(0.0, 0.0, 0.5, 0.0, None, math.nan, (math.inf, -1.0))
    assert unknown.place(ahead) is None
    assert unknown[6:] == (0.0, 0.0, 0.0, 0.0)
