# SPDX-License-Identifier: Apache-2.0
"""The bench's diagnosis at the end of a replay, `diagnosis.py`: of steady stretches made by another law."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from smallwheel_ros.replay.diagnosis import diagnosed, evened
from smallwheel_ros.simulate.truth import static_sinkage


def stretches(count: int, slip_sinkage: float = 0.0) -> pd.DataFrame:
    """Steady stretches of two sizes of wheels, as `SteadyStretches` gives them."""
    rng = np.random.default_rng(5)
    index = np.arange(count)
    diameter = np.where(index % 2, 0.3, 0.2)
    load = np.exp(rng.normal(np.log(80.0), 0.3, count))
    modulus = 30e3 / 0.01**0.9 * np.exp(0.03 * rng.standard_normal(count))
    still = static_sinkage(
        lambda depth: modulus[:, None] * depth**0.9, load, diameter, np.full(count, 0.1)
    )
    slip = rng.uniform(0.02, 0.4, count)
    sinkage = still * (1.0 + slip_sinkage * slip) + 3e-4 * rng.standard_normal(count)
    return pd.DataFrame(
        {
            "load [N]": load, "diameter [m]": diameter, "width [m]": 0.1, "sinkage [m]": sinkage,
            "sinkage_std [m]": 3e-4, "slip": slip, "speed [m/s]": 0.4, "contact": "rolling", "soil": "soil 1",
            "run": [f"1.{i // 2}" for i in index], "wheel": np.where(index % 2, "rear", "front"),
        }
    )  # fmt: skip


def on_two_sides(zeros: tuple[float, float, float, float], count: int = 200) -> pd.DataFrame:
    """Stretches of two axles, to whose left and right sinkages (m) something is added."""
    table = stretches(count)
    left = np.arange(count) // 2 % 2
    number = 2 * left + np.arange(count) % 2
    table["wheel"] = table["wheel"] + np.where(left, "_left", "_right")
    return table.assign(**{"sinkage [m]": table["sinkage [m]"] + np.array(zeros)[number]})


@settings(max_examples=20, deadline=None)
@given(st.tuples(*[st.floats(-0.002, 0.002)] * 4))
def test_what_left_and_right_differ_by_is_taken_out_and_no_more(
    zeros: tuple[float, float, float, float],
) -> None:
    found, plain = evened(on_two_sides(zeros)), evened(on_two_sides((0.0,) * 4))
    for axle, (right, left) in enumerate([(zeros[0], zeros[2]), (zeros[1], zeros[3])]):
        mine = np.arange(200) % 2 == axle
        moved = (found["sinkage [m]"] - plain["sinkage [m]"])[mine]
        assert moved.to_numpy() == pytest.approx(0.5 * (left + right), abs=1e-4)


def test_wheels_of_two_sizes_or_on_two_passes_are_not_compared() -> None:
    table = stretches(200)
    pd.testing.assert_frame_equal(evened(table), table)
    passes = table.assign(
        pass_number=1 + np.arange(200) % 2, **{"diameter [m]": 0.3, "width [m]": 0.1}
    )
    pd.testing.assert_frame_equal(evened(passes), passes)


def test_of_a_short_drive_nothing_is_said_but_that() -> None:
    found = diagnosed(stretches(60), Path("measurements.csv"))
    assert found.to_dict()["verdict"] is None
    (line,) = found.lines
    assert "60" in line
    assert "120" in line


def test_a_table_that_cannot_be_read_is_one_line() -> None:
    table = stretches(140).assign(contact="floating")
    found = diagnosed(table, Path("measurements.csv"))
    assert found.verdict == ""
    assert "floating" in found.lines[0]


def test_where_nothing_shows_no_model_is_refitted() -> None:
    found = diagnosed(stretches(140), Path("out/measurements.csv"))
    assert found.verdict == "adequate"
    first, second = found.lines
    assert first.startswith("Diagnosis of 140 steady stretches: no missing effect shows (p")
    assert "smallwheel diagnose out/measurements.csv" in second


def test_what_the_filter_has_found_is_said_where_stretches_do_not_show_it() -> None:
    remark = "sinkage grows with slip, s = 0.9 +- 0.2"
    for count in (60, 140):
        found = diagnosed(stretches(count), Path("out/measurements.csv"), [remark])
        assert remark in found.lines[0]
        assert "no missing effect" not in found.lines[0]
        assert found.to_dict()["by_filter"] == [remark]
        assert found.effects == ()


@pytest.mark.slow
@pytest.mark.parametrize(("strength", "verdict"), [(1.0, "missing_effect"), (0.0, "adequate")])
def test_slip_sinkage_that_the_model_lacks_is_named_in_two_lines(
    strength: float, verdict: str
) -> None:
    found = diagnosed(stretches(140, strength), Path("out/measurements.csv"))
    assert found.verdict == verdict
    first, second = found.lines
    assert ("slip_sinkage" in found.effects) is (strength > 0.0)
    assert ("slip sinkage" in first) is (strength > 0.0)
    assert second.startswith("Next:")
