# SPDX-License-Identifier: Apache-2.0
"""The tables of README's real rig, from the files of the public repository that measured it.

    git clone https://github.com/robomechanics/3d-terramechanics
    .venv/bin/python examples/cmu_rig.py 3d-terramechanics -o cmu_rig

FOLDER is that repository (MIT licence, Carnegie Mellon University; figures here are of commit 55a6e92).
What is written into the output folder, beside its licence:

    indentation.csv            plates and the smooth wheel pressed into the sand, 20 samples a second
    rolling.csv                the smooth wheel rolling at slip angle 0
    rolling_to_75.csv          the same at slip angles from 0 to 75 degrees
    rolling_smooth_wheel.csv   all of it, with 90 degrees

Which trials, which part of each and which zeros are those of the repository's own
force_displacement_curve_processing.m and read_force_displacement.m. The trials of the small box are left
out, as its walls are near, and those of the wheel with lugs.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy.io import loadmat

from smallwheel_ros.bags import BagReader
from smallwheel_ros.common.errors import SmallwheelError
from smallwheel_ros.common.files import write_bytes

DATA = "raw-data-processing"
ROLLING = "all_smooth_data.mat"
LICENCE = "license.txt.txt"
DIAMETER, WIDTH = 0.116, 0.050  # m, of the wheel
SOIL = "rig_sand"
EVERY, SMOOTH = 5, 10  # samples of the force sensor, which gives 100 a second
HOUR = 3600.0
FIELDS = ("avg_Fx", "avg_Fy", "std_Fy", "avg_Fz", "avg_Vx", "avg_Vry", "avg_Z", "Vry", "beta",
          "trial_num", "slip")  # fmt: skip


class RigError(SmallwheelError):
    """A folder that is not the repository, or a file of it that is not as expected."""


class Press(NamedTuple):
    """One trial. start, end: s after its bag's first message. depth: mm and force: N at its beginning.

    plate: diameter in mm, 0 for the wheel. behind: h by which the log's clock lags (a time zone).
    """

    folder: str
    name: str
    plate: int
    start: float
    end: float
    depth: float = 0.0
    force: float = 0.0
    behind: int = 5


TRIALS = (
    Press("f-d-large-box", "1", 60, 11.03, 22.0, -9.62, 0.75),
    Press("f-d-large-box", "2", 60, 13.73, 23.7, -8.55),
    Press("f-d-large-box", "3", 60, 10.97, 22.13, -9.58, 0.63),
    Press("f-d-large-box", "4", 100, 11.67, 21.54, -9.0, 0.4),
    Press("f-d-large-box", "5", 100, 9.39, 24.58, -9.68),
    Press("f-d-large-box", "6", 100, 9.6, 20.0, -9.42),
    Press("f-d-large-box", "7", 80, 12.65, 28.0, -8.72),
    Press("f-d-large-box", "8", 80, 9.9, 19.6, -9.33, 0.68),
    Press("f-d-large-box", "9", 80, 12.08, 23.6, -9.45, 0.45),
    Press("f-d-large-box", "smooth_1", 0, 10.2, 19.8, 9.98, -0.71),
    Press("f-d-large-box", "smooth_2", 0, 9.89, 17.7, 2.15, -1.0),
    Press("f-d-large-box", "smooth_3", 0, 9.49, 17.18, 3.67, -0.66),
    Press("force-displacement", "6", 0, 6.42, 19.8, behind=4),
    Press("force-displacement", "7", 0, 6.47, 17.7, behind=4),
    Press("force-displacement", "8", 0, 7.92, 21.3, behind=4),
    Press("force-displacement", "9", 0, 13.16, 25.1, behind=4),
    Press("force-displacement", "10", 0, 7.75, 21.9, behind=4),
    Press("force-displacement", "11", 0, 4.5, 17.7, behind=4),
)


def indentation(folder: Path, trials: tuple[Press, ...] = TRIALS) -> pd.DataFrame:
    """Sinkage and load of each trial, a row for each sample that is kept.

    Raises RigError where a file is missing or not as expected, BagError where a bag is not.
    """
    return pd.concat([_pressed(folder / DATA, trial) for trial in trials], ignore_index=True)


class Recorded(NamedTuple):
    """Load (N, positive when pressing) and sinkage (m), each at its times, ns of the bag's clock."""

    load_time: np.ndarray
    load: np.ndarray
    sinkage_time: np.ndarray
    sinkage: np.ndarray


def recorded(bag: Path, zero: Path, log: Path, trial: Press) -> Recorded:
    """Read the force's z component less the unloaded sensor's mean, and the log of the axis.

    The log has a line for each instant: X, Vx, rim speed, slip angle, Z (mm, up), clock, unix time (s).
    """
    begin, time, force = _forces(bag)
    unloaded = _forces(zero)[2].mean()
    axis = pd.read_csv(log, header=None).to_numpy()
    if axis.shape[1] not in (7, 8):  # later logs of that rig end with one more
        raise RigError(f"{log}: {axis.shape[1]} columns, expected 7 numbers in a line")
    log_time = np.round((axis[:, 6] + trial.behind * HOUR) * 1e9).astype(np.int64)
    log_time, first = np.unique(log_time, return_index=True)
    felt, seen = (
        (since >= trial.start) & (since <= trial.end)
        for since in ((time - begin) / 1e9, (log_time - begin) / 1e9)
    )
    if not (felt.any() and seen.any()):
        raise RigError(
            f"{bag}: nothing from {trial.start:g} to {trial.end:g} s after its beginning"
        )
    sinkage = -1e-3 * axis[first, 4]
    return Recorded(time[felt], (unloaded - force)[felt], log_time[seen], sinkage[seen])


