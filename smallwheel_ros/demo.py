"""The demo: a simulated drive played over DDS into the node; its answers, table and picture.

`smallwheel demo`, `make demo` or `python -m smallwheel_ros.demo`.
"""

from __future__ import annotations

import json
import os
import shutil
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from tqdm import tqdm

from smallwheel_ros.bags import BagReader
from smallwheel_ros.errors import SmallwheelError
from smallwheel_ros.node_process import NodeProcess, check_ros, config_file, own_ros
from smallwheel_ros.onboard.message_fields import VALID
from smallwheel_ros.pictures.drive import draw_drive
from smallwheel_ros.simulate.drive import DriveSettings, simulate_drive
from smallwheel_ros.simulate.drive_bag import write_drive_bag

if TYPE_CHECKING:
    from smallwheel_ros.ros.drive_through import Recording

DEFAULT_FOLDER = Path("out") / "demo"
_BAG, _ANSWER, _LOG = "drive", "drive.answer.json", "node.log"
_MOBILITY, _SOIL, _PICTURE = "mobility.csv", "soil.csv", "drive.png"


class DemoError(SmallwheelError):
    """The demo did not work; the message says where."""


@dataclass(frozen=True)
class DemoResult:
    """What the demo made: files, and the tables in them."""

    picture: Path
    mobility_file: Path
    soil_file: Path
    mobility: pd.DataFrame
    soil: pd.DataFrame
    answer: dict[str, Any]
    published: int
    unanswered: int
    latencies: NDArray[np.float64]
    seconds: float


def run_demo(
    folder: Path | str = DEFAULT_FOLDER,
    *,
    seed: int = 1,
    distance: float = 30.0,
    rate: float = 4.0,
    say: Callable[[str], None] = lambda _: None,
) -> DemoResult:
    """Simulate a drive, play it into the node, write table and picture.

    Parameters
    ----------
    folder
        For everything that is made; files of an earlier run are replaced.
    seed, distance
        Of the drive; m.
    rate
        Times as fast as real time, at most: the player waits for the node.
    say
        Gets a line at the beginning of each step.

    Raises
    ------
    NodeProcessError
        If there is no ROS.
    DriveThroughError
        If the node dies or does not answer.
    DemoError
        If the folder cannot be used.
    """
    start = time.monotonic()
    check_ros()
    folder = _prepared(Path(folder))
    say("1/3 simulating a drive of a rover with two wheel sizes over three soils")
    drive = simulate_drive(DriveSettings(seed=seed, distance=distance, wheels="two_sizes"))
    bag = folder / _BAG
    write_drive_bag(drive, bag)
    answer = drive.answer()
    (folder / _ANSWER).write_text(json.dumps(answer), encoding="utf-8")
    say(f"2/3 playing {drive.message_count} messages over DDS into the node mobility_estimator")
    recording = recorded(bag, config_file("two_wheel_sizes.yaml"), folder, rate=rate)
    say("3/3 writing table and picture")
    epoch = int(answer["epoch_ns"])
    mobility = _table(recording.mobility, epoch)
    soil = _soil_table(recording.soil, epoch)
    mobility.to_csv(folder / _MOBILITY, index=False, float_format="%.9g")
    soil.to_csv(folder / _SOIL, index=False, float_format="%.9g")
    draw_drive(mobility, soil, folder / _PICTURE, truth=answer)
    return DemoResult(
        picture=folder / _PICTURE,
        mobility_file=folder / _MOBILITY,
        soil_file=folder / _SOIL,
        mobility=mobility,
        soil=soil,
        answer=answer,
        published=recording.published,
        unanswered=recording.unanswered,
        latencies=np.array(recording.latencies),
        seconds=time.monotonic() - start,
    )


def _prepared(folder: Path) -> Path:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        shutil.rmtree(folder / _BAG, ignore_errors=True)
        for name in (_ANSWER, _LOG, _MOBILITY, _SOIL, _PICTURE):
            (folder / name).unlink(missing_ok=True)
    except OSError as error:
        raise DemoError(f"the folder {folder} cannot be used: {error.strerror}") from error
    return folder


