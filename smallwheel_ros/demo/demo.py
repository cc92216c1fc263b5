# SPDX-License-Identifier: Apache-2.0
"""The demo: a simulated drive played over DDS into the node; its answers as tables, pictures, words.

`smallwheel demo` or `make demo`.
"""

from __future__ import annotations

import json
import math
import os
import shutil
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from tqdm import tqdm

from smallwheel_ros.bags import BagReader
from smallwheel_ros.common.errors import SmallwheelError
from smallwheel_ros.costmap.cost_picture import draw_cost
from smallwheel_ros.costmap.grid import UNKNOWN
from smallwheel_ros.onboard.result import VALID
from smallwheel_ros.replay.pictures import draw_drive, draw_known
from smallwheel_ros.ros import NodeProcess, check_ros, config_file, own_ros
from smallwheel_ros.simulate import DriveSettings, simulate_drive, write_drive_bag

if TYPE_CHECKING:
    from smallwheel_ros.ros.play import Recording

DEFAULT_FOLDER = Path("out") / "demo"
_BAG, _ANSWER = "drive", "drive.answer.json"
_LOG, _BARE_LOG = "node.log", "node_bare.log"
_MOBILITY, _SOIL = "mobility.csv", "soil.csv"
_BARE_MOBILITY = "mobility_bare.csv"
_PICTURE, _COST, _KNOWN = "drive.png", "cost.png", "known.png"
_FILES = (_ANSWER, _LOG, _BARE_LOG, _MOBILITY, _SOIL, _BARE_MOBILITY, _PICTURE, _COST, _KNOWN)
_BAND = 1.96  # standard deviations: 95 %
_BARE_SECONDS = 25.0  # of the drive, played a second time


class DemoError(SmallwheelError):
    """The demo did not work; the message says where."""


@dataclass(frozen=True)
class Clip:
    """What the node answered to a bag that was played into it.

    mobility: one row per estimate, quantities that are not known blank; soil: one per message.
    """

    mobility: pd.DataFrame
    soil: pd.DataFrame
    recording: Recording


@dataclass(frozen=True)
class DemoResult:
    """What the demo made: files, and the tables in them.

    full: the drive with everything measured. bare: its beginning, with load and slip only.
    """

    folder: Path
    full: Clip
    bare: Clip
    answer: dict[str, Any]
    seconds: float

    @property
    def pictures(self) -> tuple[Path, ...]:
        """The drive, the cost map, and what was known with and without sensors."""
        return tuple(self.folder / name for name in (_PICTURE, _COST, _KNOWN))

    @property
    def tables(self) -> tuple[Path, ...]:
        """Mobility and soil of the drive, mobility of the bare one."""
        return tuple(self.folder / name for name in (_MOBILITY, _SOIL, _BARE_MOBILITY))


