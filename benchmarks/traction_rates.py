# SPDX-License-Identifier: Apache-2.0
"""Pull, margin, cost and warnings against the truth over the worlds of `traction_worlds`."""

from __future__ import annotations

import argparse
import math
from collections import defaultdict
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from robot_worlds import VEHICLES
from traction_worlds import GRAVITY, MASS, REFERENCE_SLIP, WORLDS, TractionDrive, make_drive

from smallwheel_ros.costmap.cost import CostRules
from smallwheel_ros.estimator.settings import EstimatorSettings, SoilPrior, usual_strength
from smallwheel_ros.onboard.assessment import Assessor
from smallwheel_ros.onboard.instant import Instant
from smallwheel_ros.onboard.settings import OnboardSettings
from smallwheel_ros.physics.soil import soil
from smallwheel_ros.physics.wheel import Quantity, wheel_slip

Array = NDArray[np.float64]

_PAUSE, _EPISODE = 0.3, 0.5  # m
KINDS = ("nothing", "balance", "torque", "balance and torque", "pull sensor")


@dataclass
class Run:
    """Stated and true values; arrays over (time, wheels), and of the vehicle over time."""

    pull: list[float] = field(default_factory=list)
    deviation: list[float] = field(default_factory=list)
    positive: list[float] = field(default_factory=list)
    true_pull: list[float] = field(default_factory=list)
    margin: list[float] = field(default_factory=list)
    margin_deviation: list[float] = field(default_factory=list)
    true_margin: list[float] = field(default_factory=list)
    ahead: float | None = None  # m before it was stuck, that it was warned of without a pause
    false: int = 0  # warnings on ground where it came nowhere near
    needless: int = 0  # warnings after which it did not even come to the reference slip
    length: float = 0.0  # m


def run(drive: TractionDrive, kind: str, settle: float = 2.0) -> tuple[Assessor, Run]:
    """Let the pipeline's estimators drive. settle: m, before which nothing is scored."""
    base, wheels = soil("dry_sand"), VEHICLES[drive.world.vehicle]
    settings = OnboardSettings(
        wheels,
        SoilPrior.from_soil(base),
        usual_strength(base),
        estimator=EstimatorSettings(sinkage_zero_std=1e-3),
        mass=MASS if "balance" in kind else 0.0,
    )
    assessor, out = Assessor(settings), Run()
    warned = np.zeros(len(drive.time), dtype=bool)
    speed = np.convolve(np.pad(drive.odometry, 2, mode="edge"), np.ones(5) / 5, mode="valid")
    acceleration = np.gradient(speed, drive.time)
    for i, time in enumerate(drive.time):
        margins = []
        for j, wheel in enumerate(wheels):
            slip = wheel_slip(
                Quantity(float(drive.odometry[i]), 0.01),
                Quantity(float(drive.rim[i, j]), 0.01 * float(drive.rim[i, j])),
                0.01,
            )
            force = GRAVITY * math.sin(-drive.pitch[i]) + acceleration[i]
            made = assessor.assess(
                Instant(
                    wheel,
                    int(1e9 * time) + j,
                    Quantity(float(drive.weighed[i, j]), 1.2),
                    slip,
                    Quantity(float(drive.shown_sinkage[i, j]), 1e-3),
                    float(drive.odometry[i]),
                    float(drive.path[i]),
                    float(drive.path[i]),
                    pitch=float(drive.pitch[i]),
                    specific_force=float(force) if "balance" in kind else None,
                    torque=float(drive.torque[i, j]) if "torque" in kind else None,
                    drawbar_pull=Quantity(float(drive.pulled[i, j]), 0.6)
                    if kind == "pull sensor"
                    else None,
                )
            )
            forces = made.forces
            if drive.path[i] < settle or forces is None or forces.drawbar_pull is None:
                continue
            out.pull.append(forces.drawbar_pull.value)
            out.deviation.append(forces.drawbar_pull.standard_deviation)
            out.positive.append(forces.probability_drawbar_pull_positive)
            out.true_pull.append(float(drive.pull[i, j]))
            margins.append((forces.margin, float(drive.weighed[i, j])))
        warned[i] = bool(assessor.stuck.warning) and drive.path[i] >= settle
        if len(margins) == len(wheels):
            load = sum(w for _, w in margins)
            out.margin.append(sum(m.value * w for m, w in margins) / load)
            out.margin_deviation.append(sum(m.standard_deviation * w for m, w in margins) / load)
            out.true_margin.append(float(drive.true_margin[i]))
    _score_warnings(drive, warned, out)
    return assessor, out


