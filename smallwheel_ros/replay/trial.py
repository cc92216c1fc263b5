# SPDX-License-Identifier: Apache-2.0
"""`smallwheel convert-trial`: a recorded indentation trial as a bag that the node understands.

A trial is what a rig records while it presses a wheel straight into the soil: a bag with the force
sensor's messages, a bag with those of the unloaded sensor, and the log of the axis, a text table
with one line per instant and no header:

    X mm, Vx mm/s, rim speed mm/s, slip angle deg, Z mm (up), controller clock ms, unix time s

as that of the rig of Carnegie Mellon University (github.com/robomechanics/3d-terramechanics).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from operator import itemgetter
from pathlib import Path
from typing import Annotated, Any

import click
import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.bags import BagReader, BagWriter, Message, check_new_bag, header
from smallwheel_ros.common.console import JSON, tell
from smallwheel_ros.common.errors import SmallwheelError
from smallwheel_ros.common.files import check_targets
from smallwheel_ros.common.options import Option, settings_options
from smallwheel_ros.estimator.reading import SECOND
from smallwheel_ros.onboard.streams import nanoseconds

Array = NDArray[np.float64]

_COLUMNS = (7, 8)  # later logs of that rig end with one more
_Z, _UNIX_TIME = 4, 6
_LOAD = "geometry_msgs/msg/WrenchStamped"
_SINKAGE = "smallwheel_ros/msg/WheelSinkage"
_PATH = click.Path(path_type=Path)


class TrialError(SmallwheelError):
    """A trial that cannot be read, or nothing in it to convert."""


@dataclass(frozen=True)
class TrialSettings:
    """How the recordings of a trial belong together: the options of `smallwheel convert-trial`.

    The wheel's topics are `/<wheel>/load` and `/<wheel>/sinkage`. From start to end is what is converted:
    the unloading must not be in it. A sinkage_std of 0 leaves it to the node's parameter noise.sinkage.
    """

    wheel: Annotated[str, Option("Name of the wheel.")] = "wheel"
    log_behind: Annotated[
        float, Option("Seconds by which the log's clock is behind the bag's.")
    ] = 0.0
    start: Annotated[float, Option("s after the bag's begin.")] = 0.0
    end: Annotated[float, Option("s after the bag's begin.", words={"show_default": False})] = (
        math.inf
    )
    compliance: Annotated[
        float, Option("m/N by which the rig gives way; taken off the sinkage.")
    ] = 0.0
    sinkage_std: Annotated[
        float,
        Option(
            "Standard deviation of the sinkage, m; 0: left to the node's parameter.",
            words={"type": click.FloatRange(0)},
        ),
    ] = 0.0


@dataclass(frozen=True)
class Trial:
    """Load (N, positive when the wheel presses on the soil) and sinkage (m), each at its times.

    Times are ns since the epoch, of the bag's clock. zero: what the unloaded sensor shows, N.
    """

    load_time: NDArray[np.int64]
    load: Array
    sinkage_time: NDArray[np.int64]
    sinkage: Array
    zero: float


def read_trial(
    bag: Path | str, zero_bag: Path | str, log: Path | str, settings: TrialSettings
) -> Trial:
    """Read what was recorded of a trial.

    Load is minus the force's z component less the mean of the zero bag, sinkage is minus Z. Raises
    BagError if a bag cannot be read, TrialError if there is no force in one, the log is not such a table,
    or nothing is in the window.
    """
    begin, time, force = _forces(Path(bag))
    _, _, unloaded = _forces(Path(zero_bag))
    zero = float(np.mean(unloaded))
    log_time, z = _axis(Path(log))
    log_time = log_time + nanoseconds(settings.log_behind)
    load, sinkage = zero - force, -1e-3 * z
    # Far from the trial the load is held: nothing is converted there.
    sinkage = sinkage - settings.compliance * np.interp(log_time, time, load)
    felt, seen = (
        (since >= settings.start) & (since <= settings.end)
        for since in ((time - begin) / SECOND, (log_time - begin) / SECOND)
    )
    if not (felt.any() and seen.any()):
        raise TrialError(
            f"bag {bag} has {felt.sum()} forces and log {log} has {seen.sum()} lines in the"
            f" window from {settings.start:g} to {settings.end:g} s after the bag's beginning: the"
            f" log begins {(log_time[0] - begin) / SECOND:.3f} s after it with"
            f" {settings.log_behind:g} s for its clock's lag"
        )
    return Trial(time[felt], load[felt], log_time[seen], sinkage[seen], zero)


def write_trial(trial: Trial, path: Path | str, settings: TrialSettings) -> int:
    """Write a trial as a rosbag2 bag; return the number of messages. Raises BagError.

    Sinkages below zero are left out: the wheel is in the air.
    """
    wheel, nothing = settings.wheel, Message(x=0.0, y=0.0, z=0.0)
    messages = []
    for time, load in zip(trial.load_time.tolist(), trial.load.tolist(), strict=True):
        wrench = Message(force=Message(x=0.0, y=0.0, z=load), torque=nothing)
        messages.append((time, "load", _LOAD, Message(header=header(time, wheel), wrench=wrench)))
    variance = settings.sinkage_std**2
    for time, sinkage in zip(trial.sinkage_time.tolist(), trial.sinkage.tolist(), strict=True):
        if sinkage >= 0:
            message = Message(header=header(time, wheel), sinkage=sinkage, variance=variance)
            messages.append((time, "sinkage", _SINKAGE, message))
    with BagWriter(path) as writer:
        for time, what, kind, message in sorted(messages, key=itemgetter(0)):
            writer.write(f"/{wheel}/{what}", kind, time, message)
    return len(messages)


def _forces(path: Path) -> tuple[int, NDArray[np.int64], Array]:
    """Time of the bag's first message (ns), then stamps (ns) and z components (N) of forces."""
    times, forces = [], []
    with BagReader(path) as reader:
        begin = reader.start_time
        for entry in reader.messages():
            stamped = _wrench(entry.message)
            if stamped is not None:
                stamp = stamped.header.stamp
                times.append(int(stamp.sec) * SECOND + int(stamp.nanosec))
                forces.append(float(stamped.wrench.force.z))
    if begin is None or not forces:
        raise TrialError(f"bag {path} has no geometry_msgs/WrenchStamped in any message")
    if not np.all(np.isfinite(forces)):
        bad = int(np.flatnonzero(~np.isfinite(forces))[0])
        raise TrialError(f"bag {path}: force {bad + 1} of {len(forces)} is {forces[bad]} N")
    return begin, *_once(times, forces)


