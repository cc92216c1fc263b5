# SPDX-License-Identifier: Apache-2.0
"""Recorded drives of real robots through `smallwheel replay`: what it says of them, as a table.

    python -m rates.real_drives FOLDER... [-o OUT] [--page PAGE] [--picture warthog_sand1 FILE]

A folder holds bags, parameter files and truths: the bag `warthog_sand1` goes with `warthog.yaml`, the file
that its name begins with, and with `warthog_sand1_truth.csv`, if there is one. A truth has the columns
`stamp [s]`, `side` (left, right), `rim_speed [m/s]` and `ground_speed [m/s]`, means over 0.5 s or more. The
rows go to rates/results/real_drives.csv, beside those of other drives, and, between its marks, into the
page.

A truth is left out, and counted, where the poses that it was made of contradict it: where the vehicle's
middle (mean of both sides) is to have gone more than twice as fast as the way along these poses, 2 s to
either side, and 0.3 m/s. Places that jump, and slopes over poses that are too few, make such truths.

Moving is a wheel whose rim turns at more than 0.15 m/s, by the bag's joint states. Steady is an instant
from 1 s before to 1 s after which the rim's speed stays within a tenth of its own: in starts and stops,
poses that come late would count as the program's errors. Accusations are what a sensor is said to have wrong;
those that are so are in TRUE. Slip alone: episodes of the middle wheel's slip, mean of half a second, over
0.3.
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

from rates.drive_trial import shown_slip
from rates.faults import Raw
from smallwheel_ros.bags import BagReader
from smallwheel_ros.common.errors import SmallwheelError
from smallwheel_ros.onboard.parameters import read_parameters, settings_from
from smallwheel_ros.onboard.settings import ODOMETRY, STANDSTILL_SPEED
from smallwheel_ros.pipeline.pipeline import Pipeline
from smallwheel_ros.pipeline.rows.slip import slip_of
from smallwheel_ros.replay.recording import Recording
from smallwheel_ros.replay.replay import replay
from smallwheel_ros.replay.result import FILES
from smallwheel_ros.replay.spec import ReplaySpec, resolved

Array = NDArray[np.float64]
CSV = Path(__file__).resolve().parent / "results" / "real_drives.csv"
BEGIN, END = "<!-- drives: begin -->\n", "<!-- drives: end -->\n"
MOVING = 0.15  # m/s
STEADY, CHANGE = 1.0, 0.1  # s to either side; of the rim's speed
AROUND, FASTER, AT_REST = 2.0, 2.0, 0.3  # s to either side; times the way of the poses; m/s
NEAR = 0.15  # s between a truth and its estimate
BAND = 1.96
SLIP_ALONE, PAUSE = 0.3, 1.0  # of a threshold, and s between two of its warnings
# The odometry that is not made of the wheels, where a robot has two.
TOPICS = {"pathfinder": "/gnss/odom"}
# What is said of a sensor, and is so, by the bag: rules of the checks, with their subjects, and in words.
TRUE = {
    "warthog_grass_pose_only": {("no twist", ODOMETRY): "has no twist"},
    "pathfinder_flat": {("z down", "imu"): "looks down", ("rolling", "radii"): "the rims travel"},
    "husky_snow": {("of wheels", "odometry"): "computed from them"},
    "warthog_ice": {("turn", "imu"): "it turns the other way"},
    "warthog_gravel": {("turn", "imu"): "it turns the other way"},
    "husky_wetgrass": {("jumps", "odometry"): "its pose jumps"},
}
_VARIES = re.compile(r"-?\d+(\.\d+)?|'\w+'")  # numbers and names of wheels
_KIND = "nav_msgs/msg/Odometry"


DRIVE, BAND_CELL, ACCUSED, SAID = "drive", "in its band (steady)", "good sensors accused", "said"
STATED = "stated over median error"
WARNINGS = "warnings of both levels; by slip alone"
MAY, GETS = 2, 3  # levels of VehicleMobility.msg
HEADER = [
    DRIVE,
    "of",
    "slip known",
    BAND_CELL,
    STATED,
    "margin",
    WARNINGS,
    ACCUSED,
]  # SAID stands below the table


@dataclass
class Judged:
    """What came of one drive: cells of its row, by column; its truth with slips, and its estimates."""

    cells: dict[str, str]
    truth: pd.DataFrame | None
    estimates: pd.DataFrame
    left: set[str]


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
    for robot, topic in TOPICS.items():
        if bag.name.startswith(robot):
            return topic
    with BagReader(bag) as reader:
        topics = [topic.name for topic in reader.topics if topic.type == _KIND]
    if len(topics) != 1:
        raise SmallwheelError(f"{bag}: odometries {topics}, expected one, or a line in TOPICS")
    return topics[0]


def raw_drive(bag: Path, config: Path, topic: str) -> Raw:
    """Rows of joints, odometry and imu as the pipeline's streams have them."""
    settings = settings_from(read_parameters(str(config)))
    pipeline = Pipeline(settings.onboard)
    with BagReader(bag) as reader:
        names = {ODOMETRY: topic}
        recording = Recording(
            reader, settings, pipeline, lambda name: resolved(names.get(name, name)), clock=False
        )
        for _ in recording.turns():
            pass  # what is given to the streams stays there: no turn is taken
    streams = pipeline.streams.all.items()
    rows = {name: (stream.stamps.copy(), stream.values.copy()) for name, stream in streams}
    return Raw(settings.onboard, rows)


