# SPDX-License-Identifier: Apache-2.0
"""The demo: a simulated drive played over DDS into the node; its answers as tables, pictures and text.

`smallwheel demo` or `make demo`.
"""

from __future__ import annotations

import json
import os
import shutil
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np
import pandas as pd
from numpy.typing import NDArray

from smallwheel_ros.common.errors import SmallwheelError
from smallwheel_ros.costmap.cost_picture import draw_cost
from smallwheel_ros.costmap.grid import UNKNOWN
from smallwheel_ros.demo.pictures import Clip, draw_drive
from smallwheel_ros.drive.messages import VALID
from smallwheel_ros.pipeline.mobility.status import Status
from smallwheel_ros.ros import NodeProcess, check_ros, config_file
from smallwheel_ros.simulate import DriveSettings, simulate_drive, write_drive_bag

if TYPE_CHECKING:
    from smallwheel_ros.ros.play import PlayedRecording

Array = NDArray[np.float64]

_BAG, _ANSWER = "drive", "drive.answer.json"
_LOG = "node.log"
_PICTURES = ("drive.png", "cost.png")
_TABLES = ("mobility.csv", "soil.csv")
_BAND = 1.96  # standard deviations: 95 %
_PAUSE = 1.0  # s without a warning after which it has ended


class DemoError(SmallwheelError):
    """The demo did not work; the message says where."""


def run_demo(
    folder: Path, *, seed: int, distance: float, rate: float
) -> tuple[dict[str, Any], str]:
    """Simulate a drive that ends stuck on a slope, play it into the node, and draw the node's estimates.

    Each step is reported on standard error.

    Parameters
    ----------
    folder
        Folder for all files; those of an earlier run are replaced.
    seed
        Seed of the simulated drive.
    distance
        Distance before the slope that ends the drive, m.
    rate
        Largest factor on real time; the player waits for the node.

    Returns
    -------
    document, text : dict, str
        Paths of pictures and tables, and numbers of messages played, of estimates, and of sinkages that the
        node did not answer (`unanswered`); and the results in words.

    Raises
    ------
    NodeProcessError
        If there is no ROS.
    PlayError
        If the node dies or does not answer.
    DemoError
        If the folder cannot be used.
    """
    start = time.monotonic()
    check_ros()
    _prepare(folder)
    _say("1/3 simulating a drive of a rover with two wheel sizes over three soils, up a slope")
    settings = DriveSettings(seed=seed, distance=distance, wheels="two_sizes", finish="slope")
    drive = simulate_drive(settings)
    bag = folder / _BAG
    count = write_drive_bag(drive, bag)
    answer = drive.answer()
    (folder / _ANSWER).write_text(json.dumps(answer), encoding="utf-8")
    epoch = int(answer["epoch_ns"])
    _say(f"2/3 playing {count} messages over DDS into the node mobility_estimator")
    parameters = config_file("two_wheel_sizes.yaml")
    balance = config_file("vehicle_balance.yaml")
    # So large that it holds the whole drive.
    whole = {"cost.size": f"{4.0 * (distance + 10.0):.1f}", "cost.unknown": "none"}
    full = clip_of(recorded(bag, [parameters, balance], folder, rate=rate, overrides=whole), epoch)
    _say("3/3 writing tables and pictures")
    tables, pictures = ([folder / name for name in names] for names in (_TABLES, _PICTURES))
    for path, table in zip(tables, (full.mobility, full.soil), strict=True):
        table.to_csv(path, index=False, float_format="%.9g")
    warned = [(stamp - epoch) / 1e9 for stamp, _ in full.recording.warnings]
    draw_drive(full, answer, warned, pictures[0])
    if full.recording.cost is not None:
        way = np.array([answer["rover"]["x"], answer["rover"]["y"]]).T
        title = "Cost of the ground, as the node publishes it for a planner"
        draw_cost(full.recording.cost, pictures[1], way=way, title=title)
    seconds = time.monotonic() - start
    document = {
        "picture": str(pictures[0]),
        "pictures": [str(path) for path in pictures],
        "mobility": str(tables[0]),
        "soil": str(tables[1]),
        "messages": full.recording.published,
        "estimates": len(full.mobility),
        "unanswered": full.recording.unanswered,
        "seconds": round(seconds, 1),
    }
    lines = [summary(full, answer), f"took {seconds:.0f} s", ""]
    lines += [f"picture  {path}" for path in pictures]
    lines += [f"table    {path}" for path in tables]
    return document, "\n".join(lines)