def _wrench(message: Any) -> Any | None:
    """Return a message, or the field of a vendor's message, that is a WrenchStamped."""
    for candidate in (message, *vars(message).values()):
        if getattr(candidate, "__msgtype__", None) == _LOAD:
            return candidate
    return None


def _axis(path: Path) -> tuple[NDArray[np.int64], Array]:
    """Times (ns) and Z (mm) of the axis's log."""
    times, z = [], []
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise TrialError(f"log {path} cannot be read: {error}") from error
    for number, line in enumerate(lines, start=1):
        if not line.strip():
            continue
        try:
            values = [float(text) for text in line.split(",")]
        except ValueError:
            raise TrialError(f"log {path}, line {number}: not numbers: {line[:60]!r}") from None
        if len(values) not in _COLUMNS or not np.all(np.isfinite(values)):
            raise TrialError(
                f"log {path}, line {number}: {len(values)} columns, expected {_COLUMNS[0]} finite"
                " numbers (X, Vx, rim speed, slip angle, Z, controller clock, unix time)"
            )
        times.append(round(values[_UNIX_TIME] * SECOND))
        z.append(values[_Z])
    if not times:
        raise TrialError(f"log {path} has no lines")
    return _once(times, z)


def _once(times: list[int], values: list[float]) -> tuple[NDArray[np.int64], Array]:
    """By time, the first of each: the node would refuse a stamp that comes twice."""
    time, first = np.unique(np.array(times, dtype=np.int64), return_index=True)
    return time, np.array(values)[first]


# --- The command


@click.command("convert-trial")
@click.argument("bag", type=_PATH)
@click.option("--zero", type=_PATH, required=True, metavar="BAG",
              help="Bag of the unloaded force sensor.")  # fmt: skip
@click.option("--log", type=_PATH, required=True,
              help="Log of the axis: X, Vx, rim speed, slip angle, Z [mm, up], controller clock, "
              "unix time.")  # fmt: skip
@click.option("-o", "--output", type=_PATH, required=True, metavar="BAG",
              help="Folder for the new bag; it must not exist.")  # fmt: skip
@settings_options(TrialSettings)
@JSON
def convert_trial(
    bag: Path, zero: Path, log: Path, output: Path, json_file: str | None, **given: Any
) -> None:
    """Turn a recorded indentation trial into a bag that the node understands.

    BAG holds the force sensor's messages while a wheel is pressed straight into the soil.
    """
    check_new_bag(output)
    check_targets([json_file], [bag, zero, log])
    settings = TrialSettings(**given)
    trial = read_trial(bag, zero, log, settings)
    content = {
        "bag": str(output),
        "messages": write_trial(trial, output, settings),
        "loads": len(trial.load),
        "sinkages": len(trial.sinkage),
        "largest_load": float(trial.load.max()),
        "largest_sinkage": float(trial.sinkage.max()),
        "zero": trial.zero,
    }
    text = (
        f"{output}: {len(trial.load)} loads to {trial.load.max():.1f} N,"
        f" {len(trial.sinkage)} sinkages to {trial.sinkage.max() * 1e3:.1f} mm"
    )
    tell(content, text, json_file)
