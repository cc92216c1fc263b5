# SPDX-License-Identifier: Apache-2.0
"""Tables of the subject `tables`: their truth against quadrature, and how a trial is judged."""

from __future__ import annotations

import ast
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import quad

from rates import tables
from rates.bench_truth import BenchSoil, BenchWheel, rolled
from rates.judges import Line


def test_the_truth_carries_the_load() -> None:
    soil, wheel = BenchSoil(), BenchWheel(60.0, 0.2, 0.1, 0.3)
    there = rolled(soil, wheel)
    radius = 0.1
    entry = np.arccos(1.0 - there.sinkage / radius)

    def stress(angle: float) -> float:
        depth = radius * (np.cos(angle) - np.cos(entry))
        return float(soil.k * max(depth, 0.0) ** soil.n * 0.2**soil.m)

    carried = 0.1 * radius * quad(lambda t: stress(t) * np.cos(t), 0.0, entry)[0]
    assert carried == pytest.approx(60.0, rel=1e-3)
    work = soil.k * 0.2**soil.m * there.sinkage ** (soil.n + 1) / (soil.n + 1) * 0.1
    assert there.resistance == pytest.approx(work, rel=1e-3)


@pytest.mark.parametrize("name", tables.WORLDS)
def test_a_world_makes_a_table_and_settings_held_back(name: str) -> None:
    table, truth, fresh = tables.make(name, 0)
    world = tables.WORLDS[name]
    assert len(table) == world.runs * world.rows
    assert len(truth) == len(fresh) == 28
    assert np.isfinite(table.select_dtypes("number").to_numpy()).all()
    assert set(world.channels) <= set(truth.columns)
    again, _, _ = tables.make(name, 0)
    assert table.equals(again)
    assert not table.equals(tables.make(name, 1)[0])


def test_a_trial_counts_rows_in_their_bands() -> None:
    line = tables.trial("zero of 2.8 mm", 0)
    assert set(line["bands"]) == {"sinkage", "resistance"}
    for band in line["bands"].values():
        assert band["rows"] == 28
        assert 0 <= band["law"] <= 28
        assert band["std"] > 0.0


def test_names_are_judged_by_what_was_hidden() -> None:
    def line(world: str, named: list[str], verdict: str) -> Line:
        return {"world": world, "named": named, "verdict": verdict, "bands": {}}

    right, wrong = (judge.count for judge in tables.JUDGES[:2])
    lines = [
        line("hardpan", ["hardpan"], "missing_effect"),
        line("hardpan", ["bulldozing"], "missing_effect"),
        line("nothing", [], "adequate"),
        line("nothing", [], "unknown_effect"),
        line("two soils mixed", [], "unknown_effect"),
        line("two soils mixed", ["multipass"], "missing_effect"),
    ]
    said = [(right([one]), wrong([one])) for one in lines]
    assert [(r.value, w.value) for r, w in said if r and w] == [
        (1, 0), (0, 1), (1, 0), (0, 0), (1, 0), (0, 1)]  # fmt: skip


@pytest.mark.parametrize("name", ["tables", "bench_truth"])
def test_the_truth_knows_nothing_of_the_model(name: str) -> None:
    tree = ast.parse(Path(tables.__file__).with_name(f"{name}.py").read_text(encoding="utf-8"))
    named = [n.module or "" for n in ast.walk(tree) if isinstance(n, ast.ImportFrom)]
    named += [a.name for n in ast.walk(tree) if isinstance(n, ast.Import) for a in n.names]
    own = [module for module in named if module.startswith("smallwheel_ros")]
    assert own == (["smallwheel_ros"] if name == "tables" else [])
