"""Long records are condensed to blocks: what a block is, what is left out, what stays as it is."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from smallwheel_ros.diagnosis import diagnose
from smallwheel_ros.diagnosis.blocks import MOST_ROWS, condense
from smallwheel_ros.measurements.table import Measurements, read_measurements
from smallwheel_ros.simulate import RigSettings, simulate_rig, write_table


def drive(folder: Path, lengths: list[int], seed: int = 0, **columns: object) -> Measurements:
    """Stretches of one setting each, recorded row by row."""
    rng = np.random.default_rng(seed)
    piece = np.repeat(np.arange(len(lengths)), lengths)
    slip = rng.uniform(0.0, 0.5, len(lengths))[piece]
    load = rng.uniform(30.0, 120.0, len(lengths))[piece]
    rows = piece.size
    frame = pd.DataFrame(
        {
            "load": load * (1.0 + 0.01 * rng.normal(size=rows)),
            "diameter": 0.2,
            "width": 0.1,
            "slip": np.clip(slip + 0.005 * rng.normal(size=rows), 0.0, 1.0),
            "sinkage": 0.01 * (1.0 + slip) * (1.0 + 0.03 * rng.normal(size=rows)),
            **columns,
        }
    )
    frame.to_csv(folder / "drive.csv", index=False)
    return read_measurements(folder / "drive.csv")


def test_a_short_table_stays_as_it_is(tmp_path: Path) -> None:
    measurements = drive(tmp_path, [40] * 20)
    assert condense(measurements) is measurements


def test_blocks_end_where_a_setting_jumps(tmp_path: Path) -> None:
    lengths = [37, 61, 44, 90, 53] * 30
    whole = drive(tmp_path, lengths)
    assert len(whole) > MOST_ROWS
    short = condense(whole)
    assert 100 < len(short) < len(whole) / 2
    slip = short.conditions["slip"]
    # No block mixes two settings: its sinkage belongs to its slip.
    assert np.allclose(short.channels["sinkage"], 0.01 * (1.0 + slip), rtol=0.08)
    assert any("condensed" in note for note in short.notes)


def test_what_drifts_is_left_out(tmp_path: Path) -> None:
    rows = 30_000
    slip = np.full(rows, 0.1)
    slip[15_000:15_060] = np.linspace(0.15, 0.7, 60)  # too quick for a steady block of 30 rows
    short = condense(drive(tmp_path, [rows], slip=slip))
    assert np.max(np.abs(short.conditions["slip"] - 0.1)) < 0.05
    note = next(note for note in short.notes if "condensed" in note)
    assert "; 0 rows in which" not in note


def test_a_single_gross_value_does_not_move_its_block(tmp_path: Path) -> None:
    calm = condense(drive(tmp_path, [5000]))
    sinkage = drive(tmp_path, [5000]).channels["sinkage"].copy()
    sinkage[1234] = 0.09
    wild = condense(drive(tmp_path, [5000], sinkage=sinkage))
    apart = np.abs(wild.channels["sinkage"] - calm.channels["sinkage"])
    assert apart.max() < 0.2 * 0.01


def test_correlated_rows_make_a_block_less_certain(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    rows = 30_000
    white = rng.normal(size=rows)
    slow = np.convolve(rng.normal(size=rows + 4), np.ones(5) / np.sqrt(5), "valid")
    alone = condense(drive(tmp_path, [rows], sinkage=0.02 * (1.0 + 0.05 * white)))
    together = condense(drive(tmp_path, [rows], sinkage=0.02 * (1.0 + 0.05 * slow)))
    assert np.median(together.declared_std["sinkage"]) > 1.3 * np.median(
        alone.declared_std["sinkage"]
    )


@settings(max_examples=8, deadline=None)
@given(st.integers(0, 2**31), st.integers(5, 200))
def test_nothing_is_made_up(tmp_path_factory: pytest.TempPathFactory, seed: int, n: int) -> None:
    lengths = [int(x) for x in np.random.default_rng(seed).integers(1, 3 * 4200 // n + 2, n)]
    whole = drive(tmp_path_factory.mktemp("d"), lengths, seed)
    short = condense(whole)
    assert len(short) <= len(whole)
    for name in ("sinkage",):
        assert short.channels[name].min() >= whole.channels[name].min()
        assert short.channels[name].max() <= whole.channels[name].max()
        assert np.all(np.isfinite(short.channels[name]))


@pytest.mark.slow
def test_an_effect_in_a_drive_of_100_000_rows_is_named(tmp_path: Path) -> None:
    rig = simulate_rig(RigSettings(seed=5001, hidden=("slip_sinkage",), runs=2700, rows_per_run=37))
    frame = rig.table.drop(columns=["run"])
    write_table(frame, tmp_path / "drive.csv")
    found = diagnose(read_measurements(tmp_path / "drive.csv")).document
    assert found["missing_effects"] == ["slip_sinkage"]
    first, last = (found["steps"][i]["held_out_rmse"]["sinkage"] for i in (0, -1))
    assert last < 0.5 * first
