# SPDX-License-Identifier: Apache-2.0
"""Changes of soil, gross outliers and gaps, on simulated drives."""

from __future__ import annotations

import copy
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks._drives import measurements
from smallwheel_ros.estimator.soil_estimator import (
    EstimatorSettings,
    Outcome,
    Reading,
    SoilEstimator,
    SoilPrior,
)
from smallwheel_ros.physics.soil import soil
from smallwheel_ros.physics.wheel import Wheel
from smallwheel_ros.simulate import Drive, DriveSettings, simulate_drive
from smallwheel_ros.simulate.terrain import Stretch, soil_of_pressure

BORDER = 8.0  # m
FRONT = 0.35  # m, of the front axle before the vehicle's origin
DIAMETER = 0.25  # m


def ground(pressure: float) -> dict[str, object]:
    return {"n": 0.85, "m": 0.35, "pressure": pressure, "friction_angle": 0.54, "cohesion": 600.0}


def drive(seed: int, factor: float, outliers: float = 0.0, distance: float = 13.0) -> Drive:
    """From a dry sand to a soil of `factor` times its modulus."""
    stretches = [Stretch(0.0, soil_of_pressure("first", **ground(19e3)))]
    if factor != 1.0:
        stretches.append(Stretch(BORDER, soil_of_pressure("then", **ground(19e3 * factor))))
    return simulate_drive(
        DriveSettings(seed=seed, distance=distance, stretches=tuple(stretches), outliers=outliers)
    )


def estimator(**settings: float) -> SoilEstimator:
    return SoilEstimator(SoilPrior.from_soil(soil("dry_sand")), EstimatorSettings(**settings))


def follow(e: SoilEstimator, given: list[Reading]) -> list[float]:
    """Where (m) changes of soil were found."""
    return [one.distance for one in given if e.update(one).reason == "soil_changed"]


def modulus_error(e: SoilEstimator, driven: Drive) -> float:
    """Error of ln k D^m at 10 mm at the drive's end."""
    last = driven.stretches[-1].soil
    estimate = e.estimate()
    expected = math.log(last.k * DIAMETER**last.m * 0.01**last.n)
    return estimate.log_reference_pressure + estimate.m * math.log(DIAMETER / 0.2) - expected


def test_nothing_is_determined_wrongly_beyond_a_border() -> None:
    """A stretch that lies on both soils is of neither: used for the new one it made n 0.05 +- 0.1."""
    hard = soil_of_pressure("hard", **{**ground(38e3), "n": 0.75, "m": 0.3})
    soft = soil_of_pressure("soft", **{**ground(9e3), "n": 0.97})
    stretches = (Stretch(0.0, hard), Stretch(BORDER, soft))
    driven = simulate_drive(
        DriveSettings(seed=2, distance=13.0, stretches=stretches, wheels="two_sizes")
    )
    wheels = [
        Wheel(w.name, w.diameter, w.width, lateral_position=w.y, longitudinal_position=w.x)
        for w in driven.rover.wheels
    ]
    prior = replace(SoilPrior.from_soil(soil("dry_sand")), m_std=0.4)
    e = SoilEstimator(prior, EstimatorSettings(sinkage_zero_std=3e-4), wheels=wheels)
    determined = 0
    for one in measurements(driven):
        e.update(one)
        found = e.estimate()
        if one.distance < BORDER + 0.5:
            continue
        deviations = np.sqrt(found.covariance.diagonal())
        for said, value, true, deviation in (
            (found.identifiable.n, found.n, soft.n, deviations[1]),
            (found.identifiable.m, found.m, soft.m, deviations[2]),
        ):
            assert not said or abs(value - true) < 3.0 * deviation, one.distance
            determined += said
    assert e.soil_changes == 1
    assert determined > 100


def check_change(seed: int, factor: float, outliers: float) -> None:
    driven = drive(seed, factor, outliers)
    e = estimator()
    found = follow(e, measurements(driven))
    assert len(found) == 1
    assert 0.0 < found[0] - (BORDER - FRONT) < 1.0
    assert e.soil_changes == 1
    assert abs(modulus_error(e, driven)) < 0.25


@pytest.mark.parametrize(("factor", "outliers"), [(2.0, 0.0), (0.5, 0.02)])
def test_another_soil_is_found_within_a_metre(factor: float, outliers: float) -> None:
    check_change(1, factor, outliers)


def test_a_wheel_that_is_first_measured_behind_the_border_is_on_the_old_soil() -> None:
    driven = drive(1, 2.0)
    wheels = [
        Wheel(w.name, w.diameter, w.width, lateral_position=w.y, longitudinal_position=w.x)
        for w in driven.rover.wheels
    ]
    e = SoilEstimator(SoilPrior.from_soil(soil("dry_sand")), wheels=wheels)
    late = wheels[-1].name
    for one in measurements(driven):
        if one.wheel.name != late:
            e.update(one)
        elif e.soil_changes:
            first = e.update(one)
            break
    assert one.distance + wheels[-1].longitudinal_position < BORDER - FRONT
    size = one.measured[0], one.wheel.diameter, one.wheel.width
    assert first.predicted_sinkage is not None
    assert first.predicted_sinkage == pytest.approx(one.measured[1], rel=0.35)
    assert first.predicted_sinkage > 1.35 * e.predict(*size, wheel=wheels[0].name).sinkage
    assert e.elsewhere(late) == tuple(w.name for w in wheels[:2])


