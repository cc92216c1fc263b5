# SPDX-License-Identifier: Apache-2.0
"""Resistance over load against sinkage over diameter: what is compaction alone lies on the line of its n."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq

from smallwheel_ros.compare.resistance_ratio import resistance_ratio
from smallwheel_ros.measurements.from_file import read_measurements

PRESSURE, M, WIDTH = 3e4, 0.4, 0.1  # Pa at 10 mm, under a metre


def wheel(load: float, diameter: float, n: float) -> tuple[float, float]:
    """Sinkage and resistance by quadrature over the contact (Bekker 1956), not by the model."""
    k = PRESSURE / 0.01**n

    def borne(z: float) -> float:
        # x is what lies ahead of the axle: the chord of the circle at each depth
        def upward(depth: float) -> float:
            reach = z - depth
            dx = (diameter / 2.0 - reach) / np.sqrt(reach * (diameter - reach))
            return k * diameter**M * depth**n * dx

        return WIDTH * quad(upward, 0.0, z, points=[z])[0] - load

    z = brentq(borne, 1e-5, 0.45 * diameter)
    return z, WIDTH * k * diameter**M * z ** (n + 1.0) / (n + 1.0)


def table(n: float) -> pd.DataFrame:
    rows = [(load, d, *wheel(load, d, n)) for load in (20.0, 50.0, 90.0) for d in (0.15, 0.3)]
    return pd.DataFrame(
        rows, columns=["load [N]", "diameter [m]", "sinkage [m]", "resistance [N]"]
    ).assign(**{"width [m]": WIDTH})


@pytest.mark.parametrize("n", [0.5, 1.0, 1.5])
def test_compaction_lies_on_the_line_of_its_n_whatever_the_load_and_size(n: float) -> None:
    found = resistance_ratio(read_measurements(table(n)))
    assert found is not None
    line = np.interp(found.x, found.line_x, found.lines[n])
    np.testing.assert_allclose(found.y, line, rtol=0.01)
    others = [np.interp(found.x, found.line_x, found.lines[k]) for k in found.lines if k != n]
    assert all((np.abs(found.y / other - 1.0) > 0.05).all() for other in others)


def test_rows_without_sinkage_or_resistance_or_that_did_not_roll_are_no_points() -> None:
    made = table(1.0)
    made.loc[0, "sinkage [m]"] = np.nan
    made.loc[1, "resistance [N]"] = np.nan
    made.loc[2, "sinkage [m]"] = 0.0
    found = resistance_ratio(read_measurements(made))
    assert found is not None
    assert found.rows.tolist() == [3, 4, 5]
    made["contact"] = ["rolling"] * 4 + ["pressed"] * 2
    made.loc[4:, "resistance [N]"] = np.nan
    found = resistance_ratio(read_measurements(made))
    assert found is not None
    assert found.rows.tolist() == [3]


def test_there_is_no_check_without_both() -> None:
    assert resistance_ratio(read_measurements(table(1.0).drop(columns="resistance [N]"))) is None
