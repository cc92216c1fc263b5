# SPDX-License-Identifier: Apache-2.0
"""Tests `rig.py` and `settings.py`."""

from __future__ import annotations

import json

import numpy as np
import pandas as pd
import pytest
from pandas.testing import assert_frame_equal
from scipy.optimize import least_squares

from smallwheel_ros.measurements.from_file import read_measurements
from smallwheel_ros.simulate import (
    RigSettings,
    SimulationError,
    measure,
    simulate_rig,
    write_table,
)
from smallwheel_ros.simulate.settings import hidden_names

NAMES = [n for n in hidden_names() if n not in ("none", "column:NAME")] + ["column:density"]


def si(table):
    """Columns by plain name in SI units and radians; every unit that the rig's tables use."""
    factor = {"mm": 1e-3, "mm/s": 1e-3, "deg": np.pi / 180, "N": 1.0, "kg/m^3": 1.0, "K": 1.0}
    out = {}
    for header in table.columns:
        name, _, unit = header.partition(" [")
        values = table[header]
        out[name] = values if values.dtype.kind not in "if" else values * factor.get(unit[:-1], 1.0)
    return pd.DataFrame(out)


def test_default_table():
    table = simulate_rig(RigSettings(seed=3)).table
    assert list(table.columns) == [
        "run",
        "soil",
        "wheel",
        "load [N]",
        "diameter [mm]",
        "width [mm]",
        "slip",
        "speed [mm/s]",
        "pass_number",
        "sinkage [mm]",
        "resistance [N]",
    ]
    assert len(table) == 96
    assert table["run"].value_counts().tolist() == [3] * 32
    values = si(table)
    assert np.all(np.isfinite(values.select_dtypes("number")))
    assert values["load"].between(18, 160).all()
    assert values["diameter"].between(0.1, 0.5).all()
    assert values["slip"].between(-0.03, 0.63).all()
    assert set(values["pass_number"]) == {1, 2, 3, 4, 5}
    assert (values["sinkage"] < 0.35 * values["diameter"]).all()
    assert values["diameter"].nunique() == 4
    assert values["width"].nunique() == 4
    assert values.groupby("wheel")[["diameter", "width"]].nunique().max().max() == 1


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_the_reader_of_measurements_takes_it(tmp_path, suffix):
    made = simulate_rig(
        RigSettings(
            seed=1,
            hidden=("slip_angle_sinkage", "grouser", "column:density"),
            channels=("sinkage", "resistance", "drawbar_pull", "torque"),
        )
    )
    file = tmp_path / f"rig{suffix}"
    write_table(made.table, file)
    data = read_measurements(file)
    values = si(made.table)
    assert len(data) == 96
    assert data.runs_given
    assert set(data.channels) == {"sinkage", "resistance", "drawbar_pull", "torque"}
    for name, array in data.channels.items():
        assert array == pytest.approx(values[name].to_numpy(), rel=1e-9)
    for name in ("slip", "slip_angle", "speed", "pass_number", "grouser_height", "density"):
        assert data.conditions[name] == pytest.approx(values[name].to_numpy(), rel=1e-9)


def test_without_noise_it_is_the_physics():
    """Resistance is the work of compaction, and k, n, m come out as the answer says."""
    made = simulate_rig(RigSettings(seed=8, noise=0.0, soil_scatter=0.0))
    values, soil = si(made.table), made.truth.soil

    def work(k, n, m):
        depth = values["sinkage"] ** (n + 1) / (n + 1)
        return (values["width"] * k * values["diameter"] ** m * depth).to_numpy()

    assert values["resistance"].to_numpy() == pytest.approx(work(soil.k, soil.n, soil.m), rel=1e-4)
    fit = least_squares(
        lambda x: np.log(work(np.exp(x[0]), x[1], x[2]) / values["resistance"].to_numpy()),
        [13.0, 0.8, 0.1],
    )
    assert np.exp(fit.x[0]) == pytest.approx(soil.k, rel=1e-3)
    assert fit.x[1:] == pytest.approx([soil.n, soil.m], abs=1e-3)


