# SPDX-License-Identifier: Apache-2.0
"""How right the pipeline's soils are on a drive of `robot_drives`: at every place of it, not only at its end.

The rows of a drive go through stretches and soils, the stages that the law is found in.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from benchmarks.robot_drives import RobotDrive, make_drive
from benchmarks.robot_worlds import VEHICLES, WORLDS
from smallwheel_ros.onboard.prior import EstimatorSettings
from smallwheel_ros.onboard.settings import OnboardSettings
from smallwheel_ros.physics.soil import REFERENCE_DIAMETER, usual_strength
from smallwheel_ros.pipeline.identifiability import SoilEstimate
from smallwheel_ros.pipeline.local_law import Reported, law_of
from smallwheel_ros.pipeline.soils import Soils
from smallwheel_ros.pipeline.stretches import Loaded, StretchState, stretches

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

    def as_dict(self) -> dict[str, Any]:
        """For a file."""
        return asdict(self)


def run(drive: RobotDrive) -> tuple[Soils, Score]:
    """Let the pipeline's soils drive, and score them."""
    world, wheels, rows = drive.world, VEHICLES[drive.world.vehicle], drive.rows
    estimator = EstimatorSettings(sinkage_zero_std=world.zero_std)
    strength = usual_strength(drive.prior.soil)
    settings = OnboardSettings(wheels, drive.prior, strength, estimator=estimator)
    soils, state = Soils(drive.prior, estimator, (), wheels), StretchState.of(settings)
    closed, loads = stretches(state, rows, settings)
    assert closed is not None
    stamps = soils.take(closed)
    version, newest = soils.version_of(rows, 0, stamps)
    asked = Loaded(
        rows.wheel, loads.load, (loads.load_std / loads.load) ** 2, np.zeros(len(rows)), rows.slip,
        rows.speed, rows.passes, rows.pass_doubt,
    )  # fmt: skip
    expected, variance = soils.sinkage(asked, version)
    said = np.isfinite(expected)
    held = np.abs(expected - drive.sinkage)[said] <= 1.96 * np.sqrt(variance[said])
    score = Score(world.name, 0, held=float(held.mean()), changes=soils.changes)
    reported = Reported(drive.prior, settings.mean_diameter)
    for place in range(1, len(drive.at)):
        over = np.flatnonzero(rows.distance >= drive.at[place])
        number = int(newest[over[0]]) if over.size else len(soils.versions) - 1
        judge(reported.estimate(soils.versions[number]), drive, place, score)
    judge(reported.estimate(soils.versions[-1]), drive, len(drive.at) - 1, score)
    borders = [soils.versions[i].border for i in range(len(soils.versions))]
    met = np.array(borders)[newest] > -math.inf
    if drive.border is not None and met.any():
        score.found = float(rows.distance[met][0]) - drive.border
    alarm = soils.watch.alarm
    score.effect = "" if alarm is None else alarm.effect
    return soils, score


def judge(estimate: SoilEstimate, drive: RobotDrive, place: int, score: Score) -> None:
    """Compare what is believed with the soils that may be believed in there."""
    pressure, n, log_modulus = drive.soils[place]  # at the soils' reference diameter
    across = drive.m * math.log(estimate.reference_diameter / REFERENCE_DIAMETER)
    pressure, log_modulus = pressure + across, log_modulus + across
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
    soils, score = run(drive)
    found, covariance = law_of(soils.versions[-1])
    error = found - np.array([*drive.soils[-1, :2, 0], drive.m])
    return float(error @ np.linalg.solve(covariance, error)) / 3.0, score.held
