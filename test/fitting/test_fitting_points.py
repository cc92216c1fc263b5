# SPDX-License-Identifier: Apache-2.0
"""What a fit takes from a table: points, not rows.

Tests `constants.py` and `points.py`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fitted import fit_model
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from plain_rig import PlainRig, table
from random_examples import examples

from smallwheel_ros.fitting import FittingError, Problem
from smallwheel_ros.fitting.constants import CURVE_POINTS, MOST_POINTS
from smallwheel_ros.fitting.points import Points, points_of
from smallwheel_ros.measurements.measurements import Measurements

RUNS = [{"load": w, "slip": i} for w in (20.0, 50.0, 110.0) for i in (0.0, 0.3)]


def curves(rows: int, seed: int = 0, runs: int = 3) -> Measurements:
    """Plate curves p = k z^0.8 with smooth deviations of 5 %, sampled at that many of 300 places."""
    rng = np.random.default_rng(seed)
    keep = np.round(np.linspace(0, 299, rows)).astype(int)
    depth = np.linspace(1e-3, 30e-3, 300)
    load, shown, name = [], [], []
    for number in range(runs):
        phase = rng.uniform(0, 2 * np.pi, 5)
        wave = np.sum(np.cos(np.log(depth)[:, None] * rng.normal(0, 1.5, 5) + phase), axis=1)
        load.append((2e3 * (depth / 0.01) ** 0.8 * 0.01 * np.exp(0.03 * wave))[keep])
        shown.append(depth[keep])
        name += [f"curve {number}"] * rows
    return table(
        {"sinkage": np.concatenate(shown)},
        name,
        load=np.concatenate(load),
        diameter=0.1,
        width=0.1,
        contact="plate",
    )


def test_a_run_becomes_one_point_of_each_channel() -> None:
    measured = PlainRig().measure(RUNS, 1, rows=5)
    points = points_of(measured)
    assert len(points) == 2 * len(RUNS)
    assert np.all(points.count == 5)
    assert not points.swept.any()
    for i in range(len(points)):
        channel = measured.channels[points.channels[points.channel[i]]]
        assert points.value[i] == pytest.approx(channel[points.rows[i]].mean())
        assert set(measured.run[points.rows[i]]) == {points.runs[points.run[i]]}


def test_repeats_of_a_setting_share_it_and_are_runs_of_their_own() -> None:
    points = points_of(PlainRig().measure([*RUNS, *RUNS], 1))
    assert points.run_count == 2 * len(RUNS)
    assert np.unique(points.setting).size == len(RUNS)


@pytest.mark.parametrize("rows", [20, 100, 300])
def test_a_swept_run_has_ten_points_at_most(rows: int) -> None:
    points = points_of(curves(rows))
    assert points.swept.all()
    assert np.bincount(points.run).max() <= CURVE_POINTS


def test_a_curve_of_three_rows_has_three_points() -> None:
    assert np.bincount(points_of(curves(3)).run).tolist() == [3, 3, 3]


def test_many_curves_have_few_points_each() -> None:
    points = points_of(curves(60, runs=90))
    assert len(points) <= MOST_POINTS
    assert points.run_count == 90


def test_a_driven_sweep_of_slip_is_cut_along_its_path() -> None:
    slip = np.linspace(0.0, 0.6, 80)
    rows = PlainRig(slip_growth=1.5, soil_scatter=0.0).measure(
        [{"load": 50.0, "slip": float(i)} for i in slip], 1, rows=1
    )
    one = table(rows.channels, ["sweep"] * 80, load=50.0, slip=slip)
    points = points_of(one)
    assert points.swept.all()
    assert len(points) <= 2 * CURVE_POINTS
    assert np.all(np.diff(points.column("slip")[points.of_channel("sinkage")]) > 0)


@pytest.mark.parametrize("rows", [3, 20, 100])
def test_a_steady_run_has_the_same_points_at_each_density(rows: int) -> None:
    """Fewer rows of the same record: the means differ by their own noise only."""
    record = PlainRig(noise=0.02).measure(RUNS, 5, rows=300)
    kept = np.flatnonzero(
        np.isin(np.arange(len(record)) % 300, np.linspace(0, 299, rows, dtype=int))
    )
    dense, thin = points_of(record), points_of(record.take(kept))
    assert thin.runs == dense.runs
    np.testing.assert_array_equal(thin.setting, dense.setting)
    np.testing.assert_allclose(thin.value, dense.value, rtol=4.5 * 0.02 / np.sqrt(rows))


@pytest.mark.parametrize("rows", [20, 100])
def test_a_curve_has_nearly_the_same_points_at_each_density(rows: int) -> None:
    """Each point lies on the line through the points of the densest sampling."""
    dense, thin = points_of(curves(300)), points_of(curves(rows))
    for run in range(3):
        line = dense.run == run
        mine = (thin.run == run) & (thin.value >= dense.value[line].min())
        assert mine.sum() >= CURVE_POINTS - 1
        expected = np.interp(
            np.log(thin.value[mine]),
            np.log(dense.value[line]),
            np.log(dense.column("load")[line]),
        )
        np.testing.assert_allclose(np.log(thin.column("load")[mine]), expected, atol=0.08)


@pytest.mark.parametrize(("zero", "off"), [(0.0, 1e-9), (0.3e-3, 0.125)])
def test_rows_at_touch_down_have_little_weight(zero: float, off: float) -> None:
    """A curve p = c z^0.9 whose zero is off by a third of the first depth; equal weights: 0.15."""
    exact = curves(60)
    shown = exact.channels["sinkage"] + zero
    c = exact.conditions.load / exact.channels["sinkage"] ** 0.9
    load = c.mean() * exact.channels["sinkage"] ** 0.9
    data = replace(
        exact, conditions=replace(exact.conditions, load=load), channels={"sinkage": shown}
    )
    points = points_of(data)
    law = (points.conditions.load[points.row] / c.mean()) ** (1.0 / 0.9)
    assert np.max(np.abs(np.log(points.value / law))) < off


def test_ten_runs_of_correlated_rows_count_as_ten() -> None:
    """Three hundred rows a run, the soil along each correlated: the fit is that of the run means."""
    rng = np.random.default_rng(4)
    rig = PlainRig(noise=0.0, soil_scatter=0.05, channels=("sinkage",))
    steady = rig.measure([{"load": w} for w in np.geomspace(15, 130, 10)], 9, rows=300)
    walk = np.zeros((10, 300))
    for i in range(1, 300):
        walk[:, i] = 0.97 * walk[:, i - 1] + np.sqrt(1 - 0.97**2) * rng.normal(size=10)
    wavering = steady.channels["sinkage"] * np.exp(0.1 * walk.ravel())
    load = steady.conditions.load * np.exp(0.02 * rng.normal(size=3000))
    rows = table({"sinkage": wavering}, steady.run, load=load)
    first = np.arange(0, 3000, 300)
    means = table(
        {"sinkage": wavering.reshape(10, 300).mean(axis=1)},
        steady.run[first],
        load=np.exp(np.log(load).reshape(10, 300).mean(axis=1)),
    )

    def fitted(measured: Measurements) -> tuple[float, float]:
        n = next(p for p in fit_model(measured).parameters if p.name == "n")
        assert n.std is not None
        return n.value, n.std

    (of_rows, std), (of_means, _) = fitted(rows), fitted(means)
    assert of_rows == pytest.approx(of_means, abs=0.02)
    assert abs(of_rows - 0.8) < 2.5 * std
    assert 0.02 < std < 0.3


@pytest.mark.parametrize(("repeated", "wild"), [(4, [7, 20]), (1, [20])])
def test_rows_far_off_their_run_are_flagged_with_their_line(repeated: int, wild: list[int]) -> None:
    measured = PlainRig().measure(RUNS * repeated, 2, rows=6)
    measured.channels["resistance"][wild] *= 3.0
    problem = Problem.of(measured)
    points, outliers = problem.points, problem.outliers
    assert outliers.tolist() == wild
    assert not set(wild) & set(np.concatenate(points.rows))
    notes = " ".join(fit_model(measured).notes)
    assert ("2 rows lie far off" if len(wild) == 2 else "1 row lies far off") in notes
    lines = "lines " if len(wild) == 2 else "line "
    assert lines + ", ".join(str(row + 2) for row in wild) in notes  # the header is line 1


def test_a_problem_without_some_rows_has_the_channels_and_weights_that_it_had() -> None:
    rig, swept = Problem.of(PlainRig().measure(RUNS, 2, rows=6)), Problem.of(curves(40))
    for one in (rig, replace(rig, points=rig.points.only(("sinkage",))), swept.judged):
        left = one.without(np.array([3]))
        assert left.judging == one.judging
        assert left.points.channels == one.points.channels
        assert 3 not in np.concatenate(left.points.rows)
    assert swept.judged.judging


def test_heavy_noise_is_no_crowd_of_outliers() -> None:
    rng = np.random.default_rng(3)
    run = np.repeat(np.arange(20), 6).astype(str)
    sinkage = 0.01 * (1.0 + 0.05 * rng.standard_t(3, run.size))
    found = Problem.of(
        table({"sinkage": sinkage}, run, load=np.repeat(np.linspace(20, 100, 20), 6))
    )
    assert found.outliers.size <= 2


def test_a_long_record_without_runs_becomes_stretches_of_each_wheel() -> None:
    rng = np.random.default_rng(1)
    count = 5000
    load = 60.0 * np.exp(0.1 * rng.normal(size=count))
    record = table({"sinkage": 1e-4 * load}, [str(i) for i in range(count)], load=load,
                   runs_given=False, slip=rng.uniform(0.0, 0.3, count))  # fmt: skip
    points = points_of(record)
    assert all(name.startswith("stretch ") for name in points.runs)
    assert points.run_count == MOST_POINTS // 8
    assert len(points) <= MOST_POINTS
    for i in range(len(points)):  # neighbours in time
        assert np.ptp(points.rows[i]) < count / points.run_count


def with_pull(angle: np.ndarray) -> Points:
    pull = np.linspace(5.0, 10.0, angle.size)
    return points_of(
        table(
            {"sinkage": np.full(angle.size, 0.01), "drawbar_pull": pull},
            [str(i) for i in range(angle.size)],
            load=np.linspace(20, 90, angle.size),
            slip=np.full(angle.size, 0.2),
            slip_angle=angle,
        )
    )


def test_drawbar_pull_at_a_slip_angle_is_left_out_and_that_is_said() -> None:
    angle = np.radians([0.0, 9.9, -9.9, 10.1, 45.0, -45.0])
    points = with_pull(angle)
    assert points.row[points.of_channel("drawbar_pull")].tolist() == [0, 1, 2]
    assert int(points.of_channel("sinkage").sum()) == 6
    assert any("drawbar_pull of 3 rows" in note for note in points.notes)
    assert not any("drawbar_pull" in note for note in with_pull(np.zeros(6)).notes)


def test_rows_sunk_to_the_axle_are_left_out_and_that_is_said() -> None:
    points = points_of(table({"sinkage": np.array([0.01, 0.12, 0.02])}, ["a", "b", "c"]))
    assert points.value.tolist() == [0.01, 0.02]
    assert any("deeper than its axle" in note for note in points.notes)


def test_what_has_nothing_usable_is_refused() -> None:
    pull = {"drawbar_pull": np.array([3.0, 4.0])}
    with pytest.raises(FittingError, match="need slip"):
        points_of(table(pull, ["a", "b"]))
    with pytest.raises(FittingError, match="measure at least one"):
        points_of(table({"sinkage": np.array([np.nan, np.nan])}, ["a", "b"]))


@settings(max_examples=examples(60))
@given(st.data())
def test_every_usable_row_is_in_one_point_of_its_run(data: st.DataObject) -> None:
    count = data.draw(st.integers(1, 60))
    run = data.draw(arrays(np.intp, count, elements=st.integers(0, 7)))
    load = data.draw(arrays(float, count, elements=st.floats(1.0, 200.0)))
    z = data.draw(arrays(float, count, elements=st.floats(1e-4, 0.099) | st.just(np.nan)))
    r = data.draw(arrays(float, count, elements=st.floats(-5.0, 50.0) | st.just(np.nan)))
    slip = data.draw(arrays(float, count, elements=st.floats(-0.9, 0.9)))
    measured = table({"sinkage": z, "resistance": r}, run.astype(str), load=load, slip=slip)
    known = np.isfinite(z) | np.isfinite(r)
    if not known.any():
        with pytest.raises(FittingError):
            points_of(measured)
        return
    points = points_of(measured)
    assert np.isfinite(points.value).all()
    for name in points.channels:
        mine = points.of_channel(name)
        rows = np.concatenate([points.rows[i] for i in np.flatnonzero(mine)])
        assert np.unique(rows).size == rows.size
        assert np.isfinite(measured.channels[name][rows]).all()
        assert np.bincount(points.run[mine]).max() <= CURVE_POINTS
    for i, rows in enumerate(points.rows):
        assert set(measured.run[rows]) == {points.runs[points.run[i]]}
        values = measured.channels[points.channels[points.channel[i]]][rows]
        assert values.min() - 1e-9 <= points.value[i] <= values.max() + 1e-9
        at = points.conditions.load[points.row[i]]
        assert load[run == int(points.runs[points.run[i]])].min() - 1e-9 <= at
