# SPDX-License-Identifier: Apache-2.0
"""The worlds that the rates of the diagnosis are counted over: what they hold is what they say."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from pandas.testing import assert_frame_equal

from rates._world_labs import (
    DENSITIES,
    correlated,
    drawn,
    heavy_tailed,
    ornstein_uhlenbeck,
    random_fourier,
    selected,
)
from rates.diagnosis import INSTRUMENTS, WORLDS
from smallwheel_ros.effects.registry import families, is_of_column
from smallwheel_ros.measurements.from_file import read_measurements
from smallwheel_ros.simulate import write_table

# One or two of each kind of table, those of every module among them.
SAMPLE = (
    "soil/slip_sinkage+multipass",
    "poor/column:density",
    "tie/slip-load-slip_sinkage",
    "fault/load_offset=-4",
    "curve/plate-3",
    "curve/pressed-20",
    "series/slip_sinkage-3",
    "lab/2x5-slip_sinkage",
    "lab/3x4-nothing",
    "pull/rim-without-R-nothing",
    "pull/hump-with-R-slip_sinkage",
    "pull/loss-with-R-nothing",
    "odd/drifting-soil",
    "odd/creeping-zero",
    "odd/heavy-tails-nothing",
    "odd/uncertain-settings-nothing",
    "odd/declared-x3-nothing",
    "odd/torque-nothing",
    "odd/load-falls-skid_sinkage",
)


@pytest.mark.parametrize("name", SAMPLE)
def test_a_world_is_a_table_that_can_be_read_and_fresh_runs_of_it(name, tmp_path):
    world = WORLDS[name]
    table = world.table(3, 0)
    write_table(table, tmp_path / "table.csv")
    data = read_measurements(tmp_path / "table.csv")
    assert data.runs_given
    assert len(data) == len(table)
    assert "sinkage" in data.channels
    assert_frame_equal(table, world.table(3, 0))
    assert not table.equals(world.table(4, 0))
    if world.fresh:
        fresh = world.table(3, 1)
        assert list(fresh.columns) == list(table.columns)
        assert not np.isin(fresh["sinkage [mm]"], table["sinkage [mm]"]).any()
        # The same truth: what is measured lies in the same range, but for a few extremes.
        low, high = np.quantile(table["sinkage [mm]"], [0.0, 1.0])
        assert fresh["sinkage [mm]"].between(0.5 * low, 2.0 * high).mean() > 0.9


def test_what_is_hidden_has_the_librarys_ids():
    known = set(families())
    for world in WORLDS.values():
        hidden = world.soil | world.instruments
        assert {name for name in hidden if not is_of_column(name)} <= known, world.name
        assert not world.soil & INSTRUMENTS
        assert world.verdicts


def test_a_fault_is_expected_as_an_instruments():
    one = WORLDS["fault/sinkage_gain=-0.1"]
    assert one.instruments == {"sinkage_gain"}
    assert not one.soil
    both = WORLDS["soil/slip_sinkage+sinkage_offset"]
    assert both.soil == {"slip_sinkage"}
    assert both.instruments == {"sinkage_offset"}
    assert both.names == {"slip_sinkage", "sinkage_offset"}


@pytest.mark.parametrize(
    "family",
    ["curve/plate", "curve/pressed", pytest.param("series/slip_sinkage", marks=pytest.mark.slow)],
)
def test_fewer_rows_are_a_selection_of_the_densest(family):
    members = [world for world in WORLDS.values() if world.family == family]
    assert [int(world.name.rpartition("-")[2]) for world in members] == list(DENSITIES)
    densest = members[-1].table(1, 0).groupby("run", sort=False)
    for rows, world in zip(DENSITIES, members, strict=True):
        thin = world.table(1, 0)
        kept = pd.concat(group.iloc[selected(rows)] for _, group in densest)
        assert_frame_equal(thin, kept.reset_index(drop=True))


def test_curves_follow_the_exact_law_but_for_smooth_deviations():
    """ln p is linear in ln z and ln D, 6 % off, and neighbouring rows are off together."""
    offs = []
    for seed in range(8):
        table = WORLDS["curve/plate-100"].table(seed, 0)
        size, depth = table["diameter [mm]"] / 1e3, table["sinkage [mm]"] / 1e3
        pressure = np.log(table["load [N]"] / (np.pi / 4 * size**2))
        design = np.column_stack([np.ones(len(table)), np.log(depth), np.log(size)])
        fitted, *_ = np.linalg.lstsq(design, pressure, rcond=None)
        off = pd.Series(pressure - design @ fitted)
        offs.append(off.std())
        neighbours = off.groupby(table["run"]).apply(lambda one: one.iloc[30:].autocorr(1))
        assert neighbours.median() > 0.7
    assert 0.03 < np.mean(offs) < 0.09


@pytest.mark.parametrize("kind", [random_fourier, ornstein_uhlenbeck])
def test_deviations_have_unit_variance_and_their_length(kind):
    x = np.log([2e-3, 2.02e-3, 30e-3])
    drawn = np.array([kind(np.random.default_rng(seed))(x) for seed in range(400)])
    assert np.mean(drawn**2, axis=0) == pytest.approx(1.0, abs=0.25)
    correlation = np.corrcoef(drawn.T)
    assert correlation[0, 1] > 0.95
    assert abs(correlation[0, 2]) < 0.2


def test_series_and_tails():
    series = correlated(np.random.default_rng(0), 200_000, 10.0)
    assert np.var(series) == pytest.approx(1.0, abs=0.05)
    assert np.corrcoef(series[:-10], series[10:])[0, 1] == pytest.approx(np.exp(-1), abs=0.03)
    wild = heavy_tailed(np.random.default_rng(0), 200_000)
    assert np.median(np.abs(wild)) < 0.6  # narrower than normal in the middle
    assert np.mean(np.abs(wild) > 5.0) > 1e-3


def test_the_lab_has_one_wheel_on_a_grid_three_times():
    table = WORLDS["lab/2x5-nothing"].table(0, 0)
    settings = table.groupby(["load [N]", "slip"]).size()
    assert len(settings) == 10
    assert set(settings) == {3}
    assert table["run"].nunique() == len(table) == 30
    assert table["diameter [mm]"].nunique() == table["width [mm]"].nunique() == 1
    assert table["slip"].min() == -0.1


def test_drift_goes_with_the_runs():
    plain = drawn(0, 0)
    number = plain["run"].str.removeprefix("run_").astype(int) - 1
    creeping = WORLDS["odd/creeping-zero"].table(0, 0)["sinkage [mm]"] - plain["sinkage [mm]"]
    assert creeping.to_numpy() == pytest.approx(0.06 * number, abs=1e-9)
    # Soil that firms by 1 % a run: averaged over seeds, the scatter of the runs goes down.
    slopes = []
    for seed in range(8):
        drift = WORLDS["odd/drifting-soil"].table(seed, 0)
        ratio = drift["sinkage [mm]"] / drawn(seed, 0)["sinkage [mm]"]
        slopes.append(np.polyfit(number, np.log(ratio), 1)[0])
    assert -0.012 < np.mean(slopes) < -0.003


def test_what_is_odd_is_in_the_table():
    declared = WORLDS["odd/declared-x3-nothing"].table(0, 0)
    assert declared["run"].is_unique
    share = declared["sinkage_std [mm]"] / declared["sinkage [mm]"]
    assert share.between(0.09, 0.15).mean() > 0.7  # 3 % told as 9 %, and the absolute noise
    falling = WORLDS["odd/load-falls-nothing"].table(0, 0)
    assert falling["slip"].max() < 0
    torque = WORLDS["odd/torque-nothing"].table(0, 0)
    assert np.corrcoef(torque["torque [N m]"], torque["slip"])[0, 1] > 0.2
    over = torque["torque [N m]"] / (torque["load [N]"] * torque["diameter [mm]"] / 2e3)
    assert over.between(-0.05, 1.0).all()


def test_pull_of_another_law_leaves_the_rest_alone():
    tables = [WORLDS[f"pull/{law}-with-R-nothing"].table(2, 0) for law in ("rim", "hump", "loss")]
    for column in ("sinkage [mm]", "resistance [N]", "load [N]"):
        assert tables[0][column].equals(tables[1][column])
        assert tables[0][column].equals(tables[2][column])
    assert not np.allclose(tables[0]["drawbar_pull [N]"], tables[1]["drawbar_pull [N]"], atol=5)
    assert "resistance [N]" not in WORLDS["pull/hump-without-R-nothing"].table(2, 0)
