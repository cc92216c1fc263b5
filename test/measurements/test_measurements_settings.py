# SPDX-License-Identifier: Apache-2.0
"""Which rows share a setting, and which are repeats of one run.

Tests `settings.py`.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from smallwheel_ros.measurements.measurements import Measurements
from smallwheel_ros.measurements.settings import (
    cluster,
    repeatability,
    repeats_of_rows,
    runs_of_rows,
    settings_of_rows,
)
from smallwheel_ros.physics.conditions import Conditions


def table(
    rows: int, run: list[str] | None = None, *, wheel: list[str] | None = None, **columns: Any
) -> Measurements:
    """Rows of one wheel that roll, but for what is given; without `run` each row is its own."""
    settings = {"load": 60.0, "diameter": 0.2, "width": 0.1} | columns
    units = settings.pop("units", {})
    sinkage = np.asarray(settings.pop("sinkage", np.linspace(0.01, 0.02, rows)))
    settings = {name: np.broadcast_to(value, rows) for name, value in settings.items()}
    return Measurements(
        Conditions.of(**settings),
        {"sinkage": sinkage},
        np.array(run or [f"line {i}" for i in range(rows)]),
        np.array(wheel or ["wheel"] * rows),
        np.arange(2, rows + 2),
        runs_given=run is not None,
        wheels_given=wheel is not None,
        units=units,
    )


# One column


@given(st.lists(st.floats(-100, 100) | st.just(np.nan), max_size=60), st.floats(0, 30))
def test_values_of_one_code_agree_and_codes_rise_with_values(
    values: list[float], tolerance: float
) -> None:
    column = np.array(values)
    codes = cluster(column, tolerance)
    assert np.array_equal(codes == -1, np.isnan(column))
    for code in np.unique(codes[codes >= 0]):
        assert np.ptp(column[codes == code]) <= tolerance
    known = column[codes >= 0]
    assert (np.diff(codes[codes >= 0][np.argsort(known, kind="stable")]) >= 0).all()


@given(
    st.lists(st.tuples(st.floats(0.0, 1.0), st.integers(0, 30)), min_size=1, max_size=60),
    st.floats(-3.0, 3.0),
    st.permutations(range(60)),
)
def test_set_points_are_found_wherever_they_lie(
    readings: list[tuple[float, int]], shift: float, order: list[int]
) -> None:
    """Values within the tolerance of each other and further from all others are never split."""
    where = [i for i in order if i < len(readings)]
    point = np.array([readings[i][1] for i in where])
    values = shift + 2.1 * point + np.array([readings[i][0] for i in where])
    codes = cluster(values, 1.0 + 1e-9)
    same = codes[:, None] == codes[None, :]
    assert np.array_equal(same, point[:, None] == point[None, :])


def test_close_neighbours_stay_together_where_everything_is_close() -> None:
    """Bins of width 1 from 0 would split the two readings at 1, and so would bins from 0.2."""
    values = np.array([0.2, 0.7, 0.99, 1.01, 1.4, 1.9])
    codes = cluster(values, 1.0)
    assert codes[2] == codes[3]


# Settings


@pytest.mark.parametrize(
    ("column", "together", "apart"),
    [
        ("load", [60.0, 65.0], [60.0, 67.0]),
        ("diameter", [0.2, 0.203], [0.2, 0.205]),
        ("width", [0.1, 0.1019], [0.1, 0.1021]),
        ("slip", [0.20, 0.219], [0.20, 0.23]),
        ("slope", np.radians([10.0, 10.9]), np.radians([10.0, 11.5])),
        ("pass_number", [1.0, 1.0], [1.0, 2.0]),
        ("speed", [0.1, 0.1019], [0.1, 0.103]),
        ("soil", ["sand", "sand"], ["sand", "loam"]),
        ("contact", ["rolling", "rolling"], ["rolling", "pressed"]),
    ],
)
def test_how_far_two_rows_of_one_setting_may_differ(
    column: str, together: list[float], apart: list[float]
) -> None:
    assert settings_of_rows(table(2, **{column: together})).tolist() == [0, 0]
    assert settings_of_rows(table(2, **{column: apart})).tolist() == [0, 1]


def test_of_a_wide_column_a_twenty_fifth_of_the_range_is_one_setting() -> None:
    moisture = [0.0, 0.10, 0.139, 1.0]
    assert settings_of_rows(table(4, moisture=moisture)).tolist() == [0, 1, 1, 2]
    # Passes are counted: of thirty, the first two are two.
    passes = [1.0, 2.0, 30.0]
    assert settings_of_rows(table(3, pass_number=passes)).tolist() == [0, 1, 2]


def test_the_size_of_a_temperature_in_kelvin_says_nothing() -> None:
    kelvin = {"temperature": [293.0, 296.0], "units": {"temperature": "K"}}
    assert settings_of_rows(table(2, **kelvin)).tolist() == [0, 1]


def test_what_the_wheel_answers_and_the_time_are_no_settings() -> None:
    answers = {"torque": [1.0, 5.0], "t": [0.0, 900.0], "trial": [1.0, 2.0], "q": [1.0, 9.0]}
    assert settings_of_rows(table(2, **answers, units={"q": "N"})).tolist() == [0, 0]
    assert settings_of_rows(table(2, **answers, units={"q": "1"})).tolist() == [0, 1]


def test_blank_agrees_with_blank_only() -> None:
    codes = settings_of_rows(table(3, speed=[np.nan, 0.1, np.nan]))
    assert codes.tolist() == [0, 1, 0]


def test_wheels_that_are_named_apart_are_settings_but_for_those_of_one_vehicle() -> None:
    assert settings_of_rows(table(2, wheel=["smooth", "lugged"])).tolist() == [0, 1]
    vehicle = table(4, ["a", "a", "b", "b"], wheel=["left", "right"] * 2)
    assert settings_of_rows(vehicle).tolist() == [0, 0, 0, 0]


SETTING = st.tuples(
    st.sampled_from([20.0, 40.0, 80.0]), st.sampled_from([0.1, 0.3]), st.sampled_from(["a", "b"])
)


@given(st.lists(SETTING, min_size=1, max_size=30), st.integers(0, 2**32 - 1))
def test_noisy_readings_of_a_few_settings_are_these_settings(
    chosen: list[tuple[float, float, str]], seed: int
) -> None:
    rng = np.random.default_rng(seed)
    rows = len(chosen)
    load, slip, soil = (np.array(column) for column in zip(*chosen, strict=True))
    noisy = table(
        rows,
        load=load * np.exp(rng.uniform(-0.04, 0.04, rows)),
        slip=slip + rng.uniform(-0.009, 0.009, rows),
        soil=soil,
        torque=rng.normal(size=rows),
    )
    codes = settings_of_rows(noisy)
    first = {one: k for k, one in enumerate(dict.fromkeys(chosen))}
    assert codes.tolist() == [first[one] for one in chosen]


# Runs


def test_runs_as_named_in_the_order_of_appearance() -> None:
    names, codes = runs_of_rows(table(4, ["z", "a", "z", "m"]))
    assert names == ("z", "a", "m")
    assert codes.tolist() == [0, 1, 0, 2]


def test_without_names_rows_of_one_set_point_are_repeats() -> None:
    """A load cell never reads the same twice: what differs by its noise is one setting."""
    load = [20.1, 19.8, 20.0, 40.2, 39.7, 60.1]
    slip = [0.1, 0.11, 0.1, 0.1, 0.1, 0.1]
    names, codes = runs_of_rows(table(6, load=load, slip=slip, torque=[1.0, 2, 3, 4, 5, 6]))
    assert codes.tolist() == [0, 0, 0, 1, 1, 2]
    assert names == ("setting 1", "setting 2", "setting 3")


def test_without_names_neighbours_in_a_sweep_are_no_repeats() -> None:
    sweep = np.linspace(0.0, 0.5, 40)
    assert runs_of_rows(table(40, slip=sweep))[1].tolist() == list(range(40))
    # but the same value met twice is
    assert runs_of_rows(table(80, slip=np.tile(sweep, 2)))[1].tolist() == list(range(40)) * 2


@given(st.lists(SETTING, min_size=1, max_size=30))
def test_doubling_a_table_without_runs_brings_no_new_run(
    chosen: list[tuple[float, float, str]],
) -> None:
    """Copying a row is no new evidence."""
    load, slip, soil = (np.array(column) for column in zip(*chosen, strict=True))
    once = runs_of_rows(table(load.size, load=load, slip=slip, soil=soil))
    rows = np.tile(np.arange(load.size), 2)
    twice = runs_of_rows(table(rows.size, load=load[rows], slip=slip[rows], soil=soil[rows]))
    assert twice[0] == once[0]
    assert twice[1].tolist() == once[1][rows].tolist()


def test_an_empty_table_has_neither() -> None:
    none = table(2, slip=[0.1, 0.2]).take(np.array([], dtype=np.intp))
    assert settings_of_rows(none).size == 0
    assert runs_of_rows(none)[0] == ()


# Repeats


def test_a_run_whose_settings_vary_has_no_repeats() -> None:
    run = ["a"] * 3 + ["b"] * 3
    load = [60.0, 61.0, 60.0, 60.0, 61.0, 90.0]
    assert repeats_of_rows(table(6, run, load=load)).tolist() == [0, 0, 0, -1, -1, -1]


def test_a_dense_curve_is_not_its_own_repeatability() -> None:
    """Neighbours of a curve agree in load, yet differ along the curve."""
    load = np.linspace(50.0, 100.0, 200)
    curve = table(200, ["a"] * 200, load=load, sinkage=load * 1e-4)
    assert repeatability(curve) == {}


def test_a_column_that_only_its_noise_moves_does_not_hide_repeats() -> None:
    rng = np.random.default_rng(3)
    run = [name for name in "abcdefgh" for _ in range(5)]
    noisy = table(
        40, run,
        sinkage=0.01 + rng.normal(0, 2e-4, 40),
        speed=0.01 + rng.uniform(-9e-5, 9e-5, 40),
        slip=0.2 + rng.uniform(-0.009, 0.009, 40),
        torque=rng.normal(size=40),
        trial=np.tile(np.arange(1.0, 6.0), 8),
    )  # fmt: skip
    assert repeatability(noisy)["sinkage"] == pytest.approx(2e-4, rel=0.3)