@contextmanager
def _environment(variables: dict[str, str]) -> Iterator[None]:
    """Set environment variables for as long as it lasts; rclpy reads them in this process."""
    before = {name: os.environ.get(name) for name in variables}
    os.environ.update(variables)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def recorded(bag: Path, parameters: Path, folder: Path, *, rate: float) -> Recording:
    """Run the node in a process of its own, play a bag into it, and record its answers.

    Parameters
    ----------
    parameters
        The node's parameter file.
    folder
        For the node's log.
    rate
        Times as fast as recorded, at most.

    Raises
    ------
    NodeProcessError
        If there is no ROS.
    DriveThroughError
        If the node dies or does not answer.
    """
    check_ros()
    from smallwheel_ros.ros.drive_through import drive_through  # needs ROS

    with BagReader(bag) as reader:
        total = reader.message_count
    with (
        _environment(own_ros(folder / "ros_log")),
        NodeProcess([parameters], folder / _LOG, {"use_sim_time": "true"}) as node,
        tqdm(total=total, unit=" messages", disable=None, leave=False) as bar,
    ):
        return drive_through(bag, rate=rate, alive=node.death, progress=bar.update)


def _table(rows: list[dict[str, Any]], epoch: int) -> pd.DataFrame:
    """One row per estimate; blank where a quantity is not known."""
    table = pd.DataFrame(rows)
    table.insert(0, "time", (table.pop("stamp") - epoch) / 1e9)
    table.insert(1, "wheel", table.pop("frame_id"))
    for flag, names in VALID.items():
        known = table.pop(flag)
        for name in names:
            columns = [c for c in (name, f"{name}_standard_deviation") if c in table]
            table[columns] = table[columns].where(known)
    return table.sort_values(["time", "wheel"], ignore_index=True)


def _soil_table(rows: list[dict[str, Any]], epoch: int) -> pd.DataFrame:
    table = pd.DataFrame(rows)
    # The first message is of the node's start, before there was a measurement.
    table = table[table["measurements_accepted"] > 0].reset_index(drop=True)
    table.insert(0, "time", (table.pop("stamp") - epoch) / 1e9)
    covariance = np.stack([np.asarray(c).reshape(3, 3) for c in table.pop("covariance")])
    for i, name in enumerate(("k", "n", "m")):
        deviation = np.sqrt(covariance[:, i, i])
        place = list(table.columns).index(name) + 1
        table.insert(place, f"{name}_standard_deviation", deviation)
    return table.drop(columns=["frame_id"])


def summary(result: DemoResult) -> str:
    """Put the result into a few lines for people."""
    table, soil = result.mobility, result.soil
    lines = ["wheel         estimates  not used  sinkage measured - predicted   drawbar pull > 0"]
    for wheel, rows in table.groupby("wheel"):
        used = rows[rows["status"] != 3]
        error = (used["sinkage_measured"] - used["sinkage_predicted"]).dropna() * 1e3
        share = (rows["probability_drawbar_pull_positive"].dropna() > 0.5).mean()
        lines.append(
            f"{wheel:<12} {len(rows):>10} {len(rows) - len(used):>9}"
            f" {np.sqrt(np.mean(error**2)):>20.2f} mm rms {share:>17.0%}"
        )
    last = soil.iloc[-1]
    place = np.interp(last["time"], result.answer["rover"]["time"], result.answer["rover"]["way"])
    true = [s for s in result.answer["stretches"] if s["start"] <= place][-1]
    lines += ["", "soil at the end    estimated                  true"]
    for name, unit in (("k", "Pa/m^(n+m)"), ("n", ""), ("m", "")):
        deviation = last[f"{name}_standard_deviation"]
        lines.append(
            f"{name:<12} {last[name]:>15.5g} +- {deviation:<9.2g} {true[name]:>9.5g} {unit}"
        )
    lines += [
        "",
        f"{result.published} messages played, {len(table)} estimates,"
        f" {result.unanswered} sinkages without answer",
        f"from a sinkage to its estimate: median {np.median(result.latencies) * 1e3:.0f} ms, while"
        " it waits for the other wheels' sinkages; 99 % within"
        f" {np.percentile(result.latencies, 99) * 1e3:.0f} ms",
        f"took {result.seconds:.0f} s",
        "",
        f"picture  {result.picture}",
        f"table    {result.mobility_file}",
        f"soil     {result.soil_file}",
    ]
    return "\n".join(lines)


def main() -> int:
    """Run the demo with everything at its default; return the exit code."""
    try:
        print(summary(run_demo(say=lambda line: print(line, file=sys.stderr))))
    except SmallwheelError as error:
        print(f"demo: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