def _score_warnings(drive: TractionDrive, warned: NDArray[np.bool_], out: Run) -> None:
    """How far ahead the last warning began; and those that were false.

    False: from half a metre before to two metres after it no slip over 0.3, and no place with a true
    reserve under 0.03. Stricter: no slip over 0.4.
    """
    path = drive.path
    out.length, begin = float(path[-1]), float(path[-1])
    if drive.stuck:
        for place, on in zip(path[::-1], warned[::-1], strict=True):
            if on:
                begin = float(place)
            elif begin - place > _PAUSE:
                break
        out.ahead = out.length - begin
    last = -math.inf
    for place, on in zip(path, warned, strict=True):
        if on and place - last > _EPISODE and place < begin:
            near = (path > place - 0.5) & (path < place + 2.0)
            out.false += bool(drive.slip[near].max() < 0.3 and drive.reserve[near].min() > 0.03)
            out.needless += bool(drive.slip[near].max() < REFERENCE_SLIP)
        if on:
            last = place


def rates(runs: list[Run]) -> dict[str, object]:
    """Rms, coverage, Brier score and reliability in fifths."""

    def all_of(name: str) -> Array:
        return np.concatenate([getattr(one, name) for one in runs])

    off = all_of("pull") - all_of("true_pull")
    stated, came = all_of("positive"), all_of("true_pull") > 0
    fifths = []
    for low in (0.0, 0.2, 0.4, 0.6, 0.8):
        inside = (stated >= low) & (stated <= low + 0.2)
        if inside.sum() > 30:
            fifths.append(f"{stated[inside].mean():.2f}:{came[inside].mean():.2f}({inside.sum()})")
    short = all_of("margin") - all_of("true_margin")
    cost, stuck = CostRules().cost(all_of("margin"), all_of("margin_deviation")), []
    lost = all_of("true_margin") < 0.0
    for low in range(0, 100, 20):
        inside = (cost >= low) & (cost < low + 20 + (low == 80))
        if inside.sum() > 30:
            stuck.append(
                f"{cost[inside].mean():.0f}:{100 * lost[inside].mean():.0f}({inside.sum()})"
            )
    ahead = sorted(round(one.ahead, 2) for one in runs if one.ahead is not None)
    return {
        "pull rms": round(float(np.sqrt(np.mean(off**2))), 2),
        "held": round(float(np.mean(np.abs(off) < 1.96 * all_of("deviation"))), 3),
        "sd": round(float(np.mean(all_of("deviation"))), 2),
        "Brier": round(float(np.mean((stated - came) ** 2)), 3),
        "margin rms": round(float(np.sqrt(np.mean(short**2))), 3),
        "margin bias": round(float(np.mean(short)), 3),
        "margin held": round(float(np.mean(np.abs(short) < 1.96 * all_of("margin_deviation"))), 3),
        "margin sd": round(float(np.mean(all_of("margin_deviation"))), 3),
        "fifths": " ".join(fifths),
        "cost": " ".join(stuck),
        "warned ahead": ahead,
        "needless warnings": sum(one.needless for one in runs),
        "false warnings": f"{sum(one.false for one in runs)} in {sum(one.length for one in runs):.0f} m",
    }


def _drives(job: tuple[str, int, tuple[str, ...]]) -> list[Run]:
    name, seed, kinds = job
    drive = make_drive(WORLDS[name], seed)
    return [run(drive, kind)[1] for kind in kinds]


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=6)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--kinds", nargs="*", default=KINDS)
    parser.add_argument("--worlds", nargs="*", default=list(WORLDS))
    given = parser.parse_args()
    found: dict[str, list[Run]] = defaultdict(list)
    jobs = [
        (name, seed, tuple(given.kinds))
        for name in given.worlds
        for seed in range(given.first, given.first + given.seeds)
    ]
    with ProcessPoolExecutor() as pool:
        for (name, _, kinds), runs in zip(jobs, pool.map(_drives, jobs), strict=True):
            for kind, one in zip(kinds, runs, strict=True):
                found[kind].append(one)
                found[f"{kind} | {name}"].append(one)
    for key, runs in found.items():
        print(key, rates(runs))


if __name__ == "__main__":
    main()