def run_demo(
    folder: Path | str = DEFAULT_FOLDER,
    *,
    seed: int = 1,
    distance: float = 24.0,
    rate: float = 4.0,
    say: Callable[[str], None] = lambda _: None,
) -> DemoResult:
    """Simulate a drive that ends stuck on a slope, play it into the node, draw what it finds.

    Parameters
    ----------
    folder
        For everything that is made; files of an earlier run are replaced.
    seed, distance
        Of the drive; m before the slope that ends it.
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
    say("1/4 simulating a drive of a rover with two wheel sizes over three soils, up a slope")
    settings = DriveSettings(seed=seed, distance=distance, wheels="two_sizes", finish="slope")
    drive = simulate_drive(settings)
    bag = folder / _BAG
    count = write_drive_bag(drive, bag)
    answer = drive.answer()
    (folder / _ANSWER).write_text(json.dumps(answer), encoding="utf-8")
    epoch = int(answer["epoch_ns"])
    say(f"2/4 playing {count} messages over DDS into the node mobility_estimator")
    parameters = config_file("two_wheel_sizes.yaml")
    balance = config_file("vehicle_balance.yaml")
    # So large that it holds the whole drive.
    whole = {"cost.size": f"{4.0 * (distance + 10.0):.1f}", "cost.unknown": "none"}
    full = _clip(recorded(bag, [parameters, balance], folder, rate=rate, overrides=whole), epoch)
    say(f"3/4 playing its first {_BARE_SECONDS:.0f} s again: nothing but load and slip")
    blind = {f"{wheel.name}.sinkage_topic": "''" for wheel in drive.rover.wheels}
    bare = _clip(
        recorded(
            bag,
            [parameters],
            folder,
            rate=rate,
            overrides=blind,
            seconds=_BARE_SECONDS,
            by_sinkage=False,
            log=_BARE_LOG,
        ),
        epoch,
    )
    say("4/4 writing tables and pictures")
    for name, table in (
        (_MOBILITY, full.mobility),
        (_SOIL, full.soil),
        (_BARE_MOBILITY, bare.mobility),
    ):
        table.to_csv(folder / name, index=False, float_format="%.9g")
    warned = [(stamp - epoch) / 1e9 for stamp, _ in full.recording.warnings]
    draw_drive(full.mobility, full.soil, folder / _PICTURE, truth=answer, warned=warned)
    way = np.array([answer["rover"]["x"], answer["rover"]["y"]]).T
    if full.recording.cost is not None:
        title = "What the soil costs, as the node tells it to a planner"
        draw_cost(full.recording.cost, folder / _COST, way=way, title=title)
    draw_known(
        {"with sinkage, imu and mass": full.mobility, "with load and slip only": bare.mobility},
        {"with sinkage, imu and mass": full.soil, "with load and slip only": bare.soil},
        answer,
        folder / _KNOWN,
    )
    return DemoResult(folder, full, bare, answer, time.monotonic() - start)


def _clip(recording: Recording, epoch: int) -> Clip:
    return Clip(_table(recording.mobility, epoch), _soil_table(recording.soil, epoch), recording)


def _prepared(folder: Path) -> Path:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        shutil.rmtree(folder / _BAG, ignore_errors=True)
        for name in _FILES:
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


def recorded(
    bag: Path,
    parameters: Sequence[Path],
    folder: Path,
    *,
    rate: float,
    overrides: Mapping[str, str] | None = None,
    seconds: float = math.inf,
    by_sinkage: bool = True,
    log: str = _LOG,
) -> Recording:
    """Run the node in a process of its own, play a bag into it, and record its answers.

    Parameters
    ----------
    parameters
        The node's parameter files; later ones win.
    folder
        For the node's log.
    rate
        Times as fast as recorded, at most.
    overrides
        Further parameters.
    seconds, by_sinkage
        As in `drive_through`.
    log
        Name of the node's log in the folder.

    Raises
    ------
    NodeProcessError
        If there is no ROS.
    DriveThroughError
        If the node dies or does not answer.
    """
    check_ros()
    from smallwheel_ros.ros.play import drive_through  # needs ROS

    with BagReader(bag) as reader:
        total = reader.message_count
    more = {"use_sim_time": "true", **(overrides or {})}
    with (
        _environment(own_ros(folder / "ros_log")),
        NodeProcess(parameters, folder / log, more) as node,
        tqdm(total=total, unit=" messages", disable=None, leave=False) as bar,
    ):
        return drive_through(
            bag,
            rate=rate,
            seconds=seconds,
            by_sinkage=by_sinkage,
            alive=node.death,
            progress=bar.update,
        )


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
    """One row per message; the first is of the node's start, before there was a measurement."""
    table = pd.DataFrame(rows)
    measured = table["measurements_accepted"] > 0
    table = table[measured].reset_index(drop=True) if measured.any() else table.iloc[-1:]
    table.insert(0, "time", (table.pop("stamp") - epoch) / 1e9)
    covariance = np.stack([np.asarray(c).reshape(3, 3) for c in table.pop("covariance")])
    for i, name in enumerate(("k", "n", "m")):
        deviation = np.sqrt(covariance[:, i, i])
        place = list(table.columns).index(name) + 1
        table.insert(place, f"{name}_standard_deviation", deviation)
    return table.drop(columns=["frame_id"])


# --- In words: what the node found, against what was true


def summary(result: DemoResult) -> str:
    """Put the result into a few lines for people."""
    full, answer = result.full, result.answer
    found = full.recording
    lines = _wheels(full.mobility)
    lines += ["", *_soil(full, answer), "", *_pull(result), "", *_stuck(full, answer)]
    lines += [_cost(full), "", *_bare(result)]
    lines += [
        "",
        f"{found.published} messages played, {len(full.mobility)} estimates,"
        f" {found.unanswered} sinkages without answer",
        f"from a sinkage to its estimate: median {np.median(found.latencies) * 1e3:.0f} ms, while"
        " it waits for the other wheels' sinkages; 99 % within"
        f" {np.percentile(found.latencies, 99) * 1e3:.0f} ms",
        f"took {result.seconds:.0f} s",
        "",
        *(f"picture  {path}" for path in result.pictures),
        *(f"table    {path}" for path in result.tables),
    ]
    return "\n".join(lines)


def _wheels(table: pd.DataFrame) -> list[str]:
    lines = ["wheel         estimates  not used  sinkage measured - predicted   drawbar pull > 0"]
    for wheel, rows in table.groupby("wheel"):
        used = rows[rows["status"] != 3]
        error = (used["sinkage_measured"] - used["sinkage_predicted"]).dropna() * 1e3
        share = (rows["probability_drawbar_pull_positive"].dropna() > 0.5).mean()
        lines.append(
            f"{wheel:<12} {len(rows):>10} {len(rows) - len(used):>9}"
            f" {np.sqrt(np.mean(error**2)):>20.2f} mm rms {share:>17.0%}"
        )
    return lines


