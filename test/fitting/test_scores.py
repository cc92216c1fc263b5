# SPDX-License-Identifier: Apache-2.0
"""Tests `held_out.py`."""

from __future__ import annotations

import numpy as np
import pytest

from smallwheel_ros.fitting.held_out import CvErrors, compare_cv
from smallwheel_ros.measurements.measurements import Measurements
from smallwheel_ros.measurements.settings import levels, parts, varies
from smallwheel_ros.physics.conditions import Conditions


def errors(values: np.ndarray, run: np.ndarray) -> CvErrors:
    return CvErrors({"sinkage": values}, run)


def test_rmse_and_bias_of_known_residuals() -> None:
    made = errors(np.array([3.0, -1.0, np.nan, 1.0]), np.array([0, 0, 1, 2]))
    found = made.score("sinkage")
    assert found is not None
    assert (found.rows, found.runs) == (3, 2)
    assert found.rmse == pytest.approx(np.sqrt(11 / 3))
    assert found.bias == pytest.approx(1.0)
    assert found.rmse_std is None  # two runs say nothing of the spread between runs
    some = made.score("sinkage", np.array([True, False, True, False]))
    assert some is not None
    assert (some.rows, some.rmse) == (1, 3.0)


def test_nothing_to_score_is_none() -> None:
    empty = errors(np.full(3, np.nan), np.arange(3))
    assert empty.score("sinkage") is None
    assert empty.score("resistance") is None
    assert errors(np.ones(3), np.arange(3)).score("sinkage", np.zeros(3, dtype=bool)) is None
    assert "sinkage" not in compare_cv(errors(np.ones(3), np.arange(3)), empty).reduction


def test_a_difference_is_paired_over_runs() -> None:
    """Two models that share their error are told apart by far less than the error itself."""
    rng = np.random.default_rng(6)
    run, noise = np.repeat(np.arange(30), 3), rng.normal(0, 1.0, 90)
    same = compare_cv(errors(noise, run), errors(noise, run))
    assert (same.reduction, same.z_score) == ({"sinkage": 0.0}, {"sinkage": 0.0})
    assert not same.worse
    longer = compare_cv(errors(noise, run), errors(1.1 * noise, run))
    assert longer.reduction["sinkage"] == pytest.approx(-0.1)
    assert longer.worse == ("sinkage",)
    other = compare_cv(errors(noise, run), errors(rng.permutation(noise), run))
    assert not other.worse


def test_a_difference_is_of_the_rows_that_both_predict() -> None:
    one, run = np.array([1.0, 1.0, 9.0, 9.0]), np.arange(4)
    half = np.array([2.0, 2.0, np.nan, np.nan])
    found = compare_cv(errors(one, run), errors(half, run))
    assert found.reduction["sinkage"] == pytest.approx(-1.0)


@pytest.mark.parametrize(
    ("values", "answer"),
    [
        (np.full(5, 0.1), False),
        (np.array([0.0098, 0.0102]), False),
        (np.array([0.0095, 0.0101]), True),
        (np.array([0.01, 0.02]), True),
        (np.array([-1.0, 1.0]), True),
        (np.zeros(4), False),
        (np.full(4, np.nan), False),
    ],
)
def test_what_is_meant_to_be_constant_does_not_vary(values: np.ndarray, answer: bool) -> None:
    assert varies(values) is answer


def test_few_values_are_levels_and_many_are_not() -> None:
    got = levels(np.array([0.1, 0.1001, 0.2, 0.3, 0.3001]))
    assert got is not None
    assert got.tolist() == pytest.approx([0.10005, 0.2, 0.30005])
    assert levels(np.linspace(0, 1, 50)) is None


def test_parts_cover_each_row_once_by_each_column() -> None:
    rng = np.random.default_rng(7)
    rows = 60
    data = Measurements(
        Conditions.of(
            rng.uniform(20, 100, rows),
            np.repeat([0.1, 0.2, 0.3], 20),
            0.1,
            soil=np.where(np.arange(rows) % 2 == 0, "sand", "loam"),
            slip=np.full(rows, 0.2),
            torque=rng.uniform(1, 2, rows),
            moisture=np.where(np.arange(rows) < 5, np.nan, rng.uniform(0, 1, rows)),
        ),
        {"sinkage": rng.uniform(0, 0.01, rows)},
        np.arange(rows).astype(np.str_),
        np.full(rows, "wheel"),
        np.arange(rows),
    )
    found = parts(data)
    # torque is what the wheel answers, and slip was the same in all rows
    assert {part.by for part in found} == {"soil", "wheel", "load", "diameter", "moisture"}
    for by in ("soil", "wheel", "load", "diameter"):
        times = np.sum([part.rows for part in found if part.by == by], axis=0)
        assert (times == 1).all()
    moist = np.sum([part.rows for part in found if part.by == "moisture"], axis=0)
    np.testing.assert_array_equal(moist == 1, np.isfinite(data.conditions["moisture"]))
    for part in found:
        if part.range:
            inside = data.conditions[part.by][part.rows]
            assert inside.min() >= min(part.range) - 1e-12
            assert inside.max() <= max(part.range) + 1e-12