def real_drive(folder: Path, name: str) -> Raw:
    """The drive of that name in a folder."""
    bag, config = next(pair for pair in drives_in(folder) if pair[0].name == name)
    return raw_drive(bag, config, odometry_of(bag))


def rims(raw: Raw) -> dict[str, tuple[Array, Array]]:
    """By wheel times (s) and rim speeds (m/s)."""
    found = {}
    for wheel in raw.settings.wheels:
        stamps, values = raw.rows[f"{wheel.name}/wheel_speed"]
        found[wheel.name] = stamps * 1e-9, 0.5 * wheel.diameter * values[:, 0]
    return found


def by_slip_alone(raw: Raw) -> int:
    """Warnings of a threshold on the slip that rims and odometry show."""
    time, slip = shown_slip(raw)
    return int(np.sum(np.diff(time[slip > SLIP_ALONE], prepend=-np.inf) > PAUSE))


def rises(vehicle: pd.DataFrame, level: int) -> int:
    """How often a level of the warning, or a higher one, begins after `PAUSE` without it."""
    times = vehicle["time"][vehicle["level"] >= level]
    return int(np.sum(np.diff(times, prepend=-np.inf) > PAUSE))


def is_steady(times: Array, speeds: Array, at: float) -> bool:
    """Whether the rim keeps its speed about an instant."""
    begin, end = np.searchsorted(times, [at - STEADY, at + STEADY])
    about = speeds[begin:end]
    return bool(about.size and np.ptp(about) < 2.0 * CHANGE * abs(about.mean()))


def contradicted(
    truth: pd.DataFrame, odometry: tuple[NDArray[np.int64], Array]
) -> NDArray[np.bool_]:
    """Of each row of a truth, whether the poses that it was made of, rows of its odometry, contradict it."""
    times, (x, y) = odometry[0] * 1e-9, odometry[1][:, 2:4].T
    way = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(x), np.diff(y)))])
    stamps = truth.iloc[:, 0].to_numpy()
    middle = truth.groupby(truth.columns[0])[truth.columns[3]].transform("mean").to_numpy()
    gone = np.interp(stamps + AROUND, times, way) - np.interp(stamps - AROUND, times, way)
    wrong = np.abs(middle) > FASTER * gone / (2.0 * AROUND) + AT_REST
    return np.asarray(wrong & (stamps >= times[0]) & (stamps <= times[-1]))


def true_slips(truth: pd.DataFrame) -> Array:
    """Slips of the rows of a truth, NaN where nothing turns or moves."""
    rim, speed = truth.iloc[:, 2].to_numpy(float), truth.iloc[:, 3].to_numpy(float)
    exact = np.zeros(len(truth))
    return slip_of(speed, exact, rim, exact, STANDSTILL_SPEED)[0]


def truth_of(bag: Path, raw: Raw) -> tuple[pd.DataFrame | None, int]:
    """The truth beside a bag, with slips, without rows that its poses contradict; how many those are."""
    file = longest(bag, "*_truth.csv", "_truth.csv")
    if file is None:
        return None, 0
    truth = pd.read_csv(file).dropna()  # at some instants one of both speeds is not there
    wrong = contradicted(truth, raw.rows[ODOMETRY])
    truth = truth[~wrong].sort_values(truth.columns[0])
    return truth.assign(slip=true_slips(truth)), int(wrong.sum())


