# SPDX-License-Identifier: Apache-2.0
"""Curves that something is wrong with: a zero, spikes, travel before contact, a gauge that stands still."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import smallwheel_ros as sw

K, N, M = 3e6, 0.9, 0.4  # of the soil, by p = k z^n D^m
SIZES = (0.06, 0.08, 0.10)


EXAMPLES = Path(__file__).resolve().parents[2] / "examples" / "data"


def curves(seed: int = 0, rows: int = 60, deepest: float = 0.02) -> pd.DataFrame:
    """Nine curves, each plate pressed three times, to 20 mm."""
    rng, made = np.random.default_rng(seed), []
    for i in range(9):
        size, firmer = SIZES[i % 3], np.exp(rng.normal(0.0, 0.04))
        depth = np.linspace(0.0005, deepest, rows)
        load = np.pi / 4 * size**2 * K * size**M * depth**N * firmer
        made.append(pd.DataFrame({
            "run": f"c{i}", "contact": "plate", "load": load * (1 + rng.normal(0, 0.01, rows)),
            "diameter": size, "sinkage": depth + rng.normal(0, 5e-5, rows),
        }))  # fmt: skip
    return pd.concat(made, ignore_index=True)


def n_of(frame: pd.DataFrame) -> tuple[float, float]:
    found = sw.fit(frame)["n"]
    assert found.std is not None
    return found.value, found.std


def test_clean_curves_are_left_alone() -> None:
    found = sw.fit(curves())
    assert not found.fit.outliers.size
    assert not [note for note in found.notes if "lies far off" in note or "gauge" in note]
    assert abs(found["n"].value - N) < 2 * found["n"].std


@pytest.mark.parametrize("table", ["cullinan_sand/plates.csv", "cmu_wheel_rig/indentation.csv"])
def test_no_real_curve_is_accused(table: str) -> None:
    assert not [note for note in sw.fit(EXAMPLES / table).notes if "lies far off" in note]


@pytest.mark.parametrize(
    ("zero", "deepest"),
    [
        (0.01, 0.02), (0.1, 0.04),
        *(
            pytest.param(*both, marks=pytest.mark.slow)
            for both in ((0.01, 0.04), (0.03, 0.02), (0.03, 0.04), (0.1, 0.02))
        ),
    ],
)  # fmt: skip
def test_one_curve_with_a_bad_zero_is_named(zero: float, deepest: float) -> None:
    frame = curves(seed=1, deepest=deepest)
    frame.loc[frame["run"] == "c4", "sinkage"] += zero
    found = sw.diagnose(frame)
    assert [bad["run"] for bad in found.document["bad_runs"]] == ["c4"]
    assert found.verdict == "adequate"
    assert abs(found.fit["n"].value - N) < 2 * found.fit["n"].std
    assert [note.split()[1] for note in sw.fit(frame).notes if "lies far off" in note] == ["c4"]


def test_spikes_are_left_out() -> None:
    frame, rng = curves(seed=2), np.random.default_rng(9)
    hit = rng.choice(len(frame), len(frame) // 25, replace=False)
    frame.loc[hit, "sinkage"] = rng.uniform(0.07, 0.35, hit.size)
    found = sw.fit(frame)
    assert {*hit.tolist()} <= {*found.fit.outliers.tolist()}
    assert abs(found["n"].value - N) < 2 * found["n"].std


def test_travel_before_contact_is_no_sinkage() -> None:
    frame, rng, parts = curves(seed=3), np.random.default_rng(4), []
    for _, curve in frame.groupby("run", sort=False):
        way = float(rng.uniform(0.003, 0.008))
        ahead = curve.iloc[:12].assign(
            sinkage=np.linspace(0.0002, way, 12), load=rng.uniform(0.01, 0.03, 12)
        )
        parts += [ahead, curve.assign(sinkage=curve["sinkage"] + way)]
    moved = pd.concat(parts, ignore_index=True)
    data = sw.read(moved)
    assert any("9 curves begin before the body touches" in line for line in data.understood)
    value, std = n_of(moved)
    assert abs(value - N) < 2 * std
    plain = sw.read(frame)
    assert not any("before the body touches" in line for line in plain.understood)


def test_a_gauge_that_stands_still_in_one_curve_is_named() -> None:
    frame = curves(seed=5)
    frame.loc[frame["run"] == "c2", "sinkage"] = 0.004
    assert [bad["run"] for bad in sw.diagnose(frame).document["bad_runs"]] == ["c2"]


@pytest.mark.parametrize("wheel", [False, True])
def test_a_gauge_that_never_moves_is_no_soil(wheel: bool) -> None:
    rng, frame = np.random.default_rng(6), curves(seed=6)
    if wheel:
        load = np.repeat(rng.uniform(20.0, 130.0, 18), 2)
        frame = pd.DataFrame(
            {"run": np.repeat(np.arange(18), 2), "load": load, "diameter": 0.2, "width": 0.1}
        )
    frame["sinkage"] = 0.004 + rng.normal(0.0, 1e-6, len(frame))
    found = sw.diagnose(frame)
    assert found.verdict == "unknown_effect"
    assert "does not rise while the load rises" in found.document["reason"]
    assert found.document["closest"] == []  # not a zero of the sensor, nor another effect
    assert any("does not rise" in note for note in sw.fit(frame).notes)
