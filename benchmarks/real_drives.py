# SPDX-License-Identifier: Apache-2.0
"""Recorded drives of real robots through `smallwheel replay`: what it says of them, as a table.

    python benchmarks/real_drives.py FOLDER [-o OUT]

FOLDER holds bags, parameter files and truths: the bag `warthog_sand1` goes with `warthog.yaml`, the file that
its name begins with, and with `warthog_sand1_truth.csv`, if there is one. A truth has the columns
`stamp [s]`, `side` (left, right), `rim_speed [m/s]` and `ground_speed [m/s]`, means over 0.5 s or more.

A truth is left out, and counted, where the poses that it was made of contradict it: where the vehicle's
middle (mean of both sides) is to have gone more than twice as fast as the way along these poses, 2 s to
either side, and 0.3 m/s. Places that jump, and slopes over poses that are too few, make such truths.

Moving is a wheel whose rim turns at more than 0.15 m/s, by the bag's joint states. Steady is an instant
from 1 s before to 1 s after which the rim's speed stays within a tenth of its own: in starts and stops,
poses that come late would count as the program's errors. Accusations are what a sensor is said to have wrong.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from smallwheel_ros.bags import BagReader
from smallwheel_ros.common.errors import SmallwheelError
from smallwheel_ros.physics.wheel import Quantity, wheel_slip
from smallwheel_ros.replay.replay import replay
from smallwheel_ros.replay.result import FILES
from smallwheel_ros.replay.spec import ReplaySpec, resolved

Array = NDArray[np.float64]
MOVING = 0.15  # m/s
STEADY, CHANGE = 1.0, 0.1  # s to either side; of the rim's speed
AROUND, FASTER, AT_REST = 2.0, 2.0, 0.3  # s to either side; times the way of the poses; m/s
NEAR = 0.15  # s between a truth and its estimate
BAND = 1.96
# The odometry that is not made of the wheels, where a robot has two.
ODOMETRY = {"pathfinder": "/gnss/odom"}
_VARIES = re.compile(
    r"-?\d+(\.\d+)?|'\w+'"
)  # numbers and names of wheels, that alike texts are one line
_KIND = "nav_msgs/msg/Odometry"


@dataclass
class Row:
    """What came of one drive; shares are NaN where there is nothing to count."""

    name: str
    seconds: float
    metres: float
    accusations: Counter[str]
    known: float  # share of moving time with slip
    inside: float  # share of truths in the band of slip, and that of steady ones
    steady: float
    truths: int
    left_out: int  # truths that their own poses contradict
    margin: float
    margin_deviation: float
    warnings: int

    def cells(self) -> list[str]:
        """The row as the table has it."""
        margin = "-"
        if np.isfinite(self.margin):
            margin = f"{self.margin:.2f} ± {BAND * self.margin_deviation:.2f}"
        inside = "-"
        if self.truths:
            inside = (
                f"{self.inside:.2f} ({self.steady:.2f}) of {self.truths}, {self.left_out} left out"
            )
        return [
            self.name,
            f"{self.seconds:.0f} s, {self.metres:.0f} m",
            f"{self.known:.0%}",
            inside,
            margin,
            str(self.warnings),
            str(self.accusations.total()),
        ]


HEADER = ["drive", "of", "slip known", "in its band (steady)", "margin", "warnings", "accusations"]


def longest(bag: Path, pattern: str, ending: str) -> Path | None:
    """The file beside a bag whose name, less its ending, the bag's begins with; the longest such name."""
    fits = [p for p in bag.parent.glob(pattern) if bag.name.startswith(p.name.removesuffix(ending))]
    return max(fits, key=lambda path: len(path.name), default=None)


def drives_in(folder: Path) -> list[tuple[Path, Path]]:
    """Bags of a folder, each with its parameter file. Raises SmallwheelError where there is none."""
    found = []
    for bag in sorted(path.parent for path in folder.glob("*/metadata.yaml")):
        config = longest(bag, "*.yaml", ".yaml")
        if config is not None:
            found.append((bag, config))
        else:
            print(f"{bag}: no parameter file whose name it begins with", file=sys.stderr)
    if not found:
        raise SmallwheelError(f"{folder}: no bag beside the parameter file that it begins with")
    return found


def odometry_of(bag: Path) -> str:
    """The topic of its odometry. Raises SmallwheelError where the bag has none, or several."""
    for robot, topic in ODOMETRY.items():
        if bag.name.startswith(robot):
            return topic
    with BagReader(bag) as reader:
        topics = [topic.name for topic in reader.topics if topic.type == _KIND]
    if len(topics) != 1:
        raise SmallwheelError(f"{bag}: odometries {topics}, expected one, or a line in ODOMETRY")
    return topics[0]


def rims(bag: Path, wheels: dict[str, tuple[str, float]]) -> dict[str, tuple[Array, Array]]:
    """By wheel times (s) and rim speeds (m/s), from joint states. wheels: joint and signed radius."""
    found: dict[str, list[tuple[float, float]]] = {wheel: [] for wheel in wheels}
    with BagReader(bag) as reader:
        for message in reader.messages({"/joint_states"}):
            stamp, states = message.message.header.stamp, message.message
            at = {name: i for i, name in enumerate(states.name)}
            for wheel, (joint, radius) in wheels.items():
                if joint in at:
                    speed = radius * float(states.velocity[at[joint]])
                    found[wheel].append((stamp.sec + stamp.nanosec * 1e-9, speed))
    arrays = {wheel: np.array(rows).reshape(-1, 2) for wheel, rows in found.items()}
    return {wheel: (rows[:, 0], rows[:, 1]) for wheel, rows in arrays.items()}


