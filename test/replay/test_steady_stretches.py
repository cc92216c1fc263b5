# SPDX-License-Identifier: Apache-2.0
"""Steady stretches of rolling and pressed wheels together: where blocks end makes no difference.

Tests `tables.py`.
"""

from __future__ import annotations

from dataclasses import fields
from itertools import pairwise

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from random_examples import examples

from smallwheel_ros.physics.wheel import Wheel
from smallwheel_ros.pipeline.tables import Readings
from smallwheel_ros.replay import tables
from smallwheel_ros.replay.tables import SteadyStretches

WHEELS = [
    Wheel("left", 0.2, 0.1), Wheel("foot", 0.1, 0.1, contact="pressed"), Wheel("right", 0.2, 0.1)
]  # fmt: skip
ROWS, LENGTH = 900, 6.0  # m


def drive() -> tuple[Readings, np.ndarray]:
    """Three wheels in turn over 6 m, and whether the soil was changing; the soil changes once, after 4 m."""
    rng = np.random.default_rng(0)
    columns = {one.name: np.zeros(ROWS) for one in fields(Readings)}
    distance = np.linspace(0.0, LENGTH, ROWS)
    columns |= {
        "stamp": np.arange(ROWS) * 10_000_000, "wheel": np.arange(ROWS) % 3, "distance": distance,
        "load": rng.normal(50.0, 1.0, ROWS), "sinkage": rng.normal(0.01, 2e-4, ROWS),
        "slip": rng.normal(0.1, 0.01, ROWS), "speed": rng.normal(0.2, 0.002, ROWS),
        "sinkage_std": np.full(ROWS, 1e-3), "pass_number": np.ones(ROWS),
    }  # fmt: skip
    return Readings(**columns), (distance > 4.0) & (distance < 4.1)


def stretches(cuts: list[int]) -> pd.DataFrame:
    """The table of the drive, given in blocks that end at these rows."""
    rows, changing = drive()
    found = SteadyStretches(WHEELS)
    for first, end in pairwise([0, *sorted({*cuts}), ROWS]):
        found.add(rows.take(np.arange(first, end)), changing[first:end])
    return found.table()


def test_rolling_wheels_have_a_stretch_for_each_turn() -> None:
    whole = stretches([])
    rolling = whole[whole["wheel"] != "foot"]
    # A turn is 0.628 m: numbers 0 to 6 begin before the change at 4 m, of which the last two are left out,
    # and 6 to 9 end or begin after it, whatever the pressed wheel counts.
    assert rolling["wheel"].value_counts()[["left", "right"]].tolist() == [5 + 4, 5 + 4]
    assert len(whole[whole["wheel"] == "foot"]) > 200


@settings(deadline=None, max_examples=examples(60))
@given(st.lists(st.integers(1, ROWS - 1), max_size=12), st.integers(20, 400))
def test_cuts_make_no_difference(cuts: list[int], block: int) -> None:
    whole = stretches([])
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(tables, "_BLOCK", block)
        pd.testing.assert_frame_equal(stretches(cuts), whole, check_exact=True)
