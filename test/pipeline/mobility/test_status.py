# SPDX-License-Identifier: Apache-2.0
"""Statuses: one enum of which the messages and the docs are a copy; a wheel that stands keeps its load."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rows_of_drives import START, drive, give, rover

from smallwheel_ros.common.stamps import SECOND
from smallwheel_ros.drive.messages import mobility_columns, status_texts
from smallwheel_ros.model.model import Model
from smallwheel_ros.model.model_file import write_model
from smallwheel_ros.pipeline.mobility.status import Condition, Status, status_of
from smallwheel_ros.pipeline.pipeline import Pipeline
from smallwheel_ros.pipeline.tables import Estimates

ROOT = Path(__file__).resolve().parents[3]


def test_the_page_of_the_node_explains_each_status_as_the_message_does() -> None:
    page = (ROOT / "docs" / "node.md").read_text(encoding="utf-8")
    table = page.split("## Status of a mobility estimate")[1].split("\n## ")[0]
    rows = re.findall(r"^\| ([A-Z_]+) \| (.+?) \|", table, re.MULTILINE)
    assert rows == [(one.name, one.meaning) for one in Status]


@given(st.lists(st.sampled_from(list(Condition)), min_size=1))
def test_the_status_is_the_most_serious_of_what_applies(applies: list[Condition]) -> None:
    alone = {int(status_of(np.array([int(one)]))[0]) for one in applies}
    together = np.array([int(np.bitwise_or.reduce([int(one) for one in applies]))])
    assert int(status_of(together)[0]) in alone
    if Condition.SUNK_TO_AXLE in applies:
        assert int(status_of(together)[0]) == Status.SUNK_TO_AXLE


def stopped(tmp_path: Path, *effects: str) -> tuple[Pipeline, Estimates]:
    """Estimates of a drive that stops after 8 s, by a model with effects."""
    model = Model("dry_sand")
    for effect in effects:
        model = model + effect
    write_model(tmp_path / "model.yaml", model)
    vehicle = rover(model_file=str(tmp_path / "model.yaml"))
    pipeline = Pipeline(vehicle.onboard)
    give(pipeline.streams, drive(14.0, speed=lambda t: np.where((t > 1.0) & (t < 8.0), 0.3, 0.0)))
    return pipeline, Estimates.joined([turn.estimates for turn in pipeline.turns(last=True)])


@pytest.mark.parametrize("effects", [(), ("slip_sinkage",)])
def test_a_wheel_that_stands_has_its_load_and_its_slip_is_what_is_unknown(
    tmp_path: Path, effects: tuple[str, ...]
) -> None:
    pipeline, found = stopped(tmp_path, *effects)
    late = found.take(found.stamp > START + 10 * SECOND)
    assert len(late) > 100
    assert (late.status == Status.SLIP_UNKNOWN).all()
    assert ((late.load > 50.0) & (late.load < 66.0)).all()
    assert (late.load_std > 0.0).all()
    columns = mobility_columns(late, pipeline)
    assert columns["load_valid"].all()
    assert not columns["traction_valid"].any()
    assert columns["prediction_valid"].all() == (not effects)
    text = status_texts(late, pipeline)[-1]
    assert "slip unknown (the wheel stands)" in text
    assert ("slip_sinkage of the model reads it" in text) == bool(effects)
    assert "load near" not in text
