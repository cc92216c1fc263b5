# SPDX-License-Identifier: Apache-2.0
"""Saving what a pipeline believes, and going on from it."""

from __future__ import annotations

import json
import os
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from rows_of_drives import drive, rover, run

from smallwheel_ros.effects.slip import Exponential
from smallwheel_ros.onboard.prior import EstimatorError
from smallwheel_ros.onboard.settings import OnboardSettings
from smallwheel_ros.pipeline.pipeline import Pipeline
from smallwheel_ros.pipeline.soil.saved_state import check_may_replace

SETTINGS = rover().onboard


@cache
def driven() -> Pipeline:
    pipeline = Pipeline(SETTINGS)
    run(rover(), drive(25.0), pipeline=pipeline)
    return pipeline


@pytest.fixture
def saved(tmp_path: Path) -> Path:
    path = tmp_path / "state" / "soil.json"
    driven().save(path)
    return path


def restored(path: Path, settings: OnboardSettings = SETTINGS) -> Pipeline:
    pipeline = Pipeline(settings)
    pipeline.restore(path)
    return pipeline


def test_a_restart_goes_on_where_it_was(saved: Path) -> None:
    before, again = driven().soil, restored(saved)
    after = again.soil
    assert before.accepted > 100
    assert (after.k, after.n, after.m) == pytest.approx((before.k, before.n, before.m), rel=1e-9)
    np.testing.assert_allclose(after.covariance, before.covariance, rtol=1e-9)
    assert (after.accepted, after.status) == (before.accepted, before.status)
    assert after.identifiable == before.identifiable
    strength, expected = again.strength, driven().strength
    assert strength.steps == expected.steps > 0
    assert strength.sources == expected.sources
    assert strength.status == expected.status
    assert strength.friction_angle == pytest.approx(expected.friction_angle, rel=1e-9)
    # Time and travel begin anew, and it goes on learning.
    run(rover(), drive(25.0, seed=1), pipeline=again)
    assert again.accepted > before.accepted
    assert again.strength.steps > strength.steps


def test_nothing_measured_is_saved_as_the_prior(tmp_path: Path) -> None:
    Pipeline(SETTINGS).save(tmp_path / "soil.json")
    again = restored(tmp_path / "soil.json")
    assert again.soil.accepted == 0
    assert again.soil.status == Pipeline(SETTINGS).soil.status


def refused(path: Path, words: str, settings: OnboardSettings = SETTINGS) -> None:
    pipeline = Pipeline(settings)
    run(rover(), drive(8.0), pipeline=pipeline)
    soil, steps = pipeline.soil, pipeline.strength.steps
    with pytest.raises(EstimatorError, match=words) as error:
        pipeline.restore(path)
    assert str(path) in str(error.value)
    assert pipeline.soil.k == soil.k
    assert pipeline.soil.accepted == soil.accepted
    assert pipeline.strength.steps == steps


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"format": "something"}, "expected a file of format"),
        ({"version": 1}, r"version 1 of a saved soil.*delete the file"),
        ({"prior": None}, "not as it was written"),
        ({"accepted": 10**400}, "not as it was written"),
        ({"soil": 3}, "not as it was written"),
        ({"sha256": None}, "not as it was written"),
    ],
)
def test_a_wrong_file_is_named_and_changes_nothing(
    saved: Path, values: dict[str, object], words: str
) -> None:
    saved.write_text(json.dumps(json.loads(saved.read_text()) | values))
    refused(saved, words)


def test_another_prior_or_model_is_refused(saved: Path) -> None:
    prior = replace(SETTINGS.prior, n=SETTINGS.prior.n + 1e-6)
    refused(saved, "another prior", replace(SETTINGS, prior=prior))
    refused(saved, "another model", replace(SETTINGS, effects=(Exponential(a=1.0),)))


@pytest.mark.parametrize("share", [0.0, 0.1, 0.97])
def test_half_a_file_is_no_state(saved: Path, share: float) -> None:
    whole = saved.read_bytes()
    saved.write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(EstimatorError, match="not a whole saved soil"):
        restored(saved)


@pytest.mark.parametrize("text", ["[" * 100_000, '{"a": NaN}', "[1, 2]"])
def test_text_that_is_no_object_is_refused(saved: Path, text: str) -> None:
    saved.write_text(text)
    with pytest.raises(EstimatorError, match="not a whole saved soil"):
        restored(saved)


def test_what_is_no_file_is_named(saved: Path) -> None:
    with pytest.raises(EstimatorError, match=r"nowhere.json: no saved soil"):
        restored(saved.with_name("nowhere.json"))
    saved.unlink()
    os.mkfifo(saved)
    with pytest.raises(EstimatorError, match="a device or a pipe"):
        restored(saved)


def test_what_cannot_be_written_leaves_the_old_file(
    saved: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    old = saved.read_bytes()
    with pytest.raises(EstimatorError, match="cannot be written"):
        driven().save(saved / "below_a_file")

    def full(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(EstimatorError, match="No space left"):
        driven().save(saved)
    assert saved.read_bytes() == old
    assert list(saved.parent.iterdir()) == [saved]


@pytest.mark.parametrize("content", [b"precious", b'{"format": "other"}', b""])
def test_only_a_saved_soil_may_be_replaced(saved: Path, content: bytes) -> None:
    check_may_replace(saved)
    check_may_replace(saved.with_name("new.json"))
    saved.write_bytes(content)
    with pytest.raises(EstimatorError, match="not a saved soil, and is left as it is"):
        check_may_replace(saved)
