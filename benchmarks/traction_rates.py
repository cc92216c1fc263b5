# SPDX-License-Identifier: Apache-2.0
"""Pull, margin and warnings against the truth over the worlds of `traction_worlds`.

    python benchmarks/traction_rates.py drive --first 100 --seeds 8 -o a.jsonl   # small samples, in parallel
    python benchmarks/traction_rates.py known --first 100 --seeds 8   # warnings by the true reserve itself
    python benchmarks/traction_rates.py table a.jsonl b.jsonl --picture docs/images/reliability.png

What the sensors of a simulated drive show goes to the pipeline's streams, without ROS: one drive a seed, with
its own soil, in the worlds in turn. One line a drive and kind of sensors goes to the file: sums, so that
samples add up. Intervals (95 %) of the table are of the bootstrap over seeds, since readings of one drive are
not independent.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks._fed import newest_of_each
from benchmarks._traction_table import AHEAD, KINDS, Row, draw, in_words, table
from benchmarks.robot_worlds import VEHICLES
from benchmarks.traction_worlds import MASS, WORLDS, TractionDrive, make_drive
from smallwheel_ros.onboard.prior import EstimatorSettings, SoilPrior
from smallwheel_ros.onboard.settings import ODOMETRY, OnboardSettings
from smallwheel_ros.physics.soil import soil, usual_strength
from smallwheel_ros.physics.wheel import Quantity
from smallwheel_ros.pipeline.pipeline import Pipeline
from smallwheel_ros.pipeline.tables import Array, Estimates, Integers
from smallwheel_ros.pipeline.warnings import Warned

_PAUSE, _EPISODE, _WITHIN = 0.3, 0.5, 1.0  # m
FRICTION_STD = 0.25  # rad: the node's
SETTLE = 2.0  # m, before which nothing is scored
EPOCH = 1_700_000_000_000_000_000  # ns


@dataclass
class Run:
    """Stated and true values: of wheels at instants, and of the vehicle over time.

    positive: stated probability that the pull is over 0. too_steep: within a metre it needs more than its
    margin. ahead: m before it was stuck, that it was warned of without a pause. left: of each warning that
    nothing came of, the least true reserve near it.
    """

    pull: Array = field(default_factory=lambda: np.empty(0))
    deviation: Array = field(default_factory=lambda: np.empty(0))
    positive: Array = field(default_factory=lambda: np.empty(0))
    true_pull: Array = field(default_factory=lambda: np.empty(0))
    margin: Array = field(default_factory=lambda: np.empty(0))
    margin_deviation: Array = field(default_factory=lambda: np.empty(0))
    true_margin: Array = field(default_factory=lambda: np.empty(0))
    wheel_margins: int = 0  # of single wheels, and how many were in their band
    wheel_margins_inside: int = 0
    risk: Array = field(default_factory=lambda: np.empty(0))
    too_steep: NDArray[np.bool_] = field(default_factory=lambda: np.empty(0, dtype=bool))
    ahead: float | None = None
    left: list[float] = field(default_factory=list)
    length: float = 0.0  # m


def settings_of(vehicle: str, mass: float, kind: str = "") -> OnboardSettings:
    """A robot that takes its soil for dry sand. kind: of `KINDS`, what tells of its strength."""
    base = soil("dry_sand")
    wheels = VEHICLES[vehicle]
    names = frozenset(wheel.name for wheel in wheels)
    strength = replace(
        usual_strength(base), friction_angle=Quantity(base.friction_angle, FRICTION_STD)
    )
    return OnboardSettings(
        wheels, SoilPrior.from_soil(base), strength,
        estimator=EstimatorSettings(sinkage_zero_std=1e-3), mass=mass, mobility_rate=0.0,
        with_torque=names if "torque" in kind else frozenset(),
        with_drawbar_pull=names if kind == "pull sensor" else frozenset(),
    )  # fmt: skip


def streams_of(drive: TractionDrive, kind: str) -> dict[str, tuple[Integers, Array]]:
    """Rows of all streams that the sensors of a drive fill, by stream: stamps (ns) and values.

    The odometry has a pitch where a balance is to tell of the strength: then the slope is known.
    """
    stamps = EPOCH + np.round(1e9 * drive.time).astype(np.int64)
    count, found = drive.time.size, {}
    zero, one = np.zeros(count), np.ones(count)
    for j, wheel in enumerate(VEHICLES[drive.world.vehicle]):
        columns = {
            "wheel_speed": [drive.rim[:, j] / (0.5 * wheel.diameter)], "load": [drive.weighed[:, j]],
            "sinkage": [drive.shown_sinkage[:, j], 1e-6 * one], "torque": [drive.torque[:, j]],
            "drawbar_pull": [drive.pulled[:, j]],
        }  # fmt: skip
        for name, values in columns.items():
            found[f"{wheel.name}/{name}"] = stamps, np.stack(values, axis=1)
    pitch = drive.pitch if "balance" in kind else zero
    moves = [drive.odometry, zero, drive.path, zero, one, zero, 1e-4 * one, zero, pitch, zero]
    found[ODOMETRY] = stamps, np.stack(moves, axis=1)
    return found


def run(drive: TractionDrive, kind: str, settle: float = SETTLE) -> tuple[Pipeline, Run]:
    """Let the pipeline drive. settle: m, before which nothing is scored."""
    pipeline = Pipeline(settings_of(drive.world.vehicle, MASS if "balance" in kind else 0.0, kind))
    streams = streams_of(drive, kind)
    for i in range(drive.time.size):
        for name in pipeline.streams.all:
            stamps, values = streams[name]
            pipeline.streams.add(name, int(stamps[i]), tuple(values[i].tolist()))
    turns = list(pipeline.turns(last=True))
    made = Estimates.joined([turn.estimates for turn in turns])
    told = [turn.warned for turn in turns if turn.warned is not None]
    return pipeline, scored(drive, made, Warned.joined(told) if told else None, settle)


def scored(drive: TractionDrive, made: Estimates, told: Warned | None, settle: float) -> Run:
    """Estimates beside the truth of their instants."""
    out, j = Run(), made.wheel
    stamps = EPOCH + np.round(1e9 * drive.time).astype(np.int64)
    i = np.searchsorted(stamps, made.stamp)
    late = drive.path[i] >= settle
    known = late & np.isfinite(made.drawbar_pull)
    out.pull, out.deviation = made.drawbar_pull[known], made.drawbar_pull_std[known]
    out.positive = made.probability_drawbar_pull_positive[known]
    out.true_pull = drive.pull[i, j][known]
    off = made.margin - drive.held[i, j] / drive.load[i, j]
    out.wheel_margins = int(known.sum())
    out.wheel_margins_inside = int((np.abs(off) < 1.96 * made.margin_std)[known].sum())
    nothing = np.full(drive.rim.shape[1], math.nan)
    margin, spread, load = (
        newest_of_each(j, column, nothing) for column in (made.margin, made.margin_std, made.load)
    )
    whole = load.sum(axis=1)
    mean, deviation = (margin * load).sum(axis=1) / whole, (spread * load).sum(axis=1) / whole
    ends = late & np.isfinite(mean) & (j == drive.rim.shape[1] - 1)
    out.margin, out.margin_deviation = mean[ends], deviation[ends]
    out.true_margin = drive.true_margin[i[ends]]
    near = [
        bool(drive.reserve[(drive.path >= at) & (drive.path <= at + _WITHIN)].min() < 0.0)
        for at in drive.path
    ]
    ahead = drive.stuck | (drive.path[-1] - drive.path[i] >= _WITHIN)
    risky = late & ahead & (j == 0) & np.isfinite(made.risk)
    out.risk, out.too_steep = made.risk[risky], np.array(near)[i[risky]]
    warned = np.zeros(drive.time.size, dtype=bool)
    if told is not None:
        at = np.searchsorted(told.stamp, stamps, side="right") - 1
        warned = (at >= 0) & (told.level[np.maximum(at, 0)] > 0) & (drive.path >= settle)
    _score_warnings(drive, warned, out)
    return out


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
    came, off = made.true_pull > 0.0, made.pull - made.true_pull
    short, stated = made.margin - made.true_margin, made.positive
    return Row(
        world,
        seed,
        kind,
        len(made.pull),
        float(np.sum(off**2)),
        int(np.sum(np.abs(off) < 1.96 * made.deviation)),
        float(np.sum((stated - came) ** 2)),
        _fifths(stated, came),
        _fifths(made.risk, made.too_steep),
        len(short),
        float(np.sum(short**2)),
        int(np.sum(np.abs(short) < 1.96 * made.margin_deviation)),
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
