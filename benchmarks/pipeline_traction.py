# SPDX-License-Identifier: Apache-2.0
"""Pull and margin of the pipeline against the truth over drives of `traction_worlds`, beside today's node.

python benchmarks/pipeline_traction.py --worlds 'plain|patch' --seeds 0:2 --kind balance
"""

from __future__ import annotations

import argparse
import re
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.pipeline_rates import table_of
from benchmarks.traction_rates import SETTLE, settings_of
from benchmarks.traction_rates import run as run_of_today
from benchmarks.traction_worlds import GRAVITY, MASS, WORLDS, TractionDrive, make_drive
from smallwheel_ros.onboard.settings import OnboardSettings
from smallwheel_ros.pipeline.align import slip_of
from smallwheel_ros.pipeline.mobility import mobility
from smallwheel_ros.pipeline.motion import rut_of
from smallwheel_ros.pipeline.soils import Soils
from smallwheel_ros.pipeline.steps import StepState, steps
from smallwheel_ros.pipeline.strength import Strengths
from smallwheel_ros.pipeline.stretches import StretchState, stretches
from smallwheel_ros.pipeline.tables import Array, Estimates, Readings


def rows_of(drive: TractionDrive, settings: OnboardSettings, kind: str) -> Readings:
    """The table of a drive, a row for each wheel and instant."""
    times, wheels = drive.rim.shape
    speed = np.convolve(np.pad(drive.odometry, 2, mode="edge"), np.ones(5) / 5, mode="valid")
    gained = np.gradient(speed, drive.time)
    count = times * wheels
    yes, none = np.ones(count, dtype=bool), np.full(count, np.nan)
    wheel = np.tile(np.arange(wheels), times)

    def each(column: Array) -> Array:
        return np.repeat(column, wheels)

    travel, rim = each(drive.odometry), drive.rim.ravel()
    std = np.full(count, 0.01)
    slip, slip_std, _ = slip_of(travel, std, rim, 0.01 * rim, 0.01)
    passes, doubt = rut_of(settings.wheels, wheel, yes, none)  # these drives tell no places
    return table_of(
        stamp=(each(1e9 * drive.time) + wheel).astype(np.int64), wheel=wheel,
        sinkage=drive.shown_sinkage.ravel(), sinkage_std=np.full(count, 1e-3),
        load=drive.weighed.ravel(), load_std=np.full(count, 1.2), vehicle_speed=travel, speed=travel,
        speed_std=std, rim_speed=rim, rim_std=0.01 * rim, slip=slip, slip_std=slip_std, stands=~yes,
        forward=yes, slope=each(GRAVITY * np.sin(-drive.pitch)) if "balance" in kind else none,
        gained=each(gained), torque=drive.torque.ravel() if "torque" in kind else none,
        pull=drive.pulled.ravel() if kind == "pull sensor" else none, pitch=each(drive.pitch),
        distance=each(drive.path), path=each(drive.path), onward=yes, passes=passes, pass_doubt=doubt,
        due=yes,
    )  # fmt: skip


def estimates_of(rows: Readings, settings: OnboardSettings) -> Estimates:
    """Estimates of all rows, through every stage behind motion."""
    soils = Soils(
        settings.prior, settings.estimator, settings.effects, settings.wheels, settings.mass
    )
    rolling = np.arange(len(settings.wheels))
    strengths = Strengths(settings.strength, settings.wheels, rolling, settings.mass)
    closed, loads = stretches(StretchState.of(settings), rows, settings)
    stamps = np.empty(0, dtype=np.int64) if closed is None else soils.take(closed)
    law = soils.version_of(rows, 0, stamps)[0]
    made = steps(StepState(), rows, loads.load, loads.load_std, law, soils, settings)
    ends = np.empty(0, dtype=np.int64) if made is None else strengths.take(made)
    believed = np.searchsorted(ends, rows.stamp)
    return mobility(rows, loads.load, loads.load_std, law, believed, soils, strengths, settings)


def run(drive: TractionDrive, kind: str) -> dict[str, float]:
    """Errors of pull (N) and of the vehicle's margin, and shares in their 95 % bands."""
    settings = settings_of(drive.world.vehicle, MASS if "balance" in kind else 0.0)
    rows = rows_of(drive, settings, kind)
    found = estimates_of(rows, settings)
    shape = drive.rim.shape
    late = drive.path >= SETTLE
    pull, std, margin, margin_std = (
        getattr(found, name).reshape(shape)[late]
        for name in ("drawbar_pull", "drawbar_pull_std", "margin", "margin_std")
    )
    weight = drive.weighed[late] / drive.weighed[late].sum(axis=1, keepdims=True)
    off = pull - drive.pull[late]
    of_all = (margin * weight).sum(axis=1) - drive.true_margin[late]
    band = 1.96 * (margin_std * weight).sum(axis=1)
    return {
        "pull": float(np.sqrt(np.mean(off**2))),
        "pull_band": float((np.abs(off) <= 1.96 * std).mean()),
        "margin": float(np.sqrt(np.mean(of_all**2))),
        "margin_band": float((np.abs(of_all) <= band).mean()),
    }


def today(drive: TractionDrive, kind: str) -> dict[str, float]:
    """The same of today's node."""
    _, out = run_of_today(drive, kind)
    off, margin = np.subtract(out.pull, out.true_pull), np.subtract(out.margin, out.true_margin)
    return {
        "pull": float(np.sqrt(np.mean(off**2))),
        "pull_band": float((np.abs(off) <= 1.96 * np.array(out.deviation)).mean()),
        "margin": float(np.sqrt(np.mean(margin**2))),
        "margin_band": float((np.abs(margin) <= 1.96 * np.array(out.margin_deviation)).mean()),
    }


def main() -> None:
    """Print a line a drive: the pipeline, then today's node."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--worlds", default="", help="regular expression; all without it")
    parser.add_argument("--seeds", default="0:1", help="first and end")
    parser.add_argument("--kind", default="balance and torque")
    given = parser.parse_args()
    first, end = (int(part) for part in given.seeds.split(":"))
    for name in (n for n in WORLDS if re.search(given.worlds, n)):
        for seed in range(first, end):
            drive = make_drive(WORLDS[name], seed)
            for who, way in (("pipeline", run), ("today", today)):
                begun = time.process_time()
                score = way(drive, given.kind)
                took = time.process_time() - begun
                numbers = "  ".join(f"{key} {value:.3f}" for key, value in score.items())
                print(f"{name:24} {seed} {who:9} {numbers}  {took:.1f} s", flush=True)


if __name__ == "__main__":
    main()
