# SPDX-License-Identifier: Apache-2.0
"""Where a vehicle drives under another gravity: loads, slopes and margins are those of that place."""

from __future__ import annotations

import numpy as np
import pytest
from rows_of_drives import G, Row, drive, give, rover, static_rover

from smallwheel_ros.onboard.parameters import ParametersError
from smallwheel_ros.onboard.settings import NodeSettings
from smallwheel_ros.pipeline.pipeline import Pipeline
from smallwheel_ros.pipeline.tables import Estimates

MOON = 1.62


def under(gravity: float, rows: list[Row]) -> list[Row]:
    """The rows of a drive on the level as an imu and load cells have them under another gravity."""
    share = gravity / G
    found = []
    for name, stamp, values, now in rows:
        if name == "imu":
            values = (*values[:3], share * values[3], *values[4:])
        elif name.endswith("/load"):
            values = (share * values[0],)
        found.append((name, stamp, values, now))
    return found


def estimated(vehicle: NodeSettings, rows: list[Row]) -> tuple[Pipeline, Estimates]:
    pipeline = Pipeline(vehicle.onboard)
    give(pipeline.streams, rows)
    return pipeline, Estimates.joined([turn.estimates for turn in pipeline.turns(last=True)])


def test_loads_of_a_static_vehicle_are_its_weight_there() -> None:
    _, found = estimated(static_rover(gravity=MOON), under(MOON, drive(soil=False)))
    assert float(np.median(found.load)) == pytest.approx(24.0 * MOON / 4.0, rel=0.02)
    assert np.isfinite(found.margin).all()


def test_cells_that_show_the_weight_there_are_right_and_under_another_gravity_are_not() -> None:
    rows = under(MOON, drive())
    right, _ = estimated(rover(gravity=MOON), rows)
    assert not [text for text in right.findings if "weight" in text or "z of the imu" in text]
    wrong, _ = estimated(rover(), rows)
    assert [text for text in wrong.findings if "times the weight" in text]


@pytest.mark.parametrize("gravity", [0.0, -1.62])
def test_no_gravity_is_refused_with_what_to_write(gravity: float) -> None:
    with pytest.raises(ParametersError, match=r"gravity is .*expected a double from 0\.01 to 100"):
        rover(gravity=gravity)
