# SPDX-License-Identifier: Apache-2.0
"""What the sinkages of a vehicle's wheels differ by, `own_zeros.py`: of wheels whose zeros are known."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from smallwheel_ros.diagnosis.own_zeros import evened
from smallwheel_ros.diagnosis.pipeline import start_of
from smallwheel_ros.measurements.from_file import read_measurements
from smallwheel_ros.measurements.measurements import Measurements
from smallwheel_ros.simulate.truth import static_sinkage

ROWS = 200
WHEEL = np.array(["front_right", "rear_right", "front_left", "rear_left"])[np.arange(ROWS) % 4]
FRONT = np.arange(ROWS) % 2 == 0


def drive(zeros: tuple[float, ...] = (0.0,) * 4, **columns: object) -> pd.DataFrame:
    """Stretches of four wheels of two sizes on one soil, a zero (m) added to what each shows."""
    rng = np.random.default_rng(5)
    diameter = np.where(FRONT, 0.2, 0.3)
    load = np.exp(rng.normal(np.log(80.0), 0.3, ROWS))
    modulus = 30e3 / 0.01**0.9 * np.exp(0.03 * rng.standard_normal(ROWS))
    still = static_sinkage(
        lambda depth: modulus[:, None] * depth**0.9, load, diameter, np.full(ROWS, 0.1)
    )
    shown = still + np.array(zeros)[np.arange(ROWS) % 4]
    table = pd.DataFrame(
        {
            "load [N]": load, "diameter [m]": diameter, "width [m]": 0.1, "sinkage [m]": shown,
            "slip": rng.uniform(0.02, 0.4, ROWS), "contact": "rolling", "wheel": WHEEL,
            "run": [f"1.{i // 4}" for i in range(ROWS)],
        }
    )  # fmt: skip
    return table.assign(**columns)


def sinkage(data: Measurements) -> np.ndarray:
    return data.channels["sinkage"]


@settings(max_examples=20, deadline=None)
@given(st.tuples(*[st.floats(-0.002, 0.002)] * 4))
def test_what_left_and_right_differ_by_is_taken_out_and_no_more(
    zeros: tuple[float, float, float, float],
) -> None:
    found, plain = (evened(read_measurements(drive(z))) for z in (zeros, (0.0,) * 4))
    for axle, mine in ((0, FRONT), (1, ~FRONT)):
        moved = (sinkage(found) - sinkage(plain))[mine]
        both = 0.5 * (zeros[axle] + zeros[axle + 2])
        assert moved[np.isfinite(moved)] == pytest.approx(both, abs=1e-4)


def test_every_diagnosis_begins_with_it_and_says_what_was_taken_out() -> None:
    data = read_measurements(drive((2e-3, 0.0, -2e-3, 0.0)))
    start = start_of(data)
    moved = 1e3 * (sinkage(data) - sinkage(start.measurements))
    assert moved[FRONT] == pytest.approx(
        np.where(WHEEL == "front_right", 2.0, -2.0)[FRONT], abs=0.1
    )
    (note,) = set(start.measurements.notes) - set(data.notes)
    assert "front_right +2.0 mm" in note
    assert "front_left -2.0 mm" in note


def test_a_sinkage_that_is_below_zero_then_counts_as_not_measured() -> None:
    table = drive((4e-3, 0.0, -4e-3, 0.0))
    table.loc[0, "sinkage [m]"] = 1e-3  # of a wheel that shows 4 mm too much
    found = sinkage(evened(read_measurements(table)))
    assert np.isnan(found[0])
    assert np.isfinite(found[1:]).all()


@pytest.mark.parametrize(
    "columns",
    [
        {"diameter [m]": 0.1 + 0.05 * (np.arange(ROWS) % 4)},
        {"pass_number": 1 + np.arange(ROWS) % 4},
        {"grouser_height [mm]": np.arange(ROWS) % 4},
        {"run": [f"{i}" for i in range(ROWS)]},
        {"run": np.where(FRONT, "1", "2")},
    ],
    ids=["sizes", "passes", "lugs", "a run for each", "repeats of a run"],
)
def test_other_wheels_and_those_of_a_rig_are_not_compared(columns: dict[str, object]) -> None:
    data = read_measurements(drive((2e-3, 1e-3, -2e-3, -1e-3), **columns))
    found = start_of(data).measurements
    np.testing.assert_array_equal(sinkage(found), sinkage(data))
    assert found.notes == data.notes


@pytest.mark.filterwarnings("error")
def test_a_size_without_any_sinkage_is_left_alone() -> None:
    """Its wheels have a drawbar pull; the other size is evened as if they were not there."""
    table = drive((2e-3, 0.0, -2e-3, 0.0), **{"drawbar_pull [N]": 5.0})
    alone = sinkage(evened(read_measurements(table)))
    table.loc[~FRONT, "sinkage [m]"] = np.nan
    shown = sinkage(evened(read_measurements(table)))
    np.testing.assert_allclose(shown[FRONT], alone[FRONT])
    assert np.isnan(shown[~FRONT]).all()
