"""Pull, risk and margin against the truth over the worlds of `traction_worlds`."""

from __future__ import annotations

import argparse
import math
from collections import defaultdict
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from robot_worlds import VEHICLES
from traction_worlds import GRAVITY, MASS, WORLDS, TractionDrive, make_drive

from smallwheel_ros.estimator.settings import EstimatorSettings, SoilPrior, usual_strength
from smallwheel_ros.onboard.assessment import Assessor
from smallwheel_ros.onboard.instant import Instant
from smallwheel_ros.onboard.settings import OnboardSettings
from smallwheel_ros.physics.soil import soil
from smallwheel_ros.physics.wheel import Quantity, wheel_slip

Array = NDArray[np.float64]

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
            forces = made.mobility.forces
            if drive.path[i] < settle or forces is None or forces.drawbar_pull is None:
                continue
            out.pull.append(forces.drawbar_pull.value)
            out.deviation.append(forces.drawbar_pull.standard_deviation)
            out.positive.append(forces.probability_drawbar_pull_positive)
            out.true_pull.append(float(drive.pull[i, j]))
            margins.append((forces.margin, float(drive.weighed[i, j])))
        if len(margins) == len(wheels):
            load = sum(w for _, w in margins)
            out.margin.append(sum(m.value * w for m, w in margins) / load)
            out.margin_deviation.append(sum(m.standard_deviation * w for m, w in margins) / load)
            out.true_margin.append(float(drive.true_margin[i]))
    return assessor, out


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
    }


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=6)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--kinds", nargs="*", default=KINDS)
    parser.add_argument("--worlds", nargs="*", default=list(WORLDS))
    given = parser.parse_args()
    found: dict[str, list[Run]] = defaultdict(list)
    for name in given.worlds:
        for seed in range(given.first, given.first + given.seeds):
            drive = make_drive(WORLDS[name], seed)
            for kind in given.kinds:
                one = run(drive, kind)[1]
                found[kind].append(one)
                found[f"{kind} | {name}"].append(one)
    for key, runs in found.items():
        print(key, rates(runs))


if __name__ == "__main__":
    main()
