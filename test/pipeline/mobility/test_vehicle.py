# SPDX-License-Identifier: Apache-2.0
"""The vehicle as a whole: ten times a second, also at rest, with a flag for whatever is not known."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace

import numpy as np
import pytest
from rows_of_drives import START, drive, give, rover, static_rover

from smallwheel_ros.common.stamps import SECOND
from smallwheel_ros.drive.messages import VEHICLE_VALID, vehicle_columns
from smallwheel_ros.onboard.settings import NodeSettings
from smallwheel_ros.pipeline.intake.layout import widths_of
from smallwheel_ros.pipeline.mobility.status import Status
from smallwheel_ros.pipeline.mobility.vehicle import VehicleEstimates
from smallwheel_ros.pipeline.pipeline import Pipeline, Turn
from smallwheel_ros.pipeline.tables import Estimates
from smallwheel_ros.pipeline.warning.warning_level import WarningLevel


def turns_of(
    rows: list,
    span: int | None = None,
    vehicle: Callable[..., NodeSettings] = rover,
    **parameters: object,
) -> list[Turn]:
    settings = vehicle(**parameters).onboard
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


@pytest.mark.parametrize("others", [True, False])
@pytest.mark.parametrize("seconds", [None, 0.33])
def test_without_any_odometry_there_is_a_row_each_tenth_all_the_same(
    others: bool, seconds: float | None
) -> None:
    span = None if seconds is None else round(seconds * SECOND)
    rows = [row for row in drive() if row[0] != "odom" and (others or row[0] != "imu")]
    found = joined(turns_of(rows, span, static_rover, **({} if others else {"imu_topic": None})))
    assert found.stamp[-1] - found.stamp[0] > 11 * SECOND
    assert (np.diff(found.stamp) == SECOND // 10).all()
    columns = vehicle_columns(found)
    assert set(np.asarray(columns["level"]).tolist()) == {WarningLevel.UNKNOWN}
    assert not any(np.asarray(columns[flag]).any() for flag in VEHICLE_VALID)


def test_every_flag_is_set_while_it_is_known_and_cleared_while_it_is_not() -> None:
    silent = range(10 * SECOND, 16 * SECOND)  # of odometry and imu; they come again
    rows = [
        row
        for row in drive(26.0, oriented=True)
        if row[0] not in ("odom", "imu") or row[1] - START not in silent
    ]
    found = joined(turns_of(rows, None, static_rover))
    columns, time = vehicle_columns(found), (found.stamp - START) / SECOND
    assert (np.diff(found.stamp) == SECOND // 10).all()
    known = [(time > 4.0) & (time < 10.0), time > 20.0]
    unknown = (time > 13.0) & (time < 16.0)
    for flag, names in VEHICLE_VALID.items():
        column = np.asarray(columns[flag])
        assert all(column[part].all() for part in known), flag
        assert not column[unknown].any(), flag
        for name in names:
            assert not np.asarray(columns[name])[unknown].any(), name
    assert (found.level[known[0]] == WarningLevel.OK).all()
    assert (found.level[unknown] == WarningLevel.UNKNOWN).all()


def test_after_a_hole_in_time_it_goes_on_without_rows_in_between() -> None:
    hole = 60 * SECOND
    rows = [
        (name, stamp + hole, values, stamp + hole) if stamp - START > 6 * SECOND else row
        for row in drive()
        for name, stamp, values, _ in [row]
    ]
    apart = np.diff(joined(turns_of(rows, None, static_rover)).stamp)
    assert apart.min() == SECOND // 10
    assert (apart > SECOND // 10).sum() == 1
    assert apart.max() == pytest.approx(hole, abs=2 * SECOND)


# Columns of `VehicleEstimates` that a flag is about, where they are called otherwise in the message.
_COLUMNS = {
    "steepest_slope": "margin",
    "risk_of_getting_stuck": "risk",
    "energy_per_metre": "energy",
}


def all_known() -> VehicleEstimates:
    """One row in which all is known."""
    names = [field.name for field in fields(VehicleEstimates)]
    numbers = {name: np.full(1, 0.1 + 0.01 * i) for i, name in enumerate(names)}
    whole = {
        name: np.ones(1, dtype=np.int64) for name in ("stamp", "level", "margin_source", "soil")
    }
    return VehicleEstimates(**(numbers | whole | {"at_border": np.zeros(1, dtype=bool)}))


@pytest.mark.parametrize(
    ("flag", "name"), [(flag, name) for flag, names in VEHICLE_VALID.items() for name in names]
)
def test_each_flag_is_set_where_all_is_known_and_goes_with_each_of_its_columns(
    flag: str, name: str
) -> None:
    rows = all_known()
    known = vehicle_columns(rows)
    assert all(known[one][0] for one in VEHICLE_VALID)
    column = _COLUMNS.get(name, name)
    found = vehicle_columns(replace(rows, **{column: np.full(1, np.nan)}))
    about = {
        flag,
        *VEHICLE_VALID[flag],
        *(f"{one}_standard_deviation" for one in VEHICLE_VALID[flag]),
    }
    about |= {"margin_source", "margin_information"} if flag == "margin_valid" else set()
    for one, values in found.items():
        if one in about:
            assert not values[0], one
        else:
            assert values[0] == known[one][0], one


@pytest.mark.parametrize("mass", [24.0, None], ids=["strength measured", "any ground"])
@pytest.mark.parametrize("span", [None, SECOND // 3])
def test_a_wheel_that_sinks_to_its_axle_lowers_the_margin_and_raises_the_risk(
    mass: float | None, span: int | None
) -> None:
    """The soil does not carry 3 kN on one wheel: it pulls nothing, and is dragged along."""
    dug_in = START + 22 * SECOND
    rows = [
        (
            name,
            stamp,
            (3000.0 + values[0],) if name == "rl/load" and stamp > dug_in else values,
            now,
        )
        for name, stamp, values, now in drive(26.0, wave=0.5, oriented=True)
    ]
    turns = turns_of(rows, span, **{"vehicle.mass": mass})
    wheels, found = Estimates.joined([turn.estimates for turn in turns]), joined(turns)
    sunk = wheels.status == Status.SUNK_TO_AXLE
    assert set(wheels.wheel[sunk].tolist()) == {2}
    assert np.isnan(wheels.margin[sunk]).all(), "the wheel's own margin is not known"
    last = wheels.stamp[sunk].max()
    before = (found.stamp > START + 10 * SECOND) & (found.stamp < dug_in - SECOND)
    after = (found.stamp > wheels.stamp[sunk].min() + SECOND) & (found.stamp <= last)
    assert after.sum() > 5
    assert (found.margin[before] > 0.0).all()
    assert (found.margin[after] < 0.0).all(), "nothing pulls 3 kN out"
    assert (found.risk[before] < 0.5).all()
    assert (found.risk[after] > 0.9).all()
