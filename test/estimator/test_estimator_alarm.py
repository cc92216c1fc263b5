# SPDX-License-Identifier: Apache-2.0
"""The alarm that an effect is missing, on drives whose truth has it in another form."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from test_law_filter import SEGMENT
from test_segment import segments

from benchmarks._drives import measurements
from benchmarks._innovations import innovations_picture
from benchmarks.missing_effect import both
from smallwheel_ros.effects.slip import Exponential
from smallwheel_ros.estimator.missing_effect import MissingEffectWatch, SegmentChanges, robust_fit
from smallwheel_ros.estimator.soil_estimator import MissingEffect, SoilEstimator, SoilPrior
from smallwheel_ros.physics.soil import soil
from smallwheel_ros.simulate import DriveSettings, simulate_drive

TERRAINS = ["mixed", pytest.param("single", marks=pytest.mark.slow)]


def alarms(
    seed: int, hidden: tuple[str, ...], distance: float, terrain: str
) -> list[MissingEffect]:
    """Every alarm of a drive, each once."""
    drive = simulate_drive(
        DriveSettings(seed=seed, distance=distance, terrain=terrain, hidden=hidden, outliers=0.02)
    )
    e = SoilEstimator(SoilPrior.from_soil(soil("dry_sand")))
    found: dict[str, MissingEffect] = {}
    for one in measurements(drive):
        e.update(one)
        if e.missing_effect is not None:
            found.setdefault(e.missing_effect.effect, e.missing_effect)
    return list(found.values())


@pytest.mark.parametrize("terrain", TERRAINS)
def test_hidden_slip_sinkage_is_named(terrain: str) -> None:
    found = alarms(3, ("slip_sinkage",), 20.0, terrain)
    assert [one.effect for one in found] == ["slip_sinkage"]
    assert found[0].rivals == ()
    assert found[0].follows == "slip"
    assert "follows slip: slip_sinkage fits" in found[0].message


@pytest.mark.parametrize("terrain", TERRAINS)
def test_without_a_hidden_effect_it_is_quiet(terrain: str) -> None:
    assert alarms(3, (), 25.0, terrain) == []


@pytest.mark.slow
@pytest.mark.parametrize("terrain", ["single", "mixed"])
def test_hidden_slip_sinkage_is_named_within_30_m(terrain: str) -> None:
    places, wrong, drives = [], 0, 40
    for seed in range(drives):
        found = alarms(seed, ("slip_sinkage",), 30.0, terrain)
        places += [one.distance for one in found if one.effect == "slip_sinkage" and not one.rivals]
        wrong += any(one.effect != "slip_sinkage" for one in found)
    print(
        f"{terrain}: named in {len(places)} of {drives} drives, after "
        f"{np.percentile(places, [50, 90, 100])} m; another name in {wrong}"
    )
    assert len(places) >= 0.9 * drives
    assert wrong <= 0.02 * drives


@pytest.mark.slow
@pytest.mark.parametrize("terrain", ["single", "mixed"])
def test_200_m_without_a_hidden_effect_are_quiet(terrain: str) -> None:
    found = [alarms(seed, (), 200.0, terrain) for seed in range(25)]
    print(f"{terrain}: alarms {[[one.effect for one in drive] for drive in found]}")
    assert sum(map(bool, found)) <= 0.02 * 50


def test_the_effect_added_the_same_drive_is_quiet_and_as_expected(tmp_path: Path) -> None:
    first, before, second, after = both(3, 16.0)
    assert first.missing_effect is not None
    assert second.missing_effect is None
    assert after.alarm is None
    # Readings on one stretch have the soil's texture in common: white they are not even then.
    assert before.correlation[0][0] > after.correlation[0][0]
    squares = [np.mean(one.normalised[one.accepted] ** 2) for one in (before, after)]
    assert squares[1] < squares[0]
    assert second.soil_changes <= first.soil_changes
    innovations_picture(before, after).savefig(tmp_path / "picture.png")
    assert (tmp_path / "picture.png").stat().st_size > 20_000


# ---- Parts


def test_robust_fit_lets_a_few_great_errors_be() -> None:
    rng = np.random.default_rng(1)
    columns = rng.standard_normal((400, 2))
    y = columns @ [0.5, -1.0] + 0.1 * rng.standard_normal(400)
    y[:20] += 5.0
    fit = robust_fit(y, columns)
    np.testing.assert_allclose(fit.coefficients, [0.5, -1.0], atol=0.02)
    assert fit.scale < 0.15
    # One column more than there is reason for gains what chance gives.
    more = robust_fit(y, np.column_stack([columns, rng.standard_normal(400)]), np.zeros(3))
    assert -0.01 < 2 * (more.log_likelihood - fit.log_likelihood) < 12
    assert robust_fit(y, np.zeros((400, 0))).coefficients.size == 0


def test_changes_are_of_neighbours_and_gaps_part_them() -> None:
    made = SegmentChanges(0.2, 40.0)
    assert made.changes() is None
    for i in range(100):
        at = 0.2 * i + (5.0 if i >= 50 else 0.0)
        for wheel, sinkage in (("a", 0.01), ("b", 0.02)):
            one = replace(SEGMENT, wheel=wheel, distance=at, sinkage=sinkage, speed=None)
            made.add(one)
    changes = made.changes()
    assert changes is not None
    # Of one wheel only; over the gap the soil may be any other.
    assert changes.later.size == 2 * 98
    np.testing.assert_allclose(changes.of(changes.log_sinkage), 0.0, atol=1e-12)
    assert np.isnan(changes.wheels["speed"]).all()
    assert np.all(changes.wheels["slip"] == 0.2)


def test_a_segment_without_measurable_sinkage_has_no_logarithm() -> None:
    made = SegmentChanges(0.2, 40.0)
    for sinkage in (0.01, -0.001, 1e-5, 0.01):
        made.add(replace(SEGMENT, sinkage=sinkage))
    changes = made.changes()
    assert changes is not None
    assert changes.log_sinkage.size == 2


def test_old_segments_are_forgotten() -> None:
    made = SegmentChanges(0.2, 40.0)
    for i in range(10_000):
        made.add(replace(SEGMENT, distance=0.2 * i))
    changes = made.changes()
    assert changes is not None
    assert changes.log_sinkage.size <= 202


def test_what_cannot_be_tested_says_why() -> None:
    drive = simulate_drive(DriveSettings(seed=1, distance=12.0, terrain="single"))
    e = SoilEstimator(SoilPrior.from_soil(soil("dry_sand")))
    for one in measurements(drive):
        e.update(one._replace(slip=None))
    reasons = {score.effect: score.reason for score in e.effect_scores}
    assert reasons["slip_sinkage"] == "slip is not known"
    assert reasons["moisture"] == "moisture is not known"
    assert reasons["load_dependent_modulus"]


def test_an_effect_of_the_model_is_not_looked_for() -> None:
    watch = MissingEffectWatch((Exponential(a=1.0),), 0.2)
    drive = simulate_drive(DriveSettings(seed=1, distance=12.0, terrain="single"))
    given, found = measurements(drive), []
    for wheel in drive.rover.wheels:
        found += segments([one for one in given if one.wheel.name == wheel.name])
    for segment in sorted(found, key=lambda one: one.distance):
        if watch.add(segment):
            watch.test(soil("dry_sand"), (1.6e6, 0.8, 0.39), segment.distance)
    assert watch.scores
    assert "slip_sinkage" not in {score.effect for score in watch.scores}
