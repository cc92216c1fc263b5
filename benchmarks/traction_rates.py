# SPDX-License-Identifier: Apache-2.0
"""Pull, margin and warnings against the truth over the worlds of `traction_worlds`.

    python benchmarks/traction_rates.py drive --first 100 --seeds 8 -o a.jsonl   # small samples, in parallel
    python benchmarks/traction_rates.py known --first 100 --seeds 8   # warnings by the true reserve itself
    python benchmarks/traction_rates.py table a.jsonl b.jsonl --picture docs/images/reliability.png

A simulated drive is given to the pipeline's estimators, without ROS: one drive a seed, with its own soil,
in the worlds in turn. One line a drive and kind of sensors goes to the file: sums, so that samples add up.
Intervals (95 %) of the table are of the bootstrap over seeds, since readings of one drive are not
independent.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks._traction_table import AHEAD, KINDS, Row, draw, in_words, table
from benchmarks.robot_worlds import VEHICLES
from benchmarks.traction_worlds import GRAVITY, MASS, WORLDS, TractionDrive, make_drive
from smallwheel_ros.estimator.reading import Reading
from smallwheel_ros.estimator.settings import EstimatorSettings, SoilPrior, usual_strength
from smallwheel_ros.onboard.onboard import Onboard
from smallwheel_ros.onboard.settings import OnboardSettings
from smallwheel_ros.physics.soil import soil
from smallwheel_ros.physics.wheel import Quantity, wheel_slip

Array = NDArray[np.float64]

_PAUSE, _EPISODE, _WITHIN = 0.3, 0.5, 1.0  # m
SETTLE = 2.0  # m, before which nothing is scored


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
    wheel_margins: int = 0  # of single wheels, and how many were in their band
    wheel_margins_inside: int = 0
    risk: list[float] = field(default_factory=list)
    too_steep: list[bool] = field(
        default_factory=list
    )  # within a metre it needs more than its margin
    ahead: float | None = None  # m before it was stuck, that it was warned of without a pause
    # Of each warning that nothing came of: the least true reserve near it.
    left: list[float] = field(default_factory=list)
    length: float = 0.0  # m


def settings_of(vehicle: str, mass: float) -> OnboardSettings:
    """A robot that takes its soil for dry sand."""
    base = soil("dry_sand")
    estimator = EstimatorSettings(sinkage_zero_std=1e-3)
    prior, strength = SoilPrior.from_soil(base), usual_strength(base)
    wheels = VEHICLES[vehicle]
    return OnboardSettings(
        wheels, prior, strength, estimator=estimator, mass=mass, mobility_rate=0.0
    )


def run(drive: TractionDrive, kind: str, settle: float = SETTLE) -> tuple[Onboard, Run]:
    """Let the pipeline's estimators drive. settle: m, before which nothing is scored."""
    settings = settings_of(drive.world.vehicle, MASS if "balance" in kind else 0.0)
    assessor, out, wheels = Onboard(settings), Run(), settings.wheels
    warned = np.zeros(len(drive.time), dtype=bool)
    speed = np.convolve(np.pad(drive.odometry, 2, mode="edge"), np.ones(5) / 5, mode="valid")
    acceleration = np.gradient(speed, drive.time)
    for i, time in enumerate(drive.time):
        margins = []
        for j, wheel in enumerate(wheels):
            rim, travel = float(drive.rim[i, j]), float(drive.odometry[i])
            slope = GRAVITY * math.sin(-drive.pitch[i]) if "balance" in kind else None
            noise = Quantity(travel, 0.01), Quantity(rim, 0.01 * rim)
            made = assessor.assess(
                Reading(
                    wheel,
                    int(1e9 * time) + j,
                    Quantity(float(drive.weighed[i, j]), 1.2),
                    wheel_slip(*noise, 0.01),
                    Quantity(float(drive.shown_sinkage[i, j]), 1e-3),
                    travel,
                    float(drive.path[i]),
                    float(drive.path[i]),
                    pitch=float(drive.pitch[i]),
                    rim_speed=rim,
                    speed_std=noise[0].standard_deviation,
                    rim_std=noise[1].standard_deviation,
                    slope_force=slope,
                    gained_force=float(acceleration[i]),
                    torque=float(drive.torque[i, j]) if "torque" in kind else None,
                    drawbar_pull=Quantity(float(drive.pulled[i, j]), 0.6)
                    if kind == "pull sensor"
                    else None,
                )
            )
            forces = None if made is None else made.forces
            if drive.path[i] < settle or forces is None or forces.drawbar_pull is None:
                continue
            out.pull.append(forces.drawbar_pull.value)
            out.deviation.append(forces.drawbar_pull.standard_deviation)
            out.positive.append(forces.probability_drawbar_pull_positive)
            out.true_pull.append(float(drive.pull[i, j]))
            margins.append((forces.margin, float(drive.weighed[i, j])))
            off = forces.margin.value - float(drive.held[i, j] / drive.load[i, j])
            out.wheel_margins += 1
            out.wheel_margins_inside += abs(off) < 1.96 * forces.margin.standard_deviation
        warned[i] = bool(assessor.stuck.warning) and drive.path[i] >= settle
        near = (drive.path >= drive.path[i]) & (drive.path <= drive.path[i] + _WITHIN)
        whole = drive.stuck or drive.path[-1] - drive.path[i] >= _WITHIN
        if drive.path[i] >= settle and whole and assessor.stuck.risk is not None:
            out.risk.append(assessor.stuck.risk)
            out.too_steep.append(bool(drive.reserve[near].min() < 0.0))
        if len(margins) == len(wheels):
            load = sum(w for _, w in margins)
            out.margin.append(sum(m.value * w for m, w in margins) / load)
            out.margin_deviation.append(sum(m.standard_deviation * w for m, w in margins) / load)
            out.true_margin.append(float(drive.true_margin[i]))
    _score_warnings(drive, warned, out)
    return assessor, out


