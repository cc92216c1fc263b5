# SPDX-License-Identifier: Apache-2.0
"""The vehicle as a whole: ten times a second, also at rest, with a flag for whatever is not known."""

from __future__ import annotations

import numpy as np
import pytest
from rows_of_drives import drive, give, rover

from smallwheel_ros.drive.messages import VEHICLE_VALID, vehicle_columns
from smallwheel_ros.pipeline.intake.layout import widths_of
from smallwheel_ros.pipeline.mobility.status import WarningLevel
from smallwheel_ros.pipeline.mobility.vehicle import VehicleEstimates
from smallwheel_ros.pipeline.pipeline import Pipeline, Turn
from smallwheel_ros.pipeline.tables import SECOND


def turns_of(rows: list, span: int | None = None, **parameters: object) -> list[Turn]:
    settings = rover(**parameters).onboard
    pipeline = Pipeline(settings)
    known = set(widths_of(settings))
    give(pipeline.streams, [row for row in rows if row[0] in known])
    return [*pipeline.turns(span=span), *pipeline.turns(last=True)]


def joined(turns: list[Turn]) -> VehicleEstimates:
    return VehicleEstimates.joined([turn.vehicle for turn in turns])


def test_there_is_a_row_each_tenth_of_a_second_and_its_messages_are_finite() -> None:
    turns = turns_of(drive())
    rows = joined(turns)
    assert (np.diff(rows.stamp) == SECOND // 10).all()
    columns = vehicle_columns(rows)
    for name, column in columns.items():
        assert len(column) == len(rows), name
        if name != "text":
            assert np.isfinite(np.asarray(column, dtype=float)).all(), name
    assert all(columns["text"])
    late = rows.stamp > rows.stamp[0] + 5 * SECOND
    assert (rows.level[late] >= WarningLevel.OK).all()
    slip = np.concatenate([turn.estimates.slip for turn in turns])
    assert np.nanmedian(rows.slip[late]) == pytest.approx(np.nanmedian(slip), abs=0.03)
    for flag in ("speed_valid", "slip_valid", "margin_valid", "slope_valid"):
        assert columns[flag][late].all(), flag


@pytest.mark.parametrize("seconds", [0.05, 0.33, 2.0])
def test_cuts_change_nothing(seconds: float) -> None:
    rows = drive()
    whole, cut = (joined(turns_of(rows, span)) for span in (None, round(seconds * SECOND)))
    for name, column in vars(whole).items():
        np.testing.assert_allclose(
            getattr(cut, name), column, rtol=1e-9, atol=1e-12, equal_nan=True, err_msg=name
        )


def test_what_nothing_tells_is_0_and_its_flag_false() -> None:
    rows = [row for row in drive() if row[0] != "odom"]
    columns = vehicle_columns(joined(turns_of(rows)))
    assert set(np.asarray(columns["level"]).tolist()) == {WarningLevel.UNKNOWN}
    assert "slip is not known" in columns["text"][0]
    for flag in ("speed_valid", "slip_valid", "energy_valid"):
        assert not columns[flag].any()
        for name in VEHICLE_VALID[flag]:
            assert not columns[name].any()