def is_steady(times: Array, speeds: Array, at: float) -> bool:
    """Whether the rim keeps its speed about an instant."""
    begin, end = np.searchsorted(times, [at - STEADY, at + STEADY])
    about = speeds[begin:end]
    return bool(about.size and np.ptp(about) < 2.0 * CHANGE * abs(about.mean()))


def poses(bag: Path, topic: str) -> tuple[Array, Array]:
    """Times (s) of an odometry, and the way (m) along its places up to each."""
    rows = []
    with BagReader(bag) as reader:
        for message in reader.messages({topic}):
            stamp, place = message.message.header.stamp, message.message.pose.pose.position
            rows.append((stamp.sec + stamp.nanosec * 1e-9, place.x, place.y))
    times, x, y = np.array(rows).T
    return times, np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(x), np.diff(y)))])


def contradicted(truth: pd.DataFrame, times: Array, way: Array) -> NDArray[np.bool_]:
    """Of each row of a truth, whether the poses that it was made of contradict it."""
    stamps = truth.iloc[:, 0].to_numpy()
    middle = truth.groupby(truth.columns[0])[truth.columns[3]].transform("mean").to_numpy()
    gone = np.interp(stamps + AROUND, times, way) - np.interp(stamps - AROUND, times, way)
    return np.asarray(np.abs(middle) > FASTER * gone / (2.0 * AROUND) + AT_REST)


def judged(
    truth: pd.DataFrame,
    estimates: pd.DataFrame,
    speeds: dict[str, tuple[Array, Array]],
    left: set[str],
) -> list[tuple[bool, bool]]:
    """Of each true slip that an estimate of that side is near to: is it in the band; is it steady."""
    found = []
    known = estimates[estimates["slip"].notna()]
    for wheel, rows in known.groupby("wheel"):
        stamps = rows["stamp"].to_numpy() * 1e-9
        slips, deviations = rows["slip"].to_numpy(), rows["slip_standard_deviation"].to_numpy()
        side = "left" if wheel in left else "right"
        for row in truth[truth["side"] == side].itertuples(index=False):
            near = int(np.argmin(abs(stamps - row[0])))
            if abs(stamps[near] - row[0]) > NEAR or abs(row[2]) < MOVING:
                continue
            true = wheel_slip(Quantity(row[3], 0.0), Quantity(row[2], 0.0), 0.01)
            assert true is not None
            inside = abs(slips[near] - true.value) <= BAND * deviations[near]
            found.append((bool(inside), is_steady(*speeds[str(wheel)], row[0])))
    return found


def row_of(bag: Path, config: Path, folder: Path) -> Row:
    """Replay one drive and judge it."""
    spec = ReplaySpec(bag, config, folder, {"/odom": resolved(odometry_of(bag))}, copy="none")
    result = replay(spec)
    summary: dict[str, Any] = result.to_dict()
    estimates = pd.read_csv(folder / FILES["estimates_csv"], low_memory=False)
    onboard, inputs = result.settings.onboard, result.settings.inputs
    by_joint = {
        w.name: (inputs[w.name].joint, inputs[w.name].joint_sign * w.diameter / 2.0)
        for w in onboard.wheels
    }
    speeds, moving = rims(bag, by_joint), []
    for wheel, rows in estimates.groupby("wheel"):
        times, rim = speeds[str(wheel)]
        turning = abs(np.interp(rows["stamp"] * 1e-9, times, rim)) > MOVING
        moving.append(rows["slip"].notna()[turning])
    said = [event["text"] for event in summary["events"] if event["kind"] == "sensor"]
    said += [text for text in summary["sensors"] if text not in said]
    said = [_VARIES.sub("#", re.split("[,(]", text)[0]).strip() for text in said]
    truth_file = longest(bag, "*_truth.csv", "_truth.csv")
    found, left_out = [], 0
    if truth_file is not None:
        left = {w.name for w in onboard.wheels if w.lateral_position > 0.0}
        truth = pd.read_csv(truth_file).dropna()  # at some instants one of both speeds is not there
        times, way = poses(bag, odometry_of(bag))
        there = truth.iloc[:, 0].between(times[0], times[-1]).to_numpy()
        wrong = contradicted(truth, times, way) & there
        left_out = int(wrong.sum())
        found = judged(truth[~wrong], estimates, speeds, left)
    inside = np.array([a for a, _ in found], dtype=float)
    steady = np.array([a for a, b in found if b], dtype=float)
    margin = estimates["mobility_margin"]
    return Row(
        bag.name,
        summary["duration"],
        summary["travel"],
        Counter(said),
        float(pd.concat(moving).mean()),
        float(inside.mean()) if inside.size else np.nan,
        float(steady.mean()) if steady.size else np.nan,
        len(found),
        left_out,
        float(margin.median()),
        float(estimates["mobility_margin_standard_deviation"].median()),
        sum(event["kind"] == "stuck" for event in summary["events"]),
    )


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("-o", "--output", type=Path, help="keep the replays there")
    options = parser.parse_args()
    rows = []
    try:
        with TemporaryDirectory() as scratch:
            for bag, config in drives_in(options.folder):
                rows.append(row_of(bag, config, (options.output or Path(scratch)) / bag.name))
    except (SmallwheelError, OSError) as error:
        print(f"real_drives: {error}", file=sys.stderr)
        return 2
    for cells in (HEADER, ["---"] * len(HEADER), *(row.cells() for row in rows)):
        print("| " + " | ".join(cells) + " |")
    for row in rows:
        for text, count in row.accusations.items():
            print(f"\n{row.name}: {text}" + (f" ({count} times)" if count > 1 else ""), end="")
    print()
    return 0


if __name__ == "__main__":
    sys.exit(main())
