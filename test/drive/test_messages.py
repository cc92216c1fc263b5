# SPDX-License-Identifier: Apache-2.0
"""Every row that is due is answered: with what is known of it, and in words with what is not."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest
from rows_of_drives import START, Row, drive, give, rover, static_rover

from smallwheel_ros.common.stamps import SECOND
from smallwheel_ros.drive.messages import (
    VALID,
    margin_before_driving,
    mobility_columns,
    soil_fields,
    status_texts,
)
from smallwheel_ros.onboard.settings import NodeSettings
from smallwheel_ros.physics.wheel import Quantity
from smallwheel_ros.pipeline.intake.layout import widths_of
from smallwheel_ros.pipeline.mobility.status import Status
from smallwheel_ros.pipeline.mobility.vehicle import vehicle_margin
from smallwheel_ros.pipeline.pipeline import Pipeline, Turn
from smallwheel_ros.pipeline.tables import Estimates


def turned(
    vehicle: NodeSettings, rows: list[Row], pipeline: Pipeline | None = None
) -> tuple[Pipeline, list[Turn], Estimates]:
    """A pipeline behind some rows, its turns, and their estimates."""
    pipeline = pipeline or Pipeline(vehicle.onboard)
    known = set(widths_of(vehicle.onboard))
    give(pipeline.streams, [row for row in rows if row[0] in known])
    turns = list(pipeline.turns(last=True))
    return pipeline, turns, Estimates.joined([turn.estimates for turn in turns])


def test_messages_have_a_flag_for_what_is_not_known_and_no_nan() -> None:
    pipeline, _, found = turned(rover(), drive())
    columns = mobility_columns(found, pipeline)
    names = {name for group in VALID.values() for name in group}
    deviations = {f"{n}_standard_deviation" for n in names} - {
        "probability_drawbar_pull_positive_standard_deviation"
    }
    others = {"wheel", "slip_angle", "steering_angle"}
    assert set(columns) == {*VALID, *names, *deviations, "status", "status_text", *others}
    for name, column in columns.items():
        assert len(column) == len(found), name
        if name not in ("status_text", "wheel"):
            assert np.isfinite(np.asarray(column, dtype=float)).all(), name
    assert columns["traction_valid"][-1]
    assert columns["mobility_margin"][-1] == found.margin[-1]


def test_a_row_without_load_is_answered_and_says_so() -> None:
    gap = [
        row
        for row in drive()
        if not (row[0] == "fl/load" and 5.0 < (row[1] - START) / SECOND < 9.0)
    ]
    pipeline, _, found = turned(rover(), gap)
    late = (
        (found.wheel == 0) & (found.stamp > START + 7 * SECOND) & (found.stamp < START + 8 * SECOND)
    )
    assert late.sum() >= 8
    assert (found.status[late] == Status.LOAD_MISSING).all()
    assert np.isnan(found.sinkage[late]).all()
    assert np.isfinite(found.margin[late]).all()  # that of any ground needs no load
    assert "no load near this reading" in status_texts(found.take(late), pipeline)[0]
    others = (found.wheel == 1) & (found.stamp > START + 7 * SECOND)
    assert np.isfinite(found.sinkage[others]).all()


@pytest.mark.parametrize("factor", [0.92, 1.08])
def test_loads_of_cells_that_are_off_are_within_their_deviation(factor: float) -> None:
    rows = [
        (name, stamp, (factor * values[0],), now) if name.endswith("/load") else row
        for row in drive()
        for name, stamp, values, now in [row]
    ]
    _, _, found = turned(rover(**{"vehicle.mass": None}), rows)
    _, _, true = turned(rover(**{"vehicle.mass": None}), drive())
    late = np.isfinite(found.load) & (found.distance > 1.0)
    off = np.abs(found.load - true.load)[late] / found.load_std[late]
    assert (off < 1.96).mean() > 0.95
    assert (
        found.load_std[late] / found.load[late] > 0.02
    ).all()  # nothing told the scale of the cells


def test_a_soil_that_is_neither_named_nor_measured_gives_no_sinkage() -> None:
    pipeline, _, found = turned(static_rover(), drive(soil=False))
    assert np.isnan(found.sinkage).all()
    assert np.isnan(found.compaction_resistance).all()
    assert np.isfinite(found.margin).all()
    text = status_texts(found, pipeline)[-1]
    assert "no sinkage is measured, and the soil is not named" in text
    assert "load not measured: 58.8 N as configured" in text


def test_a_wild_sinkage_does_not_fit_and_the_next_one_does() -> None:
    rows = drive(20.0)
    at = [
        i for i, row in enumerate(rows) if row[0] == "fl/sinkage" and row[1] > START + 15 * SECOND
    ]
    for i in at[:40:10]:
        name, stamp, values, now = rows[i]
        rows[i] = name, stamp, (values[0] + 0.05, values[1]), now
    pipeline = Pipeline(rover(**{"mobility.rate": 0.0}).onboard)
    pipeline, _, found = turned(rover(), rows, pipeline)
    wild = found.sinkage_measured > 0.05
    assert wild.sum() == 4
    assert (found.status[wild] == Status.REJECTED).all()
    assert "does not fit: 6" in status_texts(found.take(wild), pipeline)[0]
    settled = (found.stamp > START + 10 * SECOND) & ~wild
    assert (found.status[settled] != Status.REJECTED).mean() > 0.99


def test_a_doubted_encoder_gives_no_slip_and_says_why() -> None:
    """The joint of one wheel is mirrored: from when that is said on nothing is known of its slip."""
    rows = [
        (name, stamp, (-values[0],) if name == "fl/wheel_speed" else values, now)
        for name, stamp, values, now in drive(30.0, noise=0.03, wave=0.5)
    ]
    pipeline, turns, found = turned(rover(), rows)
    said = [one for turn in turns for one in turn.findings]
    assert [one.rule for one in said] == ["mirrored"]
    assert "fl" in said[0].text
    assert any("fl" in words for words in pipeline.findings)
    late = found.stamp > said[0].stamp + 3 * SECOND
    assert np.isnan(found.slip[late & (found.wheel == 0)]).all()
    assert np.isfinite(found.slip[late & (found.wheel == 1)]).all()


def test_numbers_that_no_soil_has_are_said() -> None:
    """Sinkages of a tenth of what they are, loads of ten times: no soil is so hard."""
    scaled = {"load": 100.0, "sinkage": 0.02}
    rows = []
    for name, stamp, values, now in drive(40.0):
        by = scaled.get(name.rpartition("/")[2])
        rows.append((name, stamp, values if by is None else (values[0] * by, *values[1:]), now))
    pipeline, _, _ = turned(rover(**{"vehicle.mass": None}), rows)
    assert pipeline.accepted
    assert bool(pipeline.impossible) == any("no soil carries" in one for one in pipeline.findings)


def test_the_vehicle_goes_by_the_loads_of_its_wheels() -> None:
    _, _, found = turned(rover(), drive())
    newest = Estimates.joined(
        [found.take(found.wheel == w).take(slice(-1, None)) for w in range(4)]
    )
    margin = vehicle_margin(newest)
    assert margin is not None
    rounding = 1e-12
    assert min(newest.margin) - rounding <= margin.value <= max(newest.margin) + rounding
    assert vehicle_margin(newest.take(slice(0, 0))) is None
    before = margin_before_driving(rover().onboard)
    assert isinstance(before, Quantity)
    assert 0.1 < before.value < 0.6
    assert before.standard_deviation > 0.15


def test_soil_fields_are_finite_before_and_behind_a_drive() -> None:
    pipeline = Pipeline(rover().onboard)
    assert soil_fields(pipeline.soil, 0)["status"] == 1
    pipeline, _, _ = turned(rover(), drive(), pipeline)
    told = soil_fields(pipeline.soil, pipeline.rejected)
    assert told["status"] == 0
    assert told["measurements_accepted"] == pipeline.accepted > 0
    numbers = [value for value in told.values() if not isinstance(value, str)]
    assert all(np.isfinite(value).all() for value in numbers)


def test_time_that_goes_back_begins_anew_and_says_so() -> None:
    rows = drive(6.0)
    _, turns, _ = turned(rover(), rows + rows)
    assert [turn.starts_over for turn in turns].count(True) == 2


@pytest.mark.parametrize("name", [f.name for f in fields(Estimates)])
def test_no_estimate_is_infinite(name: str) -> None:
    _, _, found = turned(rover(), drive(4.0))
    assert not np.isinf(np.asarray(getattr(found, name), dtype=float)).any()