def test_noise_and_scatter_are_as_large_as_asked():
    quiet = si(simulate_rig(RigSettings(seed=4, runs=200, noise=0.0, soil_scatter=0.0)).table)
    noisy = si(simulate_rig(RigSettings(seed=4, runs=200, noise=0.06, soil_scatter=0.0)).table)
    for name, absolute in (("sinkage", 0.3e-3), ("resistance", 0.3)):
        normed = (noisy[name] - quiet[name]) / np.hypot(0.06 * quiet[name], absolute)
        assert np.std(normed) == pytest.approx(1.0, abs=0.08)
    assert np.std(noisy["load"] / quiet["load"] - 1) == pytest.approx(0.01, abs=0.0015)
    assert np.std(noisy["slip"] - quiet["slip"]) == pytest.approx(0.008, abs=0.0015)
    moved = si(simulate_rig(RigSettings(seed=4, runs=200, noise=0.0, soil_scatter=0.1)).table)
    # Sinkage goes as k^(-1/(n + 1/2)), and a run's rows move together.
    n = simulate_rig(RigSettings(seed=4)).truth.soil.n
    shift = np.log(moved["sinkage"] / quiet["sinkage"]) * (n + 0.5)
    by_run = shift.groupby(moved["run"])
    assert np.std(by_run.mean()) == pytest.approx(0.1, abs=0.02)
    assert by_run.std().max() < 0.01


def test_settings_are_independent_of_each_other():
    """Averaged over seeds: the redraw of implausible settings leaves only slight correlations."""
    tables = []
    for seed in range(12):
        runs = pd.DataFrame(simulate_rig(RigSettings(seed=seed, runs=60)).truth.runs)
        tables.append(
            np.log(runs[["load", "diameter", "width", "speed"]])
            .assign(slip=runs["slip"], pass_number=runs["pass_number"])
            .corr()
            .to_numpy()
        )
    mean = np.mean(tables, axis=0)
    assert np.max(np.abs(mean - np.eye(6))) < 0.25


@pytest.mark.parametrize("pair", [("slip", "load"), ("speed", "slip"), ("load", "moisture")])
def test_tied_settings_move_together(pair):
    hidden = ("moisture",) if "moisture" in pair else ()
    for seed in range(4):
        values = si(simulate_rig(RigSettings(seed=seed, tie=pair, hidden=hidden)).table)
        correlation = values[list(pair)].corr().iloc[0, 1]
        assert 0.975 < correlation < 0.998
        assert abs(values["slip"].corr(values["diameter"])) < 0.5


@pytest.mark.parametrize("name", NAMES)
def test_every_effect_makes_a_plausible_table(name):
    for seed in range(2):
        made = simulate_rig(RigSettings(seed=seed, hidden=(name,)))
        values = si(made.table).select_dtypes("number")
        assert np.all(np.isfinite(values))
        assert (values["sinkage"] > 0).all()
        assert (values["sinkage"] < 0.4 * values["diameter"]).all()
        # The zero of the sensor is off by up to 2.3 N, to either side.
        assert (values["resistance"] > (-2.5 if name == "resistance_offset" else 0.0)).all()
        assert np.median(values["resistance"] / values["load"]) < 0.8
        assert len(made.truth.runs) == 32


def test_hidden_effects_are_not_in_the_table():
    made = simulate_rig(RigSettings(hidden=("bulldozing", "unrecorded")))
    text = made.table.to_csv()
    assert "bulldozing" not in text
    assert "unrecorded" not in text
    assert len(made.table.columns) == 11
    told = json.loads(json.dumps(made.truth.answer(), allow_nan=False))
    assert [e["effect"] for e in told["hidden"]] == ["bulldozing", "unrecorded"]
    assert told["soil"]["k"] > 0
    assert len(told["runs"]) == 32