def _score_warnings(drive: TractionDrive, warned: NDArray[np.bool_], out: Run) -> None:
    """How far ahead the last warning began; and those that nothing came of.

    That is, from half a metre before to two metres after it slip stayed under 0.3. How much true reserve
    was left there says whether it was a near miss.
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
            if drive.slip[near].max() < 0.3:
                out.left.append(float(drive.reserve[near].min()))
        if on:
            last = place


def print_known(drives: list[TractionDrive]) -> None:
    """What warnings would be like by the true reserve under the wheels, known without any error."""
    for least in (0.03, 0.05, 0.07, 0.1):
        rows = []
        for drive in drives:
            made = Run()
            _score_warnings(drive, (drive.reserve < least) & (drive.path >= SETTLE), made)
            rows.append(made)
        pairs = [
            (made.ahead, AHEAD.get(d.world.name)) for made, d in zip(rows, drives, strict=True)
        ]
        stuck = [ahead >= need for ahead, need in pairs if ahead is not None and need is not None]
        left = [each for made in rows for each in made.left]
        print(
            f"true reserve under {least}: {sum(stuck)} of {len(stuck)} in time,"
            f" {in_words(left, sum(made.length for made in rows))}"
        )


def summed(world: str, seed: int, kind: str, made: Run) -> Row:
    """Sums of a drive."""
    pull, deviation, true, stated = map(
        np.array, (made.pull, made.deviation, made.true_pull, made.positive)
    )
    came, off = true > 0.0, pull - true
    short = np.array(made.margin) - made.true_margin
    return Row(
        world,
        seed,
        kind,
        len(pull),
        float(np.sum(off**2)),
        int(np.sum(np.abs(off) < 1.96 * deviation)),
        float(np.sum((stated - came) ** 2)),
        _fifths(stated, came),
        _fifths(np.array(made.risk), np.array(made.too_steep)),
        len(short),
        float(np.sum(short**2)),
        int(np.sum(np.abs(short) < 1.96 * np.array(made.margin_deviation))),
        made.wheel_margins,
        made.wheel_margins_inside,
        made.ahead,
        made.left,
        made.length,
    )


def _fifths(stated: Array, came: NDArray[np.bool_]) -> list[list[float]]:
    """Readings in each fifth of what was stated, the sum of it, and how often it came."""
    fifth = np.clip((5.0 * stated).astype(int), 0, 4)
    return [
        [int(np.sum(at)), float(np.sum(stated[at])), int(np.sum(came[at]))]
        for at in (fifth == i for i in range(5))
    ]


def main() -> None:
    """Drive, or print what was driven."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    commands = parser.add_subparsers(dest="command", required=True)
    driving, knowing = commands.add_parser("drive"), commands.add_parser("known")
    for command in (driving, knowing):
        command.add_argument("--seeds", type=int, default=8)
        command.add_argument("--first", type=int, default=0)
        command.add_argument("--worlds", nargs="*", default=list(WORLDS))
    driving.add_argument("--kinds", nargs="*", default=KINDS)
    driving.add_argument("-o", "--output", type=Path, required=True)
    printing = commands.add_parser("table")
    printing.add_argument("files", nargs="+", type=Path)
    printing.add_argument("--picture", type=Path)
    given = parser.parse_args()
    if given.command in ("drive", "known"):
        made = (
            (seed, name, make_drive(WORLDS[name], seed))
            for seed in range(given.first, given.first + given.seeds)
            for name in [given.worlds[seed % len(given.worlds)]]
        )
        if given.command == "known":
            print_known([drive for _, _, drive in made])
            return
        for seed, name, drive in made:
            with given.output.open("a", encoding="utf-8") as file:
                for kind in given.kinds:
                    row = summed(name, seed, kind, run(drive, kind)[1])
                    file.write(json.dumps(asdict(row)) + "\n")
        return
    lines = [line for file in given.files for line in file.read_text("utf-8").splitlines()]
    rows = [Row(**json.loads(line)) for line in lines]
    table(rows)
    if given.picture:
        draw(rows, given.picture)


if __name__ == "__main__":
    main()