def near_truths(
    truth: pd.DataFrame, estimates: pd.DataFrame, speeds: dict[str, tuple[Array, Array]], left: set[str]
) -> pd.DataFrame:  # fmt: skip
    """Of each true slip that an estimate of that side is near to: error, its deviation, is it steady."""
    parts = []
    time, _, rim, *_ = truth.columns
    for wheel, rows in estimates[estimates["slip"].notna()].groupby("wheel"):
        of_side = truth["side"] == ("left" if wheel in left else "right")
        mine = truth[of_side & (truth[rim].abs() >= MOVING)].rename(columns={"slip": "true"})
        rows = rows.assign(**{time: rows["stamp"] * 1e-9}).sort_values(time)
        near = pd.merge_asof(mine, rows, on=time, direction="nearest", tolerance=NEAR)
        near = near[near["slip"].notna()]
        error = (near["slip"] - near["true"]).abs()
        steady = [is_steady(*speeds[str(wheel)], at) for at in near[time]]
        columns = {"error": error, "stated": near["slip_standard_deviation"]}
        parts.append(pd.DataFrame({**columns, "steady": np.array(steady, dtype=bool)}))
    return pd.concat(parts, ignore_index=True)


def of_truths(found: pd.DataFrame) -> tuple[str, str]:
    """Share of truths in their band; in steady driving, median stated deviation over median error."""
    inside, steady = found["error"] <= BAND * found["stated"], found[found["steady"]]
    ratio = steady["stated"].median() / steady["error"].median()
    shares = f"{inside.mean():.2f} ({inside[found['steady']].mean():.2f}) of {len(found)}"
    return shares, f"{ratio:.1f}"


def sensors_said(summary: dict[str, Any]) -> list[str]:
    """What was reported about sensors: of texts that differ in numbers or wheels alone, the newest."""
    said = [event["text"] for event in summary["events"] if event["kind"] == "sensor"]
    said += [text for text in summary["sensors"] if text not in said]
    said = [re.split("[,(]", text)[0].strip() for text in said]
    newest = {_VARIES.sub("#", text): text for text in said}
    return [newest[_VARIES.sub("#", text)] for text in said]


def known_share(estimates: pd.DataFrame, speeds: dict[str, tuple[Array, Array]]) -> float:
    """Share of the moving time with slip."""
    moving = []
    for wheel, rows in estimates.groupby("wheel"):
        turning = abs(np.interp(rows["stamp"] * 1e-9, *speeds[str(wheel)])) > MOVING
        moving.append(rows["slip"].notna()[turning])
    return float(pd.concat(moving).mean())


def judged(bag: Path, config: Path, folder: Path) -> Judged:
    """Replay one drive and judge it."""
    topic = odometry_of(bag)
    spec = ReplaySpec(bag, config, folder, {"/odom": resolved(topic)}, copy="none")
    result = replay(spec)
    summary: dict[str, Any] = result.to_dict()
    estimates = pd.read_csv(folder / FILES["estimates_csv"], low_memory=False)
    left = {w.name for w in result.settings.onboard.wheels if w.lateral_position > 0.0}
    raw = raw_drive(bag, config, topic)
    speeds = rims(raw)
    truth, left_out = truth_of(bag, raw)
    inside = stated = "-"
    if truth is not None:
        found = near_truths(truth, estimates, speeds, left)
        inside, stated = of_truths(found)
        inside += f", {left_out} left out"
    margin = estimates["mobility_margin"].median()
    deviation = estimates["mobility_margin_standard_deviation"].median()
    vehicle = pd.read_csv(folder / FILES["vehicle_csv"])
    first, second = (rises(vehicle, level) for level in (MAY, GETS))
    said = Counter(sensors_said(summary))
    true = TRUE.get(bag.name, {}).values()
    cells = {
        DRIVE: f"{bag.parent.name}/{bag.name}",
        "of": f"{summary['duration']:.0f} s, {summary['travel']:.0f} m",
        "slip known": f"{known_share(estimates, speeds):.0%}",
        BAND_CELL: inside,
        STATED: stated,
        "margin": f"{margin:.2f} ± {BAND * deviation:.2f}" if np.isfinite(margin) else "-",
        WARNINGS: f"{first}, {second}; {by_slip_alone(raw)}",
        ACCUSED: str(sum(n for text, n in said.items() if not any(w in text for w in true))),
        SAID: "; ".join(said),
    }
    return Judged(cells, truth, estimates, left)