@pytest.mark.parametrize(
    ("text", "column", "change"),
    [
        ("sinkage_gain=-0.1", "sinkage", lambda v: 0.9 * v["sinkage"]),
        ("sinkage_offset=0.002", "sinkage", lambda v: v["sinkage"] + 0.002),
        ("load_offset=-4", "load", lambda v: v["load"] - 4.0),
        ("load_gain=0.1", "load", lambda v: 1.1 * v["load"]),
        ("resistance_gain=0.1", "resistance", lambda v: 1.1 * v["resistance"]),
        ("resistance_offset=2", "resistance", lambda v: v["resistance"] + 2.0),
        ("rig_friction=0.06", "resistance", lambda v: v["resistance"] + 0.06 * v["load"]),
    ],
)
def test_a_fault_changes_one_column_only(text, column, change):
    """Compared run by run where both tables have the same settings."""
    quiet = {"seed": 5, "noise": 0.0, "soil_scatter": 0.0}
    plain = simulate_rig(RigSettings(**quiet))
    faulty = simulate_rig(RigSettings(**quiet, hidden=(text,)))
    assert faulty.truth.runs == plain.truth.runs
    before, after = si(plain.table), si(faulty.table)
    assert after[column].to_numpy() == pytest.approx(change(before).to_numpy(), rel=1e-5)
    rest = [name for name in before.columns if name != column]
    assert_frame_equal(before[rest], after[rest])


def test_columns_and_ranges_follow_the_effects():
    table = simulate_rig(RigSettings(hidden=("column:density",))).table
    assert table["density [kg/m^3]"].between(1400, 1700).all()
    assert (table.groupby("run")["density [kg/m^3]"].nunique() == 1).all()
    assert simulate_rig(RigSettings(hidden=("column:x",))).table["x"].between(0.5, 1.5).all()
    assert simulate_rig(RigSettings(hidden=("moisture",))).table["moisture"].max() < 0.2
    skid = simulate_rig(RigSettings(hidden=("skid_sinkage",))).table
    assert skid["slip"].min() < -0.3
    pull = simulate_rig(RigSettings(channels=("drawbar_pull",))).table
    assert "drawbar_pull [N]" in pull
    assert "sinkage [mm]" not in pull


def test_torque_changes_no_other_column():
    def made(*channels, **settings):
        return simulate_rig(RigSettings(seed=5, channels=channels, **settings)).table

    plain = made("sinkage", "drawbar_pull")
    more = made("sinkage", "drawbar_pull", "torque")
    assert list(more) == [*plain, "torque [N m]"]
    assert more[list(plain)].equals(plain)
    torque = more["torque [N m]"].to_numpy()
    quiet = made("torque", noise=0.0)["torque [N m]"].to_numpy()
    normed = (torque - quiet) / np.hypot(0.03 * quiet, 0.03)
    assert np.std(normed) == pytest.approx(1.0, abs=0.25)


def test_same_seed_same_bytes(tmp_path):
    for name in ("a", "b"):
        made = simulate_rig(RigSettings(seed=11, hidden=("multipass", "moisture"), outliers=0.1))
        write_table(made.table, tmp_path / f"{name}.csv")
        write_table(made.table, tmp_path / f"{name}.parquet")
    for suffix in (".csv", ".parquet"):
        assert (tmp_path / f"a{suffix}").read_bytes() == (tmp_path / f"b{suffix}").read_bytes()
    other = simulate_rig(RigSettings(seed=12, hidden=("multipass", "moisture"), outliers=0.1))
    assert not other.table.equals(made.table)
    assert_frame_equal(
        pd.read_csv(tmp_path / "a.csv"), pd.read_parquet(tmp_path / "a.parquet"), check_dtype=False
    )


def test_outliers_touch_few_rows():
    plain = simulate_rig(RigSettings(seed=2, runs=100)).table
    wild = simulate_rig(RigSettings(seed=2, runs=100, outliers=0.05)).table
    hit = (plain["sinkage [mm]"] != wild["sinkage [mm]"]) | (
        plain["resistance [N]"] != wild["resistance [N]"]
    )
    assert 0.02 < hit.mean() < 0.09
    assert_frame_equal(plain[~hit], wild[~hit])
    assert (wild["sinkage [mm]"] <= 0.5 * wild["diameter [mm]"]).all()