@pytest.mark.slow
@pytest.mark.parametrize("factor", [0.33, 0.5, 2.0, 3.0])
def test_every_change_is_found_once(factor: float) -> None:
    late, extra, off = [], 0, []
    for seed in range(40):
        driven = drive(seed, factor, 0.02)
        e = estimator()
        found = follow(e, measurements(driven))
        extra += len(found) - 1
        late.append(found[0] - (BORDER - FRONT) if found else math.inf)
        off.append(modulus_error(e, driven))
    print(f"factor {factor}: found after {np.percentile(late, [50, 95, 100])} m, {extra} more")
    assert min(late) > 0.0
    assert max(late) < 1.0
    # At the border a wheel on either soil now and then makes it count three times.
    assert extra <= 6
    # 0.12 is aimed at; an rms of 40 drives is known to a ninth of itself, and 0.1205 came with 3.0.
    assert float(np.sqrt(np.mean(np.square(off)))) < 0.135


@pytest.mark.slow
def test_one_soil_is_no_other_soil() -> None:
    """At most one false alarm in 200 m of one soil, with 2 % gross outliers."""
    alarms = []
    for seed in range(10):
        e = estimator()
        alarms.append(len(follow(e, measurements(drive(seed, 1.0, 0.02, 200.0)))))
    print(f"false changes of soil in each of 10 drives of 200 m: {alarms}")
    assert sum(alarms) <= 10


def test_a_soil_met_before_is_taken_up_again() -> None:
    stretches = tuple(
        Stretch(start, soil_of_pressure("s", **ground(19e3 * factor)))
        for start, factor in ((0.0, 1.0), (6.0, 2.5), (9.0, 1.0))
    )
    driven = simulate_drive(DriveSettings(seed=3, distance=12.0, stretches=stretches))
    given = measurements(driven)
    e = estimator()
    found = follow(e, given)
    assert len(found) == 2
    # Back on the first soil, it is known as well as one that was never left.
    stayed = estimator()
    for one in given:
        if one.distance < 5.6:
            stayed.update(one)
    assert e.estimate().log_covariance[1, 1] < stayed.estimate().log_covariance[1, 1]
    assert abs(modulus_error(e, driven)) < 0.2


def single(seed: int, outliers: float) -> tuple[SoilEstimator, Drive]:
    driven = simulate_drive(
        DriveSettings(
            seed=seed, distance=20.0, wheels="two_sizes", terrain="single", outliers=outliers
        )
    )
    e = estimator()
    follow(e, measurements(driven))
    return e, driven


@pytest.mark.slow
def test_outliers_barely_move_the_estimate() -> None:
    errors = {0.0: [], 0.02: []}
    for seed in range(40):
        for share, found in errors.items():
            e, driven = single(seed, share)
            truth, estimate = driven.stretches[0].soil, e.estimate()
            found.append([modulus_error(e, driven), estimate.n - truth.n, estimate.m - truth.m])
    size = {k: np.sqrt(np.mean(np.square(v), axis=0)) for k, v in errors.items()}
    print(f"error with 2 % outliers over that without: {np.round(size[0.02] / size[0.0], 3)}")
    assert np.all(size[0.02] < 1.2 * size[0.0])


def test_gross_outliers_are_left_out() -> None:
    e, driven = single(2, 0.05)
    wild = sum(int(r.outlier.sum()) for r in driven.sinkage.values())
    assert 0.8 * wild < e.outliers < 1.2 * wild
    assert e.soil_changes == 0
    assert abs(modulus_error(e, driven)) < 0.1


# ---- Gaps and standing


def test_a_gap_is_only_a_gap() -> None:
    """No measurement for 5 m: the uncertainty grows by the drift, and the next one fits."""
    given = measurements(drive(5, 1.0, distance=12.0))
    e = estimator()
    follow(e, [one for one in given if one.distance < 4.0])
    before = e.estimate().log_covariance
    rest = [one for one in given if one.distance > 9.0]
    assert e.update(rest[0]).outcome is Outcome.ACCEPTED
    assert follow(e, rest[1:]) == []
    assert e.estimate().log_covariance[0, 0] < 2.0 * before[0, 0]


def test_asking_for_the_estimate_changes_nothing_and_is_never_behind(tmp_path: Path) -> None:
    """What is kept of a soil's law must follow its filter wherever that goes."""
    given = measurements(drive(1, 2.0, outliers=0.02))
    asked, left_alone = estimator(), estimator()
    for i, one in enumerate(given):
        asked.update(one)
        for wheel in (None, one.wheel.name):
            asked.estimate(wheel)
        left_alone.update(one)
        if i % 100 and i > 30:
            continue
        fresh = copy.deepcopy(left_alone)  # never asked before, so nothing of it is kept
        for wheel in (None, one.wheel.name):
            here, there = asked.estimate(wheel), fresh.estimate(wheel)
            assert (here.k, here.n, here.m, here.status) == (
                there.k,
                there.n,
                there.m,
                there.status,
            )
            np.testing.assert_array_equal(here.covariance, there.covariance)
    assert asked.soil_changes == 1
    asked.save(tmp_path / "soil.json")
    other = estimator()
    other.estimate()
    other.restore(tmp_path / "soil.json")
    assert other.estimate().k == pytest.approx(asked.estimate().k, rel=1e-9)
    covariances = [one.estimate().log_covariance for one in (other, asked)]
    np.testing.assert_allclose(*covariances, rtol=1e-6)
    other.reset()
    begin, prior = other.estimate(), estimator().estimate()
    assert (begin.k, begin.n, begin.m, begin.accepted) == (prior.k, prior.n, prior.m, 0)
    assert (begin.log_covariance == prior.log_covariance).all()