def _say(line: str) -> None:
    click.echo(line, err=True)


def _prepare(folder: Path) -> None:
    """Make the folder, without what an earlier run left. Raises DemoError."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        shutil.rmtree(folder / _BAG, ignore_errors=True)
        for name in (_ANSWER, _LOG, *_TABLES, *_PICTURES):
            (folder / name).unlink(missing_ok=True)
    except OSError as error:
        raise DemoError(f"the folder {folder} cannot be used: {error.strerror}") from error


# --- What the node answers


def recorded(
    bag: Path,
    parameters: Sequence[Path],
    folder: Path,
    *,
    rate: float,
    overrides: Mapping[str, str] | None = None,
) -> PlayedRecording:
    """Run the node in a process of its own, play a bag into it, and record its answers.

    Parameters
    ----------
    bag
        The bag.
    parameters
        The node's parameter files; later ones take precedence.
    folder
        Folder for the node's log.
    rate
        Largest factor on real time; the player waits for the node.
    overrides
        Further parameters by name, as they are typed; they take precedence over the files.

    Returns
    -------
    PlayedRecording
        The node's answers, and how long they took.

    Raises
    ------
    NodeProcessError
        If there is no ROS.
    PlayError
        If the node dies or does not answer.
    """
    check_ros()
    from smallwheel_ros.ros.play import drive_through  # needs ROS

    more = {"use_sim_time": "true", **(overrides or {})}
    with (
        _own_ros(folder / "ros_log"),
        NodeProcess(parameters, folder / _LOG, more) as node,
    ):
        return drive_through(bag, rate=rate, alive=node.death)


@contextmanager
def _own_ros(log_folder: Path) -> Iterator[None]:
    """Separate ROS from that of other programs by environment variables, inside the `with` block.

    The domain is that of ROS_DOMAIN_ID if it is set, otherwise one derived from the process id.
    """
    before = dict(os.environ)
    os.environ["ROS_DOMAIN_ID"] = before.get("ROS_DOMAIN_ID") or str(1 + os.getpid() % 100)
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    os.environ["ROS_LOG_DIR"] = str(log_folder)
    try:
        yield
    finally:
        os.environ.clear()
        os.environ.update(before)


def clip_of(recording: PlayedRecording, epoch: int) -> Clip:
    """Turn the node's answers into tables.

    Parameters
    ----------
    recording
        The answers.
    epoch
        Stamp at which the tables' column `time` is 0, ns.
    """
    mobility = _mobility_table(recording.mobility, epoch)
    return Clip(mobility, _soil_table(recording.soil, epoch), recording, epoch)


def _mobility_table(rows: list[dict[str, Any]], epoch: int) -> pd.DataFrame:
    """One row per estimate; blank where a quantity is not known."""
    table = pd.DataFrame(rows)
    table.insert(0, "time", (table.pop("stamp") - epoch) / 1e9)
    table = table.drop(columns="frame_id")
    table.insert(1, "wheel", table.pop("wheel"))
    for flag, names in VALID.items():
        known = table.pop(flag)
        told = [c for c in map(str, table) if c.removesuffix("_standard_deviation") in names]
        table[told] = table[told].where(known)
    return table.sort_values(["time", "wheel"], ignore_index=True)


def _soil_table(rows: list[dict[str, Any]], epoch: int) -> pd.DataFrame:
    """One row per message; the first is of the node's start, before there was a measurement."""
    table = pd.DataFrame(rows)
    measured = table["measurements_accepted"] > 0
    table = table[measured].reset_index(drop=True) if measured.any() else table.iloc[-1:]
    table.insert(0, "time", (table.pop("stamp") - epoch) / 1e9)
    covariance = np.stack([np.asarray(c).reshape(3, 3) for c in table.pop("covariance")])
    for i, name in enumerate(("k", "n", "m")):
        place = list(table.columns).index(name) + 1
        table.insert(place, f"{name}_standard_deviation", np.sqrt(covariance[:, i, i]))
    return table.drop(columns=["frame_id"])


# --- The node's estimates against the truth, in words


