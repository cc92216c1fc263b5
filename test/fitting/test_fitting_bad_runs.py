# SPDX-License-Identifier: Apache-2.0
"""`fit` names the runs that `diagnose` leaves out as slips of the pen, by the same function."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

import smallwheel_ros as sw


def table() -> pd.DataFrame:
    rng = np.random.default_rng(1)
    load = np.repeat([30.0, 45.0, 60.0, 80.0, 100.0, 120.0], 4)
    diameter = np.tile([0.2, 0.275], 12)
    sinkage = 0.006 * (load / 50.0) ** 0.9 * (0.2 / diameter) ** 0.5
    return pd.DataFrame({
        "run": [f"r{i}" for i in range(24)], "load": load, "diameter": diameter, "width": 0.1,
        "sinkage": sinkage * np.exp(rng.normal(0.0, 0.03, 24)),
    })  # fmt: skip


@pytest.mark.parametrize("factor", [1.0, 6.0])
def test_fit_names_the_bad_runs_of_diagnose(factor: float) -> None:
    frame = table()
    frame.loc[9, "sinkage"] *= factor
    said = [note for note in sw.fit(frame).notes if "lies far off" in note]
    left_out = [bad["run"] for bad in sw.diagnose(frame).document["bad_runs"]]
    assert left_out == (["r9"] if factor > 1.0 else [])
    assert [note.split()[1] for note in said] == left_out
    assert all("(row 10) lies far off and is in the fit" in note for note in said)
