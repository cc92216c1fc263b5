# SPDX-License-Identifier: Apache-2.0
"""How right the estimator is on a drive of `robot_drives`: at every place of it, not only at its end."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from benchmarks.robot_drives import RobotDrive, make_drive
from benchmarks.robot_worlds import VEHICLES, WORLDS
from smallwheel_ros.estimator.soil_estimator import (
    EstimatorSettings,
    SoilEstimate,
    SoilEstimator,
)

NAMES = ("reference_pressure", "n", "m", "effective_modulus")
SIGMAS = 3.0  # a parameter that is said to be determined is wrong beyond so many deviations


@dataclass
class Score:
    """What came of a drive.

    judged: every 0.1 m, how often each parameter was said to be determined; wrong: how often it was
    over 3 deviations off then; worst: the most deviations, and where (m). determined, error,
    deviation: at the end. held: share of readings whose true sinkage was inside the 95 % band.
    found: m after the first border.
    """

    world: str
    seed: int
    judged: dict[str, int] = field(default_factory=lambda: dict.fromkeys(NAMES, 0))
    wrong: dict[str, int] = field(default_factory=dict)
    worst: dict[str, tuple[float, float]] = field(default_factory=dict)
    determined: dict[str, bool] = field(default_factory=dict)
    error: dict[str, float] = field(default_factory=dict)
    deviation: dict[str, float] = field(default_factory=dict)
    held: float = math.nan
    changes: int = 0
    found: float = math.nan
    effect: str = ""
    findings: tuple[str, ...] = ()

    def as_dict(self) -> dict[str, Any]:
        """For a file."""
        return asdict(self)


def run(drive: RobotDrive) -> tuple[SoilEstimator, Score]:
    """Let the estimator drive, and score it."""
    world = drive.world
    settings = EstimatorSettings(sinkage_zero_std=world.zero_std)
    estimator = SoilEstimator(drive.prior, settings, wheels=VEHICLES[world.vehicle])
    score = Score(world.name, 0)
    held: list[bool] = []
    place = 0
    for reading, true in zip(drive.readings, drive.sinkage, strict=True):
        while place + 1 < len(drive.at) and reading.distance >= drive.at[place + 1]:
            place += 1
            judge(estimator.estimate(), drive, place, score)
        result = estimator.update(reading)
        if result.predicted_sinkage is not None and result.predicted_variance is not None:
            off = abs(result.predicted_sinkage - true)
            held.append(bool(off <= 1.96 * math.sqrt(result.predicted_variance)))
        if drive.border is not None and math.isnan(score.found) and estimator.soil_changes:
            score.found = reading.distance - drive.border
    judge(estimator.estimate(), drive, len(drive.at) - 1, score)
    score.held = float(np.mean(held))
    score.changes = estimator.soil_changes
    score.findings = estimator.findings
    alarm = estimator.missing_effect
    score.effect = "" if alarm is None else alarm.effect
    return estimator, score


def judge(estimate: SoilEstimate, drive: RobotDrive, place: int, score: Score) -> None:
    """Compare what is believed with the soils that may be believed in there."""
    pressure, n, log_modulus = drive.soils[place]
    modulus, deviation = estimate.effective_modulus()  # at the diameter that the pressure is of
    covariance = estimate.log_covariance
    values = {
        "reference_pressure": (estimate.log_reference_pressure, pressure, covariance[0, 0]),
        "n": (estimate.n, n, covariance[1, 1]),
        "m": (estimate.m, (drive.m, drive.m), covariance[2, 2]),
        "effective_modulus": (math.log(modulus), log_modulus, (deviation / modulus) ** 2),
    }
    for name, (value, (least, most), variance) in values.items():
        error = float(min(value - least, 0.0) + max(value - most, 0.0))
        std = math.sqrt(variance)
        determined = bool(getattr(estimate.identifiable, name))
        score.error[name], score.deviation[name] = error, std
        score.determined[name] = determined
        if not determined:
            continue
        score.judged[name] += 1
        sigmas = abs(error) / std
        if sigmas > SIGMAS:
            score.wrong[name] = score.wrong.get(name, 0) + 1
        if sigmas > score.worst.get(name, (0.0, 0.0))[0]:
            score.worst[name] = sigmas, float(drive.at[place])


def error_and_held(task: tuple[str, int]) -> tuple[float, float]:
    """Of a drive of 12 m, given as world and seed, how far off the law is, and the share of sinkages held.

    The former is the normalised error squared of (ln pressure, n, m) over its expectation.
    """
    name, seed = task
    drive = make_drive(replace(WORLDS[name], distance=12.0), seed)
    estimator, score = run(drive)
    estimate = estimator.estimate()
    found = np.array([estimate.log_reference_pressure, estimate.n, estimate.m])
    error = found - np.array([*drive.soils[-1, :2, 0], drive.m])
    return float(error @ np.linalg.solve(estimate.log_covariance, error)) / 3.0, score.held