def _soil(clip: Clip, answer: dict[str, Any]) -> list[str]:
    last = clip.soil.iloc[-1]
    place = np.interp(last["time"], answer["rover"]["time"], answer["rover"]["way"])
    true = [s for s in answer["stretches"] if s["start"] <= place][-1]
    lines = ["soil at the end    estimated                  true"]
    for name, unit in (("k", "Pa/m^(n+m)"), ("n", ""), ("m", "")):
        deviation = last[f"{name}_standard_deviation"]
        known = "determined" if last[f"{name}_identifiable"] else "not determined"
        lines.append(
            f"{name:<12} {last[name]:>15.5g} +- {deviation:<9.2g} {true[name]:>9.5g} {unit:<10} {known}"
        )
    return lines


def pulls(table: pd.DataFrame, answer: dict[str, Any]) -> pd.DataFrame:
    """Stated and true drawbar pull (N) of every estimate of a moving wheel that has one."""
    parts = []
    for wheel, rows in table.groupby("wheel"):
        truth = answer["wheels"][wheel]
        moving = (
            np.interp(rows["time"], truth["time"], np.array(truth["moving"], dtype=float)) > 0.5
        )
        rows = rows[moving & rows["drawbar_pull"].notna()]
        parts.append(
            pd.DataFrame(
                {
                    "time": rows["time"],
                    "stated": rows["drawbar_pull"],
                    "deviation": rows["drawbar_pull_standard_deviation"],
                    "true": np.interp(rows["time"], truth["time"], truth["drawbar_pull"]),
                }
            )
        )
    return pd.concat(parts)


def _pull_line(name: str, found: pd.DataFrame) -> str:
    off = found["stated"] - found["true"]
    inside = (off.abs() < _BAND * found["deviation"]).mean()
    return (
        f"{name:<28} {np.sqrt((off**2).mean()):>8.2f} N {found['deviation'].mean():>12.2f} N"
        f" {inside:>14.0%} of {len(found)}"
    )


def _pull(result: DemoResult) -> list[str]:
    end = result.bare.mobility["time"].max()
    full = pulls(result.full.mobility, result.answer)
    bare = pulls(result.bare.mobility, result.answer)
    return [
        "drawbar pull                 error, rms   stated, 1 sd   true one in its 95 % band",
        _pull_line("with sinkage, imu and mass", full),
        _pull_line(f"  of that, first {end:.0f} s", full[full["time"] <= end]),
        _pull_line("with load and slip only", bare),
    ]


def _stuck(clip: Clip, answer: dict[str, Any]) -> list[str]:
    time, way = answer["rover"]["time"], answer["rover"]["way"]
    epoch = answer["epoch_ns"]
    warned = [((stamp - epoch) / 1e9, text) for stamp, text in clip.recording.warnings]
    lines = []
    stuck = answer["stuck"]
    if stuck is not None:
        before = _last_episode([t for t, _ in warned if t < stuck["time"]])
        if before is None:
            lines.append(f"stuck at {stuck['way']:.1f} m, without a warning before")
        else:
            at = float(np.interp(before, time, way))
            text = next(words for t, words in warned if t == before)
            lines.append(
                f"stuck on the slope at {stuck['way']:.1f} m, warned of {stuck['way'] - at:.1f} m and"
                f" {stuck['time'] - before:.0f} s before: {text!r}"
            )
    else:
        lines.append("never stuck")
    return lines


def _last_episode(times: list[float]) -> float | None:
    """Begin of the last warnings without a long pause, s."""
    if not times:
        return None
    # Diagnostics come once a second, of a bag that is played several times as fast as recorded.
    pauses = np.flatnonzero(np.diff(times) > 12.0)
    return times[pauses[-1] + 1] if pauses.size else times[0]


def _cost(clip: Clip) -> str:
    grid = clip.recording.cost
    known = np.empty(0) if grid is None else grid.cells[grid.cells != UNKNOWN]
    if not known.size:
        return "cost map: nothing crossed"
    shares = [
        np.mean((known >= low) & (known < high)) for low, high in ((0, 20), (20, 60), (60, 101))
    ]
    return (
        f"cost map: {known.size} cells with a cost; 0 to 19 in {shares[0]:.0%}, 20 to 59 in"
        f" {shares[1]:.0%}, 60 and more in {shares[2]:.0%}"
    )


def _bare(result: DemoResult) -> list[str]:
    last = result.bare.soil.iloc[-1]
    unknown = [name for name in ("k", "n", "m") if not last[f"{name}_identifiable"]]
    margin = result.bare.mobility["mobility_margin_standard_deviation"].median()
    measured = result.full.mobility
    measured = measured[measured["time"] <= result.bare.mobility["time"].max()]
    with_all = measured["mobility_margin_standard_deviation"].median()
    return [
        "with load and slip only the node does not know: "
        + ", ".join(unknown)
        + (f" ({last['status_text']})" if last["status_text"] else ""),
        f"margin for slopes then +- {margin:.2f} of the load, with everything +- {with_all:.2f}",
    ]
