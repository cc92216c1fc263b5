# SPDX-License-Identifier: Apache-2.0
"""How often the pipeline's soils are right on the worlds of `robot_worlds`, beside the estimator's.

    python benchmarks/pipeline_rates.py --worlds 'stuck|bedrock' --seeds 0:4 --jobs 1 --scores out/new.jsonl

The readings of `robot_drives` become one table of `pipeline.tables`, which goes through stretches and
soils; scores and tables are those of `robot_rates`, so that both can be laid side by side.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.robot_drives import RobotDrive, make_drive
from benchmarks.robot_rates import run_worlds, summary, table
from benchmarks.robot_scores import Score, judge
from benchmarks.robot_worlds import VEHICLES, WORLDS
from smallwheel_ros.estimator.identifiability import SoilEstimate
from smallwheel_ros.estimator.reading import Reading
from smallwheel_ros.estimator.settings import EstimatorSettings, SoilPrior, usual_strength
from smallwheel_ros.onboard.settings import OnboardSettings
from smallwheel_ros.physics.soil import REFERENCE_DIAMETER, REFERENCE_SINKAGE
from smallwheel_ros.physics.wheel import Wheel
from smallwheel_ros.pipeline.local_law import Version, law_of
from smallwheel_ros.pipeline.motion import rut_of
from smallwheel_ros.pipeline.soils import Soils
from smallwheel_ros.pipeline.stretches import Loaded, StretchState, stretches
from smallwheel_ros.pipeline.tables import Array, Readings


def table_of(**columns: Any) -> Readings:
    """A table of these columns; of all others nothing is known."""
    none = np.full(len(columns["stamp"]), math.nan)
    return Readings(**({field.name: none for field in fields(Readings)} | columns))


def rows_of(readings: Sequence[Reading], wheels: tuple[Wheel, ...]) -> Readings:
    """The table of a list of readings that are sorted by stamp."""
    names = [wheel.name for wheel in wheels]
    number = np.array([names.index(r.wheel.name) for r in readings])

    def value(name: str, part: str = "value") -> Array:
        given = [getattr(r, name) for r in readings]
        return np.array([math.nan if g is None else getattr(g, part) for g in given])

    def plain(name: str) -> Array:
        given = [getattr(r, name) for r in readings]
        return np.array([math.nan if g is None else g for g in given], dtype=float)

    onward = np.array([r.onward for r in readings])
    passes, doubt = rut_of(wheels, number, onward, np.full(len(readings), math.nan))  # no places
    std = "standard_deviation"
    return table_of(
        stamp=np.array([r.stamp for r in readings]), wheel=number, sinkage=value("sinkage"),
        sinkage_std=value("sinkage", std), load=value("load"), load_std=value("load", std),
        vehicle_speed=plain("speed"), speed=plain("speed"), speed_std=plain("speed_std"),
        rim_speed=plain("rim_speed"), rim_std=plain("rim_std"), slip=value("slip"),
        slip_std=value("slip", std), stands=np.array([r.stands for r in readings]),
        forward=np.array([r.forward for r in readings]), slope=plain("slope_force"),
        gained=plain("gained_force"), torque=plain("torque"), pull=value("drawbar_pull"),
        pitch=plain("pitch"), distance=plain("distance"),
        path=plain("path"), onward=onward, passes=passes, pass_doubt=doubt,
        due=np.ones(len(readings), dtype=bool),
    )  # fmt: skip


def estimate_of(version: Version, prior: SoilPrior, distance: float) -> SoilEstimate:
    """A version of the law in the terms of the field, at the soil's reference."""
    mean, covariance = law_of(version)
    pressure, n, m = mean.tolist()
    log_k = pressure - n * math.log(REFERENCE_SINKAGE) - m * math.log(REFERENCE_DIAMETER)
    return SoilEstimate(
        math.exp(log_k), n, m, pressure, covariance, prior.law[1], REFERENCE_SINKAGE, REFERENCE_DIAMETER,
        version.variety, version.accepted, 0, 0, distance, settled=version.settled,
    )  # fmt: skip


def run(drive: RobotDrive) -> tuple[Soils, Score]:
    """Let the pipeline's soils drive, and score them."""
    world, wheels = drive.world, VEHICLES[drive.world.vehicle]
    estimator = EstimatorSettings(sinkage_zero_std=world.zero_std)
    strength = usual_strength(drive.prior.soil)
    settings = OnboardSettings(wheels, drive.prior, strength, estimator=estimator)
    soils, state = Soils(drive.prior, estimator, (), wheels), StretchState.of(settings)
    rows = rows_of(drive.readings, wheels)
    closed, loads = stretches(state, rows, settings)
    assert closed is not None
    stamps = soils.take(closed)
    version = soils.version_of(rows, 0, stamps)[0]
    asked = Loaded(
        rows.wheel, loads.load, (loads.load_std / loads.load) ** 2, np.zeros(len(rows)), rows.slip,
        rows.speed, rows.passes, rows.pass_doubt,
    )  # fmt: skip
    expected, variance = soils.sinkage(asked, version)
    said = np.isfinite(expected)
    held = np.abs(expected - drive.sinkage)[said] <= 1.96 * np.sqrt(variance[said])
    score = Score(world.name, 0, held=float(held.mean()), changes=soils.changes)
    newest = np.searchsorted(stamps, rows.stamp)
    for place in range(1, len(drive.at)):
        over = np.flatnonzero(rows.distance >= drive.at[place])
        number = int(newest[over[0]]) if over.size else len(soils.versions) - 1
        at = float(drive.at[place])
        judge(estimate_of(soils.versions[number], drive.prior, at), drive, place, score)
    last = estimate_of(soils.versions[-1], drive.prior, float(drive.at[-1]))
    judge(last, drive, len(drive.at) - 1, score)
    borders = [soils.versions[i].border for i in range(len(soils.versions))]
    met = np.array(borders)[newest] > -math.inf
    if drive.border is not None and met.any():
        score.found = float(rows.distance[met][0]) - drive.border
    return soils, score


def drive_and_score(task: tuple[str, int]) -> Score:
    """Make and run one drive."""
    name, seed = task
    _, score = run(make_drive(WORLDS[name], seed))
    score.seed = seed
    return score


def main() -> None:
    """Run the worlds and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    _, worlds, scores = run_worlds(parser, WORLDS, Score, drive_and_score)
    print("\n".join([*summary(scores), "", *table(scores, worlds)]))


if __name__ == "__main__":
    main()
