# SPDX-License-Identifier: Apache-2.0
"""Saving the estimate and going on from it."""

from __future__ import annotations

import json
import math
import os
from contextlib import suppress
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st
from random_examples import examples
from wheel_drives import READING, changed, follow, rolled, varied

from benchmarks.robot_drives import make_drive
from benchmarks.robot_worlds import VEHICLES, WORLDS
from smallwheel_ros.effects.slip import Exponential
from smallwheel_ros.estimator.law_model import WHEELS
from smallwheel_ros.estimator.saved_state import check_may_replace
from smallwheel_ros.estimator.soil_estimator import (
    EstimatorError,
    Outcome,
    Reading,
    SoilEstimator,
    SoilPrior,
)
from smallwheel_ros.physics.soil import soil

PRIOR = SoilPrior.from_soil(soil("dry_sand"))
ONE = changed(READING, wheel="w", diameter=0.25, distance=0.0, slip=0.1, speed=0.2)


@cache
def readings() -> tuple[Reading, ...]:
    return tuple(rolled(varied(400), 1, one=ONE))


def driven(e: SoilEstimator) -> SoilEstimator:
    return follow(e, readings())


@pytest.fixture
def saved(tmp_path: Path) -> Path:
    path = tmp_path / "state" / "soil.json"
    driven(SoilEstimator(PRIOR)).save(path)
    return path


def test_a_restart_goes_on_where_it_was(saved: Path) -> None:
    before = driven(SoilEstimator(PRIOR)).estimate()
    again = SoilEstimator(PRIOR)
    again.restore(saved)
    after = again.estimate()
    assert (after.k, after.n, after.m) == pytest.approx((before.k, before.n, before.m), rel=1e-12)
    np.testing.assert_allclose(after.log_covariance, before.log_covariance, rtol=1e-9)
    assert after.status == before.status
    assert after.accepted == before.accepted
    assert after.identifiable == before.identifiable
    # Time and travel begin anew, and it goes on learning.
    driven(again)
    assert again.accepted == pytest.approx(2 * before.accepted, abs=24)
    assert again.soil_changes == 0
    assert again.estimate().log_covariance[1, 1] < before.log_covariance[1, 1]


def test_a_restart_on_another_soil_finds_that(saved: Path) -> None:
    again = SoilEstimator(PRIOR)
    again.restore(saved)
    other = rolled(varied(700), 2, one=ONE, factor=0.2)
    follow(again, other)
    assert again.soil_changes >= 1
    true = float(
        np.mean([one.measured[1] for one in rolled(np.full(300, 60.0), 2, one=ONE, factor=0.2)])
    )
    predicted = again.predict(60.0, 0.25, 0.1)
    assert abs(predicted.sinkage - true) < 2.0 * predicted.standard_deviation
    assert predicted.sinkage == pytest.approx(true, rel=0.15)


def test_nothing_measured_is_saved_as_the_prior(tmp_path: Path) -> None:
    SoilEstimator(PRIOR).save(tmp_path / "soil.json")
    again = SoilEstimator(PRIOR)
    again.restore(tmp_path / "soil.json")
    assert again.estimate().status == SoilEstimator(PRIOR).estimate().status


def change(path: Path, **values: object) -> None:
    content = json.loads(path.read_text())
    for name, value in values.items():
        place, *inner = name.split("__")
        if inner:
            content[place][inner[0]] = value
        else:
            content[place] = value
    path.write_text(json.dumps(content))


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"format": "something"}, "expected a file of format"),
        ({"version": 7}, "version 7"),
        ({"prior": None}, "not as it was written"),
        ({"prior__n": 0.5}, "not as it was written"),
        ({"accepted": 10**400}, "not as it was written"),
        ({"soil": 3}, "not as it was written"),
        ({"soil__mean": [1.0, *(WHEELS - 1) * [0.0]]}, "not as it was written"),
        ({"sha256": "0" * 64}, "not as it was written"),
        ({"sha256": None}, "not as it was written"),
    ],
)
def test_a_wrong_file_is_named_and_changes_nothing(
    saved: Path, values: dict[str, object], words: str
) -> None:
    change(saved, **values)
    refused(saved, SoilEstimator(PRIOR), words)