def summary(full: Clip, answer: dict[str, Any]) -> str:
    """Summarise the node's estimates in lines of text, beside the true values.

    Parameters
    ----------
    full
        The node's answers.
    answer
        True values of the simulated drive, as its `answer()` gives them.
    """
    found = full.recording
    latencies = np.array(found.latencies) * 1e3
    lines = [
        *_wheels(full.mobility),
        "",
        *_soil(full.soil.iloc[-1], answer),
        "",
        _pull(full, answer),
        "",
        _stuck(full.recording.vehicle, full.epoch, answer),
        _cost(found),
        "",
        f"{found.published} messages played, {len(full.mobility)} estimates,"
        f" {found.unanswered} sinkages without answer",
        f"from a sinkage to its estimate: median {np.median(latencies):.0f} ms, while"
        " it waits for the other wheels' sinkages; 99 % within"
        f" {np.percentile(latencies, 99):.0f} ms",
    ]
    return "\n".join(lines)


def _wheels(table: pd.DataFrame) -> list[str]:
    lines = ["wheel         estimates  not used  sinkage measured - predicted   drawbar pull > 0"]
    for wheel, rows in table.groupby("wheel"):
        used = rows[rows["status"] != Status.REJECTED]
        error = (used["sinkage_measured"] - used["sinkage_predicted"]).dropna() * 1e3
        share = (rows["probability_drawbar_pull_positive"].dropna() > 0.5).mean()
        lines.append(
            f"{wheel:<12} {len(rows):>10} {len(rows) - len(used):>9}"
            f" {np.sqrt(np.mean(error**2)):>20.2f} mm rms {share:>17.0%}"
        )
    return lines


def _soil(last: pd.Series[Any], answer: dict[str, Any]) -> list[str]:
    """k, n and m at the end."""
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


def _pull(full: Clip, answer: dict[str, Any]) -> str:
    """A sentence on errors of the drawbar pull of moving wheels, beside its stated standard deviation."""
    off, deviation = _pull_errors(full.mobility, answer)
    inside = (abs(off) < _BAND * deviation).mean()
    rms = np.sqrt((off**2).mean())
    return (
        f"drawbar pull: error {rms:.2f} N rms, stated {deviation.mean():.2f} N (1 sd); truth inside the"
        f" 95 % band: {inside:.0%} of {len(off)}"
    )


def _pull_errors(table: pd.DataFrame, answer: dict[str, Any]) -> tuple[Array, Array]:
    """Errors of the drawbar pull of moving wheels (N), and their estimated standard deviations (N)."""
    off, deviations = [], []
    for wheel, rows in table.groupby("wheel"):
        rows = rows.dropna(subset=["drawbar_pull"])
        truth = answer["wheels"][wheel]
        moving = np.interp(rows["time"], truth["time"], np.asarray(truth["moving"], float)) > 0.5
        true = np.interp(rows["time"], truth["time"], truth["drawbar_pull"])
        off.append((rows["drawbar_pull"] - true)[moving])
        deviations.append(rows["drawbar_pull_standard_deviation"][moving])
    return np.concatenate(off), np.concatenate(deviations)


def _stuck(rows: list[dict[str, Any]], epoch: int, answer: dict[str, Any]) -> str:
    """A sentence on the distance and time by which the node's warning came before the vehicle was stuck.

    It gives them for both levels of the warning, by the stamps of the messages: diagnostics come once a
    second, which is several seconds of a bag that is played faster than it was recorded.
    """
    stuck = answer["stuck"]
    if stuck is None:
        return "never stuck"
    rover, words = answer["rover"], []
    for name, least in (("may get stuck", 2), ("gets stuck", 3)):
        stamps = np.array([row["stamp"] for row in rows if row["level"] >= least], dtype=float)
        times = (stamps - epoch) / 1e9
        times = times[times <= stuck["time"]]
        if not times.size or stuck["time"] - times[-1] > _PAUSE:
            continue
        begins = float(times[np.flatnonzero(np.diff(times, prepend=-np.inf) > _PAUSE)[-1]])
        way = stuck["way"] - np.interp(begins, rover["time"], rover["way"])
        words.append(f"{way:.1f} m and {stuck['time'] - begins:.0f} s before ({name})")
    warned = f"warned of {', '.join(words)}" if words else "without a warning before"
    return f"stuck on the slope at {stuck['way']:.1f} m, {warned}"


def _cost(found: PlayedRecording) -> str:
    known = np.empty(0) if found.cost is None else found.cost.cells[found.cost.cells != UNKNOWN]
    if not known.size:
        return "cost map: nothing crossed"
    low, middle, high = np.histogram(known, [0, 20, 60, 101])[0] / known.size
    return (
        f"cost map: {known.size} cells with a cost; 0 to 19 in {low:.0%}, 20 to 59 in"
        f" {middle:.0%}, 60 and more in {high:.0%}"
    )