def draw(drive: Judged, path: Path, seconds: float = 60.0) -> None:
    """Slip of one wheel of each side with its 95 % band, and the truth beside it."""
    import matplotlib.pyplot as plt

    truth, estimates, name = drive.truth, drive.estimates, drive.cells[DRIVE]
    if truth is None:
        raise SmallwheelError(f"{name}: there is no truth to draw beside it")
    begin = float(truth.iloc[:, 0].min()) + 5.0
    figure, axes = plt.subplots(2, 1, figsize=(8.0, 4.6), sharex=True, layout="constrained")
    for axis, side in zip(axes, ("left", "right"), strict=True):
        names = estimates["wheel"].unique()
        wheel = next(one for one in names if (one in drive.left) == (side == "left"))
        rows = estimates[estimates["wheel"] == wheel]
        time = rows["stamp"].to_numpy() * 1e-9 - begin
        slip, spread = rows["slip"].to_numpy(), BAND * rows["slip_standard_deviation"].to_numpy()
        mine = truth[truth["side"] == side]
        axis.fill_between(time, slip - spread, slip + spread, alpha=0.3, label="95 % band")
        axis.plot(time, slip, linewidth=1.0, label=f"estimate, {wheel}")
        axis.plot(
            mine.iloc[:, 0] - begin, mine["slip"], ".", color="black", markersize=3,
            label="truth, by lidar poses",
        )  # fmt: skip
        axis.set(xlim=(0.0, seconds), ylim=(-1.1, 1.1), ylabel=f"slip, {side}")
        axis.grid(alpha=0.3)
    axes[0].legend(loc="lower right", fontsize=8, ncols=3)
    axes[1].set_xlabel(f"time, s ({name})")
    figure.savefig(path, dpi=110)


def merged(drives: list[Judged], path: Path = CSV) -> pd.DataFrame:
    """Rows as the table has them; those of drives that are not among them stay as they were."""
    new = pd.DataFrame([drive.cells for drive in drives])
    if not path.exists():
        return new
    old = pd.read_csv(path, keep_default_na=False)
    return pd.concat([new, old[~old[DRIVE].isin(new[DRIVE])]]).sort_values(DRIVE)


def in_short(table: pd.DataFrame) -> str:
    """All drives in one sentence."""
    metres = table["of"].str.extract(r"(\d+) m")[0].astype(int).sum()
    counts = table[WARNINGS].str.split("[,;] ", expand=True, regex=True)
    first, second, by_slip = counts.astype(int).sum()
    inside = [cell.split()[0] for cell in table[BAND_CELL] if cell != "-"]
    accused = table[ACCUSED].astype(int).sum()
    return (
        f"{len(table)} real drives, {metres} m: {first} warnings, {second} of them of the second level,"
        f" where a threshold of {SLIP_ALONE} on"
        f" slip gives {by_slip}; slip in its 95 % band in {', '.join(inside)} of the truths; {accused} good"
        " sensors accused.\n"
    )


def markdown(table: pd.DataFrame) -> str:
    """The sentence, the table, and what was reported about the sensors."""
    lines = [HEADER, ["---"] * len(HEADER), *table[HEADER].astype(str).to_numpy().tolist()]
    text = "".join("| " + " | ".join(cells) + " |\n" for cells in lines)
    told = [f"- {row.drive}: {row.said}\n" for row in table.itertuples() if row.said]
    return f"{in_short(table)}\n{text}\nReported about sensors:\n\n{''.join(told)}"


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folders", type=Path, nargs="+")
    parser.add_argument("-o", "--output", type=Path, help="keep the replays there")
    parser.add_argument(
        "--page", type=Path, help="page whose table is made anew, between its marks"
    )
    parser.add_argument("--picture", nargs=2, metavar=("DRIVE", "FILE"), help="slip and its truth")
    options = parser.parse_args()
    drives = []
    try:
        with TemporaryDirectory() as scratch:
            for folder in options.folders:
                for bag, config in drives_in(folder):
                    kept = (options.output or Path(scratch)) / folder.name / bag.name
                    drives.append(judged(bag, config, kept))
        if options.picture:
            name, file = options.picture
            named = [one for one in drives if one.cells[DRIVE].endswith(f"/{name}")]
            if not named:
                raise SmallwheelError(f"no drive {name} in these folders")
            draw(named[0], Path(file))
    except (SmallwheelError, OSError) as error:
        print(f"real_drives: {error}", file=sys.stderr)
        return 2
    table = merged(drives)
    text = markdown(table)
    print(text)
    CSV.parent.mkdir(exist_ok=True)
    table.to_csv(CSV, index=False)
    if options.page:
        before, _, rest = options.page.read_text(encoding="utf-8").partition(BEGIN)
        if END not in rest:
            print(f"real_drives: {options.page} has no marks for the table", file=sys.stderr)
            return 2
        page = before + BEGIN + text + END + rest.split(END)[1]
        options.page.write_text(page, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