@settings(max_examples=examples(60), suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(place=st.integers(0, 10**6), digit=st.sampled_from("0123456789"))
def test_no_digit_of_a_file_can_be_another(saved: Path, place: int, digit: str) -> None:
    whole = saved.read_text()
    digits = [i for i, letter in enumerate(whole) if letter.isdigit()]
    at = digits[place % len(digits)]
    other = whole[:at] + digit + whole[at + 1 :]
    # Of seventeen digits the last one may be another, and the number the same.
    with suppress(ValueError):  # or the text may be no JSON at all
        assume(json.loads(other) != json.loads(whole))
    saved.write_text(other)
    try:
        with pytest.raises(EstimatorError, match=r"not a whole saved soil|version \d"):
            SoilEstimator(PRIOR).restore(saved)
    finally:
        saved.write_text(whole)


def refused(saved: Path, estimator: SoilEstimator, words: str) -> None:
    e = driven(estimator)
    before = e.estimate()
    with pytest.raises(EstimatorError, match=words) as error:
        e.restore(saved)
    assert str(saved) in str(error.value)
    assert e.estimate().k == before.k
    assert e.update(changed(ONE, time=1e3, distance=1e2)).outcome is not Outcome.REFUSED


@pytest.mark.parametrize(
    "prior",
    [replace(PRIOR, n=PRIOR.n + 1e-6), replace(PRIOR, soil=replace(PRIOR.soil, name="other"))],
)
def test_another_prior_is_refused(saved: Path, prior: SoilPrior) -> None:
    refused(saved, SoilEstimator(prior), "another prior")


def test_the_last_digit_of_a_prior_is_of_the_processor(saved: Path) -> None:
    """The logarithm of another machine may differ in it."""
    nearly = replace(PRIOR, n=math.nextafter(PRIOR.n, 9.0))
    e = SoilEstimator(nearly)
    e.restore(saved)
    assert e.estimate().accepted > 0


@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.97])
def test_half_a_file_is_no_state(saved: Path, share: float) -> None:
    whole = saved.read_bytes()
    saved.write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(EstimatorError, match="not a whole saved soil"):
        SoilEstimator(PRIOR).restore(saved)
    saved.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(EstimatorError, match="not a whole saved soil"):
        SoilEstimator(PRIOR).restore(saved)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(EstimatorError, match=r"nowhere.json: no saved soil"):
        SoilEstimator(PRIOR).restore(tmp_path / "nowhere.json")


def test_a_file_of_the_first_version_is_refused_with_what_to_do(saved: Path) -> None:
    change(saved, version=1)
    with pytest.raises(EstimatorError, match=r"version 1 of a saved soil.*delete the file"):
        SoilEstimator(PRIOR).restore(saved)


def test_what_is_known_of_the_sensors_is_kept_too(tmp_path: Path) -> None:
    """A delay that was found is not to be found again."""
    world = WORLDS["delay 200 ms"]
    drive = make_drive(replace(world, distance=12.0), 1)
    e = follow(SoilEstimator(drive.prior, wheels=VEHICLES[world.vehicle]), drive.readings)
    assert any("behind the load" in words for words in e.findings)
    e.save(tmp_path / "soil.json")
    again = SoilEstimator(drive.prior, wheels=VEHICLES[world.vehicle])
    again.restore(tmp_path / "soil.json")
    assert any("behind the load" in words for words in again.findings)


def test_another_model_is_refused(saved: Path) -> None:
    with pytest.raises(EstimatorError, match="another model"):
        SoilEstimator(PRIOR, effects=(Exponential(a=1.0),)).restore(saved)


def test_what_cannot_be_written_leaves_the_old_file(
    saved: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    old = saved.read_bytes()
    with pytest.raises(EstimatorError, match="cannot be written"):
        SoilEstimator(PRIOR).save(saved / "below_a_file")

    def full(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(EstimatorError, match="No space left"):
        SoilEstimator(PRIOR).save(saved)
    assert saved.read_bytes() == old
    assert list(saved.parent.iterdir()) == [saved]


@pytest.mark.parametrize("text", ["[" * 100_000, '{"a":' * 100_000, '{"a": NaN}', "[1, 2]"])
def test_text_that_is_no_object_is_refused(saved: Path, text: str) -> None:
    saved.write_text(text)
    with pytest.raises(EstimatorError, match="not a whole saved soil"):
        SoilEstimator(PRIOR).restore(saved)


def test_a_device_is_not_read(saved: Path) -> None:
    with pytest.raises(EstimatorError, match="a device or a pipe"):
        SoilEstimator(PRIOR).restore("/dev/zero")
    saved.unlink()
    os.mkfifo(saved)
    with pytest.raises(EstimatorError, match="a device or a pipe"):
        SoilEstimator(PRIOR).restore(saved)


@pytest.mark.parametrize("content", [b"precious", b'{"format": "other"}', b"", b"[" * 100_000])
def test_only_a_saved_soil_may_be_replaced(saved: Path, content: bytes) -> None:
    check_may_replace(saved)
    check_may_replace(saved.with_name("new.json"))
    saved.write_bytes(content)
    with pytest.raises(EstimatorError, match="no saved soil, and it is left as it is"):
        check_may_replace(saved)
    link = saved.with_name("link.json")
    link.symlink_to("nowhere")
    with pytest.raises(EstimatorError, match="is left as it is"):
        check_may_replace(link)
