# SPDX-License-Identifier: Apache-2.0
"""How late a speed comes, and whether an odometry is made of the wheels, from rows made by hand."""

from __future__ import annotations

import numpy as np
import pytest

from smallwheel_ros.pipeline.checks.lateness import LAGS, Lag, OfWheels

SECOND = 1_000_000_000
RATE = 20.0  # Hz


def turns(time: np.ndarray) -> np.ndarray:
    """A rate of turning (rad/s) that never repeats within the lags."""
    return 0.5 * np.sin(0.9 * time) + 0.3 * np.sin(2.3 * time + 1.0)


def lag_of(late: float, sense: float = 1.0, cuts: tuple[int, ...] = ()) -> np.ndarray:
    """The lag found for a speed that comes so much later (s)."""
    time = np.arange(400) / RATE
    follows, followed = sense * turns(time - late), turns(time[:, None] - LAGS / SECOND)
    found, lag = [], Lag()
    for begin, end in zip((0, *cuts), (*cuts, time.size), strict=True):
        found.append(lag.take(follows[begin:end], followed[begin:end]))
    return np.concatenate(found)


@pytest.mark.parametrize("late", [0.0, 0.1, 0.4, 1.0])
def test_a_lag_is_the_one_that_was_put_in(late: float) -> None:
    assert lag_of(late)[-1] == pytest.approx(late)
    np.testing.assert_array_equal(lag_of(late, cuts=(7, 150, 151)), lag_of(late))


def test_what_goes_the_other_way_follows_nothing() -> None:
    assert np.isnan(lag_of(0.2, sense=-1.0)).all()


def test_what_hardly_changes_follows_nothing() -> None:
    time = np.arange(400) / RATE
    even = np.full((time.size, LAGS.size), 0.5)
    assert np.isnan(Lag().take(np.full(time.size, 0.5), even)).all()


def test_nothing_is_told_from_few_rows() -> None:
    found = lag_of(0.3)
    assert np.isnan(found[:99]).all()
    assert np.isfinite(found[-1])


def of_wheels(share: float, seed: int = 1) -> tuple[bool, bool, float]:
    """What is found of an odometry that is a multiple of the rims but for a share of each piece."""
    rng = np.random.default_rng(seed)
    rims = np.full(1000, 0.02)  # m a row: 20 m, forty pieces
    piece = np.repeat(rng.standard_normal(40), 25)  # an error that lasts for a piece
    parts = np.stack([rims, 0.97 * rims * (1.0 + share * piece), 0.0 * rims, 0.0 * rims], axis=1)
    way = np.cumsum(rims)
    made, may_be, off = OfWheels().take(way - rims, way, parts)
    return bool(made[-1]), bool(may_be[-1]), float(off[-1])


def test_an_odometry_of_the_wheels_is_their_multiple() -> None:
    made, _, off = of_wheels(0.0)
    assert made
    assert off < 1e-9


def test_an_odometry_of_its_own_is_not() -> None:
    for seed in range(5):
        made, may_be, off = of_wheels(0.02, seed)
        assert not made
        assert not may_be
        assert 0.01 < off < 0.04


def test_what_few_pieces_say_is_that_it_may_be() -> None:
    rims = np.full(100, 0.02)  # four pieces
    way = np.cumsum(rims)
    made, may_be, _ = OfWheels().take(
        way - rims, way, np.stack([rims, 0.97 * rims, 0.0 * rims, 0.0 * rims], axis=1)
    )
    assert may_be[-1]
    assert not made.any()