def _forces(path: Path) -> tuple[int, np.ndarray, np.ndarray]:
    """Time of the bag's first message (ns), stamps (ns) and z components (N) of its forces."""
    found: dict[int, float] = {}
    with BagReader(path) as reader:
        for _, _, _, message in reader.messages():
            for part in (message, *vars(message).values()):  # a vendor's message has it in a field
                if getattr(part, "__msgtype__", None) == "geometry_msgs/msg/WrenchStamped":
                    stamp = part.header.stamp
                    found.setdefault(
                        int(stamp.sec) * 10**9 + int(stamp.nanosec), part.wrench.force.z
                    )
        begin = reader.start_time or 0
    if not found:
        raise RigError(f"{path}: no geometry_msgs/WrenchStamped in any message")
    times = np.array(sorted(found), dtype=np.int64)
    return begin, times, np.array([found[time] for time in times.tolist()])


def _pressed(folder: Path, trial: Press) -> pd.DataFrame:
    start = folder / trial.folder / f"force-displacement_{trial.name}"
    bag, zero, log = (_there(Path(f"{start}{end}")) for end in (".bag", "_zero.bag", ".txt"))
    found = recorded(bag, zero, log, trial)
    time = found.load_time - found.load_time[0]
    # At either end the log may have a sample less: its own end is held.
    z = np.interp(time, found.sinkage_time - found.load_time[0], found.sinkage) + 1e-3 * trial.depth
    load = pd.Series(found.load - trial.force).rolling(SMOOTH, center=True, min_periods=1).mean()
    wheel = not trial.plate
    rows = pd.DataFrame(
        {
            "run": f"{trial.folder}_{trial.name}",
            "soil": SOIL,
            "contact": "pressed" if wheel else "plate",
            "diameter [m]": DIAMETER if wheel else 1e-3 * trial.plate,
            "width [m]": WIDTH if wheel else np.nan,
            "t [s]": (1e-9 * time).round(4),
            "sinkage [m]": z.round(6),
            "load [N]": load.round(3),
        }
    )
    return rows[(rows["sinkage [m]"] > 0.0) & (rows["load [N]"] > 0.0)][::EVERY]


def rolling(folder: Path) -> pd.DataFrame:
    """The steady state of each trial of the smooth wheel, as the repository averaged it, a row each.

    Raises RigError where the file is missing or has other fields.
    """
    file = _there(folder / DATA / ROLLING)
    try:
        found = loadmat(file, squeeze_me=True)["all_results"]
        values = {name: np.atleast_1d(found[name]).astype(float) for name in FIELDS}
    except (KeyError, ValueError, IndexError, TypeError) as error:
        raise RigError(
            f"{file}: {error}; expected the structure all_results with {', '.join(FIELDS)}, as in "
            "commit 55a6e92 of the repository"
        ) from error
    v = pd.DataFrame(values)
    return pd.DataFrame(
        {
            "run": [f"rim{r:g}_angle{b:g}" for r, b in zip(v.Vry, v.beta, strict=True)],
            "trial": v.trial_num.astype(int),
            "wheel": "smooth",
            "soil": SOIL,
            "diameter [m]": DIAMETER,
            "width [m]": WIDTH,
            "load [N]": (-v.avg_Fz).round(4),
            "slip": v.slip.round(5),
            "slip_angle [deg]": v.beta,
            "speed [mm/s]": v.avg_Vx.round(4),
            "rim_speed [mm/s]": v.avg_Vry.round(4),
            "drawbar_pull [N]": (-v.avg_Fy).round(4),
            "drawbar_pull_std [N]": v.std_Fy.round(4),
            "side_force [N]": v.avg_Fx.round(4),
            "sinkage [mm]": (-v.avg_Z).round(4),
        }
    )


def _there(file: Path) -> Path:
    if not file.exists():
        raise RigError(
            f"{file}: no such file, expected FOLDER to be a copy of "
            "https://github.com/robomechanics/3d-terramechanics: clone it first"
        )
    return file


def write_tables(folder: Path, output: Path, trials: tuple[Press, ...] = TRIALS) -> None:
    """Write the tables and the licence, and say how many rows each has. Raises SmallwheelError."""
    all_angles = rolling(folder)
    angle = all_angles["slip_angle [deg]"]
    tables = {
        "indentation.csv": indentation(folder, trials),
        "rolling.csv": all_angles[angle == 0.0],
        "rolling_to_75.csv": all_angles[angle <= 75.0],
        "rolling_smooth_wheel.csv": all_angles,
    }
    write_bytes(output / "LICENSE", _there(folder / LICENCE).read_bytes())
    for name, table in tables.items():
        write_bytes(output / name, table.to_csv(index=False).encode())
        print(f"{output / name}: {len(table)} rows, {table['run'].nunique()} runs")


def main() -> int:
    """Read the repository's files, write the tables; give the exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("-o", "--output", type=Path, default=Path("cmu_rig"))
    options = parser.parse_args()
    try:
        options.output.mkdir(parents=True, exist_ok=True)
        write_tables(options.folder, options.output)
    except (SmallwheelError, OSError) as error:
        print(f"cmu_rig: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