def test_measuring_goes_on_in_the_same_soil():
    made = simulate_rig(RigSettings(seed=6, noise=0.0, soil_scatter=0.0))
    again = measure(made.truth, made.truth.runs, first_run=0)
    assert_frame_equal(again, made.table)
    more = measure(made.truth, [{"load": 60.0, "slip": s} for s in (0.0, 0.3, 0.6)])
    assert list(more.columns) == list(made.table.columns)
    assert more["run"].unique().tolist() == ["run_033", "run_034", "run_035"]
    values = si(more)
    assert values["slip"].groupby(values["run"]).mean().tolist() == pytest.approx(
        [0.0, 0.3, 0.6], abs=0.02
    )
    soil = made.truth.soil
    work = values["width"] * soil.k * values["diameter"] ** soil.m
    work = work * values["sinkage"] ** (soil.n + 1) / (soil.n + 1)
    assert values["resistance"].to_numpy() == pytest.approx(work.to_numpy(), rel=1e-4)
    one = measure(made.truth, [{"load": 60.0, "slip": 0.6}], first_run=34)
    assert one["slip"].mean() == pytest.approx(0.6, abs=0.02)
    assert len(one) == 3


def test_a_longer_table_begins_like_a_shorter_one():
    """Each run has its own random stream: asking for more does not change what there is."""
    short = simulate_rig(RigSettings(seed=9, runs=32))
    more = measure(short.truth, [{"load": 50.0}, {"load": 70.0}])
    first = measure(short.truth, [{"load": 50.0}])
    assert_frame_equal(more[:3], first)


@pytest.mark.parametrize(
    ("settings", "match"),
    [
        ({"runs": 0}, "runs is 0"),
        ({"runs": -4}, "runs is -4"),
        ({"rows_per_run": 0}, "rows per run is 0"),
        ({"noise": 0.9}, "noise is 0.9: expected a number from 0 to 0.5"),
        ({"noise": float("nan")}, "noise is nan"),
        ({"strength": -1.0}, "strength is -1.0"),
        ({"outliers": 1.0}, "outliers is 1.0"),
        ({"channels": ("sinkag",)}, "sinkag"),
        ({"channels": ()}, "channels are empty"),
        ({"tie": ("slip",)}, "two different settings"),
        ({"tie": ("slip", "lod")}, "did you mean 'load'"),
        ({"tie": ("slip", "moisture")}, "cannot be tied"),
        ({"hidden": ("multipas",)}, "did you mean 'multipass'"),
        ({"hidden": ("sinkage_offset=-0.1",)}, "take a smaller strength"),
        ({"hidden": ("load_offset=4N",)}, "its size is '4N'"),
    ],
)
def test_bad_settings_are_named(settings, match):
    with pytest.raises(SimulationError, match=match):
        simulate_rig(RigSettings(**settings))


@pytest.mark.parametrize(
    ("run", "match"),
    [
        ({"lod": 3.0}, "setting 'lod' is none"),
        ({"moisture": 0.1}, "'moisture' is none"),
        ({"load": -3.0}, "load is -3.0"),
        ({"slip": 2.0}, "slip is 2.0"),
        ({"pass_number": -3}, "pass_number is -3"),
        ({"pass_number": 0}, "pass_number is 0"),
        ({"pass_number": 2.5}, "pass_number is 2.5, expected a whole number"),
        ({"load": 9e4}, "run_033: the wheel .* sinks to its axle"),
    ],
)
def test_bad_runs_to_measure_are_named(run, match):
    truth = simulate_rig(RigSettings(seed=0)).truth
    with pytest.raises(SimulationError, match=match):
        measure(truth, [run])
    with pytest.raises(SimulationError, match="no runs"):
        measure(truth, [])
